"""Frame with damping, and the motion of its floors under base motion or a force.

The poles s and complex shapes psi of (s^2 M + s C + K) psi = 0 give the displacements under forces b p(t) from rest,

    u(t) = sum over all poles of psi (psi' b) / a z(t),   a = psi' (2 s M + C) psi,   z' = s z + p

(Foss 1958). Real modes with modal damping are the case psi = phi, s = -zeta omega +- i omega sqrt(1 - zeta^2). If p is
a straight line between samples, z(t + h) = e^(s h) z(t) + (f1 - f2) p(t) + f2 p(t + h) with

    f1 = (e^(s h) - 1) / s,   f2 = (e^(s h) - 1 - s h) / (s^2 h).

This is the first-order hold (for one oscillator: Nigam and Jennings, 1969), a linear filter with one pole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from cvxshear.model.shear import Modes, modes
from cvxshear.records.motion import DrivenRun
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Complexes, Floats

UNCOUPLED = 1e-12
"""Largest damping between two modes, relative to their own damping, that counts as zero: the modes are real then."""


@dataclass(frozen=True, eq=False)
class DampedPoles:
    """Poles of a damped frame, one of each conjugate pair.

    Parameters
    ----------
    values : ndarray of complex, shape (p,)
        s, rad/s; ascending in size. Overdamped modes have two real poles each.
    shapes : ndarray of complex, shape (N, p)
        psi, one column per pole.
    scales : ndarray of complex, shape (p,)
        a = psi' (2 s M + C) psi.
    """

    values: Complexes
    shapes: Complexes
    scales: Complexes

    @property
    def weights(self) -> Floats:
        """Weight of each pole: 2 for a pole with a conjugate, 1 for a real pole, shape (p,)."""
        return np.where(self.values.imag > 0, 2.0, 1.0)

    @property
    def ratios(self) -> Floats:
        """Damping ratio -Re s / |s| of each pole, shape (p,)."""
        return -self.values.real / np.abs(self.values)


def modal_damping(real: Modes, C: Floats) -> Floats:
    """Compute Gamma = Phi' C Phi, shape (N, N): diagonal with 2 zeta omega if the modes are uncoupled."""
    return real.shapes @ C @ real.shapes.T


def poles(M: Floats, C: Floats, K: Floats) -> DampedPoles:
    """Compute the complex modes of a damped frame with symmetric matrices.

    Raises
    ------
    InputError
        If the undamped frame has no modes.
    """
    real = modes(M, K)
    gamma = modal_damping(real, C)
    own = np.diag(gamma)
    size = np.sqrt(np.abs(np.outer(own, own)))
    if np.all(np.abs(gamma - np.diag(own)) <= UNCOUPLED * np.maximum(size, np.max(size, initial=0.0) * 1e-3)):
        return classical(real, own)
    return coupled(real, gamma)


def classical(real: Modes, own: Floats) -> DampedPoles:
    """Return the poles of modes without coupling by damping; `own` is 2 zeta omega of each mode, rad/s."""
    omega = np.sqrt(real.eigenvalues)
    half = 0.5 * own
    root = np.sqrt((half**2 - omega**2).astype(np.complex128))
    over = half >= omega
    values = np.concatenate([-half + root, (-half - root)[over]])
    which = np.concatenate([np.arange(len(omega)), np.flatnonzero(over)])
    order = np.argsort(np.abs(values), kind="stable")
    values, which = values[order], which[order]
    return DampedPoles(values, real.shapes[which].T.astype(np.complex128), np.asarray(2 * values + own[which]))


