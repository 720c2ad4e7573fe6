"""Errors of a model: frequency and shape errors, and the chi-square of the residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import special

from cvxshear.data import Datum, Model, noise_kinds
from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats


@dataclass(frozen=True)
class Quality(InJson):
    """Errors of a model, relative and not in percent.

    Parameters
    ----------
    errors : mapping of str to float or None
        Every error figure that a kind of data declares, by its key; None if the kind was not measured.
    chi2 : float
        Sum of squared standardized residuals, soft priors included.
    dof : int
        Number of data less number of free parameters.
    p_value : float or None
        p-value of chi2, if the noise is declared and a degree of freedom is left.
    """

    json_keys: ClassVar[str] = "*errors chi2 dof p_value"

    errors: Mapping[str, float | None]
    chi2: float
    dof: int
    p_value: float | None

    @property
    def max_frequency_error(self) -> float:
        """Largest |model / measured - 1| of a frequency."""
        return self.errors["max_frequency_error"] or 0.0

    @property
    def rms_frequency_error(self) -> float:
        """Root mean square of model / measured - 1 of the frequencies."""
        return self.errors["rms_frequency_error"] or 0.0

    @property
    def min_mac(self) -> float | None:
        """Smallest modal assurance criterion; None if no shape was measured at two floors."""
        return self.errors["min_mac"]

    @property
    def max_shape_error(self) -> float | None:
        """Largest difference of a shape entry; None without measured shapes.

        The measured mode is scaled to a largest entry of 1 and the model's to it by least squares.
        """
        return self.errors["max_shape_error"]

    @property
    def max_displacement_error(self) -> float | None:
        """Largest difference of a displacement over the largest of its test; None without measured displacements."""
        return self.errors["max_displacement_error"]


def quality(data: Sequence[Datum], models: Sequence[Model], chi2: float, dof: int, *, declared: bool) -> Quality:
    """Compute the errors of a model.

    Parameters
    ----------
    data : sequence of Datum
    models : sequence of Model
        One a tested state.
    chi2 : float
    dof : int
    declared : bool
        Whether every standard deviation is declared, so that chi2 has a chi-square distribution.
    """
    by_tested = {id(model.state.tested): model for model in models}
    found: dict[str, list[Floats]] = {}
    for datum in data:
        for name, values in datum.errors(by_tested[id(datum.tested)]).items():
            found.setdefault(name, []).append(values)
    errors: dict[str, float | None] = {}
    for figure in (each for kind in noise_kinds().values() for each in kind.figures):
        values = np.concatenate(found.get(figure.errors, [np.zeros(0)]))
        errors[figure.key] = float(figure.statistic(values)) if values.size else None
    p_value = float(special.chdtrc(dof, chi2)) if declared and dof > 0 else None
    return Quality(errors, chi2, dof, p_value)
