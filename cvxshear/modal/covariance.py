"""Covariance-driven stochastic subspace identification: modes from responses to unmeasured wide-band input.

The covariances R_k = E[y_{t+k} y_t'] of the response to white noise are Markov parameters,
R_k = C A^{k-1} G (Peeters and De Roeck 1999, "Reference-based stochastic subspace identification for
output-only modal analysis", MSSP 13(6)), so their block Hankel matrix factors as an impulse response's
does, and the poles found are those of the structure.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.modal.realization import block_hankel, left_factor
from cvxshear.typing import Bools, Floats, Ints

ROWS = 60
COLUMNS = 60


class CovarianceSource:
    """An ambient record, in blocks, for covariance-driven SSI.

    Parameters
    ----------
    pieces : sequence of array, shape (samples, outputs)
        Blocks; each carries `rows + columns` samples of what comes after it, which its lags reach into.
    sampling_rate : float
        Hz.
    rows, columns : int, optional
        Block rows and columns of the Hankel matrix.
    """

    unit = "block"

    def __init__(
        self, pieces: Sequence[Floats], sampling_rate: float, rows: int = ROWS, columns: int = COLUMNS
    ) -> None:
        self.sampling_rate = sampling_rate
        self.rows, self.columns = rows, columns
        self.outputs = pieces[0].shape[1]
        self.groups: Ints = np.zeros(len(pieces), dtype=np.int64)
        self.energies: Floats = np.array([float(np.mean(piece**2)) for piece in pieces])
        self._covariances = np.array([_covariances(piece, rows + columns) for piece in pieces])
        self._counts = np.array([len(piece) - rows - columns for piece in pieces], dtype=np.float64)

    def markov(self, keep: Bools | None = None) -> Floats:
        """Covariances at lags 0, 1, ..., shape (lags, outputs, outputs)."""
        used = np.ones(len(self._counts), dtype=bool) if keep is None else keep
        total = np.tensordot(self._counts[used], self._covariances[used], axes=1)
        return np.asarray(total / self._counts[used].sum())

    def factor(self, keep: Bools | None = None) -> Floats:
        """Left factor of the block Hankel matrix of the covariances from lag 1 on."""
        return left_factor(block_hankel(self.markov(keep), self.rows, self.columns))

    def impulse(self, keep: Bools | None = None) -> None:
        """None: covariances decay as impulse responses do, but of an input that nobody measured."""


def _covariances(response: Floats, lags: int) -> Floats:
    count = len(response) - lags
    first = response[:count]
    return np.array([response[lag : lag + count].T @ first for lag in range(lags + 1)]) / count
