"""Frequencies predicted from data that did not hold them: what an effect cannot pass by adding freedom alone."""

from __future__ import annotations

import numpy as np

from cvxshear.effects import compose
from cvxshear.effects.composition import slices
from cvxshear.errors import CvxshearError
from cvxshear.frame import mode_derivatives, modes
from cvxshear.identification.efficient import Estimate
from cvxshear.identification.misfit import Misfit
from cvxshear.loop.fitter import Fitter
from cvxshear.typing import Bools

DETERMINED = 1e-3
"""Largest change of the logarithm of a frequency along a direction left open, for the prediction to count."""

USEFUL = 0.1
"""Largest relative standard deviation of a prediction, for it to count."""


def held_out_frequency_error(estimate: Estimate, fitter: Fitter) -> float | None:
    """Largest |predicted / measured - 1| over the frequencies left out in turn.

    Each configuration's frequencies are predicted from the others, or each mode's from the other modes where
    there is one configuration. Effects of the left-out configuration alone are unknown to the others and not
    used for it. A frequency that the remaining data do not determine is passed over.

    Returns
    -------
    float or None
        None where no frequency could be predicted.
    """
    errors = [error for name, mask in _left_out(estimate) for error in _prediction_errors(estimate, name, mask, fitter)]
    return max(errors) if errors else None


def _left_out(estimate: Estimate) -> list[tuple[str, Bools]]:
    """Configuration and the modes of it that are left out, one after the other."""
    configurations = estimate.experiment.configurations
    if len(configurations) > 1:
        return [(each.name, np.ones(len(each.frequencies), dtype=bool)) for each in configurations]
    (only,) = configurations
    return [(only.name, row) for row in np.eye(len(only.frequencies), dtype=bool)] if len(only.frequencies) > 1 else []


def _prediction_errors(estimate: Estimate, name: str, mask: Bools, fitter: Fitter) -> list[float]:
    """|predicted / measured - 1| of the left-out frequencies that the rest determines."""
    whole = len(estimate.experiment.configurations) > 1
    kept = [placed for placed in estimate.effects if not (whole and placed.place.configuration == name)]
    n = estimate.experiment.stories
    own = [at for placed, at in slices(estimate.effects, 2 * n) if placed in kept]
    start = np.concatenate([estimate.theta[: 2 * n], *(estimate.theta[at] for at in own)])
    try:
        rest = fitter.fit(Misfit(estimate.experiment, kept, {name: mask}), start)
    except CvxshearError:
        # No prediction can be made from the rest; what can be predicted elsewhere still counts.
        return []
    configuration = next(each for each in estimate.experiment.configurations if each.name == name)
    state = compose(estimate.experiment, configuration, kept, rest.theta)
    found = modes(state.system.M, state.system.K)
    which = (configuration.modes[mask] - 1).tolist()
    gradient = mode_derivatives(found, state.system, which)[0] / (2 * found.eigenvalues[which])
    open_change = np.abs(gradient * np.abs(rest.theta)[:, None])[~rest.uncertainty.determined].sum(axis=0)
    noise = rest.noise_scale if np.isfinite(rest.noise_scale) else 1.0
    variance = np.einsum("pm,pq,qm->m", gradient, rest.uncertainty.covariance(noise), gradient)
    error = np.abs(found.frequencies[which] / configuration.frequencies[mask] - 1.0)
    return [float(value) for value in error[(open_change <= DETERMINED) & (variance <= USEFUL**2)]]
