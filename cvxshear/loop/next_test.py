"""Proposal of the next test: added mass, state and sensors that distinguish the rivals best."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.data import Frequencies, Shapes
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.gaussian import separation
from cvxshear.fit.misfit import ExpectedTest, data_rows, expected_configuration, predicted_modes, tested_model
from cvxshear.measurement.configuration import DEFAULT_MODE_SHAPE_STD
from cvxshear.measurement.experiment import Configuration
from cvxshear.util import ranking
from cvxshear.util.errors import NoModesError
from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats, Ints

PARTS_OF_A_FLOOR = (0.1, 0.25, 0.5, 1.0)
"""Candidate added masses, as fractions of the mean floor mass."""

HEAVIEST = 1000.0
"""Largest added mass on one floor, kg: a practical limit for a test."""

MOST_RIVALS = 4
"""Number of rival sets that a test should distinguish from the accepted set, the most probable first."""

WORTHWHILE = 1.0
"""Smallest distance, in standard deviations, of a test that is proposed."""

CLEAR = 3.0
"""Sufficient distance, in standard deviations: a test with this distance needs no more sensors."""

WORTH_A_SENSOR = 1.2
"""Smallest factor on the distance that justifies one more sensor."""


@dataclass(frozen=True)
class NextTest(InJson):
    """Test that would distinguish the rivals.

    Parameters
    ----------
    floor : int
    added_mass : float
        Mass on that floor, kg, in addition to the first configuration of its state.
    state : str
        State of the frame in the test.
    standard_deviations : float
        Distance between the predictions of the accepted model and of its nearest rival.
    measured_floors : tuple of int or None
        Floors with a sensor, if sensors are proposed in addition to that configuration; else None.
    tells_all : bool
        Whether some added mass would distinguish every rival from the accepted model.
    """

    floor: int
    added_mass: float
    state: str
    standard_deviations: float
    measured_floors: tuple[int, ...] | None = None
    tells_all: bool = True


def next_test(accepted: Estimate, rivals: Sequence[Estimate]) -> NextTest | None:
    """Find the added mass whose test best distinguishes an accepted model from its rivals, and the required sensors.

    The accepted model simulates the test for each testable state (the last of declared states), each floor and several
    masses, with the sensors and noise of the state's first configuration. The result is compared with the prediction of
    each rival (`fit/gaussian.py`).

    The criterion is the smallest distance over the rivals. Rivals that no such test distinguishes do not count if other
    rivals can be distinguished. If the distance of the best test is below `CLEAR`, more floors receive a sensor,
    the best first, while each sensor is worth its cost.
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
            # A model buckles under this mass, so the test is not proposed.
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
    # Among equal tests, take the first by state, floor and mass.
    found = ranking.ranked(found, lambda each: each[0].standard_deviations)
    best = found[0][0]
    if best.standard_deviations < CLEAR:
        best = _with_sensors(accepted, rivals, *found[0])
    return best if best.standard_deviations >= WORTHWHILE else None


