"""Natural frequencies: their logarithms, each with its standard deviation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.data.base import Datum, Deviation, ErrorFigure, Model, NoiseKind, Residual, largest
from cvxshear.data.pairing import frequency_residual
from cvxshear.measurement.configuration import DEFAULT_FREQUENCY_STD
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.util.typing import Bools, Floats


@dataclass(frozen=True, eq=False)
class Frequencies(Datum):
    """r_j = (log f_j - log measured f_j) / std_j, with dlog f = dlambda / (2 lambda).

    Parameters
    ----------
    tested : Configuration
    used : ndarray of bool, shape (m,)
        Which of its modes count.
    """

    noise = NoiseKind(
        "frequency", "frequencies", DEFAULT_FREQUENCY_STD, 0.03,
        "records of a few minutes give frequencies to 0.1 to 0.5 %; identified by hand they are right to 3 %",
        (
            ErrorFigure("max_frequency_error", "largest frequency error", "frequency_error", largest),
            ErrorFigure(
                "rms_frequency_error", "frequency error, root mean square", "frequency_error",
                lambda errors: np.sqrt(np.mean(errors**2)),
            ),
        ),
        negligible=1e-5,
    )  # fmt: skip
    tested: Configuration
    used: Bools

    @classmethod
    def of(cls, experiment: Experiment) -> Sequence[Frequencies]:
        """List the frequencies of each configuration."""
        return [cls(each, np.ones(len(each.frequencies), dtype=bool)) for each in experiment.configurations]

    @property
    def count(self) -> int:
        """Number of modes that count."""
        return int(np.sum(self.used))

    def residual(self, model: Model) -> Residual:
        """Differences of logarithms over the standard deviation of the logarithm."""
        logs, std = np.log(2 * np.pi * self.tested.frequencies[self.used]), self.tested.log_frequency_std[self.used]
        slopes = model.mode_derivatives[0][:, self.used] if model.derivatives else None
        return Residual(*frequency_residual(logs, model.modes.eigenvalues[model.paired][self.used], std, slopes))

    def errors(self, model: Model) -> Mapping[str, Floats]:
        """model / measured - 1 of each frequency."""
        modelled = model.modes.frequencies[model.paired][self.used]
        return {"frequency_error": modelled / self.tested.frequencies[self.used] - 1.0}

    def without(self, left_out: Bools) -> Frequencies:
        """Leave out these modes."""
        return Frequencies(self.tested, self.used & ~left_out)

    def describe(self, model: Model) -> list[Deviation]:
        """Describe each mode."""
        errors, r = self.errors(model)["frequency_error"], self.residual(model).r
        modes = self.tested.modes[self.used]
        return [
            Deviation(self.noise.name, self.tested.name, f"mode {mode}", float(error), float(z))
            for mode, error, z in zip(modes, errors, r, strict=True)
        ]
