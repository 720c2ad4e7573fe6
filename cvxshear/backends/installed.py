"""Which backends there are: the closed form, and what is installed of qpsolvers' and cvxpy's solvers."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from functools import cache

from cvxshear.backends.base import Backend
from cvxshear.backends.closed_form import Auto, Kkt
from cvxshear.backends.qpsolvers_backend import Qpsolvers
from cvxshear.backends.solvers import THROUGH_CVXPY, THROUGH_QPSOLVERS
from cvxshear.util.errors import InputError
from cvxshear.util.results import InJson

DEFINITE = ("daqp", "clarabel")
SEMIDEFINITE = ("clarabel", "daqp")
"""General solvers in the order in which "auto" asks them; Clarabel is always installed. See `closed_form` for why."""

_registered: dict[str, Backend] = {}


def register(backend: Backend) -> None:
    """Make a backend known by its name; one of the same name is replaced."""
    _registered[backend.name] = backend


@cache
def _direct() -> dict[str, Backend]:
    """List the closed form, and what qpsolvers calls."""
    backends: list[Backend] = [Kkt(), *(Qpsolvers(solver.name) for solver in THROUGH_QPSOLVERS if solver.installed)]
    return {backend.name: backend for backend in backends}


@cache
def _through_cvxpy(name: str) -> Backend:
    # cvxpy takes a second to import, so it is, only when one of its backends is asked for.
    from cvxshear.backends.cvxpy_backend import Cvxpy  # noqa: PLC0415

    return Cvxpy(name.removeprefix("cvxpy-").upper())


@cache
def _auto() -> Auto:
    """List the closed form, then `DEFINITE` or `SEMIDEFINITE` as far as they are installed."""
    installed = _direct()
    orders = [[installed[name] for name in names if name in installed] for names in (DEFINITE, SEMIDEFINITE)]
    return Auto(installed["kkt"], *orders)


def available() -> list[str]:
    """Names of the backends that can be used here, the closed form first."""
    through_cvxpy = [solver.name for solver in THROUGH_CVXPY if solver.installed]
    return [*_direct(), *through_cvxpy, *(name for name in _registered if name not in _direct())]


@dataclass(frozen=True)
class ListedBackend(InJson):
    """A backend that is there, or that could be.

    Parameters
    ----------
    name : str
    solver : str
        Name of the package that solves; empty for a backend of this library or of the caller.
    through : str
        The package that calls it; empty where there is none.
    installed : bool
    version : str or None
        Of the solver; None where it is not installed or does not tell.
    how_to_get : str
        The command that installs it; empty where it is.
    """

    name: str
    solver: str
    through: str
    installed: bool
    version: str | None
    how_to_get: str


def listed() -> list[ListedBackend]:
    """Every backend that is there, and every one that pip could bring."""
    solvers = {solver.name: solver for solver in (*THROUGH_QPSOLVERS, *THROUGH_CVXPY)}
    own = [ListedBackend(name, "", "", True, None, "") for name in available() if name not in solvers]
    return own + [
        ListedBackend(
            solver.name, solver.package, solver.through, solver.installed, solver.version,
            "" if solver.installed else solver.how_to_get,
        )
        for solver in sorted(solvers.values(), key=lambda solver: not solver.installed)
    ]  # fmt: skip


def get(backend: str | Backend) -> Backend:
    """Return the backend of this name; "auto" is the closed form, and a general solver where a bound is active.

    Parameters
    ----------
    backend : str or Backend
        A backend itself is handed back.

    Raises
    ------
    InputError
        Where none of that name is installed; the message lists those that are.
    """
    if isinstance(backend, Backend):
        return backend
    if backend in _registered:
        return _registered[backend]
    if backend in _direct():
        return _direct()[backend]
    if backend == "auto":
        return _auto()
    names = ["auto", *available()]
    if backend in names:
        return _through_cvxpy(backend)
    near = difflib.get_close_matches(backend, names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise InputError(f"no backend named {backend!r} is installed here{hint} (there are {', '.join(names)})")
