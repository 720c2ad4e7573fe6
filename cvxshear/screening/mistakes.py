"""Mistakes in measured modes and declared masses: hypotheses, weighed by the data as they would be if mended.

A hypothesis changes one thing: a sign, a sensor's place or unit, an order, a mode's number, a floor mass, the floor of
a load, a frequency. The nearest shear frame is fitted to the data as given and as changed. A change that can be made at
K places has the prior odds q / K against the data as given, q the share of files with a mistake of its kind. The
evidence of each fit makes them probabilities (`util/odds.py`). A mistake is named if the data as given are improbable,
with all changes that are needed to make the mistake certain.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from cvxshear.effects import LocatedEffect
from cvxshear.effects.stories import StoryChange
from cvxshear.loop.close import start_search
from cvxshear.loop.fitter import ModelClass
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.measurement.reading import CLOSER, FARTHER, FREQUENCY_TOLERANCE, MeasuredModes, violations
from cvxshear.priors import Nominal
from cvxshear.screening.finding import FileFinding, in_words
from cvxshear.screening.nearest_frame import (
    MISTAKEN,
    PLAUSIBLE,
    RANKED,
    TALLEST_FITTED,
    NearestFrame,
    ShearFrames,
    even_starts,
    loads_of,
    misfit,
    odd_starts,
    usual_width,
)  # fmt: skip
from cvxshear.screening.repairs import KINDS
from cvxshear.util import ranking
from cvxshear.util.errors import CvxshearError
from cvxshear.util.odds import weigh
from cvxshear.util.quantities import SURE, counted, quantity, significant
from cvxshear.util.typing import Floats

SLIP = 0.5
"""Standard deviation of the logarithm of a floor mass with a wrong declared value: a factor 1.6."""

MISTYPED = 0.3
"""Standard deviation of the logarithm of a frequency that is wrong: a wrong digit changes it by a few to 100 %."""

AS_DECLARED_STD = 0.003
"""Standard deviation of the logarithm of a floor mass that is declared exactly: a few bolts more or less."""

SHORTLIST = 6
"""Number of changes, the best by a rough fit, that are fitted to the end."""


@dataclass(frozen=True, eq=False)
class Change:
    """A hypothesis: one change of the data.

    Parameters
    ----------
    key : str
        Of the words for the mistake; empty for the data as given.
    frames : ShearFrames
        The data as they would be.
    choices : int
        Number of places where a mistake of this kind can be made.
    gaps : mapping
        What the words leave open.
    freed : tuple of int, optional
        Floor mass, or test and frequency, that the change leaves to the other data.
    """

    key: str
    frames: ShearFrames
    choices: int = 1
    gaps: Mapping[str, object] = field(default_factory=dict)
    freed: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Tried:
    """A change and the frame nearest to the data with it."""

    change: Change
    frame: NearestFrame

    @property
    def log_prior(self) -> float:
        """Logarithm of the prior odds against the data as given."""
        return float(np.log(MISTAKEN / self.change.choices)) if self.change.key else 0.0

    @property
    def distance(self) -> float:
        """Standard deviations between the data and the frame."""
        return self.change.frames.distance(self.frame)

    @property
    def plausible(self) -> bool:
        """Whether a shear frame explains the data."""
        return self.frame.misfit < PLAUSIBLE * self.change.frames.count


def needs_no_search(frames: ShearFrames, given: NearestFrame) -> bool:
    """Return whether no change can be certain: data cannot be nearer to a frame than on it, by the least tolerance."""
    lost = max(given.stds - frames.tolerant(CLOSER).stds, 0.0)
    return bool(given.misfit + lost < 2 * np.log(SURE / (1 - SURE) / MISTAKEN))


def named(given: NearestFrame, tried: Sequence[Tried], given_log_prior: float = 0.0) -> list[Tried]:
    """Return the changes that together are certain, the most probable first; none if the data may stand as given."""
    explaining = [each for each in tried if each.plausible]
    if not explaining:
        return []
    evidence = [given.log_evidence, *(each.frame.log_evidence for each in explaining)]
    probability = weigh(evidence, [given_log_prior, *(each.log_prior for each in explaining)])
    if probability[0] > 1 - SURE:
        return []
    order = ranking.order(probability[1:])
    needed = int(np.searchsorted(np.cumsum(probability[1:][order]), SURE * (1 - probability[0]))) + 1
    return [explaining[place] for place in order[:needed]]


def shortlisted(changes: Sequence[Change], starts: Sequence[Sequence[Floats]]) -> list[tuple[Change, NearestFrame]]:
    """Fit each change roughly and keep the most probable ones."""
    rough = [(each, each.frames.nearest(begin, RANKED)) for each, begin in zip(changes, starts, strict=True)]
    best = ranking.ranked(rough, lambda item: item[1].log_evidence - float(np.log(item[0].choices)))
    return best[:SHORTLIST]


def mistakes(configuration: Configuration) -> list[FileFinding]:
    """Find the mistake in one test's modes, if there is one."""
    if not configuration.measured.any():
        return []
    reading = MeasuredModes.of(configuration)
    broken, tried = violations(reading), reading.stories <= TALLEST_FITTED
    if tried:
        given, explaining = of_modes(reading)
        if explaining:
            before, after = ShearFrames.of(reading).distance(given), explaining[0].distance
            evidence = (
                f"{broken[0] if broken else 'no shear frame has these modes'} (the nearest frame is {before:.0f} "
                f"standard deviations away, with the change {after:.0f})"
            )
            changes = [in_words(item.change.key, **item.change.gaps) for item in explaining]
            return [FileFinding.of_changes(configuration.name, changes, evidence, refuses=True)]
    if not broken:
        return []
    change = "no single change mends it: look for more than one mistake" if tried else "look for a mistake"
    found = broken[0] + (f"; likewise {counted(len(broken) - 1, 'other mode')}" if len(broken) > 1 else "")
    change += " in mode_shapes and modes, or leave out a mode that is of no shear frame: torsion, a swing on a floor"
    return [FileFinding("signs", configuration.name, found, change, refuses=True)]


