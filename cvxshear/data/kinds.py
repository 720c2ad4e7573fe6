"""The kinds of data: natural frequencies, mode shapes, and displacements of static tests.

Frequencies are compared by their logarithms. Shapes have a free scale each, unless they are mass-normalized. A static
test has known forces and measured displacements.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy import linalg

from cvxshear.data.base import Datum, ErrorFigure, Model, NoiseKind, Residual, largest
from cvxshear.measurement.configuration import DEFAULT_FREQUENCY_STD, DEFAULT_MODE_SHAPE_STD
from cvxshear.measurement.declaration import DEFAULT_DISPLACEMENT_STD
from cvxshear.measurement.experiment import Configuration, Experiment, StaticTest
from cvxshear.util import ranking
from cvxshear.util.typing import Bools, Complexes, Floats, Ints


def mac(first: Floats | Complexes, second: Floats | Complexes) -> float:
    """Modal assurance criterion |a^H b|^2 / (a^H a b^H b) of two shapes (Allemang and Brown 1982)."""
    product = abs(np.vdot(first, second)) ** 2
    return float(product / (np.vdot(first, first).real * np.vdot(second, second).real))


def scaled(
    measured: Floats, modelled: Floats, weights: Floats, *, mass_normalized: bool = False
) -> tuple[Floats, Floats]:
    """Scales by least squares, and the unit vectors u, of each row.

    Parameters
    ----------
    measured, modelled, weights : ndarray, shape (m, n)
        Weight zero for missing entries.
    mass_normalized : bool, optional
        Whether the scale is a sign alone.

    Returns
    -------
    scale : ndarray, shape (m,)
    unit : ndarray, shape (m, n)
    """
    weighted = weights * modelled
    length = np.sum(weighted**2, axis=1)
    safe = np.where(length > 0, length, 1.0)
    scale = np.sum(weighted * weights * measured, axis=1) / safe
    return np.where(scale < 0, -1.0, 1.0) if mass_normalized else scale, weighted / np.sqrt(safe)[:, None]


def frequency_residual(
    log_omega: Floats, eigenvalues: Floats, std: Floats, slopes: Floats | None = None, correlation: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return differences of log frequencies in standard deviations, with derivatives dlambda / (2 lambda).

    Correlated differences d, each over its deviation, become C^-1/2 d with the symmetric root of their correlation C:
    they are independent then, and each stays as near to its own frequency as it can (Kessy et al. 2018).

    Parameters
    ----------
    log_omega : ndarray, shape (m,)
        Logarithms of the measured circular frequencies.
    eigenvalues : ndarray, shape (m,)
        Squares of the modelled circular frequencies.
    std : ndarray, shape (m,)
    slopes : ndarray, shape (p, m), optional
        Derivatives of the eigenvalues.
    correlation : ndarray, shape (m, m), optional
        C; independent differences without it.

    Returns
    -------
    r : ndarray, shape (m,)
    J : ndarray, shape (m, p)
        Of no rows without `slopes`.
    """
    r = (0.5 * np.log(eigenvalues) - log_omega) / std
    J = np.zeros((0, 0)) if slopes is None else (slopes * (0.5 / (std * eigenvalues))).T
    if correlation is None:
        return r, J
    values, vectors = np.linalg.eigh(correlation)
    root = (vectors / np.sqrt(values)) @ vectors.T
    return root @ r, J if slopes is None else root @ J


def shape_residual(
    measured: Floats, modelled: Floats, weights: Floats, slopes: Floats | None = None, *, mass_normalized: bool = False
) -> tuple[Floats, Floats]:
    """Return W (c phi - measured phi) with the scale c of each mode eliminated, and its derivatives.

    At the c of least squares the sum of squares is stationary in c, so its gradient is J' r with
    J = (1 - u u') W c dphi (Golub and Pereyra 1973, in Kaufman's form). Mass-normalized shapes have only a free sign.

    Parameters
    ----------
    measured, modelled, weights : ndarray, shape (m, n)
        Weight zero for missing entries.
    slopes : ndarray, shape (p, m, n), optional
        Derivatives of the modelled shapes.
    mass_normalized : bool, optional

    Returns
    -------
    r : ndarray, shape (m n,)
    J : ndarray, shape (m n, p)
        Of no rows without `slopes`.
    """
    scale, unit = scaled(measured, modelled, weights, mass_normalized=mass_normalized)
    r = (weights * (scale[:, None] * modelled - measured)).ravel()
    if slopes is None:
        return r, np.zeros((0, 0))
    J = weights * scale[:, None] * slopes
    if not mass_normalized:
        J = J - unit * np.sum(unit * J, axis=2, keepdims=True)
    return r, J.reshape(len(J), r.size).T


