"""Closing the loop: from the shear model to the effects that it lacks, and their probabilities."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import Effect, LocatedEffect, Scale
from cvxshear.effects.state import heights_of
from cvxshear.fit.domain import EffectPrior
from cvxshear.fit.efficient import Estimate, efficient
from cvxshear.loop.comparison import verdict_fits
from cvxshear.loop.conclusion import conclude
from cvxshear.loop.hypotheses import Hypothesis, Numbering, able_to_take_part, assumed_effects, chosen, hypotheses
from cvxshear.loop.posterior import Posterior
from cvxshear.loop.results import LoopResult
from cvxshear.loop.search import Search
from cvxshear.loop.searches import Searches
from cvxshear.loop.verdicts import VERDICTS
from cvxshear.measurement.experiment import Experiment, Measurement, opened
from cvxshear.measurement.reading import without_repeated
from cvxshear.priors import Prior
from cvxshear.util.errors import InputError, UnsuitableError
from cvxshear.util.typing import Floats

MOST_WIDENINGS = 3
"""Largest number of times that the noise is widened for an unexplained residual: wider noise changes the best set."""


def search_for_effects(
    experiment: Measurement,
    effects: Sequence[str | Effect] | None = None,
    assume: Sequence[str | LocatedEffect] = (),
    backend: str | Backend = "auto",
    priors: Sequence[Prior] = (),
    *,
    jobs: int = 1,
) -> LoopResult:
    """Find the effects that the shear model lacks, without screening the measurement first.

    `cvxshear.close_loop` has the same parameters; it screens the measurement and then calls this function.
    """
    experiment, repeated = without_repeated(opened(experiment).with_priors(tuple(priors)))
    wanted, left_out = able_to_take_part(chosen(effects), experiment)
    solver = backends.get(backend)
    assumed = _declared(experiment, solver, assumed_effects(experiment, assume))
    declared = searches = _prepared(experiment, solver, wanted, assumed, jobs)
    found = searches.run(experiment)
    messages = (
        *(f'"{name}" repeats "{same}" to the last digit: both count as one test' for name, same in repeated),
        *(f"an effect was left out: {message}" for message in left_out),
    )
    result = _concluded(found, found, wanted, messages)
    for _ in range(MOST_WIDENINGS):
        if not VERDICTS[result.verdict].provisional or not (excess := _excess(result)):
            break
        # The residual refutes the noise, so the evidence is invalid: judge the sets again under sufficient noise.
        searches = dataclasses.replace(searches, widened=searches.widened * excess)
        again = searches.run(experiment)
        numbered = [each.fitter.numbering.changes for each in found]
        # Only the wider noise makes these mode numbers probable: report their fit under the declared noise.
        new = {each.fitter.numbering.changes: each.fitter.numbering for each in again}
        found += [declared.start_search(each) for changes, each in new.items() if changes not in numbered]
        result = _concluded(found, again, wanted, messages)
    return result


def _concluded(
    found: Sequence[Search], judging: Sequence[Search], wanted: Sequence[Effect], messages: Sequence[str]
) -> LoopResult:
    """Weigh the visited sets of some searches, make the fits of their verdict, and conclude.

    Parameters
    ----------
    found : sequence of Search
        First the search with the modes numbered as given, then those with other numberings.
    judging : sequence of Search
        The same, or searches under noise so wide that the residual is probable.
    wanted : sequence of Effect
    messages : sequence of str
    """
    models = [model for each in judging for model in (*each.visited.values(), *each.other_optima)]
    posterior = Posterior(models, found[0].fitter.hypotheses)
    fits = verdict_fits(judging, posterior.within(posterior.numberings[0].changes), found[0].fitter)
    fitters = list(dict.fromkeys(each.fitter for each in (*found, *judging)))
    effort = sum(each.fits for each in fitters), sum(each.programs for each in fitters)
    return conclude(fits, posterior, wanted, messages=messages, effort=effort)


def start_search(experiment: Experiment, assumed: tuple[LocatedEffect, ...] = ()) -> Search:
    """Begin a search over the whole catalogue with the fit of the shear model; no effect is tried.

    Parameters
    ----------
    experiment : Experiment
    assumed : tuple of LocatedEffect, optional
        Effects that the model holds from the start.

    Raises
    ------
    CvxshearError
        If the shear model could not be fitted.
    """
    return _prepared(experiment, backends.get("auto"), chosen(None), assumed).start_search(Numbering(experiment))


def _prepared(
    experiment: Experiment, solver: Backend, wanted: Sequence[Effect], assumed: tuple[LocatedEffect, ...], jobs: int = 1
) -> Searches:
    """Fit the shear model, and collect the settings that all searches share."""
    looked_for = hypotheses(experiment, wanted, assumed)
    start = _first(experiment, solver, assumed)
    return Searches(solver, assumed, looked_for, _expectation(experiment, start.theta, looked_for), start, jobs)


def _excess(result: LoopResult) -> float | None:
    """Return the factor on the noise that makes the residual probable; None if the residual is probable already."""
    judged = result.judged
    return float(np.sqrt(judged.fit.at.chi2 / max(judged.dof, 1))) if judged.improbable else None


def _first(experiment: Experiment, backend: Backend, assumed: tuple[LocatedEffect, ...]) -> Estimate:
    """Make the first fit on the requested backend, so that a failing backend is found at once.

    Another backend replaces it only if the requested one does not accept such programs (active inequalities).
    """
    try:
        return efficient(experiment, backend, assumed)
    except UnsuitableError:
        if backend.name == "auto":
            raise
        return efficient(experiment, backends.get("auto"), assumed)


def _declared(
    experiment: Experiment, backend: Backend, assumed: tuple[LocatedEffect, ...]
) -> tuple[LocatedEffect, ...]:
    """Return the assumed effects; an effect that these data do not determine is held at its starting value."""
    if not assumed:
        return assumed
    found = _first(experiment, backend, assumed)
    known = found.uncertainty.determined
    return tuple(
        placed if np.all(known[found.own(placed)]) else LocatedEffect(placed.effect, placed.place, placed.start)
        for placed in assumed
    )


def _expectation(experiment: Experiment, theta: Floats, looked_for: Sequence[Hypothesis]) -> EffectPrior:
    """Collect the priors of effects and frame, in units of a typical floor and story of a first fit."""
    n = experiment.stories
    mass, stiffness = np.median(theta[:n]), np.median(theta[n : 2 * n])
    scale = Scale(float(mass), float(stiffness), heights_of(experiment))
    stds = {
        item.placed: item.placed.effect.expecting(size=item.size).expected_sizes(scale)
        for item in looked_for
        if item.size is not None
    }
    found = EffectPrior(scale, stds)
    for item in looked_for:
        for parameter, std in zip(item.placed.effect.parameters, found.of(item.placed), strict=True):
            if np.isinf(std) and np.isinf(parameter.upper - parameter.lower):
                raise InputError(
                    f"nothing says how large {parameter.name} of the effect {item.placed.effect.name} may be: give the "
                    "effect `sizes`, or the parameter finite bounds"
                )
    return found
