"""From the visited sets to the verdict and the reported result, without any further fit."""

import dataclasses
from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import special

from cvxshear.effects import Effect, LocatedEffect, masses
from cvxshear.fit import next_test, other_frames
from cvxshear.fit.efficient import Estimate, parameter_names
from cvxshear.loop import comparison, hypotheses, results
from cvxshear.loop.fitter import ModelClass
from cvxshear.loop.posterior import ADDED, RIVAL, Posterior, counted_from_the_first
from cvxshear.loop.search import REPORTED, Search, fits_alike
from cvxshear.measurement.experiment import Experiment
from cvxshear.util import quantities, ranking

#: Smallest probability of the given mode numbers if the shear model is called adequate. Data without information on the
#: numbers keep their prior probability, which suffices.
NUMBERED = 1.0 - 2.0 * hypotheses.OVERLOOKED

#: Smallest ratio of precisions, with the data and without, for an effect that the data distinguish from the frame.
LITTLE_GAINED = 1.1

#: Largest distance of a parameter on a bound from this bound, in prior standard deviations.
AT_AN_END = 1e-3


def conclude(
    fits: comparison.VerdictFits,
    posterior: Posterior,
    wanted: Sequence[Effect],
    *,
    messages: Sequence[str],
    effort: tuple[int, int],
) -> results.LoopResult:
    """Reach the verdict on the visited sets; no fit is made.

    Parameters
    ----------
    fits : VerdictFits
    posterior : Posterior
    wanted : sequence of Effect
        Effects that the user requested.
    messages : sequence of str
        Messages about tests and effects that were left out.
    effort : tuple of int
        Number of fits, and of step programs that they solved.
    """
    numbering = posterior.numberings[0]
    # Each numbering of the modes has its own effects, so the verdict uses one numbering for all of them.
    here = posterior.within(numbering.changes)
    search, found, judged, final = fits.search, fits.model, fits.judged, fits.final
    twins = _twins(search, found, here)
    posterior, here = posterior.with_twins(twins), here.with_twins(twins)
    fitter = search.fitter
    order = posterior.ranked(placed for placed in judged.effects if placed not in fitter.assumed)
    added = tuple(_added(posterior, judged, placed) for placed in order)
    significant = final.improbable
    negligible = significant and _negligible(final)
    by_set = {model.effects: model.estimate for model in reversed(here.models)}
    rivals = [by_set[rival] for rival in _rival_sets(here, added)]
    others = other_frames.weighed(judged, fits.equivalents, fits.searched)
    granted = (
        *_granted(search, found),
        *_granted_of_the_frame(added, fitter.experiment),
        *_granted_of_the_scale(search, found),
        *_granted_of_bounds(fitter.experiment),
        *([f"that the frame is this one of the {len(others.frames) + 1} that fit"] if others.frames else []),
    )
    return results.LoopResult(
        experiment=fitter.experiment,
        backend=fitter.backend.name,
        verdict=_verdict(added, here, numbering, final, unexplained=significant and not negligible),
        rests_on=(*_rests_on(final), *dict.fromkeys(granted)),
        steps=fits.steps,
        judged=judged,
        effects=added,
        assumed=fitter.assumed,
        numberings=tuple(each for each in posterior.numberings if each.probability >= REPORTED),
        models=tuple(_shown_sets(posterior)),
        averaged=dataclasses.replace(posterior.averaged(), at_bounds=judged.frame.at_bounds),
        candidates=tuple(_candidates(posterior, fits)),
        not_considered={each.name: lack for each in wanted if (lack := each.unavailable(fitter.experiment))},
        remains=tuple(results.where_it_sits(final)) if significant and not negligible else (),
        information=(*messages, *_information(search, posterior, judged, negligible=negligible)),
        next_test=next_test.next_test(judged, rivals) or next_test.next_test(judged, fits.equivalents),
        others=others,
        fits=effort[0],
        programs=effort[1],
    )


