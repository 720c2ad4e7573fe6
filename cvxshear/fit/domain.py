"""Domain, prior and uncertainty of the parameters of a fit.

The domain has positivity, declared masses, exact priors, and the limits of the effects. The prior makes the evidence of
a set of effects proper. Effects have theirs from their classes: Student's t about the null value, or, for an effect
with many parameters of one common size, normal with this size, which is estimated with the rest (`fit/gaussian.py`).
The frame has the same prior in every set: the logarithm of each floor mass is normal about a typical value, that of
each story stiffness about their mean. It is so wide that it moves an estimate of a few percent by less than a hundredth
of its standard deviation.

**Uncertainty.** With Z an orthonormal basis of the directions that the active constraints leave free, the covariance of
the parameters is Z (Z' J'J Z)^-1 Z': a Cramer-Rao bound under constraints (Stoica and Ng, 1998), which the estimator
reaches where the noise is small.

A parameter with a physical interval, such as gravity's gamma in [1, 6/5], is not known exactly if the fit ends at an
end of it. The interval then counts as a prior with the standard deviation of a uniform distribution,
(upper - lower) / sqrt(12), and the end is not held.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from cvxshear.effects import LocatedEffect, Scale
from cvxshear.effects.composition import slices
from cvxshear.fit.gaussian import tailed
from cvxshear.measurement.experiment import Experiment
from cvxshear.priors import Constraints
from cvxshear.programs import LeastSquares, MatrixInequality, turning
from cvxshear.programs.constraints import LEAST_POSITIVE, NamedConstraints, constrained, exact_frame, statements
from cvxshear.util import decorators, ranking
from cvxshear.util.typing import Bools, Floats

#: Smallest positive mass or stiffness, relative to the smallest value at the start, if that is below twice the usual
#: smallest one (`LEAST_POSITIVE`): stiffnesses can differ by 1e6.
PART_OF_START = 0.1

#: Largest mass or stiffness relative to its start. A less determined value is practically infinite, and larger values
#: would cost the digits of the others.
FARTHEST = 1e5


MASS_WIDTH = 1.0
#: Standard deviations of the logarithms of floor masses and of story stiffnesses about typical ones. Floors of one
#: frame seldom differ by more than a factor e; stories do, if one stands on rails or bearings.
STIFFNESS_WIDTH = 2.0

#: Smallest change of the data along a determined direction, each parameter in units of its own sensitivity.
NULL = 1e-6

#: Smallest unit of a parameter for `NULL`, relative to its size. A prior of 1e-9 makes the unit of its own sensitivity
#: so small that the other data seem to have no influence.
LEAST_UNIT = 1e-4

#: Largest distance from an active bound, in standard deviations of the data.
ON_BOUND = 1e-5

Rows = tuple[Floats, Floats]


@dataclass(frozen=True, eq=False)
class Domain:
    """Constraints and scales of the parameters of a fit.

    Parameters
    ----------
    statements : sequence of NamedConstraints
        Exact statements about theta.
    scale : ndarray, shape (P,)
        Size of each parameter: its start, or the expected size of an effect if that is larger.
    interval_std : ndarray, shape (P,)
        Standard deviation of a uniform distribution over a parameter's physical interval; infinite without interval.
    farthest : ndarray, shape (P,), optional
        Largest value of each parameter that a step may reach. Default: no limit.
    lmi : sequence of MatrixInequality, optional
        Matrices of floors and stories that turn.
    held : ndarray, shape (P, k), optional
        Orthonormal directions along which the parameters, in units of `scale`, stay.
    """

    statements: Sequence[NamedConstraints]
    scale: Floats
    interval_std: Floats
    farthest: Floats | None = None
    lmi: Sequence[MatrixInequality] = ()
    held: Floats | None = None

    def held_rows(self, U: Floats) -> Floats:
        """Write rows that hold a step along `held`, each as heavy as all rows U; none without such directions.

        Equalities would have multipliers of rounding alone.
        """
        if self.held is None:
            return np.zeros((0, U.shape[1]))
        return np.asarray(np.linalg.norm(U * self.scale) * self.held.T / self.scale)

    def around(self, program: LeastSquares, theta: Floats) -> LeastSquares:
        """Constrain a program in the change of the parameters from theta."""
        moved = tuple(MatrixInequality(each.name, each.at(theta), each.slopes) for each in self.lmi)
        return constrained(program, self.statements, theta).replace(lmi=moved)

    def tangent(self, program: LeastSquares, theta: Floats) -> LeastSquares:
        """Constrain a program to changes along `held` of zero and v' F v >= 0, v the eigenvectors of each matrix F."""
        parts = []
        if self.held is not None:
            rows = self.held.T / self.scale
            parts.append(NamedConstraints("what the data leave open", Constraints(A=rows, b=rows @ theta)))
        for each in self.lmi:
            _, vectors = np.linalg.eigh(each.at(theta))
            G = -np.einsum("av,jab,bv->vj", vectors, each.slopes, vectors)
            h = np.einsum("av,ab,bv->v", vectors, each.constant, vectors)
            parts.append(NamedConstraints(f"{each.name} is positive", Constraints(G=G, h=h)))
        return constrained(program, [*self.statements, *parts], theta)


