"""Declarations that look wrong by what else is declared or measured: units, elevations for heights, percent, rounding.

Nothing in the frequencies and shapes of one test alone says in which unit they are. What does is stated with each
function.
"""

from collections.abc import Iterator

import numpy as np

from cvxshear.measurement.experiment import Experiment
from cvxshear.screening.finding import Finding, doubt
from cvxshear.screening.shear_fit import modes_of
from cvxshear.util.quantities import quantity, significant
from cvxshear.util.typing import Floats

EARTH = (9.7, 10.0)
"""Range (m/s2) of the Earth's gravity: 9.78 to 9.83 between the equator and the poles, and often rounded."""

OTHER_GRAVITIES = ((981.0, "cm/s²"), (9810.0, "mm/s²"), (32.2, "ft/s²"), (386.0, "in/s²"), (1.0, "g"))
"""The Earth's gravity in other units, with their names."""

HIGHEST_STORY = 25.0
"""Story height (m) that no building exceeds: lobbies and plant floors of towers have up to 20 m."""

BUILDING_STORY = 2.3
"""Story height (m) from which on a story is one of a building: people need as much."""

MODEL_STORY = 0.6
"""Story height (m) up to which a story is one of a model in a laboratory."""

LIGHTEST_FLOOR = 300.0
"""Mass (kg) that a building's floor exceeds: one square metre of a concrete slab has as much."""

HEAVIEST_MODEL_FLOOR = 3000.0
"""Mass (kg) that no floor of a laboratory's model reaches: it would need a crane of its own."""

LIGHTEST_PLATE = 1.0
"""Mass (kg/m²) of a model's floor that is as wide as its story is high: a plate of aluminium of 0.4 mm has as much."""

HIGHEST_TIMES_FREQUENCY = 130.0
"""Largest product (m Hz) of a building's height and first frequency. The mean is 46 (Ellis 1980), within a factor of
two or so, and with walls nearly three; rad/s would make the mean 290."""

UNIT_FACTOR_WITHIN = 0.15
"""Difference of logarithms within which a ratio is taken for a factor between units."""

STEEP = 0.15
"""Relative deviation of the growth of story heights from an even one at which they still look added up."""

HIGHEST_GROUND = 2.0
"""Height of a ground story, over that of those above, up to which story heights that grow evenly look added up."""

SLOWEST = 0.02
"""Lowest first frequency (Hz): the tallest towers begin at some 0.1 Hz, and long bridges at 0.05 Hz."""

BEST_LABORATORY_STD = 1e-6
"""Relative standard deviation below which nothing is measured: the best counters and interferometers are no better."""

LARGEST_STD = {"frequency_std": 0.05, "mode_shape_std": 0.3}
"""Relative standard deviations beyond which nothing is measured any more, so that percent are suspected."""

ROUNDED, FEWEST_ROUNDED = 2.0, 4
"""Times the stated standard deviation that rounding alone makes, from which on it is worth a word; and so many numbers
that end at the same decimal place, which of numbers that were not rounded one set in ten thousand does."""


def gravity(experiment: Experiment) -> Iterator[Finding]:
    """Gravity is known."""
    value = experiment.frame.gravity
    if EARTH[0] <= value <= EARTH[1]:
        return
    unit = next((f" (that would be {unit})" for size, unit in OTHER_GRAVITIES if near(value, size)), "")
    said = f"gravity = {value:g} m/s² is not the Earth's{unit}"
    yield doubt("gravity", said, "write it in m/s², 9.81, or leave it out")


def heights(experiment: Experiment) -> Iterator[Finding]:
    """No story is as high as a tower."""
    found = experiment.frame.story_heights
    if found is None or found.max() <= HIGHEST_STORY:
        return
    said = f"story_heights of up to {found.max():g} m look like mm or cm"
    yield doubt("heights", said, "write story_heights in m")


def masses(experiment: Experiment) -> Iterator[Finding]:
    """Floors of a building weigh tons, those of a model that stands on a table do not."""
    frame = experiment.frame
    if frame.story_heights is None or frame.known_total is None:
        return
    height, floor = float(np.mean(frame.story_heights)), frame.known_total / experiment.stories
    if right_in_kg(experiment, floor) is not False:
        return
    unit = "g" if floor > HEAVIEST_MODEL_FLOOR else "t"
    weights = f"floors of {quantity(floor, 'kg', 3)} each under stories of {significant(height, 3)} m"
    yield doubt("masses", f"{weights} look like masses in {unit}", "write masses in kg")


def angular_frequency(experiment: Experiment) -> Iterator[Finding]:
    """Design values of masses and stiffnesses give the frequencies; else a tall building's height tells their order."""
    ratio = _over_nominal(experiment)
    lowest = next((each.frequencies[0] for each in experiment.configurations if each.modes[0] == 1), None)
    heights = experiment.frame.story_heights
    if ratio is not None:
        if not near(ratio, 2 * np.pi):
            return
        said = f"the frequencies are {ratio:.2f} times those of the nominal masses and stiffnesses, about 2 pi"
    elif lowest is not None and heights is not None and BUILDING_STORY <= heights.mean() <= HIGHEST_STORY:
        if lowest * heights.sum() <= HIGHEST_TIMES_FREQUENCY:
            return
        height = significant(heights.sum(), 3)
        said = f"a first frequency of {significant(lowest, 3)} Hz is high for a building of {height} m"
    else:
        return
    change = "write frequencies in Hz, the angular ones divided by 2 pi"
    yield doubt("angular_frequency", f"{said}: they look like rad/s", change)


