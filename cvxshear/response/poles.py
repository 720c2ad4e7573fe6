"""Complex modes of a damped frame: the poles s and shapes psi of (s^2 M + s C + K) psi = 0.

With forces f(t) = b p(t) from rest, the displacements are

    u(t) = sum over all poles of psi (psi' b) / a z(t),   a = psi' (2 s M + C) psi,   z' = s z + p

(Foss 1958). Real modes with modal damping are the case psi = phi, s = -zeta omega +- i omega sqrt(1 - zeta^2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cvxshear.model.shear import Modes, modes
from cvxshear.util.typing import Floats

Complexes = NDArray[np.complex128]

UNCOUPLED = 1e-12
"""Damping between two modes, relative to their own, that is rounding: the modes are real then."""


@dataclass(frozen=True, eq=False)
class Poles:
    """Poles of a damped frame, one of each conjugate pair.

    Parameters
    ----------
    values : ndarray of complex, shape (p,)
        s, rad/s; ascending in size. Overdamped modes have two real ones each.
    shapes : ndarray of complex, shape (N, p)
        psi, a column a pole.
    scales : ndarray of complex, shape (p,)
        a = psi' (2 s M + C) psi.
    """

    values: Complexes
    shapes: Complexes
    scales: Complexes

    @property
    def weights(self) -> Floats:
        """2 for a pole that stands for its conjugate too, else 1, shape (p,)."""
        return np.where(self.values.imag > 0, 2.0, 1.0)

    @property
    def ratios(self) -> Floats:
        """Damping ratio -Re s / |s| of each pole, shape (p,)."""
        return -self.values.real / np.abs(self.values)


def modal_damping(of: Modes, C: Floats) -> Floats:
    """Gamma = Phi' C Phi, shape (N, N): diagonal with 2 zeta omega where the modes do not couple."""
    return of.shapes @ C @ of.shapes.T


def poles(M: Floats, C: Floats, K: Floats) -> Poles:
    """The complex modes of a damped frame.

    Parameters
    ----------
    M, C, K : ndarray, shape (N, N)
        Symmetric; kg, N s/m, N/m.

    Raises
    ------
    InputError
        Where the undamped frame has no modes.
    """
    real = modes(M, K)
    gamma = modal_damping(real, C)
    own = np.diag(gamma)
    size = np.sqrt(np.abs(np.outer(own, own)))
    if np.all(np.abs(gamma - np.diag(own)) <= UNCOUPLED * np.maximum(size, np.max(size, initial=0.0) * 1e-3)):
        return classical(real, own)
    return coupled(real, gamma)


def classical(real: Modes, own: Floats) -> Poles:
    """Poles of modes that damping does not couple.

    Parameters
    ----------
    real : Modes
    own : ndarray, shape (N,)
        2 zeta omega of each mode, rad/s.
    """
    omega = np.sqrt(real.eigenvalues)
    half = 0.5 * own
    root = np.sqrt((half**2 - omega**2).astype(np.complex128))
    over = half >= omega
    values = np.concatenate([-half + root, (-half - root)[over]])
    which = np.concatenate([np.arange(len(omega)), np.flatnonzero(over)])
    order = np.argsort(np.abs(values), kind="stable")
    values, which = values[order], which[order]
    return Poles(values, real.shapes[which].T.astype(np.complex128), np.asarray(2 * values + own[which]))


def coupled(real: Modes, gamma: Floats) -> Poles:
    """Poles of modes that damping couples.

    The state is (omega q, q') of the modal coordinates q, in which the undamped part is skew and of even scale.
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
    return Poles(s, np.asarray(real.shapes.T @ q, dtype=np.complex128), scales)
