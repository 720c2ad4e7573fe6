"""Faults of sensors that the record itself shows: set right, or left out, before the frame is fitted to it.

The checks are those of `cvxshear modes`. They look at the stretches in which every sensor recorded; what they are sure
of is done to the whole record, gaps and all.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from cvxshear.records.data_frames import FEWEST_SAMPLES, sound_pieces
from cvxshear.records.examination import examined
from cvxshear.records.floors import ACROSS, center_weights
from cvxshear.records.identify import identify_modes
from cvxshear.records.motion import DRIVEN
from cvxshear.records.record import Channel, Finding, Run, TimeRecord
from cvxshear.records.sick_channels import spikes_in, stuck_in
from cvxshear.records.signals import SINC_TERMS, between
from cvxshear.util.errors import InputError, NoSolutionError
from cvxshear.util.typing import Floats, Ints

SAID = (
    "dead channel", "stuck channel", "clipped channel", "held samples", "aliasing", "mains hum", "direction", "sign",
    "unit", "swapped channels", "clock offset", "clock drift",
)  # fmt: skip
"""Kinds of findings that concern the sensors. Spikes and straight lines are left to the smoother, which weighs them."""

LEAST_DELAY = 0.25
"""Samples; a delay of less is said and left in. The phases of the modes tell it, of which there may be three: with
noise of 10 % on the ground they say 0.08 samples of one sound record in eight."""


@dataclass(frozen=True, eq=False)
class SensorRecord:
    """What every sensor recorded, with gaps.

    Parameters
    ----------
    channels : tuple of Channel
        Ascending by floor.
    measured : tuple of ndarray, shape (samples, channels)
        Accelerations of each run, m/s2; nan where a piece is missing.
    excitations : tuple of ndarray, shape (samples,)
        Of each run, m/s2 or N; zeros where nobody measured it.
    sampling_rate : float
        Hz.
    input : str
        "base", "force" or "none".
    force_floor : int, optional
        Where a measured force acts.
    remarks : tuple of str, optional
        What was found wrong with the sensors.
    late : ndarray, shape (channels, 2), optional
        Delay (s) and its growth (s/s) that were taken out of each channel.
    late_remarks : tuple of str, optional
        What was said of it, for each channel.
    """

    channels: tuple[Channel, ...]
    measured: tuple[Floats, ...]
    excitations: tuple[Floats, ...]
    sampling_rate: float
    input: str
    force_floor: int = 0
    remarks: tuple[str, ...] = ()
    late: Floats | None = None
    late_remarks: tuple[str, ...] = ()

    def set_right(self, stories: int) -> SensorRecord:
        """Return the record without the faults that are sure, each said in a remark.

        Reversed channels are turned round, units converted, delays taken out, dead channels and the pieces in which a
        channel sticks left out. What is less sure is said.

        Raises
        ------
        InputError
            Where every channel is dead, or two on one floor contradict each other.
        """
        order = np.argsort([each.floor for each in self.channels], kind="stable")
        whole = dataclasses.replace(
            self,
            channels=tuple(self.channels[column] for column in order),
            measured=tuple(values[:, order] for values in self.measured),
        )
        pieces = whole._pieces()
        if not any(np.any(np.ptp(np.nan_to_num(values), axis=0) > 0) for values in whole.measured):
            return whole
        if not pieces:
            said = "signs and clocks of the sensors were not checked: no stretch in which all recorded is long enough"
            return dataclasses.replace(whole, remarks=(*self.remarks, said))
        return whole._less(whole._findings(pieces, stories), pieces)

    def _pieces(self) -> list[tuple[int, slice]]:
        """List the stretches in which every sensor recorded, each with the place of its run."""
        found = []
        for place, (values, excitation) in enumerate(zip(self.measured, self.excitations, strict=True)):
            there = np.isfinite(values).all(axis=1) & np.isfinite(excitation)
            for piece in sound_pieces(there):
                long = piece.stop - piece.start >= FEWEST_SAMPLES
                if long and there[piece].all() and (self.input not in DRIVEN or np.any(excitation[piece])):
                    found.append((place, piece))
        return found

    def _findings(self, pieces: Sequence[tuple[int, slice]], stories: int) -> list[Finding]:
        """Look at the sensors as `cvxshear modes` does."""
        runs = tuple(
            Run(
                self.measured[place][piece],
                self.excitations[place][piece] if self.input in DRIVEN else None,
                self.force_floor,
                f"run {number}" if len(pieces) > 1 else "the record",
            )
            for number, (place, piece) in enumerate(pieces, 1)
        )
        most = max(stories, *(each.floor for each in self.channels))
        record = TimeRecord(self.channels, stories=most, runs=runs, sampling_rate=self.sampling_rate, input=self.input)
        try:
            findings = identify_modes(record, accept_swapped=True).findings
        except (NoSolutionError, InputError):
            # A motion whose modes cannot be found, a short one say, is judged without them.
            findings = examined(record).findings
        return [each for each in findings if each.kind in (*SAID, "spikes")]

    def _less(self, findings: Sequence[Finding], pieces: Sequence[tuple[int, slice]]) -> SensorRecord:
        """Take out what was found for sure."""
        factors, late, out = np.ones(len(self.channels) + 1), np.zeros((len(self.channels) + 1, 2)), set()
        measured, said = [values.copy() for values in self.measured], list(self.remarks)
        of_clocks: dict[int, str] = {}
        spikes = [np.zeros(values.shape, dtype=bool) for values in measured]
        for finding in findings:
            numbers, message = finding.numbers, finding.message
            columns = self._columns(numbers.get("channels", [numbers.get("channel")]))
            if finding.kind == "dead channel":
                out.update(columns)
            elif finding.kind == "stuck channel":
                for column, (place, piece) in itertools.product(columns, pieces):
                    stuck = stuck_in(self.measured[place][piece], column, self.sampling_rate)
                    measured[place][piece][stuck, column] = np.nan
                message = f"{message.removesuffix('; left out')}; these samples are left out"
            elif finding.kind in ("sign", "unit") and numbers["corrected"]:
                factors[columns] *= -1.0 if finding.kind == "sign" else numbers["factor"]
            elif finding.kind == "clock offset" and abs(numbers["seconds"]) * self.sampling_rate < LEAST_DELAY:
                message = f"{message.removesuffix('; taken out')}; so short a delay may be chance and is left in"
            elif finding.kind in ("clock offset", "clock drift") and numbers.get("corrected", True):
                late[columns] += numbers["seconds"], numbers.get("drift", 0.0)
                message = message if message.endswith("taken out") else f"{message}; taken out"
                of_clocks.update(dict.fromkeys(columns, message))
            if finding.kind == "spikes":
                for column, (place, piece) in itertools.product(columns, pieces):
                    spikes[place][piece][:, column] = spikes_in(self.measured[place][piece])[0][:, column]
            else:
                said.append(message)
        kept = [column for column in range(len(self.channels)) if column not in out]
        # An input that is late is every sensor that is early.
        late = late[:-1] - late[-1]
        started = 0
        for values, spiked in zip(measured, spikes, strict=True):
            for column in np.flatnonzero(late.any(axis=1)):
                # What is made of samples on both sides would carry a spike to all of them.
                values[spiked[:, column], column] = np.nan
                values[:, column] = earlier(values[:, column], late[column], self.sampling_rate, started)
            started += len(values)
        return dataclasses.replace(
            self,
            channels=tuple(self.channels[column] for column in kept),
            measured=tuple((factors[:-1] * values)[:, kept] for values in measured),
            excitations=tuple(factors[-1] * each for each in self.excitations),
            remarks=tuple(said),
            late=late[kept],
            late_remarks=tuple(of_clocks.get(column, of_clocks.get(-1, "")) for column in kept),
        )

    def _columns(self, names: Sequence[str | None]) -> list[int]:
        """List the channels of these names, several sensors of a floor under one name among them; -1 is the input."""
        single = {part for name in names if name is not None for part in (name, *name.split(" + "))}
        found = [column for column, channel in enumerate(self.channels) if channel.name in single]
        return [*found, -1] if "input" in single and not found else found

    def by_floor(self) -> tuple[Ints, list[Floats], Floats, tuple[str, ...]]:
        """Return the floors, ascending, their motions in each run, the delays taken out of them, and what was said.

        A motion is nan where a sample of one sensor is missing.

        Sensors across the direction of test are left out; of several on a floor the motion of its center is taken.
        """
        cosines = np.cos(np.radians([each.direction or 0.0 for each in self.channels]))
        along = np.abs(cosines) >= np.cos(np.radians(ACROSS))
        floors = np.array([each.floor for each in self.channels], dtype=np.int64)
        named = np.unique(floors[along])
        if not named.size:
            raise InputError("no floor's acceleration was recorded; a reconstruction needs one at least")
        weights = np.zeros((len(floors), len(named)))
        for place, floor in enumerate(named):
            group = np.flatnonzero(along & (floors == floor))
            weights[group, place] = center_weights(self.channels, group)[0] / cosines[group]
        groups = [np.flatnonzero(column) for column in weights.T]
        motions = [
            np.column_stack([values[:, group] @ weights[group, place] for place, group in enumerate(groups)])
            for values in self.measured
        ]
        late = np.zeros((len(floors), 2)) if self.late is None else self.late
        firsts = [int(group[0]) for group in groups]
        remarks = self.late_remarks or ("",) * len(floors)
        return named, motions, late[firsts], tuple(remarks[first] for first in firsts)


def earlier(values: Floats, late: Floats, rate: float, started: int) -> Floats:
    """Move a channel of a run that begins so many samples after the first to where it would be without its delay."""
    time = (started + np.arange(len(values))) / rate
    return _moved(values, rate * (late[0] + late[1] * time))


def _moved(values: Floats, samples: Floats) -> Floats:
    """Return a channel at times so many samples later; nan where a sample that this needs is missing."""
    index, there = np.arange(len(values)), np.isfinite(values)
    if not there.any():
        return values
    places = index + samples
    unknown = ndimage.maximum_filter1d((~there).astype(np.uint8), SINC_TERMS + 1, mode="constant", cval=1)
    near = np.clip(np.round(places).astype(np.int64), 0, len(values) - 1)
    result = between(np.interp(index, index[there], values[there]), places)
    return np.where(unknown[near].astype(bool), np.nan, result)
