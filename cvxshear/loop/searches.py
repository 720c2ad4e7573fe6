"""The searches of one loop: with the modes numbered as given, numbered otherwise, and from the dual of the frame.

A search among sets of effects that cannot mend a wrong number is long and in vain. So the shear model is fitted under
every numbering first, then the most promising take the effects that their linearised models promise, and only what is
still near the best is searched to its end. Where frequencies alone leave a second frame open (`loop/twins.py`), sets of
effects are visited from there too.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.backends import Backend
from cvxshear.effects import Placed
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.expectation import EffectPrior
from cvxshear.fit.gauss_newton import FULL, ROUGH, Accuracy
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.start import nearest_start
from cvxshear.loop.fitter import Fitter, ModelClass
from cvxshear.loop.hypotheses import Hypothesis
from cvxshear.loop.neighbors import holds_open
from cvxshear.loop.numbering import Numbering, named_numberings, overlooked_in_all, overlooked_in_one
from cvxshear.loop.search import REACH, Search
from cvxshear.loop.twins import dual_fits_as_well, dual_frame, dual_set, few_floors_seen
from cvxshear.measurement.experiment import Experiment
from cvxshear.util import ranking
from cvxshear.util.errors import CvxshearError, NoSolutionError
from cvxshear.util.typing import Floats

PROBED = 4
"""Numberings, the best by their shear models, that are probed with effects before one is searched to its end."""

CARRIED_OVER = 3
"""Best sets of effects of the leading numbering that are tried with every other one that is probed."""

FAR_BEHIND = 100.0
"""Logarithm of a probability ratio at which a numbering is given up once another one explains the data: the others by
their shear models, as effects that both need bring both as much; the numbers as given by the best that was tried."""

SAME_FRAME = 1e-3
"""Relative difference of masses and stiffnesses below which two fits have one frame: fits end closer than that."""

MOST_PAIRED = 10
"""Stories up to which all pairs of changes of a state are tried: 180 fits a state."""


@dataclass(frozen=True)
class Searches:
    """What all searches of one loop share.

    Parameters
    ----------
    backend : Backend
    there : tuple of Placed
        Effects that are in the model from the start.
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
    there: tuple[Placed, ...]
    looked_for: Sequence[Hypothesis]
    expectation: EffectPrior
    start: Estimate
    jobs: int = 1
    widened: float = 1.0

    def run(self, experiment: Experiment) -> list[Search]:
        """Run the searches that count: with the modes numbered as given, then with each numbering near the best.

        Each is searched to its end, but the one with the modes as given where others leave it far behind.

        Raises
        ------
        NoSolutionError
            Where the shear model could not be fitted to the modes as given.
        """
        given = self.begun(Numbering(experiment))
        others = list(self._possible(named_numberings(experiment)))
        if not given.base.improbable:
            given.run()
        if given.base.improbable or given.best.effects:
            others += self._possible(overlooked_in_all(experiment))
        leader = _leader(given, others)
        if leader.best.improbable or holds_open(leader.best.effects):
            # Before a statement of the shear model is given up the numbers are doubted one test at a time.
            others += self._possible(overlooked_in_one(experiment))
            leader = _leader(given, others)
        leader.run()
        near = _near(given, others, leader)
        duals = [other for search in near if (other := self._dual(search)) is not None]
        for search in (*near, *duals):
            search.refine()
            search.visit_twins()
        return [*near, *duals]

    def begun(self, numbering: Numbering) -> Search:
        """Begin a search under one numbering of the modes, its shear model fitted."""
        theta = self.start.theta
        if numbering.changes:
            theta = nearest_start(Misfit(numbering.experiment, self.there))
        return self._search(numbering, theta, ROUGH if numbering.changes else FULL)

    def _search(self, numbering: Numbering, theta: Floats, accuracy: Accuracy) -> Search:
        fitter = Fitter(numbering, self.backend, self.looked_for, self.there, self.expectation, jobs=self.jobs)
        noise = self.start.misfit.noise
        misfit = Misfit(numbering.experiment, self.there, None, noise, self.expectation, self.widened)
        try:
            found = fitter.fit(misfit, theta, accuracy)
        except NoSolutionError:
            # Far from the data a fit may follow a curved valley without an end; effects are looked for from there, too.
            found = fitter.fit(misfit, theta, ROUGH)
        return Search(fitter, found)

    def _possible(self, numberings: Iterable[Numbering]) -> Iterator[Search]:
        """Begin a search under each numbering with which the frame can be what was declared of it."""
        for numbering in numberings:
            try:
                yield self.begun(numbering)
            except CvxshearError:
                continue

    def _dual(self, search: Search) -> Search | None:
        """Visit what frequencies alone leave open: sets with frames far from that of the search.

        Where no datum tells a frame from its dual, begin the search that starts at the dual of the shear model; None
        elsewhere, and where the dual start leads to the same frame.
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
            # What was declared of the frame excludes its dual.
            return None
        if other.base.score < search.base.score - REACH or _same_frame(other.base, search.base):
            return None
        other.visit(effects for effects, _ in self._duals(search))
        other.run()
        search.visit(effects for effects, _ in self._duals(other))
        return other

    def _duals(self, search: Search) -> list[tuple[frozenset[Placed], Floats]]:
        """List the duals of the best sets of a search, each with the dual of the frame that it has with its set."""
        n = search.fitter.experiment.stories
        known = [item.placed for item in self.looked_for]
        return [
            (dual, dual_frame(model.estimate.theta[: 2 * n]))
            for model in search.beam
            if model.estimate is not None and (dual := dual_set(model.effects, known, n)) is not None
        ]

    def _with_duals(self, stories: int) -> list[Placed]:
        return [each.placed for each in self.looked_for if each.placed.effect.dual(each.placed.place, stories)]

    def _pairs(self, search: Search) -> list[frozenset[Placed]]:
        """List two changes of a kind in one state: two that are seen only together are seen by no step towards one."""
        n = search.fitter.experiment.stories
        return [
            frozenset([a, b])
            for a, b in itertools.combinations(self._with_duals(n) if n <= MOST_PAIRED else (), 2)
            if (a.effect.name, a.place.state) == (b.effect.name, b.place.state)
        ]

    def _changes(self, search: Search) -> list[tuple[frozenset[Placed], Floats]]:
        """List every change of a state that has a dual, from the frame of each state by itself, and from its dual.

        The shear model of all states together lies between their frames, and may be nearer to another minimum.
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
            misfit = Misfit(experiment, self.there, left_out, base.misfit.noise, self.expectation, self.widened)
            frame = search.fitter.fit(misfit, base.theta, ROUGH).theta[: 2 * n]
            frames += [frame, dual_frame(frame)]
        return [(frozenset([each]), frame) for each in placed for frame in frames]


def _leader(given: Search, others: Sequence[Search]) -> Search:
    """Probe the most promising, and return the best of them."""
    if not others:
        return given
    promising = ranking.ranked(others, lambda search: search.base.score, same=ranking.SAME_ODDS)[: PROBED - 1]
    for search in (given, *promising):
        search.probe()
    return max((given, *promising), key=lambda search: search.best.score)


def _near(given: Search, others: Sequence[Search], leader: Search) -> list[Search]:
    """Search what is near the best to its end, and the numbers as given where they may still win."""
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
        search.visit(model.effects for model in leader.beam[:CARRIED_OVER])
        behind = best - search.best.score
        if behind <= REACH or (search is given and (behind <= FAR_BEHIND or leader.best.improbable)):
            search.run()
            best = max(best, search.best.score)
            kept.add(id(search))
    return [search for search in (given, *others) if id(search) in kept]


def _same_frame(a: ModelClass, b: ModelClass) -> bool:
    """Whether two fits have one frame: from another, even one that no datum tells from it, other sets are reached."""
    assert a.estimate is not None, "the shear model was fitted"
    assert b.estimate is not None, "the shear model was fitted"
    return bool(np.allclose(a.estimate.theta, b.estimate.theta, rtol=SAME_FRAME))
