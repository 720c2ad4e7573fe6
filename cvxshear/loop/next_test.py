"""Which added mass to test next, in which state, so that rivals part."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.effects import compose
from cvxshear.errors import NoModesError
from cvxshear.experiment import Configuration, Experiment
from cvxshear.frame import modes
from cvxshear.identification.efficient import Estimate
from cvxshear.identification.misfit import Misfit
from cvxshear.typing import Floats, Json

PARTS_OF_A_FLOOR = (0.1, 0.25, 0.5, 1.0)
"""Added masses that are tried, as parts of the mean floor mass."""

HEAVIEST = 1000.0
"""kg on one floor: more is not carried up for a test."""

MOST_RIVALS = 4
"""Rival sets that a test is to tell from the accepted one, the most probable first."""

WORTHWHILE = 1.0
"""Standard deviations below which no test is proposed."""


@dataclass(frozen=True)
class NextTest:
    """A test that would tell the rivals apart.

    Parameters
    ----------
    floor : int
    added_mass : float
        kg on that floor, beyond what the first configuration of its state carries.
    state : str
        In which it is tested.
    standard_deviations : float
        How far the predictions of the accepted model and of its nearest rival lie apart.
    """

    floor: int
    added_mass: float
    state: str
    standard_deviations: float

    def to_dict(self) -> Json:
        """The fields by name."""
        return dataclasses.asdict(self)


def next_test(accepted: Estimate, rivals: Sequence[Estimate]) -> NextTest | None:
    """The added mass whose test would best tell an accepted model from its rivals.

    For each state, each floor and a few masses, the test is simulated by the accepted model with the sensors and noise
    of the state's first configuration, and the rivals' residual on it, r, weighed with what the fits so far leave
    uncertain: D^2 = r' (1 + J C J' + J_r C_r J_r')^-1 r in units of the noise. The smallest D over the rivals counts.
    """
    if not rivals:
        return None
    size = accepted.scale.floor_mass
    masses = sorted({min(part * size, HEAVIEST) for part in PARTS_OF_A_FLOOR})
    rivals = rivals[:MOST_RIVALS]
    tests = [
        (first, floor, mass)
        for first in _first_of_states(accepted, rivals)
        for floor in range(1, accepted.experiment.stories + 1)
        for mass in masses
    ]
    best: NextTest | None = None
    for first, floor, mass in tests:
        try:
            apart = min(separation(accepted, rival, _imagined(accepted, first, floor, mass)) for rival in rivals)
        except NoModesError:
            # A model buckles under this mass; nobody would test it.
            continue
        if best is None or apart > best.standard_deviations:
            best = NextTest(floor, mass, first.state, apart)
    return best if best is not None and best.standard_deviations >= WORTHWHILE else None


def _first_of_states(accepted: Estimate, rivals: Sequence[Estimate]) -> list[Configuration]:
    """The first configuration of each state that the models disagree on, and of the first state of all."""
    mine = set(accepted.effects)
    parted = {placed.place.state for rival in rivals for placed in mine.symmetric_difference(rival.effects)}
    firsts = {each.state: each for each in reversed(accepted.experiment.configurations)}
    here = accepted.experiment.configurations[0].state
    return [first for state, first in firsts.items() if state in parted or state == here]


def separation(accepted: Estimate, rival: Estimate, imagined: Experiment) -> float:
    """How many standard deviations a test sets two models apart."""
    noise = accepted.misfit.noise
    mine = Misfit(imagined, accepted.effects, noise=noise).evaluate(accepted.theta)
    other = Misfit(imagined, rival.effects, noise=noise).evaluate(rival.theta)
    r = other.r - mine.r
    spread = np.eye(len(r)) + _carried(mine.J, accepted) + _carried(other.J, rival)
    return float(np.sqrt(r @ np.linalg.solve(spread, r)))


def _carried(J: Floats, estimate: Estimate) -> Floats:
    """The covariance of predictions that comes from that of the parameters."""
    covariance: Floats = J @ estimate.uncertainty.covariance() @ J.T
    return covariance


def _imagined(estimate: Estimate, first: Configuration, floor: int, mass: float) -> Experiment:
    """A test by itself: a configuration with this mass more, measured as the model predicts."""
    added = first.added_mass.copy()
    added[floor - 1] += mass
    blank = dataclasses.replace(first, name="next test", added_mass=added)
    state = compose(estimate.experiment, blank, estimate.effects, estimate.theta, derivatives=False)
    found = modes(state.system.M, state.system.K)
    shapes = (found.shapes * state.gain)[np.ix_(first.modes - 1, first.measured_floors - 1)]
    measured = dataclasses.replace(
        blank,
        frequencies=found.frequencies[first.modes - 1],
        mode_shapes=np.where(first.measured, shapes, np.nan),
    )
    declared = estimate.experiment.frame
    total = declared.total_mass or float(estimate.theta[: estimate.experiment.stories].sum())
    frame = dataclasses.replace(
        declared, reference=None, total_mass=None if declared.floor_masses is not None else total
    )
    return Experiment(frame, (measured,))
