"""Measure the amplitude dependence of damping and frequency for the frames of the mini shake table.

`python -m tests.studies response_amplitude` prints the tables.

After each record the table stops and the frame vibrates freely. The envelope and phase of the first mode give damping
and frequency at every amplitude without a model. The study also predicts each record with the frequencies and shapes
from one record and the damping from the other. docs/measured/mini-table-response.md has the figures.
"""

from __future__ import annotations

import dataclasses
import functools
import tempfile
from pathlib import Path

import numpy as np
from scipy import signal

from cvxshear.records.motion import trend
from cvxshear.response import predict
from cvxshear.response.recording import recording_of
from tests.records.shared import mini_table
from tests.studies.response_records import FRAMES, RECORDS, models

LEVELS = (4.0, 2.0, 1.0, 0.5, 0.25)
"""Amplitudes of the top floor's acceleration in the first mode, m/s2."""

ENOUGH = 0.4
"""Log amplitude range that a record must cover near a level; the largest (level / root 2 to level root 2) is ln 2."""

STILL = 4.0
"""Initial rest of each record, s."""


@functools.cache
def motion(name):
    with tempfile.TemporaryDirectory() as folder:
        record = recording_of(mini_table(Path(folder), name))
    return record.replaced(
        excitation=(run.excitation - trend(run.excitation) for run in record.runs),
        responses=(run.measured - trend(run.measured) for run in record.runs),
    )


def decay(name):
    """Return damping ratio and frequency (Hz) of the first mode at each level; nan for unreached levels."""
    of = motion(name)
    (drive,), rate = of.runs, of.sampling_rate
    first = models(name).after.experiment.configurations[0].frequencies[0]
    band = signal.butter(3, [0.8 * first, 1.2 * first], "band", fs=rate, output="sos")
    swing = signal.hilbert(signal.sosfiltfilt(band, drive.responses[:, -1]))
    noise = np.std(drive.excitation[: int(STILL * rate)])
    at_rest = int(np.flatnonzero(np.abs(drive.excitation) > 8 * noise)[-1] + rate)
    # The filter distorts the end of the record.
    free = swing[at_rest : -int(2 * rate)]
    size, phase, time = np.abs(free), np.unwrap(np.angle(free)), np.arange(len(free)) / rate
    found = []
    for level in LEVELS:
        here = (size < level * np.sqrt(2)) & (size > level / np.sqrt(2))
        if not here.any() or np.ptp(np.log(size[here])) < ENOUGH:
            found.append((np.nan, np.nan))
            continue
        rate_of_decay = -np.polyfit(time[here], np.log(size[here]), 1)[0]
        omega = np.polyfit(time[here], phase[here], 1)[0]
        found.append((rate_of_decay / omega, omega / (2 * np.pi)))
    return np.array(found)


def largest(name):
    """Return root mean square and peak of the top floor's acceleration in the whole record, m/s2."""
    top = motion(name).runs[0].responses[:, -1]
    return np.std(top), np.max(np.abs(top))


@functools.cache
def crossed(frequencies, damping, record):
    """Predict a record with the model of one record and the damping ratios of another."""
    fitted = models(frequencies).after
    of, other = fitted.experiment, models(damping).after.experiment.configurations[0]
    replaced = dataclasses.replace(
        of.configurations[0], damping_ratios=other.damping_ratios, damping_ratio_std=other.damping_ratio_std
    )
    experiment = dataclasses.replace(of, configurations=(replaced,))
    of_both = dataclasses.replace(models(frequencies), after=dataclasses.replace(fitted, experiment=experiment))
    return predict(of_both, motion(record))


def off(found):
    """Return the mean over floors of the predicted rms over the measured rms, minus 1."""
    return float(np.mean(found.after.comparison.rms_ratio) - 1)


def main():
    print("| frame | after | " + " | ".join(f"{level:g}" for level in LEVELS) + " |")
    print("|---|---|" + "---:|" * len(LEVELS))
    for frame in FRAMES:
        for record in RECORDS:
            cells = [
                "–" if np.isnan(ratio) else f"{100 * ratio:.2f} %, {frequency:.3f} Hz"
                for ratio, frequency in decay(f"{frame}-{record}")
            ]
            print(f"| {frame} | {record} | " + " | ".join(cells) + " |")
    print()
    for frame in FRAMES:
        for record in RECORDS:
            rms, peak = largest(f"{frame}-{record}")
            print(f"{frame} {record}: top floor {rms:.1f} m/s2 rms, {peak:.0f} m/s2 peak")
    print("\n| frame | record | frequencies of | damping of | rms | in time |")
    print("|---|---|---|---|---:|---:|")
    for frame in FRAMES:
        for record in RECORDS:
            for frequencies in RECORDS:
                for damping in RECORDS:
                    found = crossed(f"{frame}-{frequencies}", f"{frame}-{damping}", f"{frame}-{record}")
                    in_time = 100 * np.mean(found.after.comparison.nrmse)
                    errors = f"{100 * off(found):+.0f} % | {in_time:.0f} %"
                    print(f"| {frame} | {record} | {frequencies} | {damping} | {errors} |", flush=True)


if __name__ == "__main__":
    main()
