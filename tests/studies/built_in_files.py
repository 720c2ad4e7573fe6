"""Write the built-in measurement files of measured frames from the published data beside the project.

    CVXSHEAR_SHARED=... python -m tests.studies built_in_files [FOLDER]

writes them to cvxshear/builtin, or to another folder. `cvxshear modes` identifies the modes of the records and
functions. The modes of the benchmark get seeded noise. The frequencies of the loosened joints are the published values.
The files of Los Alamos and E-Defense were written by hand.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from cvxshear.io.modes import modes_from_file
from tests.records.shared import DATA, mini_table, southampton

BUILT_IN = Path(__file__).parents[2] / "cvxshear" / "builtin"

MINI = {
    "mini-flexible-northridge": "flexible-northridge",
    "mini-flexible-sine": "flexible-sine-2.0",
    "mini-stiff-northridge": "stiff-northridge",
    "mini-stiff-sine": "stiff-sine-2.0",
}
"""Built-in files and the records from which their modes are identified."""

OF_MINI = """\
# A three-story bench model on a small shake table, with {columns} columns: modes of the record of {motion},
# as `cvxshear modes` finds them. Accelerometers at the base and the floors, 120 Hz. Masses and heights are not
# documented: the total mass stands for one, and all results are relative to it.
# Source: records in the notebooks of the mdof package, BSD 2-Clause, Copyright 2023 Chrystal Chern.
"""

OF_SOUTHAMPTON = """\
# A three-story aluminium model of about half a metre (Southampton): modes of its measured accelerances, each floor
# driven in turn, as `cvxshear modes` finds them. Driving points scale the shapes, so that no mass is declared.
# Source: Cristallo digital-twin platform, BSD 3-Clause, Copyright 2021 Digital-Twin-Operational-Platform.
"""

FREQUENCY_STD, SHAPE_STD = 0.002, 0.01
"""Standard deviations of the benchmark's noise: a careful ambient test reaches them, and the measurement file has them
as defaults."""

SEED = 20

FLOOR_MASSES = (3452.4, 2652.4, 2652.4, 1809.9)
"""Floor masses of the benchmark, kg, from its published program."""

NOISE = f"{100 * FREQUENCY_STD:g} % of a frequency, {100 * SHAPE_STD:g} % of a shape's largest entry, seed {SEED}"

OF_BENCHMARK = f"""\
# The simulated benchmark of the IASC-ASCE task group on structural health monitoring, phase I, in {{direction}}: a
# braced steel frame of four stories, 3.6 m tall, undamaged (pattern 0) and with six patterns of damage. Modes of its
# model of 120 degrees of freedom, whose joints turn and whose columns stretch, with normal noise added by
# `python -m tests.studies built_in_files`: {NOISE}.
# Source: the task group's program datagen (P. Lam, 2000 and 2001; MIT licence as uploaded), as described by
# E. Johnson, H. Lam, L. Katafygiotis, J. Beck, Phase I IASC-ASCE Structural Health Monitoring Benchmark Problem Using
# Simulated Data, Journal of Engineering Mechanics 130, 2004. Floor masses are those of its model.
"""

REBUILD_STD = (0.0015, 0.0023, 0.0016)
"""Scatter of the healthy frame's frequencies over five rebuilds."""

OF_JOINTS = """\
# A bench frame of three floors on four screwed plates (University College London): natural frequencies of the healthy
# frame and with the four screws of one plate loosened by 1/8, 1/2 or 1 turn, from taps with one sensor on top. The
# second frequency is missing where twice the first falls on it. Standard deviations: the scatter over five rebuilds.
# Floors 2 and 3 were weighed, floor 1 is alike; heights are not published.
# Source: public repository Eric56123/Building_Sensor, folder four_floor/characterisation, a student's project
# (a deposit under CC BY 4.0 is announced there).
"""


def main(folder: Path) -> None:
    """Write all files that this script makes to a folder."""
    with tempfile.TemporaryDirectory() as scratch:
        for name in (*MINI, "southampton"):
            record = record_of(name, Path(scratch))
            (folder / f"{name}.toml").write_text(header_of(name) + from_record(record))
    for direction in "xy":
        (folder / f"iasc-asce-{direction}.toml").write_text(benchmark(direction))
    (folder / "ucl-loosened-joints.toml").write_text(loosened_joints())


