"""From a block Hankel matrix to poles and shapes of every model order.

Every method here computes a matrix with the column space of the extended observability matrix, col(C, CA, CA^2, ...).
Its shift invariance gives A, its first block row C.
"""

from __future__ import annotations

import dataclasses
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.util import ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Bools, Complexes, Floats, Ints


class Source(ABC):
    """Data of one record, reduced to pieces that can be left out one at a time.

    Attributes
    ----------
    outputs : int
    sampling_rate : float
        Hz, after decimation.
    groups : array of int, shape (pieces,)
        The stratum each piece belongs to; pieces are left out within their stratum. Empty where the
        record has no pieces that could be left out.
    unit : str
        What a piece is: "block", "hit", "driving point".
    energies : array, shape (pieces,)
        Mean square response of each piece.
    """

    outputs: int
    sampling_rate: float
    groups: Ints
    unit: str
    energies: Floats

    @property
    def weights(self) -> Floats:
        """How much each piece tells, shape (pieces,)."""
        return np.ones(len(self.groups))

    @abstractmethod
    def factor(self, keep: Bools | None = None) -> Floats:
        """Left factor of the data, shape (rows * outputs, m), columns by descending singular value."""

    def data(self) -> Floats:
        """Return the same of all the data, in no other weight than their own size."""
        return self.factor()

    def impulse(self, keep: Bools | None = None) -> Impulse | None:
        """Return the impulse responses behind the factor; None where no input was measured, and none can be known."""
        return None


@dataclass(frozen=True, eq=False)
class Impulse:
    """Impulse responses, or free decays.

    Parameters
    ----------
    sequence : array, shape (samples, outputs, inputs)
    start : int
        The first sample that is a sum of decaying exponentials.
    driven : array of int, shape (inputs,)
        The floor of each input; 0 the ground, or no input at all.
    wrapped : bool, optional
        Whether what comes after the end is folded back onto the start.
    pulse : array, shape (lags, inputs), optional
        The symmetric pulses that the sequence answers to, from lag 0 on; unit pulses where not given.
    """

    sequence: Floats
    start: int
    driven: Ints
    wrapped: bool = False
    pulse: Floats | None = None

    def excited(self, eigenvalues: Complexes, sampling_rate: float) -> Complexes:
        """Return the pulses' transforms at eigenvalues in 1/s, the factors of the residues, shape (modes, inputs)."""
        if self.pulse is None:
            return np.ones((len(eigenvalues), len(self.driven)), dtype=np.complex128)
        steps = np.outer(eigenvalues, np.arange(1, len(self.pulse))) / sampling_rate
        return np.asarray(self.pulse[0] + 2 * np.cosh(steps) @ self.pulse[1:])


class DampedModes:
    """Modes by their eigenvalues with positive imaginary part.

    Attributes
    ----------
    eigenvalues : array of complex, shape (m,)
        Continuous-time, 1/s.
    """

    eigenvalues: Complexes

    @cached_property
    def frequencies(self) -> Floats:
        """Undamped natural frequencies |lambda| / 2 pi, Hz."""
        return np.abs(self.eigenvalues) / (2 * np.pi)

    @cached_property
    def damping_ratios(self) -> Floats:
        """Fraction of critical."""
        return -self.eigenvalues.real / np.abs(self.eigenvalues)


@dataclass(frozen=True, eq=False)
class Poles(DampedModes):
    """Poles of one model order with positive imaginary part.

    Parameters
    ----------
    order : int
        Number of states.
    eigenvalues : array of complex, shape (k,)
        Continuous-time, 1/s.
    shapes : array of complex, shape (k, outputs)
        As seen by the sensors, unit norm, largest entry real and positive.
    """

    order: int
    eigenvalues: Complexes
    shapes: Complexes


