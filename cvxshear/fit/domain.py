"""Where the parameters of a fit may lie: positivity, declared masses, exact priors, what the effects can be."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from cvxshear.effects import Placed
from cvxshear.effects.composition import slices
from cvxshear.fit.gauss_newton import Domain, embedded
from cvxshear.measurement.experiment import Experiment, Frame
from cvxshear.priors import Constraints
from cvxshear.programs.feasibility import NamedConstraints, refuse_contradictions
from cvxshear.programs.rows import statements
from cvxshear.util.typing import Floats

SMALLEST = 1e-3
"""Of the median at the start: a smaller mass or stiffness does not count as positive."""


def spread(
    on_mass: Sequence[NamedConstraints], on_stiffness: Sequence[NamedConstraints], n: int, size: int
) -> list[NamedConstraints]:
    """Statements about the masses and about the stiffnesses as statements about all parameters."""
    return [
        NamedConstraints(part.name, embedded(part.constraints, at, size))
        for parts, at in ((on_mass, slice(0, n)), (on_stiffness, slice(n, 2 * n)))
        for part in parts
    ]


def refuse_contradicting(experiment: Experiment) -> None:
    """Raise where the declared masses and the exact priors cannot all be true.

    Raises
    ------
    InfeasibleError
        Naming a smallest set that cannot.
    """
    n = experiment.stories
    refuse_contradictions(statements(experiment.priors, "floor_mass", n, _exact(experiment.frame, ())), n)
    refuse_contradictions(statements(experiment.priors, "story_stiffness", n), n)


def domain_of(experiment: Experiment, effects: Sequence[Placed], theta: Floats) -> Domain:
    """The domain of the parameters of a fit with these effects."""
    n, size = experiment.stories, len(theta)
    mass, stiffness = SMALLEST * np.median(theta[:n]), SMALLEST * np.median(theta[n : 2 * n])
    frame = _exact(experiment.frame, effects)
    parts = spread(
        statements(experiment.priors, "floor_mass", n, frame, least=mass),
        statements(experiment.priors, "story_stiffness", n, least=stiffness),
        n,
        size,
    )
    interval_std = np.full(size, np.inf)
    for placed, own in slices(effects, 2 * n):
        parameters = placed.effect.parameters
        if placed.fixed:
            held = Constraints(A=np.eye(len(parameters)), b=np.array(placed.fixed))
            parts.append(NamedConstraints(f"{placed.label} as assumed", embedded(held, own, size)))
            continue
        bounds = Constraints(
            lower=np.array([item.lower for item in parameters]), upper=np.array([item.upper for item in parameters])
        )
        interval_std[own] = [(item.upper - item.lower) / np.sqrt(12) for item in parameters]
        parts.append(NamedConstraints(f"bounds of {placed.label}", embedded(bounds, own, size)))
        limits = placed.effect.limits(experiment, placed.place)
        columns = np.concatenate([np.arange(2 * n), np.arange(own.start, own.stop)])
        parts.append(NamedConstraints(f"what {placed.label} can be", embedded(limits, columns, size)))
    return Domain(parts, np.where(theta == 0, 1.0, np.abs(theta)), interval_std)


def _exact(frame: Frame, effects: Sequence[Placed]) -> Frame:
    """The frame with a total mass only where it holds exactly."""
    released = any("total_mass" in placed.effect.releases for placed in effects)
    if frame.floor_masses is None and frame.total_mass is not None and (released or frame.total_mass_std is not None):
        return dataclasses.replace(frame, total_mass=None, total_mass_std=None, total_mass_placeholder=False)
    return frame
