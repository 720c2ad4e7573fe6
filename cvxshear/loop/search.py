"""Search among sets of effects, the best first: expansion, grouping and exchange. No set is visited twice.

Where a set holds open classes, the causes that best replace them are tried in their place. A set is then expanded by
the effects that the linearised model at its fit promises, each alone and all in sequence. The best set and the best set
without an open class come first: they lose superfluous effects and are expanded. Then one cause replaces a group of
effects of the best set: all of one state, all of one name, or all. Then the other good sets have their turn, and each
loses one effect at a time and is expanded again, so that another effect takes its place. The derivatives by an effect
that adds a motion carry no information at zero mass, so such effects are fitted from their own starting points. There
are finitely many sets and none is fitted or expanded twice, so the search ends; at the latest when its budget of work
is spent, and then it says what it has not tried. Sets that tie are tried with each other's exchanges.
"""

import dataclasses
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from cvxshear.effects import LocatedEffect
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.gauss_newton import FULL, HOPELESS, ROUGH
from cvxshear.loop.fitter import FitProposal, Fitter, ModelClass
from cvxshear.loop.hypotheses import MANY_CAUSES, OPEN
from cvxshear.loop.linear import Linearised
from cvxshear.util import errors, ranking
from cvxshear.util.typing import Floats

#: Number of best visited sets that are expanded, and of further effects that are fitted alone when a set is expanded.
BEAM = 6

#: Smallest probability, relative to the best set, of a set that is followed up; smallest probability that is reported.
REPORTED = 1e-3

#: Largest distance from the best set, in log probability, of a set that is followed up.
WITHIN = float(-np.log(REPORTED))

#: Largest difference in log probability of two sets that are equally good. Further effects are tried beside both of
#: them. Tried beside one only, they would count for that set alone, and the probabilities of its effects would be
#: wrong: without this rule, an effect that no datum concerns loses its prior probability.
TIE = 2.0

#: Number of effects on the accuracy of data that are fitted when a set that does not explain the data is expanded.
RESCALING = 3

#: Largest number of fits from given starting points, the best after one step.
MOST_STARTS = 20

#: Work, in small fits (`fitter.SMALL_FIT`), after which a search ends at the end of its step. Nine states of
#: frequencies alone (Los Alamos) need somewhat less: cut short, rounding would decide what had been tried. The result
#: says what was not tried.
MOST_WORK = 1500

#: Difference of chi-square of twins, relative if chi-square exceeds one. Rounding and the priors of the sizes cause it.
TWINS_DIFFER = 0.1

Set = frozenset[LocatedEffect]
Item = TypeVar("Item")


