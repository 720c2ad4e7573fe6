"""How modes agree with the measured functions, and with a second opinion: another method's, a peer's, or peaks."""

import numpy as np

from cvxshear.data.pairing import mac
from cvxshear.records.adapters import from_arrays
from cvxshear.records.findings import finding
from cvxshear.records.functions import Functions
from cvxshear.records.record import Finding
from cvxshear.records.result import ModalResult
from cvxshear.util.errors import InputError, NoSolutionError
from cvxshear.util.typing import Bools, Complexes, Floats

FDD = "fdd"
"""The name of the frequency domain decomposition among methods."""
SAME_FREQUENCY = 0.05
"""Relative distance of frequencies within which two methods may have found the same mode."""
SAME_MODE_MAC = 0.9
"""MAC from which on two shapes within that distance are taken for those of one mode; usual in correlating tests."""


def frequency_domain_decomposition(functions: Functions, count: int, stories: int) -> ModalResult:
    """Modes at the peaks of the largest singular value of the measured functions, with its singular vectors as shapes.

    The largest peaks, each refined by the parabola through three lines of the logarithm. Of half-spectra this is the
    frequency domain decomposition (Brincker, Zhang and Andersen 2001), of frequency response functions the complex mode
    indicator function (Shih, Tsuei, Allemang and Brown 1988); neither uses a model of the poles.

    Parameters
    ----------
    functions : Functions
        Of a record, by `identify_modes` with `functions=True`.
    count : int
        Most modes.
    stories : int

    Returns
    -------
    ModalResult
        Frequencies known to a line's width over the root of twelve; shape entries to an assumed 1 %.

    Raises
    ------
    NoSolutionError
        Where there is no peak.
    """
    left, values, _ = np.linalg.svd(functions.values, full_matrices=False)
    height = np.log(np.maximum(values[:, 0], 1e-300))
    peaks = np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:])) + 1
    # A peak of noise stands little above the valleys on both sides of it.
    prominence = np.array([height[place] - _saddle(height, int(place)) for place in peaks])
    places = np.sort(peaks[np.argsort(-prominence)[:count]])
    if not len(places):
        raise NoSolutionError(FDD, "the measured functions have no peak")
    before, at, after = (height[places + step] for step in (-1, 0, 1))
    step = functions.frequencies[1] - functions.frequencies[0]
    frequencies = functions.frequencies[places] + 0.5 * step * (before - after) / (before - 2 * at + after)
    std, shapes = step / np.sqrt(12.0) / frequencies, left[places, :, 0]
    return from_arrays(frequencies, shapes, floors=functions.floors, stories=stories, frequency_std=std, name=FDD)


def _saddle(height: Floats, place: int) -> float:
    """Find the higher of the two lowest points between a peak and what is higher than it on either side."""
    lowest = []
    for side in (height[:place][::-1], height[place + 1 :]):
        higher = np.flatnonzero(side > height[place])
        lowest.append(side[: higher[0] if higher.size else None].min())
    return float(max(lowest))


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
