"""Doubts about a declaration, by what else is declared or measured: units, sums, roundings, copies, total masses.

The frequencies and shapes of one test alone do not determine their units. Each function states its evidence.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
from scipy.optimize import minimize_scalar

from cvxshear.data.kinds import mac
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.measurement.reading import CERTAIN, NUMBERS_OF_A_COPY, MeasuredModes, repeated_configurations
from cvxshear.screening.finding import FileFinding, doubt, in_words
from cvxshear.screening.nearest_frame import (
    MISTAKEN,
    PLAUSIBLE,
    RANKED,
    TALLEST_FITTED,
    NearestFrame,
    ShearFrames,
    loads_of,
    modes_of,
    odd_starts,
    usual_width,
)  # fmt: skip
from cvxshear.util.odds import weigh
from cvxshear.util.quantities import SURE, quantity, significant
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

UNIT_WITHIN = 0.15
"""Difference of logarithms within which a ratio is one of units, and steps are even: a model strays less from what is
measured."""

HIGHEST_GROUND = 2.0
"""Largest ratio of the ground story's height to the stories above, for heights that look added up."""

SLOWEST = 0.02
"""Lowest first frequency (Hz): the tallest towers begin at some 0.1 Hz, and long bridges at 0.05 Hz."""

BEST_LABORATORY_STD = 1e-6
"""Least relative standard deviation of a measurement: the accuracy of the best counters and interferometers."""

LARGEST_STD = {"frequency_std": 0.05, "mode_shape_std": 0.3}
"""Largest relative standard deviations of measurements; larger ones may be in percent."""

FACTORS = ((2 * np.pi, "2 pi, as of rad/s"), (60.0, "60, as of cycles a minute"), (1000.0, "1000, as of mHz"))
"""Factors between units of frequency, with the unit that each would mean."""

SAME_SHAPE_MAC, TOLD_APART = 0.9, 0.5
"""Modal assurance criteria of adjacent modes: measured shapes are alike above the first, and shapes of a frame with
equal floors and stories differ below the second. Of 15,000 sound random frames two have such modes."""

WORD = re.compile(r"[^\W\d_]{4,}")
"""Letters in which a slip is seen; a shorter word with another letter is mostly another word."""

LOAD_UNITS = (("t", 1e3), ("kN", 1e3 / 9.81), ("g", 1e-3), ("N", 1 / 9.81))
"""Other units of added masses than kg, with the factor that the total then seems too large by."""

TOTAL_STD = 0.05
"""Standard deviation of the logarithm of a total mass that sound tests imply about the true one."""

LARGEST_SLIP = float(np.log(30.0))
"""Logarithm of the error factor of a wrong total or load: a shifted decimal point, and some more."""

UNIT_OFF = 0.5
"""Difference of logarithms within which the ratio of two totals is one of units."""


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
    highest = (1 + UNIT_WITHIN) if len(growth) == 1 else HIGHEST_GROUND
    even = usual > 0 and np.max(np.abs(growth / usual - 1)) < UNIT_WITHIN
    if even and (1 - UNIT_WITHIN) < found[0] / usual < highest:
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
            coarse = step / np.sqrt(12.0) > np.median(std) if len(values) > NUMBERS_OF_A_COPY else False
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
    return bool(abs(np.log(value / size)) < UNIT_WITHIN)


def right_in_kg(experiment: Experiment, floor: float) -> bool | None:
    """Whether a floor mass, kg, suits the story heights; None where these do not say."""
    heights = experiment.frame.story_heights
    if heights is None:
        return None
    height = float(np.mean(heights))
    if BUILDING_STORY <= height <= HIGHEST_STORY:
        return floor >= LIGHTEST_FLOOR
    return LIGHTEST_PLATE * height**2 <= floor <= HEAVIEST_MODEL_FLOOR if height <= MODEL_STORY else None


def repeats(experiment: Experiment) -> Iterator[FileFinding]:
    """Two tests never agree to the last digit."""
    copies = repeated_configurations(experiment)
    for names in copies:
        yield doubt("repeated/copy", names[1], names=_listed(names))
    alike: dict[tuple[bytes, bytes], list[Configuration]] = {}
    for each in experiment.configurations:
        alike.setdefault((each.modes.tobytes(), each.frequencies.tobytes()), []).append(each)
    for tests in alike.values():
        names = tuple(each.name for each in tests)
        if any(set(names) <= set(group) for group in copies) or not _shows_load(experiment, tests):
            continue
        what = "modes" if _same_shapes(tests) else "frequencies"
        yield doubt("repeated/load", names[1], names=_listed(names), what=what)


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def _shows_load(experiment: Experiment, tests: Sequence[Configuration]) -> bool:
    """Return whether tests with equal frequencies have loads that must have changed the frequencies.

    Entries of shapes never agree. Frequencies alone can, read off lines of a spectrum, under a load that is light.
    """
    copied = int(tests[0].measured.sum()) if _same_shapes(tests) else 0
    if len(tests) < 2 or len(tests[0].frequencies) + copied < NUMBERS_OF_A_COPY:
        return False
    if copied:
        return True
    total = experiment.frame.known_total
    lightest, heaviest = (pick(float(each.added_mass.sum()) for each in tests) for pick in (min, max))
    std = max(float(np.max(each.log_frequency_std)) for each in tests)
    return total is not None and (heaviest - lightest) / (2 * total) > CERTAIN * std


