"""Two methods that compute the column space of the extended observability matrix from blocks of a record.

Input-output subspace identification with past inputs and outputs as instruments (PO-MOESP): with block Hankel matrices
of past (p) and future (f) data, the extended observability matrix spans the columns of the future outputs from which
the future inputs have been projected out, correlated with the past data (Verhaegen 1994, "Identification of the
deterministic part of MIMO state space models", Automatica 30(1)): in the triangle of [U_f | U_p Y_p | Y_f], the block
L32 of Y_f against the past, and L33 what is left of Y_f. It is weighted by the inverse square root of the future's
covariance L32 L32' + L33 L33', so that its singular values are the canonical correlations of past and future (Larimore
1990, "Canonical variate analysis in identification, filtering, and adaptive control", IEEE CDC): unweighted, the noise
of a strong mode's channels stands before a weak mode, and bends its pole by the square of noise over motion, which no
scatter over the record's pieces shows.

The residues of its poles come from an observer. The responses are regressed on past inputs and past responses (Juang,
Phan, Horta, Longman 1993, "Identification of observer/Kalman filter Markov parameters", J. Guidance 16(2)):

    y_k = D u_k + sum_{i=1}^{p} (B_i u_{k-i} + A_i y_{k-i}) + e_k.

The system's Markov parameters follow by Y_0 = D, Y_k = B_k + sum_{i=1}^{k} A_i Y_{k-i}, with A_i and B_i zero beyond p.

Covariance-driven stochastic subspace identification: the covariances R_k = E[y_{t+k} y_t'] of the response to white
noise are Markov parameters, R_k = C A^{k-1} G (Peeters and De Roeck 1999, "Reference-based stochastic subspace
identification for output-only modal analysis", MSSP 13(6)), so their block Hankel matrix factors as an impulse
response's does. It is weighted by the inverse square roots of the covariances of future and past, the canonical
variates (Arun and Kung 1990, "Balanced approximation of stochastic systems", SIAM J. Matrix Anal. Appl. 11(1)):
unweighted, the chance scatter of a strong mode's covariances drowns a weak one.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from cvxshear.records.frf import ERA_COLUMNS, ERA_ROWS, RINGING
from cvxshear.records.pole_sweep import Impulse, Source, block_hankel, left_factor
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import NoSolutionError
from cvxshear.util.typing import Bools, Complexes, Floats

LAGS, LAGS_A_STATE = 20, 7.0
"""Lags of the observer: a minimum, and past responses for each state of the frame. Under
noise an observer of few outputs forgets slowly; cut short, it bends the high modes by ten of their deviations."""

MOST_UNKNOWNS = 0.1
"""Of the samples: more of them an observer of that many lags would not average over."""

LARGEST_GROWTH = 1.002
"""A sample; a lightly damped pole may come out that much unstable by chance."""


def lags_for(stories: int, outputs: int, samples: int) -> int:
    """Choose the number of lags of an observer of a frame's responses.

    Parameters
    ----------
    stories : int
        The frame has two states for each story.
    outputs : int
    samples : int
        In the whole record.
    """
    wanted = int(np.ceil(LAGS_A_STATE * 2 * stories / outputs))
    return max(LAGS, min(wanted, int(MOST_UNKNOWNS * samples / (1 + outputs))))


def rows_for(stories: int, outputs: int) -> int:
    """Choose the block rows of past and future: three samples for each state of the frame."""
    return max(SUBSPACE_ROWS, int(np.ceil(SAMPLES_A_STATE * 2 * stories / outputs)))


def _triangle(matrix: Floats) -> Floats:
    width = matrix.shape[1]
    triangle = linalg.qr(matrix, mode="r", check_finite=False)[0][:width]
    # A block of fewer samples than columns makes a shorter triangle; rows of zeros change no sum of squares.
    return np.vstack([triangle, np.zeros((width - len(triangle), width))])


class Triangles:
    """The triangles R of blocks of data, R'R being the sum of squares and products of each; as they add up.

    Triangles, not products: a product would square the condition number of a regression.

    Parameters
    ----------
    pieces : sequence of array, shape (k, k)
        Upper triangular.
    """

    def __init__(self, pieces: Sequence[Floats]) -> None:
        self.pieces = list(pieces)

    @cached_property
    def _before(self) -> list[Floats]:
        """Up to each block, and it; with `_after`, two triangles make the whole without one block, not all but one."""
        return list(itertools.accumulate(self.pieces, _joined))

    @cached_property
    def _after(self) -> list[Floats]:
        """From each block on."""
        return list(itertools.accumulate(reversed(self.pieces), _joined))[::-1]

    def together(self, keep: Bools | None) -> Floats:
        """Return the triangle of all blocks, or of those kept."""
        left = [] if keep is None else np.flatnonzero(~keep).tolist()
        if not left:
            return self._before[-1]
        if len(left) > 1:
            chosen = np.ones(len(self.pieces), dtype=bool) if keep is None else keep
            return _triangle(np.vstack([piece for piece, kept in zip(self.pieces, chosen, strict=True) if kept]))
        before, after = self._before[: left[0]][-1:], self._after[left[0] + 1 :][:1]
        return _joined(before[0], after[0]) if before and after else (before or after)[0]


def _joined(first: Floats, second: Floats) -> Floats:
    """Triangle of two one above the other, which LAPACK makes without a look at their zeros."""
    size = len(first)
    triangle: Floats = linalg.lapack.dtpqrt(size, size, first, second)[0]
    return triangle


class Observer:
    """The observer of a record with measured input, in blocks, and the Markov parameters that follow from it.

    Parameters
    ----------
    pieces : sequence of (array, shape (samples, inputs); array, shape (samples, outputs))
        Blocks of input and output; each carries `lags` samples of what came before it.
    lags : int
        p above.
    """

    def __init__(self, pieces: Sequence[tuple[Floats, Floats]], lags: int) -> None:
        self.lags = lags
        self.inputs = pieces[0][0].shape[1]
        self.outputs = pieces[0][1].shape[1]
        # Residues of the same pieces are asked for more than once.
        self._latest: tuple[bytes | None, Floats] | None = None
        self._triangles = Triangles([_triangle(_regression(u, y, lags)) for u, y in pieces])

    def markov(self, keep: Bools | None = None) -> Floats:
        """Markov parameters, shape (samples, outputs, inputs), the first one D."""
        pieces = None if keep is None else keep.tobytes()
        if self._latest is None or self._latest[0] != pieces:
            self._latest = (pieces, self._regressed(keep))
        return self._latest[1]

    def _regressed(self, keep: Bools | None) -> Floats:
        triangle = self._triangles.together(keep)
        split = triangle.shape[1] - self.outputs
        weights = linalg.lstsq(triangle[:split, :split], triangle[:split, split:], check_finite=False)[0]
        direct = weights[: self.inputs].T
        lagged = weights[self.inputs :].reshape(self.lags, self.inputs + self.outputs, self.outputs)
        past = lagged.transpose(0, 2, 1)
        return _system_markov(direct, past[:, :, : self.inputs], past[:, :, self.inputs :], ERA_ROWS + ERA_COLUMNS)


def _regression(excitation: Floats, response: Floats, lags: int) -> Floats:
    """Rows [u_k, u_{k-1}, y_{k-1}, ..., u_{k-p}, y_{k-p} | y_k], shape (samples - lags, ...)."""
    both = np.hstack([excitation, response])
    windows = np.lib.stride_tricks.sliding_window_view(both, lags + 1, axis=0)
    past = windows[:, :, lags - 1 :: -1].transpose(0, 2, 1).reshape(len(windows), -1)
    return np.hstack([excitation[lags:], past, response[lags:]])


def _system_markov(direct: Floats, inputs: Floats, outputs: Floats, count: int) -> Floats:
    """Markov parameters 0 to `count` of the system behind the observer, without what in it explodes.

    With x the observer's state in its canonical form, x' = F x + G u, y = x_1 + D u, the parameters are Y_k = C F^{k-1}
    G, summed over the eigenvalues of F. An eigenvalue well outside the unit circle is not a mode. It comes from the
    edge of the band and would exceed all others.
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
    """Expand the drive in F's eigenvectors; where these fall together F's powers are no sum over eigenvalues."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", linalg.LinAlgWarning)
        try:
            return np.asarray(linalg.solve(vectors, drive))
        except (linalg.LinAlgError, linalg.LinAlgWarning):
            raise NoSolutionError(
                "subspace",
                "the observer of this record has no separate poles; is one channel a copy of another, or constant?",
            ) from None


SUBSPACE_ROWS, SAMPLES_A_STATE = 30, 3.0
"""Block rows of past and future: a minimum, and samples for each state of the frame."""

SILENCE = 1e-4
"""Fraction of the largest variance, added to every channel's variance before the future is weighted. Resolution and
hum, 40 dB below the motion, otherwise give poles."""


class SubspaceSource(Source):
    """A record with measured input, in blocks, for PO-MOESP.

    The projection gives the poles and shapes; noise is not correlated with its instruments. Residues of these poles
    come from the Markov parameters of an observer on the same blocks.

    Parameters
    ----------
    pieces : sequence of (array, shape (samples, inputs); array, shape (samples, outputs))
        Blocks of input and output; each carries 2 * rows - 1 samples of what came before it.
    sampling_rate : float
        Hz.
    floor : int, optional
        Where a force acts; 0 for a base acceleration.
    rows : int, optional
        Block rows of past and of future.
    lags : int, optional
        Of the observer.
    """

    unit = "block"

    def __init__(
        self,
        pieces: Sequence[tuple[Floats, Floats]],
        sampling_rate: float,
        floor: int = 0,
        rows: int = SUBSPACE_ROWS,
        lags: int = LAGS,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.floor = floor
        self._observer = Observer(pieces, min(lags, 2 * rows - 1))
        self.rows = rows
        self.inputs, self.outputs = self._observer.inputs, self._observer.outputs
        self.groups = np.zeros(len(pieces), dtype=np.int64)
        self.energies = np.array([float(np.mean(response**2)) for _, response in pieces])
        self._triangles = Triangles([_triangle(_data(u, y, rows)) for u, y in pieces])

    def factor(self, keep: Bools | None = None) -> Floats:
        """Left factor of the future outputs as the past explains them, weighted by their covariance, weight undone."""
        explained, rest = self._future(keep)
        weight = _root(explained @ explained.T + rest @ rest.T, SILENCE)
        weighted = linalg.solve_triangular(weight, explained, lower=True, check_finite=False)
        return np.asarray(weight @ left_factor(weighted))

    def data(self) -> Floats:
        """Left factor of the future outputs as the past explains them."""
        return left_factor(self._future(None)[0])

    def _future(self, keep: Bools | None) -> tuple[Floats, Floats]:
        """Split the future outputs, the future inputs projected out, into what the past explains and what is left."""
        triangle = self._triangles.together(keep).T
        future_inputs = self.rows * self.inputs
        past = future_inputs + self.rows * (self.inputs + self.outputs)
        return triangle[past:, future_inputs:past], triangle[past:, past:]

    def impulse(self, keep: Bools | None = None) -> Impulse:
        """Return the observer's Markov parameters, from the first that rings no more.

        An impulse response starts with a step; sampled, it rings at half the sampling rate, and residues of the first
        samples would be 0.1 to 0.7 % low in the highest modes.
        """
        return Impulse(self._observer.markov(keep), RINGING, np.full(self.inputs, self.floor, dtype=np.int64))


def _data(excitation: Floats, response: Floats, rows: int) -> Floats:
    """Rows [u_f | u_p y_p | y_f], one a starting sample."""
    count = len(response) - 2 * rows + 1

    def windows(values: Floats, start: int) -> Floats:
        view = np.lib.stride_tricks.sliding_window_view(values, rows, axis=0)[start : start + count]
        return view.transpose(0, 2, 1).reshape(count, -1)

    return np.hstack([windows(excitation, rows), windows(excitation, 0), windows(response, 0), windows(response, rows)])


SSI_ROWS = 40
"""Block rows, and block columns, of the Hankel matrix of covariances: four periods of a highest mode at a tenth of the
sampling rate, and with two sensors more than twice the 30 states of the largest model."""
LEAST_NOISE = 1e-8
"""Of the largest variance, added to every channel's: an oversampled record's covariances are nearly singular."""


class CovarianceSource(Source):
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
        self, pieces: Sequence[Floats], sampling_rate: float, rows: int = SSI_ROWS, columns: int = SSI_ROWS
    ) -> None:
        self.sampling_rate = sampling_rate
        self.rows, self.columns = rows, columns
        self.outputs = pieces[0].shape[1]
        self.groups = np.zeros(len(pieces), dtype=np.int64)
        self.energies = np.array([float(np.mean(piece**2)) for piece in pieces])
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


def _root(matrix: Floats, least: float = LEAST_NOISE) -> Floats:
    """Lower triangular square root of a covariance that sampling may have left slightly indefinite."""
    scale = float(np.max(np.diag(matrix)))
    lift = least * scale - min(0.0, float(linalg.eigvalsh(matrix, subset_by_index=[0, 0])[0]))
    return np.asarray(linalg.cholesky(matrix + lift * np.eye(len(matrix)), lower=True))
