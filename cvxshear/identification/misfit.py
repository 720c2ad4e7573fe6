"""Measured against modelled: standardized residuals over all configurations together, and their derivatives.

Data are the logarithms of the frequencies, the mode shapes up to one scale a mode, and the soft priors,
each divided by its standard deviation. The scale c_j of a measured mode is eliminated: at the c_j of least
squares the residual of the shape is (1 - u u') W phi_measured with u = W phi / |W phi|, and since the sum of
squares is stationary in c_j its gradient is J' r with J = (1 - u u') W c_j dphi (Golub and Pereyra, 1973, in
Kaufman's form).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.optimize import linear_sum_assignment

from cvxshear.effects import Placed, compose
from cvxshear.errors import InputError
from cvxshear.experiment import Configuration, Experiment
from cvxshear.frame import Modes, System, mode_derivatives, modes
from cvxshear.typing import Bools, Floats, Ints

PAIRED = 0.5
"""Modal assurance criterion below which a measured mode is looked for among the other modes of the model."""


@dataclass(frozen=True, eq=False)
class Target:
    """What one configuration measured, weighted, an entry without measurement having weight zero.

    Parameters
    ----------
    configuration : Configuration
    log_frequencies, frequency_weights : ndarray, shape (m,)
    shapes, weights : ndarray, shape (m, n)
    floors, modes : ndarray of int, shapes (n,) and (m,)
        Zero-based.
    """

    configuration: Configuration
    log_frequencies: Floats
    frequency_weights: Floats
    shapes: Floats
    weights: Floats
    floors: Ints
    modes: Ints

    @staticmethod
    def of(configuration: Configuration) -> Target:
        """The targets of a configuration that is part of an experiment."""
        known = configuration.measured
        with np.errstate(invalid="ignore"):
            weights = np.where(known, 1.0 / np.where(known, configuration.entry_std, 1.0), 0.0)
        return Target(
            configuration,
            np.log(configuration.frequencies),
            1.0 / configuration.log_frequency_std,
            np.where(known, configuration.mode_shapes, 0.0),
            weights,
            configuration.measured_floors - 1,
            configuration.modes - 1,
        )

    @property
    def count(self) -> int:
        """Number of data: frequencies, and shape entries less one a mode whose scale is free."""
        entries = np.sum(self.weights > 0, axis=1)
        free = 0 if self.configuration.mass_normalized else 1
        return len(self.log_frequencies) + int(np.sum(np.maximum(entries - free, 0)))


@dataclass(frozen=True, eq=False)
class Match:
    """One configuration of the model beside its measurement.

    Parameters
    ----------
    modes : Modes
        Of the model, all of them.
    paired : ndarray of int, shape (m,)
        Which mode of the model each measured one is, zero-based.
    seen : ndarray, shape (m, n)
        The modelled shapes as the sensors would show them, scaled to the measured ones.
    """

    modes: Modes
    paired: Ints
    seen: Floats


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Residuals at one point.

    Parameters
    ----------
    r : ndarray, shape (d,)
        Model less measurement in standard deviations.
    J : ndarray, shape (d, P)
        dr/dtheta, its columns those asked for; of no rows where none was.
    matches : tuple of Match
        One a configuration.
    """

    r: Floats
    J: Floats
    matches: tuple[Match, ...] = field(default=())

    @property
    def chi2(self) -> float:
        """Sum of squares of the residuals."""
        return float(self.r @ self.r)

    @cached_property
    def triangle(self) -> tuple[Floats, Floats]:
        """U and c with |J x + r|^2 = |U x + c|^2 + constant for every x: J = Q U, c = Q' r, at most P rows.

        All that a step and its uncertainty need of J; there are many more data than parameters.
        """
        whole = np.asarray(np.linalg.qr(np.column_stack([self.J, self.r]), mode="r"))
        P = self.J.shape[1]
        return whole[:P, :P], whole[:P, P]


