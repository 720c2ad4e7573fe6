"""Every solver that the qpsolvers package finds installed, under its name there."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import qpsolvers
from scipy import sparse

from cvxshear.backends.base import Backend
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.errors import NoSolutionError

ACCURATE: dict[str, dict[str, Any]] = {
    "clarabel": {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12},
    "daqp": {"primal_tol": 1e-11, "dual_tol": 1e-11},
    # HiGHS adds this multiple of the identity to every Hessian; ours has eigenvalues of one and needs none.
    "highs": {
        "primal_feasibility_tolerance": 1e-10,
        "dual_feasibility_tolerance": 1e-10,
        "qp_regularization_value": 0.0,
    },
    "osqp": {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 200_000},
    "piqp": {"eps_abs": 1e-12, "eps_rel": 1e-12, "eps_duality_gap_abs": 1e-12, "eps_duality_gap_rel": 1e-12},
    "proxqp": {"eps_abs": 1e-11, "eps_rel": 0.0},
    "scs": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 200_000},
}  # fmt: skip
"""Accuracy settings a solver, chosen so that masses and stiffnesses agree with the closed form within 1e-6."""

MAGNIFIED: dict[str, float] = {"highs": 1e4}
"""Factor of the unknowns and the right sides. HiGHS takes a reduced gradient of some 1e-6 for none, whatever its
tolerances; on greater numbers that is less."""


class Qpsolvers(Backend):
    """One solver of qpsolvers.

    Parameters
    ----------
    name : str
        As qpsolvers calls it.
    options : dict, optional
        The solver's own, in place of `ACCURATE`.
    """

    def __init__(self, name: str, options: dict[str, Any] | None = None) -> None:
        self.name = name
        self.options = ACCURATE.get(name, {}) if options is None else options
        self._scale = MAGNIFIED.get(name, 1.0)

    def answer(self, problem: Canonical) -> Answer:
        stated = self._stated(problem)
        # Solvers that cannot begin at a point pass over it.
        scale = self._scale
        start = None if problem.start is None else scale * problem.start.z
        try:
            with warnings.catch_warnings():
                # What a solver warns about (an inaccurate solution, an iteration limit) is either told by `found`
                # or measured by the certificate.
                warnings.simplefilter("ignore")
                found = qpsolvers.solve_problem(stated, self.name, initvals=start, **self.options)
        except (qpsolvers.QPError, ValueError, ArithmeticError) as error:
            raise NoSolutionError(self.name, str(error) or type(error).__name__) from error
        status = _status(found)
        if not found.found or found.x is None:
            raise NoSolutionError(self.name, f"no solution found (its status: {status})")
        y = np.zeros(len(problem.e)) if found.y is None or not len(problem.e) else np.asarray(found.y)
        w = np.zeros(len(problem.f)) if found.z is None or not len(problem.f) else np.asarray(found.z)
        return Answer(np.asarray(found.x) / scale, y / scale, w / scale, status, _iterations(found.extras))

    def _stated(self, problem: Canonical) -> qpsolvers.Problem:
        """The problem in the solver's preferred matrix format: z'C'C z / 2 - (C'q)'z."""
        scale = self._scale
        stored = np.asarray if self.name in qpsolvers.dense_solvers else sparse.csc_matrix
        return qpsolvers.Problem(
            stored(problem.C.T @ problem.C),
            -problem.C.T @ (scale * problem.q),
            stored(problem.F) if len(problem.f) else None,
            scale * problem.f if len(problem.f) else None,
            stored(problem.E) if len(problem.e) else None,
            scale * problem.e if len(problem.e) else None,
        )


def _status(found: qpsolvers.Solution) -> str:
    extras = found.extras
    status = extras.get("status", getattr(extras.get("info"), "status", None))
    if status is None:
        return "found" if found.found else "not found"
    return str(getattr(status, "name", status)).strip().lower()


def _iterations(extras: dict[str, Any]) -> int | None:
    """The number of iterations, under whichever name the solver reports it."""
    info = extras.get("info")
    for value in (getattr(info, "iter", None), extras.get("iter"), extras.get("iterations")):
        if value is not None:
            return int(np.ravel(value)[0])
    return None
