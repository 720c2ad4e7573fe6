"""What drove a frame, from a record file: the motion of the ground or a force, with responses where they are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cvxshear.files.record import RECORD_KEYS, columns_of, rate_of, read_record, refuse_two_rates
from cvxshear.files.record_tables import added_mass_of, channels_of, driver_of, placed, runs_of, tables_of
from cvxshear.modal.motion import Drive, Motion
from cvxshear.util import checks


def read_motion(path: str | Path) -> Motion:
    """Read what drove a frame from a record file, with the floors' accelerations where it names such channels.

    Parameters
    ----------
    path : str or Path
        As for `read_record`; here a channel of the ground, or of the force, is enough.

    Returns
    -------
    Motion

    Raises
    ------
    InputError
        As `read_record` does, and where nothing says what drove the frame.
    """
    path = Path(path)
    table, lines = tables_of(path)
    with placed(path):
        declared = checks.keys(table["record"], RECORD_KEYS, [], "record")
        channels = channels_of(table["channel"], declared, path, lines)
        driver = driver_of(channels, declared.get("input", "none"))
    if driver is None or declared.get("kind", "time") != "time" or any(item.responds for item in channels):
        found = read_record(path)
        return Motion.of(found.record, found.added_mass, found.state)
    with placed(path):
        drives, rates = [], []
        for run in runs_of(table, declared):
            columns = columns_of(run, declared, path)
            rates.append((rate_of(declared, columns), columns.source))
            excitation = driver.factor * columns.column(driver.column, driver.place or path.name)
            floor = run.get("input_floor", declared.get("input_floor", driver.floor))
            drives.append(Drive(excitation, floor, name=run.get("name", Path(run["file"]).name)))
        refuse_two_rates(rates)
        name = checks.text(declared.get("name", path.stem), "record: name")
        added = added_mass_of(table, path)
        return Motion(
            tuple(drives), rates[0][0], declared["input"], added_mass=None if added is None else np.array(added),
            name=name, state=None if table.get("state") is None else checks.text(table["state"], "state"),
        )  # fmt: skip
