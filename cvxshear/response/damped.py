"""Frame with damping: its matrices, complex modes and damping ratios."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.model.shear import Modes, modes
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Complexes, Floats


@dataclass(frozen=True, eq=False)
class DampedPoles:
    """Poles of a damped frame, one of each conjugate pair: (s^2 M + s C + K) psi = 0.

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


def modal_damping(real: Modes, C: Floats) -> Floats:
    """Compute Gamma = Phi' C Phi, shape (N, N): diagonal with 2 zeta omega if the modes are uncoupled."""
    return real.shapes @ C @ real.shapes.T


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
    def ratios(self) -> Floats:
        """Damping ratio of each mode, shape (N,): -Re s / |s| of its pole, or from Phi' C Phi if one is overdamped."""
        gamma = modal_damping(self.modes, self.C)
        s = coupled(self.modes, gamma).values
        if len(s) == len(self.M) and np.all(s.imag > 0):
            return -s.real / np.abs(s)
        ratios: Floats = np.diag(gamma) / (2 * np.sqrt(self.modes.eigenvalues))
        return ratios
