"""Closing the loop: from the shear model to the effects that it lacks, and their probabilities.

Searches run with the modes numbered as given, with other numberings, and from the dual frame. Effects cannot correct a
wrong mode number, and a search that tries this is long. So the shear model is fitted under every numbering first. The
most promising numberings then receive the effects that their linearised models predict. Only numberings near the best
are searched to the end.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import Effect, LocatedEffect, Scale
from cvxshear.effects.state import heights_of
from cvxshear.fit.domain import EffectPrior
from cvxshear.fit.efficient import Estimate, efficient
from cvxshear.fit.gauss_newton import FULL, ROUGH, Accuracy
from cvxshear.fit.identification import INSEPARABLE
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.start import nearest_start
from cvxshear.loop.comparison import verdict_fits
from cvxshear.loop.conclusion import conclude
from cvxshear.loop.fitter import Fitter, ModelClass
from cvxshear.loop.hypotheses import (
    Hypothesis,
    Numbering,
    able_to_take_part,
    assumed_effects,
    chosen,
    dual_fits_as_well,
    dual_frame,
    dual_set,
    few_floors_seen,
    hypotheses,
    named_numberings,
    overlooked_in_all,
    overlooked_in_one,
)
from cvxshear.loop.posterior import Posterior
from cvxshear.loop.results import LoopResult
from cvxshear.loop.search import Search, holds_open
from cvxshear.loop.verdicts import VERDICTS
from cvxshear.measurement.experiment import Experiment, Measurement, opened
from cvxshear.measurement.reading import without_repeated
from cvxshear.priors import Prior
from cvxshear.util import ranking
from cvxshear.util.errors import CvxshearError, InputError, NoSolutionError, UnsuitableError
from cvxshear.util.typing import Floats

MOST_WIDENINGS = 3
"""Largest number of times that the noise is widened for an unexplained residual: wider noise changes the best set."""

PROBED = 4
"""Number of numberings, the best by their shear models, that are tried with effects before one is searched fully."""

REACH = 20.0
"""Largest log probability ratio between the best numbering and one that is searched to the end."""

FAR_BEHIND = 100.0
"""Largest log probability ratio between the best numbering and one that stays in the search, after the best one
explains the data. Other numberings are compared by their shear models, because effects that both need gain the same in
both. The given numbering is compared by its best set."""

MOST_PAIRED = 10
"""Largest number of stories for which all pairs of changes of a state are tried: 180 fits per state."""


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


@dataclass(frozen=True)
class Searches:
    """Settings that all searches of one loop share.

    Parameters
    ----------
    backend : Backend
    assumed : tuple of LocatedEffect
        Effects that the model holds from the start.
    looked_for : sequence of Hypothesis
    expectation : EffectPrior
    start : Estimate
        The shear model with the modes as given.
    jobs : int
        Processes over which sets of effects are fitted.
    widened : float
        Factor on the standard deviations of the data.
    """

    backend: Backend
    assumed: tuple[LocatedEffect, ...]
    looked_for: Sequence[Hypothesis]
    expectation: EffectPrior
    start: Estimate
    jobs: int = 1
    widened: float = 1.0

    def run(self, experiment: Experiment) -> list[Search]:
        """Run the searches: with the modes numbered as given, then with each numbering near the best.

        Each search runs to its end. The search with the given numbering is dropped if another numbering is far better.

        Raises
        ------
        NoSolutionError
            If the shear model could not be fitted to the modes as given.
        """
        given = self.start_search(Numbering(experiment))
        others = list(self._possible(named_numberings(experiment)))
        if not given.base.improbable:
            given.run()
        if given.base.improbable or given.best.effects:
            others += self._possible(overlooked_in_all(experiment))
        leader = _leader(given, others)
        if leader.best.improbable or holds_open(leader.best.effects):
            # Before a statement of the shear model is rejected, the mode numbers are questioned one test at a time.
            others += self._possible(overlooked_in_one(experiment))
            leader = _leader(given, others)
        leader.run()
        near = _near(given, others, leader)
        duals = [other for search in near if (other := self._dual(search)) is not None]
        for search in (*near, *duals):
            search.visit_ties()
            search.refine()
            search.visit_twins()
        return [*near, *duals]

    def start_search(self, numbering: Numbering) -> Search:
        """Begin a search under one numbering of the modes, with its shear model fitted."""
        theta = self.start.theta
        if numbering.changes:
            theta = nearest_start(Misfit(numbering.experiment, self.assumed))
        return self._search(numbering, theta, ROUGH if numbering.changes else FULL)

    def _search(self, numbering: Numbering, theta: Floats, accuracy: Accuracy) -> Search:
        fitter = Fitter(numbering, self.backend, self.looked_for, self.assumed, self.expectation, jobs=self.jobs)
        noise = self.start.misfit.noise
        misfit = Misfit(numbering.experiment, self.assumed, None, noise, self.expectation, self.widened)
        try:
            found = fitter.fit(misfit, theta, accuracy)
        except NoSolutionError:
            # Far from the data a fit may follow an endless curved valley; effects are searched for from there, too.
            found = fitter.fit(misfit, theta, ROUGH)
        return Search(fitter, found)

    def _possible(self, numberings: Iterable[Numbering]) -> Iterator[Search]:
        """Begin a search under each numbering for which a frame satisfies the declarations."""
        for numbering in numberings:
            try:
                yield self.start_search(numbering)
            except CvxshearError:
                continue

    def _dual(self, search: Search) -> Search | None:
        """Visit sets whose frames are far from the frame of the search, because frequencies alone do not exclude them.

        If the data do not distinguish a frame from its dual, begin a search at the dual of the shear model. Return None
        otherwise, or if the dual start leads to the same frame.
        """
        numbering = search.fitter.numbering
        if search.base.estimate is None or not few_floors_seen(numbering.experiment):
            return None
        best = search.best
        pairs = self._pairs(search)
        search.visit(pairs)
        typical = np.median(search.base.estimate.theta[: 2 * numbering.experiment.stories].reshape(2, -1), axis=1)
        even = np.repeat(typical, numbering.experiment.stories)
        found = search.visit_from([*self._duals(search), *self._changes(search)])
        if search.visit_from([(each, even) for each in pairs]) or found or search.best is not best:
            search.run()
        while search.visit_exchanges():
            search.run()
        if not dual_fits_as_well(numbering.experiment):
            return None
        theta = search.base.estimate.theta.copy()
        frame = theta[: 2 * numbering.experiment.stories]
        frame[:] = dual_frame(frame)
        try:
            other = self._search(numbering, theta, FULL)
        except CvxshearError:
            # The declarations exclude the dual.
            return None
        if other.base.score < search.base.score - REACH or _same_frame(other.base, search.base):
            return None
        other.visit(effects for effects, _ in self._duals(search))
        other.run()
        search.visit(effects for effects, _ in self._duals(other))
        return other

    def _duals(self, search: Search) -> list[tuple[frozenset[LocatedEffect], Floats]]:
        """List the duals of the best sets of a search, each with the dual of its fitted frame."""
        n = search.fitter.experiment.stories
        known = [item.placed for item in self.looked_for]
        return [
            (dual, dual_frame(model.estimate.theta[: 2 * n]))
            for model in search.beam
            if model.estimate is not None and (dual := dual_set(model.effects, known, n)) is not None
        ]

    def _with_duals(self, stories: int) -> list[LocatedEffect]:
        return [each.placed for each in self.looked_for if each.placed.effect.dual(each.placed.place, stories)]

    def _pairs(self, search: Search) -> list[frozenset[LocatedEffect]]:
        """List pairs of changes of one kind in one state: a search for single changes may not find such a pair."""
        n = search.fitter.experiment.stories
        return [
            frozenset([a, b])
            for a, b in itertools.combinations(self._with_duals(n) if n <= MOST_PAIRED else (), 2)
            if (a.effect.name, a.place.state) == (b.effect.name, b.place.state)
        ]

    def _changes(self, search: Search) -> list[tuple[frozenset[LocatedEffect], Floats]]:
        """List every change of a state that has a dual, with several frames to start from.

        These are the frame of each single state and its dual. The shear model of all states lies between their frames,
        and may be nearer to another minimum.
        """
        base, experiment = search.base.estimate, search.fitter.experiment
        assert base is not None, "the shear model was fitted"
        n = experiment.stories
        placed = self._with_duals(n)
        frames = []
        for state in experiment.states if placed else ():
            left_out = {
                each.name: np.ones(len(each.frequencies), dtype=bool)
                for each in experiment.configurations
                if each.state != state
            }
            misfit = Misfit(experiment, self.assumed, left_out, base.misfit.noise, self.expectation, self.widened)
            frame = search.fitter.fit(misfit, base.theta, ROUGH).theta[: 2 * n]
            frames += [frame, dual_frame(frame)]
        return [(frozenset([each]), frame) for each in placed for frame in frames]


def _leader(given: Search, others: Sequence[Search]) -> Search:
    """Try the most promising numberings with effects, and return the best of them."""
    if not others:
        return given
    promising = ranking.ranked(others, lambda search: search.base.score, same=ranking.SAME_ODDS)[: PROBED - 1]
    for search in (given, *promising):
        search.probe()
    return max((given, *promising), key=lambda search: search.best.score)


def _near(given: Search, others: Sequence[Search], leader: Search) -> list[Search]:
    """Search the numberings near the best to the end, and the given numbering if it may still win."""
    rest = ranking.ranked(
        (each for each in (given, *others) if each is not leader),
        lambda search: search.base.score,
        same=ranking.SAME_ODDS,
    )
    kept = {id(given), id(leader)}
    best = leader.best.score
    for search in rest:
        hopeless = not leader.best.improbable and search.base.score < leader.base.score - FAR_BEHIND
        if hopeless and search is not given:
            continue
        search.visit([leader.best.effects])
        behind = best - search.best.score
        if behind <= REACH or (search is given and (behind <= FAR_BEHIND or leader.best.improbable)):
            search.run()
            best = max(best, search.best.score)
            kept.add(id(search))
    return [search for search in (given, *others) if id(search) in kept]


def _same_frame(a: ModelClass, b: ModelClass) -> bool:
    """Whether two fits have the same frame. Another frame that fits equally well leads to other sets."""
    assert a.estimate is not None, "the shear model was fitted"
    assert b.estimate is not None, "the shear model was fitted"
    return bool(np.allclose(a.estimate.theta, b.estimate.theta, rtol=INSEPARABLE))
