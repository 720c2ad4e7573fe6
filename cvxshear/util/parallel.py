"""Apply one function to many items: in one process, in several, or on a cluster.

joblib runs the work. Inside `with joblib.parallel_config(backend="dask")`, with a `dask.distributed.Client` open, the
same calls run on that cluster (the extra `dask`). If the cluster loses a worker, other workers repeat its tasks: every
task is a pure function of its arguments.

Every worker process watches its parent and ends soon after the parent has ended.
"""

import importlib
import logging
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from typing import Any, TypeVar

from joblib import Parallel, cpu_count, delayed
from threadpoolctl import threadpool_limits

from cvxshear.util import checks
from cvxshear.util.errors import LostProcessError

logger = logging.getLogger(__name__)

Item = TypeVar("Item")
Done = TypeVar("Done")

#: Number of chunks for each process: enough to balance the load, and few enough to keep the transfer cheap.
TASKS_A_JOB = 8

#: Time in s between two checks of a worker for its parent. A worker must end within two seconds of its parent.
GLANCE = 0.5

#: Function that is called with the number of finished items and the number of all items.
Progress = Callable[[int, int], None]


def each(
    function: Callable[[Item], Done], items: Iterable[Item], *, jobs: int = 1, progress: Progress | None = None
) -> list[Done]:
    """Return function(item) for every item, in the order of the items.

    Parameters
    ----------
    function : callable
        If `jobs` is not 1, the function must be picklable: a function of a module, or a `functools.partial` of one.
    items : iterable
    jobs : int, optional
        Number of processes; 1 uses this process alone, -1 every core. On a Dask cluster, -1 uses every worker.
    progress : callable, optional
        Called after every chunk.

    Raises
    ------
    LostProcessError
        If a process was killed.
    Exception
        Any exception that `function` raises.
    """
    todo = list(items)
    if jobs != -1:
        checks.whole(jobs, "jobs", least=1)
    chunks = _chunks(todo, jobs, seen=progress is not None)
    results: list[Done] = []
    options: dict[str, Any] = {} if jobs == 1 else {"initializer": end_with, "initargs": (os.getpid(),)}
    parts: Any = ()
    try:
        with nullcontext() if jobs == 1 else _interruption_held():
            # joblib yields the results in the order of the chunks, while later chunks still run.
            parts = Parallel(n_jobs=jobs, return_as="generator", **options)(
                delayed(_done)(function, chunk) for chunk in chunks
            )
        for part in parts:
            results += part
            logger.debug("%d of %d done", len(results), len(todo))
            if progress is not None:
                progress(len(results), len(todo))
    except KeyboardInterrupt:
        _let_managers_end_in_silence()
        raise
    except BrokenProcessPool:
        raise LostProcessError(
            f"one of the processes was ended from outside, after {len(results)} of {len(todo)} things were done; where "
            "it was for want of memory, fewer jobs need less of it"
        ) from None
    finally:
        _drop(parts)
    return results


def _let_managers_end_in_silence() -> None:
    """Print no traceback of loky's managing thread, which may still look for a cancelled task."""
    hook = threading.excepthook

    def said(args: Any) -> None:
        if args.thread is None or "ExecutorManager" not in args.thread.name:
            hook(args)

    threading.excepthook = said


def _drop(parts: Any) -> None:
    """Cancel the unfinished tasks, and silence joblib's warning about cancelled tasks."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        if hasattr(parts, "close"):
            parts.close()


def _chunks(items: Sequence[Item], jobs: int, *, seen: bool) -> list[Sequence[Item]]:
    """Split the items into consecutive chunks."""
    processes = cpu_count() if jobs == -1 else jobs
    alone = 100 if seen else 1
    count = alone if jobs == 1 else TASKS_A_JOB * processes
    size = max(1, -(-len(items) // count))
    return [items[first : first + size] for first in range(0, len(items), size)]


def _done(function: Callable[[Item], Done], items: Sequence[Item]) -> list[Done]:
    # The matrices are small. Threads inside one of several processes would compete for the same cores.
    with threadpool_limits(1):
        return [function(item) for item in items]


def end_with(parent: int) -> None:
    """End this process soon after its parent has ended for any reason.

    Parameters
    ----------
    parent : int
        Process number of the parent. A process whose parent has ended gets another parent number.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(GLANCE)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _interruption_held() -> Iterator[None]:
    """Block Ctrl-C while workers start: they inherit the blocked signal and print no traceback."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # The trackers of shared memory start with the first worker, and their start unblocks Ctrl-C. Start them before.
    for tracker in ("multiprocessing.resource_tracker", "joblib.externals.loky.backend.resource_tracker"):
        importlib.import_module(tracker).ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
