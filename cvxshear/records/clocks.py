"""Clock offsets between channels, from the phases they put on modes that should be real.

A channel whose clock is late by tau shows every component of angular frequency w turned by -w tau. The
shapes of a lightly damped frame are nearly real, so the turn of each entry, known up to half a turn, is a
straight line through the origin over the natural frequencies, whose slope is the offset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.records.record import Complexes
from cvxshear.util.typing import Floats

STEPS = 4001
LONGEST = 0.05
"""s; a longer offset is looked for with the eyes."""
FOLDED = 0.85
"""Of half the sampling rate, above which what folds back from beyond it turns the phases of a resonance."""


@dataclass(frozen=True, eq=False)
class Offsets:
    """Estimated clock offsets.

    Parameters
    ----------
    seconds : array, shape (clocks,)
        Positive where a channel's record is late, against the clock that is nearest to all the others; the
        channels in order of floor, then the input where its clock is seen.
    unexplained : array, shape (clocks,)
        Root mean square angle, degrees, that the offset leaves, over the modes, weighted as the fit.
    before : array, shape (clocks,)
        The same angle without the offset.
    reference : int
        The clock that the offsets count from.
    """

    seconds: Floats
    unexplained: Floats
    before: Floats
    reference: int


def offsets(
    eigenvalues: Complexes,
    shapes: Complexes,
    participations: Complexes | None = None,
    reference: int | None = None,
    sampling_rate: float = np.inf,
) -> Offsets:
    """Estimate the offset of every channel's clock.

    Parameters
    ----------
    eigenvalues : array of complex, shape (modes,)
        1/s.
    shapes : array of complex, shape (modes, channels)
    participations : array of complex, shape (modes,), optional
        What turns each shape into a residue that is real for a real mode and clocks that agree; the input's
        clock is then estimated as well.
    reference : int, optional
        The clock to count from; the one nearest to all the others where None.
    sampling_rate : float, optional
        Hz. Modes above `FOLDED` of its half do not count, where two others are left.

    Returns
    -------
    Offsets
    """
    omega = np.abs(eigenvalues.imag)
    heard = omega <= FOLDED * np.pi * sampling_rate
    if 2 <= np.count_nonzero(heard) < len(omega):
        omega, shapes = omega[heard], shapes[heard]
        participations = None if participations is None else participations[heard]
    if participations is not None:
        phasors = shapes * participations[:, None]
    else:
        floor = int(np.argmax(np.min(np.abs(shapes), axis=0)))
        phasors = shapes * np.conj(shapes[:, [floor]])
    phasors = phasors / np.maximum(np.linalg.norm(phasors, axis=1, keepdims=True), 1e-300)
    fitted = [_slope(omega, column) for column in phasors.T]
    seconds = np.array([item[0] for item in fitted])
    left = np.array([item[1] for item in fitted])
    before = np.array([_angle(column, np.zeros(len(omega))) for column in phasors.T])
    if participations is not None:
        seconds, left, before = np.append(seconds, 0.0), np.append(left, 0.0), np.append(before, 0.0)
    if reference is None:
        reference = int(np.argmin(np.sum(np.abs(seconds[:, None] - seconds[None, :]), axis=1)))
    return Offsets(seconds - seconds[reference], left, before, reference)


def undone(eigenvalues: Complexes, shapes: Complexes, seconds: Floats) -> Complexes:
    """The shapes with the offsets' turns taken back, shape (modes, channels)."""
    turn = np.exp(1j * np.abs(eigenvalues.imag)[:, None] * seconds[None, : shapes.shape[1]])
    return np.asarray(shapes * turn)


def _slope(omega: Floats, phasors: Complexes) -> tuple[float, float]:
    """The offset that makes the phasors most nearly real, the smallest where several do equally, and what is left."""
    longest = min(LONGEST, 0.5 * np.pi / float(omega.min()))
    grid = np.linspace(-longest, longest, STEPS)
    turned = phasors[None, :] * np.exp(1j * grid[:, None] * omega[None, :])
    cost = np.sum(turned.imag**2, axis=1) / np.sum(np.abs(phasors) ** 2)
    start = grid[int(np.argmin(cost + 1e-3 * np.abs(grid) / longest))]
    # On the line the remaining angles are small, and least squares in the angle is a division.
    for _ in range(5):
        now = phasors * np.exp(1j * start * omega)
        angle = np.angle(now * np.where(now.real < 0, -1.0, 1.0))
        weight = np.abs(phasors) ** 2
        start -= float(np.sum(weight * omega * angle) / np.sum(weight * omega**2))
    return float(start), _angle(phasors, omega * start)


def _angle(phasors: Complexes, turn: Floats) -> float:
    now = phasors * np.exp(1j * turn)
    angle = np.angle(now * np.where(now.real < 0, -1.0, 1.0))
    weight = np.abs(phasors) ** 2
    return float(np.degrees(np.sqrt(np.sum(weight * angle**2) / np.sum(weight))))
