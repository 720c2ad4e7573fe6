"""Poles and shapes of every model order, from a block Hankel matrix, and those that come back at order after order.

Every method computes a matrix with the column space of the extended observability matrix, col(C, CA, CA^2, ...). Its
shift invariance gives A, its first block row C. A pole is stable if the next lower order of the sweep holds one of
nearly the same frequency, damping and shape. Stable poles of consecutive orders are chained into clusters; a cluster
that lives on through the rest of the sweep is a candidate for a mode.
"""

from __future__ import annotations

import dataclasses
import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence

import numpy as np
from scipy import linalg

from cvxshear.data.kinds import mac
from cvxshear.util import checks, ranking
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
        Mean square response of each block; other pieces have none.
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
        """Return the impulse responses behind the factor; None where there are none."""
        return None

    def residues(self, eigenvalues: Complexes, keep: Bools | None = None) -> tuple[Complexes, Ints] | None:
        """Find the amplitudes c of the impulse responses 2 Re(c_r z_r^k) to unit pulses, and the floors of the inputs.

        Shape (modes, outputs, inputs). None where no input was measured, and none can be known.
        """
        impulse = self.impulse(keep)
        if impulse is None or not np.all(impulse.driven > 0):
            return None
        found = impulse.amplitudes(eigenvalues, self.sampling_rate)
        if impulse.wrapped:
            length = len(impulse.sequence) / self.sampling_rate
            found = found * (1 - np.exp(eigenvalues * length))[:, None, None]
        return found / impulse.excited(eigenvalues, self.sampling_rate)[:, None, :], impulse.driven


@dataclasses.dataclass(frozen=True, eq=False)
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
    pulse: Floats = dataclasses.field(default_factory=lambda: np.ones((1, 1)))

    def amplitudes(self, eigenvalues: Complexes, sampling_rate: float) -> Complexes:
        """Fit Y_k = sum_r 2 Re(c_r z_r^k), k >= start, by least squares; c has the shape (modes, outputs, inputs)."""
        powers = np.exp(np.outer(np.arange(self.start, len(self.sequence)), eigenvalues) / sampling_rate)
        design = np.hstack([2 * powers.real, -2 * powers.imag])
        flat = np.linalg.lstsq(design, self.sequence[self.start :].reshape(len(powers), -1), rcond=None)[0]
        modes = len(eigenvalues)
        return np.asarray((flat[:modes] + 1j * flat[modes:]).reshape(modes, *self.sequence.shape[1:]))

    def excited(self, eigenvalues: Complexes, sampling_rate: float) -> Complexes:
        """Return the pulses' transforms at eigenvalues in 1/s, the factors of the residues, shape (modes, inputs)."""
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


@dataclasses.dataclass(frozen=True, eq=False)
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
    # pinv(U) U' from products; columns that depend on each other leave the least solution.
    transition = np.linalg.lstsq(gram[:states, :states], shift[:states, :states], rcond=None)[0]
    discrete, vectors = linalg.eig(transition)
    # A pole at the origin is a pure delay and has no continuous-time counterpart.
    used = (discrete.imag > 0) & (np.abs(discrete) > 1e-6)
    eigenvalues = np.log(discrete[used]) * sampling_rate
    shapes = (basis[:outputs, :states] @ vectors[:, used]).T
    return Poles(order, eigenvalues, normalized(shapes))


def normalized(shapes: Complexes) -> Complexes:
    """Shapes of unit norm whose largest entry is real and positive, shape (k, n)."""
    if not len(shapes):
        return shapes
    size = np.linalg.norm(shapes, axis=1, keepdims=True)
    largest = np.take_along_axis(shapes, ranking.largest(np.abs(shapes))[:, None], axis=1)
    return np.asarray(shapes / size * np.conj(largest) / np.abs(largest))


#: States of the largest model of a sweep: the minimum, and the number for each mode. A mode takes two, and has to
#: last.
LEAST_ORDERS, STATES = 30, 3


