"""Which added mass to test next, in which state, and with which sensors, so that rivals part."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.fit.efficient import Estimate
from cvxshear.fit.separation import Disagreement, disagreement, imagined
from cvxshear.measurement.experiment import Configuration
from cvxshear.util import ranking
from cvxshear.util.errors import NoModesError
from cvxshear.util.results import InJson
from cvxshear.util.typing import Ints

PARTS_OF_A_FLOOR = (0.1, 0.25, 0.5, 1.0)
"""Added masses that are tried, as parts of the mean floor mass."""

HEAVIEST = 1000.0
"""kg on one floor: more is not carried up for a test."""

MOST_RIVALS = 4
"""Rival sets that a test is to tell from the accepted one, the most probable first."""

WORTHWHILE = 1.0
"""Standard deviations below which no test is proposed."""

CLEAR = 3.0
"""Standard deviations from which on a test needs no more sensors."""

WORTH_A_SENSOR = 1.2
"""Times as many standard deviations that a sensor more must give."""

PROMISING = 8
"""Tests, those that tell most with the sensors there are, that more sensors are tried in."""


@dataclass(frozen=True)
class NextTest(InJson):
    """A test that would tell the rivals apart.

    Parameters
    ----------
    floor : int
    added_mass : float
        kg on that floor, beyond what the first configuration of its state carries.
    state : str
        In which it is tested.
    standard_deviations : float
        How far the predictions of the accepted model and of its nearest rival lie apart.
    measured_floors : tuple of int or None
        The floors with a sensor, where some are proposed beyond those of that configuration; else None.
    tells_all : bool
        Whether no rival is left that no added mass would tell from the accepted model.
    """

    floor: int
    added_mass: float
    state: str
    standard_deviations: float
    measured_floors: tuple[int, ...] | None = None
    tells_all: bool = True


def next_test(accepted: Estimate, rivals: Sequence[Estimate]) -> NextTest | None:
    """Find the added mass whose test would best tell an accepted model from its rivals, and the sensors that it needs.

    For each state that can still be tested (of declared states the last), each floor and a few masses, the test is
    simulated by the accepted model with the sensors and noise of the state's first configuration, and compared with
    what each rival says of it (`fit/separation.py`).
    The smallest distance over the rivals counts, without those that no such test tells where one tells others. Where it
    stays below `CLEAR`, floors without a sensor get one, the best first, as long as each is worth it.
    """
    if not rivals:
        return None
    size = accepted.scale.floor_mass
    masses = sorted({min(part * size, HEAVIEST) for part in PARTS_OF_A_FLOOR})
    rivals = rivals[:MOST_RIVALS]
    tests = [
        (first, floor, mass)
        for first in _first_of_states(accepted, rivals)
        for floor in range(1, accepted.experiment.stories + 1)
        for mass in masses
    ]
    possible: list[tuple[NextTest, Configuration]] = []
    distances = []
    for first, floor, mass in tests:
        try:
            said = _said(accepted, rivals, first, floor, mass)
        except NoModesError:
            # A model buckles under this mass; nobody would test it.
            continue
        possible.append((NextTest(floor, mass, first.state, 0.0), first))
        distances.append([each.at(first.measured_floors - 1) for each in said])
    if not possible:
        return None
    distance = np.array(distances)
    separable = distance.max(axis=0) >= WORTHWHILE
    if separable.any():
        rivals = [rival for rival, tells in zip(rivals, separable, strict=True) if tells]
        distance = distance[:, separable]
    found = [
        (dataclasses.replace(test, standard_deviations=float(nearest), tells_all=bool(separable.all())), first)
        for (test, first), nearest in zip(possible, distance.min(axis=1), strict=True)
    ]
    # The first of equals: the state, floor and mass that come first.
    found = ranking.ranked(found, lambda each: each[0].standard_deviations)
    best = found[0][0]
    if best.standard_deviations < CLEAR:
        more = [_with_sensors(accepted, rivals, test, first) for test, first in found[:PROMISING]]
        best = ranking.ranked([best, *more], lambda test: test.standard_deviations)[0]
    return best if best.standard_deviations >= WORTHWHILE else None


def _first_of_states(accepted: Estimate, rivals: Sequence[Estimate]) -> list[Configuration]:
    """List the first configuration of each state that can be tested again and that the models disagree on.

    Where states are declared, that is the last one in the file: what was changed between two states cannot be undone
    for a test. Tests without a declared state are of one frame that still stands: of the first of all then too.
    """
    tests = accepted.experiment.configurations
    firsts = {each.state: each for each in reversed(tests)}
    if accepted.experiment.frame.reference is not None or any(each.state != each.name for each in tests):
        return [firsts[next(state for state in reversed(accepted.experiment.states) if state in firsts)]]
    mine = set(accepted.effects)
    parted = {placed.place.state for rival in rivals for placed in mine.symmetric_difference(rival.effects)}
    return [first for state, first in firsts.items() if state in parted or state == tests[0].state]


def _said(
    accepted: Estimate, rivals: Sequence[Estimate], first: Configuration, floor: int, mass: float
) -> list[Disagreement]:
    """Compare what the accepted model and each rival say of a configuration with this mass more."""
    added = first.added_mass.copy()
    added[floor - 1] += mass
    test = imagined(accepted, first, added)
    return [disagreement(accepted, rival, test, first) for rival in rivals]


def _smallest_distance(said: Sequence[Disagreement], floors: Ints) -> float:
    """Count the standard deviations between the accepted model and the nearest rival with sensors at these floors."""
    return min(each.at(floors) for each in said)


def _with_sensors(accepted: Estimate, rivals: Sequence[Estimate], test: NextTest, first: Configuration) -> NextTest:
    """Add sensors to a test at more floors, one after the other, while each is needed and worth it."""
    if not first.measured.any():
        # Frequencies alone: there are no sensors to add one to.
        return test
    said = _said(accepted, rivals, first, test.floor, test.added_mass)
    floors = first.measured_floors - 1
    distance = test.standard_deviations
    while distance < CLEAR:
        bare = np.setdiff1d(np.arange(accepted.experiment.stories), floors)
        tried = [(_smallest_distance(said, np.union1d(floors, floor)), floor) for floor in bare]
        if not tried or max(tried)[0] < WORTH_A_SENSOR * distance:
            break
        distance, floor = max(tried)
        floors = np.union1d(floors, floor)
    if len(floors) == len(first.measured_floors):
        return test
    return dataclasses.replace(
        test, standard_deviations=distance, measured_floors=tuple(int(floor) + 1 for floor in floors)
    )
