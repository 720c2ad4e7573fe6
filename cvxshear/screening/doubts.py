"""Findings of the screening, and doubts about a declaration by what else is declared or measured.

The frequencies and shapes of one test alone do not determine their units. Each function states its evidence.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise

import numpy as np

from cvxshear.data.kinds import mac
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.measurement.reading import MeasuredModes, repeated_configurations
from cvxshear.screening import nearest_frame
from cvxshear.screening.nearest_frame import NearestFrame, ShearFrames
from cvxshear.util import quantities, ranking, results
from cvxshear.util.typing import Json

#: Range (m/s2) of the Earth's gravity: 9.78 to 9.83 between the equator and the poles, and often rounded.
EARTH = (9.7, 10.0)

#: Story height (m) that no building exceeds: lobbies and plant floors of towers have up to 20 m.
HIGHEST_STORY = 25.0

#: Least story height (m) of a building: the height of a person.
BUILDING_STORY = 2.3

#: Least mass (kg) of a building's floor: one square metre of a concrete slab.
LIGHTEST_FLOOR = 300.0

#: Largest product (m Hz) of a building's height and first frequency. The mean is 46 (Ellis 1980), within a factor of
#: two or so, and with walls nearly three; rad/s would make the mean 290.
HIGHEST_TIMES_FREQUENCY = 130.0

#: Difference of logarithms within which a ratio of frequencies is one of units: a model strays less from what is
#: measured.
UNIT_WITHIN = 0.15

#: Largest relative standard deviations of measurements; larger ones may be in percent.
LARGEST_STD = {"frequency_std": 0.05, "mode_shape_std": 0.3}

#: Factors between units of frequency, with the unit that each would mean.
FACTORS = ((2 * np.pi, "2 pi, as of rad/s"), (60.0, "60, as of cycles a minute"), (1000.0, "1000, as of mHz"))

#: Modal assurance criteria of adjacent modes: measured shapes are alike above the first, and shapes of a frame with
#: equal floors and stories differ below the second. Of 15,000 sound random frames two have such modes.
SAME_SHAPE_MAC, TOLD_APART = 0.9, 0.5

MASS_UNITS = (("g", 1e3), ("t", 1e-3))
#: Other units of the total mass and of added masses than kg, with the factor that the total then seems too large by.
LOAD_UNITS = (("t", 1e3), ("kN", 1e3 / 9.81), ("g", 1e-3), ("N", 1 / 9.81))

#: Standard deviation of the logarithm of a total mass that sound tests imply about the true one.
TOTAL_STD = 0.05

#: Standard deviation of the logarithm of the error factor of a wrong total or load: a shifted decimal point or more.
LARGEST_SLIP = float(np.log(30.0))


@dataclass(frozen=True)
class FileFinding(results.InJson):
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
        Whether the file is refused until the mistake is changed or accepted; otherwise a warning.
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
    ) -> FileFinding:
        """Make a finding with alternative changes: the mistakes, the evidence and the changes."""
        names = list(dict.fromkeys(name for name, _, _ in changes))
        found = f"{' or '.join(found for _, found, _ in changes)}: {evidence}"
        change = f"{'One of: ' if len(changes) > 1 else ''}{'; or '.join(change for _, _, change in changes)}"
        return FileFinding(names[0], configuration, found, change, refuses, tuple(names[1:]))

    def accepted(self, names: Collection[str]) -> bool:
        """Whether it is among these names."""
        return any(name in names for name in (self.name, *self.rivals))

    @property
    def how_to_accept(self) -> str:
        """The line of the measurement file that lets it pass."""
        return f'[frame] accept = ["{self.name}"]'


def in_json(found: Iterable[FileFinding] | None) -> Json:
    """List the findings for a result's JSON; empty without screening."""
    return {} if found is None else {"warnings": [item.to_dict() for item in found]}


#: Sentence of each finding, and the proposed change; a key with a slash is one case of a finding.
WORDS_OF_FINDINGS: dict[str, dict[str, str]] = tomllib.loads(
    resources.files("cvxshear.screening").joinpath("words.toml").read_text(encoding="utf-8")
)