def _twins(search: Search, found: ModelClass, posterior: Posterior) -> dict[LocatedEffect, list[LocatedEffect]]:
    """List the twins of each effect of a set: exact twins, and the dual if only frequencies were measured."""
    experiment = search.fitter.experiment
    twins = {placed: search.twins(found, placed) for placed in found.effects}
    if counted_from_the_first(experiment):
        first = experiment.states[0]
        twins = {each: [twin for twin in twins[each] if twin.place.state != first] for each in twins}
    if not hypotheses.dual_fits_as_well(experiment):
        return twins
    known = [item.placed for item in search.fitter.hypotheses]
    alike = [model.effects for model in posterior.models if fits_alike(model, found)]
    if hypotheses.dual_set(found.effects, known, experiment.stories) in alike:
        for placed in found.effects:
            other = hypotheses.dual_set(frozenset([placed]), known, experiment.stories)
            twins[placed] += [each for each in other or () if each not in (placed, *twins[placed])]
    return twins


def _verdict(
    added: Sequence[results.AddedEffect],
    posterior: Posterior,
    numbering: hypotheses.NumberingProbability,
    final: Estimate,
    *,
    unexplained: bool,
) -> str:
    if unexplained:
        return "unexplained"
    if not added and not numbering.changes:
        answered = final.dof > 0 and numbering.probability >= NUMBERED and posterior.something() < ADDED
        return "adequate" if answered else "ambiguous"
    sure = min([numbering.probability, *(item.probability for item in _of_the_finding(added))]) >= quantities.SURE
    twins = any(rival.twin for item in added for rival in item.rivals)
    if not sure or twins or final.dof <= 0:
        return "ambiguous"
    return "located" if any(item.placed.effect.kind == hypotheses.OPEN for item in added) else "explained"


def _of_the_finding(added: Sequence[results.AddedEffect]) -> Sequence[results.AddedEffect]:
    """List the effects that decide whether the finding is sure.

    If states differ, their changes are the finding. An effect of the frame in all states then counts only if something
    else may be there in its place.
    """
    if all(item.placed.place.state is None for item in added):
        return added
    return [item for item in added if item.placed.place.state is not None or item.rivals]


def _negligible(final: Estimate) -> bool:
    """Whether the errors of all kinds of data are negligible; a kind without an error measure is not negligible."""
    errors = final.quality.errors
    kinds = final.misfit.noises.values()
    return all(kind.leading is not None and (errors[kind.leading.key] or 0.0) < kind.negligible for kind in kinds)


def _added(posterior: Posterior, final: Estimate, placed: LocatedEffect) -> results.AddedEffect:
    values, errors = final.theta[final.own(placed)], posterior.deviations_about(final, placed)
    names = [item.name for item in placed.effect.parameters]
    parameters = dict(zip(names, values.tolist(), strict=True))
    std = {name: None if np.isnan(error) else float(error) for name, error in zip(names, errors, strict=True)}
    said = placed.effect.phrase(placed.place, values, errors, final.scale, placed.units(final.experiment))
    if placed.effect.rescales:
        factor = final.noise.of(placed.label) or {}
        parameters, std = {"factor": factor["factor"]}, {"factor": factor["std"]}
        said = f"{said}: {quantities.significant(factor['factor'], 2)} times"
    probability, rivals = posterior.of_effects[placed], tuple(posterior.rivals(placed))
    parts = _parts_of_the_story(placed, [rival.placed for rival in rivals], final.experiment.stories)
    story = None
    if len(parts) > 1:
        either = probability + sum(rival.probability for rival in rivals if rival.placed in parts)
        story = results.SharedStory(said.partition(":")[0], min(either, 1.0), parts)
    return results.AddedEffect(
        placed, probability, parameters, std, said, rivals, tuple(_remarks(final, placed)), story
    )


