"""Accuracy against the number of sensors."""

from __future__ import annotations

import numpy as np

from cvxshear.planning.choice import choose
from cvxshear.planning.criteria import criterion_named
from cvxshear.planning.results import Plan

MOST_POINTS = 10


def accuracy_curve(plan: Plan) -> list[tuple[int, float, float]]:
    """Number of sensors, the criterion of the best choice found, and what no choice is below; ascending.

    Parameters
    ----------
    plan : Plan
    """
    model, by = plan.model, criterion_named(plan.criterion)
    n = model.design.stories
    tests = [model.expected(masses) for masses in plan.tests]
    spread = np.unique(np.linspace(1, n, min(n, MOST_POINTS)).round().astype(int))
    points = []
    for count in sorted({*spread.tolist(), len(plan.sensors)}):
        found = choose(model.sensors(tests, count), count, by, plan.solver)
        points.append((count, found.value, found.bound))
    return points