class Search:
    """Visited sets of effects, and the steps that visit more.

    Parameters
    ----------
    fitter : Fitter
    base : Estimate
        Fit of the model without looked-for effects.
    """

    def __init__(self, fitter: Fitter, base: Estimate) -> None:
        self.fitter = fitter
        self.base = fitter.model_of(base)
        self.visited: dict[Set, ModelClass] = {self.base.effects: self.base}
        self.other_optima: list[ModelClass] = []
        self.untried: list[str] = []
        self._done: set[tuple[str, Set]] = set()
        self._kept: list[Linearised] = []

    @property
    def best(self) -> ModelClass:
        """The most probable set so far."""
        return max(self.visited.values(), key=lambda model: model.score)

    @property
    def beam(self) -> list[ModelClass]:
        """Most probable sets so far."""
        fitted = ranking.ranked(self.visited.values(), lambda model: model.score, same=ranking.SAME_ODDS)
        return foremost(fitted, lambda model: model.effects)

    def _steps(self) -> Iterator[tuple[str, Callable[[ModelClass], None], Sequence[ModelClass]]]:
        """Yield what is tried in words, the step, and the sets that take it; each step begins when none before is left.

        The order is that of the module's docstring.
        """
        yield "fewer effects", self._prune, self._leaders
        yield "further effects", self._expand, self._leaders
        if self.unsatisfied:
            yield "masses on springs", self.add_motions, [self.best]
        yield "one cause for several", self._regroup, [self.best]
        yield "further effects", self._expand, self._near
        yield "one cause for several", self._regroup, self._near
        yield "exchanges of effects", self._exchange, self._near
        yield "masses on springs", self.add_motions, [self.best]

    def run(self) -> None:
        """Visit sets until no good set is left to expand, to group or to exchange, or the budget is spent."""
        while self.fitter.work < MOST_WORK and any(self._follow(step, models) for _, step, models in self._steps()):
            pass
        if self.fitter.work >= MOST_WORK:
            left = [words for words, step, models in self._steps() if not all(self._had(step, each) for each in models)]
            self.untried = list(dict.fromkeys(left))

    def _had(self, step: Callable[[ModelClass], None], model: ModelClass) -> bool:
        return (step.__name__, model.effects) in self._done

    def _follow(self, step: Callable[[ModelClass], None], models: Sequence[ModelClass]) -> bool:
        """Apply a step to the first of these sets that has not had it; return whether there was such a set."""
        for model in models:
            if not self._had(step, model):
                self._done.add((step.__name__, model.effects))
                step(model)
                return True
        return False

    @property
    def _leaders(self) -> list[ModelClass]:
        """The best set, and the best set of causes: an open class that fits the effect of several causes hides them.

        Many kinds of causes lose against one unknown cause, so a set with many is not expanded while it is behind.
        """
        causes = next(model for model in self.beam if not holds_open(model.effects))
        kinds = {placed.effect.name for placed in causes.effects}
        return [self.best, causes] if len(kinds) < MANY_CAUSES else [self.best]

    @property
    def _near(self) -> list[ModelClass]:
        """Sets near the best, without those that only add effects to a better set, if the best explains the data."""
        near = [model for model in self.beam if model.score >= self.best.score - WITHIN]
        if self.best.improbable:
            return near

        def adds_only(model: ModelClass) -> bool:
            return any(each.effects < model.effects and each.score > model.score + TIE for each in near)

        return [each for each in near if each is self.best or not (holds_open(each.effects) or adds_only(each))]

    @property
    def unsatisfied(self) -> bool:
        """Whether no set of causes explains the data so far."""
        return self.best.improbable or holds_open(self.best.effects)

    def add_motions(self, model: ModelClass) -> None:
        """Visit the shear model, and a set, with effects that add degrees of freedom.

        The shear model alone remains if it wins and explains the data. With an effect and its companion the posterior
        may have a ridge with several optima, and all of them count.
        """
        base = self.base.estimate
        if model is self.base and not model.improbable:
            return
        # Where causes explain the data, a rival must promise to come near them.
        most = np.inf if self.unsatisfied else self.best.estimate.fit.at.objective + 2.0 * WITHIN
        if ("motions", self.base.effects) not in self._done:
            self._done.add(("motions", self.base.effects))
            motions = [item.placed for item in self.fitter.hypotheses if item.placed.effect.adds_motion]
            alone = [(self.fitter.proposal(base, (*base.effects, motion)), motion) for motion in motions]
            self._fit(_from_starts(alone, base, most))
        found = self.fitter.models(_from_starts(with_companions(self.fitter, model), base, most))
        self.other_optima += found
        self._record(found)

    def visit(self, sets: Iterable[Set]) -> None:
        """Fit sets that are named from outside, started at the shear model."""
        if new := [each for each in sets if not self._tried(each)]:
            self._visit(self.base.estimate, self.linearised(self.base), new)

    def visit_from(self, starts: Sequence[tuple[Set, Floats]]) -> bool:
        """Fit given sets, each from a given frame; return whether a better fit was found.

        Parameters
        ----------
        starts : sequence of (frozenset of LocatedEffect, ndarray of shape (2N,))
            Sets, each with the floor masses and story stiffnesses of the start. Effects start at null.
        """
        proposals = []
        for effects, frame in starts:
            plain = self._proposal(self.base.estimate, effects)
            start = np.concatenate([frame, plain.starts[-1][len(frame) :]])
            proposals.append(dataclasses.replace(plain, starts=(start,)))
        return self._fit(proposals)

    def visit_alone(self, effects: Sequence[LocatedEffect], frames: Sequence[Floats]) -> bool:
        """Fit each of these effects alone, from given frames; return whether a better fit was found.

        Only the starts that the linearised models at the frames promise most are fitted.

        Parameters
        ----------
        effects : sequence of LocatedEffect
        frames : sequence of ndarray, shape (2N,)
        """
        promised: list[tuple[float, FitProposal]] = []
        for frame in frames:
            at = self.fitter.at(self.base.estimate, frame)
            linear = Linearised(at, effects, self.fitter.expectation)
            _, c = at.fit.at.triangle
            gains = linear.gains - 0.5 * (at.fit.at.objective - float(c @ c))
            for gain, placed in zip(gains.tolist(), effects, strict=True):
                promised.append((gain, self.fitter.proposal(at, (*at.effects, placed))))
        best = ranking.ranked(promised, lambda each: each[0])[:MOST_STARTS]
        return self._fit([proposal for _, proposal in best])

    def _proposal(self, start: Estimate, effects: Set) -> FitProposal:
        """Propose a fit of a set, started from a fit."""
        present = [item.placed for item in self.fitter.hypotheses if item.placed in effects]
        return self.fitter.proposal(start, (*self.fitter.assumed, *present))

    def visit_ties(self) -> None:
        """Visit beside each of the best sets the exchanges of one effect that tie beside another of them.

        The ends of a nearly symmetric frame, for example, are independent choices for several effects. A search whose
        budget is spent has tried the choices beside some sets only, and rounding decides which.
        """
        tied = [effects for effects, model in self.visited.items() if model.score >= self.best.score - TIE]
        moves = {(one - other, other - one): None for one in tied for other in tied}
        proposals: dict[Set, FitProposal] = {}
        for model in self.beam:
            if model.effects not in tied:
                continue
            for gone, new in moves:
                effects = (model.effects - gone) | new
                if max(len(gone), len(new)) > 1 or not gone <= model.effects or new & model.effects:
                    continue
                if not self._tried(effects) and effects not in proposals:
                    proposals[effects] = self._proposal(model.estimate, effects)
        self._fit(list(proposals.values()))

    def visit_twins(self) -> None:
        """Visit, for each of the best sets, the sets in which a twin replaces an effect."""
        # The verdict needs the best set again.
        for model in reversed(self._near):
            if not model.effects:
                continue
            found = self.linearised(model)
            for placed in model.effects:
                rest = model.effects - {placed}
                new = [rest | {twin} for twin in found.twins(placed) if not self._tried(rest | {twin})]
                for base in self._without(model, [rest]) if new else []:
                    self._visit(base.estimate, self.linearised(base), new)

    def linearised(self, model: ModelClass) -> Linearised:
        """Linearise the model at the fit of a set, with all effects that the set lacks; the latest results are kept."""
        found = next((each for each in self._kept if each.base is model.estimate), None)
        if found is None:
            found = Linearised(model.estimate, self.candidates(model), self.fitter.expectation)
            self.fitter.count(found.parameters)
        of_base = [each for each in self._kept if each.base is self.base.estimate]
        self._kept = list({id(each): each for each in (*of_base, found)}.values())
        return found

    def twins(self, model: ModelClass, placed: LocatedEffect) -> list[LocatedEffect]:
        """List the twins of an effect in a set whose fit with the twin is equally good."""
        found = []
        for twin in self.linearised(model).twins(placed):
            other = self.visited.get((model.effects - {placed}) | {twin})
            found += [twin] if other is not None and fits_alike(other, model) else []
        return found

    def refine(self) -> None:
        """Fit the most probable sets to full accuracy."""
        for model in [each for each in self.beam if each.score >= self.best.score - WITHIN]:
            self.visited[model.effects] = self.fitter.refined(model)

    def fit_of(self, effects: Set) -> Estimate:
        """Return the fit of a set; fit the set first if it was not visited."""
        if effects not in self.visited:
            near = [self._proposal(each.estimate, effects) for each in (self.best, self.base)]
            self._record(self.fitter.models(near, FULL))
        if effects not in self.visited:
            raise self.fitter.failures[effects]
        return self.visited[effects].estimate

    def candidates(self, model: ModelClass) -> list[LocatedEffect]:
        """List the effects that a set lacks and that the linearised model at its fit can judge."""
        there = {"", *(placed.effect.name for placed in (*model.effects, *self.fitter.assumed))}
        return [
            item.placed
            for item in self.fitter.hypotheses
            if item.placed not in model.effects
            and item.placed.effect.beside in there
            and not item.placed.effect.adds_motion
        ]

    def _expand(self, model: ModelClass, barred: Set = frozenset()) -> None:
        """Visit the most promising sets with further effects, except the barred ones."""
        if not self.candidates(model):
            return
        linear = self.linearised(model)
        for proposal in in_place_of_classes(model, linear, self.fitter):
            effects = self.fitter.set_of(proposal)
            if not self._tried(effects) and not self._hopeless(effects):
                self._fit([proposal])
        # Rivals of the first effect are found beside the shear model, however far behind they are.
        behind = 0.0 if model is self.base else self.best.score - model.score
        further = promising(model, linear, self.fitter, behind, barred)
        new = [each for each in further if not self._tried(each) and not self._hopeless(each)]
        self._visit(model.estimate, linear, new)

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

    def _visit(self, base: Estimate, linear: Linearised, sets: Iterable[Set]) -> None:
        """Fit these sets; each holds the effects of a fit and some that the fit lacks."""
        proposals = []
        for effects in dict.fromkeys(sets):
            new = [placed for placed in linear.candidates if placed in effects]
            motions = [placed for placed in effects if placed.effect.adds_motion and placed not in base.effects]
            factors = linear.likely_factors(new)
            predicted = [] if motions else [linear.predicted(new, factors)]
            proposals.append(self.fitter.proposal(base, (*base.effects, *new, *motions), predicted, factors))
        self._fit(proposals)

    def _fit(self, proposals: Sequence[FitProposal]) -> bool:
        """Fit sets; return whether any fit was kept."""
        return self._record(self.fitter.models(proposals))

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
            self._done = {each for each in self._done if each[1] != model.effects or each[0] == "motions"}
        return kept

    def _regroup(self, model: ModelClass) -> None:
        """Visit sets in which other effects replace a group: all effects of a state, all of one name, or all.

        If every floor of a state is heavier, or every story softer, one cause replaces many effects. Removal of one
        effect at a time never finds this cause.
        """
        for group in groups(model.effects):
            for rest in self._without(model, [model.effects - group]):
                self._expand(rest, group)

    def _prune(self, model: ModelClass) -> None:
        """Visit sets with fewer effects, the weakest removed first: an effect added early may be superfluous."""
        at = model
        while at.effects:
            self._done.add(("_prune", at.effects))
            strength = {placed: _strength(at.estimate, placed) for placed in at.effects}
            weakest = min(strength, key=lambda placed: (strength[placed], placed.label))
            fewer = self._without(at, [at.effects - {weakest}])
            if not fewer or fewer[0].score <= at.score:
                break
            at = fewer[0]

    def _exchange(self, model: ModelClass) -> None:
        """Visit the sets with one effect less, and expand them: the added effect replaces the removed one."""
        fewer = [model.effects - {placed} for placed in model.estimate.effects if placed in model.effects]
        for each in self._without(model, fewer):
            self._follow(self._expand, [each])

    def _without(self, model: ModelClass, sets: Sequence[Set]) -> list[ModelClass]:
        """Return the fits of subsets of a set, started at its fit if they were not visited."""
        assumed = set(self.fitter.assumed)
        new = [each for each in sets if not self._tried(each)]
        effects_of = [[placed for placed in model.estimate.effects if placed in each | assumed] for each in new]
        self._record(self.fitter.models([self.fitter.proposal(model.estimate, effects) for effects in effects_of]))
        return [self.visited[each] for each in sets if each in self.visited]

    def _tried(self, effects: Set) -> bool:
        """Whether a set was fitted, or could not be."""
        return effects in self.visited or effects in self.fitter.failures