def _parts_of_the_story(
    placed: LocatedEffect, rivals: Sequence[LocatedEffect], stories: int
) -> dict[LocatedEffect, str]:
    """List the effects that change the one story of an effect in the same state, each with its part of the story."""
    found = {each: each.effect.of_story(each.place, stories) for each in (placed, *rivals)}
    mine = found[placed]
    return {
        each: own[1]
        for each, own in found.items()
        if mine and own and (own[0], each.place.state) == (mine[0], placed.place.state)
    }


def _remarks(final: Estimate, placed: LocatedEffect) -> Iterator[str]:
    """List the parameters that lie on a physical bound."""
    stds = final.misfit.expectation.of(placed)
    for item, value, std in zip(placed.effect.parameters, final.theta[final.own(placed)], stds, strict=True):
        size = std if np.isfinite(std) else item.upper - item.lower
        for bound, word in ((item.lower, "lower"), (item.upper, "upper")):
            if np.isfinite(bound) and abs(value - bound) <= AT_AN_END * size:
                yield f"{item.name} is at the {word} end of what is physical"


def _rival_sets(posterior: Posterior, added: Sequence[results.AddedEffect]) -> list[frozenset[LocatedEffect]]:
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


def _shown_sets(posterior: Posterior) -> Iterator[results.EffectSet]:
    sums = defaultdict[object, float](float)
    for model, probability in zip(posterior.models, posterior.of_sets, strict=True):
        sums[model.effects, model.changes] += float(probability)
    # A set may explain the data with two frames: only the better fit is shown.
    best = {(model.effects, model.changes): model for model in reversed(posterior.models)}
    for key in ranking.ranked(best, sums.__getitem__):
        model = best[key]
        if sums[key] >= REPORTED:
            order = tuple(placed for placed in model.estimate.effects if placed in model.effects)
            yield results.EffectSet(order, min(sums[key], 1.0), model.log_evidence, model.estimate.chi2, model.changes)


def _candidates(posterior: Posterior, fits: comparison.VerdictFits) -> list[results.Candidate]:
    """List all effects that were looked for, the most probable first.

    The search fits only promising effects. An effect with too small an influence to detect keeps its prior probability;
    an effect that was not fitted beside the set of the verdict never gets a larger one from the linearised model.
    """
    final, search, fitter = fits.judged, fits.search, fits.search.fitter
    linear = search.linearised(fits.model)
    log_odds = fitter.log_priors(linear.candidates, fits.model.effects) + np.minimum(linear.gains, 0.0)
    unseen = dict(zip(linear.candidates, special.expit(log_odds).tolist(), strict=True))
    names = parameter_names(final.experiment, final.effects)
    found = []
    for item in fitter.hypotheses:
        placed = item.placed
        count = len(placed.effect.parameters)
        gain, dof, confounded = 0.0, final.dof - count, tuple[str, ...]()
        chi2 = final.chi2
        if placed in fits.chi2_without:
            gain, dof = fits.chi2_without[placed] - final.chi2, final.dof
        elif placed in unseen:
            # Otherwise the derivatives at the null value carry no information on the effect here.
            gain = linear.decrease(placed)
            chi2 -= gain
            if linear.precision_gained(placed) < LITTLE_GAINED and placed in posterior.kept_odds:
                confounded = linear.confounders(placed, names)
        p_value = min(1.0, len(fitter.hypotheses) * float(special.chdtrc(count, max(gain, 0.0))))
        probability = posterior.of_effects[placed]
        if fits.model.effects | {placed} not in search.visited:
            probability += (1.0 - probability) * unseen.get(placed, 0.0)
        found.append(results.Candidate(placed, probability, item.probability, chi2, dof, p_value, confounded))
    order = posterior.ranked((each.placed for each in found), {each.placed: each.probability for each in found})
    place = {placed: at for at, placed in enumerate(order)}
    return sorted(found, key=lambda each: (place[each.placed] if each.probability else len(order), each.chi2))


def _quoted(names: Sequence[str]) -> str:
    return quantities.listed([f'"{name}"' for name in names])


