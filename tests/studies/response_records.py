"""Predict measured records: `python -m tests.studies response_records` prints the table of docs/measured/.

Modes come from one record of the mini shake table. The shear model and the model with joint rotation predict both
records. The environment variable CVXSHEAR_SHARED names the folder of the records.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import numpy as np

import cvxshear
from cvxshear.io.modes import modes_from_file
from cvxshear.loop.close import search_for_effects
from cvxshear.response import models_of_loop, predict, reconstruct
from tests.records.shared import mini_table

FRAMES = ("flexible", "stiff")
RECORDS = ("northridge", "sine-2.0")


@functools.cache
def models(name):
    """Return the shear model and the model with joint rotation for the modes of one record.

    The heights and masses of the specimen are not documented. The models take equal stories of 1 m and a mass of 1 kg;
    neither value affects accelerations.
    """
    with tempfile.TemporaryDirectory() as folder:
        _, declared = modes_from_file(mini_table(Path(folder), name))
    declared["frame"] |= {"story_heights": 1.0, "total_mass": 1.0, "total_mass_placeholder": True}
    experiment = cvxshear.Experiment.from_dict(declared, name=name)
    return models_of_loop(search_for_effects(experiment, effects=["joint_rotation"]))


@functools.cache
def predicted(source, record):
    """Predict one record with the models of another."""
    with tempfile.TemporaryDirectory() as folder:
        return predict(models(source), mini_table(Path(folder), record))


def row(side):
    """Return errors over all floors: largest rms and peak errors, mean errors in time and around each mode."""
    of = side.comparison
    off = [np.max(np.abs(ratio - 1)) for ratio in (of.rms_ratio, of.peak_ratio)]
    return [*off, np.mean(of.nrmse), *np.mean(of.frf_error, axis=0)]


@functools.cache
def reconstructed(source, record):
    """Reconstruct one record with the models of another."""
    with tempfile.TemporaryDirectory() as folder:
        return reconstruct(models(source), mini_table(Path(folder), record))


def sensors():
    """Print each floor's reconstruction from the other two: error, stated deviation, and the prediction's error."""
    print("| frame | modes from | record | floor | error | stated | within 95 % band | prediction alone |")
    print("|---|---|---|---:|---:|---:|---:|---:|")
    for frame in FRAMES:
        for source, record in (RECORDS, RECORDS[::-1]):
            for check in reconstructed(f"{frame}-{source}", f"{frame}-{record}").checks:
                cells = [check.error, check.stated]
                cells = " | ".join(f"{100 * value / check.measured:.1f} %" for value in cells)
                print(
                    f"| {frame} | {source} | {record} | {check.floor} | {cells} | {100 * check.within:.0f} % | "
                    f"{100 * check.prediction_error / check.measured:.0f} % |",
                    flush=True,
                )


def main():
    print("| frame | modes from | record | model | rms | peak | in time | H, mode 1 | 2 | 3 |")
    print("|---|---|---|---|---:|---:|---:|---:|---:|---:|")
    for frame in FRAMES:
        for source in RECORDS:
            for record in RECORDS:
                found = predicted(f"{frame}-{source}", f"{frame}-{record}")
                for word, side in (("before", found.before), ("after", found.after)):
                    cells = " | ".join(f"{100 * value:.0f} %" for value in row(side))
                    print(f"| {frame} | {source} | {record} | {word} | {cells} |", flush=True)
    print()
    for frame in FRAMES:
        for source, record in (RECORDS, RECORDS[::-1]):
            found = predicted(f"{frame}-{source}", f"{frame}-{record}")
            ratios = ", ".join(f"{100 * ratio:.2f}" for ratio in found.damping.ratios)
            shifts = "; ".join(str(shift) for shift in found.after.comparison.shifts)
            print(f"{frame}, modes from {source}: damping {ratios} %. Of {record}: {shifts}", flush=True)


if __name__ == "__main__":
    main()
    print()
    sensors()
