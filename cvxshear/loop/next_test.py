"""Which added mass to test next, so that rivals part."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.effects import compose
from cvxshear.errors import InputError
from cvxshear.experiment import Experiment
from cvxshear.frame import modes
from cvxshear.identification.efficient import Estimate
from cvxshear.identification.misfit import Misfit
from cvxshear.typing import Floats, Json

PARTS_OF_A_FLOOR = (0.25, 0.5, 1.0)
"""Added masses that are tried, as parts of the mean floor mass: what can be carried up in practice."""

WORTHWHILE = 1.0
"""Standard deviations below which no test is proposed."""


@dataclass(frozen=True)
class NextTest:
    """A test that would tell the rivals apart.

    Parameters
    ----------
    floor : int
    added_mass : float
        kg on that floor, beyond what the first configuration carries.
    standard_deviations : float
        How far the predictions of the accepted model and of its nearest rival lie apart.
    """

    floor: int
    added_mass: float
    standard_deviations: float

    def to_dict(self) -> Json:
        """The fields by name."""
        return dataclasses.asdict(self)


def next_test(accepted: Estimate, rivals: Sequence[Estimate]) -> NextTest | None:
    """The added mass whose test would best tell an accepted model from its rivals.

    For each floor and a few masses, the test is simulated by the accepted model with the sensors and noise of
    the first configuration, and the rivals' residual on it, r, weighed with what the fits so far leave
    uncertain: D^2 = r' (S + J C J' + J_r C_r J_r')^-1 r, S the noise. The smallest D over the rivals counts.
    """
    size = float(np.mean(accepted.theta[: accepted.experiment.stories]))
    best: NextTest | None = None
    for floor in range(1, accepted.experiment.stories + 1):
        for part in PARTS_OF_A_FLOOR:
            try:
                apart = min(_separation(accepted, rival, floor, part * size) for rival in rivals)
            except InputError:
                # A model buckles under this mass; nobody would test it.
                continue
            if best is None or apart > best.standard_deviations:
                best = NextTest(floor, part * size, apart)
    return best if best is not None and best.standard_deviations >= WORTHWHILE else None


def _separation(accepted: Estimate, rival: Estimate, floor: int, mass: float) -> float:
    """How many standard deviations a test with this mass would set two models apart."""
    imagined = _imagined(accepted, floor, mass)
    test = imagined.configurations[-1]
    others = {each.name: np.ones(len(each.frequencies), dtype=bool) for each in imagined.configurations[:-1]}
    mine = Misfit(imagined, accepted.effects, others).evaluate(accepted.theta)
    other = Misfit(imagined, rival.effects, others).evaluate(rival.theta)
    # Soft priors stand at the end of the residuals; they are no part of the test.
    rows = test.frequencies.size + test.mode_shapes.size
    r = (other.r - mine.r)[:rows]
    spread = (
        accepted.noise_scale**2 * np.eye(rows) + _carried(mine.J[:rows], accepted) + _carried(other.J[:rows], rival)
    )
    return float(np.sqrt(r @ np.linalg.solve(spread, r)))


def _carried(J: Floats, estimate: Estimate) -> Floats:
    """The covariance of predictions that comes from that of the parameters."""
    covariance: Floats = J @ estimate.uncertainty.covariance(estimate.noise_scale) @ J.T
    return covariance


def _imagined(estimate: Estimate, floor: int, mass: float) -> Experiment:
    """The experiment with one more test: the first configuration with this mass, measured as the model predicts."""
    first = estimate.experiment.configurations[0]
    added = first.added_mass.copy()
    added[floor - 1] += mass
    blank = dataclasses.replace(first, name="next test", added_mass=added)
    state = compose(estimate.experiment, blank, estimate.effects, estimate.theta)
    found = modes(state.system.M, state.system.K)
    at = np.ix_(first.measured_floors - 1, first.modes - 1)
    shapes = (found.shapes * state.gain[:, None])[at].T
    measured = dataclasses.replace(
        blank,
        frequencies=found.frequencies[first.modes - 1],
        mode_shapes=np.where(first.measured, shapes, np.nan),
    )
    return dataclasses.replace(estimate.experiment, configurations=(*estimate.experiment.configurations, measured))