def _same_shapes(tests: Sequence[Configuration]) -> bool:
    """Whether all tests have the same shapes at the same floors, to the last digit."""
    first = tests[0]
    return all(
        np.array_equal(each.measured_floors, first.measured_floors)
        and np.array_equal(each.mode_shapes, first.mode_shapes, equal_nan=True)
        for each in tests
    )


def state_names(experiment: Experiment) -> Iterator[FileFinding]:
    """Doubt that two states whose names differ by one letter of a word are two."""
    declared = {each.state for each in experiment.tested if each.state != each.name}
    for first, second in combinations(experiment.states, 2):
        if declared & {first, second} and (_one_slip(first, second) or _one_slip(second, first)):
            yield doubt("states", names=_listed((first, second)))


def _one_slip(name: str, other: str) -> bool:
    """Whether a name is another with one letter of a word too many, wrong, or exchanged with the next one.

    Numbers, short words and letters at the end are how states are counted (1 and 2, NE and N, case a and case b).
    """
    if name.casefold().split() == other.casefold().split():
        return True
    for word in WORD.finditer(name):
        for at in range(*word.span()):
            head, letter, tail = name[:at], name[at], name[at + 1 :]
            exchanged = at + 1 < word.end() and head + tail[0] + letter + tail[1:] == other
            inside = word.start() < at < word.end() - 1
            wrong = inside and other[at : at + 1].islower() and head + other[at] + tail == other
            if letter.islower() and (head + tail == other or exchanged or wrong):
                return True
    return False


def look_alike(experiment: Experiment) -> Iterator[FileFinding]:
    """Adjacent sway modes differ at the sensors, if there is a sensor for each mode.

    Two that do not are one motion with another beside it: torsion seen by sensors off the centre, another direction, a
    mode of something on the frame, or a mode found twice.
    """
    even = modes_of(np.ones(experiment.stories), np.ones(experiment.stories)).shapes
    for each in experiment.configurations:
        at = each.measured_floors - 1
        for row, (mode, following) in enumerate(pairwise(each.modes.tolist())):
            measured, others = each.mode_shapes[row : row + 2], even[[mode - 1, following - 1]][:, at]
            there = np.isfinite(measured).all(axis=0)
            if following != mode + 1 or there.sum() < max(3, following):
                continue
            if mac(*measured[:, there]) > SAME_SHAPE_MAC and mac(*others[:, there]) < TOLD_APART:
                yield doubt("look_alike", each.name, mode=mode, following=following, sensors=there.sum())
                break


def frequency_units(experiment: Experiment) -> Iterator[FileFinding]:
    """All frequencies of one configuration differ from the other configurations by a factor between units.

    The same modes of other configurations are compared with, the median where there are several.
    """
    tests = experiment.configurations
    off = [_off_by(each, [other for other in tests if other is not each]) for each in tests]
    wrong = [(each, said) for each, said in zip(tests, off, strict=True) if said]
    for each, (ratio, words) in wrong:
        # Of two that differ either can be wrong.
        either = " (or those of the other are smaller by it)" if len(tests) == 2 else ""
        name, found, change = in_words("frequency_unit", ratio=significant(ratio, 3), words=words, either=either)
        yield FileFinding(name, each.name, found, change, refuses=True)
        if len(tests) == 2:
            return


def _off_by(configuration: Configuration, others: Sequence[Configuration]) -> tuple[float, str] | None:
    """Find the factor on a configuration's frequencies, where all modes that others have say the same; its words."""
    known: dict[int, list[float]] = {}
    for other in others:
        for mode, frequency in zip(other.modes.tolist(), np.log(other.frequencies).tolist(), strict=True):
            known.setdefault(mode, []).append(frequency)
    ratios = np.array([
        np.log(frequency) - np.median(known[mode])
        for mode, frequency in zip(configuration.modes.tolist(), configuration.frequencies, strict=True)
        if mode in known
    ])  # fmt: skip
    if not ratios.size or np.max(np.abs(ratios - ratios.mean())) > UNIT_WITHIN:
        return None
    ratio = float(np.exp(ratios.mean()))
    for factor, words in FACTORS:
        if near(ratio, factor):
            return ratio, words
        if len(others) > 1 and near(ratio, 1 / factor):
            return ratio, f"1/{words}"
    return None


