"""A commented measurement file to fill in."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import tomli_w

from cvxshear.files.formats import read_modes_of
from cvxshear.util import checks
from cvxshear.util.checks import MOST_STORIES
from cvxshear.util.errors import InputError
from cvxshear.util.text import escaped, printable
from cvxshear.util.typing import Floats

MASS, STIFFNESS, FORCE = 10.0, 10e3, 100.0
"""Of the floors (kg) and stories (N/m) of the frame that stands for the user's, and a pull at its top (N)."""

HEAD = """\
# What is known of a frame, and what was measured on it. Replace the numbers below by your own and leave out what you
# do not know; a line that begins with # is not read. SI units, frequencies in Hz; floor 1 is the first above ground,
# story 1 the one below it; lists begin at the bottom.

[frame]
stories = {stories}
{total}
# story_heights = {heights}  # m, one number or one a story; effects such as gravity need them
# total_mass_std = 0.01  # relative: how well the total mass is known; exact where not given
# total_mass_placeholder = true  # total_mass stands for one that nobody knows: all comes out relative to it
# floor_masses = {masses}  # kg, where they are known, in place of total_mass
# gravity = 9.81  # m/s2
# reference = "bare"  # the state that is the frame itself
# accept = ["total_mass"]  # findings of 'cvxshear check' that are known and right, by name

[[configuration]]  # one tested state of the frame; repeat the table for each
name = "bare"
{modes}
# added_mass = {added}  # kg on each floor in this test
# state = "bare"  # tests of one state, before or after a change, share its name
# modes = [1, 3]  # which modes of the frame these are, where it is not 1, 2, 3, ...
# other_modes = [{{modes = [2, 3], probability = 0.3}}]  # which they may be as well; 'cvxshear loop' weighs them
# mass_normalized = true  # the shapes are in 1/sqrt(kg), so that they tell how heavy the frame is
frequency_std = 0.002  # relative: how much repeated tests scatter
mode_shape_std = 0.01  # of an entry, relative to the largest of its mode
# mode_shape_noise = "multiplicative"  # mode_shape_std is relative to the entry itself
# damping_ratios = 0.01  # fraction of critical, one number or one a mode (nan: unknown): for 'predict', not fitted
# damping_ratio_std = 0.2  # relative
"""

TOTAL = "total_mass = {total}  # kg, all floors without added mass; not needed with two different added masses"
"""The line that a new file has where its modes are made up."""

TO_FILL_IN = """\
total_mass = 1.0  # kg, all floors without added mass: FILL IN, or give two configurations with different added masses;
# {file} does not tell how heavy the frame is, and with 1 kg masses and stiffnesses come out per kilogram of it"""

CARRIED = "# total_mass is not needed: the shapes carry the scale, 1/sqrt(kg)"

LISTS = """\
# measured_floors = {floors}  # where sensors stood, where it is not every floor
frequencies = {frequencies}  # Hz, ascending
mode_shapes = [  # one row a mode, one entry a measured floor; any scale; nan where not measured
{rows}
]
# csv = "modes.csv"  # a table with the modes, in place of both lists
# xlsx = "modes.xlsx"  # the same as a spreadsheet
# uff = "test.uff"  # the same as a universal file"""

TAIL = """
# [[static]]  # a pull or tilt test; any number
# name = "rope at the top"
# force = {force}  # N, on each floor
# displacement = {displacement}  # m, of each floor; nan where not measured
# displacement_std = 0.01  # relative to the largest
# state = "bare"  # which state of the frame was pulled
# added_mass = {added}  # kg on each floor in this test

# [[prior]]  # what is known beforehand; any number
# kind = "bounds"  # or "ratio", "value", "nominal", "monotone", each with keys of its own
# quantity = "story_stiffness"  # or "floor_mass", "story_damping"
# lower = 1e3  # N/m
# upper = 1e9  # N/m

# [[effect]]  # what is expected of an effect that 'cvxshear loop' looks for; any number
# name = "ground_spring"
# floor = 1  # where it applies, everywhere where not given; others have a story in its place
# state = "bare"  # in which state
# size = 1e3  # standard deviation of its parameter, in its unit
# probability = 0.1  # that it is there
# exclude = true  # in place of both: it is not looked for there

# [[effect]]
# name = "story_change"
# story = 1

# [[effect]]
# name = "bracing"
# to = 1  # the higher floor of an effect that joins two; floor is then the lower

# [damping]  # how damping is modelled where a response is predicted
# kind = "modal"  # or "story", "rayleigh"

# [limits]  # whether 'cvxshear reconstruct' finds them passed, story by story
# story_drift = [0.005, 0.01]  # drift over story height, ascending
# names = ["repair", "inspection"]  # what each means
"""