def _first_of_states(accepted: Estimate, rivals: Sequence[Estimate]) -> list[Configuration]:
    """List the first configuration of each state that can be tested again and that distinguishes the models.

    Among declared states, this is the last one in the file, because a change between two states cannot be undone for a
    test. Tests without a declared state are of one frame that still stands, so their first configuration counts too.
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
    """Compare the predictions of the accepted model and each rival for a configuration with this added mass."""
    added = first.added_mass.copy()
    added[floor - 1] += mass
    test = imagined(accepted, first, added)
    return [disagreement(accepted, rival, test, first) for rival in rivals]


def _smallest_distance(said: Sequence[Disagreement], floors: Ints) -> float:
    """Return the number of standard deviations between the accepted model and its nearest rival, with these sensors."""
    return min(each.at(floors) for each in said)


def _with_sensors(accepted: Estimate, rivals: Sequence[Estimate], test: NextTest, first: Configuration) -> NextTest:
    """Add sensors to a test at more floors, one after the other, while each is needed and worth its cost."""
    if not first.measured.any():
        # The test measures frequencies only and has no sensors to extend.
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


@dataclass(frozen=True, eq=False)
class Disagreement:
    """Two fits in a test that was not made.

    Parameters
    ----------
    expected : ExpectedTest
        Its first column is the difference of the predictions, the others the uncertainty of the fits.
    """

    expected: ExpectedTest

    def at(self, floors: Ints) -> float:
        """Count the standard deviations between the fits with sensors at these floors, zero-based."""
        rows = self.expected.at(floors)
        return float(np.sqrt(separation(rows[:, :1], rows[:, 1:])[0, 0]))


def disagreement(accepted: Estimate, rival: Estimate, test: Configuration, first: Configuration) -> Disagreement:
    """Compare the predictions of two fits for a test.

    Parameters
    ----------
    accepted, rival : Estimate
        Fits of one frame.
    test : Configuration
        Test from `imagined`.
    first : Configuration
        The configuration that it repeats with other masses.

    Raises
    ------
    NoModesError
        If a model buckles under these masses.
    """
    mine, other = (
        data_rows(test, tested_model(each.experiment, test, each.effects, each.theta)) for each in (accepted, rival)
    )
    # An entry that was not measured at an instrumented floor will not be measured there again.
    seen = np.full(test.mode_shapes.shape, bool(first.measured.any()))
    seen[:, first.measured_floors - 1] = first.measured
    columns = [(other.r - mine.r)[:, None], _carried(mine.J, accepted), _carried(other.J, rival)]
    return Disagreement(ExpectedTest(test, np.hstack(columns), seen, not first.mass_normalized))


def imagined(accepted: Estimate, first: Configuration, added_mass: Floats) -> Configuration:
    """Make a configuration with these masses, measured at every floor as a fit predicts.

    Parameters
    ----------
    accepted : Estimate
    first : Configuration
        Configuration with the state, modes and noise of the test; floors without a sensor get the mean noise.
    added_mass : ndarray, shape (N,)
        kg, in all.

    Raises
    ------
    NoModesError
        If the model buckles under these masses.
    """
    noise = accepted.misfit.noise
    blank = dataclasses.replace(first, name="next test", added_mass=added_mass)
    model = tested_model(accepted.experiment, blank, accepted.effects, accepted.theta)
    frequencies, shapes = predicted_modes(blank, model)
    measured = dataclasses.replace(
        blank, mode_shapes=np.where(first.measured, shapes[:, first.measured_floors - 1], np.nan)
    )
    frequency = 1.0 if first.frequency_std is not None else noise.of(Frequencies.noise.name)
    shape = 1.0 if first.mode_shape_std is not None else noise.of(Shapes.noise.name)
    stds = frequency * first.log_frequency_std, shape * _everywhere(measured, shapes)
    return expected_configuration(blank, frequencies, shapes, *stds)


def _everywhere(measured: Configuration, shapes: Floats) -> Floats:
    """Return the standard deviations of a mode's entries at every floor over its largest entry, shape (m, N)."""
    std = np.full(shapes.shape, np.nan)
    std[:, measured.measured_floors - 1] = np.where(measured.measured, measured.entry_std, np.nan)
    relative = std / np.max(np.abs(shapes), axis=1, keepdims=True)
    known = np.isfinite(relative)
    if not known.any():
        return np.full(shapes.shape, DEFAULT_MODE_SHAPE_STD)
    overall = float(relative[known].mean())
    own = [float(row[some].mean()) if some.any() else overall for row, some in zip(relative, known, strict=True)]
    return np.where(known, relative, np.array(own)[:, None])


def _carried(J: Floats, estimate: Estimate) -> Floats:
    """Return the changes of predictions by the uncertainty of a fit, one standard deviation per column."""
    values, axes = np.linalg.eigh(estimate.uncertainty.covariance())
    result: Floats = J @ (axes * np.sqrt(np.maximum(values, 0.0)))
    return result
