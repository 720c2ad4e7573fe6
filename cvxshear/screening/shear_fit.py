"""How far a reading is from the nearest shear frame of plausible proportions.

Floor masses and story stiffnesses are those that minimize

    sum (log f_model - log f)^2 / s_f^2 + sum |(1 - u u') W phi|^2 + sum (log m_i)^2 / s_m^2
        + sum (log k_i - mean log k)^2 / s_k^2,      u = W phi_model / |W phi_model|,

the scale of each shape eliminated, by Gauss-Newton (`fit.gauss_newton`). Declared masses are not used: one
configuration determines masses only up to a common factor, and the declaration may be wrong. The last two sums say how
far floors and stories of one frame differ, as in the loop (`fit.domain`); they decide where the measurement does
not.

A story that is a thousand times softer, or a floor that is a thousand times heavier, has a local minimum that an even
start does not reach. So a reading that even frames do not explain is also fitted from frames with one such story or
floor.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from cvxshear import backends
from cvxshear.data.pairing import scaled
from cvxshear.fit.domain import MASS_WIDTH, STIFFNESS_WIDTH, Domain
from cvxshear.fit.gauss_newton import Accuracy, gauss_newton
from cvxshear.fit.optimality import PlainResiduals
from cvxshear.fit.start import START_PASSES, solved_story_equations
from cvxshear.measurement.reading import CLOSER, FARTHER, MeasuredModes
from cvxshear.model.shear import Modes, mass_matrix, mode_derivatives, modes, shear_system, stiffness_matrix
from cvxshear.priors import Constraints
from cvxshear.programs.constraints import NamedConstraints
from cvxshear.util import ranking
from cvxshear.util.errors import CvxshearError, NoModesError
from cvxshear.util.typing import Floats

FARTHEST_LOG = 14.0
"""Bound on the logarithms of masses and stiffnesses about their start: factors of a million, bearings under a house."""

STARTING_LOG = 3.0
"""Largest log difference of masses or stiffnesses from their mean at a start, unless farther off fits better."""

ODD = 1e-3
"""Stiffness of the one story, and inverse mass of the one floor, of the odd frames that a fit starts from."""

MOST_NEAREST_STEPS = 60
"""Step programs at most, in one fit."""

ROUGH_STEPS = 8
"""Steps of a fit that only ranks starts or repairs; further steps rarely change the order."""

TALLEST_FITTED = 24
"""Largest number of stories for fits of repairs: their number grows with the square of the stories."""

ENOUGH = 3e-2
"""Change of a residual, in standard deviations, of a step that counts as none."""

OUTLIER = 2.0
"""A robust fit reduces the weight of entries that are off by more standard deviations."""

ABOUT = 0.1
"""Standard deviation of the logarithm of a frequency under a frame of about the right proportions."""

REWEIGHTINGS = 4
"""Times that the entries of a robust fit are weighed anew."""


@dataclass(frozen=True, eq=False)
class NearestFrame:
    """A shear frame near a reading.

    Parameters
    ----------
    theta : ndarray, shape (2N,)
        Logarithms of masses and stiffnesses, the unit of mass free.
    cost : float
        The sum above.
    at : PlainResiduals, optional
        Residuals there.
    """

    theta: Floats
    cost: float
    at: PlainResiduals | None = None

    @property
    def modes(self) -> Modes:
        """The frame's modes."""
        return modes_at(self.theta)


def usual_width(stories: int) -> Floats:
    """Return the standard deviations of the logarithms of masses and stiffnesses about typical ones, shape (2N,)."""
    return np.repeat([MASS_WIDTH, STIFFNESS_WIDTH], stories)


def modes_of(mass: Floats, stiffness: Floats) -> Modes:
    """Modes of a frame of these floor masses and story stiffnesses."""
    return modes(mass_matrix(mass), stiffness_matrix(stiffness))


def modes_at(theta: Floats) -> Modes:
    """Modes of the frame whose masses and stiffnesses have these logarithms."""
    return modes_of(*np.split(np.exp(theta), 2))


def starts(stories: int) -> list[Floats]:
    """Frames of equal floors whose stories are equal, or weaker with height."""
    return [np.log(np.concatenate([np.ones(stories), np.linspace(1.0, top, stories)])) for top in (1.0, 0.4)]


def odd_starts(stories: int) -> list[Floats]:
    """Even frames but for one soft story, or one heavy floor."""
    even = np.zeros(2 * stories)
    changes = np.concatenate([np.full(stories, -np.log(ODD)), np.full(stories, np.log(ODD))])
    return [even + np.where(np.arange(2 * stories) == place, changes, 0.0) for place in range(2 * stories)]


