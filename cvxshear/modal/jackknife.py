"""Covariance of an estimate by leaving out pieces of the data, or by disturbing data that have no pieces.

Stratified delete-one jackknife (Efron and Stein 1981; Rao and Wu 1985): with n_h pieces in stratum h,
cov = sum_h (n_h - 1) / n_h * sum_i (t_(h i) - mean_h)(t_(h i) - mean_h)'.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats, Ints

Estimate = Callable[[Bools], Floats | None]


def jackknife(estimate: Estimate, groups: Ints) -> tuple[Floats, int]:
    """Covariance by leaving out one piece at a time.

    Parameters
    ----------
    estimate : callable
        From a mask of kept pieces to the parameters, shape (k,), or None where they are not found.
    groups : array of int, shape (pieces,)
        Stratum of each piece.

    Returns
    -------
    covariance : array, shape (k, k)
    lost : int
        Pieces without which the parameters were not found; the others stand in for them.

    Raises
    ------
    InputError
        Where fewer than two pieces of some stratum can be left out.
    """
    total: Floats | None = None
    lost = 0
    for group in np.unique(groups):
        replicates = []
        for piece in np.flatnonzero(groups == group):
            keep = np.ones(len(groups), dtype=bool)
            keep[piece] = False
            values = estimate(keep)
            if values is None:
                lost += 1
            else:
                replicates.append(values)
        if len(replicates) < 2:
            raise InputError(
                "the modes rest on single pieces of the record: left out one at a time, they are not found again in "
                "the rest; record longer, or more hits"
            )
        spread = np.array(replicates) - np.mean(replicates, axis=0)
        part = (len(replicates) - 1) / len(replicates) * spread.T @ spread
        total = part if total is None else total + part
    if total is None:
        raise InputError("there are no pieces to leave out")
    return total, lost


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