def in_words(key: str, /, **gaps: object) -> tuple[str, str, str]:
    """Name a finding, and say what it is and what to change, the gaps filled."""
    words = WORDS_OF_FINDINGS[key]
    return key.partition("/")[0], words["found"].format(**gaps), words["change"].format(**gaps)


def doubt(key: str, configuration: str | None = None, /, **gaps: object) -> FileFinding:
    """Make a finding that warns, in the words of its key."""
    name, found, change = in_words(key, **gaps)
    return FileFinding(name, configuration, found, change, refuses=False)


def frame_values(experiment: Experiment) -> Iterator[FileFinding]:
    """Doubt gravity unlike the Earth's, stories as high as towers, and floors of a building lighter than a slab."""
    frame, heights = experiment.frame, experiment.frame.story_heights
    if not EARTH[0] <= frame.gravity <= EARTH[1]:
        yield doubt("gravity", value=frame.gravity)
    if heights is None:
        return
    if heights.max() > HIGHEST_STORY:
        yield doubt("heights", highest=heights.max())
    if frame.known_total is not None and not frame.total_mass_placeholder:
        height, floor = float(np.mean(heights)), frame.known_total / experiment.stories
        if BUILDING_STORY <= height <= HIGHEST_STORY and floor < LIGHTEST_FLOOR:
            yield doubt("masses", floor=quantities.quantity(floor, "kg", 3), height=quantities.significant(height, 3))


def outside_the_plan(experiment: Experiment) -> list[FileFinding]:
    """Doubt the first sensor of each test that stands outside the declared plan: another unit or another origin."""
    found = []
    for test in experiment.configurations if experiment.frame.plan is not None else ():
        for number, sensor in enumerate(test.sensors, 1):
            half = experiment.half_plan[sensor.floor - 1]
            if np.any(np.abs(sensor.position) > half * (1.0 + ranking.SAME_NUMBER)):
                (x, y), (a, b) = sensor.position, 2.0 * half
                found.append(doubt("outside_plan", test.name, sensor=number, x=x, y=y, floor=sensor.floor, a=a, b=b))
                break
    return found


def angular_frequency(experiment: Experiment) -> Iterator[FileFinding]:
    """Doubt a first frequency that is too high for the building's height."""
    first = next((each.frequencies[0] for each in experiment.configurations if each.modes[0] == 1), None)
    heights = experiment.frame.story_heights
    if first is not None and heights is not None and BUILDING_STORY <= heights.mean() <= HIGHEST_STORY:
        height = float(heights.sum())
        if first * height > HIGHEST_TIMES_FREQUENCY:
            yield doubt(
                "angular_frequency", lowest=quantities.significant(first, 3), height=quantities.significant(height, 3)
            )


def deviations(experiment: Experiment) -> Iterator[FileFinding]:
    """Doubt standard deviations with which a measurement says nothing: they may be in percent."""
    for each in experiment.configurations:
        for key, largest in LARGEST_STD.items():
            std = np.ravel(np.asarray(getattr(each, key), dtype=float))
            std = std[np.isfinite(std) & (std > 0)]
            if std.size and (middle := np.median(std)) > largest:
                of = "frequencies" if key == "frequency_std" else "shapes"
                yield doubt("deviations", each.name, of=of, key=key, std=middle, percent=100 * middle)


def repeats(experiment: Experiment) -> Iterator[FileFinding]:
    """Two tests never agree to the last digit."""
    for names in repeated_configurations(experiment):
        yield doubt("repeated", names[1], names=", ".join(f'"{name}"' for name in names))


def look_alike(experiment: Experiment) -> Iterator[FileFinding]:
    """Adjacent sway modes differ at the sensors, if there is a sensor for each mode.

    Two that do not are one motion with another beside it: torsion seen by sensors off the centre, another direction, a
    mode of something on the frame, or a mode found twice.
    """
    even = nearest_frame.modes_of(np.ones(experiment.stories), np.ones(experiment.stories)).shapes
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
        name, found, change = in_words(
            "frequency_unit", ratio=quantities.significant(ratio, 3), words=words, either=either
        )
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
    mean = float(ratios.mean())
    for factor, words in FACTORS:
        if abs(mean - np.log(factor)) < UNIT_WITHIN:
            return float(np.exp(mean)), words
        if len(others) > 1 and abs(mean + np.log(factor)) < UNIT_WITHIN:
            return float(np.exp(mean)), f"1/{words}"
    return None


