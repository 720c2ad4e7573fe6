"""Input-output subspace identification with past inputs and outputs as instruments (PO-MOESP).

With block Hankel matrices of past (p) and future (f) data, the extended observability matrix spans the
columns of the future outputs from which the future inputs have been projected out, correlated with the
past data (Verhaegen 1994, "Identification of the deterministic part of MIMO state space models",
Automatica 30(1)): in the triangle of [U_f | U_p Y_p | Y_f], the block of Y_f against the past.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from cvxshear.modal.realization import left_factor
from cvxshear.util.typing import Bools, Floats, Ints

ROWS = 30


class SubspaceSource:
    """A record with measured input, in blocks, for PO-MOESP.

    Parameters
    ----------
    pieces : sequence of (array, shape (samples, inputs); array, shape (samples, outputs))
        Blocks of input and output; each carries 2 * rows - 1 samples of what came before it.
    sampling_rate : float
        Hz.
    rows : int, optional
        Block rows of past and of future.
    """

    unit = "block"

    def __init__(self, pieces: Sequence[tuple[Floats, Floats]], sampling_rate: float, rows: int = ROWS) -> None:
        self.sampling_rate = sampling_rate
        self.rows = rows
        self.inputs = pieces[0][0].shape[1]
        self.outputs = pieces[0][1].shape[1]
        self.groups: Ints = np.zeros(len(pieces), dtype=np.int64)
        self.energies: Floats = np.array([float(np.mean(response**2)) for _, response in pieces])
        self._triangles = [_triangle(_data(u, y, rows)) for u, y in pieces]

    def factor(self, keep: Bools | None = None) -> Floats:
        """Left factor of the future outputs as the past explains them."""
        chosen = self._triangles if keep is None else [t for t, k in zip(self._triangles, keep, strict=True) if k]
        triangle = _triangle(np.vstack(chosen)).T
        future_inputs = self.rows * self.inputs
        past = future_inputs + self.rows * (self.inputs + self.outputs)
        return left_factor(triangle[past:, future_inputs:past])

    def data(self) -> Floats:
        """The same: the data are not weighted."""
        return self.factor()

    def impulse(self, keep: Bools | None = None) -> None:
        """None: the projection leaves no impulse response."""


def _data(excitation: Floats, response: Floats, rows: int) -> Floats:
    """Rows [u_f | u_p y_p | y_f], one a starting sample."""
    count = len(response) - 2 * rows + 1

    def windows(values: Floats, start: int) -> Floats:
        view = np.lib.stride_tricks.sliding_window_view(values, rows, axis=0)[start : start + count]
        return view.transpose(0, 2, 1).reshape(count, -1)

    return np.hstack([windows(excitation, rows), windows(excitation, 0), windows(response, 0), windows(response, rows)])


def _triangle(matrix: Floats) -> Floats:
    width = matrix.shape[1]
    triangle = linalg.qr(matrix, mode="r", check_finite=False)[0][:width]
    # A block of fewer samples than columns makes a shorter triangle; rows of zeros change no sum of squares.
    return np.vstack([triangle, np.zeros((width - len(triangle), width))])
