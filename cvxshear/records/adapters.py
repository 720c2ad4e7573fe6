"""Modes that were identified elsewhere, and how well modes agree with others and with the measured functions."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cvxshear.data.kinds import mac
from cvxshear.records.functions import Functions
from cvxshear.records.mode_shapes import collinearity, lost_phase, main_axis, real_shape
from cvxshear.records.record import Finding, finding
from cvxshear.records.result import ModalResult
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Complexes, Floats


def from_arrays(
    frequencies: ArrayLike,
    mode_shapes: ArrayLike,
    *,
    floors: ArrayLike | None = None,
    stories: int | None = None,
    damping_ratios: ArrayLike | None = None,
    frequency_std: ArrayLike | None = None,
    mode_shape_std: ArrayLike | None = None,
    mass_normalized: bool = False,
    name: str = "given modes",
) -> ModalResult:
    """Modes that somebody else identified, as a result that can be written to a measurement file.

    Parameters
    ----------
    frequencies : array_like, shape (m,)
        Hz, in any order.
    mode_shapes : array_like, real or complex, shape (m, n)
        One row a mode. Complex shapes are made real by magnitude.
    floors : array_like of int, shape (n,), optional
        1, 2, ..., n where None.
    stories : int, optional
        The highest floor where None.
    damping_ratios : array_like, shape (m,), optional
        Fraction of critical; nan in the result, and left out of files, if None.
    frequency_std : float or array_like, shape (m,), optional
        Relative standard deviations; nan in the result, and left out of files, if None.
    mode_shape_std : float or array_like, shape (m, n), optional
        Standard deviations of the entries, relative to each mode's largest entry; nan in the result, and left out of
        files, if None.
    mass_normalized : bool, optional
    name : str, optional

    Returns
    -------
    ModalResult

    Raises
    ------
    InputError
        Where the arrays do not fit each other or are not finite.
    """
    values = _finite(frequencies, "frequencies", 1).real
    shapes = np.asarray(_finite(mode_shapes, "mode_shapes", 2), dtype=np.complex128)
    count, width = shapes.shape
    if len(values) != count:
        raise InputError(f"mode_shapes has {count} rows, frequencies {len(values)} entries; one row a mode")
    places = np.arange(1, width + 1) if floors is None else np.asarray(floors, dtype=np.int64)
    if places.shape != (width,):
        raise InputError(f"floors must have {width} entries, one a column of mode_shapes, not {places.size}")
    by_floor, by_frequency = np.argsort(places), np.argsort(values)
    shapes = shapes[by_frequency][:, by_floor]
    # A real shape stands as it is, sign and all.
    real = np.array([real_shape(shape) if np.any(shape.imag) else shape.real for shape in shapes])
    frequency = _given(frequency_std, (count,), "frequency_std")[by_frequency]
    entries = _given(mode_shape_std, (count, width), "mode_shape_std")[by_frequency][:, by_floor]
    damping = _given(damping_ratios, (count,), "damping_ratios")[by_frequency]
    missing = [key for key, given in (("frequencies", frequency_std), ("shapes", mode_shape_std)) if given is None]
    highest = int(places.max())
    return ModalResult(
        name=checks.text(name, "name"),
        method="given",
        stories=highest if stories is None else checks.whole(stories, "stories", least=highest, most=2000),
        floors=places[by_floor],
        frequencies=values[by_frequency],
        frequency_std=frequency,
        damping_ratios=damping,
        damping_std=np.zeros(count),
        mode_shapes=real,
        mode_shape_std=entries,
        entry_std=entries,
        mass_normalized=checks.flag(mass_normalized, "mass_normalized"),
        modes=np.arange(1, count + 1, dtype=np.int64),
        complex_shapes=np.array([main_axis(shape) for shape in shapes]),
        phase_collinearity=np.array([collinearity(shape) for shape in shapes]),
        lost_phase=np.array([lost_phase(shape) for shape in shapes]),
        clock_offsets={},
        covariance=np.diag(np.concatenate([frequency, entries.ravel()]) ** 2),
        uncertainty="as given" if not missing else f"not given for {' and '.join(missing)}",
    )


def from_pyoma(
    found: Any, *, floors: ArrayLike | None = None, stories: int | None = None, name: str = "pyOMA2"
) -> ModalResult:
    """Modes of a pyOMA2 algorithm that has been run and whose modes have been chosen.

    Parameters
    ----------
    found : pyOMA2 algorithm or result
        Anything with `Fn`, shape (m,), and `Phi`, shape (channels, m), or with such a `result`. `Xi` and the
        standard deviations `Fn_std` are used where they are there. `Phi_std` is not: it is of another
        normalization in each version.
    floors : array_like of int, shape (channels,), optional
        The floor of each channel; 1, 2, ... where None.
    stories : int, optional
    name : str, optional

    Returns
    -------
    ModalResult

    Raises
    ------
    InputError
        Where no modes have been chosen yet.
    """
    result = getattr(found, "result", found)
    frequencies, shapes = getattr(result, "Fn", None), getattr(result, "Phi", None)
    if frequencies is None or shapes is None:
        raise InputError(
            "the pyOMA2 object holds no modes (Fn, Phi): run the algorithm and choose modes first, by mpe or a cluster"
        )
    frequencies = np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    std, damping = getattr(result, "Fn_std", None), getattr(result, "Xi", None)
    known: dict[str, Any] = {
        "damping_ratios": None if damping is None else np.clip(np.atleast_1d(damping), 0.0, None),
        "frequency_std": None if std is None else np.atleast_1d(std) / frequencies,
    }
    rows = np.atleast_2d(np.asarray(shapes).T)
    return from_arrays(frequencies, rows, floors=floors, stories=stories, name=name, **known)


def from_sdypy(
    model: Any, *, floors: ArrayLike | None = None, stories: int | None = None, name: str = "sdypy"
) -> ModalResult:
    """Modes of a sdypy-EMA model whose poles have been selected and whose modal constants have been computed.

    Parameters
    ----------
    model : sdypy.EMA.Model
        Anything with `nat_freq` and `nat_xi`, shape (m,), and the modal constants `A`, shape (channels, m), of one
        driving point.
    floors : array_like of int, shape (channels,), optional
        The floor of each channel; 1, 2, ... where None.
    stories : int, optional
    name : str, optional

    Returns
    -------
    ModalResult

    Raises
    ------
    InputError
        Where no poles have been selected, one of them was not found, or there are no modal constants.
    """
    frequencies, constants = getattr(model, "nat_freq", None), getattr(model, "A", None)
    if frequencies is None or constants is None:
        raise InputError(
            "the sdypy model holds no modes (nat_freq, A): select poles first, by select_closest_poles, then call "
            "get_constants"
        )
    values = np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    missing = np.flatnonzero(~(values > 0))
    if missing.size:
        raise InputError(f"the sdypy model found no pole for mode {missing[0] + 1}: select another frequency for it")
    damping = np.clip(np.atleast_1d(np.asarray(model.nat_xi, dtype=np.float64)), 0.0, None)
    rows = np.atleast_2d(np.asarray(constants).T)
    return from_arrays(values, rows, floors=floors, stories=stories, damping_ratios=damping, name=name)


def _finite(value: ArrayLike, where: str, dimensions: int) -> Complexes:
    if np.ma.is_masked(value):
        raise InputError(f"{where} has masked entries: leave out the floor or the mode, or fill the entries in")
    try:
        array = np.asarray(value, dtype=np.complex128)
    except (TypeError, ValueError):
        raise InputError(f"{where} must hold numbers, not {checks.shown(value)}") from None
    if array.ndim != dimensions or not array.size:
        raise InputError(f"{where} must have {dimensions} dimension(s), not shape {array.shape}")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        raise InputError(f"{where}, entry {tuple(int(i) + 1 for i in bad[0])} is not finite")
    return array


def _given(value: ArrayLike | None, shape: tuple[int, ...], where: str) -> Floats:
    """Return one number, or one for each entry, in full shape; nan if not given."""
    if value is None:
        return np.full(shape, np.nan)
    if np.ma.is_masked(value):
        raise InputError(f"{where} has masked entries; fill them in")
    given = np.asarray(value, dtype=np.float64)
    try:
        array = np.broadcast_to(given, shape).copy()
    except ValueError:
        raise InputError(f"{where} must be one number or of shape {shape}, not {given.shape}") from None
    if not np.all(np.isfinite(array)) or np.any(array < 0):
        raise InputError(f"{where} must be finite and not negative")
    return array


def second_opinion(
    result: ModalResult, other: ModalResult, *, frequency_change: float = 0.05, least_mac: float = 0.9
) -> list[Finding]:
    """Report what another identification of the same test says of each mode.

    Parameters
    ----------
    result : ModalResult
    other : ModalResult
        By another method, or of a peer by `from_pyoma`, `from_sdypy` or `from_arrays`.
    frequency_change, least_mac : float, optional
        Largest relative difference of the frequencies, and least MAC of the shapes, of one mode.

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
        near = np.flatnonzero((np.abs(changes) < frequency_change) & (alike > least_mac))
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