def spread(
    on_mass: Sequence[NamedConstraints], on_stiffness: Sequence[NamedConstraints], n: int, size: int
) -> list[NamedConstraints]:
    """Write statements about masses and about stiffnesses as statements about all parameters."""
    return [
        part.widened(at, size)
        for parts, at in ((on_mass, slice(0, n)), (on_stiffness, slice(n, 2 * n)))
        for part in parts
    ]


def domain_of(
    experiment: Experiment, effects: Sequence[LocatedEffect], theta: Floats, held: Floats | None = None
) -> Domain:
    """Build the domain of the parameters of a fit with these effects.

    Parameters
    ----------
    experiment : Experiment
    effects : sequence of LocatedEffect
    theta : ndarray, shape (P,)
        Start.
    held : ndarray, shape (P, k), optional
        `Domain.held`.
    """
    n, size, frame_size = experiment.stories, len(theta), experiment.parameters
    known = experiment.frame.known_total
    masses, stiffnesses = experiment.levels(theta)
    typical_mass, typical_stiffness = float(np.median(masses)), float(np.median(stiffnesses))
    mass = _least(masses, typical_mass if known is None else known / n)
    stiffness = _least(stiffnesses, typical_stiffness)
    released = any("total_mass" in placed.effect.releases for placed in effects)
    frame = exact_frame(experiment.frame, total_released=released)
    gone = {placed.place.prior for placed in effects if "prior" in placed.effect.releases}
    priors = [prior for words, prior in experiment.stated.items() if words not in gone]
    interval_std, scale = np.full(size, np.inf), np.abs(theta)
    lmi: tuple[MatrixInequality, ...] = ()
    if experiment.frame.turns:
        floors = turning.floor_statements(experiment, frame, priors)
        parts = [each.widened(experiment.of_floors, size) for each in floors]
        units = experiment.units(typical_mass, typical_stiffness)
        if experiment.symmetric:
            least = Constraints(lower=np.minimum(LEAST_POSITIVE * units, PART_OF_START * theta[:frame_size]))
            parts.append(NamedConstraints("what is positive", least).widened(slice(0, frame_size), size))
        else:
            lmi = (
                *(
                    each.widened(experiment.of_floors, size)
                    for each in turning.positive_floors(experiment, LEAST_POSITIVE * mass)
                ),
                *(
                    each.widened(experiment.of_stories, size)
                    for each in turning.positive_stories(experiment, LEAST_POSITIVE * stiffness)
                ),
            )
        scale[:frame_size] = np.maximum(scale[:frame_size], units)
    else:
        parts = spread(
            statements(priors, "floor_mass", n, frame, least=mass),
            statements(priors, "story_stiffness", n, least=stiffness),
            n,
            size,
        )
    typical = Scale.of(experiment, typical_mass, typical_stiffness)
    for placed, own in slices(effects, frame_size):
        parameters = placed.effect.parameters
        if placed.fixed:
            exact = Constraints(A=np.eye(len(parameters)), b=np.array(placed.fixed))
            parts.append(NamedConstraints(f"{placed.label} as assumed", exact).widened(own, size))
            continue
        bounds = Constraints(
            lower=np.array([item.lower for item in parameters]), upper=np.array([item.upper for item in parameters])
        )
        interval_std[own] = [(item.upper - item.lower) / np.sqrt(12) for item in parameters]
        expected = placed.effect.expected_sizes(typical)
        scale[own] = np.maximum(np.abs(theta[own]), np.where(np.isfinite(expected), expected, 0.0))
        parts.append(NamedConstraints(f"bounds of {placed.label}", bounds).widened(own, size))
        limits = placed.effect.limits(experiment, placed.place)
        columns = np.concatenate([np.arange(frame_size), np.arange(own.start, own.stop)])
        parts.append(NamedConstraints(f"what {placed.label} can be", limits).widened(columns, size))
    scale = np.where(scale == 0, 1.0, scale)
    farthest = np.where(np.arange(size) < frame_size, FARTHEST * scale, np.inf)
    return Domain(parts, scale, interval_std, farthest, lmi, held)


