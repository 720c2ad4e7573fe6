"""Declarations that look wrong by what else is declared or measured: units, elevations for heights, percent, rounding.

The frequencies and shapes of one test alone do not determine their units. Each function states its evidence.
"""

from collections.abc import Iterator

import numpy as np

from cvxshear.measurement.experiment import Experiment
from cvxshear.screening.finding import FileFinding, doubt
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
"""Least story height (m) of a building: the height of a person."""

MODEL_STORY = 0.6
"""Largest story height (m) of a laboratory model."""

LIGHTEST_FLOOR = 300.0
"""Least mass (kg) of a building's floor: one square metre of a concrete slab."""

HEAVIEST_MODEL_FLOOR = 3000.0
"""Mass (kg) that no floor of a laboratory's model reaches: it would need a crane of its own."""

LIGHTEST_PLATE = 1.0
"""Mass (kg/m²) of a model's floor that is as wide as its story is high: a plate of aluminium of 0.4 mm."""

HIGHEST_TIMES_FREQUENCY = 130.0
"""Largest product (m Hz) of a building's height and first frequency. The mean is 46 (Ellis 1980), within a factor of
two or so, and with walls nearly three; rad/s would make the mean 290."""

UNIT_FACTOR_WITHIN = 0.15
"""Difference of logarithms within which a ratio is taken for a factor between units."""

STEEP = 0.15
"""Story heights look added up if their growth is even to this relative deviation."""

HIGHEST_GROUND = 2.0
"""Largest ratio of the ground story's height to the stories above, for heights that look added up."""

SLOWEST = 0.02
"""Lowest first frequency (Hz): the tallest towers begin at some 0.1 Hz, and long bridges at 0.05 Hz."""

BEST_LABORATORY_STD = 1e-6
"""Least relative standard deviation of a measurement: the accuracy of the best counters and interferometers."""

LARGEST_STD = {"frequency_std": 0.05, "mode_shape_std": 0.3}
"""Largest relative standard deviations of measurements; larger ones may be in percent."""

COARSE_STEP, FEWEST_ROUNDED = 2.0, 4
"""Times the stated standard deviation that rounding alone makes, from which on it is worth a word; and so many numbers
that end at the same decimal place, which of numbers that were not rounded one set in ten thousand does."""


def gravity(experiment: Experiment) -> Iterator[FileFinding]:
    """Gravity is known."""
    value = experiment.frame.gravity
    if EARTH[0] <= value <= EARTH[1]:
        return
    unit = next((f" (that would be {unit})" for size, unit in OTHER_GRAVITIES if near(value, size)), "")
    yield doubt("gravity", value=value, unit=unit)


def heights(experiment: Experiment) -> Iterator[FileFinding]:
    """No story is as high as a tower."""
    found = experiment.frame.story_heights
    if found is not None and found.max() > HIGHEST_STORY:
        yield doubt("heights", highest=found.max())


def masses(experiment: Experiment) -> Iterator[FileFinding]:
    """Floors of a building weigh tons; floors of a table-top model do not."""
    frame = experiment.frame
    if frame.story_heights is None or frame.known_total is None or frame.total_mass_placeholder:
        return
    height, floor = float(np.mean(frame.story_heights)), frame.known_total / experiment.stories
    if right_in_kg(experiment, floor) is False:
        unit = "g" if floor > HEAVIEST_MODEL_FLOOR else "t"
        yield doubt("masses", floor=quantity(floor, "kg", 3), height=significant(height, 3), unit=unit)


def angular_frequency(experiment: Experiment) -> Iterator[FileFinding]:
    """Design values of masses and stiffnesses give the frequencies; else a tall building's height tells their order."""
    ratio = _over_nominal(experiment)
    lowest = next((each.frequencies[0] for each in experiment.configurations if each.modes[0] == 1), None)
    heights = experiment.frame.story_heights
    if ratio is not None:
        if near(ratio, 2 * np.pi):
            yield doubt("angular_frequency/nominal", ratio=ratio)
    elif lowest is not None and heights is not None and BUILDING_STORY <= heights.mean() <= HIGHEST_STORY:
        height = float(heights.sum())
        if lowest * height > HIGHEST_TIMES_FREQUENCY:
            sizes = {"lowest": significant(lowest, 3), "height": significant(height, 3)}
            yield doubt("angular_frequency/height", **sizes)


def added_up(experiment: Experiment) -> Iterator[FileFinding]:
    """Story heights that grow by one story height from each to the next are the floors' elevations."""
    found = experiment.frame.story_heights
    if found is None or len(found) < 2:
        return
    # A ground story is often higher than the others, so compare the growth from floor to floor; with two stories, the
    # first height.
    growth = np.diff(found)
    usual = float(np.median(growth))
    highest = (1 + STEEP) if len(growth) == 1 else HIGHEST_GROUND
    even = usual > 0 and np.max(np.abs(growth / usual - 1)) < STEEP
    if even and (1 - STEEP) < found[0] / usual < highest:
        yield doubt("elevations", first=found[0], last=found[-1])


def slow(experiment: Experiment) -> Iterator[FileFinding]:
    """No structure swings once a minute."""
    lowest = min(float(each.frequencies[0]) for each in experiment.configurations)
    if lowest < SLOWEST:
        yield doubt("time_unit", lowest=significant(lowest, 3))


def deviations(experiment: Experiment) -> Iterator[FileFinding]:
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
                yield doubt("deviations/fine", each.name, key=key, std=std.min())
            elif (middle := np.median(std)) > largest:
                of = "frequencies" if key == "frequency_std" else "shapes"
                yield doubt("deviations/coarse", each.name, of=of, key=key, std=middle, percent=100 * middle)
    frame = experiment.frame
    stated = [("total_mass_std", frame.total_mass_std)]
    stated += [(f"std of the prior {prior.describe()}", getattr(prior, "std", None)) for prior in experiment.priors]
    for words, value in stated:
        if value is not None and float(value) < BEST_LABORATORY_STD:
            yield doubt("deviations/stated", words=words, std=float(value))


def rounding(experiment: Experiment) -> Iterator[FileFinding]:
    """Numbers that were rounded are known no better than that."""
    for each in experiment.configurations:
        for key, values, std in (
            ("frequency_std", each.frequencies, each.frequencies * each.log_frequency_std),
            ("mode_shape_std", each.mode_shapes[each.measured], each.entry_std[each.measured]),
        ):
            step = next(
                (10.0**-digits for digits in range(4) if np.allclose(values, np.round(values, digits), 0, 1e-9)), 0
            )
            coarse = step / np.sqrt(12.0) > COARSE_STEP * np.median(std) if len(values) >= FEWEST_ROUNDED else False
            if getattr(each, key) is not None and coarse:
                of = "frequencies" if key == "frequency_std" else "shapes"
                yield doubt("deviations/rounded", each.name, of=of, step=step, key=key)


def _over_nominal(experiment: Experiment) -> float | None:
    """Divide the measured frequencies by the frequencies of the design values; None without complete design values."""
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
"""Checks of a declaration alone."""
