"""Frequencies predicted from data that did not hold them: what an effect cannot pass by adding freedom alone."""

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
"""Largest change of the logarithm of a frequency along a direction left open, for the prediction to count."""

USEFUL = 0.1
"""Largest relative standard deviation of a prediction, for it to count."""

MOST_PREDICTIONS = 24
"""Predictions that are made: every one is a fit, and a tall frame has many modes."""

Errors = dict[tuple[str, int], float]
"""|predicted / measured - 1| by configuration and place of the frequency in it."""


def held_out_frequency_errors(before: Estimate, after: Estimate, fitter: Fitter) -> tuple[float | None, float | None]:
    """Largest |predicted / measured - 1| over the same frequencies left out in turn, by either model.

    Each configuration's frequencies are predicted from the others, or each mode's from the other modes where there is
    one configuration. An effect that concerns one state cannot be judged by the others, nor another by tests of one
    such state, nor a frequency that the rest does not determine under both models.

    Returns
    -------
    before, after : float or None
        None for both where no frequency could be predicted by both.
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
    """List what is left out, one after the other: a configuration and modes of it."""
    configurations = experiment.configurations
    if len(configurations) > 1:
        alone = [each for each in configurations if _judged(each, experiment, concerned)]
        return [(each.name, np.ones(len(each.frequencies), dtype=bool)) for each in alone][:MOST_PREDICTIONS]
    (only,) = configurations
    rows = list(np.eye(len(only.frequencies), dtype=bool))
    return [(only.name, row) for row in rows][:MOST_PREDICTIONS] if len(only.frequencies) > 1 else []


def _judged(test: Configuration, experiment: Experiment, concerned: set[str | None]) -> bool:
    """Whether the other tests can judge one: of a state without effects, and not from one state that has some."""
    states = {each.state for each in experiment.configurations if each is not test}
    return test.state not in concerned and (len(states) > 1 or not states <= concerned)


def _prediction_errors(estimate: Estimate, name: str, mask: Bools, fitter: Fitter) -> Errors:
    """Predict the errors of the left-out frequencies that the rest determines."""
    misfit = Misfit(
        estimate.experiment, estimate.effects, {name: mask}, estimate.misfit.noise, estimate.misfit.expectation
    )
    fitter.fits += 1
    try:
        rest = fitted_with(misfit, estimate.theta, fitter.backend)
    except CvxshearError:
        # No prediction can be made from the rest; what can be predicted elsewhere still counts.
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
