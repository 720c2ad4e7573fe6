"""Identified modes with their standard deviations, and what the record got wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import nnls

from cvxshear.modal.functions import Functions
from cvxshear.modal.picking import Sweep
from cvxshear.records.record import Finding
from cvxshear.util.results import Shown, ask, data_frame
from cvxshear.util.typing import Complexes, Floats, Ints, Json

if TYPE_CHECKING:
    import pandas as pd

OVERLOOKED_KIND = "overlooked mode"
"""The kind of the findings that put the numbers of modes in doubt."""

SENSOR_STD = 0.005
"""Standard deviation of a shape entry, over the mode's largest, that no scatter shows: a sensor 5 degrees askew loses
0.4 %, one with a transverse sensitivity of 3 % picks up as much of a floor's other motions."""


def frequency_std(scatter: Floats, modes: Ints, findings: Sequence[Finding]) -> Floats:
    """Relative standard deviations of the frequencies, those that depend on amplitude being known no better than that.

    The halves of the record, the stronger and the weaker one, lie a half of the whole range of amplitudes apart. A
    frequency that changes by d between them is spread over 2 d, with a standard deviation of 2 d / sqrt(12). A mode
    for which no change could be told is taken to change by as much as the one that changes least. One that is only
    suspected to change, by its scatter, has that scatter in its deviation already.

    Parameters
    ----------
    scatter : ndarray, shape (m,)
    modes : ndarray of int, shape (m,)
    findings : sequence of Finding
    """
    changes = {
        item.numbers["mode"]: 2.0 * abs(item.numbers["change"]) / np.sqrt(12.0)
        for item in findings
        if item.kind == "amplitude" and "change" in item.numbers
    }
    least = min(changes.values(), default=0.0)
    return np.hypot(scatter, [changes.get(int(mode), least) for mode in modes])


def entry_std(scatter: Floats, shapes: Floats, floors: Ints, findings: Sequence[Finding]) -> Floats:
    """Add what sensors get wrong unseen to the standard deviations of the entries, over each mode's largest.

    Where the response at floor i to a force at j differs from that at j to a force at i by the share d, one of four
    calibrations is off, those of two sensors and of the force at two driving points. With s the standard deviation of
    each, d has that of 2 s; an entry takes half of its sensor's error and half of its driving point's, which is
    s / sqrt(2) = d / (2 sqrt(2)).

    Parameters
    ----------
    scatter : ndarray, shape (m, n)
    shapes : ndarray, shape (m, n)
        In any scaling.
    floors : ndarray of int, shape (n,)
    findings : sequence of Finding
    """
    failures = [item.numbers for item in findings if item.kind == "reciprocity"]
    of_floors = ([each["by_mode"] for each in failures if floor in each["floors"]] for floor in floors.tolist())
    share = np.array([np.sqrt(np.mean(np.square(each or [[0.0]]))) for each in of_floors])
    relative = np.abs(shapes) / np.max(np.abs(shapes), axis=1, keepdims=True)
    result: Floats = np.hypot(np.hypot(scatter, SENSOR_STD), relative * share / (2.0 * np.sqrt(2.0)))
    return result


def other_modes(findings: Sequence[Finding]) -> list[Json]:
    """Which other modes of the frame those of a record may be, as `other_modes` of a measurement file has it."""
    return [
        {"modes": item.numbers["modes"], "probability": item.numbers["probability"]}
        for item in findings
        if item.kind == OVERLOOKED_KIND
    ]


DRAWN = 0.3
"""Weight of equal variances against those that the covariance asks for."""
REPRODUCED_TO = 2e-4
"""Relative standard deviation of a frequency that no scatter within a record goes below: loggers' crystals are 20 to
100 ppm off, and a degree takes 0.02 % from the frequency of a steel frame (Young's modulus falls by 0.04 % a degree).
Without it a day's change of temperature between two tests would be found as a cause."""
DAMPING_REPRODUCED_TO = 0.01
"""Least relative std of a damping ratio: friction in joints and cables changes it by more between two tests."""


