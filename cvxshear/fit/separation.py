"""Distance between models of one frame in a test that was not made.

The predictions of two models differ by d, in standard deviations of the test's noise. The uncertainty of each model
moves its own prediction along columns S, one standard deviation per column. So d has the covariance 1 + S S', and the
distance between the models, in standard deviations, is

    D = sqrt(d' (1 + S S')^-1 d).

The same formula holds for effects before any fit: d is then the change of the data by each effect, and S the possible
change by the frame's masses and stiffnesses.

The information of such a test about one effect is the linear model y = G x + e, with the effect's value x, G = D^2 at x
= 1 and var(e) = G. `log_evidence` is the ratio of the probabilities of y with and without the effect: the evidence of
the loop, where Laplace's approximation is exact.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from cvxshear.data import Frequencies, Shapes
from cvxshear.data.pairing import numbered
from cvxshear.effects import compose
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.misfit import Misfit
from cvxshear.measurement.configuration import DEFAULT_MODE_SHAPE_STD
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model.shear import modes
from cvxshear.util.typing import Bools, Floats, Ints


def separation(differences: Floats, uncertain: Floats) -> Floats:
    """Compute squared distances of models, d' (1 + S S')^-1 d; entries off the diagonal are their scalar products.

    Parameters
    ----------
    differences : ndarray, shape (k, e)
        d, a column a model, in standard deviations of the noise.
    uncertain : ndarray, shape (k, q)
        S.

    Returns
    -------
    ndarray, shape (e, e)
    """
    k, q = uncertain.shape
    if k <= q:
        # The left singular vectors of S span all k dimensions, and no large variance is inverted.
        left, values, _ = np.linalg.svd(uncertain, full_matrices=False)
        along = (left.T @ differences) / np.hypot(1.0, values)[:, None]
        return np.asarray(along.T @ along, dtype=np.float64)
    # The same as the residual of d after a regularized fit by the columns of S.
    basis = np.linalg.qr(np.concatenate([uncertain, np.eye(q)]))[0]
    left = np.concatenate([differences, np.zeros((q, differences.shape[1]))])
    left = left - basis @ (basis.T @ left)
    return np.asarray(left.T @ left, dtype=np.float64)


def log_evidence(information: float, y: Floats, mean: float, std: float, side: int = 0) -> Floats:
    """Compute the log evidence ratio of the models with and without an effect of one parameter.

    With a normal prior of the effect's value x about `mean`, and data y with var(y) = G,

        (1 + s^2 G)^(-1/2) exp(m^2 / (2 v) - mean^2 / (2 s^2)),  v = 1 / (G + 1 / s^2),  m = v (y + mean / s^2),

    times 2 Phi(m / sqrt(v)) if physics allows values on one side of zero only.

    Parameters
    ----------
    information : float
        G, about the effect's value, with the frame marginalized.
    y : ndarray
        G x + e.
    mean, std : float
        Prior of the effect's value.
    side : int, optional
        1 or -1 if the value can only be on that side of zero, else 0.

    Returns
    -------
    ndarray
        Log evidence ratios, in the shape of y.
    """
    v = 1 / (information + 1 / std**2)
    m = v * (y + mean / std**2)
    found: Floats = m**2 / (2 * v) - mean**2 / (2 * std**2) - np.log1p(std**2 * information) / 2
    return found if side == 0 else found + np.log(2) + log_ndtr(side * m / np.sqrt(v))


@dataclass(frozen=True, eq=False)
class Disagreement:
    """Difference of two models' predictions of a test with sensors at every floor.

    Parameters
    ----------
    difference : ndarray, shape (m + m N,)
        Differences in standard deviations of the noise: frequencies, then the entries of each shape.
    uncertain : ndarray, shape (m + m N, q)
        Uncertainty of the fits, one standard deviation per column.
    shapes : ndarray, shape (m, N)
        Shapes in standard deviations of the entries.
    seen : ndarray of bool, shape (m, N)
        Entries that a sensor at their floor would show.
    free_scale : bool
        Whether the scales of the shapes are free.
    """

    difference: Floats
    uncertain: Floats
    shapes: Floats
    seen: Bools
    free_scale: bool

    def at(self, floors: Ints) -> float:
        """Count the standard deviations between the models with sensors at these floors, zero-based."""
        m, n = self.shapes.shape
        measured = np.zeros((m, n), dtype=bool)
        measured[:, floors] = self.seen[:, floors]
        rows = np.concatenate([np.arange(m), m + np.flatnonzero(measured)])
        both = np.column_stack([self.difference, self.uncertain])[rows]
        if self.free_scale:
            for mode in range(m):
                # The component along a shape is its scale.
                own = slice(m + int(measured[:mode].sum()), m + int(measured[: mode + 1].sum()))
                along = self.shapes[mode, measured[mode]]
                length = float(along @ along)
                if length > 0:
                    both[own] -= np.outer(along, along @ both[own]) / length
        return float(np.sqrt(separation(both[:, :1], both[:, 1:])[0, 0]))


def disagreement(accepted: Estimate, rival: Estimate, test: Configuration, first: Configuration) -> Disagreement:
    """Compare the predictions of two fits for a test.

    Parameters
    ----------
    accepted, rival : Estimate
        Fits of one frame.
    test : Configuration
        Test from `imagined`.
    first : Configuration
        The configuration that it repeats with other masses.

    Raises
    ------
    NoModesError
        If a model buckles under these masses.
    """
    alone = _by_itself(accepted, test)
    mine = Misfit(alone, accepted.effects).evaluate(accepted.theta)
    other = Misfit(alone, rival.effects).evaluate(rival.theta)
    m, n = test.mode_shapes.shape
    rows = slice(0, m + m * n)
    seen = np.ones((m, n), dtype=bool)
    # An entry that was not measured at an instrumented floor will not be measured there again.
    seen[:, first.measured_floors - 1] = first.measured
    return Disagreement(
        other.r[rows] - mine.r[rows],
        np.hstack([_carried(mine.J[rows], accepted), _carried(other.J[rows], rival)]),
        test.entry_weights * test.mode_shapes,
        seen if first.measured.any() else np.zeros((m, n), dtype=bool),
        not first.mass_normalized,
    )


def imagined(accepted: Estimate, first: Configuration, added_mass: Floats) -> Configuration:
    """Make a configuration with these masses, measured at every floor as a fit predicts.

    Parameters
    ----------
    accepted : Estimate
    first : Configuration
        Configuration with the state, modes and noise of the test; floors without a sensor get the mean noise.
    added_mass : ndarray, shape (N,)
        kg, in all.

    Raises
    ------
    NoModesError
        If the model buckles under these masses.
    """
    noise = accepted.misfit.noise
    blank = dataclasses.replace(first, name="next test", added_mass=added_mass)
    state = compose(accepted.experiment, blank, accepted.effects, accepted.theta, derivatives=False)
    found = modes(state.system.M, state.system.K)
    which = numbered(first, found, state.system.M)
    shapes = state.observation.shown(found.shapes[which])
    measured = dataclasses.replace(
        blank, mode_shapes=np.where(first.measured, shapes[:, first.measured_floors - 1], np.nan)
    )
    frequency = 1.0 if first.frequency_std is not None else noise.of(Frequencies.noise.name)
    shape = 1.0 if first.mode_shape_std is not None else noise.of(Shapes.noise.name)
    return dataclasses.replace(
        blank,
        frequencies=found.frequencies[which],
        measured_floors=np.arange(1, shapes.shape[1] + 1),
        mode_shapes=shapes,
        frequency_std=frequency * first.log_frequency_std,
        mode_shape_std=shape * _everywhere(measured, shapes),
        mode_shape_noise="additive",
        # `Disagreement.at` frees the scale over the measured floors.
        mass_normalized=True,
    )


def _everywhere(measured: Configuration, shapes: Floats) -> Floats:
    """Return the standard deviations of a mode's entries at every floor over its largest entry, shape (m, N)."""
    std = np.full(shapes.shape, np.nan)
    std[:, measured.measured_floors - 1] = np.where(measured.measured, measured.entry_std, np.nan)
    relative = std / np.max(np.abs(shapes), axis=1, keepdims=True)
    known = np.isfinite(relative)
    if not known.any():
        return np.full(shapes.shape, DEFAULT_MODE_SHAPE_STD)
    overall = float(relative[known].mean())
    own = [float(row[some].mean()) if some.any() else overall for row, some in zip(relative, known, strict=True)]
    return np.where(known, relative, np.array(own)[:, None])


def _carried(J: Floats, estimate: Estimate) -> Floats:
    """Return the changes of predictions by the uncertainty of a fit, one standard deviation per column."""
    values, axes = np.linalg.eigh(estimate.uncertainty.covariance())
    result: Floats = J @ (axes * np.sqrt(np.maximum(values, 0.0)))
    return result


def _by_itself(accepted: Estimate, test: Configuration) -> Experiment:
    """Return the test as its own experiment, of a frame with the declared total mass, or else the total of the fit."""
    declared = accepted.experiment.frame
    total = declared.total_mass or float(accepted.theta[: accepted.experiment.stories].sum())
    frame = dataclasses.replace(
        declared, reference=None, total_mass=None if declared.floor_masses is not None else total
    )
    return Experiment(frame, (test,))
