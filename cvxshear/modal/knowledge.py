"""What a record tells of its own accuracy beyond the scatter of its modes: standard deviations for those who fit them.

The jackknife sees what differs from one part of a record to the next. It does not see a sensor that stands askew, nor
that a frequency found at one amplitude is not that of another; a fit that took the scatter for the whole error would
explain both by effects of the frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.modal.findings import Finding
from cvxshear.modal.overlooked import OVERLOOKED
from cvxshear.util.typing import Floats, Ints, Json

SENSOR_STD = 0.005
"""Standard deviation of a shape entry, over the mode's largest, that no scatter shows: a sensor 5 degrees askew loses
0.4 %, one with a transverse sensitivity of 3 % picks up as much of a floor's other motions."""


def frequency_std(scatter: Floats, modes: Ints, findings: Sequence[Finding]) -> Floats:
    """Relative standard deviations of the frequencies, those that depend on amplitude being known no better than that.

    The halves of the record, the stronger and the weaker one, lie a half of the whole range of amplitudes apart. A
    frequency that changes by d between them is spread over 2 d, with a standard deviation of 2 d / sqrt(12). A mode
    for which no change could be told is taken to change by as much as the one that changes least.

    Parameters
    ----------
    scatter : ndarray, shape (m,)
    modes : ndarray of int, shape (m,)
    findings : sequence of Finding
    """
    changes = {
        item.numbers["mode"]: 2.0 * abs(item.numbers["change"]) / np.sqrt(12.0)
        for item in findings
        if item.kind == "amplitude"
    }
    least = min(changes.values(), default=0.0)
    return np.hypot(scatter, [changes.get(int(mode), least) for mode in modes])


def entry_std(scatter: Floats, shapes: Floats, floors: Ints, findings: Sequence[Finding]) -> Floats:
    """Standard deviations of the shape entries, over each mode's largest, with what sensors get wrong unseen.

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
    share = np.array(
        [
            np.sqrt(np.mean(np.square([each["by_mode"] for each in failures if floor in each["floors"]] or [[0.0]])))
            for floor in floors.tolist()
        ]
    )
    relative = np.abs(shapes) / np.max(np.abs(shapes), axis=1, keepdims=True)
    result: Floats = np.hypot(np.hypot(scatter, SENSOR_STD), relative * share / (2.0 * np.sqrt(2.0)))
    return result


def other_modes(findings: Sequence[Finding]) -> list[Json]:
    """Which other modes of the frame those of a record may be, as `other_modes` of a measurement file has it."""
    return [
        {"modes": item.numbers["modes"], "probability": item.numbers["probability"]}
        for item in findings
        if item.kind == OVERLOOKED
    ]
