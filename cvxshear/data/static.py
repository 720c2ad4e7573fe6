"""A static pull or tilt test: known forces, measured displacements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cvxshear.data.base import Datum, Deviation, ErrorFigure, Model, NoiseKind, Residual, largest
from cvxshear.measurement.declaration import DEFAULT_DISPLACEMENT_STD
from cvxshear.measurement.experiment import Experiment, StaticTest
from cvxshear.util.typing import Floats, Ints


@dataclass(frozen=True, eq=False)
class Static(Datum):
    """r = (K^-1 f - measured u) / std, with du = -K^-1 dK u.

    Parameters
    ----------
    tested : StaticTest
    """

    noise = NoiseKind(
        "displacement", "displacements", DEFAULT_DISPLACEMENT_STD, 0.15,
        "dial gauges and load cells are good to 1 % of the largest reading; 15 % is a wire's slack or a soft support",
        (ErrorFigure("max_displacement_error", "largest displacement error", "displacement_error", largest),),
        negligible=1e-4,
    )  # fmt: skip
    tested: StaticTest

    @classmethod
    def of(cls, experiment: Experiment) -> Sequence[Static]:
        """List the static tests."""
        return [cls(each) for each in experiment.static]

    @property
    def count(self) -> int:
        """Number of measured displacements."""
        return len(self.floors)

    @property
    def floors(self) -> Ints:
        """Floors with a measured displacement."""
        return np.flatnonzero(self.tested.measured) + 1

    def residual(self, model: Model) -> Residual:
        """Differences of displacements over their standard deviations, measured floors only."""
        test, known = self.tested, self.tested.measured
        system = model.wanted
        weights = 1.0 / test.entry_std[known]
        u = _moved(system.K, test.force)
        n = len(test.force)
        r = weights * (u[:n] - test.displacement)[known]
        if not model.derivatives:
            return Residual(r, np.zeros((0, 0)))
        slopes: Floats = -linalg.solve(system.K, system.stiffness_slopes(u).T, assume_a="sym")
        return Residual(r, weights[:, None] * slopes[:n][known])

    def errors(self, model: Model) -> Mapping[str, Floats]:
        """model / measured - 1, relative to the largest measured displacement."""
        test, known = self.tested, self.tested.measured
        u = _moved(model.state.system.K, test.force)[: len(test.force)]
        return {"displacement_error": (u - test.displacement)[known] / np.max(np.abs(test.displacement[known]))}

    def describe(self, model: Model) -> list[Deviation]:
        """Describe each measured floor."""
        errors, r = self.errors(model)["displacement_error"], self.residual(model).r
        return [
            Deviation(self.noise.name, self.tested.name, f"floor {floor}", float(error), float(z))
            for floor, error, z in zip(self.floors, errors, r, strict=True)
        ]


def _moved(K: Floats, force: Floats) -> Floats:
    """Displacements of all motions under forces on the floors, which come first, m."""
    load = np.concatenate([force, np.zeros(len(K) - len(force))])
    return np.asarray(linalg.solve(K, load, assume_a="sym"))
