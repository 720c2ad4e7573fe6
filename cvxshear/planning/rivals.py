"""One test more: the masses, and the floors, that best tell rival models of one frame apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cvxshear import checks
from cvxshear.effects import compose
from cvxshear.errors import InputError, NoModesError
from cvxshear.frame import mode_derivatives, modes
from cvxshear.identification.efficient import Estimate
from cvxshear.planning.masses import Limits
from cvxshear.planning.model import blank_test
from cvxshear.planning.noise import Declared, TestNoise
from cvxshear.typing import Floats, Ints, Json

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


@dataclass(frozen=True, eq=False)
class _Prediction:
    """What a model says of a test, in standard deviations of the noise.

    Parameters
    ----------
    frequencies : ndarray, shape (m,)
        Logarithms.
    shapes : ndarray, shape (N, m)
        At every floor.
    d_frequencies, d_shapes : ndarray, shapes (m, q) and (N, m, q)
        Changes by what the fit leaves uncertain, a column a standard deviation.
    """

    frequencies: Floats
    shapes: Floats
    d_frequencies: Floats
    d_shapes: Floats

    def at(self, floors: Ints, unit: Floats) -> tuple[Floats, Floats]:
        """Values, and their changes, at these floors, without what lies along the unit shapes: the scale is free."""
        shapes, changes = self.shapes[floors], self.d_shapes[floors]
        shapes = shapes - unit * np.sum(unit * shapes, axis=0)
        changes = changes - unit[:, :, None] * np.einsum("jm,jmq->mq", unit, changes)
        values = np.concatenate([self.frequencies, shapes.ravel()])
        return values, np.concatenate([self.d_frequencies, changes.reshape(-1, changes.shape[2])])


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
    noise = noise or Declared(float(first.log_frequency_std.mean()), _usual_shape_std(rivals[0]))
    floors = first.measured_floors - 1
    best: tuple[float, Floats, Ints] | None = None
    for masses in limits.grid():
        try:
            said = [_predicted(each, masses, first.modes - 1, noise) for each in rivals]
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


def _usual_shape_std(estimate: Estimate) -> float:
    """Standard deviation of an entry, of shapes with a largest entry of 1, that the first configuration declares."""
    first = estimate.experiment.configurations[0]
    largest = np.nanmax(np.abs(np.where(first.measured, first.mode_shapes, np.nan)), axis=1, initial=0.0)
    known = largest > 0
    return float(np.mean(first.entry_std[known] / largest[known, None])) if np.any(known) else Declared().mode_shape_std


def _predicted(estimate: Estimate, masses: Floats, which: Ints, noise: TestNoise) -> _Prediction:
    """What a fit predicts for a test with these masses."""
    state = compose(estimate.experiment, blank_test(masses, "next test"), estimate.effects, estimate.theta)
    found = modes(state.system.M, state.system.K)
    dlam, dphi = mode_derivatives(found, state.system, which)
    frequency_std, shape_std = noise.of(found, np.diag(state.system.M).copy(), which)
    psi = found.shapes[which].T * state.gain[:, None]
    dpsi = dphi.transpose(2, 1, 0) * state.gain[:, None, None]
    dpsi += (psi / state.gain[:, None])[:, :, None] * state.d_gain.T[:, None, :]
    weight = 1.0 / (np.max(np.abs(psi), axis=0) * shape_std)
    values, axes = np.linalg.eigh(estimate.uncertainty.covariance())
    root = axes * np.sqrt(np.maximum(values, 0.0))
    return _Prediction(
        0.5 * np.log(found.eigenvalues[which]) / frequency_std,
        psi * weight,
        (dlam / (2 * found.eigenvalues[which]) / frequency_std).T @ root,
        (dpsi * weight[:, None]) @ root,
    )


def _apart(said: Sequence[_Prediction], floors: Ints) -> float:
    """The smallest distance of two predictions at these floors."""
    return min(_distance(a, b, floors) for a, b in combinations(said, 2))


def _distance(a: _Prediction, b: _Prediction, floors: Ints) -> float:
    shapes = a.shapes[floors]
    length = np.linalg.norm(shapes, axis=0)
    unit = shapes / np.where(length > 0, length, 1.0)
    # The sign of a mode is free, as its scale is.
    scale = np.sum(unit * b.shapes[floors], axis=0) / np.where(length > 0, length, 1.0)
    scale = np.where(scale != 0, scale, 1.0)
    scaled = _Prediction(b.frequencies, b.shapes / scale, b.d_frequencies, b.d_shapes / scale[:, None])
    (mine, my_changes), (other, other_changes) = a.at(floors, unit), scaled.at(floors, unit)
    spread = np.eye(len(mine)) + my_changes @ my_changes.T + other_changes @ other_changes.T
    d = other - mine
    return float(np.sqrt(d @ np.linalg.solve(spread, d)))


def _best_floors(said: Sequence[_Prediction], sensors: int, start: Ints) -> Ints:
    """So many floors at which the predictions are farthest apart, by exchanges."""
    n = len(said[0].shapes)
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
