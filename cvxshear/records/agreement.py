"""Compare modes with the measured functions, and with the modes of another method or program."""

import numpy as np

from cvxshear.data.pairing import mac
from cvxshear.records.findings import finding
from cvxshear.records.functions import Functions
from cvxshear.records.record import Finding
from cvxshear.records.result import ModalResult
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Complexes, Floats

SAME_FREQUENCY = 0.05
"""Largest relative difference between the frequencies of one mode by two methods."""
SAME_MODE_MAC = 0.9
"""Least MAC between the shapes of one mode by two methods; usual in the correlation of tests and models."""


def second_opinion(result: ModalResult, other: ModalResult) -> list[Finding]:
    """Report what another identification of the same test says of each mode.

    Parameters
    ----------
    result : ModalResult
    other : ModalResult
        By another method, or of a peer by `from_pyoma`, `from_sdypy` or `from_arrays`.

    Returns
    -------
    list of Finding
        One a mode: the other's frequency and the MAC of the shapes at the floors that both have, or that it is not
        among the other's; and one for each mode that the other alone has.
    """
    common = np.intersect1d(result.floors, other.floors)
    own, its = (
        item.mode_shapes[:, np.isin(item.floors, common)] / np.abs(item.mode_shapes).max(axis=1, keepdims=True)
        for item in (result, other)
    )
    found, seen = [], set()
    for row, (mode, frequency) in enumerate(zip(result.modes.tolist(), result.frequencies.tolist(), strict=True)):
        changes = other.frequencies / frequency - 1.0
        alike = np.array([mac(own[row], shape) for shape in its])
        near = np.flatnonzero((np.abs(changes) < SAME_FREQUENCY) & (alike > SAME_MODE_MAC))
        numbers = {"mode": mode, "method": other.name}
        if not near.size:
            closest = int(np.argmin(np.abs(changes)))
            near_by = {"own": frequency, "nearest": other.frequencies[closest], "alike": alike[closest]}
            found.append(finding("second opinion/none", {**numbers, "agrees": False}, **near_by))
            continue
        place = int(near[np.argmin(np.abs(changes[near]))])
        seen.add(place)
        its_own, change, same = (float(each[place]) for each in (other.frequencies, changes, alike))
        numbers |= {"agrees": True, "frequency": its_own, "change": change, "mac": same}
        found.append(finding("second opinion", numbers))
    for place, frequency in enumerate(other.frequencies.tolist()):
        if place not in seen:
            numbers = {"method": other.name, "agrees": False, "frequency": frequency}
            found.append(finding("second opinion/another", numbers))
    return found


def synthesized(result: ModalResult) -> Complexes:
    """Rebuild the measured functions from the identified modes, shape (lines, outputs, inputs).

    H_ij = sum_r (psi_ir L_rj / (i w - l_r) + its conjugate) + C_ij + D_ij / w^2 over the band of the modes, the poles
    l_r and shapes psi_r as identified, participations L and real residual terms C, D by least squares (least-squares
    frequency domain, Heylen, Lammens and Sas 1997). Where a mode's shape is wrong the curves part.

    Parameters
    ----------
    result : ModalResult
        Of `identify_modes` with `functions`.

    Returns
    -------
    array of complex
        nan outside the band, and at floors that the result has no shape for.

    Raises
    ------
    InputError
        Where the result holds no functions.
    """
    functions = result.functions
    if functions is None:
        raise InputError("the result holds no functions of its record: identify_modes keeps them with functions=True")
    within = band_of(functions.frequencies, result.frequencies)
    places = np.flatnonzero(np.isin(functions.floors, result.floors))
    basis = _basis(2 * np.pi * functions.frequencies[within], *_poles_and_shapes(functions, result))
    rows = np.vstack([basis.real, basis.imag])
    size = np.linalg.norm(rows, axis=0)
    answer = np.full(functions.values.shape, np.nan + 0j)
    for column in range(functions.values.shape[2]):
        target = functions.values[within][:, places, column].T.ravel()
        weights = np.linalg.lstsq(rows / size, np.concatenate([target.real, target.imag]), rcond=None)[0] / size
        answer[np.ix_(np.flatnonzero(within), places, np.array([column]))] = (
            (basis @ weights).reshape(len(places), -1).T[:, :, None]
        )
    return answer


def band_of(lines: Floats, frequencies: Floats) -> Bools:
    """Select the lines from half the lowest to 1.3 times the highest natural frequency, shape (lines,)."""
    return np.asarray((lines > 0.5 * frequencies[0]) & (lines < 1.3 * frequencies[-1]))


def _basis(omega: Floats, poles: Complexes, shapes: Complexes) -> Complexes:
    """Columns: real and imaginary parts of each mode's participation, then C and D of each output."""
    outputs, lines = shapes.shape[1], len(omega)
    columns = []
    for pole, shape in zip(poles, shapes, strict=True):
        up = np.outer(shape, 1 / (1j * omega - pole))
        down = np.outer(np.conj(shape), 1 / (1j * omega - np.conj(pole)))
        columns += [(up + down).ravel(), (1j * (up - down)).ravel()]
    for output in range(outputs):
        for residual in (np.ones(lines), (omega[0] / omega) ** 2):
            column = np.zeros((outputs, lines), dtype=np.complex128)
            column[output] = residual
            columns.append(column.ravel())
    return np.column_stack(columns)


def _poles_and_shapes(functions: Functions, result: ModalResult) -> tuple[Complexes, Complexes]:
    """Return the poles as the functions show them, windows and all, and the shapes as recorded where they are known."""
    omega = 2 * np.pi * result.frequencies
    decay = result.damping_ratios * omega
    poles = -decay - functions.decay + 1j * np.sqrt(np.maximum(omega**2 - decay**2, 0.0))
    if result.sweep is not None and len(result.sweep.chosen) == len(poles):
        return poles, np.array([item.shape for item in result.sweep.chosen])
    return poles, result.complex_shapes
