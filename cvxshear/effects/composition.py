"""Composition of the frame in one tested state with its effects."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from cvxshear.effects.base import LocatedEffect
from cvxshear.effects.state import STAGES, State, summed
from cvxshear.measurement.experiment import Configuration, Experiment, Tested
from cvxshear.model import FrameSystem, Observation, mass_matrix, stiffness_matrix, transformation
from cvxshear.motions import THREE_MOTIONS, unit_derivatives
from cvxshear.util.errors import CvxshearError, FaultyEffectError, UnsuitableError
from cvxshear.util.typing import Floats

#: Largest memory of a fit, or of the derivatives of a state on which effects act, bytes.
MEMORY = 1e9


def compose(
    experiment: Experiment, tested: Tested, effects: Sequence[LocatedEffect], theta: Floats, *, derivatives: bool = True
) -> State:
    """Return matrices and observation of one tested state, with derivatives by every parameter.

    Parameters
    ----------
    experiment : Experiment
    tested : Tested
    effects : sequence of LocatedEffect
    theta : ndarray, shape (P,)
        Parameters of the floors without added mass, of the stories, then of the effects in order.
    derivatives : bool, optional
        If false, and if the model has no effects, return the matrices alone.

    Returns
    -------
    State
    """
    acting = [item for item in slices(effects, experiment.parameters) if item[0].acts_on(tested)]
    acting.sort(key=lambda item: STAGES.index(item[0].effect.stage))
    n, size = experiment.stories, len(theta) if derivatives or effects else 0
    mass, stiffness = theta[experiment.of_floors], theta[experiment.of_stories]
    if acting:
        _refuse_large(n, size, experiment.motions.count)
    system = FrameSystem(experiment.motions, *_matrices(experiment, tested, mass, stiffness), len(theta), slice(size))
    by_stiffness = np.eye(size, len(stiffness), -len(mass))
    if experiment.frame.turns:
        stiffness, by_stiffness = (_all_entries(each, n) for each in (stiffness, by_stiffness))
    rows = tested.sensor_rows if experiment.frame.turns and isinstance(tested, Configuration) else np.eye(n)
    state = State(
        experiment=experiment,
        tested=tested,
        floor_mass=mass,
        story_stiffness=stiffness,
        d_story_stiffness=by_stiffness,
        brace_stiffness=np.zeros(n),
        d_brace_stiffness=np.zeros((size, n)),
        column_stiffness=stiffness,
        d_column_stiffness=by_stiffness,
        joint_flexibility=np.zeros(n + 1),
        d_joint_flexibility=np.zeros((size, n + 1)),
        system=system,
        observation=Observation(rows),
    )
    frame = [item for item in acting if STAGES.index(item[0].effect.stage) < STAGES.index("flexibility")]
    for placed, own in frame:
        state = _applied(placed, state, theta, own)
    if frame:
        state = _assembled(state)
    for placed, own in acting[len(frame) :]:
        state = _applied(placed, state, theta, own)
    for name, array in state.system.arrays() if acting else ():
        if not np.isfinite(np.sum(array)):
            names = ", ".join(placed.label for placed, _ in acting)
            raise FaultyEffectError(f"{names}: {name} is not finite after apply()")
    return state


def _applied(placed: LocatedEffect, state: State, theta: Floats, own: slice) -> State:
    """Apply one effect; name the effect in an exception that its code raises."""
    try:
        found = placed.effect.apply(state, placed.place, theta[own], own)
    except (CvxshearError, np.linalg.LinAlgError):
        raise
    except Exception as error:
        # A user's effect may raise anything; its place belongs in the message.
        raise FaultyEffectError(f"{placed.label}: apply() raised {type(error).__name__}: {error}") from error
    if not isinstance(found, State):
        raise FaultyEffectError(f"{placed.label}: apply() returned a {type(found).__name__}, not a State")
    return found


def _all_entries(stiffness: Floats, stories: int) -> Floats:
    """Write the parameters of stories that turn, in the last axis, as the six entries of each story's matrix."""
    own = stiffness.reshape(*stiffness.shape[:-1], stories, stiffness.shape[-1] // stories)
    found = np.zeros((*own.shape[:-1], len(THREE_MOTIONS.stiffness_basis)))
    found[..., : own.shape[-1]] = own
    return found.reshape(*stiffness.shape[:-1], found.shape[-1] * stories)


def _matrices(experiment: Experiment, tested: Tested, mass: Floats, stiffness: Floats) -> tuple[Floats, Floats]:
    """Assemble M, with the added mass of the test, and K; without rotation by their diagonals alone."""
    motions = experiment.motions
    if motions.count == 1:
        return mass_matrix(mass + tested.added_mass), stiffness_matrix(stiffness)
    assert isinstance(tested, Configuration)
    added = motions.loads(tested.added_mass, tested.added_mass_position)
    return motions.masses(mass) + added, motions.stiffnesses(stiffness)


def _refuse_large(stories: int, size: int, motions: int) -> None:
    """Raise `UnsuitableError` if the derivatives of a frame with effects would not fit into memory."""
    needed = 2 * size * (motions * stories) ** 2 * 8
    if needed > MEMORY:
        raise UnsuitableError(
            f"effects in a frame of {stories} stories need {needed / 1e9:.1f} GB for derivatives; up to "
            f"{int((MEMORY / 32) ** (1 / 3))} stories fit into {MEMORY / 1e9:g} GB: join stories, or identify "
            "the frame without effects"
        )


def _assembled(state: State) -> State:
    """Assemble the stiffness matrix of the stories, braces and joints of a state.

    A story has columns of stiffness k = 12 E I / h^3 and height h. With sway u and joint rotation theta at either end,
    it has the stiffness of the Bernoulli beam, k [1, h/2; h^2/3, h^2/6 coupling] (Przemieniecki, Theory of Matrix
    Structural Analysis). Joints of flexibility s resist a rotation with 1 / s. The rotations are condensed out (Guyan
    1965): K = K_uu - K_ut S (1 + K_tt S)^-1 K_ut', which stays finite for rigid joints.
    """
    if state.experiment.frame.turns:
        _, dK = unit_derivatives(THREE_MOTIONS, state.experiment.stories)
        by_entries = dK[-len(state.story_stiffness) :]
        return state.with_stiffness(
            THREE_MOTIONS.stiffnesses(state.story_stiffness), summed(state.d_story_stiffness, by_entries)
        )
    T = transformation(len(state.story_stiffness))
    if not (state.joint_flexibility.any() or state.d_joint_flexibility.any()):
        return state.with_stiffness(
            stiffness_matrix(state.story_stiffness), (T * state.d_story_stiffness[:, None, :]) @ T.T
        )
    k, S = state.story_stiffness - state.brace_stiffness, state.joint_flexibility
    uu, ut, tt = _stories(tuple(state.heights.tolist()))
    Kuu, Kut, Ktt = (summed(k, unit) for unit in (uu, ut, tt))
    turned = np.linalg.solve(np.eye(len(S)) + Ktt * S, Kut.T)
    down = -S[:, None] * turned
    # Condensation is a congruence with [1; down], so a derivative of the full matrix passes through it.
    bent = ut @ down
    each = uu + bent + bent.transpose(0, 2, 1) + down.T @ tt @ down
    dK = summed(state.d_story_stiffness - state.d_brace_stiffness, each)
    if state.d_brace_stiffness.any():
        dK += (T * state.d_brace_stiffness[:, None, :]) @ T.T
    dK -= summed(state.d_joint_flexibility, turned[:, :, None] * turned[:, None, :])
    K = Kuu + Kut @ down
    return state.with_stiffness(0.5 * (K + K.T) + stiffness_matrix(state.brace_stiffness), dK)


@lru_cache(maxsize=16)
def _stories(heights: tuple[float, ...]) -> tuple[Floats, Floats, Floats]:
    """Build the blocks (u, u), (u, theta) and (theta, theta) of every story of unit stiffness, one after the other.

    theta > 0 turns the joint so that the column leans towards +u: the drift is resisted by
    u_i - u_(i-1) - h (theta_i + theta_(i-1)) / 2. The first joint is the base, which does not sway.
    """
    n, h = len(heights), np.array(heights)
    story = np.arange(n)
    sway, joints, tt = np.zeros((n, n + 1)), np.zeros((n, n + 1)), np.zeros((n, n + 1, n + 1))
    sway[story, story + 1] = 1.0
    sway[story, story] = -1.0
    joints[story, story + 1] = joints[story, story] = 1.0
    tt[story, story, story] = tt[story, story + 1, story + 1] = h**2 / 3
    tt[story, story, story + 1] = tt[story, story + 1, story] = h**2 / 6
    sway = sway[:, 1:]
    ut = -0.5 * h[:, None, None] * sway[:, :, None] * joints[:, None, :]
    return sway[:, :, None] * sway[:, None, :], ut, tt


def slices(effects: Sequence[LocatedEffect], first: int) -> list[tuple[LocatedEffect, slice]]:
    """List each effect with the places of its parameters, counted from `first`."""
    result = []
    for placed in effects:
        count = len(placed.effect.parameters)
        result.append((placed, slice(first, first + count)))
        first += count
    return result