def template(stories: int = 3) -> str:
    """A measurement file of a frame of equal stories, with every key explained.

    What is not needed stands as a comment.

    Parameters
    ----------
    stories : int, optional

    Returns
    -------
    str
        TOML that `cvxshear.load` takes as it stands.
    """
    checks.whole(stories, "stories", least=1, most=MOST_STORIES)
    frequencies, shapes = _uniform(stories)
    lists = LISTS.format(
        floors=_listed(np.arange(1, stories + 1), "d"),
        frequencies=_listed(frequencies, ".4f"),
        rows="\n".join(f"    {_listed(shape, '.4f')}," for shape in shapes),
    )
    return _filled(lists, stories, TOTAL)


def template_from(modes: str | Path, folder: str | Path = ".") -> str:
    """A measurement file whose modes are read from a table or a universal file.

    Parameters
    ----------
    modes : str or Path
        Of one of the formats in `files.formats.FORMATS` that hold modes.
    folder : str or Path, optional
        Where the measurement file will stand; it names the other from there.

    Returns
    -------
    str
        TOML that `cvxshear.load` takes as it stands.

    Raises
    ------
    InputError
        Where the file cannot be read.
    """
    key, found = read_modes_of(modes)
    named = toml_line(key, os.path.relpath(modes, folder))
    total = CARRIED if found.get("mass_normalized") else TO_FILL_IN.replace("{file}", printable(Path(modes).name))
    text = _filled(f"{named}  # frequencies and mode shapes", max(found["measured_floors"]), total)
    for given in ("frequency_std", "mode_shape_std"):
        # What the table says itself need not be said here.
        text = text.replace(f"\n{given} =", f"\n# {given} =") if given in found else text
    return text


def toml_line(key: str, name: str) -> str:
    """A line of TOML that names a file, from the folder that the line stands in.

    Raises
    ------
    InputError
        Where the name has bytes that are no text, which TOML cannot hold.
    """
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(f"{name}: a name that is no UTF-8 text cannot stand in TOML; rename the file") from None
    return escaped(tomli_w.dumps({key: name.replace(os.sep, "/")})).rstrip("\n")


def _filled(modes: str, stories: int, total: str) -> str:
    return HEAD.format(
        stories=stories,
        total=total.replace("{total}", f"{MASS * stories:.1f}"),
        heights=_listed(np.full(stories, 3.0), ".1f"),
        masses=_listed(np.full(stories, MASS), ".1f"),
        added=_listed(np.zeros(stories), ".1f"),
        modes=modes,
    ) + TAIL.format(
        force=_listed(np.eye(stories)[-1] * FORCE, ".1f"),
        displacement=_listed(np.arange(1, stories + 1) * FORCE / STIFFNESS, ".3f"),
        added=_listed(np.zeros(stories), ".1f"),
    )


def _uniform(stories: int) -> tuple[Floats, Floats]:
    """Modes of equal floors of 10 kg on equal stories of 10 kN/m: sine waves, in closed form."""
    angle = (2 * np.arange(1, stories + 1) - 1) * np.pi / (2 * stories + 1)
    shapes = np.sin(np.outer(angle, np.arange(1, stories + 1)))
    frequencies = np.sqrt(STIFFNESS / MASS) * 2 * np.sin(angle / 2) / (2 * np.pi)
    return frequencies, shapes / np.abs(shapes).max(axis=1, keepdims=True)


def _listed(values: Floats | np.ndarray, shown: str) -> str:
    return "[" + ", ".join(format(value, shown) for value in values) + "]"
