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

The residues of its poles follow from the responses themselves. With the poles z_r known, each response is linear in the
residues c_r and in what the first lags ring besides:

    y_t = sum_{k < p} D_k u_{t-k} + sum_r 2 Re(c_r sum_{k >= p} z_r^k u_{t-k} + x_r z_r^t) + e_t.

The x_r are what the motion before a block leaves in it, and are projected out block by block.

Covariance-driven stochastic subspace identification: the covariances R_k = E[y_{t+k} y_t'] of the response to white
noise are Markov parameters, R_k = C A^{k-1} G (Peeters and De Roeck 1999, "Reference-based stochastic subspace
identification for output-only modal analysis", MSSP 13(6)), so their block Hankel matrix factors as an impulse
response's does. It is weighted by the inverse square roots of the covariances of future and past, the canonical
variates (Arun and Kung 1990, "Balanced approximation of stochastic systems", SIAM J. Matrix Anal. Appl. 11(1)):
unweighted, the chance scatter of a strong mode's covariances drowns a weak one.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from scipy import linalg, signal

from cvxshear.records import frf, pole_sweep
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import NoSolutionError
from cvxshear.util.typing import Bools, Complexes, Floats, Ints


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
    return np.asarray(linalg.lapack.dtpqrt(size, size, first, second)[0])


#: Block rows of past and future: a minimum, and samples for each state of the frame.
SUBSPACE_ROWS, SAMPLES_A_STATE = 30, 3.0

#: Fraction of the largest variance, added to every channel's variance before the future is weighted. Resolution and
#: hum, 40 dB below the motion, otherwise give poles.
SILENCE = 1e-4


class SubspaceSource(pole_sweep.Source):
    """A record with measured input, in blocks, for PO-MOESP.

    The projection gives the poles and shapes; noise is not correlated with its instruments.

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
    """

    unit = "block"

    def __init__(
        self, pieces: Sequence[tuple[Floats, Floats]], sampling_rate: float, floor: int = 0, rows: int = SUBSPACE_ROWS
    ) -> None:
        self.sampling_rate = sampling_rate
        self.floor = floor
        self.rows = rows
        self.pieces = list(pieces)
        self.inputs, self.outputs = pieces[0][0].shape[1], pieces[0][1].shape[1]
        self.groups = np.zeros(len(pieces), dtype=np.int64)
        self.energies = np.array([float(np.mean(response**2)) for _, response in pieces])
        self._triangles = Triangles([_triangle(_data(u, y, rows)) for u, y in pieces])

    def factor(self, keep: Bools | None = None) -> Floats:
        """Left factor of the future outputs as the past explains them, weighted by their covariance, weight undone."""
        explained, rest = self._future(keep)
        weight = _root(explained @ explained.T + rest @ rest.T, SILENCE)
        weighted = linalg.solve_triangular(weight, explained, lower=True, check_finite=False)
        return np.asarray(weight @ pole_sweep.left_factor(weighted))

    def data(self) -> Floats:
        """Left factor of the future outputs as the past explains them."""
        return pole_sweep.left_factor(self._future(None)[0])

    def _future(self, keep: Bools | None) -> tuple[Floats, Floats]:
        """Split the future outputs, the future inputs projected out, into what the past explains and what is left."""
        triangle = self._triangles.together(keep).T
        future_inputs = self.rows * self.inputs
        past = future_inputs + self.rows * (self.inputs + self.outputs)
        return triangle[past:, future_inputs:past], triangle[past:, past:]

    def residues(self, eigenvalues: Complexes, keep: Bools | None = None) -> tuple[Complexes, Ints]:
        """Find the amplitudes of the modes in the impulse response by least squares of the responses."""
        poles = np.exp(eigenvalues / self.sampling_rate)
        used = self.pieces if keep is None else [piece for piece, kept in zip(self.pieces, keep, strict=True) if kept]
        rows = np.vstack([_on_modes(excitation[:, 0], response, poles) for excitation, response in used])
        modes, columns = len(poles), rows.shape[1] - self.outputs
        fit = np.linalg.lstsq(rows[:, :columns], rows[:, columns:], rcond=None)[0][-2 * modes :]
        if not np.all(np.isfinite(fit)):
            raise NoSolutionError("subspace", "the input hardly moves beside the responses; is it the right channel?")
        return (fit[:modes] + 1j * fit[modes:])[:, :, None], np.array([self.floor])


def _on_modes(excitation: Floats, response: Floats, poles: Complexes) -> Floats:
    """Regress a block on [first lags of the input | modes that it drives | response], the free motion projected out.

    An input starts with a step; sampled, it rings at half the sampling rate, and residues of the first samples would be
    0.1 to 0.7 % low in the highest modes.
    """
    lags = [excitation[frf.RINGING - lag : len(excitation) - lag] for lag in range(frf.RINGING)]
    late = excitation[: len(excitation) - frf.RINGING]
    driven = [pole**frf.RINGING * signal.lfilter([1.0], [1.0, -pole], late) for pole in poles]
    free = poles[:, None] ** np.arange(len(late))
    modes = [*(2 * each.real for each in driven), *(-2 * each.imag for each in driven)]
    rows = np.column_stack([*lags, *modes, response[frf.RINGING :]])
    basis = linalg.qr(np.vstack([free.real, free.imag]).T, mode="economic", check_finite=False)[0]
    return np.asarray(rows - basis @ (basis.T @ rows))


def _data(excitation: Floats, response: Floats, rows: int) -> Floats:
    """Rows [u_f | u_p y_p | y_f], one a starting sample."""
    count = len(response) - 2 * rows + 1

    def windows(values: Floats, start: int) -> Floats:
        view = np.lib.stride_tricks.sliding_window_view(values, rows, axis=0)[start : start + count]
        return view.transpose(0, 2, 1).reshape(count, -1)

    return np.hstack([windows(excitation, rows), windows(excitation, 0), windows(response, 0), windows(response, rows)])


#: Block rows, and block columns, of the Hankel matrix of covariances: four periods of a highest mode at a tenth of the
#: sampling rate, and with two sensors more than twice the 30 states of the largest model.
SSI_ROWS = 40
#: Of the largest variance, added to every channel's: an oversampled record's covariances are nearly singular.
LEAST_NOISE = 1e-8


class CovarianceSource(pole_sweep.Source):
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
        hankel = pole_sweep.block_hankel(covariances, self.rows, self.columns)
        half = linalg.solve_triangular(future, hankel, lower=True, check_finite=False)
        weighted = linalg.solve_triangular(past, half.T, lower=True, check_finite=False).T
        return np.asarray(future @ pole_sweep.left_factor(weighted))

    def data(self) -> Floats:
        """Left factor of the block Hankel matrix as it is."""
        return pole_sweep.left_factor(pole_sweep.block_hankel(self.markov(), self.rows, self.columns))


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
