"""The frame in one tested state with effects in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Placed
from cvxshear.effects.state import STAGES, State
from cvxshear.measurement.experiment import Experiment, Tested
from cvxshear.model.shear import ShearSystem, System, mass_matrix, shear_system, stiffness_matrix
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Floats

MOST_BYTES = 1e9
"""Of the derivatives of one state's matrices, where effects act on them."""


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
    acting = [(placed, own) for placed, own in slices(effects, 2 * n) if placed.acts_on(tested)]
    state = State(
        experiment=experiment,
        tested=tested,
        frame_stiffness=stiffness,
        story_stiffness=stiffness,
        d_story_stiffness=np.concatenate([np.zeros((n, n)), np.eye(n), np.zeros((size - 2 * n, n))]),
        system=_system(mass + tested.added_mass, stiffness, size, dense=bool(acting)),
        gain=np.ones(n),
        d_gain=np.zeros((size, n)),
    )
    for placed, own in sorted(acting, key=lambda item: STAGES.index(item[0].effect.stage)):
        state = placed.effect.apply(state, placed.place, theta[own], own)
    return state


def _system(mass: Floats, stiffness: Floats, size: int, *, dense: bool) -> System:
    """The shear frame with derivatives by all parameters; as whole matrices where effects are to act on them.

    Raises
    ------
    UnsuitableError
        Where those matrices would not fit into memory, before any of them is made.
    """
    n = len(mass)
    if not dense:
        return ShearSystem(mass_matrix(mass), stiffness_matrix(stiffness), size)
    if 2 * size * n * n * 8 > MOST_BYTES:
        raise UnsuitableError(
            f"effects in a frame of {n} stories need {2 * size * n * n * 8 / 1e9:.1f} GB for derivatives; up to "
            f"{int((MOST_BYTES / 32) ** (1 / 3))} stories fit into {MOST_BYTES / 1e9:g} GB: join stories, or identify "
            "the frame without effects"
        )
    plain = shear_system(mass, stiffness)
    extra = np.zeros((size - 2 * n, n, n))
    return System(plain.M, plain.K, np.concatenate([plain.dM, extra]), np.concatenate([plain.dK, extra]))


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
