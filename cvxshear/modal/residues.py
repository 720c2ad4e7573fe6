"""Residues of identified poles, and the scale they give the shapes."""

from __future__ import annotations

import numpy as np

from cvxshear.modal.runs import Complexes
from cvxshear.util.typing import Floats, Ints

DERIVATIVES = {"displacement": 0, "velocity": 1, "acceleration": 2}


def residues(sequence: Floats, eigenvalues: Complexes, sampling_rate: float, start: int) -> Complexes:
    """Complex amplitudes c of a sequence Y_k = sum_r 2 Re(c_r z_r^k), k >= start, by least squares.

    Parameters
    ----------
    sequence : array, shape (samples, outputs, inputs)
    eigenvalues : array of complex, shape (modes,)
        1/s.
    sampling_rate : float
        Hz.
    start : int

    Returns
    -------
    array of complex, shape (modes, outputs, inputs)
    """
    count = len(sequence) - start
    powers = np.exp(np.outer(np.arange(start, start + count), eigenvalues) / sampling_rate)
    design = np.hstack([2 * powers.real, -2 * powers.imag])
    flat = np.linalg.lstsq(design, sequence[start:].reshape(count, -1), rcond=None)[0]
    modes = len(eigenvalues)
    return np.asarray((flat[:modes] + 1j * flat[modes:]).reshape(modes, *sequence.shape[1:]))


def modal_products(
    amplitudes: Complexes, eigenvalues: Complexes, sampling_rate: float, quantity: str, *, base: bool
) -> Complexes:
    """What the amplitudes say of shape times participation, shape (modes, outputs, inputs); real for real modes.

    The receptance residue of a mass-normalized real mode is phi_i phi_d / (2i w_d); a derivative multiplies
    it by the eigenvalue, a base acceleration's participation stands for -phi_d. The sampled sequence is 1/fs
    times the continuous one.
    """
    factor = 2j * np.abs(eigenvalues.imag) / eigenvalues ** DERIVATIVES[quantity]
    sign = -1.0 if base else 1.0
    return np.asarray(sign * amplitudes * (factor * sampling_rate)[:, None, None])


def unwrapped(amplitudes: Complexes, eigenvalues: Complexes, length: float) -> Complexes:
    """Amplitudes of the response itself, from those of one folded back onto itself after `length` seconds."""
    return np.asarray(amplitudes * (1 - np.exp(eigenvalues * length))[:, None, None])


def participations(products: Complexes, shapes: Complexes) -> Complexes:
    """The complex number for each mode that turns its shape into its products, strongest input, shape (modes,)."""
    columns = np.einsum("ri,rij->rj", np.conj(shapes), products) / np.sum(np.abs(shapes) ** 2, axis=1)[:, None]
    strongest = np.argmax(np.abs(columns), axis=1)
    return np.asarray(columns[np.arange(len(columns)), strongest])


def modal_scale(products: Complexes, shape: Floats, floors: Ints, driven: Ints) -> float | None:
    """The factor that mass-normalizes a real shape, 1/sqrt(kg).

    With phi = q psi, products = q^2 psi_i psi_d; q^2 by least squares over all responses and driving points.
    None where no driving point carries a sensor, or where the driving points say that q^2 is not positive.

    Parameters
    ----------
    products : array of complex, shape (outputs, inputs)
    shape : array, shape (outputs,)
        psi.
    floors, driven : array of int
        Floors of the outputs and of the inputs.
    """
    places = {int(floor): place for place, floor in enumerate(floors)}
    columns = [j for j, floor in enumerate(driven) if int(floor) in places]
    if not columns:
        return None
    model = np.outer(shape, [shape[places[int(driven[j])]] for j in columns])
    square = float(np.sum(model * products[:, columns].real) / np.sum(model**2))
    return float(np.sqrt(square)) if square > 0 else None
