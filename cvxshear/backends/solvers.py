"""Table of the solvers of qpsolvers and cvxpy with packages and options, and the backend that calls qpsolvers.

The table is read without importing a solver; importing all of them takes seconds.
"""

from __future__ import annotations

import functools
import os
import sys
import time
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module, metadata, resources, util
from typing import TYPE_CHECKING, Any

import numpy as np

from cvxshear.backends.base import TIME_LIMIT, Backend
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.util.errors import NoSolutionError
from cvxshear.util.results import InJson

if TYPE_CHECKING:
    import qpsolvers


@dataclass(frozen=True)
class Solver(InJson):
    """A solver that qpsolvers or cvxpy can call; a backend of this library or of the caller has only a name.

    Parameters
    ----------
    name : str
        Name of the backend.
    module : str
        Module that Python imports.
    package : str
        Package that pip installs.
    through : str
        Package that calls the solver, "qpsolvers" or "cvxpy".
    """

    name: str
    module: str
    package: str
    through: str = "qpsolvers"

    json_keys = "name solver=package through installed version how_to_get"

    @property
    def missing(self) -> list[str]:
        """Packages that the solver requires."""
        needed = ((self.through, self.through), (self.package, self.module))
        return [package for package, module in needed if module and util.find_spec(module) is None]

    @property
    def installed(self) -> bool:
        """Whether the solver and the package that calls the solver can be imported."""
        return not self.missing

    @property
    def version(self) -> str | None:
        """Version of the solver; None if the solver is not installed or its package has no version."""
        try:
            return metadata.version(self.package) if self.package else None
        except metadata.PackageNotFoundError:
            return None

    @property
    def how_to_get(self) -> str:
        """Command that installs the solver; empty if installed."""
        return f"pip install {' '.join(self.missing)}" if self.missing else ""


_TABLES: dict[str, dict[str, Any]] = tomllib.loads(
    resources.files("cvxshear.backends").joinpath("solvers.toml").read_text(encoding="utf-8")
)
"""Table of the solvers; the file explains its keys and numbers."""

ACCURACY_OPTIONS: dict[str, dict[str, float]] = {
    name: table["tolerances"] for name, table in _TABLES.items() if "tolerances" in table
}
TIME_LIMITS = {name: table["time_limit"] for name, table in _TABLES.items() if "time_limit" in table}
"""Requested accuracies of each solver, and the name of its option for the time limit."""

THROUGH_QPSOLVERS = tuple(
    Solver(name, table.get("module", name), table.get("module", name).replace("_", "-"))
    for name, table in _TABLES.items()
)
"""Solvers of qpsolvers that pip can install, under their names there."""

THROUGH_CVXPY = tuple(Solver(f"cvxpy-{name}", name, name, "cvxpy") for name in _TABLES if "cvxpy" in _TABLES[name])
"""Solvers that cvxpy brings along and that take a quadratic objective."""


def default_options(solver: str) -> dict[str, Any]:
    """Collect all options of a solver.

    Parameters
    ----------
    solver : str
        Name of the solver in qpsolvers.
    """
    limit = {TIME_LIMITS[solver]: TIME_LIMIT} if solver in TIME_LIMITS else {}
    return {**ACCURACY_OPTIONS.get(solver, {}), **_TABLES.get(solver, {}).get("options", {}), **limit}


class CalledSolver(Backend):
    """A solver that another package calls, with the options that it gets.

    Parameters
    ----------
    solver : str
        Name of the solver in qpsolvers or cvxpy.
    **options
        Options of the solver, in addition to the accurate settings of `solvers.toml`.

    Attributes
    ----------
    options : dict
        All options that the solver gets.
    """

    time_limit = None
    through = "qpsolvers"

    def __init__(self, solver: str, **options: Any) -> None:
        self.solver, self._listed = solver, solver.lower()
        self.name = self._listed if self.through == "qpsolvers" else f"{self.through}-{self._listed}"
        further = _TABLES.get(self._listed, {}).get(self.through, {})
        self.options = {**default_options(self._listed), **further, **options}

    @property
    def tolerance(self) -> float | None:
        given = [float(self.options[name]) for name in ACCURACY_OPTIONS.get(self._listed, {}) if name in self.options]
        return max(given, default=None)

    def with_tolerance(self, tolerance: float) -> CalledSolver:
        return self.with_options(dict.fromkeys(ACCURACY_OPTIONS.get(self._listed, {}), tolerance))

    def with_options(self, options: Mapping[str, Any]) -> CalledSolver:
        return type(self)(self.solver, **{**self.options, **options}) if options else self

    def unsolved(self, status: str, seconds: float) -> NoSolutionError:
        """Make the error of a solver without a solution: the time limit, or the solver's own message."""
        limit = self.options.get(TIME_LIMITS.get(self._listed, ""))
        if limit is not None and seconds >= limit:
            return NoSolutionError(self.name, f"stopped at its time limit of {limit:g} s (its status: {status})")
        return NoSolutionError(self.name, f"no solution found (its status: {status})")