def of_modes(reading: MeasuredModes) -> tuple[NearestFrame, list[Tried]]:
    """Weigh the repairs of a reading; return the frame nearest to it as given, and the repairs that are named."""
    frames, even = ShearFrames.of(reading), even_starts(reading.stories)
    given = frames.likeliest([*even, *frames.story_starts(even[:1])])
    if needs_no_search(frames, given):
        return given, []
    odd = frames.nearest(odd_starts(reading.stories), RANKED)
    given = ranking.ranked([given, frames.likeliest([odd.theta])], lambda item: item.log_evidence)[0]
    if needs_no_search(frames, given):
        return given, []
    references = even if given.at is None else [*even, given.theta]
    shapes = [NearestFrame(theta).modes for theta in references]
    repairs = [repair for kind in KINDS for repair in kind(replace(reading, part=FARTHER), shapes)]
    misfits = np.array([[misfit(repair.reading, each) for each in shapes] for repair in repairs])
    near = np.unique(np.argsort(misfits, axis=0, kind="stable")[:SHORTLIST])
    changes = [
        Change(repair.key, ShearFrames.of(replace(repair.reading, part=1.0)), repair.choices, repair.gaps)
        for repair in (repairs[place] for place in near)
    ]
    best = shortlisted(changes, [[references[np.argmin(misfits[place])]] for place in near])
    return given, named(given, [Tried(each, each.frames.likeliest([rough.theta])) for each, rough in best])


def by_state(tests: Iterable[Configuration]) -> list[list[Configuration]]:
    """Group tests by the state that they are of."""
    states: dict[str, list[Configuration]] = {}
    for each in tests:
        states.setdefault(each.state, []).append(each)
    return list(states.values())


def masses_declared(experiment: Experiment) -> Iterator[FileFinding]:
    """Find a mistake in declared masses and design values, by the tests of the state with most of them."""
    states = by_state(each for each in experiment.configurations if each.measured.any())
    if not states or experiment.frame.total_mass_placeholder or experiment.stories > TALLEST_FITTED:
        return
    tests, N = max(states, key=len), experiment.stories
    declared = _declared(experiment, tests)
    changes = [] if declared is None else list(_changes(experiment, tests, declared))
    if declared is None or not changes:
        return
    masses = declared.expected[:N]
    given = declared.likeliest([np.concatenate([masses, each]) for each in (np.zeros(N), np.linspace(0.0, -1.0, N))])
    if needs_no_search(declared, given):
        return
    begin = given.theta[N:]
    starts = [[np.concatenate([each.frames.expected[:N], begin])] for each in changes]
    tried = [_valued(Tried(each, each.frames.likeliest([rough.theta]))) for each, rough in shortlisted(changes, starts)]
    explaining = named(given, tried)
    if not explaining:
        return
    shared = _shared(declared, given, explaining[0].change.frames)
    explaining = named(given, tried, shared / 2)
    if explaining:
        said = [in_words(item.change.key, **item.change.gaps) for item in explaining]
        evidence = (
            f"with the masses as declared the nearest frame is {declared.distance(given):.0f} standard deviations from "
            f"the modes, with the change {explaining[0].distance:.0f}"
        )
        yield FileFinding.of_changes(None, said, evidence, refuses=said[0][0] == "masses_from_top")


