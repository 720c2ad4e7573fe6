"""Writes three records of a shaken frame as a logger would: bare, with a counterweight, and after a story was damaged.

Each is a CSV file whose time stamps are rounded to a millisecond, and a record file beside it. Then

    cvxshear modes bare.toml loaded.toml after.toml -o test.toml
    cvxshear loop test.toml
"""

from pathlib import Path

import numpy as np

from cvxshear.records.simulate import KnownFrame, shaker_record

MASSES = np.array([10.0, 7.5, 5.0])
STIFFNESSES = np.array([36e3, 24e3, 12e3])
DAMAGED = np.array([1.0, 0.85, 1.0])
RATE = 256.0

RECORD = """added_mass = [0.0, 0.0, {added}]          # kg on each floor
state = "{state}"

[record]
file = "{name}.csv"
input = "force"

[[channel]]
column = "force"
floor = 3
quantity = "force"

[[channel]]
column = "floor1"
floor = 1

[[channel]]
column = "floor2"
floor = 2

[[channel]]
column = "floor3"
floor = 3

[frame]
story_heights = 0.4
reference = "bare"
"""


def write(name: str, state: str, stiffnesses: np.ndarray, added: float, seed: int) -> None:
    """Shake a frame for two minutes and write what the logger would."""
    frame = KnownFrame(MASSES + np.array([0.0, 0.0, added]), stiffnesses, 0.01)
    run = shaker_record(frame, seed, noise=0.02, floor=3, duration=120.0, sampling_rate=RATE).runs[0]
    time = (np.arange(run.samples) + 1) / RATE
    table = np.column_stack([time, run.excitation, run.responses])
    header = "time_s,force,floor1,floor2,floor3"
    np.savetxt(f"{name}.csv", table, delimiter=",", header=header, comments="", fmt=["%.3f", *["%.5f"] * 4])
    Path(f"{name}.toml").write_text(RECORD.format(name=name, state=state, added=added), encoding="utf-8")
    first = ", ".join(f"{stamp:.3f}" for stamp in time[:6])
    print(f"{name}.toml, {name}.csv: {run.samples} samples at {RATE:g} Hz, stamped {first}, ... s")


write("bare", "bare", STIFFNESSES, 0.0, seed=1)
write("loaded", "bare", STIFFNESSES, 2.5, seed=2)
write("after", "after", STIFFNESSES * DAMAGED, 0.0, seed=3)