MAGNIFIED: dict[str, float] = {"highs": 1e4}
"""Factor on unknowns and right sides: HiGHS treats a reduced gradient of about 1e-6 as zero for any tolerance."""


class Qpsolvers(CalledSolver):
    """One solver of qpsolvers, under its name there."""

    def answer(self, problem: Canonical) -> Answer:
        # Most of what this library does needs no solver.
        import qpsolvers  # noqa: PLC0415 - imports every solver that is installed

        if self.name == "highs":
            _hear_version_of_highs()
        stated = self._stated(problem)
        # Solvers without support for a starting point ignore the start.
        scale = MAGNIFIED.get(self.name, 1.0)
        start = None if problem.start is None else scale * problem.start.z
        began = time.perf_counter()
        try:
            with warnings.catch_warnings():
                # A solver's warning (an inaccurate solution, an iteration limit) is in `found`, or the certificate
                # measures it.
                warnings.simplefilter("ignore")
                found = qpsolvers.solve_problem(stated, self.name, initvals=start, **self.options)
        except (qpsolvers.QPError, ValueError, ArithmeticError) as error:
            raise NoSolutionError(self.name, str(error) or type(error).__name__) from error
        status = _status(found)
        if not found.found or found.x is None:
            raise self.unsolved(status, time.perf_counter() - began)
        y = np.zeros(len(problem.e)) if found.y is None or not len(problem.e) else np.asarray(found.y)
        w = np.zeros(len(problem.f)) if found.z is None or not len(problem.f) else np.asarray(found.z)
        return Answer(np.asarray(found.x) / scale, y / scale, w / scale, status, _iterations(found.extras))

    def _stated(self, problem: Canonical) -> qpsolvers.Problem:
        """Write the problem in the solver's preferred matrix format: z'C'C z / 2 - (C'q)'z."""
        import qpsolvers  # noqa: PLC0415 - as in `answer`
        from scipy import sparse  # noqa: PLC0415 - only some solvers take it

        scale = MAGNIFIED.get(self.name, 1.0)
        stored = np.asarray if self.name in qpsolvers.dense_solvers else sparse.csc_matrix
        inequalities = (stored(problem.F), scale * problem.f) if len(problem.f) else (None, None)
        equalities = (stored(problem.E), scale * problem.e) if len(problem.e) else (None, None)
        P, q = stored(problem.C.T @ problem.C), -problem.C.T @ (scale * problem.q)
        return qpsolvers.Problem(P, q, *inequalities, *equalities)


@functools.cache
def _hear_version_of_highs() -> None:
    """Create the first instance of HiGHS with standard output closed.

    HiGHS 1.16 and later print the version before any option can be set, and the output of ``--json`` would begin with
    this line.
    """
    try:
        sys.stdout.flush()
        kept = os.dup(1)
    except (AttributeError, OSError, ValueError):  # there is no standard output
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        import_module("highspy").Highs()
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def _status(found: qpsolvers.Solution) -> str:
    extras = found.extras
    status = extras.get("status", getattr(extras.get("info"), "status", None))
    if status is None:
        return "found" if found.found else "not found"
    return str(getattr(status, "name", status)).strip().lower()


def _iterations(extras: dict[str, Any]) -> int | None:
    """Read the number of iterations, under the name that the solver uses."""
    info = extras.get("info")
    for value in (getattr(info, "iter", None), extras.get("iter"), extras.get("iterations")):
        if value is not None:
            return int(np.ravel(value)[0])
    return None