@dataclass(frozen=True, eq=False)
class _OfModes(Datum):
    """Data of the modes of a configuration.

    Parameters
    ----------
    tested : Configuration
    used : ndarray of bool, shape (m,)
        Which of its modes count.
    """

    tested: Configuration
    used: Bools

    def without(self, left_out: Bools) -> Self:
        """Leave out these modes."""
        return replace(self, used=self.used & ~left_out)

    @property
    def parts(self) -> list[str]:
        """The modes."""
        return [f"mode {mode}" for mode in self.tested.modes[self.used]]


@dataclass(frozen=True, eq=False)
class Frequencies(_OfModes):
    """r_j = (log f_j - log measured f_j) / std_j, with dlog f = dlambda / (2 lambda)."""

    noise = NoiseKind(
        "frequency", "frequencies", DEFAULT_FREQUENCY_STD, 0.03,
        "records of a few minutes give frequencies to 0.1 to 0.5 %; identified by hand they are right to 3 %",
        (
            ErrorFigure("max_frequency_error", "largest frequency error", "frequency_error", largest),
            ErrorFigure(
                "rms_frequency_error", "frequency error, root mean square", "frequency_error",
                lambda errors: np.sqrt(np.mean(errors**2)),
            ),
        ),
        negligible=1e-5,
    )  # fmt: skip

    @classmethod
    def of(cls, experiment: Experiment) -> Sequence[Frequencies]:
        """List the frequencies of each configuration."""
        return [cls(each, np.ones(len(each.frequencies), dtype=bool)) for each in experiment.configurations]

    @property
    def count(self) -> int:
        """Number of modes that count."""
        return int(np.sum(self.used))

    def residual(self, model: Model) -> Residual:
        """Differences of logarithms over the standard deviation of the logarithm, made independent."""
        logs, std = np.log(2 * np.pi * self.tested.frequencies[self.used]), self.tested.log_frequency_std[self.used]
        slopes = model.mode_derivatives[0][:, self.used] if model.derivatives else None
        correlation = self.tested.frequency_correlation
        if correlation is not None:
            correlation = correlation[np.ix_(self.used, self.used)]
        eigenvalues = model.modes.eigenvalues[model.paired][self.used]
        return Residual(*frequency_residual(logs, eigenvalues, std, slopes, correlation))

    def errors(self, model: Model) -> Mapping[str, Floats]:
        """model / measured - 1 of each frequency."""
        modelled = model.modes.frequencies[model.paired][self.used]
        return {"frequency_error": modelled / self.tested.frequencies[self.used] - 1.0}


@dataclass(frozen=True, eq=False)
class Shapes(_OfModes):
    """r = W (c phi - measured phi), the scale c of each mode eliminated (`shape_residual`)."""

    noise = NoiseKind(
        "mode_shape", "mode shapes", DEFAULT_MODE_SHAPE_STD, 0.15,
        "calibrated sensors show entries to 1 % of the largest; 15 % is more than an uncalibrated one is off",
        (
            ErrorFigure("min_mac", "smallest modal assurance criterion (MAC)", "mac", np.min, relative=False),
            ErrorFigure("max_shape_error", "largest mode-shape error", "shape_error", largest),
        ),
        negligible=1e-4,
    )  # fmt: skip

    @classmethod
    def of(cls, experiment: Experiment) -> Sequence[Shapes]:
        """List the shapes of each configuration that has one."""
        return [
            cls(each, np.asarray(each.measured.any(axis=1)))
            for each in experiment.configurations
            if each.measured.any()
        ]

    @property
    def count(self) -> int:
        """Entries, less one a mode whose scale is free."""
        entries = np.sum(self.tested.measured[self.used], axis=1)
        return int(np.sum(np.maximum(entries - (0 if self.tested.mass_normalized else 1), 0)))

    def _seen(self, model: Model) -> Floats:
        """Return the modelled shapes as sensors would show them, on the model's scale, shape (used, n)."""
        shapes = model.modes.shapes[model.paired[self.used]]
        return model.state.observation.shown(shapes, self.tested.entry_rows)

    def seen(self, model: Model) -> Floats:
        """Return the modelled shapes as sensors would show them, on the measured ones' scale, shape (used, n)."""
        psi, measured, weights = self._seen(model), self.tested.known_shapes, self.tested.entry_weights
        scale, _ = scaled(measured[self.used], psi, weights[self.used], mass_normalized=self.tested.mass_normalized)
        return scale[:, None] * psi

    @property
    def floors(self) -> Ints:
        """Floor of each entry, mode by mode."""
        return np.tile(self.tested.entry_floors, int(self.used.sum()))

    @property
    def known(self) -> Bools:
        """Entries that are not nan, mode by mode."""
        return self.tested.measured[self.used].ravel()

    def residual(self, model: Model) -> Residual:
        """Differences of entries over their standard deviations; zero for missing entries."""
        return self.inflated_residual(model, np.ones(len(self.floors)))

    def inflated_residual(self, model: Model, factor: Floats) -> Residual:
        """Compute `residual`, the scale of each shape following the entries that have become less certain."""
        measured = self.tested.known_shapes[self.used]
        weights = self.tested.entry_weights[self.used] / factor.reshape(measured.shape)
        slopes = None
        if model.derivatives:
            shapes, moved = model.modes.shapes[model.paired[self.used]], model.mode_derivatives[1][:, self.used]
            rows = self.tested.entry_rows
            slopes = model.state.observation.shown_slopes(shapes, moved, model.by, rows)
        normalized = self.tested.mass_normalized
        return Residual(*shape_residual(measured, self._seen(model), weights, slopes, mass_normalized=normalized))

    def errors(self, model: Model) -> Mapping[str, Floats]:
        """MAC of each shape known at two floors, and the largest difference of an entry of each."""
        known, measured = self.tested.measured[self.used], self.tested.known_shapes[self.used]
        modelled = np.where(known, self.seen(model), 0.0)
        lengths = np.sum(measured**2, axis=1) * np.sum(modelled**2, axis=1)
        several = np.sum(known, axis=1) > 1
        criteria = np.sum(measured * modelled, axis=1)[several] ** 2 / lengths[several]
        return {"mac": criteria, "shape_error": shape_errors(measured, modelled)}


