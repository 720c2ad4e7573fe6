"""Every solver that the qpsolvers package finds installed, under its name there."""

from __future__ import annotations

import time
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.solvers import CalledSolver
from cvxshear.util.errors import NoSolutionError

if TYPE_CHECKING:
    import qpsolvers

MAGNIFIED: dict[str, float] = {"highs": 1e4}
"""Factor on unknowns and right sides: HiGHS takes a reduced gradient of some 1e-6 for none, whatever its tolerances."""


class Qpsolvers(CalledSolver):
    """One solver of qpsolvers, under its name there."""

    def answer(self, problem: Canonical) -> Answer:
        # Most of what this library does needs no solver.
        import qpsolvers  # noqa: PLC0415 - imports every solver that is installed

        stated = self._stated(problem)
        # Solvers that cannot begin at a point pass over it.
        scale = MAGNIFIED.get(self.name, 1.0)
        start = None if problem.start is None else scale * problem.start.z
        began = time.perf_counter()
        try:
            with warnings.catch_warnings():
                # What a solver warns about (an inaccurate solution, an iteration limit) is either reported by `found`
                # or measured by the certificate.
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
    """Read the number of iterations, under whichever name the solver reports it."""
    info = extras.get("info")
    for value in (getattr(info, "iter", None), extras.get("iter"), extras.get("iterations")):
        if value is not None:
            return int(np.ravel(value)[0])
    return None