def record_of(name: str, folder: Path) -> Path:
    """Write the record file of a built-in frame to a folder and return its path."""
    return southampton(folder) if name == "southampton" else mini_table(folder, MINI[name])


def header_of(name: str) -> str:
    """Describe a built-in frame and its source."""
    if name == "southampton":
        return OF_SOUTHAMPTON
    columns, _, motion = MINI[name].partition("-")
    return OF_MINI.format(
        columns=columns, motion="a scaled earthquake (Northridge)" if motion == "northridge" else "a sine of 2 Hz"
    )


def from_record(record: Path) -> str:
    """Return the measurement file that `cvxshear modes` writes."""
    output = record.with_suffix(".modes.toml")
    modes_from_file(record, output=output)
    return output.read_text()


def benchmark(direction: str) -> str:
    """Return modes of the seven patterns in one direction."""
    rng = np.random.default_rng([SEED, "xy".index(direction)])
    lines = [
        OF_BENCHMARK.format(direction=direction),
        "[frame]",
        "stories = 4",
        "story_heights = 0.9",
        f"floor_masses = {list(FLOOR_MASSES)}",
        'reference = "pattern 0"',
    ]
    for pattern in range(7):
        modes = [
            row
            for row in rows("iasc-asce/modes.csv")
            if (row["model"], row["damage"], row["direction"]) == ("120", str(pattern), direction)
        ]
        modes = sorted(modes, key=lambda row: int(row["number"]))[:4]
        frequencies = np.array([float(row["hz"]) for row in modes])
        shapes = np.array([[float(row[f"{direction}{floor}"]) for floor in range(1, 5)] for row in modes])
        shapes /= shapes[np.arange(4), np.abs(shapes).argmax(axis=1)][:, None]
        frequencies *= 1.0 + FREQUENCY_STD * rng.standard_normal(4)
        shapes += SHAPE_STD * rng.standard_normal((4, 4))
        lines += [
            "",
            "[[configuration]]",
            f'name = "pattern {pattern}"',
            f"frequencies = [{numbers(frequencies, 4)}]",
            "mode_shapes = [",
            *(f"    [{numbers(shape, 4)}]," for shape in shapes),
            "]",
            f"frequency_std = {FREQUENCY_STD}",
            f"mode_shape_std = {SHAPE_STD}",
        ]
    return "\n".join(lines) + "\n"


def loosened_joints() -> str:
    """Return frequencies of the healthy frame and of twelve states with one loose plate."""
    lines = [OF_JOINTS, "[frame]", "stories = 3", "floor_masses = [0.697, 0.6967, 0.6976]", 'reference = "healthy"']
    for row in rows("ucl-loosened-joints/states.csv"):
        if row["session"] != "day6":
            continue
        known = [mode for mode in (1, 2, 3) if row[f"f{mode}_hz"]]
        lines += [
            "",
            "[[configuration]]",
            f'name = "{state_name(row)}"',
            *([f"modes = {known}"] if len(known) < 3 else []),
            f"frequencies = [{', '.join(row[f'f{mode}_hz'] for mode in known)}]",
            f"frequency_std = {[REBUILD_STD[mode - 1] for mode in known]}",
        ]
    return "\n".join(lines) + "\n"


def state_name(row: dict[str, str]) -> str:
    """Describe the state in the words of the measurement file."""
    if row["damaged_plate"] == "none":
        return "healthy"
    turns = {"0.125": "1/8 turn", "0.5": "1/2 turn", "1": "1 turn"}[row["turns"]]
    return f"{row['damaged_plate'].replace('floor', 'floor ')}, {turns}"


def numbers(values: Iterable[float], digits: int) -> str:
    """Format the numbers of a list."""
    return ", ".join(f"{value:.{digits}f}" for value in values)


def rows(file: str) -> Sequence[dict[str, str]]:
    """Return the rows of a published table."""
    with (DATA / file).open(newline="") as stream:
        return list(csv.DictReader(stream))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else BUILT_IN)
