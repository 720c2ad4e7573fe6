"""One frequency of a file that is wrong: a digit that was mistyped, or the frequency of another mode.

The tests of one state, and all tests together, are compared with the nearest shear frame, the noise being what the file
states and nothing more. Then each frequency in turn is left to the others: its logarithm has the standard deviation
`MISTYPED`. As for the other mistakes (`declared_masses`) the odds decide. With C the cost of a fit, minus twice the
logarithm of its likelihood, and J its residuals' derivatives, minus twice the logarithm of the probability is

    C + log det J'J + 2 log (std / stated std) + 2 log (K / q)

for one of K frequencies in a share q of all files. A frequency is named only where everything else then fits as its
deviations say, on more data than the frame takes up, and where no single effect of the catalogue, and no change between
the tests, accounts for the data nearly as well. A mass on a spring accounts for the data if its own mode, or the second
of its two modes, was taken for the frame's. Both causes are reported, as a doubt unless the mass is improbable.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import special

from cvxshear.effects import LocatedEffect
from cvxshear.effects.stories import StoryChange
from cvxshear.loop.close import start_search
from cvxshear.loop.fitter import ModelClass
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.measurement.reading import FARTHER, FREQUENCY_TOLERANCE, MeasuredModes
from cvxshear.screening.compared_tests import by_state
from cvxshear.screening.finding import FileFinding, in_words
from cvxshear.screening.repairs import LEFT_TO_GIVEN, RIVAL_COST, SUSPICIOUS, prior_cost
from cvxshear.screening.shear_fit import TALLEST_FITTED, NearestFrame, ShearFrames
from cvxshear.util import ranking
from cvxshear.util.errors import CvxshearError
from cvxshear.util.odds import weigh
from cvxshear.util.quantities import SURE, significant
from cvxshear.util.typing import Floats

MISTYPED = 0.3
"""Standard deviation of the logarithm of a frequency that is wrong: a wrong digit changes it by a few to 100 %."""

AS_STATED = 0.01
"""Least probability of the other data's chi-square; below it, their deviations are too small."""

FEWEST_SPARE = 2.0
"""Least number of data, beyond the frame's parameters, for a test of the fit."""


@dataclass(frozen=True, eq=False)
class Freed:
    """A fit in which one frequency counts for nothing.

    Parameters
    ----------
    test, row : int
        The configuration, and the frequency in it, from 0.
    frame : NearestFrame
    cost : float
        Minus twice the logarithm of its probability, but for a constant.
    expected, std : float
        Logarithm of the frequency, Hz, that follows from the other data, and its standard deviation.
    """

    test: int
    row: int
    frame: NearestFrame
    cost: float
    expected: float
    std: float


def wrong_frequency(experiment: Experiment) -> Iterator[FileFinding]:
    """Find a frequency that no other datum agrees with, in the tests of one state or in all of them."""
    groups = by_state(experiment.configurations)
    if len(groups) > 1:
        groups.append(list(experiment.configurations))
    if experiment.stories > TALLEST_FITTED:
        return
    for tests in groups:
        # Without stated deviations, the fit of the other data cannot be tested.
        if not all(_noise_stated(each) for each in tests):
            continue
        found = _explaining(experiment, tests)
        if found:
            yield found
            return


def _noise_stated(test: Configuration) -> bool:
    """Whether the file says how accurate a test's frequencies are, and its shapes where it has any."""
    return test.frequency_std is not None and (test.mode_shape_std is not None or not test.measured.any())


def _explaining(experiment: Experiment, tests: Sequence[Configuration]) -> FileFinding | None:
    """Say which frequency of these tests is wrong; None where it may be none."""
    readings = [dataclasses.replace(MeasuredModes.of(each), part=0.0) for each in tests]
    count = sum(len(each.modes) for each in tests)
    spare = sum(reading.count - int(reading.known.any(axis=1).sum()) for reading in readings) - 1
    if spare < FEWEST_SPARE:
        return None
    among = partial(_problem, experiment, tests)
    problem = among([dataclasses.replace(each, part=FARTHER) for each in readings])
    about = problem.nearest(problem.tuned(problem.expected)).theta
    given = among(readings).nearest(about)
    if given.cost < SUSPICIOUS:
        return None
    places = ((test, row) for test, reading in enumerate(readings) for row in range(len(reading.modes)))
    freed = ranking.ranked((_freed(among, readings, about, *place) for place in places), lambda item: -item.cost)
    best = freed[0]
    given = min(given, among(readings).nearest(best.frame.theta), key=lambda item: item.cost)
    if best.cost - given.cost - _log_det(given) > 2 * np.log(LEFT_TO_GIVEN) or not _as_stated(best, spare):
        return None
    named = [item for item in freed if item.cost - best.cost < RIVAL_COST and _as_stated(item, spare)]
    off = [abs(np.log(tests[item.test].frequencies[item.row]) - item.expected) for item in named]
    if min(off) < FREQUENCY_TOLERANCE:
        return None
    rivals = _rivals(experiment, tests, best, count)
    if rivals is None or any(not placed.effect.adds_motion for model, _ in rivals for placed in model.effects):
        return None
    found = _said(tests, named, given)
    return _beside_a_mass(found, tests[best.test].name, rivals) if rivals else found


def _problem(experiment: Experiment, tests: Sequence[Configuration], readings: Sequence[MeasuredModes]) -> ShearFrames:
    total = experiment.frame.known_total
    N = experiment.stories
    floor = max(float(each.added_mass.sum()) for each in tests) / N if total is None else total / N
    expected = np.repeat([np.log(floor or 1.0), 0.0], N)
    return ShearFrames(
        [(reading, each.added_mass) for reading, each in zip(readings, tests, strict=True)], expected=expected
    )


