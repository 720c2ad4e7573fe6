"""Mode shapes, each up to its own scale, or with it where they are mass-normalized."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.data.base import Datum, Deviation, ErrorFigure, Model, NoiseKind, Residual, largest
from cvxshear.data.pairing import scaled, shape_residual
from cvxshear.measurement.configuration import DEFAULT_MODE_SHAPE_STD
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.util import ranking
from cvxshear.util.typing import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Shapes(Datum):
    """r = W (c phi - measured phi), the scale c of each mode eliminated (`data/pairing.py:shape_residual`).

    Parameters
    ----------
    tested : Configuration
    used : ndarray of bool, shape (m,)
        Which of its modes count.
    """

    noise = NoiseKind(
        "mode_shape", "mode shapes", DEFAULT_MODE_SHAPE_STD, 0.15,
        "calibrated sensors show entries to 1 % of the largest; 15 % is more than an uncalibrated one is off",
        (
            ErrorFigure("min_mac", "smallest modal assurance criterion (MAC)", "mac", np.min, relative=False),
            ErrorFigure("max_shape_error", "largest mode-shape error", "shape_error", largest),
        ),
        negligible=1e-4,
    )  # fmt: skip
    tested: Configuration
    used: Bools

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
        return model.state.observation.shown(shapes, self.tested.measured_floors - 1)

    def seen(self, model: Model) -> Floats:
        """Return the modelled shapes as sensors would show them, on the measured ones' scale, shape (used, n)."""
        psi = self._seen(model)
        scale, _ = scaled(self.tested.known_shapes[self.used], psi, self.tested.entry_weights[self.used])
        if self.tested.mass_normalized:
            scale = np.where(scale < 0, -1.0, 1.0)
        return scale[:, None] * psi

    @property
    def floors(self) -> Ints:
        """Floor of each entry, mode by mode."""
        return np.tile(self.tested.measured_floors, int(self.used.sum()))

    @property
    def known(self) -> Bools:
        """Entries that are not nan, mode by mode."""
        return self.tested.measured[self.used].ravel()

    def residual(self, model: Model) -> Residual:
        """Differences of entries over their standard deviations; zero for missing entries."""
        return self.widened_residual(model, np.ones(len(self.floors)))

    def widened_residual(self, model: Model, factor: Floats) -> Residual:
        """Compute `residual`, the scale of each shape following the entries that have become less certain."""
        measured = self.tested.known_shapes[self.used]
        weights = self.tested.entry_weights[self.used] / factor.reshape(measured.shape)
        slopes = None
        if model.derivatives:
            shapes, moved = model.modes.shapes[model.paired[self.used]], model.mode_derivatives[1][:, self.used]
            floors = self.tested.measured_floors - 1
            slopes = model.state.observation.shown_slopes(shapes, moved, model.by, floors)
        normalized = self.tested.mass_normalized
        return Residual(*shape_residual(measured, self._seen(model), weights, slopes, mass_normalized=normalized))

    def errors(self, model: Model) -> Mapping[str, Floats]:
        """MAC of each shape known at two floors, and the largest difference of an entry of each."""
        measured, modelled = self._known_entries(model)
        lengths = np.sum(measured**2, axis=1) * np.sum(modelled**2, axis=1)
        several = np.sum(self.tested.measured[self.used], axis=1) > 1
        criteria = np.sum(measured * modelled, axis=1)[several] ** 2 / lengths[several]
        return {"mac": criteria, "shape_error": shape_errors(measured, modelled)}

    def _known_entries(self, model: Model) -> tuple[Floats, Floats]:
        """Measured and modelled shapes, zero for missing entries."""
        return self.tested.known_shapes[self.used], np.where(self.tested.measured[self.used], self.seen(model), 0.0)

    def without(self, left_out: Bools) -> Shapes:
        """Leave out these modes."""
        return Shapes(self.tested, self.used & ~left_out)

    def describe(self, model: Model) -> list[Deviation]:
        """Describe each mode."""
        z = self.residual(model).r.reshape(int(self.used.sum()), -1)
        known = self.tested.measured[self.used]
        errors = shape_errors(*self._known_entries(model))
        return [
            Deviation(
                self.noise.name,
                self.tested.name,
                f"mode {mode}",
                float(error),
                float(np.sqrt(np.mean(row[there] ** 2))),
                int(there.sum()),
            )
            for mode, row, error, there in zip(self.tested.modes[self.used], z, errors, known, strict=True)
        ]


def shape_errors(measured: Floats, modelled: Floats) -> Floats:
    """Largest difference of each mode, shape (m,).

    The measured shape is scaled to a largest entry of 1, the model's to it by least squares; entries that were not
    measured are zero in both.
    """
    unit = measured / measured[np.arange(len(measured)), ranking.largest(np.abs(measured))][:, None]
    scale = np.sum(unit * modelled, axis=1) / np.sum(modelled**2, axis=1)
    return np.asarray(np.max(np.abs(scale[:, None] * modelled - unit), axis=1))