@dataclasses.dataclass(frozen=True)
class Criteria:
    """Criteria of stable poles and physical clusters; the defaults are the same for every record.

    Parameters
    ----------
    highest_order : int, optional
        The sweep runs over 2, 4, ..., this many states; where not given 30, or three for each mode that is wanted.
    frequency_change : float, optional
        Largest relative change of a stable pole's frequency from one order to the next.
    damping_change : float, optional
        Largest change of its damping ratio, relative or, where that is larger, absolute in units of 0.01.
    shape_agreement : float, optional
        Least MAC of its shape from one order to the next.
    highest_damping : float, optional
        Poles of more damping are numerical.
    least_persistence : float, optional
        Share of the orders, from its first on, in which a physical mode is stable.
    least_orders : int, optional
        Number of orders in which a physical mode is stable.
    least_collinearity : float, optional
        MPC, once clock offsets are removed.
    largest_shape_std : float, optional
        Of an entry over the mode's largest, by leaving parts of the record out.
    largest_frequency_std : float, optional
        Relative, by the same. A mode's deviation is a part of its half-power bandwidth, twice its damping ratio, and
        smaller by the root of the number of decays in the record.
    """

    highest_order: int | None = None
    frequency_change: float = 0.01
    damping_change: float = 0.5
    shape_agreement: float = 0.95
    highest_damping: float = 0.1
    least_persistence: float = 0.5
    least_orders: int = 4
    least_collinearity: float = 0.7
    largest_shape_std: float = 0.3
    largest_frequency_std: float = 0.02

    def __post_init__(self) -> None:
        if self.highest_order is not None:
            checks.whole(self.highest_order, "highest_order", least=4, most=400)
        for field in dataclasses.fields(self)[1:]:
            checks.number(getattr(self, field.name), field.name, above=0.0)

    def orders(self, count: int) -> range:
        """Return the orders of a sweep for a number of modes."""
        highest = max(LEAST_ORDERS, STATES * count) if self.highest_order is None else self.highest_order
        return range(2, highest + 1, 2)


#: Poles of several orders that are taken for one mode, by their places: index of the order, index of the pole.
Cluster = list[tuple[int, int]]


def plausible(poles: Poles, sampling_rate: float, highest_damping: float, shift: float = 0.0) -> list[int]:
    """List the poles that decay, not too fast, below half the sampling rate, by their indices.

    `shift` (1/s) is the decay that an exponential window added.
    """
    damping = -(poles.eigenvalues.real + shift) / np.abs(poles.eigenvalues)
    return [
        index
        for index, (frequency, ratio) in enumerate(zip(poles.frequencies, damping, strict=True))
        if 0 < ratio < highest_damping and frequency < 0.49 * sampling_rate
    ]


def stable_poles(
    sweep: Sequence[Poles], sampling_rate: float, criteria: Criteria, shift: float = 0.0
) -> list[list[int]]:
    """For each order the indices of its stable poles; none in the first order."""
    result: list[list[int]] = [[]]
    for before, after in itertools.pairwise(sweep):
        earlier = plausible(before, sampling_rate, criteria.highest_damping, shift)
        now = plausible(after, sampling_rate, criteria.highest_damping, shift)
        result.append([j for j in now if any(_alike(before, i, after, j, criteria) for i in earlier)])
    return result


def _alike(before: Poles, i: int, after: Poles, j: int, criteria: Criteria) -> bool:
    f0, f1 = before.frequencies[i], after.frequencies[j]
    d0, d1 = before.damping_ratios[i], after.damping_ratios[j]
    return bool(
        abs(f1 - f0) <= criteria.frequency_change * f0
        and abs(d1 - d0) <= criteria.damping_change * max(d0, 0.01)
        and mac(before.shapes[i], after.shapes[j]) >= criteria.shape_agreement
    )


