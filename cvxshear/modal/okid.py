"""Observer/Kalman filter identification: Markov parameters from measured input and output.

The responses are regressed on past inputs and past responses, an observer whose Markov parameters are
finite in number although the structure's are not (Juang, Phan, Horta, Longman 1993, "Identification of
observer/Kalman filter Markov parameters", J. Guidance 16(2)):

    y_k = D u_k + sum_{i=1}^{p} (B_i u_{k-i} + A_i y_{k-i}) + e_k.

The system's Markov parameters follow by Y_0 = D, Y_k = B_k + sum_{i=1}^{k} A_i Y_{k-i}, with A_i and B_i
zero beyond p.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from cvxshear.modal.realization import Impulse, block_hankel, left_factor
from cvxshear.modal.runs import Complexes
from cvxshear.util.errors import NoSolutionError
from cvxshear.util.typing import Bools, Floats, Ints

LAGS, LAGS_A_STATE = 20, 7.0
"""Lags of the observer: so many at least, and as many as give seven past responses for each state of the frame. Under
noise an observer of few outputs forgets slowly; cut short, it bends the high modes by ten of their deviations."""

MOST_UNKNOWNS = 0.1
"""Of the samples: more of them an observer of that many lags would not average over."""

LARGEST_GROWTH = 1.002
"""A sample; a lightly damped pole may come out that much unstable by chance."""
ROWS = 60
COLUMNS = 600


def lags_for(stories: int, outputs: int, samples: int) -> int:
    """The lags of an observer of a frame's responses.

    Parameters
    ----------
    stories : int
        The frame has twice as many states.
    outputs : int
    samples : int
        In the whole record.
    """
    wanted = int(np.ceil(LAGS_A_STATE * 2 * stories / outputs))
    return max(LAGS, min(wanted, int(MOST_UNKNOWNS * samples / (1 + outputs))))


class OkidSource:
    """A record with measured input, in blocks, for OKID followed by the eigensystem realization algorithm.

    Parameters
    ----------
    pieces : sequence of (array, shape (samples, inputs); array, shape (samples, outputs))
        Blocks of input and output; each carries `lags` samples of what came before it.
    sampling_rate : float
        Hz.
    floor : int, optional
        Where a force acts; 0 for a base acceleration.
    lags : int, optional
        p above.
    """

    unit = "block"

    def __init__(
        self, pieces: Sequence[tuple[Floats, Floats]], sampling_rate: float, floor: int = 0, lags: int = LAGS
    ) -> None:
        self.sampling_rate = sampling_rate
        self.floor = floor
        self.lags = lags
        self.inputs = pieces[0][0].shape[1]
        self.outputs = pieces[0][1].shape[1]
        self.groups: Ints = np.zeros(len(pieces), dtype=np.int64)
        self.energies: Floats = np.array([float(np.mean(response**2)) for _, response in pieces])
        # Poles and residues of the same pieces are asked for one after the other.
        self._latest: tuple[bytes | None, Floats] | None = None
        # Triangles, not products: a product would square the condition number of the regression.
        self._triangles = [_triangle(_regression(u, y, lags)) for u, y in pieces]

    def markov(self, keep: Bools | None = None) -> Floats:
        """Markov parameters, shape (samples, outputs, inputs), the first one D."""
        pieces = None if keep is None else keep.tobytes()
        if self._latest is None or self._latest[0] != pieces:
            self._latest = (pieces, self._regressed(keep))
        return self._latest[1]

    def _regressed(self, keep: Bools | None) -> Floats:
        chosen = self._triangles if keep is None else [t for t, k in zip(self._triangles, keep, strict=True) if k]
        triangle = _triangle(np.vstack(chosen))
        split = triangle.shape[1] - self.outputs
        weights = linalg.lstsq(triangle[:split, :split], triangle[:split, split:], check_finite=False)[0]
        direct = weights[: self.inputs].T
        lagged = weights[self.inputs :].reshape(self.lags, self.inputs + self.outputs, self.outputs)
        past = lagged.transpose(0, 2, 1)
        return _system_markov(direct, past[:, :, : self.inputs], past[:, :, self.inputs :], ROWS + COLUMNS)

    def factor(self, keep: Bools | None = None) -> Floats:
        """Left factor of the block Hankel matrix of the Markov parameters."""
        return left_factor(block_hankel(self.markov(keep), ROWS, COLUMNS))

    def data(self) -> Floats:
        """The same: the data are not weighted."""
        return self.factor()

    def impulse(self, keep: Bools | None = None) -> Impulse:
        """The Markov parameters, from the first that the direct term is not part of."""
        return Impulse(self.markov(keep), 1, np.full(self.inputs, self.floor, dtype=np.int64))


def _regression(excitation: Floats, response: Floats, lags: int) -> Floats:
    """Rows [u_k, u_{k-1}, y_{k-1}, ..., u_{k-p}, y_{k-p} | y_k], shape (samples - lags, ...)."""
    both = np.hstack([excitation, response])
    windows = np.lib.stride_tricks.sliding_window_view(both, lags + 1, axis=0)
    past = windows[:, :, lags - 1 :: -1].transpose(0, 2, 1).reshape(len(windows), -1)
    return np.hstack([excitation[lags:], past, response[lags:]])


def _triangle(matrix: Floats) -> Floats:
    width = matrix.shape[1]
    return np.asarray(linalg.qr(matrix, mode="r", check_finite=False)[0][:width])


def _system_markov(direct: Floats, inputs: Floats, outputs: Floats, count: int) -> Floats:
    """Markov parameters 0 to `count` of the system behind the observer, without what in it explodes.

    With x the observer's state in its canonical form, x' = F x + G u, y = x_1 + D u, the parameters are
    Y_k = C F^{k-1} G, summed over the eigenvalues of F. One well outside the unit circle is no structure: it
    stands for what comes before its cause at the edge of the band, and would swamp the others.
    """
    lags, rows, columns = inputs.shape
    transition = np.eye(lags * rows, k=rows)
    transition[:, :rows] = outputs.reshape(lags * rows, rows)
    drive = (inputs + outputs @ direct).reshape(lags * rows, columns)
    values, vectors = linalg.eig(transition)
    weights = _in_vectors(vectors, drive.astype(np.complex128))
    kept = np.abs(values) < LARGEST_GROWTH
    powers = np.cumprod(np.vstack([np.ones(kept.sum()), np.tile(values[kept], (count - 1, 1))]), axis=0)
    later = np.einsum("ks,os,si->koi", powers, vectors[:rows, kept], weights[kept], optimize=True)
    return np.concatenate([direct[None], later.real])


def _in_vectors(vectors: Complexes, drive: Complexes) -> Complexes:
    """The drive in the eigenvectors of F; where these fall together the powers of F are no sum over eigenvalues."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", linalg.LinAlgWarning)
        try:
            return np.asarray(linalg.solve(vectors, drive))
        except (linalg.LinAlgError, linalg.LinAlgWarning):
            raise NoSolutionError(
                "okid",
                "the observer of this record has no separate poles; is one channel a copy of another, or constant?",
            ) from None
