"""Floor masses, design values and added masses that the shapes contradict: one wrong, one on another floor, an order.

The configurations of one state are compared with the nearest shear frame whose masses are as declared, and again after
each single change of the declaration. As for the modes themselves (`screen`) a change is named by its odds: the cost
of each fit, minus twice the logarithm of its likelihood, with the tolerance that suits it best, and

    2 log (K / q) + 2 log (sigma_0 / sigma)

for a change that can be made at K places in a share q of all files, and that estimates a mass expected within sigma_0
to within sigma (Occam's factor of the Laplace approximation).
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.measurement.reading import CLOSER, FARTHER, MeasuredModes
from cvxshear.priors import Nominal
from cvxshear.screening import shear_fit
from cvxshear.screening.compared_tests import by_state
from cvxshear.screening.doubts import right_in_kg
from cvxshear.screening.finding import FileFinding, doubt, in_words
from cvxshear.screening.repairs import LEFT_TO_GIVEN, REFITTED, RIVAL_COST, SUSPICIOUS, UNEXPLAINED, prior_cost
from cvxshear.screening.shear_fit import TALLEST_FITTED, NearestFrame, ShearFrames
from cvxshear.util import ranking
from cvxshear.util.quantities import quantity
from cvxshear.util.typing import Floats

AS_DECLARED_STD = 0.003
"""Standard deviation of the logarithm of a floor mass that is declared exactly: a few bolts more or less."""

SLIP = 0.5
"""Standard deviation of the logarithm of a floor mass with a wrong declared value: a factor 1.6."""


@dataclass(frozen=True, eq=False)
class DeclaredMasses:
    """Masses, and design values of stiffnesses, as declared or changed.

    Parameters
    ----------
    expected, width : ndarray, shape (2N,)
        Logarithms of masses and stiffnesses and their standard deviations.
    added : tuple of ndarray, shape (N,)
        Added mass of each configuration, kg.
    key : str
        Of the words for the mistake, which is mended here; empty for what was declared.
    gaps : dict
        What the words leave open.
    choices : int
        Among how many of its kind it is one.
    estimated : int, optional
        The floor, from 0, whose mass is estimated.
    """

    expected: Floats
    width: Floats
    added: tuple[Floats, ...]
    key: str = ""
    gaps: Mapping[str, object] = field(default_factory=dict)
    choices: int = 0
    estimated: int | None = None

    @property
    def prior_cost(self) -> float:
        """Minus twice the logarithm of the odds that it is what happened."""
        return prior_cost(self.choices) if self.choices else 0.0


@dataclass(frozen=True, eq=False)
class MassFit:
    """Masses as declared or changed, and the frame nearest to the readings with them."""

    declared: DeclaredMasses
    frame: NearestFrame
    cost: float


def masses_declared(experiment: Experiment) -> Iterator[FileFinding]:
    """Find a mistake in the masses, by the configurations of the state that has most of them."""
    states = by_state(each for each in experiment.configurations if each.measured.any())
    if not states or experiment.frame.total_mass_placeholder or experiment.stories > TALLEST_FITTED:
        return
    tests = max(states, key=len)
    declared = _declared(experiment, tests)
    others = () if declared is None else tuple(_changes(experiment, tests, declared))
    if declared is None or not others:
        return
    readings = [MeasuredModes.of(each) for each in tests]
    given = _fitted(readings, declared, [np.zeros(experiment.stories), np.linspace(0.0, -1.0, experiment.stories)])
    if given.cost < SUSPICIOUS:
        return
    begin = [given.frame.theta[experiment.stories :]]
    rough = [(_nearest(readings, each, begin, shear_fit.ROUGH_STEPS).cost + each.prior_cost, each) for each in others]
    rough = ranking.ranked(rough, lambda item: -item[0])
    fitted = ranking.ranked((_fitted(readings, each, begin) for _, each in rough[:REFITTED]), lambda item: -item.cost)
    best = fitted[0]
    left = best.cost - given.cost + _shared(given, best.declared)
    if best.frame.cost > UNEXPLAINED * given.cost or left > 2 * np.log(LEFT_TO_GIVEN):
        return
    named = [item for item in fitted if item.cost - best.cost < RIVAL_COST]
    changes = [in_words(item.declared.key, **item.declared.gaps) for item in named]
    evidence = (
        f"with the masses as declared the nearest frame is {np.sqrt(given.frame.cost):.0f} standard deviations from "
        f"the modes, with the change {np.sqrt(best.frame.cost):.0f}"
    )
    yield FileFinding.of_changes(None, changes, evidence, refuses=changes[0][0] == "masses_from_top")


def _shared(given: MassFit, changed: DeclaredMasses) -> float:
    """Return how much less the values that a change exchanges cost as declared if all err by one cause.

    Design values come of one calculation: where all are off, that is as probable as what the farthest is off by.
    """
    if given.frame.at is None:
        return 0.0
    exchanged = changed.expected != given.declared.expected
    costs = given.frame.at.r[-len(exchanged) :][exchanged] ** 2
    return float(costs.sum() - costs.max(initial=0.0))


def _declared(experiment: Experiment, tests: Sequence[Configuration]) -> DeclaredMasses | None:
    """Return the declared floor masses, or equal masses for a declared total; None without a declared mass."""
    N, frame = experiment.stories, experiment.frame
    expected, width = np.zeros(2 * N), shear_fit.usual_width(N)
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
    return DeclaredMasses(expected, width, tuple(each.added_mass for each in tests)) if known else None


def _changes(
    experiment: Experiment, tests: Sequence[Configuration], declared: DeclaredMasses
) -> Iterator[DeclaredMasses]:
    """Every single change of the declaration that can mend it."""
    N = experiment.stories
    for part, key, place in ((slice(0, N), "floor masses", "floor"), (slice(N, 2 * N), "stiffnesses", "story")):
        values = declared.expected[part]
        if np.ptp(values) > 0:
            turned = declared.expected.copy(), declared.width.copy()
            for old, new in zip((declared.expected, declared.width), turned, strict=True):
                new[part] = old[part][::-1]
            gaps: dict[str, object] = {"values": key, "place": place}
            yield replace(declared, expected=turned[0], width=turned[1], key="masses_from_top", gaps=gaps, choices=1)
    for floor in range(N if experiment.frame.floor_masses is not None else 0):
        width, gaps = np.where(np.arange(2 * N) == floor, SLIP, declared.width), {"floor": floor + 1}
        yield replace(declared, width=width, key="floor_mass", gaps=gaps, estimated=floor, choices=N)
    if len(tests) < 2 or all(np.array_equal(each, declared.added[0]) for each in declared.added):
        return
    from_top = tuple(each[::-1] for each in declared.added)
    if any(not np.array_equal(*pair) for pair in zip(from_top, declared.added, strict=True)):
        yield replace(declared, added=from_top, key="added_mass/from_top", choices=1)
    loads = _loads(declared.added)
    for (test, floor), other in itertools.product(loads, range(N)):
        mass = declared.added[test].copy()
        if mass[other]:
            continue
        mass[other], mass[floor] = mass[floor], 0.0
        load = quantity(mass[other], "kg", 3)
        gaps = {"load": load, "test": tests[test].name, "there": other + 1, "floor": floor + 1}
        added = (*declared.added[:test], mass, *declared.added[test + 1 :])
        yield replace(declared, added=added, key="added_mass/floor", gaps=gaps, choices=len(loads) * (N - 1))


def _nearest(
    readings: Sequence[MeasuredModes], declared: DeclaredMasses, stiffness: Sequence[Floats], most_steps: int
) -> NearestFrame:
    """Fit a frame from the declared masses and these logarithms of stiffnesses, shape (N,)."""
    each = list(zip(readings, declared.added, strict=True))
    problem = ShearFrames(each, expected=declared.expected, width=declared.width)
    starts = (np.concatenate([declared.expected[: readings[0].stories], start]) for start in stiffness)
    return min((problem.nearest(problem.tuned(start), most_steps) for start in starts), key=lambda item: item.cost)


def _fitted(readings: Sequence[MeasuredModes], declared: DeclaredMasses, stiffness: Sequence[Floats]) -> MassFit:
    """Fit with each tolerance and take the best by the likelihood, as `shear_fit.distance` does for one reading."""
    fits = []
    for part in (1.0, CLOSER, FARTHER):
        each = [replace(reading, part=part) for reading in readings]
        near = _nearest(each, declared, stiffness, shear_fit.MOST_NEAREST_STEPS)
        fits.append((near.cost + sum(reading.certainty_lost() for reading in each), near))
        stiffness = [near.theta[len(declared.expected) // 2 :]]
    cost, near = min(fits, key=lambda item: item[0])
    found = MassFit(declared, replace(near, cost=cost), cost + declared.prior_cost)
    floor = declared.estimated
    if floor is None or near.at is None:
        return found
    std = float(np.sqrt(np.linalg.pinv(near.at.J.T @ near.at.J)[floor, floor]))
    value, said = (quantity(float(np.exp(each[floor])), "kg", 3) for each in (near.theta, declared.expected))
    named = replace(declared, gaps={**declared.gaps, "value": value, "percent": 100 * std, "said": said})
    return replace(found, declared=named, cost=found.cost + 2 * np.log(declared.width[floor] / std))


CONTRADICTION = 4.0
"""The two totals contradict each other if their logarithms differ by more standard deviations."""

LEAST_CONTRADICTION = 0.3
"""Least reported difference between the logarithms of the two totals."""

POOREST = 0.6
"""Largest standard deviation of the logarithm of a useful total."""

POOR = 4.0
"""Largest cost per datum of a shear frame that determines a mass; above it, uneven frames are starts as well."""

VAGUE = 0.05
"""Weight, in the uncertainty of an implied total, of the rows that keep floors and stories alike."""

LOAD_UNITS = (("t", 1e3), ("kN", 1e3 / 9.81), ("g", 1e-3), ("N", 1 / 9.81))
"""Other units of added masses than kg, with the factor that the total then seems too large by."""

LARGEST_SLIP = float(np.log(30.0))
"""Logarithm of the largest error factor of one added mass: a shifted decimal point, and some more."""

SLIP_STEP = 0.02
"""Logarithm of the factor to which that mass is estimated: it is shown with two digits, and is no better known."""

RIGHT_TOTAL_STD = 0.03
"""Standard deviation of the logarithm of a declared total that is right, where a load is judged by it."""

UNIT_OFF = 0.5
"""Difference of logarithms within which the ratio of two totals is taken for 1000 or its inverse, a unit."""


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
    frame = nearest_to_all(experiment, added)
    total, std = implied_total(experiment, frame)
    off = float(np.log(declared / total))
    if std > POOREST or abs(off) < max(LEAST_CONTRADICTION, CONTRADICTION * std):
        return
    sizes = {"implied": quantity(total, "kg", 3), "percent": 100 * std, "declared": quantity(declared, "kg", 6)}
    heavy = right_in_kg(experiment, declared / experiment.stories)
    load = next((unit for unit, factor in LOAD_UNITS if abs(off - np.log(factor)) < UNIT_OFF), None)
    unit = next((unit for unit, factor in (("g", 1e3), ("t", 1e-3)) if abs(off - np.log(factor)) < UNIT_OFF), None)
    loads = list(_other_loads(experiment, added, declared, frame))
    if loads:
        alone = load is None or min(cost for cost, _ in loads) < frame.cost - RIVAL_COST
        unit_too = "" if alone else f", or with all of them in {load}"
        found = doubt("added_mass/size", **sizes, loads=" or ".join(said for _, said in loads), either=unit_too)
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
) -> Iterator[tuple[float, str]]:
    """Find single loads with which, of another size, the declared total fits as well as another total does.

    Yields the cost of the frame with each, and words.
    """
    sign = np.sign(np.log(declared) - _log_total(given))
    for test, floor in _loads(added):

        def cost(slip: float, test: int = test, floor: int = floor) -> float:
            factor = np.where(np.arange(experiment.stories) == floor, np.exp(sign * slip), 1.0)
            frame = nearest_to_all(experiment, [*added[:test], factor * added[test], *added[test + 1 :]])
            return frame.cost + float(((_log_total(frame) - np.log(declared)) / RIGHT_TOTAL_STD) ** 2)

        best = minimize_scalar(cost, bounds=(0.0, LARGEST_SLIP), method="bounded", options={"xatol": SLIP_STEP})
        if best.fun < given.cost + RIVAL_COST:
            said = float(added[test][floor])
            now = quantity(said * float(np.exp(sign * best.x)), "kg", 2)
            name = experiment.configurations[test].name
            yield best.fun, f'{now} in place of {quantity(said, "kg", 3)} on floor {floor + 1} of "{name}"'


def _loads(added: Sequence[Floats]) -> list[tuple[int, int]]:
    """List the added masses, each by its test and its floor, from 0."""
    return [(test, floor) for test, mass in enumerate(added) for floor in np.flatnonzero(mass).tolist()]


def _log_total(frame: NearestFrame) -> float:
    """Logarithm of a frame's mass, kg."""
    return float(np.log(np.sum(np.exp(np.split(frame.theta, 2)[0]))))


