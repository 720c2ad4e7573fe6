"""Standard deviations of modes as files have them: with what no scatter within a record shows."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import nnls

from cvxshear.records.record import Finding
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats, Ints

SENSOR_STD = 0.005
"""Systematic standard deviation of a shape entry, relative to the mode's largest: a sensor that is 5 degrees askew
loses 0.4 %, and a transverse sensitivity of 3 % adds 3 % of the floor's other motions."""


def frequency_std(scatter: Floats, modes: Ints, findings: Sequence[Finding]) -> Floats:
    """Relative standard deviations of the frequencies, those that depend on amplitude being known no better than that.

    The halves of the record, the stronger and the weaker one, lie a half of the whole range of amplitudes apart. A
    frequency that changes by d between them is spread over 2 d, with a standard deviation of 2 d / sqrt(12). A mode
    without a known change is given the smallest known change.

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


Estimate = Callable[[Bools], Floats | None]


def jackknife(estimate: Estimate, groups: Ints, weights: Floats) -> tuple[Floats, Floats, int]:
    """Find the covariance by leaving out one piece at a time.

    Pieces may tell more or less. With p_j the share of a piece's weight in its stratum, the sum of (1 - p_j) times the
    squares of what leaving it out changes is without bias where a piece's variance goes with 1 / p_j, and nearly so
    where it does not (HC2 of MacKinnon and White 1985, "Some heteroskedasticity-consistent covariance matrix
    estimators", J. Econometrics 29). For equal weights it is the usual jackknife.

    Parameters
    ----------
    estimate : callable
        From a mask of pieces to the parameters, shape (k,), or None where they are not found.
    groups : array of int, shape (pieces,)
        Stratum of each piece.
    weights : array, shape (pieces,)
        How much each piece tells.

    Returns
    -------
    covariance : array, shape (k, k)
    freedom : array, shape (k,)
        Degrees of freedom of each variance, its strata's together (Satterthwaite 1946), a stratum's from its weights
        (Bell and McCaffrey 2002).
    lost : int
        Pieces without which the parameters were not found; the other pieces replace them.

    Raises
    ------
    InputError
        Where fewer than two pieces of some stratum can be left out.
    """
    parts, freedoms, lost = [], [], 0
    for group in np.unique(groups):
        found, rest = [], []
        pieces = np.flatnonzero(groups == group)
        shares = weights[pieces] / weights[pieces].sum()
        for piece, share in zip(pieces, shares, strict=True):
            keep = np.ones(len(groups), dtype=bool)
            keep[piece] = False
            values = estimate(keep)
            if values is None:
                lost += 1
            else:
                found.append(values)
                rest.append(1 - share)
        if len(found) < 2:
            raise InputError(
                "the modes rest on single pieces of the record: left out one at a time, they are not found again in "
                "the rest; record longer, or more hits"
            )
        spread = (np.array(found) - np.average(found, axis=0, weights=rest)) * np.sqrt(rest)[:, None]
        parts.append(spread.T @ spread * len(pieces) / len(found))
        form = (shares**2 / (1 - shares))[:, None] * (np.diag(1 / shares) - 1)
        freedoms.append(np.trace(form) ** 2 / np.sum(form * form.T) * (len(found) - 1) / (len(pieces) - 1))
    variances, total = np.array([np.diag(part) for part in parts]), np.sum(parts, axis=0)
    squares = np.sum(variances**2 / np.array(freedoms)[:, None], axis=0)
    freedom = np.divide(np.diag(total) ** 2, squares, out=np.full(len(total), float(sum(freedoms))), where=squares > 0)
    return total, freedom, lost


def surrogate(residual: Floats, random: np.random.Generator) -> Floats:
    """Noise with the spectra and cross-spectra of a residual, shape (samples, channels), of random phase.

    One random phase a line, the same for all channels, keeps their coherence (Prichard and Theiler 1994).
    """
    spectrum = np.fft.rfft(residual, axis=0)
    phase = np.exp(2j * np.pi * random.random(len(spectrum)))
    phase[0] = 1.0
    if len(residual) % 2 == 0:
        phase[-1] = 1.0
    return np.fft.irfft(spectrum * phase[:, None], n=len(residual), axis=0)