def _shared(declared: ShearFrames, given: NearestFrame, changed: ShearFrames) -> float:
    """Return how much less the values that a change exchanges cost as declared if all err by one cause.

    Design values come of one calculation: that all are off is as probable as what the farthest is off by.
    """
    if given.at is None:
        return 0.0
    exchanged = changed.expected != declared.expected
    costs = given.at.r[-len(exchanged) :][exchanged] ** 2
    return float(costs.sum() - costs.max(initial=0.0))


def _declared(experiment: Experiment, tests: Sequence[Configuration]) -> ShearFrames | None:
    """Return the declared floor masses, or equal masses for a declared total; None without a declared mass."""
    N, frame = experiment.stories, experiment.frame
    expected, width = np.zeros(2 * N), usual_width(N)
    known = frame.known_total is not None
    if frame.known_total is not None:
        expected[:N] = np.log(frame.known_total / N)
    for prior in experiment.priors:
        if isinstance(prior, Nominal) and prior.quantity in ("floor_mass", "story_stiffness"):
            part = slice(0, N) if prior.quantity == "floor_mass" else slice(N, 2 * N)
            values = np.log(prior.values)
            # Values up to a factor keep the scale that the total gives.
            expected[part] = values + np.mean(expected[part] - values) if prior.free_scale else values
            width[part] = AS_DECLARED_STD if prior.std is None else prior.std
            known |= prior.quantity == "floor_mass" and not prior.free_scale
    if frame.floor_masses is not None:
        expected[:N], width[:N] = np.log(frame.floor_masses), AS_DECLARED_STD
    readings, added = [MeasuredModes.of(each) for each in tests], [each.added_mass for each in tests]
    return ShearFrames(readings, added, expected, width) if known else None


def _changes(experiment: Experiment, tests: Sequence[Configuration], declared: ShearFrames) -> Iterator[Change]:
    """List every single change of the declaration that can mend it."""
    N, added = experiment.stories, declared.added
    for part, key, place in ((slice(0, N), "floor masses", "floor"), (slice(N, 2 * N), "stiffnesses", "story")):
        if np.ptp(declared.expected[part]) > 0:
            expected, width = declared.expected.copy(), declared.width.copy()
            expected[part], width[part] = expected[part][::-1], width[part][::-1]
            turned = replace(declared, expected=expected, width=width)
            yield Change("masses_from_top", turned, 1, {"values": key, "place": place})
    for floor in range(N if experiment.frame.floor_masses is not None else 0):
        width = np.where(np.arange(2 * N) == floor, SLIP, declared.width)
        said = quantity(float(np.exp(declared.expected[floor])), "kg", 3)
        yield Change("floor_mass", replace(declared, width=width), N, {"floor": floor + 1, "said": said}, (floor,))
    if len(tests) < 2 or all(np.array_equal(each, added[0]) for each in added):
        return
    from_top = [each[::-1] for each in added]
    if any(not np.array_equal(*pair) for pair in zip(from_top, added, strict=True)):
        yield Change("added_mass/from_top", replace(declared, added=from_top))
    loads = loads_of(added)
    for (test, floor), other in itertools.product(loads, range(N)):
        mass = added[test].copy()
        if not mass[other]:
            mass[other], mass[floor] = mass[floor], 0.0
            there = replace(declared, added=[*added[:test], mass, *added[test + 1 :]])
            gaps = {"load": quantity(mass[other], "kg", 3), "test": tests[test].name, "there": other + 1}
            yield Change("added_mass/floor", there, len(loads) * (N - 1), {**gaps, "floor": floor + 1})