def story_starts(reading: MeasuredModes, at: Iterable[Floats]) -> list[Floats]:
    """Solve the story equations of whole shapes from these frames; no result where some floor was not measured.

    Stories and floors whose sizes differ by thousands are in no valley that even frames lead into.
    """
    N = reading.stories
    if not np.array_equal(reading.floors, np.arange(N)) or not reading.known.all():
        return []
    total = Constraints(A=np.concatenate([np.ones((1, N)), np.zeros((1, N))], axis=1), b=np.array([float(N)]))
    unit = [NamedConstraints("unit of mass", total)]
    eigenvalues = (2 * np.pi * np.exp(reading.log_frequencies)) ** 2
    problem, found = ShearFrames([(reading, np.zeros(N))]), []
    for start in at:
        theta = np.exp(problem.tuned(start))
        with suppress(CvxshearError):
            for _ in range(START_PASSES):
                theta = solved_story_equations(
                    reading.scaled, eigenvalues, np.zeros(reading.scaled.shape), theta, unit, weighed=True
                )
            found.append(np.log(theta))
    return found


def _clipped(theta: Floats) -> Floats:
    """Move every mass and stiffness that is far from the mean nearer to it."""
    by_quantity = theta.reshape(2, -1)
    mean = by_quantity.mean(axis=1, keepdims=True)
    return np.asarray((mean + np.clip(by_quantity - mean, -STARTING_LOG, STARTING_LOG)).ravel())


def fit(
    reading: MeasuredModes, at: Iterable[Floats], *, weights: Floats | None = None, most_steps: int = MOST_NEAREST_STEPS
) -> NearestFrame:
    """Return the best of the fits that begin at these frames.

    Parameters
    ----------
    reading : MeasuredModes
    at : iterable of ndarray, shape (2N,)
    weights : ndarray, shape (m, n), optional
        In place of the reading's own.
    most_steps : int, optional
        At most, in each.
    """
    problem = ShearFrames([(reading, np.zeros(reading.stories))], weights=weights)
    found = (problem.nearest(_start(problem, theta), most_steps) for theta in at)
    return ranking.ranked(found, lambda item: -item.cost)[0]


def _start(problem: ShearFrames, theta: Floats) -> Floats:
    """Choose the frame as it is or with nothing far from the mean, whichever is nearer to the reading."""
    near: list[tuple[float, Floats]] = []
    for each in (_clipped(theta), theta):
        try:
            tuned = problem.tuned(each)
            near.append((problem.evaluate(tuned, derivatives=False).objective, tuned))
        except NoModesError:
            continue
    return min(near, key=lambda item: item[0])[1] if near else _clipped(theta)


def distance(reading: MeasuredModes, at: Iterable[Floats]) -> NearestFrame:
    """Fit with each tolerance, and return the best by the likelihood: a wide tolerance must pay for itself.

    Minus twice the logarithm of the likelihood, but for a constant that is the same for every change of the reading.
    """
    found = fit(reading, at)
    each = [NearestFrame(found.theta, found.cost + reading.certainty_lost())]
    for part in (CLOSER, FARTHER):
        other = dataclasses.replace(reading, part=part)
        again = fit(other, [found.theta])
        each.append(NearestFrame(again.theta, again.cost + other.certainty_lost()))
    return ranking.ranked(each, lambda item: -item.cost)[0]


def robust_fit(reading: MeasuredModes, at: Floats) -> NearestFrame:
    """Fit with Cauchy's weights, refitted a few times: an entry counts the less the farther it is off."""
    weights = reading.weights
    found = fit(reading, [at], weights=weights)
    for _ in range(REWEIGHTINGS):
        off = shape_residual(reading, found.modes)
        found = fit(reading, [found.theta], weights=weights / np.sqrt(1 + (off / OUTLIER) ** 2))
    return found


def shape_residual(reading: MeasuredModes, found: Modes) -> Floats:
    """Shapes of a frame less those read, each scaled to it by least squares, in standard deviations, shape (m, n)."""
    psi, read, weights = found.shapes[np.ix_(reading.modes, reading.floors)], reading.scaled, reading.weights
    scale, _ = scaled(read, psi, weights)
    return np.asarray(weights * (scale[:, None] * psi - read))


def misfit(reading: MeasuredModes, found: Modes) -> float:
    """Add up the first two sums above for a frame of only about the right proportions, its scale free."""
    off = np.log(found.frequencies[reading.modes]) - reading.log_frequencies
    return float(np.sum(((off - off.mean()) / ABOUT) ** 2) + np.sum(shape_residual(reading, found) ** 2))


