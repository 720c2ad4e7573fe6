"""Mode shapes: phases, changes of sign, and the shapes of a shear frame.

The stiffness matrix of a shear frame is a Jacobi matrix, so mode r changes sign r - 1 times from the ground up
(Gantmacher and Krein 1950), and the first mode grows with height.
"""

from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.reading import fewest_changes, most_changes
from cvxshear.util import ranking
from cvxshear.util.typing import Bools, Complexes, Floats


def collinearity(shape: Complexes) -> float:
    """Modal phase collinearity (MPC): 1 where all entries lie on one line through the origin, 0 for a circle.

    ((Sxx - Syy)^2 + 4 Sxy^2) / (Sxx + Syy)^2 with S the second moments of real and imaginary parts
    (Pappa, Elliott and Schenk 1993).
    """
    x, y = shape.real, shape.imag
    sxx, syy, sxy = x @ x, y @ y, x @ y
    return float(((sxx - syy) ** 2 + 4 * sxy**2) / (sxx + syy) ** 2)


def main_axis(shape: Complexes) -> Complexes:
    """Turn a shape so that the sum of its squared imaginary parts is least; its largest entry is positive."""
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))
    largest = turned[ranking.first_largest(np.abs(turned))]
    return np.asarray(turned if largest.real > 0 else -turned)


def real_shape(shape: Complexes) -> Floats:
    """Find the real normal mode of a complex shape: moduli, with the sign of the real part on the main axis.

    A phase that a clock offset or damping put there costs a modulus nothing.

    Parameters
    ----------
    shape : array of complex, shape (n,)

    Returns
    -------
    array, shape (n,)
    """
    turned = main_axis(shape)
    return np.abs(turned) * np.where(turned.real < 0, -1.0, 1.0)


def lost_phase(shape: Complexes) -> float:
    """Angle off the main axis that a real shape leaves out, degrees, root mean square weighted by modulus squared."""
    return rms_phase(main_axis(shape))


def folded_phase(values: Complexes) -> Floats:
    """Angle off the real axis to the nearer side, rad."""
    return np.angle(values * np.where(values.real < 0, -1.0, 1.0))


def rms_phase(values: Complexes, weight: Floats | None = None) -> float:
    """Root mean square angle off the real axis, degrees, weighted by default by the squared moduli."""
    weight = np.abs(values) ** 2 if weight is None else weight
    return float(np.degrees(np.sqrt(np.sum(weight * folded_phase(values) ** 2) / np.sum(weight))))


def sign_changes(shape: Floats) -> int:
    """How often the shape changes sign from the ground up."""
    return fewest_changes(np.sign(shape))


def possible_changes(shape: Floats, tolerance: float) -> tuple[int, int]:
    """Fewest and most changes of sign, where entries below a part of the largest can have either sign.

    Over a distance of d floors between entries whose sign is sure there are d changes at most, and an odd number of
    them just where the signs differ.

    Parameters
    ----------
    shape : array, shape (n,)
    tolerance : float
        Of the largest entry.
    """
    signs = np.where(np.abs(shape) > tolerance * np.abs(shape).max(), np.sign(shape), 0.0)
    return fewest_changes(signs), most_changes(signs)


def scaled_to_one(shape: Floats) -> Floats:
    """Scale a shape to a largest entry of 1."""
    return np.asarray(shape / shape[ranking.first_largest(np.abs(shape))])


LONGEST = 0.05
"""Largest offset, s, looked for in the phases of the modes: the phases of the whole band show longer ones before."""
STEPS = 4001
"""Offsets tried between the two largest: steps of 25 microseconds turn a mode at 100 Hz by one degree."""
FOLDED = 0.85
"""Fraction of half the sampling rate. At higher frequencies, aliasing turns the phases of resonances."""


@dataclass(frozen=True, eq=False)
class Offsets:
    """Estimated clock offsets.

    Parameters
    ----------
    seconds : array, shape (clocks,)
        Positive where a channel's record is late, against the clock that is nearest to all the others; the
        channels in order of floor, then the input where its clock is seen.
    unexplained : array, shape (clocks,)
        Root mean square angle to the clock that the offsets count from, degrees, that the offset leaves over the modes.
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
    loud: Bools | None = None,
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
    loud : array of bool, shape (modes,), optional
        The modes that count, where they are two at least: a straight line takes each for as sure as the others.

    Returns
    -------
    Offsets
    """
    omega = np.abs(eigenvalues.imag)
    used = np.ones(len(omega), dtype=bool)
    for heard in (omega <= FOLDED * np.pi * sampling_rate, used if loud is None else loud):
        if np.count_nonzero(used & heard) >= 2:
            used = used & heard
    omega, shapes = omega[used], shapes[used]
    participations = None if participations is None else participations[used]
    if participations is not None:
        phasors = shapes * participations[:, None]
    else:
        floor = ranking.first_largest(np.min(np.abs(shapes), axis=0))
        phasors = shapes * np.conj(shapes[:, [floor]])
    phasors = phasors / np.maximum(np.linalg.norm(phasors, axis=1, keepdims=True), 1e-300)
    seconds = np.array([_slope(omega, column) for column in phasors.T])
    if participations is not None:
        seconds, phasors = np.append(seconds, 0.0), np.column_stack([phasors, np.ones(len(omega))])
    if reference is None:
        # Of an even number of clocks the two in the middle are equally near to all the others.
        reference = ranking.first_largest(-np.sum(np.abs(seconds[:, None] - seconds[None, :]), axis=1))
    seconds = seconds - seconds[reference]
    between = phasors * np.conj(phasors[:, [reference]])
    before = [rms_phase(column) for column in between.T]
    left = [rms_phase(column * np.exp(1j * omega * each)) for column, each in zip(between.T, seconds, strict=True)]
    return Offsets(seconds, np.array(left), np.array(before), reference)


def undone(eigenvalues: Complexes, shapes: Complexes, seconds: Floats) -> Complexes:
    """Take the offsets' turns back, shape (modes, channels)."""
    turn = np.exp(1j * np.abs(eigenvalues.imag)[:, None] * seconds[None, : shapes.shape[1]])
    return np.asarray(shapes * turn)


def _slope(omega: Floats, phasors: Complexes) -> float:
    """Find the offset that makes the phasors most nearly real, the smallest of several that do."""
    longest = min(LONGEST, 0.5 * np.pi / float(omega.min()))
    grid = np.linspace(-longest, longest, STEPS)
    turned = phasors[None, :] * np.exp(1j * grid[:, None] * omega[None, :])
    cost = np.sum(turned.imag**2, axis=1) / np.sum(np.abs(phasors) ** 2)
    start = grid[int(np.argmin(cost + 1e-3 * np.abs(grid) / longest))]
    # On the line the remaining angles are small, and least squares in the angle is a division.
    for _ in range(5):
        angle, weight = folded_phase(phasors * np.exp(1j * start * omega)), np.abs(phasors) ** 2
        start -= float(np.sum(weight * omega * angle) / np.sum(weight * omega**2))
    return float(start)
