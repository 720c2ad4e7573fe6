"""What looks wrong, and declarations that do because something declared or measured besides speaks against them.

Nothing in the frequencies and shapes of one test alone says in which unit they are. What does is stated with each
function. Whether a declared total mass is right, the added masses say: they lower the frequencies the more, the lighter
the frame is, lambda = phi' K phi / phi' (M + A) phi. So configurations with different added mass have a total of their
own: that of the shear frame nearest to all of them together, its scale free.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from cvxshear.data.pairing import mac
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.measurement.reading import Reading, repeated_configurations
from cvxshear.screening.shear_fit import ROUGH_STEPS, TALLEST_FITTED, ShearFrames, modes_of, odd_starts
from cvxshear.util.quantities import quantity, significant
from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats, Json

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
"""Relative standard deviation below which nothing is measured: the best counters and interferometers of a laboratory
are no better."""

LARGEST_STD = {"frequency_std": 0.05, "mode_shape_std": 0.3}
"""Relative standard deviations beyond which nothing is measured any more, so that percent are suspected."""

FACTORS = ((2 * np.pi, "2 pi, as of rad/s"), (60.0, "60, as of cycles a minute"), (1000.0, "1000, as of mHz"))
"""Factors between units of frequency, with the unit that each would mean."""

ONE_FACTOR_STD = 0.1
"""Standard deviation of the logarithms of the modes' ratios below which they are one factor: what changes a frame
between two tests changes its modes differently."""

ALIKE, TOLD_APART = 0.9, 0.5
"""Modal assurance criteria of adjacent modes: measured ones that look alike above the first, where those of a frame of
equal floors and stories differ by the second. Of 15,000 sound random frames two have such modes."""

CONTRADICTION = 4.0
"""Standard deviations between the logarithms of the two totals from which on they contradict each other."""

LEAST_CONTRADICTION = 0.3
"""Difference of the logarithms of the two totals below which a contradiction is not worth a word."""

POOREST = 0.6
"""Standard deviation of the logarithm of a total from which on it says nothing."""

POOR = 4.0
"""Cost a datum of a fit to which frames with one soft story or heavy floor are tried as well, and above which no shear
frame is near enough to weigh."""

VAGUE = 0.05
"""Weight, in the uncertainty of an implied total, of the rows that keep floors and stories alike."""

LOAD_UNITS = (("t", 1e3), ("kN", 1e3 / 9.81), ("g", 1e-3), ("N", 1 / 9.81))
"""Units other than kg in which added masses are written, with the factor by which the total then seems too large."""

UNIT_OFF = 0.5
"""Difference of logarithms within which the ratio of two totals is taken for 1000 or its inverse, a unit."""


SHOWN_LOAD = 5.0
"""Standard deviations by which a load of the mean floors must have changed the frequencies to be missed in them."""

WORD = re.compile(r"[^\W\d_]{4,}")
"""Letters in which a slip is seen; a shorter word with another letter is mostly another word."""


@dataclass(frozen=True)
class Finding(InJson):
    """One thing that looks wrong, and what to change.

    Parameters
    ----------
    name : str
        The word that `[frame] accept = [...]` takes.
    configuration : str or None
        Where it was found; None where it concerns the whole file.
    found : str
        What is there, a sentence.
    change : str
        What to change, a sentence.
    refuses : bool
        Whether nothing is to be fitted before it is changed or accepted; else it is a warning.
    rivals : tuple of str, optional
        Names of other mistakes that `change` proposes as well; to accept one of them is to accept the finding.
    """

    name: str
    configuration: str | None
    found: str
    change: str
    refuses: bool
    rivals: tuple[str, ...] = ()

    @staticmethod
    def of_changes(
        configuration: str | None, changes: Sequence[tuple[str, str, str]], evidence: str, *, refuses: bool
    ) -> Finding:
        """Make a finding of changes of which one is needed: what each mends, what was found, and what to do."""
        names = list(dict.fromkeys(name for name, _, _ in changes))
        found = f"{' or '.join(found for _, found, _ in changes)}: {evidence}"
        change = f"{'One of: ' if len(changes) > 1 else ''}{'; or '.join(change for _, _, change in changes)}"
        return Finding(names[0], configuration, found, change, refuses, tuple(names[1:]))

    def accepted(self, names: Collection[str]) -> bool:
        """Whether it is among these names."""
        return any(name in names for name in (self.name, *self.rivals))

    @property
    def how_to_accept(self) -> str:
        """The line of the measurement file that lets it pass."""
        return f'[frame] accept = ["{self.name}"]'


def in_json(found: Iterable[Finding] | None) -> Json:
    """List what the findings add to a result's JSON; nothing where nobody looked for any."""
    return {} if found is None else {"warnings": [item.to_dict() for item in found]}


def _doubt(name: str, found: str, change: str, configuration: str | None = None) -> Finding:
    return Finding(name, configuration, found, change, refuses=False)


