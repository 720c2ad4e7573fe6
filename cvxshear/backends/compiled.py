"""A cvxpy problem compiled once for its shape, and solved again with other numbers.

What a compiled problem hands to its solver (`Problem.get_problem_data`) are arrays in which every number of the
parameters stands somewhere, up to its sign. Where it stands is found once, from parameters that are all different.
To solve again the numbers are written there: cvxpy's own way of doing so forms the arrays anew by sparse products,
which at these sizes takes longer than the solver does.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import cvxpy as cp
import numpy as np
from scipy import sparse

from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Floats, Ints

FIRST_MARK = 1001.0
"""The parameters are marked by integers from this one on, which no constant of a compiled problem is."""


@dataclass(frozen=True)
class Found:
    """What the solver of a compiled problem said.

    Parameters
    ----------
    status : str
        cvxpy's word.
    z : ndarray, shape (n,)
        Empty where there is none.
    duals : dict
        Multipliers by the name of the constraint.
    iterations : int or None
    """

    status: str
    z: Floats
    duals: dict[str, Floats]
    iterations: int | None


@dataclass(frozen=True, eq=False)
class Parametrised:
    """A problem of one shape, its numbers left open.

    Parameters
    ----------
    problem : cvxpy.Problem
        By cvxpy's rules for parametrised problems (DPP).
    z : cvxpy.Variable
    parameters : dict
        By name.
    constraints : dict
        By name, those whose multipliers are asked for.
    """

    problem: cp.Problem
    z: cp.Variable
    parameters: Mapping[str, cp.Parameter]
    constraints: Mapping[str, cp.Constraint]


@dataclass(frozen=True, eq=False)
class _Filled:
    """An array of the solver's data, and which parameter numbers stand where in it.

    Parameters
    ----------
    template : ndarray or sparse matrix
    at, number : ndarray of int
        Entry `at` (of the stored ones, if sparse) is `sign` times this parameter number.
    sign : ndarray
    """

    template: Any
    at: Ints
    number: Ints
    sign: Floats

    def filled(self, numbers: Floats) -> Any:
        """A new array: solvers that keep the last one compare it to the next."""
        values = _stored(self.template).copy()
        values[self.at] = self.sign * numbers[self.number]
        if isinstance(self.template, np.ndarray):
            return values
        result = copy.copy(self.template)
        result.data = values
        return result


class Compiled:
    """A problem ready to be solved with any numbers.

    Parameters
    ----------
    of : Parametrised
    solver : str
        As cvxpy calls it.
    options : dict
        The solver's own.

    Raises
    ------
    UnsuitableError
        Where this version of cvxpy changes the parameters on their way to the solver.
    """

    def __init__(self, of: Parametrised, solver: str, options: Mapping[str, Any]) -> None:
        self._of = of
        self._options = dict(options)
        self._order = list(of.parameters)
        mark = FIRST_MARK
        for name in self._order:
            parameter = of.parameters[name]
            parameter.value = np.arange(mark, mark + parameter.size).reshape(parameter.shape, order="F")
            mark += parameter.size
        data, self._chain, self._inverse = of.problem.get_problem_data(
            solver, enforce_dpp=True, solver_opts=dict(options)
        )
        self._data = data
        self._places = dict(_places(data, int(mark - FIRST_MARK)))

    def solve(self, numbers: Mapping[str, Floats], *, warm: bool = False) -> Found:
        """Solve with these numbers.

        Parameters
        ----------
        numbers : mapping
            A value for every parameter, by name.
        warm : bool, optional
            Let the solver begin where it ended the last time, if it can.

        Raises
        ------
        cvxpy.SolverError
            Where the solver failed.
        """
        flat = np.concatenate([np.ravel(numbers[name], order="F") for name in self._order])
        data = {**self._data, **{key: place.filled(flat) for key, place in self._places.items()}}
        raw = self._chain.solve_via_data(self._of.problem, data, warm_start=warm, solver_opts=dict(self._options))
        found = self._chain.invert(raw, self._inverse)
        z = found.primal_vars.get(self._of.z.id)
        return Found(
            str(found.status),
            np.zeros(0) if z is None else np.asarray(z),
            {
                name: np.atleast_1d(found.dual_vars[each.id])
                for name, each in self._of.constraints.items()
                if each.id in found.dual_vars
            },
            found.attr.get(cp.settings.NUM_ITERS),
        )


def _stored(array: Any) -> Floats:
    """The numbers of an array, those stored if it is sparse."""
    return array if isinstance(array, np.ndarray) else np.asarray(array.data)


def _places(data: Mapping[str, Any], count: int) -> Iterator[tuple[str, _Filled]]:
    """Where the marked parameter numbers stand in the arrays of a solver's data."""
    seen = np.zeros(count, dtype=bool)
    for key, array in data.items():
        if not (sparse.issparse(array) or isinstance(array, np.ndarray)):
            continue
        values = _stored(array)
        number = np.rint(np.abs(values) - FIRST_MARK).astype(int)
        at = np.flatnonzero((number >= 0) & (number < count) & (np.abs(values) == number + FIRST_MARK))
        seen[number[at]] = True
        yield key, _Filled(array, at, number[at], np.sign(values[at]))
    if not np.all(seen):
        raise UnsuitableError(
            f"cvxpy {version('cvxpy')} does not hand the parameters of a problem to its solver as they are; choose a "
            "backend that is not cvxpy's, clarabel for one"
        )
