"""Prior of the frame in a record, and the evidence of sets of changes since the tests.

The unknowns of `VariedFrame` and the levels of the noise have a Gaussian prior, conditioned on the measured modes. A
change of a story, a dashpot, a gain or the floor masses widens it along some columns. The likelihood of a record is
linearized once, and one formula gives the evidence of each set of changes, with each standard deviation of e_ij.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.data.kinds import frequency_residual, scaled
from cvxshear.effects import Effect
from cvxshear.effects.readings import SensorGain
from cvxshear.effects.stories import StoryChange
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model import modes
from cvxshear.response.damping import DampedModel
from cvxshear.response.uncertain import UncertainFrame
from cvxshear.response.varied_frame import DIFFERENCE, OTHER_DAMPING_STD, VariedFrame
from cvxshear.util import ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Floats

#: Relative standard deviations of the gains of all sensors: laboratory and field calibrations, equally probable. A
#: larger error of one sensor is a change with the prior of `SensorGain`.
GAIN_STDS = (0.001, 0.01)

#: Relative standard deviation of one factor on the stiffness of the frame, and of a factor on each error of form:
#: instrumented buildings soften by some 5 to 30 % in strong shaking and mostly recover (Clinton, Bradford, Heaton and
#: Favela 2006), bench frames by some percent. If columns soften and beams do not, the form of the frame changes.
AMPLITUDE_STD = 0.15

#: Relative standard deviation of the factors of unchanged stories: some hundredths of the softening of the frame.
SCATTER_STD = 0.003

#: Standard deviation of the logarithm of one factor on all damping: ratios double or halve with the amplitude.
DAMPING_STD = 0.5

#: Probability of an undeclared dashpot in some story, of other floor masses than in the tests, and of a late sensor:
#: most owners declare their dampers and loads, and most loggers have one clock.
UNDECLARED_PROBABILITY = 0.1

#: Standard deviation of an absent dashpot or delay, in units of the deviation of a present one: the dashpot that gives
#: a mode its measured ratio without other damping; one sample, since the record itself shows longer delays.
ABSENT_STD = 1e-3

#: Standard deviation of the logarithm of each noise level: a factor of seven to either side is within two.
NOISE_STD = 1.0

#: Relative standard deviation of the floor masses if they changed since the tests: furniture, people, stored goods.
MASS_STD = 0.05

#: Standard deviations of e_ij, compared by their evidence: from an exact shear frame to a frame with other modes than
#: the model's.
FORM_STDS = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1)

#: Minimum probability, relative to the most probable answer, of an answer in the average and of a set that is extended.
LEAST_WEIGHT = 1e-3


def modal_rows(frame: UncertainFrame, varied: VariedFrame) -> tuple[Floats, Floats]:
    """Write the measured modes as linear data of a frame with errors of form, linearized at the identified frame.

    Returns
    -------
    J : ndarray, shape (d, N + W + X)
        Derivatives of frequencies and shape entries, in standard deviations, by the logarithms of the story
        stiffnesses in the tests, by masses and effects, and by e_ij.
    data : ndarray, shape (d,)
        Measured values minus the model's.
    """
    N, D, W, X = varied.sizes
    configurations = frame.fitted.experiment.configurations
    tests = [each for each in configurations if each.state == frame.configuration.state]

    def described(z: Floats) -> Floats:
        model = varied.model(np.concatenate([z[:N], np.zeros(D), z[N:]]))
        parts = [_standardized(each, model, each.added_mass - frame.configuration.added_mass) for each in tests]
        return np.concatenate([np.zeros(0), *parts])

    centre = described(np.zeros(N + W + X))
    J = np.array([(described(DIFFERENCE * row) - centre) / DIFFERENCE for row in np.eye(N + W + X)]).T
    # The sensors of the tests had other gains.
    J[:, N + W - varied.gains : N + W] = 0.0
    return -J, centre


def _standardized(test: Configuration, model: DampedModel, added: Floats) -> Floats:
    """Compute measured minus modeled frequencies and shape entries of one test, in standard deviations."""
    own = modes(model.M + np.diag(added), model.K)
    at, weights = test.modes - 1, test.entry_weights
    entries = (own.shapes[at] * model.gain)[:, test.measured_floors - 1]
    measured = np.nan_to_num(test.mode_shapes)
    left = weights * (measured - scaled(measured, entries, weights)[0][:, None] * entries)
    logs = np.log(2 * np.pi * test.frequencies)
    correlation = test.frequency_correlation
    above, _ = frequency_residual(logs, own.eigenvalues[at], test.log_frequency_std, correlation=correlation)
    return np.append(-above, left[weights > 0])


@dataclass(frozen=True, eq=False)
class FrameChange:
    """A change since the tests that the frame, its masses or a sensor may have.

    Parameters
    ----------
    kind : str
        "story", "dashpot", "gain", "delay" (the excitation's last), or "gains" or "masses" for all together.
    columns : ndarray, shape (P, k)
        Changes of the unknowns, one standard deviation each.
    log_odds : float
        Prior log odds.
    """

    kind: str
    columns: Floats
    log_odds: float


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Mean and covariance of the unknowns, and the log evidence of the measured modes without a constant."""

    mean: Floats
    covariance: Floats
    evidence: float


@dataclass(frozen=True, eq=False)
class FramePrior:
    """Gaussian prior of the unknowns of a `VariedFrame` and of the levels of the noise.

    The measured modes enter twice: in the identified stiffnesses and masses, with an exact form of the model, and as
    data for the errors of form.

    Parameters
    ----------
    varied : VariedFrame
    others : int
        Number of noise levels and of delays; the delays are last, one for each floor's sensor.
    identified : ndarray, shape (N, N)
        Covariance of the identified log story stiffnesses, given masses and effects.
    measured : tuple of ndarray
        Results of `modal_rows`.
    changes : tuple of FrameChange
        Possible changes.
    """

    varied: VariedFrame
    others: int
    identified: Floats
    measured: tuple[Floats, Floats]
    changes: tuple[FrameChange, ...]

    @staticmethod
    def around(frame: UncertainFrame, varied: VariedFrame, others: int) -> FramePrior:
        """Set up the prior from the identified frame, and from the changes that the file or the catalogue expects."""
        experiment, unit = frame.fitted.experiment, np.eye(sum(varied.sizes) + others)
        story, changed = _expected(StoryChange(), experiment, experiment.stories)
        gain, off = _expected(SensorGain(), experiment, varied.gains)
        damped, late = (_at_each(UNDECLARED_PROBABILITY, count) for count in (experiment.stories, varied.gains))
        everywhere = range(len(unit))
        delays = everywhere[len(unit) - varied.gains + 1 :]
        changes = [
            FrameChange(kind, std * unit[:, [at]], float(np.log(p / (1.0 - p))))
            for kind, places, std, p in (
                ("story", range(experiment.stories), story, changed),
                ("dashpot", everywhere[varied.dashpots], 1.0, damped),
                ("gain", everywhere[varied.sensor_gains], gain, off),
                ("delay", delays, 1.0, late),
            )
            for at in places
        ]
        # A late excitation is equivalent to sensors that are all early.
        common = unit[:, delays].sum(axis=1, keepdims=True)
        changes.append(FrameChange("delay", common, float(np.log(late / (1.0 - late)))))
        laboratory, field = GAIN_STDS
        changes.append(FrameChange("gains", np.sqrt(field**2 - laboratory**2) * unit[:, varied.sensor_gains], 0.0))
        if varied.heavier_floors.shape[1]:
            heavier = np.zeros((len(unit), experiment.stories))
            heavier[: -others or None] = MASS_STD * varied.heavier_floors
            odds = float(np.log(UNDECLARED_PROBABILITY / (1.0 - UNDECLARED_PROBABILITY)))
            changes.append(FrameChange("masses", heavier, odds))
        rows = modal_rows(frame, varied)
        return FramePrior(varied, others, frame.conditional_stiffness(), rows, tuple(changes))

    @property
    def widest(self) -> Gaussian:
        """Prior with all changes and with the largest standard deviation of the errors of form."""
        return self.gaussian(range(len(self.changes)), FORM_STDS[-1])

    def gaussian(self, changed: Sequence[int], form_std: float) -> Gaussian:
        """Return the prior of an `FrameAnswer`."""
        if form_std not in self._by_modes:
            self._by_modes[form_std] = self._given_modes(form_std)
        by_modes = self._by_modes[form_std]
        covariance = by_modes.covariance.copy()
        N, D, W, X = self.varied.sizes
        ratios, form = slice(N, self.varied.dashpots.start), slice(N + D + W, N + D + W + X)
        covariance[:N, :N] += AMPLITUDE_STD**2 + SCATTER_STD**2 * np.eye(N)
        covariance[ratios, ratios] += DAMPING_STD**2 + OTHER_DAMPING_STD**2 * np.eye(len(self.varied.own_std))
        covariance[form, form] += (AMPLITUDE_STD * form_std) ** 2 * np.eye(X)
        for each in changed:
            covariance += self.changes[each].columns @ self.changes[each].columns.T
        return Gaussian(by_modes.mean, covariance, by_modes.evidence)

    @cached_property
    def _by_modes(self) -> dict[float, Gaussian]:
        """Results of `_given_modes` by their argument; many answers share each."""
        return {}

    def _given_modes(self, form_std: float) -> Gaussian:
        """Return the prior of a record without changes of stories, masses and damping since the tests."""
        N, D, W, X = self.varied.sizes
        # The errors of form limit the accuracy of masses and effects from modes.
        share = self.varied.nuisance_share
        modal = np.isfinite(share)
        nuisances = 1.0 + (form_std / share) ** 2 / max(int(modal.sum()), 1)
        nuisances[~modal] = GAIN_STDS[0] ** 2
        rest = np.diag(np.concatenate([nuisances, np.full(X, form_std**2)]))
        tested = linalg.block_diag(self.identified, rest)
        own = self.varied.own_std
        damping = np.diag(np.append(own, np.full(D - len(own), ABSENT_STD)) ** 2)
        late = self.varied.gains - 1
        others = np.repeat([NOISE_STD, ABSENT_STD], [self.others - late, late]) ** 2
        whole = linalg.block_diag(self.identified, damping, rest, np.diag(others))
        # The record's stiffnesses are the tests' stiffnesses times factors: both change with the measured modes.
        crossed = np.zeros((len(whole), len(tested)))
        crossed[:N, :N] = self.identified
        crossed[N + D : N + D + W + X, N:] = rest
        J, data = self.measured
        seen = J @ tested @ J.T + np.eye(len(data))
        gain = np.linalg.solve(seen, J @ crossed.T).T
        _, log_det = np.linalg.slogdet(seen)
        evidence = -0.5 * float(data @ np.linalg.solve(seen, data) + log_det)
        covariance = whole - gain @ J @ crossed.T
        return Gaussian(gain @ data, 0.5 * (covariance + covariance.T), evidence)


def _expected(effect: Effect, experiment: Experiment, places: int) -> tuple[float, float]:
    """Return the size of an effect, and its probability at each place, from the file or else from the catalogue."""
    for said in experiment.expected:
        if said.name == effect.name and said.story is None and said.floor is None:
            effect = effect.expecting(size=said.size, probability=said.probability)
    return effect.size or effect.usual, _at_each(effect.probability, places)


def _at_each(probability: float, places: int) -> float:
    """Compute the probability at each of several places from the probability at any of them."""
    return float(1.0 - (1.0 - probability) ** (1.0 / max(places, 1)))


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The linearized likelihood at one point: -2 log L = |U d + c|^2 + constant for a step d.

    Parameters
    ----------
    U, c : ndarray, shapes (r, P) and (r,)
    inflation : float
        Scatter of the summed scores, relative to white innovations; at least 1.
    """

    U: Floats
    c: Floats
    inflation: float


class Linear:
    """Linear data of unknowns with a Gaussian prior; the inflation divides the log likelihood.

    Parameters
    ----------
    p : ndarray, shape (P,)
        Point of the linearization.
    """

    def __init__(self, at: Likelihood, p: Floats, prior: Gaussian) -> None:
        self.U, self.prior, self.covariance = at.U, prior, prior.covariance
        self.data = at.U @ (p - prior.mean) - at.c
        self.seen = at.U @ prior.covariance @ at.U.T + at.inflation * np.eye(len(at.c))

    def evidences(self, changes: Sequence[FrameChange], sets: Sequence[tuple[int, ...]]) -> list[float]:
        """Return the log evidence, without a constant, of the prior with each set of changes.

        A dashpot is positive: a set with a negative one has no evidence.
        """
        half = np.asarray(np.linalg.cholesky(self.seen))
        columns = [np.linalg.solve(half, self.U @ each.columns) for each in changes]
        data = np.linalg.solve(half, self.data)
        plain = self.prior.evidence - 0.5 * float(data @ data) - float(np.sum(np.log(half.diagonal())))
        found = []
        for chosen in sets:
            moved = np.hstack([np.zeros((len(data), 0)), *(columns[each] for each in chosen)])
            positive = [changes[each].kind == "dashpot" for each in chosen for _ in columns[each].T]
            wider, slope = np.eye(moved.shape[1]) + moved.T @ moved, moved.T @ data
            within = np.linalg.solve(wider, slope)
            gain = 0.5 * (float(slope @ within) - float(np.linalg.slogdet(wider)[1]))
            found.append(-np.inf if np.any(within[positive] < 0) else plain + gain)
        return found

    def posterior(self) -> tuple[Floats, Floats]:
        """Compute mean and covariance of the unknowns."""
        spread = self.U @ self.covariance
        gain = np.linalg.solve(self.seen, spread).T
        return self.prior.mean + gain @ self.data, self.covariance - gain @ spread


@dataclass(frozen=True, eq=False)
class FrameAnswer:
    """One possible way in which the frame differs from the identified one.

    Parameters
    ----------
    changed : tuple of int
        Places in `FramePrior.changes`.
    form_std : float
        Standard deviation of the errors of the model's form.
    """

    changed: tuple[int, ...]
    form_std: float
    probability: float

    @property
    def prior(self) -> tuple[tuple[int, ...], float]:
        """Arguments of `FramePrior.gaussian`."""
        return self.changed, self.form_std


def possible_answers(at: Likelihood, prior: FramePrior, p: Floats) -> tuple[FrameAnswer, ...]:
    """List the possible sets of changes and errors of form, by the evidence of the linearized likelihood.

    Sets of each size extend the probable sets of the previous size. All standard deviations of the errors of form have
    the same prior probability.
    """
    scores: dict[tuple[tuple[int, ...], float], float] = {}
    for form_std in FORM_STDS:
        linear = Linear(at, p, prior.gaussian((), form_std))
        level: list[tuple[int, ...]] = [()]
        best = -np.inf
        while level:
            odds = [sum(prior.changes[each].log_odds for each in chosen) for chosen in level]
            evidences = linear.evidences(prior.changes, level)
            own = {chosen: one + other for chosen, one, other in zip(level, odds, evidences, strict=True)}
            scores |= {(chosen, form_std): score for chosen, score in own.items()}
            best = max([best, *own.values()])
            kept = [each for each in level if own[each] > best + np.log(LEAST_WEIGHT)]
            pairs = itertools.product(kept, range(len(prior.changes)))
            level = sorted({tuple(sorted({*base, other})) for base, other in pairs if other not in base})
    order = ranking.ranked(scores, scores.__getitem__)
    probable = [each for each in order if scores[each] > scores[order[0]] + np.log(LEAST_WEIGHT)]
    weights = ranking.weigh([scores[each] for each in probable])
    return tuple(FrameAnswer(*each, float(weight)) for each, weight in zip(probable, weights, strict=True))
