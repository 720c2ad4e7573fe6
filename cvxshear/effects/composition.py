"""The frame in one configuration with effects in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import STAGES, Placed, State
from cvxshear.experiment import Configuration, Experiment
from cvxshear.frame import System, shear_system
from cvxshear.typing import Floats


def compose(experiment: Experiment, configuration: Configuration, effects: Sequence[Placed], theta: Floats) -> State:
    """Matrices and sensor gains of one configuration, with derivatives by every parameter.

    Parameters
    ----------
    experiment : Experiment
    configuration : Configuration
    effects : sequence of Placed
    theta : ndarray, shape (P,)
        Floor masses without added mass (N), story stiffnesses (N), then the effects' parameters in order.

    Returns
    -------
    State
    """
    n, size = experiment.stories, len(theta)
    mass, stiffness = theta[:n], theta[n : 2 * n]
    plain = shear_system(mass + configuration.added_mass, stiffness)
    extra = np.zeros((size - 2 * n, n, n))
    state = State(
        experiment=experiment,
        configuration=configuration,
        frame_stiffness=stiffness,
        story_stiffness=stiffness,
        d_story_stiffness=np.concatenate([np.zeros((n, n)), np.eye(n), np.zeros((size - 2 * n, n))]),
        system=System(plain.M, plain.K, np.concatenate([plain.dM, extra]), np.concatenate([plain.dK, extra])),
        gain=np.ones(n),
        d_gain=np.zeros((size, n)),
    )
    for placed, own in sorted(slices(effects, 2 * n), key=lambda item: STAGES.index(item[0].effect.stage)):
        if placed.acts_on(configuration):
            state = placed.effect.apply(state, placed.place, theta[own], own)
    return state


def slices(effects: Sequence[Placed], first: int) -> list[tuple[Placed, slice]]:
    """Each effect with the places of its parameters, counted from `first` on."""
    result = []
    for placed in effects:
        count = len(placed.effect.parameters)
        result.append((placed, slice(first, first + count)))
        first += count
    return result
