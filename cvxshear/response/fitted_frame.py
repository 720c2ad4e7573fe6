"""The frame as it was in a record: its most probable unknowns, and what is told of it by them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cvxshear.response.damped import DampedModel
from cvxshear.response.frame_answers import Answer
from cvxshear.response.frame_prior import MASS_STDS, FramePrior
from cvxshear.response.innovations import Directions, PredictionErrors
from cvxshear.response.varied_frame import GAIN_UNIT
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """The frame as it was in the record.

    Parameters
    ----------
    errors : PredictionErrors
    prior : FramePrior
    p : ndarray, shape (P,)
        Unknowns of `PredictionErrors`.
    covariance : ndarray, shape (P, P)
        Averaged over the answers.
    answers : tuple of Answer
        Most probable first.
    inflation : float
        Of the covariance, for innovations that are not white.
    converged : bool
    along : Directions
        Along which it was fitted.
    log_evidence : float
        Log of the probability of the record, averaged over the answers; that of the fit where the frame stays.
    """

    errors: PredictionErrors
    prior: FramePrior
    p: Floats
    covariance: Floats
    answers: tuple[Answer, ...]
    inflation: float
    converged: bool
    along: Directions
    log_evidence: float

    @cached_property
    def story_probability(self) -> Floats:
        """Probability that each story changed by itself, shape (N,)."""
        return self._changed[: self.errors.stories]

    @cached_property
    def dashpot_probability(self) -> Floats:
        """Probability that each story has a dashpot of its own, shape (N,)."""
        return self._changed[self.errors.stories : self._first_gain]

    @property
    def dashpots(self) -> tuple[Floats, Floats]:
        """Dashpot of each story, and its standard deviation, shapes (N,), N s/m."""
        at, unit = self.errors.varied.dashpots, self.errors.varied.dashpot
        return unit * self.p[at], unit * np.sqrt(np.diag(self.covariance)[at])

    @cached_property
    def gain_probability(self) -> Floats:
        """Probability that each sensor's gain is off by itself, shape (m,) with the excitation's last."""
        return self._changed[self._first_gain :]

    @property
    def _first_gain(self) -> int:
        return self.errors.stories + len(self.errors.varied.dashpot)

    @cached_property
    def _changed(self) -> Floats:
        result = np.zeros(self._first_gain + self.errors.varied.gains)
        for each in self.answers:
            result[list(each.changed)] += each.probability
        return result

    @property
    def mass_probability(self) -> float:
        """Probability that floor masses changed."""
        return sum(each.probability for each in self.answers if each.mass_std > 0)

    @property
    def gains(self) -> tuple[Floats, Floats]:
        """Relative error of each sensor, the excitation's last, and its standard deviation, shapes (m,)."""
        # An excitation that was larger than its sensor shows: that one reads too little.
        signs = np.where(self._sensors("log_gain")[:, -1] > 0, -1.0, 1.0)
        values, std = self._unknown_sensors("log_gain")
        return GAIN_UNIT * signs * values, GAIN_UNIT * std

    @property
    def brackets(self) -> tuple[Floats, Floats]:
        """What each sensor stands on (`DampedModel.bracket`), and its standard deviation, shapes (m,), s2."""
        unit = self._sensors("dbracket").sum(axis=1)
        values, std = self._unknown_sensors("dbracket")
        return unit * values, unit * std

    def _sensors(self, name: str) -> Floats:
        """Return the rows of an array of the sensors' directions that are not empty."""
        rows: Floats = getattr(self.errors.varied, name)
        return rows[rows.any(axis=1)]

    def _unknown_sensors(self, name: str) -> tuple[Floats, Floats]:
        """Return those unknowns and their standard deviations."""
        rows = getattr(self.errors.varied, name)
        first = self.errors.varied.sensor_gains.stop - len(rows)
        at = first + np.flatnonzero(rows.any(axis=1))
        return self.p[at], np.sqrt(np.diag(self.covariance)[at])

    @property
    def factors(self) -> Floats:
        """Story stiffnesses in this record over the identified ones, shape (N,)."""
        return self.errors.varied.story_factors(self.p[self.errors.frame])[0]

    @property
    def factors_std(self) -> Floats:
        """Standard deviations of the factors, shape (N,): both stiffnesses are uncertain."""
        return np.asarray(np.sqrt(np.diag(self._factors_covariance) + self.scale_std**2))

    @property
    def scale_std(self) -> float:
        """Relative standard deviation of the total mass, and so of all stiffnesses, since floors may have changed.

        Base motion tells how each floor changed against the others, not all together.
        """
        if not self.errors.setting.base_measured or self.errors.setting.force_floor:
            return 0.0
        return MASS_STDS[-1] * float(np.sqrt(self.mass_probability / self.errors.stories))

    @property
    def mean_factor(self) -> tuple[float, float]:
        """Mean of the factors, and its standard deviation."""
        return float(np.mean(self.factors)), float(np.sqrt(np.mean(self._factors_covariance) + self.scale_std**2))

    @property
    def against_others(self) -> tuple[Floats, Floats]:
        """Each story's factor over that of the stories that hardly changed, less one, and its deviation, shapes (N,).

        What all stories share, such as the scale of the masses, is in neither.
        """
        N, f = len(self.factors), self.factors
        weights = np.maximum(1.0 - self.story_probability, 1e-6) * (1.0 - np.eye(N)) + 1e-12
        weights /= weights.sum(axis=1, keepdims=True)
        others = weights @ f if N > 1 else np.ones(1)
        J = np.diag(1.0 / others) - (f / others**2)[:, None] * (weights if N > 1 else 0.0)
        std = np.sqrt(np.maximum(np.sum((J @ self._factors_covariance) * J, axis=1), 0.0))
        return f / others - 1.0, std

    @cached_property
    def mass_change(self) -> tuple[Floats, Floats]:
        """Relative change of each floor's mass since the tests, and its standard deviation, shapes (N,).

        Under the most probable answer in which they changed; zeros where there is none. The difference from the
        identified masses is partly the error of these.
        """
        N = self.errors.stories
        answer = next((each for each in self.answers if each.mass_std > 0), None)
        if answer is None:
            return np.zeros(N), np.zeros(N)
        prior, variance = self.prior.gaussian(*answer.prior), answer.mass_std**2
        heavier = np.zeros((len(self.p), self.prior.heavier_floors.shape[1]))
        heavier[self.errors.frame] = self.prior.heavier_floors
        G = variance * np.linalg.solve(prior.covariance, heavier).T
        covariance = variance * (np.eye(N) - G @ heavier) + G @ self.covariance @ G.T
        return G @ (self.p - prior.mean), np.sqrt(np.maximum(np.diag(covariance), 0.0))

    @cached_property
    def _factors_covariance(self) -> Floats:
        varied, frame = self.errors.varied, self.errors.frame
        _, J = varied.story_factors(self.p[frame])
        N, D, W, _ = varied.sizes
        masses = J[:, N + D : N + D + W]
        result: Floats = J @ self.covariance[frame, frame] @ J.T + self.prior.identified + masses @ masses.T
        return result

    @property
    def model(self) -> DampedModel:
        """The frame at the most probable unknowns."""
        return self.errors.model(self.p)
