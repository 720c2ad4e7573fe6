"""From the visited sets to the verdict and the reported result."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from scipy import special

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import Effect, LocatedEffect
from cvxshear.effects.masses import LoadScale
from cvxshear.fit.efficient import Estimate, fitted_with, parameter_names
from cvxshear.fit.gauss_newton import ROUGH
from cvxshear.loop.fitter import Fitter, ModelClass, with_stand_in
from cvxshear.loop.held_out import held_out_frequency_errors
from cvxshear.loop.hypotheses import OPEN, Hypothesis
from cvxshear.loop.linear import Linearised
from cvxshear.loop.next_test import next_test
from cvxshear.loop.numbering import OVERLOOKED, NumberingProbability
from cvxshear.loop.posterior import ADDED, RIVAL, Posterior
from cvxshear.loop.residual import where_it_sits
from cvxshear.loop.results import AddedEffect, Candidate, EffectSet, LoopResult, Step
from cvxshear.loop.search import Search, fits_alike
from cvxshear.loop.searches import dual_fits_as_well, dual_set
from cvxshear.measurement.experiment import Experiment
from cvxshear.util import ranking
from cvxshear.util.errors import NoModesError, NoSolutionError
from cvxshear.util.quantities import SURE, listed, significant

NUMBERED = 1.0 - 2.0 * OVERLOOKED
"""Smallest probability of the given mode numbers if the shear model is called adequate. Data without information on the
numbers keep their prior probability, which suffices."""

REPORTED = 1e-3
"""Smallest probability of a reported set."""

LITTLE_GAINED = 1.1
"""Smallest ratio of precisions, with the data and without, for an effect that the data distinguish from the frame."""

AT_AN_END = 1e-3
"""Largest distance of a parameter on a bound from this bound, in prior standard deviations."""


def conclude(
    searches: Sequence[Search],
    looked_for: Sequence[Hypothesis],
    wanted: Sequence[Effect],
    *,
    said: Sequence[str] = (),
    widened: Sequence[Search] = (),
) -> LoopResult:
    """Reach the verdict on the visited sets.

    Parameters
    ----------
    searches : sequence of Search
        First the search with the modes numbered as given, then those with other numberings.
    looked_for : sequence of Hypothesis
    wanted : sequence of Effect
        Effects that the user requested.
    said : sequence of str, optional
        Messages about tests and effects that were left out.
    widened : sequence of Search, optional
        Searches under noise so wide that the residual is probable, if no set explains the residual under the given
        noise. These searches judge the effects, and the sizes of the effects are provisional then.
    """
    judging = widened or searches
    models = [model for each in judging for model in (*each.visited.values(), *each.other_optima)]
    posterior = Posterior(models, looked_for)
    numbering = posterior.numberings[0]
    # Each numbering of the modes has its own effects, so the verdict uses one numbering for all of them.
    here = posterior.within(numbering.changes)
    search, found = _fit_of_verdict(judging, here)
    twins = _twins(search, found, here)
    posterior, here = posterior.with_twins(twins), here.with_twins(twins)
    fitter = search.fitter
    judged = found.estimate
    assert judged is not None, "a set without a fit has no probability"
    final = judged
    if widened:
        final = fitter.fit(judged.misfit.replaced(widened=1.0), judged.theta)
    steps = _steps(final, posterior, fitter, searches[0].fitter)
    added = tuple(_added(posterior, judged, placed) for placed in _by_probability(posterior, judged, fitter))
    significant = final.improbable
    negligible = significant and _negligible(final)
    fits = {model.effects: model.estimate for model in reversed(here.models)}
    rivals = [estimate for rival in _rival_sets(here, added) if (estimate := fits[rival]) is not None]
    return LoopResult(
        experiment=fitter.experiment,
        backend=fitter.backend.name,
        verdict=_verdict(added, here, numbering, final, unexplained=significant and not negligible),
        rests_on=(
            *_rests_on(final),
            *dict.fromkeys(
                (
                    *_granted(search, found),
                    *_granted_of_the_scale(search, found),
                    *_granted_of_bounds(fitter.experiment),
                )
            ),
        ),
        steps=steps,
        judged=judged,
        effects=added,
        assumed=fitter.assumed,
        numberings=tuple(each for each in posterior.numberings if each.probability >= REPORTED),
        models=tuple(_shown_sets(posterior)),
        averaged=posterior.averaged(),
        candidates=tuple(_candidates(posterior, search, found)),
        not_considered={each.name: lack for each in wanted if (lack := each.lacks(fitter.experiment))},
        remains=tuple(where_it_sits(final)) if significant and not negligible else (),
        information=(*said, *_information(search, posterior, judged, negligible=negligible)),
        next_test=next_test(judged, rivals),
        fits=sum(each.fitter.fits for each in (*searches, *widened)),
        programs=sum(each.fitter.programs for each in (*searches, *widened)),
    )


def _fit_of_verdict(searches: Sequence[Search], posterior: Posterior) -> tuple[Search, ModelClass]:
    """Find the set of the verdict, fitted to full accuracy, and the search with its best fit."""
    own = [each for each in searches if each.fitter.numbering.changes == posterior.best.changes]
    wanted = posterior.verdict_set()
    for each in own:
        each.fit_of(wanted)
    best = ranking.ranked(own, lambda each: each.visited[wanted].score, same=ranking.SAME_ODDS)[0]
    return best, best.visited[wanted]


def _twins(search: Search, found: ModelClass, posterior: Posterior) -> dict[LocatedEffect, list[LocatedEffect]]:
    """List the twins of each effect of a set: exact twins, and the dual if only frequencies were measured."""
    experiment = search.fitter.experiment
    twins = {placed: search.twins(found, placed) for placed in found.effects}
    if not dual_fits_as_well(experiment):
        return twins
    known = [item.placed for item in search.fitter.hypotheses]
    alike = [model.effects for model in posterior.models if fits_alike(model, found)]
    if dual_set(found.effects, known, experiment.stories) in alike:
        for placed in found.effects:
            other = dual_set(frozenset([placed]), known, experiment.stories)
            twins[placed] += [each for each in other or () if each not in (placed, *twins[placed])]
    return twins


def _by_probability(posterior: Posterior, final: Estimate, fitter: Fitter) -> list[LocatedEffect]:
    return posterior.ranked(placed for placed in final.effects if placed not in fitter.assumed)


def _verdict(
    added: Sequence[AddedEffect],
    posterior: Posterior,
    numbering: NumberingProbability,
    final: Estimate,
    *,
    unexplained: bool,
) -> str:
    if unexplained:
        return "unexplained"
    if not added and not numbering.changes:
        answered = final.dof > 0 and numbering.probability >= NUMBERED and posterior.something() < ADDED
        return "adequate" if answered else "ambiguous"
    sure = min([numbering.probability, *(item.probability for item in added)]) >= SURE
    twins = any(rival.twin for item in added for rival in item.rivals)
    if not sure or twins or final.dof <= 0:
        return "ambiguous"
    return "located" if any(item.placed.effect.kind == OPEN for item in added) else "explained"


def _negligible(final: Estimate) -> bool:
    """Whether the errors of all kinds of data are negligible; a kind without an error measure is not negligible."""
    errors = final.quality.errors
    kinds = final.misfit.noises.values()
    return all(kind.leading is not None and (errors[kind.leading.key] or 0.0) < kind.negligible for kind in kinds)


def _steps(final: Estimate, posterior: Posterior, fitter: Fitter, as_given: Fitter) -> tuple[Step, ...]:
    """List the fits: the shear model, the modes numbered otherwise if they are, then one more effect at a time.

    The most probable effect comes first. All fits use the noise of the last one.
    """
    order = _by_probability(posterior, final, fitter)
    what = "the shear model" if fitter is as_given else "the shear model, the modes numbered as given"
    if fitter.assumed:
        what += f" with {', '.join(placed.label for placed in fitter.assumed)} assumed"
    ways: list[tuple[str, Callable[[], Estimate]]] = [(what, lambda: _in_noise_of(final, [], as_given))]
    if fitter is not as_given:
        ways.append(("with the modes numbered otherwise", lambda: _in_noise_of(final, [], fitter)))
    for count, placed in enumerate(order, 1):
        ways.append((f"with {placed.label}", partial(_in_noise_of, final, order[:count], fitter)))
    estimates = [*(make() for _, make in ways[:-1]), final]
    left_out = held_out_frequency_errors(estimates[0], final, fitter)
    errors = [left_out[0], *[None] * (len(ways) - 2), left_out[1]] if len(ways) > 1 else [left_out[1]]
    return tuple(
        Step(estimate, what, estimate.p_value, error)
        for (what, _), estimate, error in zip(ways, estimates, errors, strict=True)
    )


def _in_noise_of(final: Estimate, effects: Sequence[LocatedEffect], fitter: Fitter) -> Estimate:
    """Fit the model with only some of the effects, in the final model's noise.

    Start at the final parameters. If the model has no real modes there, or the modes are numbered otherwise, start at
    the frame without effects.
    """
    wanted = (*fitter.assumed, *effects)
    base = fitter.base or final
    first = final if final.experiment is fitter.experiment else base
    proposals = [
        dataclasses.replace(
            proposal, misfit=proposal.misfit.replaced(noise=final.misfit.noise, widened=final.misfit.widened)
        )
        for proposal in (fitter.proposal(start, wanted) for start in (first, base))
    ]
    misfit = proposals[0].misfit
    fitter.fits += 1

    def fit(by: Backend) -> Estimate:
        try:
            return fitted_with(misfit, proposals[0].starts[0], by)
        except NoModesError:
            return fitted_with(misfit, proposals[1].starts[0], by)

    try:
        return with_stand_in(fitter.backend, fit)[0]
    except NoSolutionError:
        # Far from the data a fit may follow an endless curved valley; a rough fit is accurate enough for a comparison.
        return fitted_with(misfit, proposals[1].starts[0], backends.get("auto"), ROUGH)


def _added(posterior: Posterior, final: Estimate, placed: LocatedEffect) -> AddedEffect:
    values, errors = final.theta[final.own(placed)], posterior.deviations_about(final, placed)
    names = [item.name for item in placed.effect.parameters]
    parameters = dict(zip(names, values.tolist(), strict=True))
    std = {name: None if np.isnan(error) else float(error) for name, error in zip(names, errors, strict=True)}
    said = placed.effect.phrase(placed.place, values, errors, final.scale, placed.units(final.experiment))
    if placed.effect.rescales:
        factor = final.noise.of(placed.label) or {}
        parameters, std = {"factor": factor["factor"]}, {"factor": factor["std"]}
        said = f"{said}: {significant(factor['factor'], 2)} times"
    return AddedEffect(
        placed,
        posterior.of_effects[placed],
        parameters,
        std,
        said,
        tuple(posterior.rivals(placed)),
        tuple(_remarks(final, placed)),
    )


def _remarks(final: Estimate, placed: LocatedEffect) -> Iterator[str]:
    """List the parameters that lie on a physical bound."""
    stds = final.misfit.expectation.of(placed)
    for item, value, std in zip(placed.effect.parameters, final.theta[final.own(placed)], stds, strict=True):
        size = std if np.isfinite(std) else item.upper - item.lower
        for bound, word in ((item.lower, "lower"), (item.upper, "upper")):
            if np.isfinite(bound) and abs(value - bound) <= AT_AN_END * size:
                yield f"{item.name} is at the {word} end of what is physical"


def _rival_sets(posterior: Posterior, added: Sequence[AddedEffect]) -> list[frozenset[LocatedEffect]]:
    """List the sets that hold a rival in place of an added effect, twins first."""
    effects = frozenset(item.placed for item in added)
    twins = [(effects - {item.placed}) | {rival.placed} for item in added for rival in item.rivals if rival.twin]
    visited = {model.effects for model in posterior.models}
    found = [each for each in twins if each in visited]
    if any(item.rivals for item in added):
        least = RIVAL * float(posterior.probabilities[0])
        found += [
            model.effects
            for model, probability in zip(posterior.models[1:], posterior.probabilities[1:], strict=True)
            if probability >= least and not effects <= model.effects
        ]
    return list(dict.fromkeys(found))


def _shown_sets(posterior: Posterior) -> Iterator[EffectSet]:
    sums = defaultdict[object, float](float)
    for model, probability in zip(posterior.models, posterior.of_sets, strict=True):
        sums[model.effects, model.changes] += float(probability)
    # A set may explain the data with two frames: only the better fit is shown.
    best = {(model.effects, model.changes): model for model in reversed(posterior.models)}
    for key in ranking.ranked(best, sums.__getitem__):
        model = best[key]
        if sums[key] >= REPORTED and model.estimate is not None:
            order = tuple(placed for placed in model.estimate.effects if placed in model.effects)
            yield EffectSet(order, min(sums[key], 1.0), model.log_evidence, model.estimate.chi2, model.changes)


def _candidates(posterior: Posterior, search: Search, judged: ModelClass) -> list[Candidate]:
    """List all effects that were looked for, the most probable first."""
    final, fitter = judged.estimate, search.fitter
    assert final is not None, "the set of the verdict has a fit"
    there = set(final.effects)
    linear = search.linearised(judged)
    unseen = _unseen(linear, fitter, judged)
    names = parameter_names(final.experiment, final.effects)
    found = []
    for item in fitter.hypotheses:
        placed = item.placed
        count = len(placed.effect.parameters)
        confounded: tuple[str, ...] = ()
        if placed in there:
            kept = [each for each in final.effects if each is not placed and each not in fitter.assumed]
            gain, chi2, dof = _in_noise_of(final, kept, fitter).chi2 - final.chi2, final.chi2, final.dof
        elif placed not in linear.candidates:
            # The derivatives at the null value carry no information on the effect here.
            gain, chi2, dof = 0.0, final.chi2, final.dof - count
        else:
            gain = linear.decrease(placed)
            chi2, dof = final.chi2 - gain, final.dof - count
            if linear.precision_gained(placed) < LITTLE_GAINED and posterior.keeps_odds(placed):
                confounded = linear.confounders(placed, names)
        p_value = min(1.0, len(fitter.hypotheses) * float(special.chdtrc(count, max(gain, 0.0))))
        probability = posterior.of_effects[placed]
        if judged.effects | {placed} not in search.visited:
            probability += (1.0 - probability) * unseen.get(placed, 0.0)
        found.append(Candidate(placed, probability, item.probability, chi2, dof, p_value, confounded))
    order = posterior.ranked((each.placed for each in found), {each.placed: each.probability for each in found})
    return sorted(found, key=lambda each: (order.index(each.placed) if each.probability else len(order), each.chi2))


def _unseen(linear: Linearised, fitter: Fitter, judged: ModelClass) -> dict[LocatedEffect, float]:
    """Find the probability of each further effect beside a set, from the model linearised at the set.

    The search fits only promising effects. An effect with too small an influence to detect keeps its prior probability;
    an effect that was not fitted never gets a larger one.
    """
    log_odds = fitter.log_priors(linear.candidates, judged.effects) + np.minimum(linear.gains, 0.0)
    return dict(zip(linear.candidates, special.expit(log_odds).tolist(), strict=True))


def _quoted(names: Sequence[str]) -> str:
    return listed([f'"{name}"' for name in names])


def _rests_on(final: Estimate) -> Iterator[str]:
    """Yield the basis of the verdict: the noise that the residual is compared with."""
    if final.dof <= 0:
        yield "nothing that could speak against it: the model has as many parameters as there are data"
        return
    if not final.misfit.open_noises:
        yield "the stated standard deviations"
        return
    # The noise of the misfit is not used: it has no factor if the fit stopped at the default.
    factors = dict(final.noise.noise.factors)
    listed = ", ".join(
        f"{kind.replace('_', ' ')} {factors[kind]:.2g} times the default" for kind in final.misfit.open_noises
    )
    partly = len(final.misfit.open_noises) < len(final.misfit.noises)
    yield f"{'stated and ' if partly else ''}estimated noise ({listed})"


def _granted(search: Search, found: ModelClass) -> Iterator[str]:
    """Yield the assumptions of the verdict that the data hardly test: sentences of effects that are not in the set."""
    states = {placed.place.state for placed in found.effects} | {None}
    said = [each for each in search.candidates(found) if each.effect.granted and each.place.state in states]
    if not said:
        return
    linear = search.linearised(found)
    untold = defaultdict[str, list[str]](list)
    for placed in said:
        # Only effects with such sentences count as alternatives. Changes of single stories or floors do not, because
        # their sum is the effect itself.
        alike = [other for other in said if other.place.state == placed.place.state]
        if linear.undetermined(placed, alike):
            said_of = placed.effect.granted.replace("{prior}", str(placed.place.prior))
            untold[said_of].append(str(placed.place.state))
    for statement, names in untold.items():
        yield statement.format(state=_quoted(names))


def _granted_of_the_scale(search: Search, found: ModelClass) -> Iterator[str]:
    """Yield the quantities that all masses scale with, unless an exact total mass is declared."""
    experiment = search.fitter.experiment
    if experiment.frame.known_total is not None and experiment.frame.total_mass_std is None:
        return
    loaded = any(np.any(each.added_mass) for each in experiment.configurations)
    if loaded and not any(placed.effect.name == LoadScale.name for placed in found.effects):
        yield LoadScale.granted
    if any(each.mass_normalized and each.measured.any() for each in experiment.configurations):
        yield "that forces and motions were measured in right proportion, which is that of all masses"


def _granted_of_bounds(experiment: Experiment) -> Iterator[str]:
    """Yield the inequalities that hold in every visited model."""
    for words, prior in experiment.stated.items():
        said = prior.constraints(experiment.stories)
        if any(part is not None for part in (said.lower, said.upper, said.G)):
            yield f'that "{words}" holds, as declared'


def _information(search: Search, posterior: Posterior, final: Estimate, *, negligible: bool) -> Iterator[str]:
    """Yield further messages for the reader."""
    experiment, fitter = search.fitter.experiment, search.fitter
    n = experiment.stories
    if negligible:
        yield (
            "the residual is significant but negligible: frequencies are off by "
            f"{final.quality.max_frequency_error:.1g} at most, less than anybody needs"
        )
    named = [each.name for each in experiment.configurations if each.other_modes]
    if named and all(not each.changes for each in posterior.numberings if each.probability >= REPORTED):
        yield f"the modes of {_quoted(named)} are those given: that they are the other ones named is hardly probable"
    if not final.noise.settled:
        yield "the estimate of the standard deviations that nobody declared did not settle; its last value is used"
    if search.spent:
        yield f"the search ended after {len(search.visited)} sets of effects; sets that it did not visit may be better"
    if not final.fit.converged:
        yield f"the final fit did not converge ({final.fit.reason}); its numbers are where it stopped"
    for placed in posterior.untold():
        yield f"{placed.label}: these data tell nothing of it, its odds are what they were before"
    failed = [model for model in search.visited.values() if model.failure is not None]
    if failed:
        yield f"{len(failed)} of {len(search.visited)} sets of effects could not be fitted ({failed[0].failure})"
    if fitter.stand_ins:
        yield f"{fitter.stand_ins} of {fitter.fits} fits that {fitter.backend.name} refused were made by auto"
    if experiment.frame.story_heights is None and any(placed.effect.uses_heights for placed in final.effects):
        yield "story heights are not declared and taken as equal; lengths count in stories"
    for effect in {item.placed.effect.name: item.placed.effect for item in fitter.hypotheses}.values():
        if effect.name not in {placed.effect.name for placed in final.effects}:
            said = effect.known_anyway(experiment, final.theta[:n], final.theta[n : 2 * n])
            if said:
                yield said
