"""One test more: the masses, and the floors, that best tell rival models of one frame apart."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cvxshear.data.pairing import numbered
from cvxshear.effects import compose
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.separation import Disagreement, disagreement, imagined
from cvxshear.measurement.experiment import Configuration
from cvxshear.model.shear import modes
from cvxshear.planning.masses import Limits
from cvxshear.planning.noise import TestNoise
from cvxshear.util import checks
from cvxshear.util.errors import InputError, NoModesError
from cvxshear.util.typing import Floats, Ints, Json

WORTHWHILE = 1.0
"""Standard deviations below which no test is proposed."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """A test that would tell rivals apart.

    Parameters
    ----------
    added_mass : ndarray, shape (N,)
        kg, in all.
    measured_floors : ndarray of int, shape (n,)
        1 the lowest.
    standard_deviations : float
        How far the predictions of the two models lie apart that are hardest to tell from each other.
    """

    added_mass: Floats
    measured_floors: Ints
    standard_deviations: float

    def to_dict(self) -> Json:
        """The fields by name."""
        return {
            "added_mass": self.added_mass.tolist(),
            "measured_floors": self.measured_floors.tolist(),
            "standard_deviations": self.standard_deviations,
        }


def best_test(
    rivals: Sequence[Estimate],
    limits: Limits,
    *,
    sensors: int | None = None,
    noise: TestNoise | None = None,
) -> Proposal | None:
    """The test whose outcome the rivals disagree on most; None where they hardly do in any.

    For each pair the difference d of the predictions is weighed with the noise and with what the fits leave uncertain,

        D^2 = d' (1 + J_a C_a J_a' + J_b C_b J_b')^-1 d,

    all in standard deviations of the noise, and the smallest D of all pairs counts.

    Parameters
    ----------
    rivals : sequence of Estimate
        Of one frame, two or more.
    limits : Limits
        What the laboratory can add.
    sensors : int, optional
        Choose so many floors; those of the first configuration where not given.
    noise : TestNoise, optional
        As the first configuration declares it where not given.

    Raises
    ------
    InputError
        Where there are fewer than two rivals.
    """
    if len(rivals) < 2:
        raise InputError(f"a test that tells rivals apart needs two of them, not {len(rivals)}")
    first = rivals[0].experiment.configurations[0]
    floors = first.measured_floors - 1
    best: tuple[float, Floats, Ints] | None = None
    for masses in limits.grid():
        try:
            test = _test(rivals[0], first, masses, noise)
            said = [disagreement(a, b, test, first) for a, b in combinations(rivals, 2)]
        except NoModesError:
            # A model buckles under these masses; nobody would test them.
            continue
        here = floors if sensors is None else _best_floors(said, sensors, floors)
        apart = _apart(said, here)
        if best is None or apart > best[0] * (1 + 1e-9):
            best = apart, masses, here
    if best is None or best[0] < WORTHWHILE:
        return None
    return Proposal(best[1], best[2] + 1, best[0])


def _test(expected: Estimate, first: Configuration, masses: Floats, noise: TestNoise | None) -> Configuration:
    """A test with these masses as a fit predicts it, with the noise asked for."""
    test = imagined(expected, first, masses)
    if noise is None:
        return test
    state = compose(expected.experiment, test, expected.effects, expected.theta, derivatives=False)
    found = modes(state.system.M, state.system.K)
    frequency_std, shape_std = noise.of(found, np.diag(state.system.M).copy(), numbered(test, found, state.system.M))
    return dataclasses.replace(test, frequency_std=frequency_std, mode_shape_std=shape_std)


def _apart(said: Sequence[Disagreement], floors: Ints) -> float:
    """The smallest distance of two predictions at these floors."""
    return min(each.at(floors) for each in said)


def _best_floors(said: Sequence[Disagreement], sensors: int, start: Ints) -> Ints:
    """So many floors at which the predictions are farthest apart, by exchanges."""
    n = said[0].shapes.shape[1]
    checks.whole(sensors, "sensors", least=1, most=n)
    spare = [j for j in range(n - 1, -1, -1) if j not in start]
    chosen = sorted([*start, *spare][:sensors])
    value = _apart(said, np.array(chosen))
    while True:
        others = [j for j in range(n) if j not in chosen]
        neighbours = [sorted([*(i for i in chosen if i != out), into]) for out in chosen for into in others]
        values = [_apart(said, np.array(each)) for each in neighbours]
        if not values or max(values) <= value * (1 + 1e-9):
            return np.array(chosen)
        value, chosen = max(values), neighbours[int(np.argmax(values))]
