"""Where the parameters of a fit may lie: positivity, declared masses, exact priors, the effects' bounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects import Placed
from cvxshear.effects.composition import slices
from cvxshear.experiment import Experiment
from cvxshear.identify.gauss_newton import Domain, embedded
from cvxshear.priors import Constraints
from cvxshear.programs.feasibility import Statement, refuse_contradictions
from cvxshear.programs.rows import statements
from cvxshear.typing import Floats


def spread(heavy: Sequence[Statement], stiff: Sequence[Statement], n: int, size: int) -> list[Statement]:
    """Statements about the masses and about the stiffnesses as statements about all parameters."""
    return [
        Statement(part.name, embedded(part.constraints, at, size))
        for parts, at in ((heavy, slice(0, n)), (stiff, slice(n, 2 * n)))
        for part in parts
    ]


def domain_of(experiment: Experiment, effects: Sequence[Placed], theta: Floats) -> Domain:
    """The domain of the parameters of a fit with these effects.

    Raises
    ------
    InfeasibleError
        Where declared masses and exact priors contradict each other.
    """
    n, size = experiment.stories, len(theta)
    heavy = statements(experiment.priors, "floor_mass", n, experiment.frame)
    stiff = statements(experiment.priors, "story_stiffness", n)
    refuse_contradictions(heavy, n)
    refuse_contradictions(stiff, n)
    parts = spread(heavy, stiff, n, size)
    for placed, own in slices(effects, 2 * n):
        parameters = placed.effect.parameters
        if placed.fixed:
            held = Constraints(A=np.eye(len(parameters)), b=np.array(placed.fixed))
            parts.append(Statement(f"{placed.label} as assumed", embedded(held, own, size)))
            continue
        bounds = Constraints(
            lower=np.array([item.lower for item in parameters]), upper=np.array([item.upper for item in parameters])
        )
        parts.append(Statement(f"bounds of {placed.label}", embedded(bounds, own, size)))
    return Domain(parts, np.where(theta == 0, 1.0, np.abs(theta)))
