"""Prediction of frequencies from data that exclude them: a test that mere extra freedom does not pass."""

from __future__ import annotations

import numpy as np

from cvxshear.data.pairing import numbered
from cvxshear.effects import compose
from cvxshear.fit.efficient import Estimate, fitted_with
from cvxshear.fit.misfit import Misfit
from cvxshear.loop.fitter import Fitter
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model.shear import mode_derivatives, modes
from cvxshear.util.errors import CvxshearError
from cvxshear.util.typing import Bools

DETERMINED = 1e-3
"""Largest change of the log frequency along an undetermined direction for a prediction that counts."""

USEFUL = 0.1
"""Largest relative standard deviation of a prediction that counts."""

MOST_PREDICTIONS = 24
"""Largest number of predictions: each is a fit, and a tall frame has many modes."""

Errors = dict[tuple[str, int], float]
"""|predicted / measured - 1| by configuration and place of the frequency in it."""


def held_out_frequency_errors(before: Estimate, after: Estimate, fitter: Fitter) -> tuple[float | None, float | None]:
    """Return the largest |predicted / measured - 1| of either model over the same frequencies, left out in turn.

    Each configuration's frequencies are predicted from the other configurations; with one configuration, each mode's
    from the other modes. A configuration is left out only if no effect concerns its state, and only if the others are
    not all of one state with an effect. A frequency counts only if the remaining data determine it under both models.

    Returns
    -------
    before, after : float or None
        None for both if no frequency could be predicted by both models.
    """
    concerned = {placed.place.state for placed in (*before.effects, *after.effects)}
    pairs = [
        (_prediction_errors(before, name, mask, fitter), _prediction_errors(after, name, mask, fitter))
        for name, mask in _left_out(before.experiment, concerned)
    ]
    both = [(b[key], a[key]) for b, a in pairs for key in b if key in a]
    if not both:
        return None, None
    return max(b for b, _ in both), max(a for _, a in both)


def _left_out(experiment: Experiment, concerned: set[str | None]) -> list[tuple[str, Bools]]:
    """List the data to leave out, one after the other: a configuration and some of its modes."""
    configurations = experiment.configurations
    if len(configurations) > 1:
        alone = [each for each in configurations if _judged(each, experiment, concerned)]
        return [(each.name, np.ones(len(each.frequencies), dtype=bool)) for each in alone][:MOST_PREDICTIONS]
    (only,) = configurations
    rows = list(np.eye(len(only.frequencies), dtype=bool))
    return [(only.name, row) for row in rows][:MOST_PREDICTIONS] if len(only.frequencies) > 1 else []


def _judged(test: Configuration, experiment: Experiment, concerned: set[str | None]) -> bool:
    """Whether the other tests can judge a test.

    The state of the test must have no effects, and the other tests must not all be of one state with effects.
    """
    states = {each.state for each in experiment.configurations if each is not test}
    return test.state not in concerned and (len(states) > 1 or not states <= concerned)


def _prediction_errors(estimate: Estimate, name: str, mask: Bools, fitter: Fitter) -> Errors:
    """Return the prediction errors of the left-out frequencies that the remaining data determine."""
    misfit = Misfit(
        estimate.experiment, estimate.effects, {name: mask}, estimate.misfit.noise, estimate.misfit.expectation
    )
    fitter.fits += 1
    try:
        rest = fitted_with(misfit, estimate.theta, fitter.backend)
    except CvxshearError:
        # The remaining data allow no prediction here; predictions elsewhere still count.
        return {}
    if not rest.fit.converged:
        return {}
    configuration = next(each for each in estimate.experiment.configurations if each.name == name)
    state = compose(estimate.experiment, configuration, estimate.effects, rest.theta)
    found = modes(state.system.M, state.system.K)
    which = numbered(configuration, found, state.system.M)[mask]
    gradient = mode_derivatives(found, state.system, which)[0] / (2 * found.eigenvalues[which])
    open_change = np.abs(gradient * np.abs(rest.theta)[:, None])[~rest.uncertainty.determined].sum(axis=0)
    variance = np.einsum("pm,pq,qm->m", gradient, rest.uncertainty.covariance(), gradient)
    error = np.abs(found.frequencies[which] / configuration.frequencies[mask] - 1.0)
    counts = (open_change <= DETERMINED) & (variance <= USEFUL**2)
    places = np.flatnonzero(mask).tolist()
    return {(name, place): float(value) for place, value, good in zip(places, error, counts, strict=True) if good}
