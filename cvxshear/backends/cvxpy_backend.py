"""Use cvxpy as a backend: one parametrised problem for each shape, compiled once and solved with different numbers."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.solvers import CalledSolver
from cvxshear.util.errors import NoSolutionError


@dataclass(frozen=True, eq=False)
class Parametrised:
    """A problem of one shape with its numbers as parameters.

    Parameters
    ----------
    problem : cvxpy.Problem
        By cvxpy's rules for parametrised problems (DPP): compiled at the first solve; later solves only insert numbers.
    z : cvxpy.Variable
    parameters : dict
        By name.
    constraints : dict
        By name, the constraints with required multipliers.
    """

    problem: cp.Problem
    z: cp.Variable
    parameters: Mapping[str, cp.Parameter]
    constraints: Mapping[str, cp.Constraint]


class Cvxpy(CalledSolver):
    """A solver reached through cvxpy, named cvxpy-clarabel and so on.

    Parameters
    ----------
    solver : str
        Name of the solver in cvxpy.
    **options
        Options of the solver, in addition to the accurate settings of `solvers.toml`.

    Notes
    -----
    Each shape is compiled once, with its numbers as parameters by cvxpy's rules for such programs (DPP), and solved
    again with new numbers. Rows 0 z <= 1 raise the number of inequalities to a power of two, so that few shapes occur.
    There is always a constraint: SCS refuses a problem without one.
    """

    through = "cvxpy"

    def __init__(self, solver: str, **options: Any) -> None:
        super().__init__(solver, **options)
        self.compiled: dict[tuple[int, int, int, bool], Parametrised] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the backend without its compiled problems."""
        return _made, (self.solver, self.options)

    def answer(self, problem: Canonical) -> Answer:
        inequalities = len(problem.f)
        padding = _padding(len(problem.e), inequalities)
        shape = (len(problem.q), len(problem.e), inequalities + padding, problem.singular)
        if shape not in self.compiled:
            self.compiled[shape] = parametrised(*shape)
        compiled = self.compiled[shape]
        F = np.concatenate([problem.F, np.zeros((padding, len(problem.q)))])
        numbers = {"q": problem.q, "C": problem.C, "E": problem.E, "e": problem.e, "F": F}
        numbers["f"] = np.concatenate([problem.f, np.ones(padding)])
        for name, parameter in compiled.parameters.items():
            parameter.value = numbers[name]
        began = time.perf_counter()
        try:
            with warnings.catch_warnings():
                # The warning "Solution may be inaccurate" is also in the status, which is checked below.
                warnings.simplefilter("ignore")
                compiled.problem.solve(  # type: ignore[no-untyped-call]  # cvxpy's has no annotations
                    solver=self.solver, enforce_dpp=True, warm_start=problem.start is not None, **self.options
                )
        except cp.SolverError as error:
            raise NoSolutionError(self.name, str(error)) from error
        status, z = str(compiled.problem.status), compiled.z.value
        if status != cp.OPTIMAL or z is None:
            raise self.unsolved(status, time.perf_counter() - began)
        given = (getattr(compiled.constraints.get(name), "dual_value", None) for name in ("E", "F"))
        y, w = (np.zeros(0) if value is None else np.atleast_1d(np.asarray(value, dtype=float)) for value in given)
        return Answer(np.asarray(z), y, w[:inequalities], status, compiled.problem.solver_stats.num_iters)


def _made(solver: str, options: dict[str, Any]) -> Cvxpy:
    return Cvxpy(solver, **options)


def _padding(equalities: int, inequalities: int) -> int:
    """Count the empty rows up to the next power of two; one row if there is no constraint."""
    if not inequalities:
        return 0 if equalities else 1
    return (1 << (inequalities - 1).bit_length()) - inequalities


def parametrised(unknowns: int, equalities: int, inequalities: int, singular: bool) -> Parametrised:
    """Build the problem of this shape: |C z - q|^2 / 2, or |z|^2 / 2 - q'z if C is the identity."""
    z = cp.Variable(unknowns)
    parameters = {"q": cp.Parameter(unknowns)}
    # cvxpy exports `sum_squares` in a way that type checkers do not see.
    if singular:
        parameters["C"] = cp.Parameter((unknowns, unknowns))
        objective = 0.5 * cp.sum_squares(parameters["C"] @ z - parameters["q"])  # type: ignore[attr-defined]
    else:
        # Without the constant the solver needs no further unknowns for z - q.
        objective = 0.5 * cp.sum_squares(z) - parameters["q"] @ z  # type: ignore[attr-defined]
    constraints: dict[str, cp.Constraint] = {}
    if equalities:
        parameters["E"], parameters["e"] = cp.Parameter((equalities, unknowns)), cp.Parameter(equalities)
        constraints["E"] = parameters["E"] @ z == parameters["e"]
    if inequalities:
        parameters["F"], parameters["f"] = cp.Parameter((inequalities, unknowns)), cp.Parameter(inequalities)
        constraints["F"] = parameters["F"] @ z <= parameters["f"]
    problem = cp.Problem(cp.Minimize(objective), list(constraints.values()))
    return Parametrised(problem, z, parameters, constraints)