def _strength(estimate: Estimate, placed: LocatedEffect) -> float:
    """Return the largest distance of a parameter from null, in standard deviations; zero without parameters."""
    own = estimate.own(placed)
    nulls = [item.null for item in placed.effect.parameters]
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.abs(estimate.theta[own] - nulls) / estimate.std[own]
    return float(np.max(np.nan_to_num(z), initial=0.0))


def fits_alike(a: ModelClass, b: ModelClass) -> bool:
    """Whether two sets fit the same data equally well."""
    return abs(a.estimate.chi2 - b.estimate.chi2) <= TWINS_DIFFER * max(1.0, b.estimate.chi2)


def promising(
    model: ModelClass, linear: Linearised, fitter: Fitter, behind: float, barred: Set = frozenset()
) -> list[Set]:
    """List sets with one more effect, or several, by what the linearised model promises.

    Parameters
    ----------
    model : ModelClass
    linear : Linearised
        Linearised model at the fit of the set, with the effects that the set lacks.
    fitter : Fitter
    behind : float
        Distance in log probability that the further effects must close.
    barred : frozenset of LocatedEffect
        Effects that are not added.
    """
    odds = fitter.log_priors(linear.candidates, model.effects)
    odds[[placed in barred for placed in linear.candidates]] = -np.inf
    gains = linear.gains + odds
    floor = max(float(np.max(gains)), 0.0, behind) - WITHIN
    # Far from the data the model is not linear: the order of the gains is still useful, their sizes are not.
    far_off = model.estimate.fit.at.objective > HOPELESS * len(model.estimate.fit.at.r)
    order = [i for i in ranking.order(gains) if np.isfinite(gains[i]) and (far_off or gains[i] > floor)]
    single = foremost([linear.candidates[i] for i in order], lambda placed: frozenset([placed]))
    if model.improbable:
        # An effect that leaves the accuracy of some data open shows its full gain only after these data lose weight.
        by_gain = [linear.candidates[i] for i in ranking.order(linear.gains)]
        single += [placed for placed in by_gain if placed.effect.rescales and placed not in barred][:RESCALING]
    several = model.effects.union(linear.forward(odds))
    return [*(model.effects | {placed} for placed in single), several]


