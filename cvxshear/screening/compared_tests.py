"""Comparison of the tests in one file: copies, one state under two names, impossible modes or units."""

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, pairwise

import numpy as np

from cvxshear.data.pairing import mac
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.measurement.reading import NUMBERS_OF_A_COPY, repeated_configurations
from cvxshear.screening.doubts import near
from cvxshear.screening.finding import FileFinding, doubt, in_words
from cvxshear.screening.shear_fit import modes_of
from cvxshear.util.quantities import significant

FACTORS = ((2 * np.pi, "2 pi, as of rad/s"), (60.0, "60, as of cycles a minute"), (1000.0, "1000, as of mHz"))
"""Factors between units of frequency, with the unit that each would mean."""

ONE_FACTOR_STD = 0.1
"""The modes' ratios are one factor if their logarithms have a smaller standard deviation: a change of the frame changes
its modes differently."""

SAME_SHAPE_MAC, TOLD_APART = 0.9, 0.5
"""Modal assurance criteria of adjacent modes: measured shapes are alike above the first, and shapes of a frame with
equal floors and stories differ below the second. Of 15,000 sound random frames two have such modes."""

SHOWN_LOAD = 5.0
"""Least change of the frequencies by a load on the mean floors, in standard deviations, for a finding."""

WORD = re.compile(r"[^\W\d_]{4,}")
"""Letters in which a slip is seen; a shorter word with another letter is mostly another word."""


def by_state(tests: Iterable[Configuration]) -> list[list[Configuration]]:
    """Group tests by the state that they are of."""
    states: dict[str, list[Configuration]] = {}
    for each in tests:
        states.setdefault(each.state, []).append(each)
    return list(states.values())


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
    return total is not None and (heaviest - lightest) / (2 * total) > SHOWN_LOAD * std


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
    if not ratios.size or ratios.std() > ONE_FACTOR_STD:
        return None
    ratio = float(np.exp(ratios.mean()))
    for factor, words in FACTORS:
        if near(ratio, factor):
            return ratio, words
        if len(others) > 1 and near(ratio, 1 / factor):
            return ratio, f"1/{words}"
    return None
