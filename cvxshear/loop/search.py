"""The search among sets of effects: forward from the shear model, then exchange and removal, none visited twice.

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

from cvxshear.effects import Placed
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
from cvxshear.loop.twins import Invariances, invariances
from cvxshear.util import ranking
from cvxshear.util.typing import Floats

BEAM = 6
REACH = 20.0
"""Sets that are expanded: the best of those visited, so many at most and none further behind in log probability."""

A_PILE = 3
"""Effects from which on a set is no simple explanation: two causes at once are met now and then, three seldom."""

WEAKEST = 2
"""Effects, the weakest of a set, without which it must be worse before no more are taken out."""

STAND_FOR_A_GROUP = 3
"""Single effects, the most promising ones, that are tried in place of a group."""

MOST_CAUSES = 4
"""Causes that are put one after the other in the place of a group."""

MOST_SETS = 300
"""Sets after which a search ends, but for what it is at and the neighbors of the best sets: twice what sound files of
three states need (up to some 150), so that a file that no set explains ends too. What is left out then is said."""

TWINS_DIFFER = 0.1
"""Difference of chi-square, relative where it is above one, that rounding and the priors of sizes leave of twins."""


class Search:
    """Sets of effects that were visited, and the way to more of them.

    Parameters
    ----------
    fitter : Fitter
    base : Estimate
        Of the set without any.
    looked_for : sequence of Hypothesis, optional
        Those of the fitter that sets are made of; all of them where not given.
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
        """The most probable sets so far, those with an open class counted by themselves: they go with every cause."""
        fitted = [model for model in self.visited.values() if model.estimate is not None]
        fitted = ranking.ranked(fitted, lambda model: model.score, same=ranking.SAME_ODDS)
        causes = [model for model in fitted if not holds_open(model.effects)][:BEAM]
        others: list[ModelClass] = []
        for model in fitted:
            # What only adds to a better set would leave no room for sets that are other explanations.
            if holds_open(model.effects) and not any(better.effects < model.effects for better in others):
                others.append(model)
            if len(others) == BEAM // 2:
                break
        return ranking.ranked((*causes, *others), lambda model: model.score, same=ranking.SAME_ODDS)

    def run(self) -> None:
        """Visit sets until the beam has nothing left to expand, or the budget is spent."""
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
        """Go one way from the best set that has not gone it yet; tell whether there was one."""
        model = self._next(done, within)
        if model is not None:
            way(model)
        return model is not None

    def _look_elsewhere(self) -> bool:
        """Where nothing simple explains the data, or an open class has to, look far from the best set first."""
        if not (self._unsatisfied() or holds_open(self.best.effects)):
            return False
        return self.add_motions() or self._descend_among_causes() or self._add_companions()

    def _descend_among_causes(self) -> bool:
        """Visit, where the best set holds an open class, what causes alone lead to; tell whether one of them is better.

        A class that does the work of several causes hides them, which are seen only together: by themselves each of
        them brings less than the class. Without it the way to them is short.
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
        """Visit sets with an effect that brings a motion of its own, unless the shear model wins as it should."""
        if self.moved or (self.best is self.base and not self.base.improbable):
            return False
        self.moved = True
        base = self.base.estimate
        assert base is not None, "the shear model was fitted"
        found = with_motions(base, self.fitter, self.best)
        self._record(self.fitter.models(found))
        return bool(found)

    def _add_companions(self) -> bool:
        """Visit the best set with what may stand beside the motions that it holds.

        With both the data may leave a ridge with several optima, and all of them count.
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
        """Whether nothing simple explains the data so far."""
        return self.best.improbable or len(self.best.effects) >= A_PILE

    @property
    def spent(self) -> bool:
        """Whether the search has made as many fits as it may."""
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
        """Fit sets that are named from outside, each from a frame of its own; tell whether a better fit was found.

        Parameters
        ----------
        starts : sequence of (frozenset of Placed, ndarray of shape (2N,))
            Sets, and the floor masses and story stiffnesses at which a fit of each starts, its effects at null.
        """
        base = self.base.estimate
        assert base is not None, "the shear model was fitted"
        return self._record(self.fitter.models(from_frames(starts, base, self.fitter)))

    def visit_exchanges(self) -> bool:
        """Visit the best set with each of its effects at every other place; tell whether a better set was found.

        Far from the frame at which a model was linearised it says little of where a change sits.
        """
        best = self.best
        assert best.estimate is not None, "a best set has a fit"
        sets = [
            (best.effects - {placed}) | {other}
            for placed in best.effects
            for other in self.lacking(best)
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
        """Visit, beside each of the best sets, those in which an effect has given its place to a twin."""
        for model in [each for each in self.beam if each.score >= self.best.score - WITHIN]:
            if not model.effects or not self._worth_following(model):
                continue
            found = self.invariances(model)
            for placed in model.effects:
                rest = model.effects - {placed}
                new = [rest | {twin} for twin in found.twins(placed) if rest | {twin} not in self.visited]
                if not new:
                    continue
                self._fit_without(model, [rest])
                base = self.visited[rest]
                if base.estimate is not None:
                    self._visit(base.estimate, self.linearised(base), new, FULL)

    def invariances(self, model: ModelClass) -> Invariances:
        """Find what no datum tells at the fit of a set."""
        return invariances(self.linearised(model))

    def linearised(self, model: ModelClass) -> Linearised:
        """Linearise the model at the fit of a set, by all that it lacks; that of the last set asked for is kept."""
        assert model.estimate is not None, "only sets with a fit are linearised"
        if self._last is None or self._last.base is not model.estimate:
            self._last = Linearised(model.estimate, self.lacking(model), self.fitter.expectation)
        return self._last

    def twins(self, model: ModelClass, placed: Placed) -> list[Placed]:
        """List the effects that no datum tells from one of a set, where the set with them fits as well."""
        assert model.estimate is not None
        found = []
        for twin in self.invariances(model).twins(placed):
            other = self.visited.get((model.effects - {placed}) | {twin})
            found += [twin] if other is not None and fits_alike(other, model) else []
        return found

    def refine(self) -> None:
        """Fit the sets that count most to full accuracy."""
        floor = self.best.score - REACH
        for model in [each for each in self.beam if each.score >= floor]:
            self.visited[model.effects] = self.fitter.refined(model)

    def fit_of(self, effects: Set) -> Estimate:
        """Find the fit of a set, made where it was not visited."""
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
        """Find the best set of the beam that was not dealt with yet."""
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
        """Whether a set may lead to a better one: what only adds to one that explains the data hardly does."""
        if self.best.improbable or model is self.best:
            return True
        return not holds_open(model.effects) and not any(
            better.effects < model.effects and better.score > model.score for better in self.beam
        )

    def lacking(self, model: ModelClass) -> list[Placed]:
        """List the effects that a set lacks and the linearised model at its fit can judge."""
        there = {"", *(placed.effect.name for placed in (*model.effects, *self.fitter.assumed))}
        return [
            item.placed
            for item in self.looked_for
            if item.placed not in model.effects
            and item.placed.effect.beside in there
            and not item.placed.effect.adds_motion
        ]

    def _expand(self, model: ModelClass) -> None:
        """Visit the most promising sets with one more effect, or two."""
        self.expanded.add(model.effects)
        if not self.lacking(model) or model.estimate is None:
            return
        linear = self.linearised(model)
        further = promising(model, linear, self.fitter, self.best.score - model.score)
        new = [each for each in further if each not in self.visited and not self._hopeless(each)]
        self._visit(model.estimate, linear, new)
        named = [each for each in named_entries(model, self.fitter) if self.fitter.set_of(each) not in self.visited]
        self._record(self.fitter.models(named))

    def _hopeless(self, effects: Set) -> bool:
        """Whether a set holds an open class that was tried and fell far behind what explains the data without it."""
        if self.best.improbable:
            return False
        for placed in effects:
            if placed.effect.kind == OPEN and placed not in self.best.effects:
                tried = [model.score for each, model in self.visited.items() if placed in each]
                if tried and max(tried) < self.best.score - WITHIN:
                    return True
        return False

    def _visit(self, base: Estimate, linear: Linearised, sets: Iterable[Set], accuracy: Accuracy = ROUGH) -> None:
        """Fit these sets, each with the effects of a fit and some that it lacks."""
        proposals = []
        for effects in dict.fromkeys(sets):
            new = [placed for placed in linear.lacking if placed in effects]
            motions = [placed for placed in effects if placed.effect.adds_motion and placed not in base.effects]
            predicted = [] if motions else [linear.predicted(new)]
            proposals.append(self.fitter.proposal(base, (*base.effects, *new, *motions), predicted))
        self._record(self.fitter.models(proposals, accuracy))

    def _record(self, models: Iterable[ModelClass]) -> bool:
        """Keep fits of sets, of a set that was visited the better one; tell whether there was any."""
        kept = False
        for model in models:
            known = self.visited.get(model.effects)
            if known is not None and model.score <= known.score + ROUGH.step:
                continue
            self.visited[model.effects] = model
            kept = True
            # What was said of the neighbors of another fit was said of another frame.
            for done in (self.expanded, self.pruned, self.reduced, self.regrouped):
                done.discard(model.effects)
        return kept

    def _regroup(self, model: ModelClass) -> None:
        """Visit sets in which other causes, one or several, stand for a whole group: all of a state, all of a name, ...

        Where every floor of a state is heavier, or every story softer, one cause takes the place of many; taking them
        out one at a time never gets there. Where nothing simple explains the data, causes that explain only together
        (joints that turn, and braces that turn none) stand in the place of an open class, too: beside a class that does
        the work of both neither is seen.
        """
        self.regrouped.add(model.effects)
        for group in groups(model.effects, open_too=self._unsatisfied()):
            if self.spent:
                break
            rest = model.effects - group
            # From the shear model on, each fitted in turn, any may come: the first guess took all of them at once.
            barred = group if rest else frozenset()
            self._fit_without(model, [rest])
            firsts = self._with_one_of(self.lacking(self.visited[rest]), self.visited[rest], barred)
            if len(group) > 1:
                causes = [each for each in firsts if not holds_open(each.effects - rest)]
                firsts = ranking.ranked(causes, lambda each: each.score, same=ranking.SAME_ODDS)[:1]
            for first in firsts if self._unsatisfied() else ():
                at, best = None, first
                while best is not at and len(best.effects - rest) < MOST_CAUSES:
                    at = best
                    others = [each for each in self.lacking(at) if len(group) > 1 or each.effect.kind != OPEN]
                    best = max((at, *self._with_one_of(others, at, barred)), key=lambda each: each.score)

    def _with_one_of(self, effects: Sequence[Placed], model: ModelClass, barred: Set) -> list[ModelClass]:
        """Visit the most promising sets with one of these effects more, none that is barred."""
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
        """Visit sets with ever fewer effects, the weakest taken out first: what came early may be superfluous."""
        at, kept = model, set[Placed]()
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
        """Visit the sets with one effect less, and expand those: what is added takes its place."""
        self.reduced.add(model.effects)
        assert model.estimate is not None
        fewer = [model.effects - {placed} for placed in model.estimate.effects if placed in model.effects]
        self._fit_without(model, fewer)
        for each in fewer:
            if each not in self.expanded:
                self._expand(self.visited[each])

    def _fit_without(self, model: ModelClass, sets: Sequence[Set]) -> None:
        """Fit sets that hold some of the effects of one, started there, where they have no fit that is as good yet."""
        assert model.estimate is not None
        assumed = set(self.fitter.assumed)
        new = [each for each in sets if each not in self.visited or self._untried(self.visited[each])]
        effects_of = [[placed for placed in model.estimate.effects if placed in each | assumed] for each in new]
        self._record(self.fitter.models([self.fitter.proposal(model.estimate, effects) for effects in effects_of]))

    @staticmethod
    def _untried(model: ModelClass) -> bool:
        """Whether a set was passed over without a fit."""
        return model.estimate is None and model.failure is None


def _strength(estimate: Estimate, placed: Placed) -> float:
    """Largest distance of an effect's parameters from null, in standard deviations; zero where it has none."""
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