def _least(start: Floats, typical: float) -> float:
    """Return the least mass, or the least stiffness, that counts as positive."""
    least, smallest = LEAST_POSITIVE * typical, float(start.min())
    return PART_OF_START * smallest if smallest < 0.5 * least else least


@dataclass(frozen=True, eq=False)
class EffectPrior:
    """Prior distributions of the parameters.

    Parameters
    ----------
    scale : Scale, optional
        Of a typical floor and story. Default: no prior.
    stds : dict, optional
        Standard deviations of the parameters of effects that the experiment declares, in place of the catalogue's.
    """

    scale: Scale | None = None
    stds: dict[LocatedEffect, Floats] = field(default_factory=dict)

    def of(self, placed: LocatedEffect) -> Floats:
        """Return the standard deviations of an effect's parameters about null, shape (p,); infinite if uniform."""
        assert self.scale is not None, "without a scale an effect has no prior"
        std = self.stds.get(placed)
        return placed.effect.expected_sizes(self.scale) if std is None else std

    def residuals(
        self, theta: Floats, effects: Sequence[LocatedEffect], factors: Mapping[str, float]
    ) -> tuple[Rows, list[str], Rows]:
        """Compute the rows of the effects' parameters and the rows of the frame, with residuals and derivatives.

        Parameters
        ----------
        theta : ndarray, shape (P,)
        effects : sequence of LocatedEffect
        factors : mapping of str to float
            Factor on the expected size of an effect of one common, unknown size, by the effect's label.

        Returns
        -------
        about_effects : tuple of ndarray
        keys : list of str
            For each of these rows the label of the effect with an unknown common size; empty for the others.
        about_frame : tuple of ndarray
        """
        size = len(theta)
        if self.scale is None:
            none = np.zeros(0), np.zeros((0, size))
            return none, [], none
        r, slope, keys = np.zeros(size), np.zeros(size), [""] * size
        units = self.scale.units
        at = len(units)
        for placed in effects:
            own = slice(at, at := at + len(placed.effect.parameters))
            if placed.fixed:
                continue
            null = np.array([item.null for item in placed.effect.parameters])
            common = placed.effect.common_size
            std = self.of(placed) * (factors.get(placed.label, 1.0) if common else 1.0)
            r[own], unit_slope = tailed((theta[own] - null) / std, np.inf if common else placed.effect.tail)
            slope[own] = unit_slope / std
            keys[own] = [placed.label if common else ""] * (own.stop - own.start)
        about = np.flatnonzero(slope)
        return (r[about], np.diag(slope)[about]), [keys[i] for i in about], self._frame(theta, units)

    def _frame(self, theta: Floats, units: Floats) -> Rows:
        """Compute the logarithms of masses and stiffnesses over their widths, those of stiffnesses about their mean.

        Inertias count with the masses. The level of the stiffness has no prior: a first fit of a shear frame to a frame
        with a wall is several times too stiff, and a prior about its level would favor every effect that makes the
        stories appear stiffer.
        """
        assert self.scale is not None
        floors = len(self.scale.heights) * len(self.scale.motions.mass_names)
        width = np.repeat([MASS_WIDTH, STIFFNESS_WIDTH], [floors, len(units) - floors])
        own = theta[: len(units)]
        r, slope = np.log(own / units) / width, np.diag(1.0 / (width * own))
        r[floors:] -= np.mean(r[floors:])
        slope[floors:] -= np.mean(slope[floors:], axis=0)
        return r, np.hstack([slope, np.zeros((len(own), len(theta) - len(own)))])


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Accuracy of each parameter.

    Parameters
    ----------
    J : ndarray, shape (d, P)
        Derivatives of the standardized residuals, or a triangular factor of them.
    equalities : ndarray, shape (a, P)
        Rows on which every change is zero.
    touching, ends : ndarray, shapes (t, P) and (e, P)
        Rows of the active inequalities: bounds, and ends of a parameter's interval.
    interval_std : ndarray, shape (P,)
        Standard deviation of a uniform distribution over the physical interval; infinite without interval.
    least_units : ndarray, shape (P,)
        Smallest unit of each parameter, see `LEAST_UNIT`.
    names : tuple of str
        Names of the parameters.
    """

    J: Floats
    equalities: Floats
    touching: Floats
    ends: Floats
    interval_std: Floats
    least_units: Floats
    names: tuple[str, ...]

    @decorators.cached_property
    def _open(self) -> Floats:
        """Directions that no datum and no equality determines, shape (P, o), in units of each parameter.

        A parameter with an interval is determined by it, without any data.
        """
        known = _with_intervals(self.J, self.interval_std)
        unit = _units(known, self.least_units)
        return _split(known * unit, null_space(self.equalities * unit))[1]

    @property
    def determined(self) -> Bools:
        """Mask of the determined parameters, shape (P,)."""
        return np.asarray(np.linalg.norm(self._open, axis=1) < 1e-4)

    @property
    def null_directions(self) -> tuple[tuple[str, ...], ...]:
        """For each direction that is left open, the parameters that take part in it, largest share first."""
        return tuple(_words(column, self.names) for column in self._open.T)

    @property
    def free(self) -> int:
        """Number of free directions that the data determine, those held only by an active bound included."""
        unit = _units(self.J, self.least_units)
        return len(_split(self.J * unit, null_space(self.equalities * unit))[0][1])

    @property
    def active(self) -> tuple[str, ...]:
        """Parameters that sit on a bound."""
        on = np.any(np.concatenate([self.touching, self.ends]), axis=0)
        return tuple(name for name, here in zip(self.names, on, strict=True) if here)

    @decorators.cached_property
    def reach(self) -> Floats:
        """Directions as in `root_of`, without the rows `ends`, shape (P, g).

        Parameters at an end of their interval may then move off it, and each interval acts as a prior.
        """
        return self._unit_directions(_with_intervals(self.J, self.interval_std), self.equalities, self.touching)

    def root_of(self, J: Floats) -> Floats:
        """Directions that the constraints leave free, each of unit effect on residuals of derivatives J, shape (P, f).

        Bounds that are touched are held. J times the directions has orthonormal columns.
        """
        return self._unit_directions(J, self.equalities, self.touching, self.ends)

    def _unit_directions(self, J: Floats, *constraints: Floats) -> Floats:
        """Directions on which the held rows are zero and that J determines, each of unit effect on J's residuals."""
        unit = _units(J, self.least_units)
        (basis, values), _ = _split(J * unit, null_space(np.concatenate(constraints) * unit))
        return unit[:, None] * (basis / values)

    def covariance(self) -> Floats:
        """Covariance of the determined part, shape (P, P), in the parameters' own units."""
        covariance: Floats = self.reach @ self.reach.T
        return covariance

    def std(self) -> Floats:
        """Return the standard deviations, shape (P,); nan where the data do not determine a parameter."""
        return np.where(self.determined, np.sqrt(np.maximum(np.diag(self.covariance()), 0.0)), np.nan)

    def correlation(self) -> Floats:
        """Correlations, shape (P, P); nan where one of the two is undetermined or fixed."""
        std = self.std()
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.covariance() / np.outer(std, std)