def in_place_of_classes(model: ModelClass, linear: Linearised, fitter: Fitter) -> Iterator[FitProposal]:
    """Propose sets in which causes of the catalogue replace the open classes, all at once and then one at a time.

    Derivatives at null hardly show large changes; the fitted classes provide their sizes.
    """
    classes = [each for each in model.estimate.effects if each.effect.kind == OPEN and each.effect.parameters]
    alone = [(each,) for each in classes]
    for replaced in dict.fromkeys([tuple(classes), *alone]) if classes else ():
        odds = fitter.log_priors(linear.candidates, model.effects.difference(replaced))
        causes, start = linear.in_place_of(replaced, odds)
        rest = [each for each in model.estimate.effects if each not in replaced]
        yield dataclasses.replace(fitter.proposal(model.estimate, (*rest, *causes)), starts=(start,))


def with_companions(fitter: Fitter, best: ModelClass) -> list[tuple[FitProposal, LocatedEffect]]:
    """Propose a set with both an effect that adds degrees of freedom and its companion; it holds one of the two.

    The fits begin at the shear model's frame and at all starts of the effect. With the companion the optimum may be far
    from the fit without it. Another effect at the same place, such as a lighter floor, may have imitated the missing
    one, so the pair is also tried without the other effects of this place.
    """
    looked_for = [item.placed for item in fitter.hypotheses]
    pairs = [
        (companion, motion)
        for motion in looked_for
        if motion.effect.adds_motion
        for companion in looked_for
        if (companion.effect.companion, companion.place) == (motion.effect.name, motion.place)
        and len(best.effects & {companion, motion}) == 1
    ]
    proposals = []
    for pair in pairs:
        beside = [placed for placed in best.estimate.effects if placed not in pair]
        elsewhere = [placed for placed in beside if placed in fitter.assumed or placed.place != pair[1].place]
        others = (beside, elsewhere) if len(elsewhere) < len(beside) else (beside,)
        proposals += [(fitter.proposal(best.estimate, (*rest, *pair)), pair[1]) for rest in others]
    return proposals


