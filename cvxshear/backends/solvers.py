"""The backends: the closed form, the solvers of qpsolvers and cvxpy, and "auto".

The table of solvers is read without importing a solver; importing all of them takes seconds.

"auto" asks the solvers in the order of the table of `docs/speed.md` (python -m tests.studies solvers). A scaled
program has the identity as its Hessian and few active inequalities, for which a dual active-set method needs few steps:
DAQP takes a half to an eighth of the time of Clarabel for 3 to 100 unknowns. If the data leave a direction open, the
Hessian is singular, and the interior-point method comes first. Every answer is certified; if one fails, the next solver
is asked.
"""

from __future__ import annotations

import os
import sys
import time
import tomllib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module, metadata, resources, util
from typing import TYPE_CHECKING, Any

import numpy as np

from cvxshear.backends.base import CONIC, Backend
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.priors import Constraints
from cvxshear.programs import LeastSquares, NamedConstraints, Solution
from cvxshear.programs.certificate import Assembled
from cvxshear.programs.constraints import refuse_contradictions
from cvxshear.util import checks
from cvxshear.util.errors import InputError, NoSolutionError, UnsuitableError
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


#: Seconds after which a solver is stopped. Programs of this size that take longer do not end (HiGHS has cycled).
TIME_LIMIT = 60.0

#: Table of the solvers; the file explains its keys and numbers.
_TABLES: dict[str, dict[str, Any]] = tomllib.loads(
    resources.files("cvxshear.backends").joinpath("solvers.toml").read_text(encoding="utf-8")
)

#: Solvers of qpsolvers that pip can install, under their names there.
THROUGH_QPSOLVERS = tuple(
    Solver(name, table.get("module", name), table.get("module", name).replace("_", "-"))
    for name, table in _TABLES.items()
)

#: Solvers that cvxpy brings along and that take a quadratic objective.
THROUGH_CVXPY = tuple(Solver(f"cvxpy-{name}", name, name, "cvxpy") for name in _TABLES if "cvxpy" in _TABLES[name])


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
    accuracies : tuple of str
        Names of its options for the requested accuracy.
    time_limit : str
        Name of its option for the time limit; empty if it has none.
    """

    through = "qpsolvers"

    def __init__(self, solver: str, **options: Any) -> None:
        self.solver = solver
        plain = solver.lower()
        self.name = plain if self.through == "qpsolvers" else f"{self.through}-{plain}"
        table = _TABLES.get(plain, {})
        accuracies, further = table.get("tolerances", {}), table.get(self.through, {})
        self.accuracies, self.time_limit = tuple(accuracies), table.get("time_limit", "")
        limit = {self.time_limit: TIME_LIMIT} if self.time_limit else {}
        self.options = {**accuracies, **table.get("options", {}), **limit, **further, **options}
        self.scale = float(table.get("scale", 1.0))

    @property
    def tolerance(self) -> float | None:
        given = [float(self.options[name]) for name in self.accuracies if name in self.options]
        return max(given, default=None)

    def with_tolerance(self, tolerance: float) -> CalledSolver:
        return self.with_options(dict.fromkeys(self.accuracies, tolerance))

    def with_options(self, options: Mapping[str, Any]) -> CalledSolver:
        return type(self)(self.solver, **{**self.options, **options}) if options else self

    def answer_conic(self, problem: Canonical) -> Answer:
        """Solve through cvxpy, which turns least squares with matrix inequalities into the solver's cones."""
        if self.solver.lower() not in CONIC:
            return super().answer_conic(problem)
        return Cvxpy(self.solver.upper(), **self.options).answer(problem)

    def unsolved(self, status: str, began: float) -> NoSolutionError:
        """Make the error of a solver without a solution: the time limit, or the solver's own message."""
        limit = self.options.get(self.time_limit)
        if limit is not None and time.perf_counter() - began >= limit:
            return NoSolutionError(self.name, f"stopped at its time limit of {limit:g} s (its status: {status})")
        return NoSolutionError(self.name, f"no solution found (its status: {status})")

    def answered(self, problem: Canonical, found: Sequence[Any], status: str, iterations: int | None) -> Answer:
        """Convert a solution of `Canonical.stated`, a sum of squares, to one of half the sum in the usual scale.

        Parameters
        ----------
        problem : Canonical
        found : sequence of three array_like
            The unknowns, and the multipliers of equalities and inequalities; None for no multipliers.
        """
        z, *duals = found
        y, w = (
            np.zeros(len(side)) if dual is None or not len(side) else np.atleast_1d(dual) / (2.0 * self.scale)
            for dual, side in zip(duals, (problem.e, problem.f), strict=True)
        )
        return Answer(np.asarray(z) / self.scale, y, w, status, iterations)