def _valued(item: Tried) -> Tried:
    """Put the mass of the floor that a change leaves open into its words."""
    if not item.change.freed:
        return item
    (floor,) = item.change.freed
    value, std = float(np.exp(item.frame.theta[floor])), float(np.sqrt(item.frame.covariance[floor, floor]))
    gaps = {**item.change.gaps, "value": quantity(value, "kg", 3), "percent": 100 * std}
    return replace(item, change=replace(item.change, gaps=gaps))


def wrong_frequency(experiment: Experiment) -> Iterator[FileFinding]:
    """Find a frequency that no other datum agrees with, in the tests of one state or in all of them.

    Without stated deviations, the fit of the other data cannot be tested.
    """
    groups = by_state(experiment.configurations)
    if len(groups) > 1:
        groups.append(list(experiment.configurations))
    if experiment.stories <= TALLEST_FITTED:
        found = (_of_frequencies(experiment, tests) for tests in groups if all(_noise_stated(each) for each in tests))
        yield from itertools.islice((each for each in found if each is not None), 1)


def _noise_stated(test: Configuration) -> bool:
    """Return whether the file says how accurate a test's frequencies are, and its shapes if it has any."""
    return test.frequency_std is not None and (test.mode_shape_std is not None or not test.measured.any())


def _of_frequencies(experiment: Experiment, tests: Sequence[Configuration]) -> FileFinding | None:
    """Weigh for each frequency of these tests that it is wrong; None if it may be none.

    The noise is what the file states and nothing more.
    """
    total, N = experiment.frame.known_total, experiment.stories
    floor = max(float(each.added_mass.sum()) for each in tests) / N if total is None else total / N
    readings = [replace(MeasuredModes.of(each), part=0.0) for each in tests]
    data = sum(reading.count - int(reading.known.any(axis=1).sum()) for reading in readings) - 1
    expected = np.repeat([np.log(floor or 1.0), 0.0], N)
    frames = ShearFrames(readings, [each.added_mass for each in tests], expected, usual_width(N))
    about = frames.tolerant(FARTHER).nearest([expected]).theta
    given = frames.nearest([about])
    if needs_no_search(frames, given):
        return None
    count = sum(len(each.modes) for each in tests)
    tried = []
    for test, reading in enumerate(readings):
        for row in range(len(reading.modes)):
            noise = np.where(np.arange(len(reading.modes)) == row, MISTYPED, reading.frequency_noise)
            others = [*readings[:test], replace(reading, frequency_noise=noise), *readings[test + 1 :]]
            change = Change("frequency", replace(frames, readings=others), count, freed=(test, row))
            tried.append(Tried(change, change.frames.nearest([about])))
    best = ranking.ranked(tried, lambda item: item.frame.log_evidence)[0]
    given = ranking.ranked([given, frames.nearest([best.frame.theta])], lambda item: item.log_evidence)[0]
    explaining = named(given, [item for item in tried if _as_stated(item.frame, data)])
    if not explaining:
        return None
    expectations = [_expectation(item) for item in explaining]
    off = [
        abs(np.log(tests[item.change.freed[0]].frequencies[item.change.freed[1]]) - log)
        for item, (log, _) in zip(explaining, expectations, strict=True)
    ]
    rivals = None if min(off) < FREQUENCY_TOLERANCE else _rivals(experiment, tests, explaining[0])
    if rivals is None:
        return None
    found = _said(tests, explaining, expectations, given)
    return _beside_a_mass(found, tests[explaining[0].change.freed[0]].name, *rivals) if rivals else found


def _as_stated(frame: NearestFrame, data: int) -> bool:
    """Return whether the data are more than the frame takes up, and fit within their deviations."""
    if frame.at is None:
        return False
    own = len(frame.theta)
    J = frame.at.J[:-own]
    # The frequency that counts for nothing adds next to nothing to either sum.
    spare = data - float(np.trace(J @ frame.covariance @ J.T))
    chi2 = float(frame.at.r[:-own] @ frame.at.r[:-own])
    return spare >= 2.0 and float(special.chdtrc(spare, chi2)) > 0.01