def total_mass(experiment: Experiment) -> Iterator[FileFinding]:
    """Compare the declared total with the configurations' own total.

    Added masses lower the frequencies the more, the lighter the frame is, lambda = phi' K phi / phi' (M + A) phi. So
    configurations with different added mass determine a total of their own, by the nearest shear frame with a free
    scale.
    """
    if experiment.frame.total_mass_placeholder:
        yield doubt("total_mass/placeholder", total=experiment.frame.total_mass)
        return
    declared = experiment.frame.known_total
    different = {tuple(each.added_mass) for each in experiment.configurations}
    if declared is None or len(different) < 2 or experiment.stories > TALLEST_FITTED:
        return
    added = [each.added_mass for each in experiment.configurations]
    frame = _nearest_to_all(experiment, added)
    total, std = _implied_total(frame, sum(MeasuredModes.of(each).count for each in experiment.configurations))
    if not np.isfinite(std):
        return
    off = float(np.log(declared / total))
    spread = np.hypot(std, [TOTAL_STD, LARGEST_SLIP])
    if weigh(-0.5 * (off / spread) ** 2 - np.log(spread), [0.0, np.log(MISTAKEN)])[0] > 1 - SURE:
        return
    sizes = {"implied": quantity(total, "kg", 3), "percent": 100 * std, "declared": quantity(declared, "kg", 6)}
    heavy = right_in_kg(experiment, declared / experiment.stories)
    load = next((unit for unit, factor in LOAD_UNITS if abs(off - np.log(factor)) < UNIT_OFF), None)
    unit = next((unit for unit, factor in (("g", 1e3), ("t", 1e-3)) if abs(off - np.log(factor)) < UNIT_OFF), None)
    loads = list(_other_loads(experiment, added, declared, frame))
    if loads:
        unit_too = "" if load is None else f", or with all of them in {load}"
        found = doubt("added_mass/size", **sizes, loads=" or ".join(loads), either=unit_too)
        yield replace(found, rivals=("total_mass",))
    elif load is not None and (heavy or unit is None):
        weight = "floors of that weight suit the story heights, so " if heavy else ""
        yield doubt("added_mass", **sizes, weight=weight, load=load)
    elif unit is not None:
        either = "" if load is None or heavy is False else f", or added_mass like {load}"
        yield doubt("masses/total", **sizes, unit=unit, either=either)
    else:
        yield doubt("total_mass", **sizes)


def _other_loads(
    experiment: Experiment, added: Sequence[Floats], declared: float, given: NearestFrame
) -> Iterator[str]:
    """Find single loads with which, of another size, the declared total fits as well as another total does."""
    sign = np.sign(np.log(declared) - _log_total(given))
    for test, floor in loads_of(added):

        def cost(slip: float, test: int = test, floor: int = floor) -> float:
            factor = np.where(np.arange(experiment.stories) == floor, np.exp(sign * slip), 1.0)
            frame = _nearest_to_all(experiment, [*added[:test], factor * added[test], *added[test + 1 :]])
            return frame.misfit + float(((_log_total(frame) - np.log(declared)) / TOTAL_STD) ** 2)

        best = minimize_scalar(cost, bounds=(0.0, LARGEST_SLIP), method="bounded", options={"xatol": TOTAL_STD})
        if weigh([-0.5 * given.misfit, -0.5 * best.fun])[1] > 1 - SURE:
            said = float(added[test][floor])
            now = quantity(said * float(np.exp(sign * best.x)), "kg", 2)
            name = experiment.configurations[test].name
            yield f'{now} in place of {quantity(said, "kg", 3)} on floor {floor + 1} of "{name}"'


def _log_total(frame: NearestFrame) -> float:
    """Return the logarithm of a frame's mass, kg."""
    return float(np.log(np.sum(np.exp(np.split(frame.theta, 2)[0]))))


def _nearest_to_all(experiment: Experiment, added: Sequence[Floats]) -> NearestFrame:
    """Fit a frame of any scale to all tests, with these added masses, kg."""
    N = experiment.stories
    readings = [MeasuredModes.of(each) for each in experiment.configurations]
    # Floors as heavy as the added mass.
    begin = np.repeat([np.log(max(float(mass.sum()) for mass in added) / N), 0.0], N)
    frames = ShearFrames(readings, added, begin, usual_width(N), centred=True)
    found = frames.nearest([begin])
    if found.misfit > PLAUSIBLE * frames.count:
        others = frames.nearest([begin + start for start in odd_starts(N)], RANKED)
        found = frames.nearest([found.theta, others.theta])
    return found


def _implied_total(found: NearestFrame, count: int) -> tuple[float, float]:
    """Return the total mass of a frame without added mass, kg, and the standard deviation of its logarithm.

    The deviation is infinite if the frame is not near to the data.
    """
    masses = np.exp(np.split(found.theta, 2)[0])
    share = masses / masses.sum()
    if found.at is None or found.misfit > PLAUSIBLE * count:
        return float(masses.sum()), np.inf
    scatter = max(1.0, found.misfit / max(len(found.at.r) - len(found.theta), 1))
    own = found.covariance[: len(share), : len(share)]
    return float(masses.sum()), float(np.sqrt(scatter * share @ own @ share))


DECLARED_DOUBTS = (
    angular_frequency,
    heights,
    added_up,
    masses,
    gravity,
    slow,
    deviations,
    rounding,
    repeats,
    state_names,
)
"""Checks of the declaration, independent of the shapes."""