def _log_det(found: NearestFrame) -> float:
    if found.at is None:
        return -np.inf
    return float(np.linalg.slogdet(found.at.J.T @ found.at.J)[1])


def _freed(
    among: Callable[..., ShearFrames], readings: Sequence[MeasuredModes], about: Floats, test: int, row: int
) -> Freed:
    """Fit with one frequency left to the others."""
    reading = readings[test]
    noise = np.where(np.arange(len(reading.modes)) == row, MISTYPED, reading.frequency_noise)
    others = [*readings[:test], dataclasses.replace(reading, frequency_noise=noise), *readings[test + 1 :]]
    found = among(others).nearest(about)
    if found.at is None:
        return Freed(test, row, found, np.inf, 0.0, np.inf)
    at = row + sum(each.shapes.size + len(each.modes) for each in readings[:test])
    slope = MISTYPED * found.at.J[at]
    std = float(np.sqrt(slope @ np.linalg.pinv(found.at.J.T @ found.at.J) @ slope))
    wider = 2 * float(np.log(MISTYPED / reading.frequency_noise[row]))
    cost = found.cost + _log_det(found) + wider + prior_cost(sum(len(each.modes) for each in readings))
    return Freed(test, row, found, cost, float(reading.log_frequencies[row] + MISTYPED * found.at.r[at]), std)


def _as_stated(freed: Freed, data: int) -> bool:
    """Return whether the other data are enough for a test and fit within their deviations."""
    at = freed.frame.at
    if at is None:
        return False
    own = len(freed.frame.theta)
    J = at.J[:-own]
    # The frequency that counts for nothing adds next to nothing to either sum.
    taken = float(np.trace(J @ np.linalg.pinv(at.J.T @ at.J) @ J.T))
    spare = data - taken
    chi2 = float(at.r[:-own] @ at.r[:-own])
    return spare >= FEWEST_SPARE and float(special.chdtrc(spare, chi2)) > AS_STATED


def _rivals(
    experiment: Experiment, tests: Sequence[Configuration], best: Freed, count: int
) -> list[tuple[ModelClass, float]] | None:
    """Find the single effects, of the frame or of one test, that make the data as given nearly as probable.

    With each the logarithm of its odds against a wrong frequency; None where no fit says.
    """
    wrong = tests[best.test]
    std = wrong.log_frequency_std.copy()
    std[best.row] = MISTYPED
    given = dataclasses.replace(
        experiment,
        # Somebody may have changed something between two tests of one state.
        configurations=tuple(
            dataclasses.replace(each, state=f"{each.state}, {each.name}") if each in tests else each
            for each in experiment.configurations
            if each in tests or _noise_stated(each)
        ),
        frame=dataclasses.replace(experiment.frame, reference=None),
        static=(),
        expected=(),
    )
    less_sure = (
        dataclasses.replace(each, frequency_std=std) if each.name == wrong.name else each
        for each in given.configurations
    )
    freed = dataclasses.replace(given, configurations=tuple(less_sure))
    # Changes of stories in the other states belong to those states.
    changed = StoryChange()
    others = tuple(LocatedEffect(changed, place) for place in changed.places(given) if place.state in experiment.states)
    try:
        with_effect, without = start_search(given, others), start_search(freed, others)
        with_effect.add_motions(with_effect.base)
        with_effect.probe()
    except CvxshearError:
        return None
    paid = float(np.log(MISTYPED / wrong.log_frequency_std[best.row])) + prior_cost(count) / 2
    odds = [(model, model.score - without.base.score + paid) for model in with_effect.visited.values()]
    return [(model, each) for model, each in odds if each >= np.log(LEFT_TO_GIVEN)]


def _beside_a_mass(found: FileFinding, test: str, rivals: Sequence[tuple[ModelClass, float]]) -> FileFinding:
    """Say what mass on a spring explains the data as well; unless it is improbable the finding is a doubt."""
    model, _ = ranking.ranked(rivals, lambda item: item[1])[0]
    assert model.estimate is not None, "a set that was weighed has a fit"
    (placed,) = model.effects
    mass, frequency = (significant(value, 2) for value in model.estimate.theta[-2:].tolist())
    share = 1.0 - float(weigh([0.0, *(odds for _, odds in rivals)])[0])
    said, change = in_words(
        "frequency/attached", floor=placed.place.floor, mass=mass, frequency=frequency, percent=100 * share,
        where="" if placed.place.state is None else f' of "{test}"',
    )[1:]  # fmt: skip
    said, change = f"{found.found}; {said}", f"{found.change}; {change}"
    return dataclasses.replace(found, found=said, change=change, refuses=share < 1.0 - SURE)


def _said(tests: Sequence[Configuration], named: Sequence[Freed], given: NearestFrame) -> FileFinding:
    """Report the wrong frequency, or the possibly wrong ones, with the value from the other data."""
    changes = []
    for item in named:
        test = tests[item.test]
        expected, value = float(np.exp(item.expected)), float(test.frequencies[item.row])
        std = significant(expected * item.std, 2)
        off = abs(np.log(value) - item.expected) / np.hypot(item.std, test.log_frequency_std[item.row])
        sizes = {"value": significant(value, 5), "expected": significant(expected, 5), "std": std, "off": off}
        changes.append(in_words("frequency", mode=test.modes[item.row], test=test.name, **sizes))
    before, after = (float(np.sqrt(each.cost)) for each in (given, named[0].frame))
    evidence = f"the nearest frame is {before:.0f} standard deviations away, without it {after:.0f}"
    where = tests[named[0].test].name if len(named) == 1 else None
    return FileFinding.of_changes(where, changes, evidence, refuses=True)
