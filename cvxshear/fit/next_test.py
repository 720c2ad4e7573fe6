"""Proposal of the next test: the added mass and state that distinguish the rivals best."""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from cvxshear.data import Frequencies, Shapes
from cvxshear.fit import gaussian, misfit
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.results import NextTest
from cvxshear.measurement.configuration import DEFAULT_MODE_SHAPE_STD
from cvxshear.measurement.experiment import Configuration
from cvxshear.util import errors, ranking
from cvxshear.util.typing import Floats

#: Candidate added masses, as fractions of the mean floor mass.
PARTS_OF_A_FLOOR = (0.1, 0.25, 0.5, 1.0)

#: Largest added mass on one floor, kg: a practical limit for a test.
HEAVIEST = 1000.0

#: Smallest distance, in standard deviations, of a test that is proposed.
WORTHWHILE = 1.0


def next_test(accepted: Estimate, rivals: Sequence[Estimate]) -> NextTest | None:
    """Find the added mass whose test best distinguishes an accepted model from its rivals.

    The accepted model simulates the test for each testable state (the last of declared states), each floor and several
    masses, with the sensors and noise of the state's first configuration. The result is compared with the prediction of
    each rival (`fit/gaussian.py`).

    The criterion is the smallest distance over the rivals. Rivals that no such test distinguishes do not count if other
    rivals can be distinguished.
    """
    if not rivals or accepted.experiment.frame.turns:
        return None
    size = accepted.scale.floor_mass
    masses = sorted({min(part * size, HEAVIEST) for part in PARTS_OF_A_FLOOR})
    floors = range(1, accepted.experiment.stories + 1)
    possible: list[NextTest] = []
    distances = []
    for first, floor, mass in itertools.product(_first_of_states(accepted, rivals), floors, masses):
        added = first.added_mass.copy()
        added[floor - 1] += mass
        try:
            test = imagined(accepted, first, added)
            distances.append([distance(accepted, rival, test, first) for rival in rivals])
        except errors.NoModesError:
            # A model buckles under this mass, so the test is not proposed.
            continue
        possible.append(NextTest(floor, mass, first.state, 0.0))
    apart = np.array(distances)
    if not apart.size:
        return None
    separable = apart.max(axis=0) >= WORTHWHILE
    if not separable.any():
        return None
    nearest = apart[:, separable].min(axis=1)
    # Among equal tests, take the first by state, floor and mass.
    best = ranking.first_largest(nearest)
    if nearest[best] < WORTHWHILE:
        return None
    return dataclasses.replace(
        possible[best], standard_deviations=float(nearest[best]), tells_all=bool(separable.all())
    )


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


def distance(accepted: Estimate, rival: Estimate, test: Configuration, first: Configuration) -> float:
    """Count the standard deviations between the predictions of two fits for a test.

    Parameters
    ----------
    accepted, rival : Estimate
        Fits of one frame.
    test : Configuration
        Test from `imagined`.
    first : Configuration
        The configuration that it repeats with other masses, with the same sensors.

    Raises
    ------
    NoModesError
        If a model buckles under these masses.
    """
    models = [misfit.tested_model(each.experiment, test, each.effects, each.theta) for each in (accepted, rival)]
    mine, other = (misfit.data_rows(test, model) for model in models)
    floors = first.measured_floors - 1
    seen = np.zeros(test.mode_shapes.shape, dtype=bool)
    seen[:, floors] = first.measured
    columns = [(other.r - mine.r)[:, None], _carried(mine.J, accepted), _carried(other.J, rival)]
    rows = misfit.ExpectedTest(test, np.hstack(columns), seen, not first.mass_normalized).at(floors)
    return float(np.sqrt(gaussian.separation(rows[:, :1], rows[:, 1:])[0, 0]))


def imagined(accepted: Estimate, first: Configuration, added_mass: Floats) -> Configuration:
    """Make a configuration with these masses, measured at every floor as a fit predicts.

    Parameters
    ----------
    accepted : Estimate
    first : Configuration
        Configuration with the state, modes and noise of the test.
    added_mass : ndarray, shape (N,)
        kg, in all.

    Raises
    ------
    NoModesError
        If the model buckles under these masses.
    """
    noise = accepted.misfit.noise
    blank = dataclasses.replace(first, name="next test", added_mass=added_mass, repeats=None)
    model = misfit.tested_model(accepted.experiment, blank, accepted.effects, accepted.theta)
    frequencies, shapes = misfit.predicted_modes(blank, model)
    measured = dataclasses.replace(
        blank, mode_shapes=np.where(first.measured, shapes[:, first.measured_floors - 1], np.nan)
    )
    frequency = 1.0 if first.frequency_std is not None else noise.of(Frequencies.noise.name)
    shape = 1.0 if first.mode_shape_std is not None else noise.of(Shapes.noise.name)
    stds = frequency * first.log_frequency_std, shape * _relative_std(measured, shapes)
    return misfit.expected_configuration(blank, frequencies, shapes, *stds)


def _relative_std(measured: Configuration, shapes: Floats) -> Floats:
    """Return the standard deviations of entries over their mode's largest, (m, N); the default where none is known."""
    std = np.full(shapes.shape, DEFAULT_MODE_SHAPE_STD)
    largest = np.max(np.abs(shapes), axis=1, keepdims=True)
    std[:, measured.measured_floors - 1] = np.where(
        measured.measured, measured.entry_std / largest, DEFAULT_MODE_SHAPE_STD
    )
    return std


def _carried(J: Floats, estimate: Estimate) -> Floats:
    """Return the changes of predictions by the uncertainty of a fit, one standard deviation per column."""
    values, axes = np.linalg.eigh(estimate.uncertainty.covariance())
    result: Floats = J @ (axes * np.sqrt(np.maximum(values, 0.0)))
    return result
