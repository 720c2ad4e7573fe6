"""Which backends there are: the closed form, and what is installed of qpsolvers' and cvxpy's solvers."""

from __future__ import annotations

import difflib
from functools import cache

import qpsolvers

from cvxshear.backends.auto import Auto
from cvxshear.backends.base import Backend
from cvxshear.backends.kkt import Kkt
from cvxshear.backends.qpsolvers_backend import Qpsolvers
from cvxshear.errors import InputError

THROUGH_CVXPY = ("CLARABEL", "OSQP", "SCS")

DEFINITE = ("daqp", "clarabel")
SINGULAR = ("clarabel", "daqp")
"""General solvers in the order in which "auto" asks them; Clarabel is always installed. See `auto` for why."""

_registered: dict[str, Backend] = {}


def register(backend: Backend) -> None:
    """Make a backend known by its name; one of the same name is replaced."""
    _registered[backend.name] = backend


@cache
def _installed() -> dict[str, Backend]:
    backends: list[Backend] = [Kkt(), *(Qpsolvers(name) for name in sorted(qpsolvers.available_solvers))]
    return {backend.name: backend for backend in backends}


@cache
def _through_cvxpy() -> dict[str, Backend]:
    # cvxpy takes a second to import, so it is, only when one of its backends is asked for.
    import cvxpy as cp  # noqa: PLC0415

    from cvxshear.backends.cvxpy_backend import Cvxpy  # noqa: PLC0415

    installed = cp.installed_solvers()  # type: ignore[no-untyped-call]  # cvxpy leaves it untyped
    return {item.name: item for item in (Cvxpy(name) for name in THROUGH_CVXPY if name in installed)}


@cache
def _auto() -> Auto:
    """The closed form, then `DEFINITE` or `SINGULAR` as far as they are installed."""
    installed = _installed()
    definite, singular = ([installed[name] for name in names if name in installed] for names in (DEFINITE, SINGULAR))
    return Auto(installed["kkt"], definite, singular)


def available() -> list[str]:
    """Names of the backends that can be used here, the closed form first."""
    return [*_installed(), *_through_cvxpy(), *(name for name in _registered if name not in _installed())]


def get(backend: str | Backend) -> Backend:
    """The backend of this name; "auto" is the closed form, and a general solver where an inequality is active.

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
    if backend in _installed():
        return _installed()[backend]
    if backend == "auto":
        return _auto()
    if backend.startswith("cvxpy-") and backend in _through_cvxpy():
        return _through_cvxpy()[backend]
    names = ["auto", *available()]
    near = difflib.get_close_matches(backend, names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise InputError(f"no backend named {backend!r} is installed here{hint} (there are {', '.join(names)})")
