"""A test that was not made: the data that a model expects, and the rows that the test would add to a fit.

The test is written as a configuration that is measured at every floor exactly as the model predicts, so the data
themselves (`cvxshear.data`) give the rows: derivatives by the parameters, or differences from another model, in
standard deviations of the test's noise. Sensors at some floors choose among these rows; the free scale of each shape is
eliminated over the floors that have a sensor.

`plan` adds the rows of a test to the information about a frame. `next_test` compares two fits: their predictions differ
by d, and the uncertainty of each fit moves its own prediction along columns S, one standard deviation per column.
`fit/gaussian.py` has the distance of the fits.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.data import Frequencies, Model, Residual, Shapes
from cvxshear.data.pairing import numbered
from cvxshear.effects import LocatedEffect, compose
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.util.typing import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class ExpectedTest:
    """A test that was not made, and rows of its data.

    Parameters
    ----------
    test : Configuration
        Measured at every floor as the model predicts, with the noise of the test.
    rows : ndarray, shape (m + m N, k)
        Columns in standard deviations: frequencies, then the entries of each shape.
    seen : ndarray of bool, shape (m, N)
        Entries that a sensor at their floor would show.
    free_scale : bool
        Whether the scales of the shapes are free.
    """

    test: Configuration
    rows: Floats
    seen: Bools
    free_scale: bool = True

    @property
    def entries(self) -> Floats:
        """Derivatives of the entries by the logarithm of their mode's scale, in standard deviations, shape (m, N)."""
        return self.test.entry_weights * self.test.mode_shapes

    @property
    def frequency_rows(self) -> Floats:
        """Rows of the frequencies, shape (m, k)."""
        return self.rows[: len(self.test.frequencies)]

    @property
    def shape_rows(self) -> Floats:
        """Rows of the entries, shape (m, N, k)."""
        return self.rows[len(self.test.frequencies) :].reshape(*self.seen.shape, -1)

    def at(self, floors: Ints) -> Floats:
        """Return the rows of a test with sensors at these floors, zero-based, free of the free scales."""
        here = np.isin(np.arange(self.seen.shape[1]), floors) & self.seen
        entries, rows = np.where(here, self.entries, 0.0), self.shape_rows
        if self.free_scale:
            length = np.linalg.norm(entries, axis=1, keepdims=True)
            unit = entries / np.where(length > 0, length, 1.0)
            rows = rows - unit[:, :, None] * np.einsum("mj,mjk->mk", unit, rows)[:, None]
        return np.concatenate([self.frequency_rows, rows[here]])


def tested_model(experiment: Experiment, test: Configuration, effects: Sequence[LocatedEffect], theta: Floats) -> Model:
    """Return the model of a test.

    Raises
    ------
    NoModesError
        If the model buckles under the test's masses.
    """
    return Model(compose(experiment, test, effects, theta), slice(None), derivatives=True)


def predicted_modes(test: Configuration, model: Model) -> tuple[Floats, Floats]:
    """Return the frequencies, shape (m,), of a test's modes, and the shapes as sensors on every floor see them, (m, N).

    The modes have the test's numbers, whatever shapes it measured.
    """
    which = numbered(test, model.modes, model.state.system.M)
    return model.modes.frequencies[which], model.state.observation.shown(model.modes.shapes[which])


def expected_configuration(
    blank: Configuration, frequencies: Floats, shapes: Floats, frequency_std: Floats, shape_std: Floats
) -> Configuration:
    """Fill in a configuration at every floor.

    Parameters
    ----------
    blank : Configuration
        Its masses, modes and state stay.
    frequencies, shapes : ndarray, shapes (m,) and (m, N)
    frequency_std, shape_std : ndarray, shapes (m,) and (m, N)
        Relative; relative to a mode's largest entry over all floors.
    """
    return dataclasses.replace(
        blank,
        frequencies=frequencies,
        measured_floors=np.arange(1, shapes.shape[1] + 1),
        mode_shapes=shapes,
        frequency_std=frequency_std,
        mode_shape_std=shape_std,
        mode_shape_noise="additive",
        # `ExpectedTest.at` frees the scale over the floors that have a sensor.
        mass_normalized=True,
    )


def data_rows(test: Configuration, model: Model) -> Residual:
    """Return differences and derivatives of a model's frequencies and shapes in a test, in standard deviations."""
    every = np.ones(len(test.frequencies), dtype=bool)
    frequencies, shapes = (kind(test, every).residual(model) for kind in (Frequencies, Shapes))
    return Residual(np.concatenate([frequencies.r, shapes.r]), np.concatenate([frequencies.J, shapes.J]))