def uncertainty(J: Floats, theta: Floats, domain: Domain, names: Sequence[str]) -> Uncertainty:
    """Covariance of the parameters at a fit.

    Parameters
    ----------
    J : ndarray, shape (d, P)
        Derivatives of the standardized residuals, or a triangular factor of them.
    theta : ndarray, shape (P,)
    domain : Domain
    names : sequence of str
        Names of the P parameters.
    """
    if domain.lmi:
        # Derivatives by the parameters of a motion that no sensor sees are rounding.
        seen = np.linalg.norm(J, axis=0) * domain.scale
        J = np.where(seen > len(seen) * np.finfo(float).eps * np.max(seen), J, 0.0)
    here = domain.tangent(LeastSquares(R=J, s=np.zeros(len(J))), theta)
    G, h = here.inequalities
    unit = _units(_with_intervals(J, domain.interval_std), np.zeros(len(theta)))
    touching = G[h <= ON_BOUND * np.linalg.norm(G * unit, axis=1)]
    ends = np.any(touching[:, np.isfinite(domain.interval_std)], axis=1)
    return Uncertainty(
        J=J,
        equalities=here.equalities[0],
        touching=touching[~ends],
        ends=touching[ends],
        interval_std=domain.interval_std,
        least_units=LEAST_UNIT * np.abs(theta),
        names=tuple(names),
    )


