"""cvxpy as a backend: one parametrised problem a shape, compiled once and re-solved."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from cvxshear.backends.base import Answer, Backend
from cvxshear.backends.canonical import Canonical
from cvxshear.errors import NoSolutionError

ACCURATE: dict[str, dict[str, Any]] = {
    "CLARABEL": {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12},
    "OSQP": {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 200_000},
    "SCS": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 200_000},
}
"""Accuracy settings a solver, as in `qpsolvers_backend`."""


@dataclass(eq=False)
class _Compiled:
    """A problem of one shape, its numbers left open as parameters."""

    problem: cp.Problem
    z: cp.Variable
    parameters: dict[str, cp.Parameter]
    constraints: dict[str, cp.Constraint]


class Cvxpy(Backend):
    """A solver reached through cvxpy, named cvxpy-clarabel and so on.

    Parameters
    ----------
    solver : str
        As cvxpy calls it.
    options : dict, optional
        The solver's own, in place of `ACCURATE`.

    Notes
    -----
    The problem is written so that cvxpy's rules for parametrised programs (DPP) hold: every number that
    changes from one solve to the next is a parameter, and the compilation is done once for each shape.
    """

    def __init__(self, solver: str, options: dict[str, Any] | None = None) -> None:
        self.name = f"cvxpy-{solver.lower()}"
        self._solver = solver
        self._options = ACCURATE.get(solver, {}) if options is None else options
        self._compiled: dict[tuple[int, int, int, bool], _Compiled] = {}

    def __reduce__(self) -> tuple[type[Cvxpy], tuple[str, dict[str, Any]]]:
        """To another process without what was compiled."""
        return type(self), (self._solver, self._options)

    def answer(self, problem: Canonical) -> Answer:
        shape = (len(problem.q), len(problem.e), len(problem.f), problem.singular)
        if shape not in self._compiled:
            self._compiled[shape] = _compile(*shape)
        compiled = self._compiled[shape]
        for name, parameter in compiled.parameters.items():
            parameter.value = getattr(problem, name)
        try:
            with warnings.catch_warnings():
                # "Solution may be inaccurate" is also the status, which is looked at below.
                warnings.simplefilter("ignore")
                compiled.problem.solve(  # type: ignore[no-untyped-call]
                    solver=self._solver, enforce_dpp=True, **self._options
                )
        except cp.SolverError as error:
            raise NoSolutionError(self.name, str(error)) from error
        status = str(compiled.problem.status)
        if status != cp.OPTIMAL or compiled.z.value is None:
            raise NoSolutionError(self.name, f"no solution found (its status: {status})")
        duals = {name: np.atleast_1d(item.dual_value) for name, item in compiled.constraints.items()}
        return Answer(
            np.asarray(compiled.z.value),
            duals.get("E", np.zeros(0)),
            duals.get("F", np.zeros(0)),
            status,
            compiled.problem.solver_stats.num_iters,
        )


def _compile(unknowns: int, equalities: int, inequalities: int, singular: bool) -> _Compiled:
    """The problem of this shape; |C z - q|^2 / 2 where C is not the identity, |z - q|^2 / 2 where it is."""
    z = cp.Variable(unknowns)
    parameters = {"q": cp.Parameter(unknowns)}
    fit = z
    if singular:
        parameters["C"] = cp.Parameter((unknowns, unknowns))
        fit = parameters["C"] @ z
    constraints: dict[str, cp.Constraint] = {}
    if equalities:
        parameters["E"], parameters["e"] = cp.Parameter((equalities, unknowns)), cp.Parameter(equalities)
        constraints["E"] = parameters["E"] @ z == parameters["e"]
    if inequalities:
        parameters["F"], parameters["f"] = cp.Parameter((inequalities, unknowns)), cp.Parameter(inequalities)
        constraints["F"] = parameters["F"] @ z <= parameters["f"]
    objective = 0.5 * cp.sum_squares(fit - parameters["q"])  # type: ignore[attr-defined]
    problem = cp.Problem(cp.Minimize(objective), list(constraints.values()))
    return _Compiled(problem, z, parameters, constraints)
