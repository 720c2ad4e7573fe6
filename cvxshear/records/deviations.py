"""Standard deviations of modes as files have them: with what no scatter within a record shows."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from cvxshear.records.record import Finding
from cvxshear.util.typing import Floats, Ints

SENSOR_STD = 0.005
"""Systematic standard deviation of a shape entry, relative to the mode's largest: a sensor that is 5 degrees askew
loses 0.4 %, and a transverse sensitivity of 3 % adds 3 % of the floor's other motions."""


def frequency_std(scatter: Floats, modes: Ints, findings: Sequence[Finding]) -> Floats:
    """Relative standard deviations of the frequencies, those that depend on amplitude being known no better than that.

    The halves of the record, the stronger and the weaker one, lie a half of the whole range of amplitudes apart. A
    frequency that changes by d between them is spread over 2 d, with a standard deviation of 2 d / sqrt(12). A mode
    without a known change is given the smallest known change. One that is only suspected to change, by its scatter, has
    that scatter in its deviation already.

    Parameters
    ----------
    scatter : ndarray, shape (m,)
    modes : ndarray of int, shape (m,)
    findings : sequence of Finding
    """
    changes = {
        item.numbers["mode"]: 2.0 * abs(item.numbers["change"]) / np.sqrt(12.0)
        for item in findings
        if item.kind == "amplitude" and "change" in item.numbers
    }
    least = min(changes.values(), default=0.0)
    return np.hypot(scatter, [changes.get(int(mode), least) for mode in modes])


def entry_std(scatter: Floats, shapes: Floats, floors: Ints, findings: Sequence[Finding]) -> Floats:
    """Add what sensors get wrong unseen to the standard deviations of the entries, over each mode's largest.

    Where the response at floor i to a force at j differs from that at j to a force at i by the share d, one of four
    calibrations is off: two sensors, and the force at two driving points. If each has the standard deviation s, d has 2
    s. An entry takes half of its sensor's error and half of its driving point's, which is s / sqrt(2) = d / (2
    sqrt(2)).

    Parameters
    ----------
    scatter : ndarray, shape (m, n)
    shapes : ndarray, shape (m, n)
        In any scaling.
    floors : ndarray of int, shape (n,)
    findings : sequence of Finding
    """
    failures = [item.numbers for item in findings if item.kind == "reciprocity"]
    of_floors = ([each["by_mode"] for each in failures if floor in each["floors"]] for floor in floors.tolist())
    share = np.array([np.sqrt(np.mean(np.square(each or [[0.0]]))) for each in of_floors])
    relative = np.abs(shapes) / np.max(np.abs(shapes), axis=1, keepdims=True)
    result: Floats = np.hypot(np.hypot(scatter, SENSOR_STD), relative * share / (2.0 * np.sqrt(2.0)))
    return result


DRAWN = 0.3
"""Weight of equal variances, relative to the weight of the covariance."""
REPRODUCED_TO = 2e-4
"""Relative standard deviation of a frequency that no scatter within a record goes below: loggers' crystals are 20 to
100 ppm off, and a degree takes 0.02 % from the frequency of a steel frame (Young's modulus falls by 0.04 % a degree).
Without it a day's change of temperature between two tests would be found as a cause."""
DAMPING_REPRODUCED_TO = 0.01
"""Least relative std of a damping ratio: friction in joints and cables changes it by more between two tests."""


def independent_std(covariance: Floats, shape: Floats) -> Floats:
    """Independent errors on all entries that, the scale free, scatter a shape as a covariance says.

    An error along the shape itself is lost in the scale: with P the projector off the shape, P D P and
    P cov P have the same diagonal for the diagonal matrix D = diag(std^2) sought, a linear system with
    the squared entries of P. Solved for non-negative variances.

    Parameters
    ----------
    covariance : array, shape (n, n)
        In any scaling of the shape to a fixed length or entry.
    shape : array, shape (n,)

    Returns
    -------
    array, shape (n,)
    """
    off = np.eye(len(shape)) - np.outer(shape, shape) / (shape @ shape)
    seen = np.diag(off @ covariance @ off)
    typical = float(seen.sum()) / max(1, len(shape) - 1)
    if typical <= 0:
        return np.zeros(len(shape))
    # Drawn towards equal variances: the system is singular for two floors, and a covariance from a score of
    # pieces is no better known than that.
    rows = np.vstack([off**2, DRAWN * np.eye(len(shape))])
    variances = nnls(rows, np.concatenate([seen / typical, np.full(len(shape), DRAWN)]))[0] * typical
    return np.sqrt(np.maximum(variances, 0.1 * typical))
