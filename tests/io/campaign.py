"""Write three short records of a shaken frame as files: bare, with a counterweight, with a softer story."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cvxshear.records.simulate import KnownFrame, shaker_record
from tests.records.shared import channels

MASSES = np.array([10.0, 7.5, 5.0])
STIFFNESSES = np.array([36e3, 24e3, 12e3])
SOFTER = np.array([1.0, 0.85, 1.0])
ADDED = np.array([0.0, 0.0, 2.5])
RATE = 64.0

CHANNELS = channels("floor1", "floor2", "floor3")
FORCE = '\n[[channel]]\ncolumn = "force"\nfloor = 3\nquantity = "force"\n'
HEAD = 'added_mass = {added}\nstate = "{state}"\n[record]\nfile = "{name}.csv"\ninput = "force"\n'


def frame(name: str) -> KnownFrame:
    """Return the frame in one of its three states."""
    masses = MASSES + (ADDED if name == "loaded" else 0.0)
    return KnownFrame(masses, STIFFNESSES * (SOFTER if name == "after" else 1.0), 0.01)


RECORDS = ("bare", "loaded", "after")


def write_records(
    folder: Path, more: str = '\n[frame]\nstory_heights = 0.4\nreference = "bare"\n', names: Sequence[str] = RECORDS
) -> list[Path]:
    """Write the record files with time stamps rounded to a millisecond."""
    files = []
    for seed, name in enumerate(RECORDS):
        if name not in names:
            continue
        run = shaker_record(frame(name), seed, noise=0.01, floor=3, duration=60.0, sampling_rate=RATE).runs[0]
        time = np.arange(run.samples) / RATE
        table = np.column_stack([time, run.excitation, run.responses])
        header = "time_s,force,floor1,floor2,floor3"
        shown = ["%.3f", *["%.6f"] * 4]
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", header=header, comments="", fmt=shown)
        state = "after" if name == "after" else "bare"
        added = (ADDED if name == "loaded" else 0.0 * ADDED).tolist()
        files.append(folder / f"{name}.toml")
        files[-1].write_text(HEAD.format(added=added, state=state, name=name) + FORCE + CHANNELS + more)
    return files
