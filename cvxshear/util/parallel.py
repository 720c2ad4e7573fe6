"""The same work on many things: one process, several, or a cluster.

joblib runs it. Inside `with joblib.parallel_config(backend="dask")`, with a `dask.distributed.Client` open, the same
calls run on that cluster (the extra `dask`); a worker that is lost has its tasks done again by the others, since
every task is a pure function of what it is handed.

No process outlives the one that started it, however that ends: each looks after its parent.
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

MOST_JOBS = 4096
TASKS_A_JOB = 8
"""Chunks that each process gets: enough that none waits long for the last, few enough to send."""

GLANCE = 0.5
"""s between two looks of a process after its parent: well below the two seconds after which it must have ended."""

Progress = Callable[[int, int], None]
"""Function that is called with the number of things done and to do."""


def each(
    function: Callable[[Item], Done], items: Iterable[Item], *, jobs: int = 1, progress: Progress | None = None
) -> list[Done]:
    """function(item) for every item, in their order.

    Parameters
    ----------
    function : callable
        Picklable where `jobs` is not 1: a function of a module, or a `functools.partial` of one.
    items : iterable
    jobs : int, optional
        Processes; 1 stays in this one, -1 takes every core. On a Dask cluster, -1 takes every worker.
    progress : callable, optional
        Called after every chunk.

    Raises
    ------
    LostProcessError
        Where a process was killed.
    Exception
        What `function` raises.
    """
    todo = list(items)
    if jobs != -1:
        checks.whole(jobs, "jobs", least=1, most=MOST_JOBS)
    chunks = _chunks(todo, jobs, seen=progress is not None)
    results: list[Done] = []
    options: dict[str, Any] = {} if jobs == 1 else {"initializer": end_with, "initargs": (os.getpid(),)}
    parts: Any = ()
    try:
        with nullcontext() if jobs == 1 else _interruption_held():
            # In the order of the chunks, as they become ready.
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
    """Print no traceback of loky's managing thread: it may still look for a task that was given up."""
    hook = threading.excepthook

    def said(args: Any) -> None:
        if args.thread is None or "ExecutorManager" not in args.thread.name:
            hook(args)

    threading.excepthook = said


def _drop(parts: Any) -> None:
    """Cancel what is still under way. joblib warns of tasks that were begun for nothing: whoever stopped knows."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        if hasattr(parts, "close"):
            parts.close()


def _chunks(items: Sequence[Item], jobs: int, *, seen: bool) -> list[Sequence[Item]]:
    """Consecutive parts of the items."""
    processes = cpu_count() if jobs == -1 else jobs
    alone = 100 if seen else 1
    count = alone if jobs == 1 else TASKS_A_JOB * processes
    size = max(1, -(-len(items) // count))
    return [items[first : first + size] for first in range(0, len(items), size)]


def _done(function: Callable[[Item], Done], items: Sequence[Item]) -> list[Done]:
    # The matrices are small: threads inside a process among several would only get in each other's way.
    with threadpool_limits(1):
        return [function(item) for item in items]


def end_with(parent: int) -> None:
    """End this process soon after its parent, whatever ends that, and whatever this one is doing.

    Parameters
    ----------
    parent : int
        The parent's number. Whoever loses its parent gets another one.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(GLANCE)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _interruption_held() -> Iterator[None]:
    """Let Ctrl-C wait while processes are started: they inherit that it is none of theirs, and print no traceback."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # What counts the shared memory of processes is started with the first of them, and lets Ctrl-C in once it is.
    for tracker in ("multiprocessing.resource_tracker", "joblib.externals.loky.backend.resource_tracker"):
        importlib.import_module(tracker).ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