def coupled(real: Modes, gamma: Floats) -> DampedPoles:
    """Compute the poles of modes that damping couples.

    The state is (omega q, q') of the modal coordinates q. Its undamped part is skew and evenly scaled.
    """
    n = len(gamma)
    omega = np.sqrt(real.eigenvalues)
    system = np.zeros((2 * n, 2 * n))
    system[:n, n:] = np.diag(omega)
    system[n:, :n] = -np.diag(omega)
    system[n:, n:] = -gamma
    values, states = np.linalg.eig(system)
    values, states = values.astype(np.complex128), states.astype(np.complex128)
    kept = np.flatnonzero(values.imag >= 0)
    kept = kept[np.argsort(np.abs(values[kept]), kind="stable")]
    s: Complexes = np.asarray(values[kept], dtype=np.complex128)
    q = states[:n, kept] / omega[:, None]
    scales = 2 * s * np.sum(q * q, axis=0) + np.sum(q * (gamma @ q), axis=0)
    return DampedPoles(s, np.asarray(real.shapes.T @ q, dtype=np.complex128), scales)


SMALL = 0.1
"""Largest |s h| for the power series; the differences themselves would lose digits there."""

TERMS = 12
"""Number of terms of this series; |x|^12 / 12! is far below rounding."""


def first_order_hold(s: Complexes, step: float) -> tuple[Complexes, Complexes, Complexes]:
    """Compute e^(s h), and the weights of the present and the previous sample, in the shape of s."""
    x: Complexes = np.asarray(s * step, dtype=np.complex128)
    E: Complexes = np.exp(x)
    small = np.abs(x) < SMALL
    safe: Complexes = np.where(small, np.complex128(1.0), x)
    first: Complexes = (E - 1) / safe
    second: Complexes = (first - 1) / safe
    first[small], second[small] = _series(x[small], 1), _series(x[small], 2)
    now: Complexes = step * second
    before: Complexes = step * first - now
    return E, now, before


def _series(x: Complexes, order: int) -> Complexes:
    """Compute (e^x - its Taylor polynomial below `order`) / x^order = sum of x^k / (k + order)!."""
    result = np.zeros_like(x)
    for k in reversed(range(TERMS)):
        # Horner's scheme: the coefficient of x^(k+1) is the coefficient of x^k divided by k + 1 + order.
        result = 1.0 + x / (k + 1 + order) * result
    return result / math.factorial(order)


def driven_poles(s: Complexes, p: Floats, step: float) -> Complexes:
    """Solve z' = s z + p for every pole from rest, by the first-order hold: shape (p, samples).

    The value at the first sample is zero; p is a straight line between samples.
    """
    E, now, before = first_order_hold(np.asarray(s), step)
    z = np.empty((len(E), len(p)), dtype=np.complex128)
    for row in range(len(E)):
        # This state before the first sample makes the first output zero: the frame is at rest.
        z[row], _ = scipy.signal.lfilter(
            [now[row], before[row]], [1.0, -E[row]], p, zi=np.array([-now[row] * p[0]])
        )  # fmt: skip
    return z


@dataclass(frozen=True, eq=False)
class DampedModel:
    """Mass, damping and stiffness matrices of one state of the frame.

    Parameters
    ----------
    M, C, K : ndarray, shape (N, N)
        kg, N s/m, N/m.
    gain : ndarray, shape (N,)
        Value that a sensor on each floor shows for a value of 1.
    heights : ndarray, shape (N,), optional
        Story heights, m.
    mass_known : bool, optional
        Whether the mass scale is known; without it, forces have no scale.
    input_gain : float, optional
        Ratio of the real excitation to the value that its sensor shows.
    """

    M: Floats
    C: Floats
    K: Floats
    gain: Floats
    heights: Floats | None = None
    mass_known: bool = True
    input_gain: float = 1.0

    @cached_property
    def modes(self) -> Modes:
        """Undamped modes."""
        return modes(self.M, self.K)

    @cached_property
    def poles(self) -> DampedPoles:
        """Complex modes."""
        return poles(self.M, self.C, self.K)

    @cached_property
    def ratios(self) -> Floats:
        """Damping ratio of each mode, shape (N,): from its pole, or from Phi' C Phi if a mode is overdamped."""
        if len(self.poles.values) == len(self.M) and np.all(self.poles.values.imag > 0):
            return self.poles.ratios
        ratios: Floats = np.diag(modal_damping(self.modes, self.C)) / (2 * np.sqrt(self.modes.eigenvalues))
        return ratios


