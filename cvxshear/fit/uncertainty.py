"""Standard deviations and correlations from the information matrix, and undetermined directions.

With Z an orthonormal basis of the directions that the active constraints leave free, the covariance of the
parameters is Z (Z' J'J Z)^-1 Z': a Cramer-Rao bound under constraints (Stoica and Ng, 1998), which the
estimator reaches where the noise is small.

A parameter with a physical interval, such as gravity's gamma in [1, 6/5], is not known exactly if the fit ends at an
end of it. The interval then counts as a prior with the standard deviation of a uniform distribution,
(upper - lower) / sqrt(12), and the end is not held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.fit.domain import Domain
from cvxshear.programs import LeastSquares
from cvxshear.programs.constraints import constrained
from cvxshear.util import ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Bools, Floats

NULL = 1e-6
"""Smallest change of the data along a determined direction, each parameter in units of its own sensitivity."""

LEAST_UNIT = 1e-4
"""Smallest unit of a parameter for `NULL`, relative to its size. A prior of 1e-9 makes the unit of its own sensitivity
so small that the other data seem to have no influence."""

ON_BOUND = 1e-5
"""Largest distance from an active bound, in standard deviations of the data."""


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

    @cached_property
    def _divided(self) -> tuple[Floats, tuple[tuple[Floats, Floats], Floats]]:
        """Units of the parameters, and the free directions of the equalities as `_split` divides them.

        A parameter with an interval is determined by it, without any data.
        """
        known = _with_intervals(self.J, self.interval_std)
        unit = _units(known, self.least_units)
        return unit, _split(known * unit, _null_space(self.equalities * unit))

    @property
    def determined(self) -> Bools:
        """Mask of the determined parameters, shape (P,)."""
        return np.asarray(np.linalg.norm(self._divided[1][1], axis=1) < 1e-4)

    @property
    def null_directions(self) -> tuple[tuple[str, ...], ...]:
        """For each direction that is left open, the parameters that take part in it, largest share first."""
        return tuple(_words(column, self.names) for column in self._divided[1][1].T)

    @property
    def free(self) -> int:
        """Number of free directions that the data determine, those held only by an active bound included."""
        unit, ((basis, _), _) = self._divided
        if np.any(np.isfinite(self.interval_std)):
            (basis, _), _ = _split(self.J * unit, _null_space(self.equalities * unit))
        return int(basis.shape[1])

    @property
    def active(self) -> tuple[str, ...]:
        """Parameters that sit on a bound."""
        on = np.any(np.concatenate([self.touching, self.ends]), axis=0)
        return tuple(name for name, here in zip(self.names, on, strict=True) if here)

    @cached_property
    def root(self) -> Floats:
        """Directions that the constraints leave free, bounds that are touched held, each of unit effect on the data.

        Shape (P, f); J root has orthonormal columns.
        """
        return self.root_of(self.J) if np.any(np.isfinite(self.interval_std)) else self.reach

    @cached_property
    def reach(self) -> Floats:
        """Directions as in `root`, without the rows `ends`, shape (P, g).

        Parameters at an end of their interval may then move off it, and each interval acts as a prior.
        """
        if len(self.touching):
            known = _with_intervals(self.J, self.interval_std)
            return self._unit_directions(known, self.equalities, self.touching)
        unit, ((basis, values), _) = self._divided
        return unit[:, None] * (basis / values)

    def root_of(self, J: Floats) -> Floats:
        """Directions that the constraints leave free, of unit effect on other residuals than these, shape (P, f)."""
        return self._unit_directions(J, self.equalities, self.touching, self.ends)

    def _unit_directions(self, J: Floats, *constraints: Floats) -> Floats:
        """Directions on which the held rows are zero and that J determines, each of unit effect on J's residuals."""
        unit = _units(J, self.least_units)
        (basis, values), _ = _split(J * unit, _null_space(np.concatenate(constraints) * unit))
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
    here = constrained(LeastSquares(R=J, s=np.zeros(len(J))), domain.statements, theta)
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


def _null_space(rows: Floats) -> Floats:
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
