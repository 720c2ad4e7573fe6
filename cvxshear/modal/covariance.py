"""Covariance-driven stochastic subspace identification: modes from responses to unmeasured wide-band input.

The covariances R_k = E[y_{t+k} y_t'] of the response to white noise are Markov parameters,
R_k = C A^{k-1} G (Peeters and De Roeck 1999, "Reference-based stochastic subspace identification for
output-only modal analysis", MSSP 13(6)), so their block Hankel matrix factors as an impulse response's
does, and the poles found are those of the structure. The Hankel matrix is weighted by the inverse square
roots of the covariances of future and past, the canonical variates (Arun and Kung 1990, "Balanced
approximation of stochastic systems", SIAM J. Matrix Anal. Appl. 11(1)): unweighted, the chance scatter of a
strong mode's covariances drowns a weak one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from cvxshear.modal.realization import block_hankel, left_factor
from cvxshear.util.typing import Bools, Floats, Ints

ROWS = 40
COLUMNS = 40
LEAST_NOISE = 1e-8
"""Of the largest variance, added to every channel's: an oversampled record's covariances are nearly singular."""


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
        """Left factor of the weighted block Hankel matrix of the covariances from lag 1 on, weight undone."""
        covariances = self.markov(keep)
        future = _root(_toeplitz(covariances, self.rows))
        past = _root(_toeplitz(covariances.transpose(0, 2, 1), self.columns))
        hankel = block_hankel(covariances, self.rows, self.columns)
        half = linalg.solve_triangular(future, hankel, lower=True, check_finite=False)
        weighted = linalg.solve_triangular(past, half.T, lower=True, check_finite=False).T
        return np.asarray(future @ left_factor(weighted))

    def data(self) -> Floats:
        """Left factor of the block Hankel matrix as it is."""
        return left_factor(block_hankel(self.markov(), self.rows, self.columns))

    def impulse(self, keep: Bools | None = None) -> None:
        """None: covariances decay as impulse responses do, but of an input that nobody measured."""


def _covariances(response: Floats, lags: int) -> Floats:
    count = len(response) - lags
    first = response[:count]
    return np.array([response[lag : lag + count].T @ first for lag in range(lags + 1)]) / count


def _toeplitz(covariances: Floats, count: int) -> Floats:
    """Covariance of col(y_t, y_{t+1}, ...), blocks R_{i-j}, with R_{-k} = R_k'."""
    lags = np.arange(count)[:, None] - np.arange(count)[None, :]
    blocks = np.where(
        (lags >= 0)[:, :, None, None], covariances[np.abs(lags)], covariances.transpose(0, 2, 1)[np.abs(lags)]
    )
    outputs = covariances.shape[1]
    return np.asarray(blocks.transpose(0, 2, 1, 3).reshape(count * outputs, count * outputs))


def _root(matrix: Floats) -> Floats:
    """Lower triangular square root of a covariance that sampling may have left slightly indefinite."""
    scale = float(np.max(np.diag(matrix)))
    lift = LEAST_NOISE * scale - min(0.0, float(linalg.eigvalsh(matrix, subset_by_index=[0, 0])[0]))
    return np.asarray(linalg.cholesky(matrix + lift * np.eye(len(matrix)), lower=True))