class Misfit:
    """The residuals of an experiment under a model with these effects.

    Parameters
    ----------
    experiment : Experiment
    effects : sequence of Placed
    leave_out : array of bool for each configuration, optional
        Modes of a configuration that are not to count, by its name.
    """

    def __init__(
        self, experiment: Experiment, effects: Sequence[Placed] = (), leave_out: dict[str, Bools] | None = None
    ) -> None:
        self.experiment = experiment
        self.effects = tuple(effects)
        self.targets = [
            _without(Target.of(each), (leave_out or {}).get(each.name)) for each in experiment.configurations
        ]

    @property
    def parameters(self) -> int:
        """Number P of parameters: floor masses, story stiffnesses, and those of the effects."""
        return 2 * self.experiment.stories + sum(len(placed.effect.parameters) for placed in self.effects)

    def count(self, theta: Floats) -> int:
        """Number of data, soft priors included."""
        return sum(target.count for target in self.targets) + len(self._soft(theta)[0])

    def evaluate(self, theta: Floats, *, derivatives: bool = True, by: slice = slice(None)) -> Evaluation:
        """Residuals, and their derivatives unless told otherwise.

        Parameters
        ----------
        theta : ndarray, shape (P,)
            Floor masses without added mass, story stiffnesses, effect parameters.
        derivatives : bool, optional
        by : slice, optional
            The parameters by which derivatives are wanted, all where not given.

        Raises
        ------
        InputError
            Where the model has no modes there: a mass is not positive, or the frame would buckle.
        """
        n = self.experiment.stories
        if np.any(theta[: 2 * n] <= 0):
            raise InputError("floor masses and story stiffnesses must be positive")
        parts, rows, matches = [], [], []
        for target in self.targets:
            state = compose(self.experiment, target.configuration, self.effects, theta, derivatives=derivatives)
            found = modes(state.system.M, state.system.K)
            paired = _paired(target, found, state.gain)
            psi = found.shapes[np.ix_(target.floors, paired)].T * state.gain[target.floors]
            scale, unit = _scales(target, psi)
            frequency = 0.5 * np.log(found.eigenvalues[paired]) - np.log(2 * np.pi) - target.log_frequencies
            shape = target.weights * (scale[:, None] * psi - target.shapes)
            parts += [frequency * target.frequency_weights, shape.ravel()]
            matches.append(Match(found, paired, scale[:, None] * psi))
            if derivatives:
                system, d_gain = state.system, state.d_gain[by]
                dlam, dphi = mode_derivatives(found, System(system.M, system.K, system.dM[by], system.dK[by]), paired)
                rows.append((dlam * (0.5 * target.frequency_weights / found.eigenvalues[paired])).T)
                dpsi = dphi[:, target.floors].transpose(0, 2, 1) * state.gain[target.floors]
                dpsi += psi / state.gain[target.floors] * d_gain[:, None, target.floors]
                dshape = target.weights * scale[:, None] * dpsi
                if unit is not None:
                    dshape -= unit * np.sum(unit * dshape, axis=2, keepdims=True)
                rows.append(dshape.reshape(len(dlam), -1).T)
        r, J = self._soft(theta)
        return Evaluation(
            np.concatenate([*parts, r]),
            np.concatenate([*rows, J[:, by]]) if derivatives else np.zeros((0, len(theta))),
            tuple(matches),
        )

    def _soft(self, theta: Floats) -> tuple[Floats, Floats]:
        """The soft priors as data."""
        n = self.experiment.stories
        residuals, rows = [np.zeros(0)], [np.zeros((0, len(theta)))]
        for prior in self.experiment.priors:
            at = slice(0, n) if prior.quantity == "floor_mass" else slice(n, 2 * n)
            r, J = prior.residual(theta[at])
            row = np.zeros((len(r), len(theta)))
            row[:, at] = J
            residuals.append(r)
            rows.append(row)
        return np.concatenate(residuals), np.concatenate(rows)


def _without(target: Target, left_out: Bools | None) -> Target:
    """The target without some of its modes."""
    if left_out is None:
        return target
    keep = ~left_out
    return Target(
        target.configuration,
        target.log_frequencies[keep],
        target.frequency_weights[keep],
        target.shapes[keep],
        target.weights[keep],
        target.floors,
        target.modes[keep],
    )


def _scales(target: Target, psi: Floats) -> tuple[Floats, Floats | None]:
    """The scale of each modelled shape and the unit vectors u; only a sign where the scale was measured."""
    weighted = target.weights * psi
    overlap = np.sum(weighted * target.weights * target.shapes, axis=1)
    if target.configuration.mass_normalized:
        return np.where(overlap < 0, -1.0, 1.0), None
    length = np.sum(weighted**2, axis=1)
    safe = np.where(length > 0, length, 1.0)
    return overlap / safe, weighted / np.sqrt(safe)[:, None]


def _paired(target: Target, found: Modes, gain: Floats) -> Ints:
    """Which mode of the model each measured one is.

    The declared numbers hold unless a shape speaks against them; modes that changed places are then paired
    by the assignment of the largest modal assurance criteria among the declared ones.
    """
    declared = target.modes
    if len(declared) < 2 or len(target.floors) < 2:
        return declared
    psi = found.shapes[np.ix_(target.floors, declared)].T * gain[target.floors]
    modelled, measured = target.weights * psi, target.weights * target.shapes
    own = np.sum(modelled * measured, axis=1) ** 2
    if np.all(own >= PAIRED * np.sum(modelled**2, axis=1) * np.sum(measured**2, axis=1)):
        return declared
    weight2 = target.weights**2
    cross = (weight2 * target.shapes) @ psi.T
    with np.errstate(divide="ignore", invalid="ignore"):
        mac = cross**2 / (np.sum(measured**2, axis=1)[:, None] * (weight2 @ (psi**2).T))
    known = np.sum(target.weights > 0, axis=1) > 1
    mac = np.where(known[:, None] & np.isfinite(mac), mac, np.eye(len(declared)))
    if np.all(np.diag(mac) >= PAIRED):
        return declared
    _, columns = linear_sum_assignment(-mac)
    paired: Ints = declared[columns]
    return paired