class Qpsolvers(CalledSolver):
    """One solver of qpsolvers, under its name there."""

    def answer(self, problem: Canonical) -> Answer:
        # Most of what this library does needs no solver.
        import qpsolvers  # noqa: PLC0415 - imports every solver that is installed

        if self.name == "highs":
            _hear_version_of_highs()
        began = time.perf_counter()
        try:
            with warnings.catch_warnings():
                # A solver's warning (an inaccurate solution, an iteration limit) is in `found`, or the certificate
                # measures it. Some solvers take sparse matrices, and qpsolvers warns that it converts them.
                warnings.simplefilter("ignore")
                stated = problem.stated(self.scale).to_qpsolvers()
                found = qpsolvers.solve_problem(stated, self.name, **self.options)
        except (qpsolvers.QPError, ValueError, ArithmeticError) as error:
            raise NoSolutionError(self.name, str(error) or type(error).__name__) from error
        status = _status(found)
        if not found.found or found.x is None:
            raise self.unsolved(status, began)
        return self.answered(problem, (found.x, found.y, found.z), status, _iterations(found.extras))


class Cvxpy(CalledSolver):
    """A solver reached through cvxpy, named cvxpy-clarabel and so on.

    Parameters
    ----------
    solver : str
        Name of the solver in cvxpy.
    **options
        Options of the solver, in addition to the accurate settings of `solvers.toml`.
    """

    through = "cvxpy"

    def answer(self, problem: Canonical) -> Answer:
        import cvxpy  # noqa: PLC0415 - takes a second to import

        stated, z = problem.stated(self.scale).to_cvxpy()
        if (len(problem.f) or problem.lmi) and not problem.singular:
            # C is the identity: without the constant |q|^2, cvxpy needs no further unknowns for z - q. Where there are
            # equalities alone, or nothing, SCS answers better with them.
            objective = cvxpy.sum_squares(z) - 2.0 * self.scale * problem.q @ z  # type: ignore[attr-defined]  # untyped
            stated = cvxpy.Problem(cvxpy.Minimize(objective), stated.constraints)
        began = time.perf_counter()
        try:
            with warnings.catch_warnings():
                # The warning "Solution may be inaccurate" is also in the status, which is checked below.
                warnings.simplefilter("ignore")
                stated.solve(solver=self.solver, **self.options)  # type: ignore[no-untyped-call]  # cvxpy's has no annotations
        except cvxpy.SolverError as error:
            raise NoSolutionError(self.name, str(error)) from error
        status = str(stated.status)
        # The certificate judges what a conic solver calls inaccurate; a quadratic program has better solvers.
        enough = (cvxpy.OPTIMAL, cvxpy.OPTIMAL_INACCURATE) if problem.lmi else (cvxpy.OPTIMAL,)
        if status not in enough or z.value is None:
            raise self.unsolved(status, began)
        duals = iter(constraint.dual_value for constraint in stated.constraints)
        found = (z.value, *(next(duals) if len(side) else None for side in (problem.e, problem.f)))
        answer = self.answered(problem, found, status, stated.solver_stats.num_iters)
        return replace(answer, matrices=tuple(np.asarray(dual) / (2.0 * self.scale) for dual in duals))


@cache
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


DEFINITE = ("daqp", "clarabel")
#: Order of the general solvers for "auto", see above; Clarabel is always installed.
SEMIDEFINITE = ("clarabel", "daqp")


class Kkt(Backend):
    """minimize |C z - q|^2 subject to E z = e, in closed form: the solution of Eq. 14 without its normal matrix.

    After the factorization of the rows, C is the identity, and the solution is the nearest point to q on a plane. This
    is the generalized QR factorization of LAPACK's xGGLSE; `canonical` does the first half.

    Inequalities are checked afterwards: a solution that satisfies all of them is also the solution of the program with
    them, with zero multipliers. If the solution violates one, this backend refuses.
    """

    name = "kkt"

    def answer_all(self, problem: Canonical) -> Answer:
        return self.answer(problem)

    def answer(self, problem: Canonical) -> Answer:
        if problem.singular:
            raise NoSolutionError(self.name, "the data and the equalities do not determine every unknown")
        z, y = problem.nearest()
        if np.any(problem.violated(z)):
            raise UnsuitableError(
                "backend kkt: a bound or another inequality is active at the solution, and the closed form takes "
                "equalities only; choose another backend, clarabel for one"
            )
        return Answer(z, y, np.zeros(len(problem.f)), "closed form", 1)


