"""Correction of sensor faults that the record itself shows, before the frame is fitted.

The checks are the same as in `cvxshear modes`. They use the segments that every sensor recorded. Corrections of certain
faults apply to the whole record, including the parts with gaps.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from cvxshear.records.data_frames import FEWEST_SAMPLES, sound_pieces
from cvxshear.records.examination import ACROSS, center_weights, examined
from cvxshear.records.identify import identify_modes
from cvxshear.records.motion import DRIVEN
from cvxshear.records.prepare import SINC_TERMS, between
from cvxshear.records.record import Channel, Finding, Run, TimeRecord
from cvxshear.records.sick_channels import spikes_in, stuck_in
from cvxshear.util.errors import InputError, NoSolutionError
from cvxshear.util.typing import Floats, Ints

SAID = (
    "dead channel", "stuck channel", "clipped channel", "held samples", "mains hum", "direction", "sign",
    "unit", "swapped channels", "clock offset", "clock drift", "lost samples",
)  # fmt: skip
"""Kinds of findings that concern the sensors. The smoother handles spikes and straight lines by its weights."""

LEAST_DELAY = 0.25
"""Least delay that is removed, in samples; a shorter delay is only reported. The delay is estimated from the phases of
the modes, and there may be only three. With 10 % noise on the base motion, a sound record may show a delay of 0.08
samples."""


@dataclass(frozen=True, eq=False)
class SensorRecord:
    """Samples of every sensor, with gaps.

    Parameters
    ----------
    channels : tuple of Channel
        Ascending by floor.
    measured : tuple of ndarray, shape (samples, channels)
        Accelerations of each run, m/s2; nan in gaps.
    excitations : tuple of ndarray, shape (samples,)
        Excitation of each run, m/s2 or N; zeros if it was not measured.
    sampling_rate : float
        Hz.
    input : str
        "base", "force" or "none".
    force_floor : int, optional
        Floor on which a measured force acts.
    remarks : tuple of str, optional
        Sensor faults that were found.
    late : ndarray, shape (channels, 2), optional
        Delay (s) and its growth (s/s) that were removed from each channel.
    late_remarks : tuple of str, optional
        Remark on this delay, for each channel.
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
        """Return the record without its certain faults; a remark reports each.

        Reversed channels are inverted, units converted and delays removed. Dead channels and the samples of stuck
        channels are left out. Uncertain faults are only reported.

        Raises
        ------
        InputError
            If every channel is dead, or two channels on one floor contradict each other.
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
        """List the segments that every sensor recorded, each with the index of its run."""
        found = []
        for place, (values, excitation) in enumerate(zip(self.measured, self.excitations, strict=True)):
            there = np.isfinite(values).all(axis=1) & np.isfinite(excitation)
            for piece in sound_pieces(there):
                long = piece.stop - piece.start >= FEWEST_SAMPLES
                if long and there[piece].all() and (self.input not in DRIVEN or np.any(excitation[piece])):
                    found.append((place, piece))
        return found

    def _findings(self, pieces: Sequence[tuple[int, slice]], stories: int) -> list[Finding]:
        """Check the sensors with the methods of `cvxshear modes`."""
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
            # A motion without identifiable modes, such as a short one, is checked without modes.
            findings = examined(record).findings
        return [each for each in findings if each.kind in (*SAID, "spikes")]

    def _less(self, findings: Sequence[Finding], pieces: Sequence[tuple[int, slice]]) -> SensorRecord:
        """Correct the certain faults."""
        factors, late, out = np.ones(len(self.channels) + 1), np.zeros((len(self.channels) + 1, 2)), set()
        measured, said = [values.copy() for values in self.measured], list(self.remarks)
        of_clocks: dict[int, str] = {}
        spikes = [np.zeros(values.shape, dtype=bool) for values in measured]
        for finding in findings:
            numbers, message = finding.numbers, finding.message
            columns = self._columns(numbers.get("channels", [numbers.get("channel")]))
            if finding.kind in ("dead channel", "lost samples"):
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
        # A delayed input is equivalent to sensors that are all early.
        late = late[:-1] - late[-1]
        started = 0
        for values, spiked in zip(measured, spikes, strict=True):
            for column in np.flatnonzero(late.any(axis=1)):
                # Interpolation over the neighboring samples would spread a spike to all of them.
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
        """List the columns of the named channels; "a + b" names several sensors of a floor, and -1 is the input."""
        single = {part for name in names if name is not None for part in (name, *name.split(" + "))}
        found = [column for column, channel in enumerate(self.channels) if channel.name in single]
        return [*found, -1] if "input" in single and not found else found

    def by_floor(self) -> tuple[Ints, list[Floats], Floats, tuple[str, ...]]:
        """Return the floors (ascending), their motions in each run, the removed delays, and the remarks on them.

        A motion is nan if a sample of one of its sensors is missing. Sensors across the direction of the test are left
        out. Several sensors on a floor give the motion of the floor's center.
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
    """Remove the delay of a channel; the run begins `started` samples after the first run's beginning."""
    time = (started + np.arange(len(values))) / rate
    return _moved(values, rate * (late[0] + late[1] * time))


def _moved(values: Floats, samples: Floats) -> Floats:
    """Interpolate a channel at times `samples` later; nan if a required sample is missing."""
    index, there = np.arange(len(values)), np.isfinite(values)
    if not there.any():
        return values
    places = index + samples
    unknown = ndimage.maximum_filter1d((~there).astype(np.uint8), SINC_TERMS + 1, mode="constant", cval=1)
    near = np.clip(np.round(places).astype(np.int64), 0, len(values) - 1)
    result = between(np.interp(index, index[there], values[there]), places)
    return np.where(unknown[near].astype(bool), np.nan, result)
