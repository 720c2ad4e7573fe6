"""How far a model is from the measurement: errors that an engineer reads, and the chi-square of the residual."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from cvxshear.data import Datum, Model
from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats


@dataclass(frozen=True)
class Quality(InJson):
    """Errors of a model, relative and not in percent.

    Parameters
    ----------
    max_frequency_error : float
        Largest |model / measured - 1|.
    rms_frequency_error : float
        Root mean square of model / measured - 1.
    min_mac : float or None
        Smallest modal assurance criterion; None where no shape was measured at two floors.
    max_shape_error : float or None
        Largest difference of a shape entry, the measured mode scaled to a largest entry of 1 and the model's
        to it by least squares; None where no shape was measured.
    chi2 : float
        Sum of squared standardized residuals, soft priors included.
    dof : int
        Number of data less number of free parameters.
    p_value : float or None
        Of chi2, where the noise is declared and a degree of freedom is left.
    max_displacement_error : float or None
        Largest difference of a displacement over the largest of its test; None where none was measured.
    """

    max_frequency_error: float
    rms_frequency_error: float
    min_mac: float | None
    max_shape_error: float | None
    chi2: float
    dof: int
    p_value: float | None
    max_displacement_error: float | None = None


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
        Whether chi2 is one, every standard deviation having been declared.
    """
    by_tested = {id(model.state.tested): model for model in models}
    errors: dict[str, list[Floats]] = {}
    for datum in data:
        for name, values in datum.errors(by_tested[id(datum.tested)]).items():
            errors.setdefault(name, []).append(values)
    found = {name: np.concatenate(values) for name, values in errors.items()}
    frequency = found.get("frequency_error", np.zeros(0))
    return Quality(
        max_frequency_error=float(np.max(np.abs(frequency), initial=0.0)),
        rms_frequency_error=float(np.sqrt(np.mean(frequency**2))) if frequency.size else 0.0,
        min_mac=_extreme(found, "mac", np.min),
        max_shape_error=_extreme(found, "shape_error", np.max),
        chi2=chi2,
        dof=dof,
        p_value=float(stats.chi2.sf(chi2, dof)) if declared and dof > 0 else None,
        max_displacement_error=_extreme(found, "displacement_error", lambda values: np.max(np.abs(values))),
    )


def _extreme(found: dict[str, Floats], name: str, of: Callable[[Floats], float]) -> float | None:
    values = found.get(name)
    return None if values is None or not values.size else float(of(values))
