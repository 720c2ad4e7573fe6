"""Modes that were identified elsewhere, and the functions that identified modes make."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cvxshear.records import picking
from cvxshear.records.data_frames import matrix_of
from cvxshear.records.prepare import Functions
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
    values = checks.vector(frequencies, "frequencies", above=0.0)
    shapes = matrix_of(mode_shapes, "mode_shapes", np.complex128)
    count, width = shapes.shape
    if len(values) != count:
        raise InputError(f"mode_shapes has {count} rows, frequencies {len(values)} entries; one row a mode")
    if not np.all(np.isfinite(shapes)):
        row, column = np.argwhere(~np.isfinite(shapes))[0] + 1
        raise InputError(
            f"mode_shapes, row {row}, entry {column} is not finite, or masked: leave out its floor or mode"
        )
    places = np.arange(1, width + 1) if floors is None else np.asarray(floors, dtype=np.int64)
    if places.shape != (width,):
        raise InputError(f"floors must have {width} entries, one a column of mode_shapes, not {places.size}")
    by_floor, by_frequency = np.argsort(places), np.argsort(values)
    shapes = shapes[by_frequency][:, by_floor]
    # A real shape stands as it is, sign and all.
    real = np.array([picking.real_shape(shape) if np.any(shape.imag) else shape.real for shape in shapes])
    frequency = _deviations(frequency_std, (count,), "frequency_std")[by_frequency]
    entries = _deviations(mode_shape_std, (count, width), "mode_shape_std")[by_frequency][:, by_floor]
    damping = _deviations(damping_ratios, (count,), "damping_ratios")[by_frequency]
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
        complex_shapes=np.array([picking.main_axis(shape) for shape in shapes]),
        phase_collinearity=np.array([picking.collinearity(shape) for shape in shapes]),
        lost_phase=np.array([picking.lost_phase(shape) for shape in shapes]),
        clock_offsets={},
        covariance=np.diag(np.concatenate([frequency, entries.ravel()]) ** 2),
        uncertainty="as given" if not missing else f"not given for {' and '.join(missing)}",
    )


def from_library(
    found: Any, *, floors: ArrayLike | None = None, stories: int | None = None, name: str = "library"
) -> ModalResult:
    """Modes that pyOMA2 or sdypy-EMA identified.

    Parameters
    ----------
    found : pyOMA2 algorithm or result, or sdypy.EMA.Model
        Its modes have been chosen. Anything with frequencies `Fn` or `nat_freq`, shape (m,), and shapes `Phi` or
        modal constants `A` of one driving point, shape (channels, m), or with such a `result`. Damping ratios `Xi` or
        `nat_xi` and the standard deviations `Fn_std` are used where they are there. `Phi_std` is not: it is of another
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
        Where no modes have been chosen, one of them was not found, or there are no shapes.
    """
    result = getattr(found, "result", found)
    frequencies, shapes, damping, std = (
        next((getattr(result, key) for key in keys if getattr(result, key, None) is not None), None)
        for keys in (("Fn", "nat_freq"), ("Phi", "A"), ("Xi", "nat_xi"), ("Fn_std",))
    )
    if frequencies is None or shapes is None:
        raise InputError(
            "the object holds no modes (Fn and Phi, or nat_freq and A): choose modes first, by mpe or a cluster in "
            "pyOMA2, by select_closest_poles and then get_constants in sdypy"
        )
    values = np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    missing = np.flatnonzero(~(values > 0))
    if missing.size:
        raise InputError(f"the library found no pole for mode {missing[0] + 1}: select another frequency for it")
    return from_arrays(
        values,
        np.atleast_2d(np.asarray(shapes).T),
        floors=floors,
        stories=stories,
        name=name,
        damping_ratios=None if damping is None else np.clip(np.atleast_1d(damping), 0.0, None),
        frequency_std=None if std is None else np.atleast_1d(std) / values,
    )


def _deviations(value: ArrayLike | None, shape: tuple[int, ...], where: str) -> Floats:
    """Return one number, or one for each entry, in full shape; nan if not given."""
    if value is None:
        return np.full(shape, np.nan)
    given = checks.real(value, where)
    try:
        array = np.broadcast_to(given, shape).copy()
    except ValueError:
        raise InputError(f"{where} must be one number or of shape {shape}, not {given.shape}") from None
    if not np.all(np.isfinite(array) & (array >= 0)):
        raise InputError(f"{where} must be finite and not negative")
    return array


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