def nearest_to_all(experiment: Experiment, added: Sequence[Floats]) -> NearestFrame:
    """Fit a frame of any scale to all configurations, with these added masses, kg."""
    N = experiment.stories
    readings = [MeasuredModes.of(each) for each in experiment.configurations]
    problem = ShearFrames(list(zip(readings, added, strict=True)), centred=True)
    # Floors as heavy as the added mass.
    begin = np.repeat([np.log(max(float(mass.sum()) for mass in added) / N), 0.0], N)
    found = problem.nearest(problem.tuned(begin))
    if found.cost > POOR * sum(reading.count for reading in readings):
        others = (
            problem.nearest(problem.tuned(begin + start), shear_fit.ROUGH_STEPS) for start in shear_fit.odd_starts(N)
        )
        found = problem.nearest(min((found, *others), key=lambda item: item.cost).theta)
    return found


def implied_total(experiment: Experiment, found: NearestFrame | None = None) -> tuple[float, float]:
    """Estimate the total mass without added mass, kg, from the configurations, and the std of its logarithm.

    The std is infinite where no shear frame is near all configurations.

    Parameters
    ----------
    experiment : Experiment
        Of two configurations at least with different added mass.
    found : NearestFrame, optional
        To all of them.
    """
    N, count = experiment.stories, sum(MeasuredModes.of(each).count for each in experiment.configurations)
    if found is None:
        found = nearest_to_all(experiment, [each.added_mass for each in experiment.configurations])
    share = np.exp(found.theta[:N])
    if found.at is None or found.cost > POOR * count:
        return float(share.sum()), np.inf
    # Usual floor masses have a small weight here; the added masses decide.
    J = found.at.J.copy()
    J[-2 * N :] *= VAGUE
    covariance = np.linalg.pinv(J.T @ J)
    by_masses = share / share.sum()
    scatter = max(1.0, found.cost / max(len(found.at.r) - 2 * N, 1))
    return float(share.sum()), float(np.sqrt(scatter * by_masses @ covariance[:N, :N] @ by_masses))