def gravity(experiment: Experiment) -> Iterator[Finding]:
    """Gravity is known."""
    value = experiment.frame.gravity
    if EARTH[0] <= value <= EARTH[1]:
        return
    unit = next((f" (that would be {unit})" for size, unit in OTHER_GRAVITIES if _near(value, size)), "")
    said = f"gravity = {value:g} m/s² is not the Earth's{unit}"
    yield _doubt("gravity", said, "write it in m/s², 9.81, or leave it out")


def heights(experiment: Experiment) -> Iterator[Finding]:
    """No story is as high as a tower."""
    found = experiment.frame.story_heights
    if found is None or found.max() <= HIGHEST_STORY:
        return
    said = f"story_heights of up to {found.max():g} m look like mm or cm"
    yield _doubt("heights", said, "write story_heights in m")


def masses(experiment: Experiment) -> Iterator[Finding]:
    """Floors of a building weigh tons, those of a model that stands on a table do not."""
    frame = experiment.frame
    if frame.story_heights is None or frame.known_total is None:
        return
    height, floor = float(np.mean(frame.story_heights)), frame.known_total / experiment.stories
    if _right_in_kg(experiment, floor) is not False:
        return
    unit = "g" if floor > HEAVIEST_MODEL_FLOOR else "t"
    weights = f"floors of {quantity(floor, 'kg', 3)} each under stories of {significant(height, 3)} m"
    yield _doubt("masses", f"{weights} look like masses in {unit}", "write masses in kg")


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
    change = "write frequencies in Hz, the angular ones divided by 2 pi"
    yield _doubt("angular_frequency", f"{said}: they look like rad/s", change)


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
        yield _doubt("elevations", said, "write the height of each story, not the sum of those below")


def slow(experiment: Experiment) -> Iterator[Finding]:
    """No structure swings once a minute."""
    lowest = min(float(each.frequencies[0]) for each in experiment.configurations)
    if lowest < SLOWEST:
        said = f"a first frequency of {significant(lowest, 3)} Hz is lower than that of any frame"
        unit = "it looks like time in milliseconds, or frequencies in kHz"
        yield _doubt("time_unit", f"{said}: {unit}", "write frequencies in Hz, and times in s")


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


def _deviation(configuration: str | None, said: str) -> Finding:
    change = "write relative standard deviations, 0.01 for 1 %, or leave them out"
    return _doubt("deviations", said, change, configuration)


def repeats(experiment: Experiment) -> Iterator[Finding]:
    """Two tests never agree to the last digit."""
    change = "leave all but one of them out: a copy is no further test"
    copies = repeated_configurations(experiment)
    for names in copies:
        said = f"configurations {_listed(names)} repeat each other to the last digit"
        yield _doubt("repeated", said, change, names[1])
    for names in repeated_configurations(experiment, loads=False):
        tests = [each for each in experiment.configurations if each.name in names]
        if any(set(names) <= set(group) for group in copies) or not _shows_load(experiment, tests):
            continue
        said = f"configurations {_listed(names)} have other added mass, and the same modes to the last digit"
        yield _doubt("repeated", said, "write what each of them measured: a load changes the frequencies", names[1])


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def _shows_load(experiment: Experiment, tests: Sequence[Configuration]) -> bool:
    """Whether the loads of tests with equal modes differ by as much as their frequencies must have shown.

    Entries of shapes never agree. Frequencies alone can, read off lines of a spectrum, under a load that is light.
    """
    if any(each.measured.any() for each in tests):
        return True
    total = experiment.frame.known_total
    lightest, heaviest = (pick(float(each.added_mass.sum()) for each in tests) for pick in (min, max))
    std = max(float(np.max(each.log_frequency_std)) for each in tests)
    return total is not None and (heaviest - lightest) / (2 * total) > SHOWN_LOAD * std


def state_names(experiment: Experiment) -> Iterator[Finding]:
    """Doubt that two states whose names differ by one letter of a word are two."""
    declared = {each.state for each in experiment.tested if each.state != each.name}
    for first, second in combinations(experiment.states, 2):
        if declared & {first, second} and (_one_slip(first, second) or _one_slip(second, first)):
            said = f"states {_listed((first, second))} differ by one letter and count as two"
            yield _doubt("states", said, "write the same state where it is one, and names that differ by more if not")


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