def farthest(reading: MeasuredModes, found: Modes) -> float:
    """Find the largest difference between the data and a frame, in standard deviations."""
    frequency = (np.log(found.frequencies[reading.modes]) - reading.log_frequencies) / reading.frequency_std
    return float(max(np.max(np.abs(frequency)), np.max(np.abs(shape_residual(reading, found)))))


class ShearFrames:
    """Shear frames compared with readings of one frame, as a problem in the logarithms of masses and stiffnesses.

    Parameters
    ----------
    readings : sequence of (MeasuredModes, ndarray)
        Each with its added mass, shape (N,), kg.
    centred : bool, optional
        Whether masses are compared with their mean, and not with what is expected: where the added masses fix their
        scale.
    expected, width : ndarray, shape (2N,), optional
        Logarithms of masses and stiffnesses that are expected, the stiffnesses up to a factor, and their standard
        deviations; even floors of 1 kg and even stories, with the widths of the loop, where not given.
    weights : ndarray, shape (m, n), optional
        Of the entries of every reading, in place of its own.
    """

    def __init__(
        self,
        readings: Sequence[tuple[MeasuredModes, Floats]],
        *,
        centred: bool = False,
        expected: Floats | None = None,
        width: Floats | None = None,
        weights: Floats | None = None,
    ) -> None:
        self.readings = [
            (reading, added, reading.weights if weights is None else weights) for reading, added in readings
        ]
        self.stories = N = readings[0][0].stories
        self.expected = np.zeros(2 * N) if expected is None else expected
        about_mean = np.eye(N) - np.full((N, N), 1 / N)
        self.prior = np.zeros((2 * N, 2 * N))
        self.prior[:N, :N] = about_mean if centred else np.eye(N)
        self.prior[N:, N:] = about_mean
        self.prior /= (usual_width(N) if width is None else width)[:, None]

    def tuned(self, theta: Floats) -> Floats:
        """Scale the stiffnesses to the mean frequency of the first reading."""
        reading, added, _ = self.readings[0]
        mass, stiffness = np.split(np.exp(theta), 2)
        off = reading.log_frequencies - np.log(modes_of(mass + added, stiffness).frequencies[reading.modes])
        return np.asarray(theta + np.repeat([0.0, 2.0 * float(np.mean(off))], self.stories))

    def nearest(self, start: Floats, most_steps: int = MOST_NEAREST_STEPS) -> NearestFrame:
        """Fit a frame by Gauss-Newton from these logarithms, shape (2N,)."""
        size = len(start)
        within = NamedConstraints("reach", Constraints(lower=start - FARTHEST_LOG, upper=start + FARTHEST_LOG))
        domain = Domain((within,), np.ones(size), np.full(size, np.inf))
        try:
            found = gauss_newton(self, start, domain, backends.get("auto"), Accuracy(ENOUGH, most_steps))
        except CvxshearError:
            # No step from here can be solved in 64 bits: this start leads nowhere.
            return NearestFrame(start, np.inf)
        return NearestFrame(found.theta, found.at.objective, found.at)

    def evaluate(self, theta: Floats, /, *, derivatives: bool = True) -> PlainResiduals:
        """Residuals of frequencies and shapes, then of the logarithms themselves.

        Raises
        ------
        NoModesError
            Where rounding leaves a frequency without a value.
        """
        value = np.exp(theta)
        mass, stiffness = np.split(value, 2)
        residuals, slopes = [], []
        for reading, added, weights in self.readings:
            system = shear_system(mass + added, stiffness)
            found = modes(system.M, system.K)
            if not found.eigenvalues[0] > 0:
                raise NoModesError("masses and stiffnesses of the frame differ by more than 64 bits resolve")
            off = 0.5 * np.log(found.eigenvalues[reading.modes]) - np.log(2 * np.pi) - reading.log_frequencies
            psi, read = found.shapes[np.ix_(reading.modes, reading.floors)], reading.scaled
            scale, unit = scaled(read, psi, weights)
            residuals += [off / reading.frequency_std, (weights * (scale[:, None] * psi - read)).ravel()]
            if derivatives:
                dlam, dphi = mode_derivatives(found, system, reading.modes)
                slopes.append(0.5 * dlam / found.eigenvalues[reading.modes] / reading.frequency_std)
                d_shape = scale[:, None] * weights * dphi[:, :, reading.floors]
                d_shape -= unit * np.sum(unit * d_shape, axis=2, keepdims=True)
                slopes.append(d_shape.reshape(len(value), -1))
        r = np.concatenate([*residuals, self.prior @ (theta - self.expected)])
        if not derivatives:
            return PlainResiduals(r, np.zeros((0, len(theta))))
        return PlainResiduals(r, np.concatenate([(np.concatenate(slopes, axis=1) * value[:, None]).T, self.prior]))