def block_hankel(sequence: Floats, rows: int, columns: int, start: int = 1) -> Floats:
    """Block Hankel matrix of a sequence of Markov parameters.

    Parameters
    ----------
    sequence : array, shape (samples, outputs, inputs)
    rows, columns : int
        Block rows and block columns; rows + columns + start - 1 samples are used.
    start : int, optional
        The sample of the upper left block.

    Returns
    -------
    array, shape (rows * outputs, columns * inputs)
    """
    places = start + np.arange(rows)[:, None] + np.arange(columns)[None, :]
    _, outputs, inputs = sequence.shape
    return np.asarray(sequence[places].transpose(0, 2, 1, 3).reshape(rows * outputs, columns * inputs))


def left_factor(matrix: Floats) -> Floats:
    """Left singular vectors times singular values, by way of a triangle so that wide matrices stay cheap."""
    wide = matrix.shape[1] > matrix.shape[0]
    triangle = linalg.qr(matrix.T, mode="r", check_finite=False)[0][: matrix.shape[0]].T if wide else matrix
    left, values, _ = linalg.svd(triangle, full_matrices=False)
    return np.asarray(left * values)


def realize(factor: Floats, outputs: int, sampling_rate: float, orders: Iterable[int]) -> list[Poles]:
    """Poles and shapes for each order, from one left factor.

    With U the first n columns of the factor scaled to unit length, A = pinv(U without its last block row)
    (U without its first), C = the first block row of U (Juang and Pappa 1985, in the balanced or any other
    scaling: a change of state coordinates moves neither poles nor C times the eigenvectors).

    Parameters
    ----------
    factor : array, shape (rows * outputs, m)
    outputs : int
    sampling_rate : float
        Hz.
    orders : iterable of int
        Beyond the factor's rank the poles stay as they are.

    Returns
    -------
    list of Poles
    """
    norms = np.linalg.norm(factor, axis=0)
    rank = int(np.sum(norms > norms[0] * 1e-12)) if norms.size else 0
    basis = factor[:, :rank] / norms[:rank]
    upper, lower = basis[:-outputs], basis[outputs:]
    gram, shift = upper.T @ upper, upper.T @ lower
    # Noise-free data have a finite rank: beyond it the model cannot grow, and stays as it is.
    most = min(rank, len(upper))
    result: list[Poles] = []
    for order in orders:
        if order > most and result and result[-1].order >= most:
            result.append(dataclasses.replace(result[-1], order=order))
            continue
        result.append(_poles(basis, gram, shift, min(order, most), order, outputs, sampling_rate))
    return result


def _poles(
    basis: Floats, gram: Floats, shift: Floats, states: int, order: int, outputs: int, sampling_rate: float
) -> Poles:
    """Poles and shapes of a model with a given number of states."""
    transition = _least_squares(gram[:states, :states], shift[:states, :states])
    discrete, vectors = linalg.eig(transition)
    # A pole at the origin is a pure delay and has no continuous-time counterpart.
    used = (discrete.imag > 0) & (np.abs(discrete) > 1e-6)
    eigenvalues = np.log(discrete[used]) * sampling_rate
    shapes = (basis[:outputs, :states] @ vectors[:, used]).T
    return Poles(order, eigenvalues, normalized(shapes))


def _least_squares(gram: Floats, shift: Floats) -> Floats:
    """pinv(U) U' from the products U'U and U'U'; columns that depend on each other leave the least solution."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", linalg.LinAlgWarning)
        try:
            return np.asarray(linalg.solve(gram, shift, assume_a="pos"))
        except (linalg.LinAlgError, linalg.LinAlgWarning):
            return np.asarray(np.linalg.lstsq(gram, shift, rcond=None)[0], dtype=np.float64)


def normalized(shapes: Complexes) -> Complexes:
    """Shapes of unit norm whose largest entry is real and positive, shape (k, n)."""
    if not len(shapes):
        return shapes
    size = np.linalg.norm(shapes, axis=1, keepdims=True)
    largest = np.take_along_axis(shapes, ranking.largest(np.abs(shapes))[:, None], axis=1)
    return np.asarray(shapes / size * np.conj(largest) / np.abs(largest))