def look_alike(experiment: Experiment) -> Iterator[Finding]:
    """Adjacent sway modes differ at the sensors, if there are as many as modes.

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
            if mac(*measured[:, there]) > ALIKE and mac(*others[:, there]) < TOLD_APART:
                said = f"modes {mode} and {following} look alike at all {there.sum()} sensors"
                change = "leave out what is no sway mode (torsion, another direction, found twice), number the others"
                yield _doubt("look_alike", said, change, each.name)
                break


def frequency_units(experiment: Experiment) -> Iterator[Finding]:
    """One configuration's frequencies are all off from those of the others by a factor between units.

    The same modes of other configurations are compared with, the median where there are several.
    """
    tests = experiment.configurations
    off = [_off_by(each, [other for other in tests if other is not each]) for each in tests]
    wrong = [(each, said) for each, said in zip(tests, off, strict=True) if said]
    for each, (ratio, words) in wrong:
        # Of two that differ either can be wrong.
        either = " (or those of the other are smaller by it)" if len(tests) == 2 else ""
        yield Finding(
            "frequency_unit", each.name,
            f"all frequencies are {significant(ratio, 3)} times those of other configurations, about {words}{either}",
            "write frequencies in Hz", refuses=True,
        )  # fmt: skip
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
    if not ratios.size or ratios.std() > ONE_FACTOR_STD:
        return None
    ratio = float(np.exp(ratios.mean()))
    for factor, words in FACTORS:
        if _near(ratio, factor):
            return ratio, words
        if len(others) > 1 and _near(ratio, 1 / factor):
            return ratio, f"1/{words}"
    return None


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


def _near(value: float, size: float) -> bool:
    return bool(abs(np.log(value / size)) < UNIT_FACTOR_WITHIN)


def total_mass(experiment: Experiment) -> Iterator[Finding]:
    """Compare the declared total with that of the configurations."""
    if experiment.frame.total_mass_placeholder:
        said = f"total_mass = {experiment.frame.total_mass:g} stands for one that nobody gave: masses and stiffnesses "
        change = "write total_mass in kg, and take total_mass_placeholder out"
        yield _doubt("total_mass", f"{said}are relative to it", change)
        return
    declared = experiment.frame.known_total
    different = {tuple(each.added_mass) for each in experiment.configurations}
    if declared is None or len(different) < 2 or experiment.stories > TALLEST_FITTED:
        return
    total, std = implied_total(experiment)
    off = float(np.log(declared / total))
    if std > POOREST or abs(off) < max(LEAST_CONTRADICTION, CONTRADICTION * std):
        return
    said = (
        f"the added masses changed the frequencies as they would those of a frame of {quantity(total, 'kg', 3)} "
        f"(give or take {100 * std:.0f} %), and {quantity(declared, 'kg', 6)} are declared"
    )
    heavy = _right_in_kg(experiment, declared / experiment.stories)
    load = next((unit for unit, factor in LOAD_UNITS if abs(off - np.log(factor)) < UNIT_OFF), None)
    unit = next((unit for unit, factor in (("g", 1e3), ("t", 1e-3)) if abs(off - np.log(factor)) < UNIT_OFF), None)
    if load is not None and (heavy or unit is None):
        weight = "floors of that weight suit the story heights, so " if heavy else ""
        yield _doubt("added_mass", f"{said}: {weight}added_mass looks like {load}", "write added_mass in kg")
        return
    if unit is not None:
        either = "" if load is None or heavy is False else f", or added_mass like {load}"
        yield _doubt(
            "masses", f"{said}: total_mass (or floor_masses) looks like {unit}{either}", "write all masses in kg"
        )
        return
    change = "check total_mass (or floor_masses, without the added mass) and each added_mass"
    yield _doubt("total_mass", said, change)


def _right_in_kg(experiment: Experiment, floor: float) -> bool | None:
    """Whether a floor mass, kg, suits the story heights; None where these do not say."""
    heights = experiment.frame.story_heights
    if heights is None:
        return None
    height = float(np.mean(heights))
    if BUILDING_STORY <= height <= HIGHEST_STORY:
        return floor >= LIGHTEST_FLOOR
    return LIGHTEST_PLATE * height**2 <= floor <= HEAVIEST_MODEL_FLOOR if height <= MODEL_STORY else None


def implied_total(experiment: Experiment) -> tuple[float, float]:
    """Estimate the total mass without added mass, kg, from the configurations, and the std of its logarithm.

    The std is infinite where no shear frame is near all configurations.

    Parameters
    ----------
    experiment : Experiment
        Of two configurations at least with different added mass.
    """
    N = experiment.stories
    readings = [Reading.of(each) for each in experiment.configurations]
    added = [each.added_mass for each in experiment.configurations]
    problem = ShearFrames(list(zip(readings, added, strict=True)), centred=True)
    # Floors as heavy as the added mass.
    begin = np.repeat([np.log(max(float(mass.sum()) for mass in added) / N), 0.0], N)
    found = problem.nearest(problem.tuned(begin))
    count = sum(reading.count for reading in readings)
    if found.cost > POOR * count:
        others = (problem.nearest(problem.tuned(begin + start), ROUGH_STEPS) for start in odd_starts(N))
        found = problem.nearest(min((found, *others), key=lambda item: item.cost).theta)
    share = np.exp(found.theta[:N])
    if found.at is None or found.cost > POOR * count:
        return float(share.sum()), np.inf
    # What floors usually weigh decides no contradiction: it counts for little here, the added masses for all.
    J = found.at.J.copy()
    J[-2 * N :] *= VAGUE
    covariance = np.linalg.pinv(J.T @ J)
    by_masses = share / share.sum()
    scatter = max(1.0, found.cost / max(len(found.at.r) - 2 * N, 1))
    return float(share.sum()), float(np.sqrt(scatter * by_masses @ covariance[:N, :N] @ by_masses))


DOUBT_CHECKS = (
    angular_frequency, heights, added_up, masses, gravity, slow, deviations, repeats, state_names
)  # fmt: skip
"""What is looked for in the declaration, whatever the shapes are like."""
