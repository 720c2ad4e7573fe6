"""The shear frame of plausible proportions that is nearest to readings, and how far from it they are.

Floor masses and story stiffnesses minimize the sum of squares

    C = sum (log f_model - log f)^2 / s_f^2 + sum |(1 - u u') W phi|^2 + sum (log m_i - log m_i')^2 / s_m^2
        + sum (log k_i - log k_i' - mean)^2 / s_k^2,      u = W phi_model / |W phi_model|,

by Gauss-Newton (`fit/gauss_newton.py`), with the residuals of `data/kinds.py`. The last two sums say how far floors
and stories of one frame differ (`fit/domain.py`), or what is declared of them; they decide where the measurement does
not. No real frame is a shear frame, so the noise of a reading includes a tolerance. Three tolerances are tried, and the
most probable one is taken.

Readings are compared by their evidence, Laplace's approximation with all standard deviations in it,

    -2 log Z = C + log det J'J + 2 sum log s + constant,

so a hypothesis that leaves a datum or a mass open pays for that.

A story that is a thousand times softer, or a floor that is a thousand times heavier or lighter, has a local minimum
that an even start does not reach. So readings that even frames do not explain are also fitted from frames with one such
story or floor.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from cvxshear import backends
from cvxshear.data.kinds import frequency_residual, shape_residual
from cvxshear.fit import domain, gauss_newton, gaussian, optimality, start
from cvxshear.measurement.reading import CLOSER, FARTHER, MeasuredModes
from cvxshear.model import Modes, mass_matrix, mode_derivatives, modes, shear_system, stiffness_matrix
from cvxshear.priors import Constraints
from cvxshear.programs.constraints import NamedConstraints
from cvxshear.util import errors, ranking
from cvxshear.util.typing import Floats

#: Bound on the logarithms of masses and stiffnesses about their start: factors of a million, bearings under a house.
FARTHEST_LOG = 14.0

#: Size of the one story or floor of the odd frames that a fit starts from; of a heavy floor its inverse.
ODD = 1e-3

#: Degrees of freedom of masses and stiffnesses about typical ones: now and then a frame stands on bearings.
ODD_TAIL = 4.0

#: Number of odd frames that a fit starts from, and of changes that are fitted to the end: the best by a rough measure.
SHORTLIST = 6

#: Largest number of stories for fits of repairs: their number grows with the square of the stories.
TALLEST_FITTED = 24

#: Largest mean square, in standard deviations, of data that a shear frame explains.
PLAUSIBLE = 4.0

#: Prior probability that a file has a mistake of one kind: one file in a hundred.
MISTAKEN = 1e-2


@dataclass(frozen=True, eq=False)
class NearestFrame:
    """A shear frame near readings.

    Parameters
    ----------
    theta : ndarray, shape (2N,)
        Logarithms of masses and stiffnesses, the unit of mass free.
    misfit : float
        C; infinite if there is no fit.
    at : PlainResiduals, optional
        Residuals there.
    stds : float, optional
        2 sum log s.
    """

    theta: Floats
    misfit: float = np.inf
    at: optimality.PlainResiduals | None = None
    stds: float = 0.0

    @property
    def log_evidence(self) -> float:
        """log Z, but for a constant."""
        if self.at is None:
            return -np.inf
        log_det = float(np.linalg.slogdet(self.at.J.T @ self.at.J)[1])
        return -0.5 * (self.misfit + log_det + self.stds)

    @property
    def modes(self) -> Modes:
        """Modes of the frame."""
        return modes_of(*np.split(np.exp(self.theta), 2))


def modes_of(mass: Floats, stiffness: Floats) -> Modes:
    """Return the modes of a frame of these floor masses and story stiffnesses."""
    return modes(mass_matrix(mass), stiffness_matrix(stiffness))


def even_starts(stories: int) -> list[Floats]:
    """Return frames of equal floors whose stories are equal, or weaker with height."""
    return [np.log(np.concatenate([np.ones(stories), np.linspace(1.0, top, stories)])) for top in (1.0, 0.4)]


@dataclass(frozen=True, eq=False)
class ShearFrames:
    """Shear frames compared with readings of one frame, as a problem in the logarithms of masses and stiffnesses.

    Parameters
    ----------
    readings : sequence of MeasuredModes
    added : sequence of ndarray, shape (N,)
        Added mass of each reading, kg.
    expected : ndarray, shape (2N,)
        Logarithms of masses and stiffnesses that are expected, the stiffnesses up to a factor.
    centred : bool, optional
        Whether masses are compared with their mean, and not with what is expected: where the added masses fix their
        scale.
    """

    readings: Sequence[MeasuredModes]
    added: Sequence[Floats]
    expected: Floats
    centred: bool = False

    @staticmethod
    def of(reading: MeasuredModes) -> ShearFrames:
        """Compare one reading with frames of usual proportions; one reading leaves the unit of mass free."""
        N = reading.stories
        return ShearFrames([reading], [np.zeros(N)], np.zeros(2 * N))

    @property
    def stories(self) -> int:
        """Number of stories N."""
        return len(self.expected) // 2

    @property
    def count(self) -> int:
        """Number of frequencies and entries."""
        return sum(reading.count for reading in self.readings)

    def tolerant(self, part: float) -> ShearFrames:
        """Return the same with this part of the tolerances."""
        return replace(self, readings=[replace(each, part=part) for each in self.readings])

    def tuned(self, theta: Floats) -> Floats:
        """Scale the stiffnesses to the mean frequency of the first reading."""
        reading, (mass, stiffness) = self.readings[0], np.split(np.exp(theta), 2)
        found = modes_of(mass + self.added[0], stiffness).frequencies[reading.modes]
        off = float(np.mean(reading.log_frequencies - np.log(found)))
        return np.asarray(theta + np.repeat([0.0, 2.0 * off], self.stories))

    @property
    def stds(self) -> float:
        """Twice the sum of the logarithms of all standard deviations, but for a constant that repairs do not change."""
        return sum(each.certainty_lost() for each in self.readings)

    def nearest(self, starts: Iterable[Floats]) -> NearestFrame:
        """Return the best fit that begins at one of these logarithms, shape (2N,)."""
        size = len(self.expected)
        found = []
        for each in starts:
            try:
                begin = self.tuned(each)
                within = NamedConstraints("reach", Constraints(lower=begin - FARTHEST_LOG, upper=begin + FARTHEST_LOG))
                inside = domain.Domain((within,), np.ones(size), np.full(size, np.inf))
                fit = gauss_newton.gauss_newton(self, begin, inside, backends.get("auto"), gauss_newton.ROUGH)
            except errors.CvxshearError:
                # No step from here can be solved in 64 bits.
                found.append(NearestFrame(each))
            else:
                found.append(NearestFrame(fit.theta, fit.at.objective, fit.at, self.stds))
        return ranking.ranked(found, lambda item: -item.misfit)[0]

    def odd_starts(self, about: Floats) -> list[Floats]:
        """Return a frame but for one heavy or light floor, or one soft story: those that fit best as they are."""
        floors = np.eye(self.stories, len(about))
        starts = about + np.log(ODD) * np.concatenate([-floors, np.eye(len(about))])
        left = []
        for each in starts:
            try:
                left.append(self.evaluate(self.tuned(each), derivatives=False).objective)
            except errors.CvxshearError:
                left.append(np.inf)
        return [starts[place] for place in ranking.order(-np.array(left))[:SHORTLIST]]

    def likeliest(self, starts: Iterable[Floats]) -> NearestFrame:
        """Return the best fit of the most probable tolerance."""
        found = self.nearest(starts)
        fits = [found, *(self.tolerant(part).nearest([found.theta]) for part in (CLOSER, FARTHER))]
        return ranking.ranked(fits, lambda item: item.log_evidence)[0]

    def distance(self, frame: NearestFrame) -> float:
        """Count the standard deviations between the data and a frame, with the smallest tolerance."""
        return float(np.sqrt(self.tolerant(CLOSER).evaluate(frame.theta, derivatives=False).objective))

    def story_starts(self, starts: Iterable[Floats]) -> list[Floats]:
        """Solve the story equations of the first reading from these frames; none if a floor was not measured.

        Stories and floors whose sizes differ by thousands are in no valley that even frames lead into.
        """
        N, reading = self.stories, self.readings[0]
        if not np.array_equal(reading.floors, np.arange(N)) or not reading.known.all():
            return []
        total = Constraints(A=np.concatenate([np.ones((1, N)), np.zeros((1, N))], axis=1), b=np.array([float(N)]))
        unit = [NamedConstraints("unit of mass", total)]
        eigenvalues, shapes = (2 * np.pi * np.exp(reading.log_frequencies)) ** 2, reading.scaled
        data, found = (shapes, eigenvalues, np.zeros(shapes.shape)), []
        for each in starts:
            with suppress(errors.CvxshearError):
                theta = np.exp(self.tuned(each))
                for _ in range(start.START_PASSES):
                    theta = start.solved_story_equations(*data, theta, unit, weighed=True)
                found.append(np.log(theta))
        return found

    def evaluate(self, theta: Floats, /, *, derivatives: bool = True) -> optimality.PlainResiduals:
        """Compute residuals of frequencies and shapes, then of the logarithms themselves.

        Raises
        ------
        NoModesError
            If rounding leaves a frequency without a value.
        """
        value = np.exp(theta)
        mass, stiffness = np.split(value, 2)
        parts = []
        for reading, added in zip(self.readings, self.added, strict=True):
            system = shear_system(mass + added, stiffness)
            found, which = modes(system.M, system.K), reading.modes
            if not found.eigenvalues[0] > 0:
                raise errors.NoModesError("masses and stiffnesses of the frame differ by more than 64 bits resolve")
            of_frequencies, of_shapes = mode_derivatives(found, system, which) if derivatives else (None, None)
            log_omega = reading.log_frequencies + np.log(2 * np.pi)
            parts.append(frequency_residual(log_omega, found.eigenvalues[which], reading.frequency_std, of_frequencies))
            psi = found.shapes[np.ix_(which, reading.floors)]
            slopes = None if of_shapes is None else of_shapes[:, :, reading.floors]
            parts.append(shape_residual(reading.scaled, psi, reading.weights, slopes))
        rows = self._prior
        about, slope = gaussian.tailed(rows @ (theta - self.expected), ODD_TAIL)
        r = np.concatenate([*(r for r, _ in parts), about])
        if not derivatives:
            return optimality.PlainResiduals(r, np.zeros((0, len(theta))))
        return optimality.PlainResiduals(r, np.concatenate([*(J * value for _, J in parts), slope[:, None] * rows]))

    @property
    def _prior(self) -> Floats:
        """Rows of the logarithms over their standard deviations."""
        N = self.stories
        about_mean = np.eye(N) - np.full((N, N), 1 / N)
        rows = np.zeros((2 * N, 2 * N))
        rows[:N, :N] = about_mean if self.centred else np.eye(N)
        rows[N:, N:] = about_mean
        return np.asarray(rows / np.repeat([domain.MASS_WIDTH, domain.STIFFNESS_WIDTH], N)[:, None])


def misfit(reading: MeasuredModes, found: Modes) -> float:
    """Add up the squares of the residuals for a frame of only about the right proportions, its scale free."""
    off = np.log(found.frequencies[reading.modes]) - reading.log_frequencies
    shapes, _ = shape_residual(reading.scaled, found.shapes[np.ix_(reading.modes, reading.floors)], reading.weights)
    return float(np.sum(((off - off.mean()) / reading.frequency_std) ** 2) + np.sum(shapes**2))