class Auto(Backend):
    """`closed_form` if no inequality is active, otherwise the first general solver that succeeds.

    Parameters
    ----------
    closed_form : Backend
    definite, singular : sequence of Backend
        General solvers in the order in which they are asked, for programs whose data determine every unknown, and
        for those whose data do not.
    """

    name = "auto"

    def __init__(self, closed_form: Backend, definite: Sequence[Backend], singular: Sequence[Backend]) -> None:
        self._closed_form = closed_form
        self._definite = tuple(definite)
        self._singular = tuple(singular)

    def answer(self, problem: Canonical) -> Answer:
        """Solve by the closed form; `certified` asks the other backends, since which answer is right shows there."""
        return self._closed_form.answer(problem)

    def certified(self, program: Assembled, problem: Canonical, *, bounded: bool = True) -> Solution:
        try:
            found = self._closed_form.certified(program, problem, bounded=bounded)
            return self._chosen(found, "no inequality is active")
        except UnsuitableError:
            why = "an inequality is active"
        except NoSolutionError:
            if not len(problem.F):
                raise
            why = "the closed form fails"
        general = self._singular if problem.singular else self._definite
        return self._first(general, lambda each: each.certified(program, problem, bounded=bounded), why)

    def conic(self, program: Assembled, problem: Canonical) -> Solution:
        able = [_installed()[name] for name in CONIC if name in _installed()]
        return self._first(able, lambda each: each.conic(program, problem), "a matrix inequality is active")

    def _first(self, backends: Sequence[Backend], ask: Callable[[Backend], Solution], why: str) -> Solution:
        """Return the solution of the first backend that succeeds; if all fail, raise the first one's error."""
        failure = None
        for backend in backends:
            try:
                return self._chosen(ask(backend), why)
            except NoSolutionError as error:
                failure = failure or error
                why = f"{why}, and {backend.name} fails"
        raise failure or NoSolutionError(self.name, "there is no general solver")

    def _chosen(self, found: Solution, why: str) -> Solution:
        """Say which backend was chosen and why."""
        reason = f"auto chose {found.requested}: {why}" + (f"; {found.replaced}" if found.replaced else "")
        return replace(found, requested=self.name, replaced=reason)


_registered: dict[str, Backend] = {}


def register(backend: Backend) -> None:
    """Register a backend by its name; it replaces a backend of the same name."""
    if not isinstance(backend, Backend):
        raise InputError(f"a backend must be an instance of cvxshear.backends.Backend, not {checks.shown(backend)}")
    _registered[checks.text(getattr(backend, "name", None), "name of a backend")] = backend


@cache
def _installed() -> dict[str, Backend]:
    """List the closed form, the installed solvers of qpsolvers and those of cvxpy."""
    found: list[Backend] = [Kkt(), *(Qpsolvers(solver.name) for solver in THROUGH_QPSOLVERS if solver.installed)]
    found += [Cvxpy(solver.module.upper()) for solver in THROUGH_CVXPY if solver.installed]
    return {backend.name: backend for backend in found}


@cache
def _auto() -> Auto:
    """List the closed form, then the installed solvers of `DEFINITE` or `SEMIDEFINITE`."""
    installed = _installed()
    orders = [[installed[name] for name in names if name in installed] for names in (DEFINITE, SEMIDEFINITE)]
    return Auto(installed["kkt"], *orders)


def available() -> list[str]:
    """Names of the backends that can be used here, the closed form first."""
    return list({**_installed(), **_registered})


def solve(program: LeastSquares, backend: str | Backend, options: Mapping[str, Any]) -> Solution:
    """Solve a program with a backend and options of its solver, see `LeastSquares.solve`."""
    rows, columns, *_ = *np.shape(program.R), 0, 0
    needed = {"R": (rows, columns), "s": (rows,)} | ({} if program.W is None else {"W": (rows,)})
    for name, shape in needed.items():
        value = getattr(program, name)
        if not isinstance(value, np.ndarray) or value.shape != shape or not np.all(np.isfinite(value)):
            raise InputError(f"{name} of a program must be an array of finite numbers, of the shape {shape}")
    statements = [
        NamedConstraints("A x = b", Constraints(A=program.A, b=program.b)),
        NamedConstraints("G x <= h", Constraints(G=program.G, h=program.h)),
        NamedConstraints("x >= lower", Constraints(lower=program.lower)),
        NamedConstraints("x <= upper", Constraints(upper=program.upper)),
    ]
    for each in statements:
        each.constraints.check(program.unknowns, each.name)
    try:
        return get(backend).with_options(options).solve(program)
    except NoSolutionError:
        refuse_contradictions(statements, program.unknowns)
        raise


def listed() -> list[Solver]:
    """List every installed backend, and every backend that pip can install."""
    solvers = {solver.name: solver for solver in (*THROUGH_QPSOLVERS, *THROUGH_CVXPY)}
    own = [Solver(name, "", "", "") for name in available() if name not in solvers]
    return own + sorted(solvers.values(), key=lambda solver: not solver.installed)


def get(backend: str | Backend) -> Backend:
    """Return the backend of this name; "auto" is the closed form, or a general solver if a bound is active.

    Parameters
    ----------
    backend : str or Backend
        A backend object is returned unchanged.

    Raises
    ------
    InputError
        If no backend of this name is installed; the message lists the installed ones.
    """
    if isinstance(backend, Backend):
        return backend
    known = {**_installed(), **_registered}
    if isinstance(backend, str) and backend in known:
        return known[backend]
    if backend == "auto":
        return _auto()
    names = ["auto", *known]
    hint = checks.near(backend, names, 0.5)
    raise InputError(f"no backend named {backend!r} is installed here{hint} (there are {', '.join(names)})")
