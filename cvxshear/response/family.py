"""Real modes of many frames at once, such as samples of an uncertain one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.response.poles import UNCOUPLED, Complexes
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class Family:
    """What the accelerations and drifts of S frames under base motion are made of.

    Quantity j (the N total accelerations of the floors, then the N story drifts) of frame i is the real part of the
    sum over modes of shapes[j, i] factors[j // N, i] z, with z' = values[i] z + base acceleration.

    Parameters
    ----------
    values : ndarray of complex, shape (S, N)
        One pole of each pair, rad/s.
    shapes : ndarray, shape (2 N, S, N)
        Share of each mode in floor displacements and then in drifts.
    factors : ndarray of complex, shape (2, S, N)
        From z to a mode's acceleration and to its displacement.
    """

    values: Complexes
    shapes: Floats
    factors: Complexes

    @property
    def stories(self) -> int:
        """N."""
        return int(self.values.shape[1])

    @staticmethod
    def of(M: Floats, C: Floats, K: Floats) -> Family | None:
        """The modes of frames that damping does not couple; None where it couples or stops one.

        Parameters
        ----------
        M, C, K : ndarray, shape (S, N, N)
            Symmetric; kg, N s/m, N/m.
        """
        squares, phi = _modes(M, K)
        gamma = np.swapaxes(phi, 1, 2) @ C @ phi
        diagonal = np.einsum("sii->si", gamma)
        own = diagonal.copy()
        diagonal[:] = 0.0
        coupling = np.maximum(gamma.max(axis=(1, 2)), -gamma.min(axis=(1, 2)))
        damped = squares - (own / 2) ** 2
        if np.any(damped <= 0) or np.any(coupling > UNCOUPLED * own.max(axis=1)):
            return None
        swinging = np.sqrt(damped)
        values = -own / 2 + 1j * swinging
        # u = Re(2 phi (phi' b) / a z) with b = -M 1 and a = 2 i omega_d.
        displaced = np.moveaxis(phi * -(M.sum(axis=2)[:, None, :] @ phi), 1, 0)
        moved = -1j / swinging
        shapes = np.concatenate([displaced, np.diff(displaced, axis=0, prepend=0.0)])
        return Family(values, shapes, np.array([moved * values**2, moved]))


def _modes(M: Floats, K: Floats) -> tuple[Floats, Floats]:
    """Squares of the angular frequencies, shape (S, N), and mass-normalized shapes, a column each, (S, N, N)."""
    diagonal = np.diagonal(M, axis1=1, axis2=2)
    if np.count_nonzero(M) == np.count_nonzero(diagonal):
        root = 1.0 / np.sqrt(diagonal)
        squares, vectors = np.linalg.eigh(root[:, :, None] * K * root[:, None, :])
        return squares, root[:, :, None] * vectors
    half = np.linalg.inv(np.linalg.cholesky(M))
    turned = np.swapaxes(half, 1, 2)
    squares, vectors = np.linalg.eigh(half @ K @ turned)
    return squares, turned @ vectors
