"""How far a model is from the measurement: errors that an engineer reads, and the chi-square of the residual."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass

import numpy as np
from scipy import stats

from cvxshear.identification.misfit import Match, Misfit, Target
from cvxshear.typing import Floats, Json


@dataclass(frozen=True)
class Quality:
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
    """

    max_frequency_error: float
    rms_frequency_error: float
    min_mac: float | None
    max_shape_error: float | None
    chi2: float
    dof: int
    p_value: float | None

    def to_dict(self) -> Json:
        """The fields by name."""
        return asdict(self)


def quality(misfit: Misfit, matches: Iterable[Match], chi2: float, dof: int) -> Quality:
    """The errors of a model whose matches these are.

    Parameters
    ----------
    misfit : Misfit
    matches : iterable of Match
        One a configuration.
    chi2 : float
    dof : int
    """
    frequency, macs, shapes = [], [], []
    for target, match in zip(misfit.targets, matches, strict=True):
        frequency.append(frequency_errors(target, match))
        for measured, modelled, weight in zip(target.shapes, match.seen, target.weights, strict=True):
            known = weight > 0
            if known.sum() > 1:
                macs.append(mac(measured[known], modelled[known]))
            if known.any():
                shapes.append(shape_error(measured[known], modelled[known]))
    errors = np.concatenate(frequency)
    declared = misfit.experiment.noise_declared
    return Quality(
        max_frequency_error=float(np.max(np.abs(errors))),
        rms_frequency_error=float(np.sqrt(np.mean(errors**2))),
        min_mac=min(macs) if macs else None,
        max_shape_error=max(shapes) if shapes else None,
        chi2=chi2,
        dof=dof,
        p_value=float(stats.chi2.sf(chi2, dof)) if declared and dof > 0 else None,
    )


def frequency_errors(target: Target, match: Match) -> Floats:
    """model / measured - 1, shape (m,)."""
    return match.modes.frequencies[match.paired] / np.exp(target.log_frequencies) - 1.0


def mac(a: Floats, b: Floats) -> float:
    """Modal assurance criterion of two shapes, (a'b)^2 / (a'a b'b)."""
    return float((a @ b) ** 2 / ((a @ a) * (b @ b)))


def shape_error(measured: Floats, modelled: Floats) -> float:
    """Largest difference, the measured shape scaled to a largest entry of 1, the model's to it by least squares."""
    unit = measured / measured[np.argmax(np.abs(measured))]
    return float(np.max(np.abs(modelled * (unit @ modelled) / (modelled @ modelled) - unit)))
