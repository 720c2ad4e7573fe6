"""Search among sets of effects: forward from the shear model, then by exchange and removal. No set is visited twice.

A set is expanded by what the linearised model at its fit promises of each further effect, of each pair, and of all
that it would take one after the other; where an open class stands in it, its conspicuous entries are tried as causes.
The best set comes first: it is pruned and expanded. Where nothing simple explains, or an open class has to, effects
that bring a motion of their own, and causes alone from the shear model on, are looked at next. Then the best set is
regrouped, which puts one cause, or several where nothing simple explains, in the place of a whole group of effects.
Then the rest of the beam is expanded, the best sets visited; and at last each of the best with one effect taken out,
which exchanges that effect for another. As there are finitely many sets and none is fitted or expanded twice, it ends;
at the latest when its budget is spent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np

from cvxshear.effects import LocatedEffect
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.gauss_newton import FULL, ROUGH, Accuracy
from cvxshear.loop.fitter import Fitter, ModelClass
from cvxshear.loop.hypotheses import OPEN, Hypothesis
from cvxshear.loop.linear import Linearised
from cvxshear.loop.neighbors import (
    WITHIN,
    Set,
    from_frames,
    groups,
    holds_open,
    named_entries,
    promising,
    with_companions,
    with_motions,
)
from cvxshear.util import ranking
from cvxshear.util.typing import Floats

BEAM = 6
REACH = 20.0
"""Number of best visited sets that are expanded, and their largest distance from the best in log probability."""

TIE = 2.0
"""Largest difference in log probability of two sets that are equally good. Further effects are tried beside both of
them. Tried beside one only, they would count for that set alone, and the probabilities of its effects would be wrong:
without this rule, an effect that no datum concerns loses its prior probability."""

A_PILE = 3
"""Number of effects that a simple explanation does not reach: two simultaneous causes are rare, three are very rare."""

WEAKEST = 2
"""Number of weakest effects whose removal must make a set worse before pruning stops."""

STAND_FOR_A_GROUP = 3
"""Number of single effects, the most promising ones, that are tried in place of a group."""

MOST_CAUSES = 4
"""Largest number of causes that replace a group, added one after the other."""

MOST_SETS = 300
"""Number of visited sets after which a search ends, except for the current step. The
limit is twice the need of consistent data of three states (about 150 sets). The result reports that the search was cut
short."""

TWINS_DIFFER = 0.1
"""Difference of chi-square of twins, relative if chi-square exceeds one. Rounding and the priors of the sizes cause it.
"""


class Search:
    """Visited sets of effects, and the steps that visit more.

    Parameters
    ----------
    fitter : Fitter
    base : Estimate
        Fit of the model without looked-for effects.
    looked_for : sequence of Hypothesis, optional
        Effects that sets may hold; by default all hypotheses of the fitter.
    """

    def __init__(self, fitter: Fitter, base: Estimate, looked_for: Sequence[Hypothesis] | None = None) -> None:
        self.fitter = fitter
        self.looked_for = fitter.hypotheses if looked_for is None else looked_for
        start = fitter.model_of(base)
        fitter.base = base
        self.visited: dict[Set, ModelClass] = {start.effects: start}
        self.expanded: set[Set] = set()
        self.pruned: set[Set] = set()
        self.reduced: set[Set] = set()
        self.regrouped: set[Set] = set()
        self.accompanied: set[Set] = set()
        self.other_optima: list[ModelClass] = []
        self.moved = False
        self.descended = False
        self.base = start
        self._last: Linearised | None = None

    @property
    def best(self) -> ModelClass:
        """The most probable set so far."""
        return max(self.visited.values(), key=lambda model: model.score)

    @property
    def beam(self) -> list[ModelClass]:
        """Most probable sets so far.

        Sets with an open class are counted apart, because a class can join every cause.
        """
        fitted = [model for model in self.visited.values() if model.estimate is not None]
        fitted = ranking.ranked(fitted, lambda model: model.score, same=ranking.SAME_ODDS)
        causes = [model for model in fitted if not holds_open(model.effects)][:BEAM]
        others: list[ModelClass] = []
        for model in fitted:
            # A set that only adds effects to a better set would displace other explanations.
            if holds_open(model.effects) and not any(better.effects < model.effects for better in others):
                others.append(model)
            if len(others) == BEAM // 2:
                break
        return ranking.ranked((*causes, *others), lambda model: model.score, same=ranking.SAME_ODDS)

    def run(self) -> None:
        """Visit sets until no set of the beam is left to expand, or the budget is spent."""
        ways: tuple[Callable[[], bool], ...] = (
            partial(self._follow, self._prune, self.pruned, 0.0),
            partial(self._follow, self._expand, self.expanded, 0.0),
            self._look_elsewhere,
            partial(self._follow, self._regroup, self.regrouped, 0.0),
            partial(self._follow, self._expand, self.expanded, REACH),
            partial(self._follow, self._regroup, self.regrouped, WITHIN),
            partial(self._follow, self._reduce, self.reduced, WITHIN),
            self.add_motions,
            self._add_companions,
        )
        while not self.spent and any(way() for way in ways):
            pass

    def _follow(self, way: Callable[[ModelClass], None], done: set[Set], within: float) -> bool:
        """Apply one step to the best set that has not had this step; return whether there was such a set."""
        model = self._next(done, within)
        if model is not None:
            way(model)
        return model is not None

    def _look_elsewhere(self) -> bool:
        """Look far from the best set if no simple set explains the data, or only an open class does."""
        if not (self._unsatisfied() or holds_open(self.best.effects)):
            return False
        return self.add_motions() or self._descend_among_causes() or self._add_companions()

    def _descend_among_causes(self) -> bool:
        """Search among causes alone if the best set holds an open class; return whether the best set changed.

        An open class that fits the effect of several causes hides them: each single cause gains less than the class.
        Without the class, the search reaches these causes in a few steps.
        """
        if self.descended or not holds_open(self.best.effects):
            return False
        self.descended = True
        assert self.base.estimate is not None, "the shear model was fitted"
        causes = [item for item in self.looked_for if item.placed.effect.kind != OPEN]
        alone = Search(self.fitter, self.base.estimate, causes)
        ways = ((alone._prune, alone.pruned), (alone._expand, alone.expanded))
        while not alone.spent and any(alone._follow(way, done, 0.0) for way, done in ways):
            pass
        before = self.best
        self._record(model for effects, model in alone.visited.items() if effects not in self.visited)
        return self.best is not before

    def add_motions(self) -> bool:
        """Visit sets with an effect that adds degrees of freedom, unless the shear model wins and explains the data."""
        if self.moved or (self.best is self.base and not self.base.improbable):
            return False
        self.moved = True
        base = self.base.estimate
        assert base is not None, "the shear model was fitted"
        found = with_motions(base, self.fitter, self.best)
        self._record(self.fitter.models(found))
        return bool(found)

    def _add_companions(self) -> bool:
        """Visit the best set with the companions of its effects that add degrees of freedom.

        With both, the posterior may have a ridge with several optima, and all of them count.
        """
        best = self.best
        if best.effects in self.accompanied:
            return False
        self.accompanied.add(best.effects)
        assert self.base.estimate is not None, "the shear model was fitted"
        found = self.fitter.models(with_companions(self.base.estimate, self.fitter, best))
        self.other_optima += found
        return self._record(found)

    def _unsatisfied(self) -> bool:
        """Whether no simple set explains the data so far."""
        return self.best.improbable or len(self.best.effects) >= A_PILE

    @property
    def spent(self) -> bool:
        """Whether the budget of sets is spent."""
        return len(self.visited) >= MOST_SETS

    def probe(self) -> None:
        """Expand the shear model alone."""
        if self.base.effects not in self.expanded:
            self._expand(self.base)

    def visit(self, sets: Iterable[Set]) -> None:
        """Fit sets that are named from outside, started at the shear model."""
        new = [each for each in sets if each not in self.visited]
        if new and self.base.estimate is not None:
            self._visit(self.base.estimate, self.linearised(self.base), new)

    def visit_from(self, starts: Sequence[tuple[Set, Floats]]) -> bool:
        """Fit given sets, each from a given frame; return whether a better fit was found.

        Parameters
        ----------
        starts : sequence of (frozenset of LocatedEffect, ndarray of shape (2N,))
            Sets, each with the floor masses and story stiffnesses of the start. Effects start at null.
        """
        base = self.base.estimate
        assert base is not None, "the shear model was fitted"
        return self._record(self.fitter.models(from_frames(starts, base, self.fitter)))

    def visit_exchanges(self) -> bool:
        """Visit the best set with each of its effects at every other place; return whether a better set was found.

        Far from the frame of the linearisation, the linearised model does not locate a change.
        """
        best = self.best
        assert best.estimate is not None, "a best set has a fit"
        sets = [
            (best.effects - {placed}) | {other}
            for placed in best.effects
            for other in self.candidates(best)
            if (other.effect.name, other.place.state) == (placed.effect.name, placed.place.state)
        ]
        order = [item.placed for item in self.fitter.hypotheses]
        proposals = [
            self.fitter.proposal(best.estimate, (*self.fitter.assumed, *(each for each in order if each in effects)))
            for effects in sets
            if effects not in self.visited
        ]
        self._record(self.fitter.models(proposals))
        return self.best is not best

    def visit_twins(self) -> None:
        """Visit, for each of the best sets, the sets in which a twin replaces an effect."""
        for model in [each for each in self.beam if each.score >= self.best.score - WITHIN]:
            if not model.effects or not self._worth_following(model):
                continue
            found = self.linearised(model)
            for placed in model.effects:
                rest = model.effects - {placed}
                new = [rest | {twin} for twin in found.twins(placed) if rest | {twin} not in self.visited]
                if not new:
                    continue
                self._fit_without(model, [rest])
                base = self.visited[rest]
                if base.estimate is not None:
                    self._visit(base.estimate, self.linearised(base), new, FULL)

    def linearised(self, model: ModelClass) -> Linearised:
        """Linearise the model at the fit of a set, with all effects that the set lacks; the latest result is kept."""
        assert model.estimate is not None, "only sets with a fit are linearised"
        if self._last is None or self._last.base is not model.estimate:
            self._last = Linearised(model.estimate, self.candidates(model), self.fitter.expectation)
        return self._last

    def twins(self, model: ModelClass, placed: LocatedEffect) -> list[LocatedEffect]:
        """List the twins of an effect in a set whose fit with the twin is equally good."""
        assert model.estimate is not None
        found = []
        for twin in self.linearised(model).twins(placed):
            other = self.visited.get((model.effects - {placed}) | {twin})
            found += [twin] if other is not None and fits_alike(other, model) else []
        return found

    def refine(self) -> None:
        """Fit the most probable sets to full accuracy."""
        floor = self.best.score - REACH
        for model in [each for each in self.beam if each.score >= floor]:
            self.visited[model.effects] = self.fitter.refined(model)

    def fit_of(self, effects: Set) -> Estimate:
        """Return the fit of a set; fit the set first if it was not visited."""
        model = self.visited.get(effects)
        if model is not None and model.estimate is not None:
            return model.estimate
        near = self.best.estimate
        assert near is not None, "the shear model was fitted"
        order = [*self.fitter.assumed, *(item.placed for item in self.fitter.hypotheses if item.placed in effects)]
        (found,) = self.fitter.models([self.fitter.proposal(near, order)], FULL)
        self._record([found])
        if found.estimate is None:
            assert found.failure is not None
            raise found.failure
        return found.estimate

    def _next(self, done: set[Set], within: float) -> ModelClass | None:
        """Find the best set of the beam that has not had this step."""
        floor = self.best.score - within
        return next(
            (
                model
                for model in self.beam
                if model.effects not in done and model.score >= floor and self._worth_following(model)
            ),
            None,
        )

    def _worth_following(self, model: ModelClass) -> bool:
        """Whether a set may lead to a better one.

        A set that only adds effects to a set that explains the data hardly does.
        """
        if self.best.improbable or model is self.best:
            return True
        return not holds_open(model.effects) and not any(
            better.effects < model.effects and better.score > model.score + TIE for better in self.beam
        )

    def candidates(self, model: ModelClass) -> list[LocatedEffect]:
        """List the effects that a set lacks and that the linearised model at its fit can judge."""
        there = {"", *(placed.effect.name for placed in (*model.effects, *self.fitter.assumed))}
        return [
            item.placed
            for item in self.looked_for
            if item.placed not in model.effects
            and item.placed.effect.beside in there
            and not item.placed.effect.adds_motion
        ]

    def _expand(self, model: ModelClass) -> None:
        """Visit the most promising sets with one or two more effects."""
        self.expanded.add(model.effects)
        if not self.candidates(model) or model.estimate is None:
            return
        linear = self.linearised(model)
        further = promising(model, linear, self.fitter, self.best.score - model.score)
        new = [each for each in further if each not in self.visited and not self._hopeless(each)]
        self._visit(model.estimate, linear, new)
        named = [each for each in named_entries(model, self.fitter) if self.fitter.set_of(each) not in self.visited]
        self._record(self.fitter.models(named))

    def _hopeless(self, effects: Set) -> bool:
        """Whether a set holds an open class that was tried in vain.

        Such a class is far less probable than the best set, which explains the data without the class.
        """
        if self.best.improbable:
            return False
        for placed in effects:
            if placed.effect.kind == OPEN and placed not in self.best.effects:
                tried = [model.score for each, model in self.visited.items() if placed in each]
                if tried and max(tried) < self.best.score - WITHIN:
                    return True
        return False

    def _visit(self, base: Estimate, linear: Linearised, sets: Iterable[Set], accuracy: Accuracy = ROUGH) -> None:
        """Fit these sets; each holds the effects of a fit and some that the fit lacks."""
        proposals = []
        for effects in dict.fromkeys(sets):
            new = [placed for placed in linear.candidates if placed in effects]
            motions = [placed for placed in effects if placed.effect.adds_motion and placed not in base.effects]
            predicted = [] if motions else [linear.predicted(new)]
            proposals.append(self.fitter.proposal(base, (*base.effects, *new, *motions), predicted))
        self._record(self.fitter.models(proposals, accuracy))

    def _record(self, models: Iterable[ModelClass]) -> bool:
        """Keep the better fit of each set; return whether any fit was kept."""
        kept = False
        for model in models:
            known = self.visited.get(model.effects)
            if known is not None and model.score <= known.score + ROUGH.step:
                continue
            self.visited[model.effects] = model
            kept = True
            # The neighbors were tried from another frame, so they may be tried again.
            for done in (self.expanded, self.pruned, self.reduced, self.regrouped):
                done.discard(model.effects)
        return kept

    def _regroup(self, model: ModelClass) -> None:
        """Visit sets in which one or several causes replace a group: all effects of a state, all of one name, or all.

        If every floor of a state is heavier, or every story softer, one cause replaces many effects. Removal of one
        effect at a time never finds this cause. If no simple set explains the data, causes that explain only together
        (flexible joints, and braces that prevent joint rotation) also replace an open class: with the class in the set
        neither cause gains anything.
        """
        self.regrouped.add(model.effects)
        for group in groups(model.effects, open_too=self._unsatisfied()):
            if self.spent:
                break
            rest = model.effects - group
            # Without other effects, any effect is allowed: the first expansion took several at once, now each is fitted
            # in turn.
            barred = group if rest else frozenset()
            self._fit_without(model, [rest])
            firsts = self._with_one_of(self.candidates(self.visited[rest]), self.visited[rest], barred)
            if len(group) > 1:
                causes = [each for each in firsts if not holds_open(each.effects - rest)]
                firsts = ranking.ranked(causes, lambda each: each.score, same=ranking.SAME_ODDS)[:1]
            for first in firsts if self._unsatisfied() else ():
                at, best = None, first
                while best is not at and len(best.effects - rest) < MOST_CAUSES:
                    at = best
                    others = [each for each in self.candidates(at) if len(group) > 1 or each.effect.kind != OPEN]
                    best = max((at, *self._with_one_of(others, at, barred)), key=lambda each: each.score)

    def _with_one_of(self, effects: Sequence[LocatedEffect], model: ModelClass, barred: Set) -> list[ModelClass]:
        """Visit the most promising sets with one of these effects added, except the barred ones."""
        effects = [placed for placed in effects if placed not in barred]
        if model.estimate is None or not effects:
            return []
        linear = Linearised(model.estimate, effects, self.fitter.expectation)
        worth = linear.gains + self.fitter.log_priors(effects, model.effects)
        gains = dict(zip(effects, worth.tolist(), strict=True))
        best = ranking.ranked(gains, gains.__getitem__)[:STAND_FOR_A_GROUP]
        sets = [model.effects | {placed} for placed in best]
        self._visit(model.estimate, linear, [each for each in sets if each not in self.visited])
        return [self.visited[each] for each in sets]

    def _prune(self, model: ModelClass) -> None:
        """Visit sets with fewer effects, the weakest removed first: an effect added early may be superfluous."""
        at, kept = model, set[LocatedEffect]()
        while at.estimate is not None and len(kept) < WEAKEST:
            self.pruned.add(at.effects)
            left = [placed for placed in at.effects if placed not in kept]
            if not left:
                break
            strength = {placed: _strength(at.estimate, placed) for placed in left}
            weakest = min(left, key=lambda placed: (strength[placed], placed.label))
            fewer = at.effects - {weakest}
            self._fit_without(at, [fewer])
            if self.visited[fewer].score > at.score:
                at = self.visited[fewer]
            else:
                kept.add(weakest)

    def _reduce(self, model: ModelClass) -> None:
        """Visit the sets with one effect less, and expand them: the added effect replaces the removed one."""
        self.reduced.add(model.effects)
        assert model.estimate is not None
        fewer = [model.effects - {placed} for placed in model.estimate.effects if placed in model.effects]
        self._fit_without(model, fewer)
        for each in fewer:
            if each not in self.expanded:
                self._expand(self.visited[each])

    def _fit_without(self, model: ModelClass, sets: Sequence[Set]) -> None:
        """Fit subsets of a fitted set, started at its fit, unless they have an equally good fit already."""
        assert model.estimate is not None
        assumed = set(self.fitter.assumed)
        new = [each for each in sets if each not in self.visited or self._untried(self.visited[each])]
        effects_of = [[placed for placed in model.estimate.effects if placed in each | assumed] for each in new]
        self._record(self.fitter.models([self.fitter.proposal(model.estimate, effects) for effects in effects_of]))

    @staticmethod
    def _untried(model: ModelClass) -> bool:
        """Whether a set was passed over without a fit."""
        return model.estimate is None and model.failure is None


def _strength(estimate: Estimate, placed: LocatedEffect) -> float:
    """Return the largest distance of a parameter from null, in standard deviations; zero without parameters."""
    own = estimate.own(placed)
    nulls = [item.null for item in placed.effect.parameters]
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.abs(estimate.theta[own] - nulls) / estimate.std[own]
    return float(np.max(np.nan_to_num(z), initial=0.0))


def fits_alike(a: ModelClass, b: ModelClass) -> bool:
    """Whether two sets fit the same data equally well."""
    if a.estimate is None or b.estimate is None:
        return False
    return abs(a.estimate.chi2 - b.estimate.chi2) <= TWINS_DIFFER * max(1.0, b.estimate.chi2)