def _expectation(item: Tried) -> tuple[float, float]:
    """Return the logarithm of a frequency, Hz, that follows from the other data, and its standard deviation."""
    (test, row), at, readings = item.change.freed, item.frame.at, item.change.frames.readings
    assert at is not None, "a change that is named has a fit"
    place = row + sum(each.shapes.size + len(each.modes) for each in readings[:test])
    slope = MISTYPED * at.J[place]
    std = float(np.sqrt(slope @ item.frame.covariance @ slope))
    return float(readings[test].log_frequencies[row] + MISTYPED * at.r[place]), std


def _rivals(
    experiment: Experiment, tests: Sequence[Configuration], best: Tried
) -> tuple[ModelClass, float] | tuple[()] | None:
    """Weigh single effects, of the frame or of one test, against the wrong frequency.

    Returns
    -------
    tuple or None
        The most probable mass on a spring and the probability of all effects, empty if they are improbable; None if
        another effect accounts for the data, or if no fit says.
    """
    test, row = best.change.freed
    wrong = tests[test]
    std = wrong.log_frequency_std.copy()
    std[row] = MISTYPED
    given = replace(
        experiment,
        # Somebody may have changed something between two tests of one state.
        configurations=tuple(
            replace(each, state=f"{each.state}, {each.name}") if each in tests else each
            for each in experiment.configurations
            if each in tests or _noise_stated(each)
        ),
        frame=replace(experiment.frame, reference=None),
        static=(),
        expected=(),
    )
    less_sure = (replace(each, frequency_std=std) if each.name == wrong.name else each for each in given.configurations)
    # Changes of stories in the other states belong to those states.
    changed = StoryChange()
    others = tuple(LocatedEffect(changed, place) for place in changed.places(given) if place.state in experiment.states)
    try:
        with_effect, without = (
            start_search(given, others),
            start_search(replace(given, configurations=tuple(less_sure)), others),
        )
        with_effect.add_motions(with_effect.base)
        with_effect.probe()
    except CvxshearError:
        return None
    widened = float(np.log(MISTYPED / wrong.log_frequency_std[row]))
    models = list(with_effect.visited.values())
    scores = [model.score for model in models]
    probability = weigh([without.base.score - widened + best.log_prior, *scores])
    likely = [place for place in ranking.order(probability[1:]) if probability[1:][place] > 1 - SURE]
    kinds = [[placed.effect.adds_motion for placed in models[place].effects] for place in likely]
    if any(own != [True] for own in kinds):
        return None
    return (models[likely[0]], float(1.0 - probability[0])) if likely else ()


def _beside_a_mass(found: FileFinding, test: str, model: ModelClass, share: float) -> FileFinding:
    """Say what mass on a spring explains the data as well: the finding is a doubt."""
    assert model.estimate is not None, "a set that was weighed has a fit"
    (placed,) = model.effects
    mass, frequency = (significant(value, 2) for value in model.estimate.theta[-2:].tolist())
    _, said, change = in_words(
        "frequency/attached", floor=placed.place.floor, mass=mass, frequency=frequency, percent=100 * share,
        where="" if placed.place.state is None else f' of "{test}"',
    )  # fmt: skip
    return replace(found, found=f"{found.found}; {said}", change=f"{found.change}; {change}", refuses=False)


def _said(
    tests: Sequence[Configuration],
    explaining: Sequence[Tried],
    expectations: Sequence[tuple[float, float]],
    given: NearestFrame,
) -> FileFinding:
    """Report the wrong frequency, or the possibly wrong ones, with the value from the other data."""
    changes = []
    for item, (log, log_std) in zip(explaining, expectations, strict=True):
        test, row = tests[item.change.freed[0]], item.change.freed[1]
        expected, value = float(np.exp(log)), float(test.frequencies[row])
        off = abs(np.log(value) - log) / np.hypot(log_std, test.log_frequency_std[row])
        sizes = {"value": significant(value, 5), "expected": significant(expected, 5), "off": off}
        std = significant(expected * log_std, 2)
        changes.append(in_words("frequency", mode=test.modes[row], test=test.name, std=std, **sizes))
    before, after = (float(np.sqrt(each.misfit)) for each in (given, explaining[0].frame))
    evidence = f"the nearest frame is {before:.0f} standard deviations away, without it {after:.0f}"
    where = tests[explaining[0].change.freed[0]].name if len(explaining) == 1 else None
    return FileFinding.of_changes(where, changes, evidence, refuses=True)
