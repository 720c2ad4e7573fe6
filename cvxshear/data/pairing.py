"""Which mode of the model a measured one is, and how a modelled shape is laid on a measured one.

The scale c_j of a measured mode is free: at the c_j of least squares the residual of the shape is
(1 - u u') W phi_measured with u = W phi / |W phi|.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from cvxshear.measurement.experiment import Configuration
from cvxshear.model.observation import Observation
from cvxshear.model.shear import Modes
from cvxshear.util.typing import Floats, Ints

PAIRED = 0.5
"""Modal assurance criterion below which a measured mode is looked for among the other modes of the model."""


def mac(a: Floats, b: Floats) -> float:
    """Modal assurance criterion of two shapes, (a'b)^2 / (a'a b'b)."""
    return float((a @ b) ** 2 / ((a @ a) * (b @ b)))


def scaled(measured: Floats, modelled: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Scales by least squares, and the unit vectors u, of each row.

    Parameters
    ----------
    measured, modelled, weights : ndarray, shape (m, n)
        Weight zero where nothing was measured.

    Returns
    -------
    scale : ndarray, shape (m,)
    unit : ndarray, shape (m, n)
    """
    weighted = weights * modelled
    length = np.sum(weighted**2, axis=1)
    safe = np.where(length > 0, length, 1.0)
    return np.sum(weighted * weights * measured, axis=1) / safe, weighted / np.sqrt(safe)[:, None]


def paired(configuration: Configuration, found: Modes, observation: Observation) -> Ints:
    """Which mode of the model each measured one is, zero-based.

    The declared numbers hold unless a shape speaks against them; modes that changed places are then paired
    by the assignment of the largest modal assurance criteria among the declared ones.

    Parameters
    ----------
    configuration : Configuration
    found : Modes
    observation : Observation
        What the sensors show of the modes.
    """
    declared = configuration.modes - 1
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
    result: Ints = declared[columns]
    return result