@dataclass(frozen=True, eq=False)
class Response:
    """Motion of every floor, from rest.

    Parameters
    ----------
    time : ndarray, shape (samples,)
        s.
    acceleration : ndarray, shape (samples, N)
        Total accelerations of the floors, m/s2.
    displacement : ndarray, shape (samples, N)
        Displacements of the floors against the ground, m.
    story_force : ndarray, shape (samples, N)
        Shear of story i: the forces on floors i and above minus their inertia, N. Without a mass scale, per kilogram
        of the frame.
    heights : ndarray, shape (N,), optional
        Story heights, m.
    mass_known : bool
    """

    time: Floats
    acceleration: Floats
    displacement: Floats
    story_force: Floats
    heights: Floats | None
    mass_known: bool

    @property
    def drift(self) -> Floats:
        """Story drifts: each floor's displacement minus the lower floor's, shape (samples, N), m."""
        return np.diff(self.displacement, axis=1, prepend=0.0)

    @property
    def drift_ratio(self) -> Floats | None:
        """Drift over story height, shape (samples, N); None if heights are not declared."""
        return None if self.heights is None else self.drift / self.heights

    @property
    def story_shear(self) -> Floats | None:
        """`story_force`, N; None if the mass scale is unknown."""
        return self.story_force if self.mass_known else None

    @property
    def base_shear(self) -> Floats | None:
        """Shear of the first story, shape (samples,), N."""
        return self.story_force[:, 0] if self.mass_known else None

    @property
    def overturning_moment(self) -> Floats | None:
        """Moment of the floors' forces about the base, shape (samples,), N m; without gravity on displaced floors."""
        return self.story_force @ self.heights if self.mass_known and self.heights is not None else None


def response(model: DampedModel, run: DrivenRun, step: float) -> Response:
    """Compute the motion of the floors, exactly for an excitation that is a straight line between samples.

    Parameters
    ----------
    model : DampedModel
    drive : DrivenRun
        A base acceleration if its floor is 0, else a force.
    step : float
        Time between samples, s.

    Raises
    ------
    InputError
        If the force acts on a floor that the frame does not have.
    """
    n, p = len(model.M), run.excitation
    lines = p if run.between is None else run.between
    load = _load(model, run.floor)
    own = model.poles
    factors = own.weights * (own.shapes.T @ load) / own.scales
    z = driven_poles(own.values, lines, step)
    # u = Re(sum of shapes factors z). Its second derivative has s^2 in each term, and a jump at the load itself. For
    # base motion, this jump is the ground's own acceleration, which is also part of the total acceleration.
    table = own.shapes * factors
    both = np.concatenate([table * own.values**2, table])
    moved = np.hstack([both.real, -both.imag]) @ np.vstack([z.real, z.imag])
    acceleration, displacement = moved[:n].T, moved[n:].T
    forces = np.zeros((len(p), n))
    if run.floor:
        acceleration = acceleration + np.outer(p, np.linalg.solve(model.M, load))
        forces[:, run.floor - 1] = p
    unbalanced = forces - acceleration @ model.M
    return Response(
        time=step * np.arange(len(p), dtype=np.float64),
        acceleration=acceleration,
        displacement=displacement,
        story_force=np.cumsum(unbalanced[:, ::-1], axis=1)[:, ::-1],
        heights=model.heights,
        mass_known=model.mass_known,
    )


def _load(model: DampedModel, floor: int) -> Floats:
    """Return b of the forces b p(t): -M 1 for a base acceleration, a unit vector for a force."""
    n = len(model.M)
    if floor == 0:
        total: Floats = model.M.sum(axis=1)
        return -total
    if floor > n:
        raise InputError(f"the force acts on floor {floor} of a frame of {n} stories")
    unit = np.zeros(n)
    unit[floor - 1] = 1.0
    return unit