def clusters(sweep: Sequence[Poles], stable: Sequence[Sequence[int]], criteria: Criteria) -> list[Cluster]:
    """Chains of stable poles, each order's nearest to the chain's latest member joining it."""
    found: list[Cluster] = []
    for place, indices in enumerate(stable):
        pairs = []
        for j in indices:
            for number, cluster in enumerate(found):
                i0, j0 = cluster[-1]
                if _alike(sweep[i0], j0, sweep[place], j, criteria):
                    moved = sweep[place].eigenvalues[j] / sweep[i0].eigenvalues[j0] - 1
                    pairs.append((abs(moved), number, j))
        joined: set[int] = set()
        grown: set[int] = set()
        for _, number, j in sorted(pairs):
            if j not in joined and number not in grown:
                found[number].append((place, j))
                joined.add(j)
                grown.add(number)
        found.extend([(place, j)] for j in indices if j not in joined)
    return found


def undivided(
    cluster: Cluster, sweep: Sequence[Poles], criteria: Criteria, shift: float = 0.0
) -> list[tuple[int, int]]:
    """Select the members whose order holds no second pole of the same shape nearby.

    A model of too high an order splits a mode with a slightly variable frequency into two wrong modes. All members
    where every order does.
    """
    alone = []
    for i, j in cluster:
        poles = sweep[i]
        twins = [
            k
            for k in plausible(poles, np.inf, criteria.highest_damping, shift)
            if k != j
            and abs(poles.frequencies[k] - poles.frequencies[j]) < 0.05 * poles.frequencies[j]
            and mac(poles.shapes[k], poles.shapes[j]) > criteria.shape_agreement
        ]
        if not twins:
            alone.append((i, j))
    return alone or cluster


def nearest(poles: Poles, eigenvalue: complex, shape: Complexes, reach: float = 0.05) -> int | None:
    """Index of the nearest pole in the complex plane with a similar shape; None beyond `reach` (relative)."""
    distances = np.abs(poles.eigenvalues - eigenvalue) / abs(eigenvalue)
    near = np.flatnonzero(distances < reach)
    ordered = near[np.argsort(distances[near], kind="stable")].tolist()
    return next((index for index in ordered if mac(poles.shapes[index], shape) > 0.8), None)


def center(eigenvalues: Complexes, shapes: Complexes) -> tuple[complex, Complexes]:
    """Find the middle of a cluster: the median of eigenvalues and of shapes turned to one phase, part by part."""
    turns = np.array([np.vdot(shape, shapes[0]) for shape in shapes])
    aligned = shapes * (turns / np.abs(turns))[:, None]
    value = complex(float(np.median(eigenvalues.real)), float(np.median(eigenvalues.imag)))
    return value, np.median(aligned.real, axis=0) + 1j * np.median(aligned.imag, axis=0)


def energies(factor: Floats, poles: Sequence[tuple[complex, Complexes]], sampling_rate: float) -> Floats:
    """Share of the data's energy that each mode carries, shape (modes,).

    The factor of the Hankel matrix is fitted by the modes' observability vectors, col(shape, z shape,
    z^2 shape, ...); a mode's energy is the energy of its two terms.
    """
    if not poles:
        return np.zeros(0)
    outputs = len(poles[0][1])
    rows = len(factor) // outputs
    columns = [
        ((np.exp(value / sampling_rate) ** np.arange(rows))[:, None] * shape[None, :]).ravel() for value, shape in poles
    ]
    basis = np.column_stack([part for column in columns for part in (column.real, column.imag)])
    weights = np.linalg.lstsq(basis, factor, rcond=None)[0]
    parts = [np.linalg.norm(basis[:, 2 * i : 2 * i + 2] @ weights[2 * i : 2 * i + 2]) ** 2 for i in range(len(poles))]
    return np.asarray(parts) / float(np.linalg.norm(factor) ** 2)