def _rests_on(final: Estimate) -> Iterator[str]:
    """Yield the basis of the verdict: the noise that the residual is compared with."""
    if final.dof <= 0:
        yield "nothing that could speak against it: the model has as many parameters as there are data"
        return
    if not final.misfit.open_noises:
        yield "the stated standard deviations"
        return
    # The noise of the misfit is not used: it has no factor if the fit stopped at the default.
    factors, noises = dict(final.noise.noise.factors), final.misfit.noises
    sizes = {noises[kind].plural: noises[kind].sized(factors[kind]) for kind in final.misfit.open_noises}
    shown = ", ".join(f"{name} {quantities.significant(size, 2)} {unit}" for name, ((size,), unit) in sizes.items())
    partly = len(final.misfit.open_noises) < len(final.misfit.noises)
    yield f"{'stated and ' if partly else ''}estimated noise ({shown})"


def _granted(search: Search, found: ModelClass) -> Iterator[str]:
    """Yield the assumptions of the verdict that the data hardly test: sentences of effects that are not in the set."""
    states = {placed.place.state for placed in found.effects} | {None}
    said = [each for each in search.candidates(found) if each.effect.assumption_text and each.place.state in states]
    if not said:
        return
    linear = search.linearised(found)
    untold = defaultdict[str, list[str]](list)
    for placed in said:
        # Only effects with such sentences count as alternatives. Changes of single stories or floors do not, because
        # their sum is the effect itself.
        alike = [other for other in said if other.place.state == placed.place.state]
        if linear.undetermined(placed, alike):
            said_of = placed.effect.assumption_text.replace("{prior}", str(placed.place.prior))
            untold[said_of].append(str(placed.place.state))
    for statement, names in untold.items():
        yield statement.format(state=_quoted(names))


def _granted_of_the_frame(added: Sequence[results.AddedEffect], experiment: Experiment) -> Iterator[str]:
    """Yield which of two states is taken for the frame itself, if the other has changed and neither is declared."""
    first, *others = experiment.states
    changed = {item.placed.place.state for item in added} & set(others)
    if counted_from_the_first(experiment) and changed:
        yield f'that "{first}" is the frame itself ([frame] reference may name the other state)'


def _granted_of_the_scale(search: Search, found: ModelClass) -> Iterator[str]:
    """Yield the quantities that all masses scale with, unless an exact total mass is declared."""
    experiment = search.fitter.experiment
    if experiment.frame.known_total is not None and experiment.frame.total_mass_std is None:
        return
    loaded = any(np.any(each.added_mass) for each in experiment.configurations)
    if loaded and not any(placed.effect.name == masses.LoadScale.name for placed in found.effects):
        yield masses.LoadScale.assumption_text
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
    if search.untried:
        yield (
            f"the search ended after {len(search.visited)} sets of effects, as its budget of work was spent; not tried "
            f"with every good set: {quantities.listed(search.untried)}"
        )
    if not final.fit.converged:
        yield f"the final fit did not converge ({final.fit.reason}); its numbers are where it stopped"
    for placed in posterior.untold():
        yield f"{placed.label}: these data tell nothing of it; masses and stiffnesses are averaged without it"
    if failed := [each for each in fitter.failures if each not in search.visited]:
        tried = len(failed) + len(search.visited)
        yield f"{len(failed)} of {tried} sets of effects could not be fitted ({fitter.failures[failed[0]]})"
    if fitter.stand_ins:
        yield f"{fitter.stand_ins} of {fitter.fits} fits that {fitter.backend.name} refused were made by auto"
    if experiment.frame.story_heights is None and any(placed.effect.uses_heights for placed in final.effects):
        yield "story heights are not declared and taken as equal; lengths count in stories"
    for effect in {item.placed.effect.name: item.placed.effect for item in fitter.hypotheses}.values():
        if effect.name not in {placed.effect.name for placed in final.effects}:
            said = effect.known_anyway(experiment, *experiment.levels(final.theta))
            if said:
                yield said
