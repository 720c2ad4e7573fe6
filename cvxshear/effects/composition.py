"""The frame in one tested state with effects in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import STAGES, Placed, State
from cvxshear.experiment import Experiment, Tested
from cvxshear.frame import System, mass_matrix, shear_system, stiffness_matrix
from cvxshear.typing import Floats


def compose(
    experiment: Experiment,
    tested: Tested,
    effects: Sequence[Placed],
    theta: Floats,
    *,
    derivatives: bool = True,
) -> State:
    """Matrices and sensor gains of one tested state, with derivatives by every parameter.

    Parameters
    ----------
    experiment : Experiment
    tested : Tested
    effects : sequence of Placed
    theta : ndarray, shape (P,)
        Floor masses without added mass (N), story stiffnesses (N), then the effects' parameters in order.
    derivatives : bool, optional
        Without them, and without effects in the model, matrices alone are made.

    Returns
    -------
    State
    """
    if not derivatives and not effects:
        return _plain(experiment, tested, theta)
    n, size = experiment.stories, len(theta)
    mass, stiffness = theta[:n], theta[n : 2 * n]
    plain = shear_system(mass + tested.added_mass, stiffness)
    extra = np.zeros((size - 2 * n, n, n))
    state = State(
        experiment=experiment,
        tested=tested,
        frame_stiffness=stiffness,
        story_stiffness=stiffness,
        d_story_stiffness=np.concatenate([np.zeros((n, n)), np.eye(n), np.zeros((size - 2 * n, n))]),
        system=System(plain.M, plain.K, np.concatenate([plain.dM, extra]), np.concatenate([plain.dK, extra])),
        gain=np.ones(n),
        d_gain=np.zeros((size, n)),
    )
    for placed, own in sorted(slices(effects, 2 * n), key=lambda item: STAGES.index(item[0].effect.stage)):
        if placed.acts_on(tested):
            state = placed.effect.apply(state, placed.place, theta[own], own)
    return state


def _plain(experiment: Experiment, tested: Tested, theta: Floats) -> State:
    """The shear frame of a tested state with derivatives of no rows: 2 N^3 numbers less."""
    n = experiment.stories
    mass, stiffness = theta[:n], theta[n : 2 * n]
    none = np.zeros((0, n, n))
    return State(
        experiment=experiment,
        tested=tested,
        frame_stiffness=stiffness,
        story_stiffness=stiffness,
        d_story_stiffness=np.zeros((0, n)),
        system=System(mass_matrix(mass + tested.added_mass), stiffness_matrix(stiffness), none, none),
        gain=np.ones(n),
        d_gain=np.zeros((0, n)),
    )


def slices(effects: Sequence[Placed], first: int) -> list[tuple[Placed, slice]]:
    """Each effect with the places of its parameters, counted from `first` on."""
    result = []
    for placed in effects:
        count = len(placed.effect.parameters)
        result.append((placed, slice(first, first + count)))
        first += count
    return result
