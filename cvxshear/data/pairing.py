"""Which mode of the model a measured one is, and the residuals of frequencies and shapes with their derivatives."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from cvxshear.measurement.experiment import Configuration
from cvxshear.model.shear import Modes, Observation, attached_share, frame_modes
from cvxshear.util import ranking
from cvxshear.util.typing import Complexes, Floats, Ints

PAIRED = 0.5
"""Minimum modal assurance criterion of a measured mode and its mode in the model; below it, the other modes are
searched."""


SHARED = 0.1
"""Minimum share of an attached mass in the kinetic energy of a mode shared with the frame. A mode with less resembles a
mode of the frame alone, and with more than 1 - SHARED a mode of the mass alone."""


def mac(first: Floats | Complexes, second: Floats | Complexes) -> float:
    """Modal assurance criterion |a^H b|^2 / (a^H a b^H b) of two shapes (Allemang and Brown 1982)."""
    product = abs(np.vdot(first, second)) ** 2
    return float(product / (np.vdot(first, first).real * np.vdot(second, second).real))


def scaled(measured: Floats, modelled: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Scales by least squares, and the unit vectors u, of each row.

    Parameters
    ----------
    measured, modelled, weights : ndarray, shape (m, n)
        Weight zero for missing entries.

    Returns
    -------
    scale : ndarray, shape (m,)
    unit : ndarray, shape (m, n)
    """
    weighted = weights * modelled
    length = np.sum(weighted**2, axis=1)
    safe = np.where(length > 0, length, 1.0)
    return np.sum(weighted * weights * measured, axis=1) / safe, weighted / np.sqrt(safe)[:, None]


def frequency_residual(
    log_omega: Floats, eigenvalues: Floats, std: Floats, slopes: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return differences of log frequencies in standard deviations, with derivatives dlambda / (2 lambda).

    Parameters
    ----------
    log_omega : ndarray, shape (m,)
        Logarithms of the measured circular frequencies.
    eigenvalues : ndarray, shape (m,)
        Squares of the modelled circular frequencies.
    std : ndarray, shape (m,)
    slopes : ndarray, shape (p, m), optional
        Derivatives of the eigenvalues.

    Returns
    -------
    r : ndarray, shape (m,)
    J : ndarray, shape (m, p)
        Of no rows without `slopes`.
    """
    r = (0.5 * np.log(eigenvalues) - log_omega) / std
    return r, np.zeros((0, 0)) if slopes is None else (slopes * (0.5 / (std * eigenvalues))).T


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
    scale, unit = scaled(measured, modelled, weights)
    if mass_normalized:
        scale = np.where(scale < 0, -1.0, 1.0)
    r = (weights * (scale[:, None] * modelled - measured)).ravel()
    if slopes is None:
        return r, np.zeros((0, 0))
    J = weights * scale[:, None] * slopes
    if not mass_normalized:
        J = J - unit * np.sum(unit * J, axis=2, keepdims=True)
    return r, J.reshape(len(J), r.size).T


def numbered(configuration: Configuration, found: Modes, M: Floats) -> Ints:
    """Find the modes of the model that a configuration's mode numbers mean, zero-based, shape (m,).

    Numbers count the modes of the frame, without the own mode of a mass that is attached to a floor. Where that mass
    shares its energy among several modes, as one that is tuned to a mode does, each of them may be the one that was
    not measured; the numbers are then those that fit the measured frequencies best.
    """
    floors = len(configuration.added_mass)
    declared = configuration.modes - 1
    if len(M) == floors:
        return declared
    if len(M) == floors + 1:
        share = attached_share(found, M, floors)
        every = np.arange(floors + 1)
        unseen = set(np.flatnonzero(share >= SHARED).tolist())
        if share.max() <= 1.0 - SHARED:
            unseen.add(floors)
        log_found, measured = np.log(found.frequencies), np.log(configuration.frequencies)
        candidates = [np.delete(every, mode)[declared] for mode in sorted(unseen)]
        return ranking.ranked(candidates, lambda each: -float(np.sum((log_found[each] - measured) ** 2)))[0]
    return np.asarray(frame_modes(found, M, floors)[declared])


def paired(configuration: Configuration, found: Modes, observation: Observation, M: Floats) -> Ints:
    """Which mode of the model each measured one is, zero-based.

    The declared numbers hold unless a shape speaks against them; modes that changed places are then paired
    by the assignment of the largest modal assurance criteria among the declared ones.

    Parameters
    ----------
    configuration : Configuration
    found : Modes
    observation : Observation
        What the sensors show of the modes.
    M : ndarray, shape (n, n)
    """
    declared = numbered(configuration, found, M)
    floors = configuration.measured_floors - 1
    if len(declared) < 2 or len(floors) < 2 or not configuration.measured.any():
        return declared
    weights, shapes = configuration.entry_weights, configuration.known_shapes
    psi = observation.shown(found.shapes[declared], floors)
    modelled, measured = weights * psi, weights * shapes
    own = np.sum(modelled * measured, axis=1) ** 2
    if np.all(own >= PAIRED * np.sum(modelled**2, axis=1) * np.sum(measured**2, axis=1)):
        return declared
    cross = (weights**2 * shapes) @ psi.T
    with np.errstate(divide="ignore", invalid="ignore"):
        criteria = cross**2 / (np.sum(measured**2, axis=1)[:, None] * (weights**2 @ (psi**2).T))
    known = np.sum(weights > 0, axis=1) > 1
    criteria = np.where(known[:, None] & np.isfinite(criteria), criteria, np.eye(len(declared)))
    if np.all(np.diag(criteria) >= PAIRED):
        return declared
    _, columns = linear_sum_assignment(-criteria)
    return np.asarray(declared[columns])