def total_mass(experiment: Experiment) -> Iterator[FileFinding]:
    """Compare the declared total with the configurations' own total.

    Added masses lower the frequencies the more, the lighter the frame is, lambda = phi' K phi / phi' (M + A) phi. So
    configurations with different added mass determine a total of their own, by the nearest shear frame with a free
    scale. The declared total is right, wrong by some factor, or wrong by the factor of another unit.
    """
    if experiment.frame.total_mass_placeholder:
        yield doubt("total_mass/placeholder", total=experiment.frame.total_mass)
        return
    declared = experiment.frame.known_total
    different = {tuple(each.added_mass) for each in experiment.configurations}
    if declared is None or len(different) < 2 or experiment.stories > nearest_frame.TALLEST_FITTED:
        return
    total, std = _implied_total(experiment)
    if not np.isfinite(std):
        return
    units = [*(("mass", *each) for each in MASS_UNITS), *(("load", *each) for each in LOAD_UNITS)]
    factors = np.log([1.0, 1.0, *(factor for *_, factor in units)])
    spread = np.hypot(std, np.where(np.arange(len(factors)) == 1, LARGEST_SLIP, TOTAL_STD))
    z = (np.log(declared / total) - factors) / spread
    wrong = np.log(nearest_frame.MISTAKEN)
    probability = ranking.weigh(-0.5 * z**2 - np.log(spread), np.where(np.arange(len(factors)) == 0, 0.0, wrong))
    if probability[0] > 1 - quantities.SURE:
        return
    likely = [unit for unit, p in zip(units, probability[2:], strict=True) if p > 1 - quantities.SURE]
    masses, loads = (" or ".join(unit for of, unit, _ in likely if of == which) for which in ("mass", "load"))
    key = "masses/total" if masses else "added_mass" if loads else "total_mass"
    either = f", or added_mass like {loads}" if masses and loads else ""
    sizes = {
        "implied": quantities.quantity(total, "kg", 3),
        "percent": 100 * std,
        "declared": quantities.quantity(declared, "kg", 6),
    }
    yield doubt(key, **sizes, unit=masses or loads, either=either)


def _implied_total(experiment: Experiment) -> tuple[float, float]:
    """Return the total mass without added mass, kg, of the frame nearest to all tests, and the log's deviation.

    The deviation is infinite if no frame is near to the data.
    """
    N, added = experiment.stories, [each.added_mass for each in experiment.configurations]
    readings = [MeasuredModes.of(each) for each in experiment.configurations]
    # Floors as heavy as the added mass.
    begin = np.repeat([np.log(max(float(mass.sum()) for mass in added) / N), 0.0], N)
    frames = ShearFrames(readings, added, begin, centred=True)
    found = frames.nearest([begin])
    if not _near(found, frames):
        others = frames.nearest(frames.odd_starts(begin))
        found = frames.nearest([found.theta, others.theta])
    masses = np.exp(found.theta[:N])
    if found.at is None or not _near(found, frames):
        return float(masses.sum()), np.inf
    share = masses / masses.sum()
    scatter = max(1.0, found.misfit / max(len(found.at.r) - len(found.theta), 1))
    covariance = np.linalg.pinv(found.at.J.T @ found.at.J)[:N, :N]
    return float(masses.sum()), float(np.sqrt(scatter * share @ covariance @ share))


def _near(found: NearestFrame, frames: ShearFrames) -> bool:
    """Whether a frame explains the data."""
    return found.misfit <= nearest_frame.PLAUSIBLE * frames.count


#: Checks of the declaration, independent of the shapes.
DECLARED_DOUBTS = (frame_values, angular_frequency, deviations, repeats)
