"""What solvers are told: how accurately to solve, and when to give up."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

TIME_LIMIT = 60.0
"""Seconds after which a solver that can be told so stops. What takes longer on programs of this size is not going to
end: HiGHS has been seen to cycle on one of 30 unknowns."""

TOLERANCES: dict[str, dict[str, float]] = {
    "clarabel": {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12},
    "daqp": {"primal_tol": 1e-11, "dual_tol": 1e-11},
    "highs": {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    "osqp": {"eps_abs": 1e-10, "eps_rel": 1e-10},
    "piqp": {"eps_abs": 1e-12, "eps_rel": 1e-12, "eps_duality_gap_abs": 1e-12, "eps_duality_gap_rel": 1e-12},
    "proxqp": {"eps_abs": 1e-11},
    "scs": {"eps_abs": 1e-9, "eps_rel": 1e-9},
}
"""Accuracies a solver, chosen so that masses and stiffnesses agree with the closed form within 1e-6."""

TIME_LIMITS = {
    "clarabel": "time_limit",
    "daqp": "time_limit",
    "highs": "time_limit",
    "osqp": "time_limit",
    "scs": "time_limit_secs",
}
"""What each solver calls its limit on time. PIQP and ProxQP have one on iterations alone; quadprog has none, and ends
after finitely many steps."""

OTHERS: dict[str, dict[str, Any]] = {
    # HiGHS adds this multiple of the identity to every Hessian; ours has eigenvalues of one and needs none.
    "highs": {"qp_regularization_value": 0.0},
    "osqp": {"max_iter": 200_000},
    "piqp": {"max_iter": 1000},
    "proxqp": {"eps_rel": 0.0, "max_iter": 10_000},
    "scs": {"max_iters": 200_000},
}


def accurate(solver: str) -> dict[str, Any]:
    """All options of a solver.

    Parameters
    ----------
    solver : str
        As qpsolvers calls it.
    """
    limit = {TIME_LIMITS[solver]: TIME_LIMIT} if solver in TIME_LIMITS else {}
    return {**TOLERANCES.get(solver, {}), **OTHERS.get(solver, {}), **limit}


def loosest(solver: str, options: Mapping[str, Any]) -> float | None:
    """The loosest accuracy among a solver's options; None where none is told."""
    told = [float(options[name]) for name in TOLERANCES.get(solver, {}) if name in options]
    return max(told, default=None)


def with_tolerance(solver: str, options: Mapping[str, Any], tolerance: float) -> dict[str, Any]:
    """The options with another accuracy."""
    return {**options, **dict.fromkeys(TOLERANCES.get(solver, {}), tolerance)}


def why_not(solver: str, options: Mapping[str, Any], status: str, seconds: float) -> str:
    """Why a solver has no solution: its time was over, or what it says itself."""
    limit = options.get(TIME_LIMITS.get(solver, ""))
    if limit is not None and seconds >= limit:
        return f"stopped at its time limit of {limit:g} s (its status: {status})"
    return f"no solution found (its status: {status})"
