"""Units that look wrong, where something declared besides speaks against them: warnings, never more.

Nothing in frequencies and shapes alone tells a unit. What does is stated with each function.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cvxshear.measurement.experiment import Experiment
from cvxshear.model.shear import mass_matrix, modes, stiffness_matrix
from cvxshear.screening.finding import Finding
from cvxshear.util.quantities import quantity, significant
from cvxshear.util.typing import Floats

EARTH = (9.7, 10.0)
"""m/s2; between the equator and the poles it is 9.78 to 9.83, and often rounded."""

OTHER_GRAVITIES = ((981.0, "cm/s2"), (9810.0, "mm/s2"), (32.2, "ft/s2"), (386.0, "in/s2"), (1.0, "g"))

HIGHEST_STORY = 25.0
"""m."""

BUILDING_STORY = 2.3
"""m; from here on a story is one of a building that people use."""

MODEL_STORY = 0.6
"""m; up to here it is one of a model in a laboratory."""

LIGHTEST_FLOOR = 300.0
"""kg, of a building."""

HEAVIEST_MODEL_FLOOR = 3000.0
"""kg."""

HIGHEST_TIMES_FREQUENCY = 200.0
"""m Hz. A building's first frequency is 46 Hz m over its height (Ellis 1980), within a factor of two or so;
rad/s would make that 290."""

NEAR = 0.15
"""Of the logarithm: so near must a ratio be to a factor between units."""


def gravity(experiment: Experiment) -> Iterator[Finding]:
    """Gravity is known."""
    value = experiment.frame.gravity
    if EARTH[0] <= value <= EARTH[1]:
        return
    unit = next((f" (that would be {unit})" for size, unit in OTHER_GRAVITIES if _near(value, size)), "")
    yield Finding(
        "gravity", None, f"gravity = {value:g} m/s2 is not the Earth's{unit}",
        "write it in m/s2, 9.81, or leave it out", refuses=False,
    )  # fmt: skip


def heights(experiment: Experiment) -> Iterator[Finding]:
    """No story is as high as a tower."""
    found = experiment.frame.story_heights
    if found is None or found.max() <= HIGHEST_STORY:
        return
    yield Finding(
        "heights", None, f"story_heights of up to {found.max():g} m look like mm or cm",
        "write story_heights in m", refuses=False,
    )  # fmt: skip


def masses(experiment: Experiment) -> Iterator[Finding]:
    """Floors of a building weigh tons, those of a model that stands on a table do not."""
    frame = experiment.frame
    if frame.story_heights is None or frame.known_total is None:
        return
    height, floor = float(np.mean(frame.story_heights)), frame.known_total / experiment.stories
    if BUILDING_STORY <= height <= HIGHEST_STORY and floor < LIGHTEST_FLOOR:
        unit = "t"
    elif height <= MODEL_STORY and floor > HEAVIEST_MODEL_FLOOR:
        unit = "g"
    else:
        return
    yield Finding(
        "masses", None,
        f"floors of {quantity(floor, 'kg', 3)} each under stories of {significant(height, 3)} m look like masses in "
        f"{unit}",
        "write masses in kg", refuses=False,
    )  # fmt: skip


def angular_frequency(experiment: Experiment) -> Iterator[Finding]:
    """Design values of masses and stiffnesses give the frequencies; else a tall building's height tells their order."""
    ratio = _over_nominal(experiment)
    lowest = next((each.frequencies[0] for each in experiment.configurations if each.modes[0] == 1), None)
    heights = experiment.frame.story_heights
    if ratio is not None:
        if not _near(ratio, 2 * np.pi):
            return
        said = f"the frequencies are {ratio:.2f} times those of the nominal masses and stiffnesses, about 2 pi"
    elif lowest is not None and heights is not None and BUILDING_STORY <= heights.mean() <= HIGHEST_STORY:
        if lowest * heights.sum() <= HIGHEST_TIMES_FREQUENCY:
            return
        height = significant(heights.sum(), 3)
        said = f"a first frequency of {significant(lowest, 3)} Hz is high for a building of {height} m"
    else:
        return
    yield Finding(
        "angular_frequency", None, f"{said}: they look like rad/s",
        "write frequencies in Hz, the angular ones divided by 2 pi", refuses=False,
    )  # fmt: skip


def _over_nominal(experiment: Experiment) -> float | None:
    """The frequencies measured over those of the design values; None where these do not give any."""
    values: dict[str, Floats] = {}
    for prior in experiment.priors:
        suggested = prior.suggested(experiment.stories)
        if prior.fixes_scale and suggested is not None and not np.any(np.isnan(suggested)):
            values[prior.quantity] = suggested
    known = experiment.frame.floor_masses
    mass = values.get("floor_mass") if known is None else known
    if mass is None and experiment.frame.known_total is not None:
        mass = np.full(experiment.stories, experiment.frame.known_total / experiment.stories)
    if mass is None or "story_stiffness" not in values:
        return None
    logs = [
        np.log(each.frequencies)
        - np.log(_frequencies(mass + each.added_mass, values["story_stiffness"])[each.modes - 1])
        for each in experiment.configurations
    ]
    return float(np.exp(np.median(np.concatenate(logs))))


def _frequencies(mass: Floats, stiffness: Floats) -> Floats:
    return modes(mass_matrix(mass), stiffness_matrix(stiffness)).frequencies


def _near(value: float, size: float) -> bool:
    return bool(abs(np.log(value / size)) < NEAR)