def _from_starts(
    proposals: Sequence[tuple[FitProposal, LocatedEffect]], base: Estimate, most: float
) -> list[FitProposal]:
    """Start each proposal from the frame of the base and from every start of its last effect.

    Derivatives at zero mass carry no information on an effect that adds a motion, so its starts are compared: those
    with the lowest objective after one step of all parameters in the linearised model are kept, up to a largest one.
    """
    frame = base.experiment.parameters
    left, kept = list[float](), list[FitProposal]()
    for proposal, motion in proposals:
        for start in motion.effect.starts:
            theta = np.concatenate([base.theta[:frame], proposal.starts[-1][frame : -len(start)], start])
            try:
                at = proposal.misfit.evaluate(theta)
            except errors.NoModesError:
                continue
            _, c = at.triangle
            left.append(at.objective - float(c @ c))
            kept.append(dataclasses.replace(proposal, starts=(theta,)))
    return [kept[i] for i in ranking.order(-np.array(left))[:MOST_STARTS] if left[i] <= most]


def groups(effects: Set) -> list[Set]:
    """List groups of at least two effects: by state, by name, and all."""
    by_state, by_name = defaultdict[str | None, set[LocatedEffect]](set), defaultdict[str, set[LocatedEffect]](set)
    # Sets have no order of their own: sorted, so that every run gives the same result.
    for placed in sorted(effects, key=lambda placed: placed.label):
        by_name[placed.effect.name].add(placed)
        if placed.place.state is not None:
            by_state[placed.place.state].add(placed)
    found = [frozenset(group) for group in (*by_state.values(), *by_name.values(), effects)]
    return [group for group in dict.fromkeys(found) if len(group) > 1]


def foremost(ordered: Iterable[Item], effects_of: Callable[[Item], Set]) -> list[Item]:
    """Keep the first `BEAM` items without an open class, and half as many with one.

    They are counted apart, because a class can join every cause. A set that only adds effects to a better one with a
    class would displace other explanations.
    """
    kept: list[Item] = []
    classes: list[Set] = []
    for item in ordered:
        effects = effects_of(item)
        if not holds_open(effects) and len(kept) - len(classes) < BEAM:
            kept.append(item)
        if holds_open(effects) and len(classes) < BEAM // 2 and not any(better < effects for better in classes):
            kept.append(item)
            classes.append(effects)
    return kept


def holds_open(effects: Collection[LocatedEffect]) -> bool:
    """Whether an open class is among these effects."""
    return any(placed.effect.kind == OPEN for placed in effects)
