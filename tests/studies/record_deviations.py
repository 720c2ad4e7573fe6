"""Check the deviations stated by `identify_modes`: share of errors within 1.96 of them, by method and mode.

Random frames have 3 to 8 stories; a third of the floors have no sensor; the noise is 3 %.
`python -m tests.studies record_deviations --seeds 20` prints a row per method and quantity; 95 % is right.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np

from cvxshear.records import identify_modes
from cvxshear.records.prepare import only
from cvxshear.records.record import TimeRecord
from cvxshear.records.simulate import KnownFrame, ambient_record, base_record, hammer_record
from cvxshear.util.errors import CvxshearError

METHODS = {"subspace": "base", "ssi": "none", "era": "force"}
WITHIN = 1.96
RATE = {"none": 4.0}
"""Sampling rate over the highest frequency; the default is 2.6.

The load of `ambient_record` ends at 0.4 of the rate. A load that falls within a mode's band is not white and biases the
damping of the highest mode low.
"""


def frame_of(stories: int, random: np.random.Generator) -> KnownFrame:
    """Return a frame with its lowest mode at 1.5 Hz and 1 % of damping."""
    frame = KnownFrame(1000 * random.uniform(0.8, 1.2, stories), random.uniform(0.8, 1.2, stories), 0.01)
    return dataclasses.replace(frame, stiffnesses=frame.stiffnesses * (1.5 / frame.modes()[0][0]) ** 2)


def record_of(frame: KnownFrame, kind: str, seed: int, rate: float) -> TimeRecord:
    """Return a record with 3 % of noise."""
    if kind == "base":
        return base_record(frame, seed, noise=0.03, duration=300.0, sampling_rate=rate)
    if kind == "none":
        return ambient_record(frame, seed, noise=0.03, duration=900.0, sampling_rate=rate)
    stories = len(frame.masses)
    return hammer_record(frame, seed, noise=0.03, floors=(1, stories), hits=5, duration=40.0, sampling_rate=rate)


def errors(method: str, stories: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return errors over stated deviations: frequencies by mode, damping by mode, and the entries of all shapes."""
    random = np.random.default_rng([seed, stories])
    frame = frame_of(stories, random)
    frequencies, shapes = frame.modes()
    absent = random.choice(stories - 1, stories // 3, replace=False)
    kept, kind = np.setdiff1d(np.arange(stories), absent), METHODS[method]
    record = only(record_of(frame, kind, seed, float(np.ceil(RATE.get(kind, 2.6) * frequencies[-1]))), kept)
    found = identify_modes(record, method=method)
    of_frequency, of_damping, of_entries = np.full(stories, np.nan), np.full(stories, np.nan), []
    for row, frequency in enumerate(found.frequencies):
        mode = int(np.argmin(np.abs(np.log(frequencies / frequency))))
        of_frequency[mode] = (frequency / frequencies[mode] - 1) / found.frequency_std[row]
        of_damping[mode] = (found.damping_ratios[row] - frame.damping) / found.damping_std[row]
        largest = int(np.argmax(np.abs(found.mode_shapes[row])))
        off = (
            found.mode_shapes[row] / found.mode_shapes[row, largest] - shapes[mode, kept] / shapes[mode, kept[largest]]
        )
        others = np.arange(len(kept)) != largest
        of_entries.append(off[others] / found.mode_shape_std[row, others])
    return of_frequency, of_damping, np.concatenate(of_entries)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--stories", type=int, nargs="*", default=[3, 4, 5, 6, 7, 8])
    parser.add_argument("--methods", nargs="*", default=list(METHODS), choices=list(METHODS))
    chosen = parser.parse_args()
    for method in chosen.methods:
        frequency, damping, entries, lost = [], [], [], 0
        for stories in chosen.stories:
            for seed in range(chosen.first, chosen.first + chosen.seeds):
                try:
                    each = errors(method, stories, seed)
                except CvxshearError:
                    lost += 1
                    continue
                for store, values in zip((frequency, damping), each[:2], strict=True):
                    store.append(np.pad(values, (0, 8 - stories), constant_values=np.nan))
                entries.append(each[2])
        for name, table in (("frequency", frequency), ("damping", damping)):
            known = np.isfinite(table)
            within = np.abs(table) < WITHIN
            share = 100 * within.sum(axis=0) / np.maximum(known.sum(axis=0), 1)
            print(
                f"{method:9} {name:9} {100 * within.sum() / known.sum():.1f} %, "
                f"by mode {np.round(share).astype(int).tolist()} %, of {known.sum(axis=0).tolist()}"
            )
        together = np.concatenate(entries)
        print(
            f"{method:9} entries   {100 * np.mean(np.abs(together) < WITHIN):.1f} % of {len(together)}; {lost} lost",
            flush=True,
        )


if __name__ == "__main__":
    main()
