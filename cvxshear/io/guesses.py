"""Guess the columns of a logger's file from their names, units and numbers."""

import dataclasses
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np

from cvxshear.io.columns import Columns
from cvxshear.records.data_frames import TIME_UNITS, UNEVEN_STEP
from cvxshear.util.quantities import CHANNEL_UNITS
from cvxshear.util.typing import Floats


def blank_text(name: str) -> str:
    """Read a text of the folder `blank`."""
    return resources.files("cvxshear.io").joinpath("blank", name).read_text(encoding="utf-8")


_WORDS = tomllib.loads(blank_text("words.toml"))
(
    TIME, GROUND, FORCE, ROOF, NO_MOTION, BASEMENT, NTH_FLOOR, AXIS, BRACKETED, ENDING, RATE, HIT_FLOOR, RELEASE,
) = (re.compile(pattern, re.IGNORECASE) for pattern in _WORDS["name"].values())  # fmt: skip
"""Patterns of columns, units and sampling rates in a preamble; comments in the file explain each, in this order."""

NUMBER = re.compile(r"\d+")

ASCENDING = 0.99
"""Share of the steps of a column of time that are not negative; a handful may be torn."""


@dataclass(frozen=True)
class Guess:
    """Guess for one column, from its name and its numbers.

    Parameters
    ----------
    column : str
    unit : str or None
        Of `CHANNEL_UNITS`, None where the file says none.
    role : str
        "ground", "force" or "floor".
    floor : int
    sure : bool
        Whether a number in the name says the floor, and not the order of the columns.
    axis : str
    said : str
        The unit as the file spells it, where it is not one of `CHANNEL_UNITS`.
    why : str
        What else the floor follows from, and what it would be otherwise.
    """

    column: str
    unit: str | None
    role: str
    floor: int
    sure: bool
    axis: str
    said: str = ""
    why: str = ""


def time_column(columns: Columns) -> str | None:
    """Find the ascending column with a name of time, or else the first column if it ascends in even steps."""
    called = [name for name in columns.names if TIME.match(name.strip())]
    # Of a date and a time of the day the one that changes from sample to sample.
    steps_of = {name: _steps(columns, name) for name in (*called, *columns.names[:1])}
    for name, steps in sorted(
        steps_of.items(), key=lambda each: (each[0] not in called, -np.count_nonzero(each[1] > 0))
    ):
        if steps.size == 0 or np.mean(steps >= 0) < ASCENDING:
            continue
        usual = np.median(steps)
        # Steps of 1 count the samples.
        even = np.mean(np.abs(steps - usual) < UNEVEN_STEP * usual) > ASCENDING
        if name in called or (usual > 0 and usual != 1.0 and even):
            return name
    return None


def _steps(columns: Columns, name: str) -> Floats:
    values = columns.values[:, columns.names.index(name)]
    return np.asarray(np.diff(values[np.isfinite(values)]))


def said_unit(columns: Columns, name: str) -> tuple[str, str]:
    """Find the unit that a line of units or the header says, as it is called here and as it is spelled there."""
    said = columns.units[columns.names.index(name)] if columns.units else ""
    candidates = [said] if said else [found[1] or found[2] or "" for found in BRACKETED.finditer(name)]
    if not said and (found := ENDING.search(name)):
        candidates.append(re.sub(r"_?p?s2", "/s2", found[1]))
    known = [(unit, each) for each in candidates if (unit := _known_unit(each))]
    # "Level 3 N" is to the north: of a last word only a unit of acceleration is taken for one.
    last = name.rsplit(maxsplit=1)[-1] if " " in name.strip() else ""
    if not said and CHANNEL_UNITS.get(_known_unit(last), ("",))[0] == "acceleration":
        known.append((_known_unit(last), last))
    return known[-1] if known else ("", candidates[0] if candidates else "")


def _known_unit(said: str) -> str:
    """Return the library's name of a unit; empty for an unknown unit."""
    plain = re.sub(r"[\s*^]", "", said.strip().replace("²", "2").replace("**", ""))
    known = {each.lower(): each for each in (*CHANNEL_UNITS, *TIME_UNITS)}
    lower = plain.lower()
    return str(_WORDS["unit"].get(lower, plain if plain in CHANNEL_UNITS else known.get(lower, "")))


def guesses_of(columns: Columns, names: Sequence[str]) -> list[Guess]:
    """Tell what each column is, those that hold no number left out."""
    found: list[Guess] = []
    for name in names:
        if NO_MOTION.search(name) or not np.isfinite(columns.values[:, columns.names.index(name)]).any():
            continue
        unit, said = said_unit(columns, name)
        bare = ENDING.sub("", BRACKETED.sub("", name))
        force = bool(FORCE.search(bare)) or (unit in CHANNEL_UNITS and CHANNEL_UNITS[unit][0] == "force")
        ground = not force and bool(GROUND.search(bare.replace("_", " ")) or BASEMENT.search(bare))
        number = NUMBER.findall(bare)
        axis = AXIS.search(bare)
        floor = 0 if ground else int(number[-1]) if number and 0 < int(number[-1]) < 200 else -1
        role = "force" if force else "ground" if ground else "floor"
        found.append(
            Guess(name, unit if unit in CHANNEL_UNITS else None, role, floor, floor >= 0,
                  (axis[1] or axis[2]).lower() if axis else "x", "" if unit in CHANNEL_UNITS else said)
        )  # fmt: skip
    found = _as_in_japan(found)
    # Columns without a number get the remaining floors, in order; a roof is above all others.
    named = {each.floor for each in found if each.role == "floor"}
    free = iter(sorted(set(range(1, len(found) + max({0, *named}) + 1)) - named))
    result = []
    for each in sorted(found, key=lambda each: bool(each.floor < 0 and ROOF.search(each.column))):
        floor, why = each.floor, each.why
        if each.role == "floor" and floor < 0:
            floor = next(free) if not ROOF.search(each.column) else max({0, *named}) + 1
            if ROOF.search(each.column) and len(named) < floor - 1:
                why = ", as low as it can be: CHECK how many stories there are"
            named.add(floor)
        result.append(dataclasses.replace(each, floor=floor, why=why))
    return sorted(result, key=lambda each: names.index(each.column))


def _as_in_japan(found: Sequence[Guess]) -> list[Guess]:
    """Count 2F as the first floor above ground if 1F or a basement is the ground, and no other column is."""
    called = [NTH_FLOOR.search(BRACKETED.sub("", each.column)) if each.role == "floor" else None for each in found]
    numbers = [int(each[1] or each[2]) if each else 0 for each in called]
    basement = [bool(each.role == "ground" and BASEMENT.search(each.column)) for each in found]
    grounds = [each for each in found if each.role == "ground"]
    roof = any(ROOF.search(each.column) for each in found)
    at_ground = numbers.count(1) == 1 and roof and not grounds
    if not any(numbers) or not (at_ground or (len(grounds) == 1 and any(basement) and 1 not in numbers)):
        why = "; {} where 1F is at the ground, as in Japan"
        pairs = zip(found, numbers, strict=True)
        return [dataclasses.replace(each, why=why.format(n - 1)) if n > 1 else each for each, n in pairs]
    return [
        each if not number
        else dataclasses.replace(each, role="ground", floor=0, why=" (1F, as in Japan; 1 where it is above ground)")
        if number == 1
        else dataclasses.replace(each, floor=number - 1, why=f", counted as in Japan; {number} if 1F is above ground")
        for each, number in zip(found, numbers, strict=True)
    ]  # fmt: skip