def added_up(experiment: Experiment) -> Iterator[Finding]:
    """Story heights that grow by one story height from each to the next are the floors' elevations."""
    found = experiment.frame.story_heights
    if found is None or len(found) < 2:
        return
    # A ground story is often higher than those above, so the growth from floor to floor counts. Of two it is the first.
    growth = np.diff(found)
    usual = float(np.median(growth))
    highest = (1 + STEEP) if len(growth) == 1 else HIGHEST_GROUND
    even = usual > 0 and np.max(np.abs(growth / usual - 1)) < STEEP
    if even and (1 - STEEP) < found[0] / usual < highest:
        said = f"story_heights grow from {found[0]:g} to {found[-1]:g} m as elevations of floors do"
        yield doubt("elevations", said, "write the height of each story, not the sum of those below")


def slow(experiment: Experiment) -> Iterator[Finding]:
    """No structure swings once a minute."""
    lowest = min(float(each.frequencies[0]) for each in experiment.configurations)
    if lowest < SLOWEST:
        said = f"a first frequency of {significant(lowest, 3)} Hz is lower than that of any frame"
        unit = "it looks like time in milliseconds, or frequencies in kHz"
        yield doubt("time_unit", f"{said}: {unit}", "write frequencies in Hz, and times in s")


def deviations(experiment: Experiment) -> Iterator[Finding]:
    """Doubt standard deviations that no instrument has, of measurements and of soft statements."""
    for each in experiment.configurations:
        for key, largest in LARGEST_STD.items():
            value = getattr(each, key)
            if value is None:
                continue
            std = np.asarray(value, dtype=float)
            std = std[np.isfinite(std) & (std > 0)]
            if not std.size:
                continue
            if std.min() < BEST_LABORATORY_STD:
                yield _deviation(each.name, f"{key} = {std.min():.1g} is finer than any instrument measures")
            elif np.median(std) > largest:
                of = "frequencies" if key == "frequency_std" else "shapes"
                yield _deviation(
                    each.name,
                    f"the {of} have standard deviations of {100 * np.median(std):.3g} % ({key} = {np.median(std):.3g}) "
                    "and measure nothing: these are percent, or the record that they come from hardly shows its modes",
                )
    frame = experiment.frame
    stated = [("total_mass_std", frame.total_mass_std)]
    stated += [(f"std of the prior {prior.describe()}", getattr(prior, "std", None)) for prior in experiment.priors]
    for words, value in stated:
        if value is not None and float(value) < BEST_LABORATORY_STD:
            yield _deviation(None, f"{words} = {float(value):.1g} is finer than anything is known; exact without std")


def rounding(experiment: Experiment) -> Iterator[Finding]:
    """Numbers that were rounded are known no better than that."""
    for each in experiment.configurations:
        for key, values, std in (
            ("frequency_std", each.frequencies, each.frequencies * each.log_frequency_std),
            ("mode_shape_std", each.mode_shapes[each.measured], each.entry_std[each.measured]),
        ):
            step = next(
                (10.0**-digits for digits in range(4) if np.allclose(values, np.round(values, digits), 0, 1e-9)), 0
            )
            coarse = step / np.sqrt(12.0) > ROUNDED * np.median(std) if len(values) >= FEWEST_ROUNDED else False
            if getattr(each, key) is not None and coarse:
                what = "frequencies" if key == "frequency_std" else "shapes"
                said = f"the {what} are rounded to {step:g}, by which they err more than {key} says"
                yield _deviation(each.name, said, "write all digits, or the standard deviation of what is written")


def _deviation(
    configuration: str | None,
    said: str,
    change: str = "write relative standard deviations, 0.01 for 1 %, or leave them out",
) -> Finding:
    return doubt("deviations", said, change, configuration)


def _over_nominal(experiment: Experiment) -> float | None:
    """Divide the measured frequencies by those of the design values; None where these do not give any."""
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
        - np.log(modes_of(mass + each.added_mass, values["story_stiffness"]).frequencies[each.modes - 1])
        for each in experiment.configurations
    ]
    return float(np.exp(np.median(np.concatenate(logs))))


def near(value: float, size: float) -> bool:
    """Whether a value is a size in another unit, but for what measurements stray from a model."""
    return bool(abs(np.log(value / size)) < UNIT_FACTOR_WITHIN)


def right_in_kg(experiment: Experiment, floor: float) -> bool | None:
    """Whether a floor mass, kg, suits the story heights; None where these do not say."""
    heights = experiment.frame.story_heights
    if heights is None:
        return None
    height = float(np.mean(heights))
    if BUILDING_STORY <= height <= HIGHEST_STORY:
        return floor >= LIGHTEST_FLOOR
    return LIGHTEST_PLATE * height**2 <= floor <= HEAVIEST_MODEL_FLOOR if height <= MODEL_STORY else None


DECLARED_DOUBTS = (angular_frequency, heights, added_up, masses, gravity, slow, deviations, rounding)
"""What is looked for in a declaration by itself."""
