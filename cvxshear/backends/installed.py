"""The backends: the closed form, the installed solvers of qpsolvers and cvxpy, and "auto".

"auto" asks the solvers in the order of the table of `docs/speed.md` (python -m tests.studies solvers). A scaled
program has the identity as its Hessian and few active inequalities, for which a dual active-set method needs few steps:
DAQP takes a half to an eighth of the time of Clarabel for 3 to 100 unknowns. If the data leave a direction open, the
Hessian is singular, and the interior-point method comes first. Every answer is certified; if one fails, the next solver
is asked.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from cvxshear.backends.base import Backend
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.solvers import THROUGH_CVXPY, THROUGH_QPSOLVERS, Cvxpy, Qpsolvers, Solver
from cvxshear.programs import LeastSquares, Solution
from cvxshear.programs.certificate import Assembled
from cvxshear.util import checks
from cvxshear.util.errors import InputError, NoSolutionError, UnsuitableError

DEFINITE = ("daqp", "clarabel")
SEMIDEFINITE = ("clarabel", "daqp")
"""Order of the general solvers for "auto", see above; Clarabel is always installed."""


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

    def certified(self, program: Assembled, problem: Canonical) -> Solution:
        try:
            return self._chosen(self._closed_form.certified(program, problem), "no inequality is active")
        except UnsuitableError:
            why = "an inequality is active"
        except NoSolutionError:
            if not len(problem.F):
                raise
            why = "the closed form fails"
        failure: NoSolutionError | None = None
        for backend in self._singular if problem.singular else self._definite:
            try:
                return self._chosen(backend.certified(program, problem), why)
            except NoSolutionError as error:
                failure = failure or error
                why = f"{why}, and {backend.name} fails"
        raise failure if failure is not None else NoSolutionError(self.name, "there is no general solver")

    def _chosen(self, found: Solution, why: str) -> Solution:
        """Say which backend was chosen and why."""
        reason = f"auto chose {found.requested}: {why}" + (f"; {found.replaced}" if found.replaced else "")
        return dataclasses.replace(found, requested=self.name, replaced=reason)


_registered: dict[str, Backend] = {}


def register(backend: Backend) -> None:
    """Register a backend by its name; it replaces a backend of the same name."""
    _registered[backend.name] = backend


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
    return get(backend).with_options(options).solve(program)


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
    if backend in known:
        return known[backend]
    if backend == "auto":
        return _auto()
    names = ["auto", *known]
    hint = checks.near(backend, names, 0.5)
    raise InputError(f"no backend named {backend!r} is installed here{hint} (there are {', '.join(names)})")