def shape_errors(measured: Floats, modelled: Floats) -> Floats:
    """Largest difference of each mode, shape (m,).

    The measured shape is scaled to a largest entry of 1, the model's to it by least squares; entries that were not
    measured are zero in both.
    """
    unit = measured / measured[np.arange(len(measured)), ranking.largest(np.abs(measured))][:, None]
    scale = np.sum(unit * modelled, axis=1) / np.sum(modelled**2, axis=1)
    return np.asarray(np.max(np.abs(scale[:, None] * modelled - unit), axis=1))


@dataclass(frozen=True, eq=False)
class Static(Datum):
    """r = (K^-1 f - measured u) / std, with du = -K^-1 dK u.

    Parameters
    ----------
    tested : StaticTest
    """

    noise = NoiseKind(
        "displacement", "displacements", DEFAULT_DISPLACEMENT_STD, 0.15,
        "dial gauges and load cells are good to 1 % of the largest reading; 15 % is a wire's slack or a soft support",
        (ErrorFigure("max_displacement_error", "largest displacement error", "displacement_error", largest),),
        negligible=1e-4,
    )  # fmt: skip
    tested: StaticTest

    @classmethod
    def of(cls, experiment: Experiment) -> Sequence[Static]:
        """List the static tests."""
        return [cls(each) for each in experiment.static]

    @property
    def count(self) -> int:
        """Number of measured displacements."""
        return len(self.floors)

    @property
    def floors(self) -> Ints:
        """Floors with a measured displacement."""
        return np.flatnonzero(self.tested.measured) + 1

    def residual(self, model: Model) -> Residual:
        """Differences of displacements over their standard deviations, measured floors only."""
        test, known = self.tested, self.tested.measured
        system = model.wanted
        weights = 1.0 / test.entry_std[known]
        u = _moved(system.K, test.force)
        n = len(test.force)
        r = weights * (u[:n] - test.displacement)[known]
        if not model.derivatives:
            return Residual(r, np.zeros((0, 0)))
        slopes: Floats = -linalg.solve(system.K, system.stiffness_slopes(u).T, assume_a="sym")
        return Residual(r, weights[:, None] * slopes[:n][known])

    def errors(self, model: Model) -> Mapping[str, Floats]:
        """model / measured - 1, relative to the largest measured displacement."""
        test, known = self.tested, self.tested.measured
        u = _moved(model.state.system.K, test.force)[: len(test.force)]
        return {"displacement_error": (u - test.displacement)[known] / np.max(np.abs(test.displacement[known]))}

    @property
    def parts(self) -> list[str]:
        """The measured floors."""
        return [f"floor {floor}" for floor in self.floors]


def _moved(K: Floats, force: Floats) -> Floats:
    """Displacements of all motions under forces on the floors, which come first, m."""
    load = np.concatenate([force, np.zeros(len(K) - len(force))])
    return np.asarray(linalg.solve(K, load, assume_a="sym"))
