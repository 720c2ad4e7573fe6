"""Programs as files: as they are, and as a test set of qpbenchmark (github.com/qpsolvers/qpbenchmark)."""

import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from importlib import resources
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.backends.benchmark import BenchmarkProgram
from cvxshear.backends.canonical import canonical
from cvxshear.programs import LeastSquares
from cvxshear.util.errors import InputError
from cvxshear.util.writing import write_file

TEST_SET = "cvxshear_programs.py"
"""qpbenchmark looks in a file of this name for a class of the same one in capitals; it reads the programs beside it."""


def export(programs: Sequence[BenchmarkProgram], folder: str | Path) -> list[Path]:
    """Write programs into a new folder.

    Parameters
    ----------
    programs : sequence of BenchmarkProgram
    folder : str or Path
        Gets a file KIND-NUMBER.npz a program, with the arrays of `LeastSquares` that it has and the `origin`; and a
        folder qpbenchmark with a test set: each program in the format of `qpsolvers.Problem.load`, stated and scaled,
        and the Python file that qpbenchmark takes.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    InputError
        Where the folder has something in it already or cannot be written; nothing is left behind then.
    """
    folder = Path(folder)
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder} is there already and not empty; name a new folder for the programs")
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=folder.name, dir=folder.parent) as beside:
            # The temporary folder is for one's own eyes alone, which is not what somebody who names one expects.
            whole = Path(beside) / folder.name
            whole.mkdir()
            written = _written(programs, whole)
            whole.replace(folder)
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {error.strerror}") from None
    return [folder / path.relative_to(whole) for path in written]


def _written(programs: Sequence[BenchmarkProgram], folder: Path) -> list[Path]:
    written = []
    benchmark = folder / "qpbenchmark"
    benchmark.mkdir()
    counts: dict[str, int] = {}
    for each in programs:
        counts[each.kind] = counts.get(each.kind, 0) + 1
        name = f"{each.kind.replace(' ', '-')}-{counts[each.kind]}.npz"
        contents = {
            folder / name: _saved(partial(np.savez, origin=each.origin, **_arrays(each.program))),
            benchmark / name: _stated(each.program),
            benchmark / name.replace(".npz", "-scaled.npz"): _scaled(each.program),
        }
        for path, content in contents.items():
            write_file(path, content)
        written += list(contents)
    write_file(benchmark / TEST_SET, resources.files("cvxshear.backends").joinpath("qpbenchmark.py.txt").read_bytes())
    return [*written, benchmark / TEST_SET]


def _arrays(program: LeastSquares) -> dict[str, Any]:
    """List the arrays of a program that it has and that say something."""
    found = {name: getattr(program, name) for name in ("R", "s", "W", "A", "b", "G", "h", "lower", "upper")}
    return {name: array for name, array in found.items() if array is not None and np.isfinite(array).any()}


def _stated(program: LeastSquares) -> bytes:
    import qpsolvers  # noqa: PLC0415 - imports every solver

    R, s = program.weighted
    arrays = _arrays(program)
    G, h, A, b, lower, upper = (arrays.get(name) for name in ("G", "h", "A", "b", "lower", "upper"))
    return _saved(qpsolvers.Problem(R.T @ R, -R.T @ s, G, h, A, b, lower, upper).save)


def _scaled(program: LeastSquares) -> bytes:
    import qpsolvers  # noqa: PLC0415 - imports every solver

    scaled = canonical(program)
    inequalities = (scaled.F, scaled.f) if len(scaled.f) else (None, None)
    equalities = (scaled.E, scaled.e) if len(scaled.e) else (None, None)
    P, q = scaled.C.T @ scaled.C, -scaled.C.T @ scaled.q
    return _saved(qpsolvers.Problem(P, q, *inequalities, *equalities).save)


def _saved(save: Callable[..., None]) -> bytes:
    """Return what a function writes into the stream that it is handed."""
    save(out := BytesIO())
    return out.getvalue()