@dataclass(frozen=True, eq=False, repr=False)
class ModalResult(Shown):
    """Modes of one record.

    Parameters
    ----------
    name : str
    method : str
        "era", "okid", "subspace", "ssi" or "given".
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
        entry. These go into the measurement file, whose errors are independent.
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
    sweep : Sweep, optional
        For the stabilization diagram.
    functions : Functions, optional
        What the record shows over frequency, for the figures.
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
    sweep: Sweep | None = None
    functions: Functions | None = None

    json_keys = (
        "name method stories floors modes frequencies frequency_std damping_ratios damping_std mode_shapes "
        "mode_shape_std entry_std mass_normalized phase_collinearity lost_phase clock_offsets=named_offsets "
        "uncertainty findings"
    )

    @property
    def named_offsets(self) -> dict[str, dict[str, float]]:
        """The clock offset of each channel with its standard deviation, s, by name."""
        return {name: {"seconds": offset, "std": std} for name, (offset, std) in self.clock_offsets.items()}

    @property
    def written_frequency_std(self) -> Floats:
        """Relative standard deviations of the frequencies, with what no scatter shows, as files have them."""
        return np.maximum(frequency_std(self.frequency_std, self.modes, self.findings), REPRODUCED_TO)

    @property
    def written_damping_std(self) -> Floats:
        """Standard deviations of the damping ratios, with what no scatter shows, as files have them; 0 if not known."""
        least = np.where(self.damping_std > 0, DAMPING_REPRODUCED_TO * self.damping_ratios, 0.0)
        return np.maximum(self.damping_std, least)

    @property
    def written_entry_std(self) -> Floats:
        """Standard deviations of the entries over each mode's largest, as files have them, shape (m, n)."""
        return entry_std(self.entry_std, self.mode_shapes, self.floors, self.findings)

    def to_dataframe(self) -> pd.DataFrame:
        """One row a mode: number, frequency, damping ratio, their standard deviations, one column a floor.

        Returns
        -------
        pandas.DataFrame
            `frequency` in Hz, `frequency_std` relative as measurement files have it, `damping_ratio` and its `std` as
            fractions of critical, `floor_1`, ... in the scale of `mode_shapes`; indexed by `mode`.

        Raises
        ------
        InputError
            Where pandas is not installed.
        """
        columns: dict[str, Sequence[object]] = {
            "mode": self.modes.tolist(),
            "frequency": self.frequencies.tolist(),
            "frequency_std": self.written_frequency_std.tolist(),
            "damping_ratio": self.damping_ratios.tolist(),
            "damping_ratio_std": self.written_damping_std.tolist(),
        }
        columns |= {
            f"floor_{floor}": entries.tolist()
            for floor, entries in zip(self.floors.tolist(), self.mode_shapes.T, strict=True)
        }
        return data_frame(columns).set_index("mode")

    def pick(self, record_file: str | Path | None = None) -> Any:
        """Open the stabilization diagram, where a click on a pole chooses it as a mode and another gives it up.

        Parameters
        ----------
        record_file : str or Path, optional
            The record file (TOML) whose key `pick` is to hold the choice; it is rewritten after each click.

        Returns
        -------
        PolePicker
            Its `frequencies`, Hz, are `pick` for `identify_modes`.

        Raises
        ------
        InputError
            Where matplotlib has no interactive backend, or the result holds no order sweep.
        """
        return ask("show", "picked", self, record_file)

    def configuration(self, *, added_mass: Sequence[float] | None = None, state: str | None = None) -> Json:
        """Write the table `[[configuration]]` of a measurement file that these modes make."""
        result: Json = {"name": self.name}
        if state is not None:
            result["state"] = state
        if added_mass is not None:
            result["added_mass"] = [float(mass) for mass in added_mass]
        result |= {
            "measured_floors": self.floors.tolist(),
            "modes": self.modes.tolist(),
            **({"other_modes": others} if (others := other_modes(self.findings)) else {}),
            "frequencies": self.frequencies.tolist(),
            "mode_shapes": self.mode_shapes.tolist(),
            "mass_normalized": self.mass_normalized,
            "frequency_std": self.written_frequency_std.tolist(),
            "mode_shape_std": self.written_entry_std.tolist(),
            "mode_shape_noise": "additive",
            "damping_ratios": np.clip(self.damping_ratios, 0.0, None).tolist(),
        }
        if np.all(self.damping_ratios > 0) and np.all(self.damping_std > 0):
            result["damping_ratio_std"] = (self.written_damping_std / self.damping_ratios).tolist()
        return result

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
            The table `[frame]`: what is known of the frame itself.
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
        command shows them in kilograms or newtons. A comment at the head of the measurement file says so too.
        """
        table = frame_in({"stories": self.stories, **(frame or {})}, {state or self.name})
        if self.needs_mass(table, priors):
            table |= {"total_mass": 1.0, "total_mass_placeholder": True}
        result: Json = {"frame": table}
        if priors:
            result["prior"] = [dict(prior) for prior in priors]
        result["configuration"] = [self.configuration(added_mass=added_mass, state=state)]
        return result

    def needs_mass(self, frame: Mapping[str, object], priors: Sequence[Mapping[str, object]]) -> bool:
        """Whether nothing tells how heavy the frame is."""
        fixed = any(
            prior.get("kind") == "value" or (prior.get("kind") == "nominal" and not prior.get("free_scale"))
            for prior in priors
        )
        return not (self.mass_normalized or "total_mass" in frame or "floor_masses" in frame or fixed)


def frame_in(frame: Mapping[str, Any], states: Set[str]) -> dict[str, Any]:
    """Return the table `[frame]` for records of these states: no `reference` where all are of one other state.

    Nothing differs from the reference then, and the frame itself is the one that was tested.
    """
    alone = len(states) == 1 and frame.get("reference") not in states
    return {key: value for key, value in frame.items() if not (alone and key == "reference")}


def independent_std(covariance: Floats, shape: Floats) -> Floats:
    """Independent errors on all entries that, the scale free, scatter a shape as a covariance says.

    An error along the shape itself is lost in the scale: with P the projector off the shape, P D P and
    P cov P have the same diagonal for the diagonal matrix D = diag(std^2) sought, a linear system with
    the squared entries of P. Solved for non-negative variances.

    Parameters
    ----------
    covariance : array, shape (n, n)
        In any scaling of the shape to a fixed length or entry.
    shape : array, shape (n,)

    Returns
    -------
    array, shape (n,)
    """
    off = np.eye(len(shape)) - np.outer(shape, shape) / (shape @ shape)
    seen = np.diag(off @ covariance @ off)
    typical = float(seen.sum()) / max(1, len(shape) - 1)
    if typical <= 0:
        return np.zeros(len(shape))
    # Drawn towards equal variances: the system is singular for two floors, and a covariance from a score of
    # pieces is no better known than that.
    rows = np.vstack([off**2, DRAWN * np.eye(len(shape))])
    variances = nnls(rows, np.concatenate([seen / typical, np.full(len(shape), DRAWN)]))[0] * typical
    return np.sqrt(np.maximum(variances, 0.1 * typical))
