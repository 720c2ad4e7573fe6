"""The solvers that backends are made of: what each is called where, how to get it, and which options it gets.

All of this is known without importing any of them, which takes seconds for all together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata, util
from typing import Any

from cvxshear.backends.base import TIME_LIMIT
from cvxshear.util.results import InJson


@dataclass(frozen=True)
class Solver(InJson):
    """A solver that qpsolvers or cvxpy can call; a backend of this library or of the caller has a name alone.

    Parameters
    ----------
    name : str
        Of the backend.
    module : str
        What Python imports.
    package : str
        What pip installs.
    through : str
        The package that calls it, "qpsolvers" or "cvxpy".
    """

    name: str
    module: str
    package: str
    through: str = "qpsolvers"

    json_keys = "name solver=package through installed version how_to_get"

    @property
    def missing(self) -> list[str]:
        """Packages that must be installed before it can be used."""
        needed = ((self.through, self.through), (self.package, self.module))
        return [package for package, module in needed if module and util.find_spec(module) is None]

    @property
    def installed(self) -> bool:
        """Whether it, and the package that calls it, are there to be imported."""
        return not self.missing

    @property
    def version(self) -> str | None:
        """Version of the solver; None where it is not installed, and where its package has none."""
        try:
            return metadata.version(self.package) if self.package else None
        except metadata.PackageNotFoundError:
            return None

    @property
    def how_to_get(self) -> str:
        """The command that installs it; empty where it is."""
        return f"pip install {' '.join(self.missing)}" if self.missing else ""


MODULES = {
    "copt": "coptpy", "gurobi": "gurobipy", "highs": "highspy", "jaxopt_osqp": "jaxopt", "proxqp": "proxsuite",
    "sip": "sip_qp_python",
}  # fmt: skip
"""Modules of the solvers that Python knows by another name than qpsolvers; pip has a - for each _."""

THROUGH_QPSOLVERS = tuple(
    Solver(name, MODULES.get(name, name), MODULES.get(name, name).replace("_", "-"))
    for name in (
        "clarabel", "copt", "cvxopt", "daqp", "ecos", "gurobi", "highs", "jaxopt_osqp", "kvxopt", "mosek", "osqp",
        "piqp", "proxqp", "pyqpmad", "qpalm", "qpax", "qtqp", "quadprog", "scs", "sip",
    )
)  # fmt: skip
"""Solvers of qpsolvers that pip can install, under their names there."""

THROUGH_CVXPY = tuple(Solver(f"cvxpy-{name}", name, name, "cvxpy") for name in ("clarabel", "osqp", "scs"))
"""Solvers that cvxpy brings along and that take a quadratic objective."""

TOLERANCES: dict[str, dict[str, float]] = {
    "clarabel": {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12},
    "daqp": {"primal_tol": 1e-11, "dual_tol": 1e-11},
    "highs": {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    "osqp": {"eps_abs": 1e-10, "eps_rel": 1e-10},
    "piqp": {"eps_abs": 1e-12, "eps_rel": 1e-12, "eps_duality_gap_abs": 1e-12, "eps_duality_gap_rel": 1e-12},
    "proxqp": {"eps_abs": 1e-11},
    "scs": {"eps_abs": 1e-9, "eps_rel": 1e-9},
}
"""Accuracies that each solver is asked for, chosen so that masses and stiffnesses agree with the closed form within
1e-6."""

TIME_LIMITS = {
    "clarabel": "time_limit",
    "daqp": "time_limit",
    "highs": "time_limit",
    "osqp": "time_limit",
    "scs": "time_limit_secs",
}
"""What each solver calls its limit on time. PIQP and ProxQP have one on iterations alone; quadprog has none, and ends
after finitely many steps."""

OTHER_OPTIONS: dict[str, dict[str, Any]] = {
    # HiGHS adds this multiple of the identity to every Hessian; ours has eigenvalues of one and needs none.
    "highs": {"qp_regularization_value": 0.0},
    "osqp": {"max_iter": 200_000},
    "piqp": {"max_iter": 1000},
    "proxqp": {"eps_rel": 0.0, "max_iter": 10_000},
    "scs": {"max_iters": 200_000},
}
"""Further options: iterations enough for the accuracy above, which the solvers' own limits are not, and no looser
accuracy beside it."""


def accurate(solver: str) -> dict[str, Any]:
    """All options of a solver.

    Parameters
    ----------
    solver : str
        As qpsolvers calls it.
    """
    limit = {TIME_LIMITS[solver]: TIME_LIMIT} if solver in TIME_LIMITS else {}
    return {**TOLERANCES.get(solver, {}), **OTHER_OPTIONS.get(solver, {}), **limit}


def loosest(solver: str, options: Mapping[str, Any]) -> float | None:
    """Find the loosest accuracy among a solver's options; None where they have none."""
    given = [float(options[name]) for name in TOLERANCES.get(solver, {}) if name in options]
    return max(given, default=None)


def with_tolerance(solver: str, options: Mapping[str, Any], tolerance: float) -> dict[str, Any]:
    """Replace the accuracy in a solver's options."""
    return {**options, **dict.fromkeys(TOLERANCES.get(solver, {}), tolerance)}


def why_not(solver: str, options: Mapping[str, Any], status: str, seconds: float) -> str:
    """Why a solver has no solution: its time was over, or what it says itself."""
    limit = options.get(TIME_LIMITS.get(solver, ""))
    if limit is not None and seconds >= limit:
        return f"stopped at its time limit of {limit:g} s (its status: {status})"
    return f"no solution found (its status: {status})"