def _with_intervals(J: Floats, interval_std: Floats) -> Floats:
    """Add what intervals of physical values say, as rows beside the data's."""
    return np.concatenate([J, np.diag(1.0 / interval_std)[np.isfinite(interval_std)]])


def _units(J: Floats, least: Floats) -> Floats:
    """Return the change of each parameter that moves the data by one, or the least one given; one where none does."""
    length = np.linalg.norm(J, axis=0)
    return np.where(length > 0, np.maximum(1.0 / np.where(length > 0, length, 1.0), least), 1.0)


def null_space(rows: Floats) -> Floats:
    """Orthonormal columns that every row is zero on."""
    if not len(rows):
        return np.eye(rows.shape[1])
    lengths = np.linalg.norm(rows, axis=1)
    space: Floats = linalg.null_space(rows / np.where(lengths > 0, lengths, 1.0)[:, None], rcond=1e-12)
    return space


def _split(J: Floats, basis: Floats) -> tuple[tuple[Floats, Floats], Floats]:
    """Turn the basis into directions that the data determine, with their singular values, and others."""
    if not basis.shape[1]:
        return (basis, np.zeros(0)), basis
    # The triangular factor has the same singular values and right vectors, and no tall left ones.
    _, values, right = np.linalg.svd(np.linalg.qr(J @ basis, mode="r"), full_matrices=True)
    values = np.concatenate([values, np.zeros(len(right) - len(values))])
    known = values > NULL
    return (basis @ right[known].T, values[known]), basis @ right[~known].T


def _words(direction: Floats, names: Sequence[str]) -> tuple[str, ...]:
    """List the parameters in a null direction with more than a tenth of its largest entry, largest first."""
    size = np.abs(direction)
    order = ranking.order(size)
    return tuple(names[i] for i in order if size[i] > 0.1 * size[order[0]])
