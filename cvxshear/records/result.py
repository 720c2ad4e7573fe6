"""Modes with their standard deviations, identified here or elsewhere, and the measurement from several records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from cvxshear.measurement.configuration import Sensor, motion_shares
from cvxshear.measurement.declaration import MOTIONS
from cvxshear.records import picking
from cvxshear.records.data_frames import matrix_of
from cvxshear.records.prepare import Functions
from cvxshear.records.record import Finding
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.results import Shown, data_frame
from cvxshear.util.typing import Bools, Complexes, Floats, Ints, Json

if TYPE_CHECKING:
    import pandas as pd

#: Systematic standard deviation of a shape entry, relative to the mode's largest: a sensor that is 5 degrees askew
#: loses 0.4 %, and a transverse sensitivity of 3 % adds 3 % of the floor's other motions.
SENSOR_STD = 0.005

#: Relative standard deviation of a frequency that no scatter within a record goes below: loggers' crystals are 20 to
#: 100 ppm off, and a degree takes 0.02 % from the frequency of a steel frame (Young's modulus falls by 0.04 % a
#: degree). Without it a day's change of temperature between two tests would be found as a cause.
REPRODUCED_TO = 2e-4
#: Least relative std of a damping ratio: friction in joints and cables changes it by more between two tests.
DAMPING_REPRODUCED_TO = 0.01

#: The kind of the findings that put the numbers of modes in doubt.
OVERLOOKED_KIND = "overlooked mode"


@dataclass(frozen=True, eq=False, repr=False)
class ModalResult(Shown):
    """Modes of one record.

    Parameters
    ----------
    name : str
    method : str
        "era", "subspace", "ssi" or "given".
    stories : int
    floors : array of int, shape (n,)
        Measured floors, ascending.
    frequencies : array, shape (m,)
        Natural frequencies, Hz, ascending.
    frequency_std : array, shape (m,)
        Relative.
    damping_ratios, damping_std : array, shape (m,)
        Fraction of critical.
    mode_shapes : array, shape (m, n)
        Real normal modes; 1/sqrt(kg) where `mass_normalized`, a largest entry of 1 otherwise.
    mode_shape_std : array, shape (m, n)
        Of the entries as they stand, relative to the mode's largest. Zero at the largest entry of a mode
        that is not mass-normalized: it is 1 by definition.
    entry_std : array, shape (m, n)
        Standard deviations of independent errors on all entries, the mode's scale free, that scatter the
        shape as `mode_shape_std` says, and where `mass_normalized` its scale; relative to the mode's largest
        entry. The measurement file contains these, since its errors are independent.
    mass_normalized : bool
    modes : array of int, shape (m,)
        Which modes of the frame these are, 1 the lowest.
    complex_shapes : array of complex, shape (m, n)
        Before the real normal mode was taken, turned to their main axis.
    phase_collinearity : array, shape (m,)
        MPC of the complex shapes, clock offsets removed.
    lost_phase : array, shape (m,)
        Degrees, root mean square, which the real normal mode leaves out; clock offsets removed.
    clock_offsets : dict
        Channel name to seconds, positive where the channel is late against the median of all; each with its
        standard deviation: {name: (seconds, std)}.
    covariance : array, shape (m + m n, m + m n)
        Of the relative frequencies and the entries of `mode_shapes` over each mode's largest, mode by mode.
    uncertainty : str
        How the standard deviations were got.
    findings : tuple of Finding
    sensors : tuple of Sensor, optional
        Place and direction of the sensor of each entry, where the floors turn.
    sweep : Sweep, optional
        For the stabilization diagram.
    functions : Functions, optional
        What the record shows over frequency, for the figures.
    amplitude : float, optional
        Largest motion of a floor in a continuous record, in the unit of its responses (m/s2, m/s or m).
    """

    name: str
    method: str
    stories: int
    floors: Ints
    frequencies: Floats
    frequency_std: Floats
    damping_ratios: Floats
    damping_std: Floats
    mode_shapes: Floats
    mode_shape_std: Floats
    entry_std: Floats
    mass_normalized: bool
    modes: Ints
    complex_shapes: Complexes
    phase_collinearity: Floats
    lost_phase: Floats
    clock_offsets: Mapping[str, tuple[float, float]]
    covariance: Floats
    uncertainty: str
    findings: tuple[Finding, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    sweep: picking.Sweep | None = None
    functions: Functions | None = None
    amplitude: float | None = None

    json_keys = (
        "name method stories floors modes frequencies frequency_std=written_frequency_std damping_ratios "
        "damping_std=written_damping_std mode_shapes mode_shape_std entry_std=written_entry_std mass_normalized "
        "phase_collinearity lost_phase clock_offsets=named_offsets amplitude uncertainty findings sensors "
        "motion_shares"
    )

    @property
    def motion_shares(self) -> Floats | None:
        """Shares of x, y and rotation in each mode, shape (m, 3), see `motion_shares`; None without `sensors`."""
        return motion_shares(self.sensors, self.mode_shapes) if self.sensors else None

    @property
    def entries(self) -> list[str]:
        """Name of each entry of a shape: its floor, or of floors that turn its sensor."""
        if self.sensors:
            return [f"sensor {place}" for place in range(1, len(self.sensors) + 1)]
        return [f"floor {floor}" for floor in self.floors.tolist()]

    @property
    def named_offsets(self) -> dict[str, dict[str, float]]:
        """The clock offset of each channel with its standard deviation, s, by name."""
        return {name: {"seconds": offset, "std": std} for name, (offset, std) in self.clock_offsets.items()}

    @property
    def uncertainty_in_words(self) -> str:
        """How the standard deviations were got, and how many of those written are least values instead."""
        found = [self.frequency_std, self.damping_std]
        written = [self.written_frequency_std, self.written_damping_std]
        least = [REPRODUCED_TO * np.ones(len(self.modes)), DAMPING_REPRODUCED_TO * self.damping_ratios]
        counts = [int(np.sum((std > own) & (std <= low))) for own, std, low in zip(found, written, least, strict=True)]
        if not any(counts):
            return self.uncertainty
        shares = [f"{100 * share:g} %" for share in (REPRODUCED_TO, DAMPING_REPRODUCED_TO, SENSOR_STD)]
        return (
            f"{self.uncertainty}; least values are those of {counts[0]} frequencies ({shares[0]}) and {counts[1]} "
            f"damping ratios ({shares[1]}) of {len(self.modes)}; every entry contains {shares[2]} of the mode's "
            "largest for its sensor"
        )

    @property
    def written_frequency_std(self) -> Floats:
        """Relative standard deviations of the frequencies, with what no scatter shows, as files have them.

        The halves of the record, the stronger and the weaker one, lie a half of the whole range of amplitudes apart. A
        frequency that changes by d between them is spread over 2 d, with a standard deviation of 2 d / sqrt(12). A mode
        without a known change is given the smallest known change.
        """
        changes = {
            item.numbers["mode"]: 2.0 * abs(item.numbers["change"]) / np.sqrt(12.0)
            for item in self.findings
            if item.kind == "amplitude"
        }
        least = min(changes.values(), default=0.0)
        spread = [changes.get(mode, least) for mode in self.modes.tolist()]
        return np.maximum(np.hypot(self.frequency_std, spread), REPRODUCED_TO)

    @property
    def written_damping_std(self) -> Floats:
        """Standard deviations of the damping ratios, with what no scatter shows, as files have them; 0 if not known."""
        least = np.where(self.damping_std > 0, DAMPING_REPRODUCED_TO * self.damping_ratios, 0.0)
        return np.maximum(self.damping_std, least)

    @property
    def written_entry_std(self) -> Floats:
        """Standard deviations of the entries over each mode's largest, as files have them, shape (m, n).

        They contain what sensors get wrong unseen. Where the response at floor i to a force at j differs from that at j
        to a force at i by the share d, one of four calibrations is off: two sensors, and the force at two driving
        points. If each has the standard deviation s, d has 2 s. An entry takes half of its sensor's error and half of
        its driving point's, which is s / sqrt(2) = d / (2 sqrt(2)).
        """
        failures = [item.numbers for item in self.findings if item.kind == "reciprocity"]
        of_floors = [[each["by_mode"] for each in failures if floor in each["floors"]] for floor in self.floors]
        share = np.array([np.sqrt(np.mean(np.square(each or [[0.0]]))) for each in of_floors])
        relative = np.abs(self.mode_shapes) / np.max(np.abs(self.mode_shapes), axis=1, keepdims=True)
        return np.asarray(np.hypot(np.hypot(self.entry_std, SENSOR_STD), relative * share / (2.0 * np.sqrt(2.0))))

    def to_dataframe(self) -> pd.DataFrame:
        """One row a mode: number, frequency, damping ratio, their standard deviations, one column a floor.

        Returns
        -------
        pandas.DataFrame
            `frequency_Hz` and its standard deviation `frequency_std_Hz`, `damping_ratio` and `damping_ratio_std` as
            fractions of critical, `floor_1`, ... in the scale of `mode_shapes`; of floors that turn `sensor_1`, ...,
            after `share_x`, `share_y` and `share_rotation`. Indexed by `mode`.

        Raises
        ------
        InputError
            Where pandas is not installed.
        """
        columns: dict[str, Sequence[object]] = {
            "mode": self.modes.tolist(),
            "frequency_Hz": self.frequencies.tolist(),
            "frequency_std_Hz": (self.frequencies * self.written_frequency_std).tolist(),
            "damping_ratio": self.damping_ratios.tolist(),
            "damping_ratio_std": self.written_damping_std.tolist(),
        }
        if self.motion_shares is not None:
            columns |= {
                f"share_{name}": each for name, each in zip(MOTIONS, self.motion_shares.T.tolist(), strict=True)
            }
        columns |= {
            name.replace(" ", "_"): entries.tolist()
            for name, entries in zip(self.entries, self.mode_shapes.T, strict=True)
        }
        return data_frame(columns).set_index("mode")

    def configuration(self, *, added_mass: Sequence[float] | None = None, state: str | None = None) -> Json:
        """Write the table `[[configuration]]` of a measurement file that these modes make."""
        std, entry_std, damping = self.written_frequency_std, self.written_entry_std, self.damping_ratios
        damped = np.all(damping > 0) and np.all(self.damping_std > 0)
        others = [
            {"modes": item.numbers["modes"], "probability": item.numbers["probability"]}
            for item in self.findings
            if item.kind == OVERLOOKED_KIND
        ]
        result = {
            "name": self.name,
            "state": state,
            "added_mass": None if added_mass is None else [float(mass) for mass in added_mass],
            "amplitude": self.amplitude,
            "sensors": [sensor.to_dict() for sensor in self.sensors] or None,
            "measured_floors": None if self.sensors else self.floors.tolist(),
            "modes": self.modes.tolist(),
            "other_modes": others or None,
            "frequencies": self.frequencies.tolist(),
            "mode_shapes": self.mode_shapes.tolist(),
            "mass_normalized": self.mass_normalized,
            "frequency_std": std.tolist() if np.all(np.isfinite(std)) else None,
            "mode_shape_std": entry_std.tolist() if np.all(np.isfinite(entry_std)) else None,
            "mode_shape_noise": "additive" if np.all(np.isfinite(entry_std)) else None,
            "damping_ratios": np.clip(damping, 0.0, None).tolist() if np.all(np.isfinite(damping)) else None,
            "damping_ratio_std": (self.written_damping_std / damping).tolist() if damped else None,
        }
        return {key: value for key, value in result.items() if value is not None}

    def to_experiment(
        self,
        frame: Mapping[str, object] | None = None,
        *,
        priors: Sequence[Mapping[str, object]] = (),
        added_mass: Sequence[float] | None = None,
        state: str | None = None,
    ) -> Json:
        """Return a dict of the measurement file's shape, for `Experiment.from_dict`.

        Parameters
        ----------
        frame : dict, optional
            The table `[frame]`: declared properties of the frame.
        priors : sequence of dict, optional
            The tables `[[prior]]`.
        added_mass : sequence of float, shape (N,), optional
            kg on each floor during the record.
        state : str, optional
            The state of the frame that was tested.

        Returns
        -------
        dict

        Notes
        -----
        Where neither the shapes nor the frame nor a prior say how heavy the frame is, the total mass is set
        to 1, with `total_mass_placeholder = true`: masses and stiffnesses then come out relative to it, and no
        command shows them in kilograms or newtons. A comment at the head of the measurement file repeats this.
        """
        test = IdentifiedRecord(self.name, self, frame or {}, priors, added_mass, state)
        return merged([test])


@dataclass(frozen=True, eq=False)
class IdentifiedRecord:
    """One record with the modes found in it, and what its file says of the frame besides.

    Parameters
    ----------
    file : str
        The record file, for messages.
    modes : ModalResult
    frame : dict
        The table `[frame]`.
    priors : sequence of dict
        The tables `[[prior]]`.
    added_mass : sequence of float, optional
        kg on each floor during the record.
    state : str, optional
        The state of the frame that was tested.
    """

    file: str
    modes: ModalResult
    frame: Mapping[str, object]
    priors: Sequence[Mapping[str, object]] = ()
    added_mass: Sequence[float] | None = None
    state: str | None = None


def merged(tests: Sequence[IdentifiedRecord]) -> Json:
    """Make a dict of the measurement file's shape, for `Experiment.from_dict`.

    Parameters
    ----------
    tests : sequence of IdentifiedRecord
        Of one frame; at least one.

    Returns
    -------
    dict
        One configuration a record, in their order. `total_mass` is 1 kg if the mass scale is unknown.

    Raises
    ------
    InputError
        Where two records contradict each other, naming both files, the key and the values.
    """
    if not tests:
        raise InputError("there is no record whose modes were found; a measurement needs one at least")
    _refuse_shared_names(tests)
    frame, priors = _frame(tests), _priors(tests)
    states = {test.state or test.modes.name for test in tests}
    if len(states) == 1 and frame.get("reference") not in states:
        # Nothing differs from the reference then, and the frame itself is the one that was tested.
        frame.pop("reference", None)
    if scale_unknown(tests):
        frame |= {"total_mass": 1.0, "total_mass_placeholder": True}
    result: Json = {"frame": frame}
    if priors:
        result["prior"] = priors
    result["configuration"] = [test.modes.configuration(added_mass=test.added_mass, state=test.state) for test in tests]
    return result


def scale_unknown(tests: Sequence[IdentifiedRecord]) -> bool:
    """Whether nothing in any record file, nor a change of added mass between them, tells how heavy the frame is."""
    for test in tests:
        if test.modes.mass_normalized or {"total_mass", "floor_masses"} & set(test.frame):
            return False
        kinds = {prior.get("kind") for prior in test.priors if not prior.get("free_scale")}
        if {"value", "nominal"} & kinds:
            return False
    stories = max(test.modes.stories for test in tests)
    added = [np.zeros(stories) if test.added_mass is None else np.asarray(test.added_mass) for test in tests]
    return all(np.array_equal(mass, added[0]) for mass in added)


def over_amplitude(results: Sequence[ModalResult]) -> dict[int, tuple[Floats, Floats, Floats]]:
    """Frequencies and damping of each mode at the amplitudes of several records, and how the frequencies follow them.

    Parameters
    ----------
    results : sequence of ModalResult

    Returns
    -------
    dict
        Mode number to frequencies, Hz, and damping ratios, shape (records,), nan where a record lacks the mode; and to
        the relative change of frequency for a tenfold amplitude with its standard deviation, by a straight line
        through the logarithms, nan for fewer than three records. There are as many modes as floors with sensors, whose
        numbers are sure.
    """
    amplitudes = np.log10([np.nan if each.amplitude is None else each.amplitude for each in results])
    found = {}
    for mode in range(1, 1 + min(len(each.floors) for each in results)):
        values = np.full((2, len(results)), np.nan)
        for place, each in enumerate(results):
            here = each.modes == mode
            if here.any():
                values[:, place] = each.frequencies[here][0], each.damping_ratios[here][0]
        slope = np.full(2, np.nan)
        told = np.isfinite(values[0] + amplitudes)
        if np.count_nonzero(told) > 2 and np.ptp(amplitudes[told]) > 0:
            line = scipy.stats.linregress(amplitudes[told], np.log(values[0, told]))
            slope = np.array([np.expm1(line.slope), line.stderr])
        found[mode] = values[0], values[1], slope
    return found


#: Keys of a prior that say what it speaks of; the others are what it says.
PLACES = ("kind", "quantity", "at", "of", "to")


def _refuse_shared_names(tests: Sequence[IdentifiedRecord]) -> None:
    seen: dict[str, str] = {}
    for test in tests:
        name = test.modes.name
        if name in seen:
            raise InputError(f'{seen[name]} and {test.file} are both named "{name}"; give each its own record: name')
        seen[name] = test.file


def _frame(tests: Sequence[IdentifiedRecord]) -> dict[str, Any]:
    """Merge the tables [frame]: every key that any file gives."""
    frame: dict[str, Any] = {}
    said: dict[str, str] = {}
    for test in tests:
        for key, value in {"stories": test.modes.stories, **test.frame}.items():
            if key in frame and not _same(frame[key], value):
                remedy = "records of one frame must agree, and one of them is enough to say it"
                if key == "stories":
                    remedy = "say record: stories in each file whose top floor has no sensor"
                raise InputError(
                    f"frame: {key} is {checks.shown(frame[key])} by {said[key]}, {checks.shown(value)} by "
                    f"{test.file}; {remedy}"
                )
            frame.setdefault(key, value)
            said.setdefault(key, test.file)
    return frame


def _same(one: Any, other: Any) -> bool:
    """Whether two values say the same; one number for all stories equals a list of it."""
    try:
        return bool(np.all(np.isclose(one, other, rtol=1e-9, atol=0.0)))
    except (TypeError, ValueError):
        return bool(one == other)


def _priors(tests: Sequence[IdentifiedRecord]) -> list[dict[str, object]]:
    """Collect the tables [[prior]], each once."""
    kept: list[tuple[dict[str, object], str]] = []
    for test in tests:
        for prior in test.priors:
            if any(_same(other, prior) for other, _ in kept):
                continue
            for other, file in kept:
                if file != test.file and all(_same(other.get(key), prior.get(key)) for key in PLACES):
                    raise InputError(
                        f"prior: {checks.shown(other)} by {file} and {checks.shown(dict(prior))} by {test.file} speak "
                        "of the same thing and differ; leave one out"
                    )
            kept.append((dict(prior), test.file))
    return [prior for prior, _ in kept]


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
