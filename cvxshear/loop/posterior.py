"""Posterior over the visited sets: probabilities of sets and effects, rivals, twins, and the averaged frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from cvxshear.effects import LocatedEffect
from cvxshear.fit import gauss_newton, results
from cvxshear.fit.efficient import Estimate
from cvxshear.loop.fitter import ModelClass
from cvxshear.loop.hypotheses import MANY_CAUSES, Changes, Hypothesis, NumberingProbability, log_odds
from cvxshear.loop.search import fits_alike
from cvxshear.measurement.experiment import Experiment
from cvxshear.util import decorators, ranking
from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats

#: Smallest probability of an added effect: the median model predicts best (Barbieri and Berger 2004).
ADDED = 0.5

#: Smallest increase of the odds of an added effect by the data, as a factor. Effects that the data do not determine
#: keep their prior odds.
RAISED = 3.0

#: Smallest probability, relative to the best set, of a set whose effects count as rivals.
RIVAL = 0.05

#: Prior probability of an unknown cause that imitates `MANY_CAUSES` kinds of effects in one state (or in the frame),
#: and the factor for each further kind. One frame in fifty has a cause that the catalogue lacks. Three kinds of effects
#: imitate one in two hundred of these causes, five kinds half of them.
UNKNOWN_CAUSE, WITH_EACH_MORE = 1e-4, 10.0


@dataclass(frozen=True)
class Rival(InJson):
    """Effect that may be present instead of an added effect.

    Parameters
    ----------
    placed : LocatedEffect
    probability : float
        Probability that the rival is present instead.
    twin : bool
        Whether the data cannot distinguish the two.
    """

    placed: LocatedEffect
    probability: float
    twin: bool

    json_keys = "*placed probability twin"


class Posterior:
    """Probabilities of the visited sets.

    Parameters
    ----------
    models : iterable of ModelClass
    hypotheses : sequence of Hypothesis
    twins : mapping of LocatedEffect to sequence of LocatedEffect, optional
        Twins of each effect of the best set (`loop/linear.py`).
    """

    def __init__(
        self,
        models: Iterable[ModelClass],
        hypotheses: Sequence[Hypothesis],
        twins: Mapping[LocatedEffect, Sequence[LocatedEffect]] | None = None,
    ) -> None:
        self._twins = twins or {}
        fitted = [model for model in models if np.isfinite(model.score)]
        self.models = _distinct(ranking.ranked(fitted, lambda model: model.score, same=ranking.SAME_ODDS))
        scores = np.array([model.score for model in self.models])
        weights = np.exp(scores - scores[0])
        self.probabilities: Floats = weights / weights.sum()
        self._hypotheses = hypotheses
        self._prior = {item.placed: item.probability for item in hypotheses}

    @property
    def best(self) -> ModelClass:
        """Most probable set."""
        return self.models[0]

    @decorators.cached_property
    def of_sets(self) -> Floats:
        """Probability that each set is right about all of its effects, shape (sets,)."""
        factor = self.many_causes_penalty
        least = [min((factor.get(placed, 1.0) for placed in model.effects), default=1.0) for model in self.models]
        return self.probabilities * least

    @decorators.cached_property
    def of_effects(self) -> dict[LocatedEffect, float]:
        """Probability of each effect: the sum over the sets that hold it, with the penalty for many causes."""
        factor = self.many_causes_penalty
        return {placed: probability * factor.get(placed, 1.0) for placed, probability in self._in_sets.items()}

    @decorators.cached_property
    def _in_sets(self) -> dict[LocatedEffect, float]:
        """Probability of the sets that hold each effect, before the penalty for many causes."""
        sums = dict.fromkeys(self._prior, 0.0)
        for model, probability in zip(self.models, self.probabilities.tolist(), strict=True):
            for placed in model.effects:
                sums[placed] += probability
        return {placed: min(probability, 1.0) for placed, probability in sums.items()}

    @decorators.cached_property
    def numberings(self) -> tuple[NumberingProbability, ...]:
        """Probability of each numbering of the modes, most probable first."""
        sums: dict[Changes, float] = {}
        for model, probability in zip(self.models, self.probabilities, strict=True):
            sums[model.changes] = sums.get(model.changes, 0.0) + float(probability)
        order = ranking.ranked(sums, sums.__getitem__)
        return tuple(NumberingProbability(changes, min(sums[changes], 1.0)) for changes in order)

    def within(self, changes: Changes) -> Posterior:
        """Return the probabilities under one known numbering of the modes."""
        return Posterior([model for model in self.models if model.changes == changes], self._hypotheses, self._twins)

    def with_twins(self, twins: Mapping[LocatedEffect, Sequence[LocatedEffect]]) -> Posterior:
        """Return a copy that knows the twins."""
        return Posterior(self.models, self._hypotheses, twins)

    @decorators.cached_property
    def many_causes_penalty(self) -> dict[LocatedEffect, float]:
        """Factor on the probability of each effect of the verdict: many kinds against one unknown cause.

        Let P be the prior probability of the kinds of effects in the frame, or in one state and the frame together,
        and u the probability of an unknown cause that imitates them. The factor is P / (P + u). With fewer than
        `MANY_CAUSES` kinds the factor is 1.
        """
        factors: dict[LocatedEffect, float] = {}
        present = self.verdict_set()
        for state in {placed.place.state for placed in present}:
            kinds = {
                (placed.effect.name, placed.place.state) for placed in present if placed.place.state in (state, None)
            }
            if len(kinds) >= MANY_CAUSES:
                known = float(np.prod([self._prior_of_kind(*kind) for kind in sorted(kinds, key=str)]))
                unknown = UNKNOWN_CAUSE * WITH_EACH_MORE ** (len(kinds) - MANY_CAUSES)
                own = [placed for placed in present if placed.place.state == state]
                factors |= dict.fromkeys(own, known / (known + unknown))
        return factors

    def _prior_of_kind(self, name: str, state: str | None) -> float:
        """Return the prior probability that an effect of a kind is anywhere in a state, or in the frame for None."""
        places = [item for item in self._hypotheses if item.placed.effect.name == name]
        return 1.0 - float(np.prod([1.0 - item.probability for item in places if item.placed.place.state == state]))

    def ranked(
        self, effects: Iterable[LocatedEffect], probability: Mapping[LocatedEffect, float] | None = None
    ) -> list[LocatedEffect]:
        """Sort effects by probability; among equally probable effects, changes between states come first."""
        chance = self._in_sets if probability is None else probability
        position = {placed: at for at, placed in enumerate(self._prior)}
        known = sorted(effects, key=lambda each: (each.place.state is None, position[each]))
        with np.errstate(divide="ignore"):
            logs = {each: float(np.log(chance[each])) for each in known}
        # Fits of the search end within this distance of their optimum.
        return ranking.ranked(known, logs.__getitem__, same=gauss_newton.ROUGH.step)

    def verdict_set(self) -> frozenset[LocatedEffect]:
        """Choose the added effects.

        For each effect of the best set: if the effect or one of its rivals is present with sufficient probability, add
        the most probable of them. Also add each effect outside the best set whose probability exceeds one half.
        """
        best = [placed for placed in self.ranked(self.best.effects) if placed not in self.kept_odds]
        rivals = {placed: {rival.placed: rival.probability for rival in self.rivals(placed)} for placed in best}
        # An effect that replaces several others belongs to the one that it replaces most often.
        alternatives_of = {
            placed: [placed, *(each for each in own if own[each] >= max(r.get(each, 0.0) for r in rivals.values()))]
            for placed, own in rivals.items()
        }
        chosen: list[LocatedEffect] = []
        for alternatives in alternatives_of.values():
            if self._enough(alternatives):
                free = [each for each in alternatives if each not in chosen]
                chosen.append(self.ranked(free or alternatives)[0])
        # A rival of an added effect replaces the effect and does not join it.
        passed = {each for alternatives in alternatives_of.values() for each in alternatives}
        more = [placed for placed in self._prior if placed not in passed and self._enough([placed])]
        return frozenset((*chosen, *more))

    def _enough(self, alternatives: Sequence[LocatedEffect]) -> bool:
        """Whether one of these effects is present with at least even odds, and the data raised these odds."""
        return self._any(alternatives) >= ADDED and self._raised(alternatives) >= RAISED

    def _raised(self, alternatives: Sequence[LocatedEffect]) -> float:
        """Return the factor by which the data raised the odds that one of these effects is present."""
        probability = self._any(alternatives)
        prior = 1.0 - float(np.prod([1.0 - self._prior[placed] for placed in alternatives]))
        return probability / max(1.0 - probability, 1e-300) * (1.0 - prior) / prior

    def _any(self, alternatives: Sequence[LocatedEffect]) -> float:
        """Return the probability that one of these effects is present."""
        if len(alternatives) == 1:
            return self._in_sets[alternatives[0]]
        including = [not model.effects.isdisjoint(alternatives) for model in self.models]
        return float(self.probabilities[including].sum())

    @decorators.cached_property
    def kept_odds(self) -> frozenset[LocatedEffect]:
        """Effects with odds that the data hardly changed."""
        return frozenset(placed for placed in self._prior if 1.0 / RAISED < self._raised([placed]) < RAISED)

    @decorators.cached_property
    def _indifferent(self) -> frozenset[LocatedEffect]:
        """Effects with unchanged odds that replace no other effect: no probable set improves with one of them.

        An effect that occurs only as a substitute may also keep its odds. Sets without the other effect need the
        substitute, so it is not indifferent.
        """
        score = {model.effects: model.score for model in self.models}
        missed = {
            placed
            for model in self.models
            if model.score >= self.models[0].score + np.log(RIVAL)
            for placed in model.effects
            if model.score - score.get(model.effects - {placed}, np.inf) - log_odds(self._prior[placed])
            > np.log(RAISED)
        }
        return self.kept_odds - missed

    def something(self) -> float:
        """Return the probability that any effect is present, among the effects that the data made more probable."""
        return self._any([placed for placed in self._prior if self._raised([placed]) >= RAISED])

    def untold(self) -> list[LocatedEffect]:
        """List effects with odds that the data hardly changed, if the prior or posterior odds are at least even."""
        return [
            placed
            for placed, probability in self._in_sets.items()
            if max(probability, self._prior[placed]) >= ADDED and placed in self.kept_odds
        ]

    def rivals(self, placed: LocatedEffect) -> list[Rival]:
        """List the possible substitutes of an effect, most probable first.

        These are the effects that replace it in sets with at least a twentieth of the best probability, and its twins,
        even those with a small prior probability.
        """
        found = self._in_place_of(placed)
        twins = self._twins.get(placed, ())
        for other in twins:
            found.setdefault(other, self._in_sets[other])
        order = self.ranked(found, found)
        return [Rival(each, min(found[each], 1.0), each in twins) for each in order]

    def _in_place_of(self, placed: LocatedEffect) -> dict[LocatedEffect, float]:
        """Find the effects that replace an effect of its most probable set elsewhere, with their probability there."""
        best = next((model for model in self.models if placed in model.effects), self.best)
        found: dict[LocatedEffect, float] = {}
        for model, probability in zip(self.models, self.probabilities, strict=True):
            if probability < RIVAL * self.probabilities[0]:
                break
            if placed in model.effects or placed not in best.effects:
                continue
            gone, come = best.effects - model.effects, model.effects - best.effects
            other = replacement(placed, gone - (self._indifferent - {placed}), come - self._indifferent)
            if other is not None:
                found[other] = found.get(other, 0.0) + float(probability)
        return found

    def deviations_about(self, estimate: Estimate, placed: LocatedEffect) -> Floats:
        """Find the standard deviations of an effect's parameters about their values in one fit, shape (p,), or nan.

        They include the scatter between the sets that hold the effect and are probable enough to be rivals. Next to an
        effect that the data do not determine, the sizes of the other effects change.
        """
        mine, least = estimate.own(placed), RIVAL * self.probabilities[0]
        here, std, weights, squares = estimate.theta[mine], estimate.std[mine], [], []
        for model, probability in zip(self.models, self.probabilities, strict=True):
            other = model.estimate
            if placed in model.effects and (other is estimate or probability >= least):
                own = other.own(placed)
                weights.append(float(probability))
                within = np.where(np.isnan(other.std[own]), std, other.std[own])
                squares.append(within**2 + (other.theta[own] - here) ** 2)
        found: Floats = np.sqrt(np.average(squares, axis=0, weights=weights))
        return found

    def averaged(self) -> results.IdentifiedFrame:
        """Masses and stiffnesses averaged over the sets, with the scatter within and between them.

        Sets with an effect that the data do not determine (gravity, as a rule) do not count: such an effect only
        divides each stiffness into parts, and the average is what is left of it.
        """
        untold = self.untold()
        counts = np.array([model.effects.isdisjoint(untold) for model in self.models])
        weights = self.of_sets * counts if counts.any() else self.of_sets
        frames = [model.estimate.expected_frame for model in self.models]

        share = weights / weights.sum()
        found: dict[str, Floats] = {}
        for name in (each.name for each in fields(frames[0]) if hasattr(frames[0], f"{each.name}_std")):
            x, std = (np.array([getattr(frame, key) for frame in frames]) for key in (name, f"{name}_std"))
            found[name] = np.tensordot(share, x, 1)
            found[f"{name}_std"] = np.sqrt(np.tensordot(share, std**2 + (x - found[name]) ** 2, 1))
        return replace(frames[0], at_bounds=(), **found)


def _distinct(models: Iterable[ModelClass]) -> list[ModelClass]:
    """Leave out fits of a set at the same optimum, which several searches may have found."""
    found = defaultdict[tuple[frozenset[LocatedEffect], Changes], list[ModelClass]](list)
    kept = []
    for model in models:
        others = found[model.effects, model.changes]
        if not any(model.same_optimum(other) for other in others):
            others.append(model)
            kept.append(model)
    return kept


def from_the_first_state(
    models: Iterable[ModelClass], looked_for: Sequence[Hypothesis], experiment: Experiment
) -> list[ModelClass]:
    """Unite the sets that differ only in which of two states is the frame itself.

    Without a declared reference, a story that is softer in the second state is as well stiffer in the first. That is
    one finding, with the probability of both. It is told from the first state, as long as both sets fit alike.
    """
    found = list(models)
    if not counted_from_the_first(experiment):
        return found
    first, second = experiment.states
    known = {(item.placed.effect.name, item.placed.place): item.placed for item in looked_for}

    def told(placed: LocatedEffect) -> LocatedEffect:
        if placed.place.state != first or placed.place.test is not None:
            return placed
        return known.get((placed.effect.name, replace(placed.place, state=second)), placed)

    best = {(each.effects, each.changes): each for each in sorted(found, key=lambda model: model.score)}
    united: dict[int, tuple[ModelClass, list[float]]] = {}
    for model in found:
        other = best.get((frozenset(map(told, model.effects)), model.changes), model)
        kept = other if fits_alike(model, other) else model
        united.setdefault(id(kept), (kept, []))[1].append(model.score)
    return [
        replace(kept, log_prior=float(np.logaddexp.reduce(scores)) - kept.log_evidence) if scores[1:] else kept
        for kept, scores in united.values()
    ]


def counted_from_the_first(experiment: Experiment) -> bool:
    """Whether changes are told from the first state: there are two, and none is declared as the frame itself."""
    return experiment.frame.reference is None and len(experiment.states) == 2


def replacement(
    placed: LocatedEffect, gone: frozenset[LocatedEffect], come: frozenset[LocatedEffect]
) -> LocatedEffect | None:
    """Find the new effect that replaces a removed one: an effect of the same state, of the same kind, or the only one.

    Return None if no effect was added, or if the new effect replaces another one.
    """
    if not come:
        return None

    def likeness(a: LocatedEffect, b: LocatedEffect) -> int:
        return 2 * (a.place.state == b.place.state) + (a.effect.name == b.effect.name)

    # Sets have no order of their own: equally good effects are sorted by label, so that every run gives the same
    # result.
    pairs = sorted(
        ((likeness(a, b), a, b) for a in gone for b in come), key=lambda item: (-item[0], item[1].label, item[2].label)
    )
    taken: dict[LocatedEffect, LocatedEffect] = {}
    for _, a, b in pairs:
        if a not in taken and b not in taken.values():
            taken[a] = b
    return taken.get(placed)
