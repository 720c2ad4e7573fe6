"""Fits that a verdict is read from: the set of the verdict, the models before it, and held-out data.

The frequencies of a configuration are predicted from data that exclude them, before and after effects were added: a
test that mere extra freedom does not pass.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cvxshear import backends
from cvxshear.data.base import paired
from cvxshear.effects import LocatedEffect, compose
from cvxshear.fit import other_frames
from cvxshear.fit.efficient import Estimate, fitted_with
from cvxshear.fit.gauss_newton import FULL, HOPELESS, ROUGH
from cvxshear.fit.misfit import Misfit
from cvxshear.loop.fitter import Fitter, ModelClass, with_stand_in
from cvxshear.loop.posterior import Posterior
from cvxshear.loop.results import Step
from cvxshear.loop.search import Search
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model import mode_derivatives, modes
from cvxshear.util import errors, ranking
from cvxshear.util.typing import Bools

#: Largest relative standard deviation of a prediction that counts; an undetermined direction counts with its length.
USEFUL = 0.1

#: |predicted / measured - 1| by configuration and place of the frequency in it.
Errors = dict[tuple[str, int], float]


@dataclass(frozen=True, eq=False)
class VerdictFits:
    """Fits of the set of the verdict and of the sets that it is compared with.

    Parameters
    ----------
    search : Search
        Search with the best fit of this set.
    model : ModelClass
        The set, fitted to full accuracy.
    final : Estimate
        Its fit under the declared noise.
    steps : tuple of Step
    chi2_without : dict of LocatedEffect to float
        Chi-square without each effect of the set, in the noise of the final fit.
    equivalents : list of Estimate
        Fits of the set with other frames that fit the same data.
    searched : str
        What was searched for them, in words; empty if the data determine the frame.
    """

    search: Search
    model: ModelClass
    final: Estimate
    steps: tuple[Step, ...]
    chi2_without: dict[LocatedEffect, float]
    equivalents: list[Estimate]
    searched: str

    @property
    def judged(self) -> Estimate:
        """Fit that determines the effects; under wider noise if the residual is unexplained."""
        return self.model.estimate


def verdict_fits(searches: Sequence[Search], posterior: Posterior, as_given: Search) -> VerdictFits:
    """Fit the set of the verdict, the models before it, and the set without each of its effects.

    Parameters
    ----------
    searches : sequence of Search
    posterior : Posterior
        Under the most probable numbering of the modes.
    as_given : Search
        Search with the modes numbered as given.
    """
    own = [each for each in searches if each.fitter.numbering.changes == posterior.best.changes]
    wanted = posterior.verdict_set()
    for each in own:
        each.fit_of(wanted)
    search = ranking.ranked(own, lambda each: each.visited[wanted].score, same=ranking.SAME_ODDS)[0]
    model, fitter = search.visited[wanted], search.fitter
    final = judged = model.estimate
    if judged.misfit.noise_inflation != 1.0:
        final = fitter.fit(judged.misfit.replaced(noise_inflation=1.0), judged.theta)
    effects = [placed for placed in judged.effects if placed not in fitter.assumed]
    steps = _steps(final, posterior.ranked(effects), search, as_given)
    chi2_without = {
        placed: _in_noise_of(judged, [each for each in effects if each is not placed], search).chi2
        for placed in effects
    }
    equivalents = other_frames.equivalent_fits(judged, backends.get("auto"))
    return VerdictFits(search, model, final, steps, chi2_without, *equivalents)


def _steps(final: Estimate, order: Sequence[LocatedEffect], search: Search, as_given: Search) -> tuple[Step, ...]:
    """List the fits: the shear model, the modes numbered otherwise if they are, then one more effect at a time.

    The most probable effect comes first. All fits use the noise of the last one.
    """
    fitter = search.fitter
    otherwise = bool(fitter.numbering.changes)
    what = "the symmetric model" if fitter.experiment.symmetric else "the shear model"
    what += ", the modes numbered as given" if otherwise else ""
    if fitter.assumed:
        what += f" with {', '.join(placed.label for placed in fitter.assumed)} assumed"
    ways = [(what, order[:0], as_given if otherwise else search)]
    if otherwise:
        ways.append(("with the modes numbered otherwise", order[:0], search))
    ways += [(f"with {placed.label}", order[:count], search) for count, placed in enumerate(order, 1)]
    estimates = [*(_in_noise_of(final, effects, by) for _, effects, by in ways[:-1]), final]
    left_out = held_out_frequency_errors(estimates[0], final, fitter)
    held_out = [left_out[0], *[None] * (len(ways) - 2), left_out[1]] if len(ways) > 1 else [left_out[1]]
    return tuple(
        Step(estimate, what, estimate.p_value, error)
        for (what, *_), estimate, error in zip(ways, estimates, held_out, strict=True)
    )


def _in_noise_of(final: Estimate, effects: Sequence[LocatedEffect], search: Search) -> Estimate:
    """Fit the model with only some of the effects, in the final model's noise.

    Start at the fit of this set, at the final parameters or at the frame without effects, at the nearest first.
    """
    fitter, known = search.fitter, search.visited.get(frozenset(effects))
    near = [known.estimate] if known is not None else []
    near += [final, search.base.estimate] if final.experiment is fitter.experiment else [search.base.estimate]
    noise, inflation = final.misfit.noise, final.misfit.noise_inflation
    starts = []
    for each in near:
        proposal = fitter.proposal(each, (*fitter.assumed, *effects))
        misfit = proposal.misfit.replaced(noise=noise, noise_inflation=inflation)
        with contextlib.suppress(errors.NoModesError):
            starts.append((misfit.evaluate(proposal.starts[-1]), misfit, proposal.starts[-1]))
    starts = ranking.ranked(starts, lambda start: -start[0].objective)
    fitter.fits += 1
    failure: errors.CvxshearError = errors.NoModesError("a set of fewer effects has no modes at any starting point")
    # Far from the data a fit may follow an endless curved valley; a rough fit is accurate enough there.
    for (at, misfit, theta), accuracy in (*((each, FULL) for each in starts), *((each, ROUGH) for each in starts[:1])):
        by = partial(fitted_with, misfit, theta, accuracy=accuracy, start=at)
        try:
            return with_stand_in(fitter.backend, by)[0]
        except (errors.NoModesError, errors.NoSolutionError) as error:
            failure = error
    raise failure


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
        return [(each.name, np.ones(len(each.frequencies), dtype=bool)) for each in alone]
    (only,) = configurations
    rows = list(np.eye(len(only.frequencies), dtype=bool))
    return [(only.name, row) for row in rows] if len(only.frequencies) > 1 else []


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
    far_off = estimate.chi2 > HOPELESS * estimate.fit.at.measured
    try:
        rest = fitted_with(misfit, estimate.theta, fitter.backend, ROUGH if far_off else FULL)
    except errors.CvxshearError:
        # The remaining data allow no prediction here; predictions elsewhere still count.
        return {}
    if not rest.fit.converged:
        return {}
    configuration = next(each for each in estimate.experiment.configurations if each.name == name)
    state = compose(estimate.experiment, configuration, estimate.effects, rest.theta)
    found = modes(state.system.M, state.system.K)
    motions = estimate.experiment.motions.count
    which = paired(configuration, found, state.observation, state.system.M, motions)[mask]
    gradient = mode_derivatives(found, state.system, which)[0] / (2 * found.eigenvalues[which])
    open_change = np.abs(gradient * np.abs(rest.theta)[:, None])[~rest.uncertainty.determined].sum(axis=0)
    variance = np.einsum("pm,pq,qm->m", gradient, rest.uncertainty.covariance(), gradient)
    error = np.abs(found.frequencies[which] / configuration.frequencies[mask] - 1.0)
    counts = np.sqrt(variance) + open_change <= USEFUL
    places = np.flatnonzero(mask).tolist()
    return {(name, place): float(value) for place, value, good in zip(places, error, counts, strict=True) if good}
