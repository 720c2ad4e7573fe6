"""Inequalities are handed to a solver as they turn out to matter.

A frame of N stories has at least N bounds, of which a few are active. Scaling makes every bound a full row: all of
them would cost an interior-point method N^3 operations an iteration, and those that are far from active would spoil
the scaling of a first-order method. So the solver gets the inequalities that the closed form without any violates,
or that an earlier solution was held by; then, with its answer, those that this one violates, until there are none.
The set only grows, so that it ends; an answer to fewer inequalities that keeps all of them is the answer to all.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.nearest import nearest
from cvxshear.util.typing import Bools

FAR = 1e3
"""An inequality whose slack at zero is greater than this, in scaled units, is moved in to it for a solve."""

Solver = Callable[[Canonical], Answer]


def answered(solver: Solver, problem: Canonical) -> Answer:
    """The answer to a scaled program, its multipliers zero for inequalities that did not matter.

    Parameters
    ----------
    solver : callable
        `Backend.answer`.
    problem : Canonical
    """
    if not len(problem.F):
        return solver(problem)
    if problem.singular:
        return _all_near(solver, problem)
    within = problem.violated(nearest(problem)[0])
    if problem.start is not None:
        within |= problem.start.w > 0
    iterations: int | None = 0
    while True:
        part = solver(problem.keeping(within))
        iterations = None if iterations is None or part.iterations is None else iterations + part.iterations
        missed = problem.violated(part.z) & ~within
        if not np.any(missed):
            return _padded(part, within, iterations)
        within |= missed


def _padded(part: Answer, within: Bools, iterations: int | None) -> Answer:
    w = np.zeros(len(within))
    w[within] = part.w
    return dataclasses.replace(part, w=w, iterations=iterations)


def _all_near(solver: Solver, problem: Canonical) -> Answer:
    """The answer with every inequality, where only they determine some direction; far ones are moved in."""
    limit = FAR
    while True:
        answer = solver(dataclasses.replace(problem, f=np.minimum(problem.f, limit)))
        far = problem.f > limit
        if not np.any(far & (problem.F @ answer.z > 0.5 * limit)):
            # Far inequalities are inactive: their multipliers are zero, not the rounding that a solver returns.
            return dataclasses.replace(answer, w=np.where(far, 0.0, answer.w))
        limit *= FAR
