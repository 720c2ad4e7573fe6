"""Searches of one loop: with the modes numbered as given, with other numberings, and from the dual frame.

Effects cannot correct a wrong mode number, and a search that tries this is long. So the shear model is fitted under
every numbering first. The most promising numberings then receive the effects that their linearised models predict. Only
numberings near the best are searched to the end.

Frequencies alone also admit a second frame. A chain of N stories k_i and floors m_i has the eigenvalues of the chain
with stories 1 / m_(N+1-i) and floors 1 / k_(N+1-i), up to scale. So every set of effects has a dual that fits equally
well, in which a loss in story j is a mass on floor N+1-j (`Effect.dual`). With added mass in some tests the dual fits
worse or better, and lies near its own minimum. No fit from the first frame reaches this minimum, so sets of effects are
also visited from this frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.backends import Backend
from cvxshear.effects import LocatedEffect
from cvxshear.fit.domain import EffectPrior
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.gauss_newton import FULL, ROUGH, Accuracy
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.other_frames import SAME_FRAME
from cvxshear.fit.start import nearest_start
from cvxshear.loop.fitter import Fitter, ModelClass
from cvxshear.loop.hypotheses import Hypothesis, Numbering, named_numberings, overlooked_in_all, overlooked_in_one
from cvxshear.loop.search import Search, holds_open
from cvxshear.measurement.experiment import Experiment
from cvxshear.util import ranking
from cvxshear.util.errors import CvxshearError, NoSolutionError
from cvxshear.util.typing import Floats

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
    return bool(np.allclose(a.estimate.theta, b.estimate.theta, rtol=SAME_FRAME))


def few_floors_seen(experiment: Experiment) -> bool:
    """Whether no test measured more than half of the floors: very different frames may fit such data equally well."""
    return not any(2 * each.measured.any(axis=0).sum() > experiment.stories for each in experiment.configurations)


def dual_fits_as_well(experiment: Experiment) -> bool:
    """Whether only frequencies were measured, without added mass.

    Such data do not distinguish a frame from its dual.
    """
    return not experiment.static and not any(
        each.measured.any() or np.any(each.added_mass) for each in experiment.configurations
    )


def dual_frame(frame: Floats) -> Floats:
    """Return the masses and stiffnesses of the dual frame of the same total mass, shape (2N,).

    Parameters
    ----------
    frame : ndarray, shape (2N,)
        Floor masses and story stiffnesses, kg and N/m.
    """
    floor_mass, story_stiffness = np.split(frame, 2)
    scale = floor_mass.sum() / np.sum(1.0 / story_stiffness)
    dual: Floats = scale * np.concatenate([1.0 / story_stiffness[::-1], 1.0 / floor_mass[::-1]])
    return dual


def dual_set(
    effects: frozenset[LocatedEffect], known: Sequence[LocatedEffect], stories: int
) -> frozenset[LocatedEffect] | None:
    """Find the effects of the dual frame that give the same frequencies; None if an effect has no dual.

    Parameters
    ----------
    effects : frozenset of LocatedEffect
    known : sequence of LocatedEffect
        All effects that are looked for.
    stories : int
    """
    by_place = {(placed.effect.name, placed.place): placed for placed in known}
    found = [placed.effect.dual(placed.place, stories) for placed in effects]
    duals = [by_place.get(each) if each is not None else None for each in found]
    return frozenset(each for each in duals if each is not None) if None not in duals else None
