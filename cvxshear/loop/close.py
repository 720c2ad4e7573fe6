"""Closing the loop: from the shear model to the effects that it lacks, and their probabilities.

Searches run with the modes numbered as given, with other numberings, and from the dual frame. Under another numbering
the shear model is fitted first, and then the best set of the given one; it is searched to the end if either is near the
best.
"""

import copy
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cvxshear import backends
from cvxshear.effects import Effect, LocatedEffect, Scale
from cvxshear.fit import domain, gauss_newton, other_frames
from cvxshear.fit.efficient import Estimate, efficient, fitted
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.start import nearest_start
from cvxshear.loop import comparison, conclusion, hypotheses
from cvxshear.loop.fitter import Fitter, with_stand_in
from cvxshear.loop.posterior import Posterior, from_the_first_state
from cvxshear.loop.results import LoopResult
from cvxshear.loop.search import WITHIN, Search
from cvxshear.measurement.experiment import Experiment, Measurement, opened
from cvxshear.measurement.reading import without_repeated
from cvxshear.motions import symmetric
from cvxshear.priors import Prior
from cvxshear.util import decorators, errors, ranking
from cvxshear.util.typing import Floats

#: Tallest frame. The derivatives by all of its effects take some seconds, and more with the fourth power of the
#: stories.
TALLEST_SEARCH = 100


def search_for_effects(
    experiment: Measurement,
    effects: Sequence[str | Effect] | None = None,
    assume: Sequence[str | LocatedEffect] = (),
    backend: str | backends.Backend = "auto",
    priors: Sequence[Prior] = (),
) -> LoopResult:
    """Find the effects that the shear model lacks, without screening the measurement first.

    `cvxshear.close_loop` has the same parameters; it screens the measurement and then calls this function.
    """
    experiment, repeated = without_repeated(opened(experiment, turning=True).with_priors(tuple(priors)))
    experiment = replace(experiment, symmetric=experiment.frame.turns)
    if experiment.stories > TALLEST_SEARCH:
        raise errors.UnsuitableError(
            f"the loop takes frames of up to {TALLEST_SEARCH} stories, not {experiment.stories:,}: join stories, or "
            "identify the frame without effects"
        )
    wanted, left_out = hypotheses.able_to_take_part(hypotheses.chosen(effects, experiment), experiment)
    assumed = hypotheses.assumed_effects(experiment, assume)
    searches = Searches(experiment, wanted, assumed, backends.get(backend))
    found = searches.run()
    messages = (
        *(f'"{name}" repeats "{same}" to the last digit: both count as one test' for name, same in repeated),
        *(f"an effect was left out: {message}" for message in left_out),
    )
    result = _concluded(found, found, wanted, messages)
    judged = result.judged
    if not (result.provisional and judged.improbable):
        return result
    # The residual refutes the noise, so the evidence is invalid: judge the sets again under noise that suffices.
    inflated = copy.copy(searches)
    inflated.noise_inflation = float(np.sqrt(judged.fit.at.chi2 / max(judged.dof, 1)))
    again = inflated.run()
    numbered = [each.fitter.numbering.changes for each in found]
    # Only the wider noise makes these mode numbers probable: report their fit under the declared noise.
    new = {each.fitter.numbering.changes: each.fitter.numbering for each in again}
    found += [searches.start_search(each) for changes, each in new.items() if changes not in numbered]
    return _concluded(found, again, wanted, messages)


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
    looked_for = found[0].fitter.hypotheses
    models = [model for each in judging for model in (*each.visited.values(), *each.other_optima)]
    posterior = Posterior(from_the_first_state(models, looked_for, found[0].fitter.experiment), looked_for)
    fits = comparison.verdict_fits(judging, posterior.within(posterior.numberings[0].changes), found[0])
    fitters = list(dict.fromkeys(each.fitter for each in (*found, *judging)))
    effort = sum(each.fits for each in fitters), sum(each.programs for each in fitters)
    return conclusion.conclude(fits, posterior, wanted, messages=messages, effort=effort)


@dataclass(eq=False)
class Searches:
    """An experiment with everything that all of its searches share.

    Parameters
    ----------
    experiment : Experiment
    wanted : sequence of Effect
    assumed : tuple of LocatedEffect
        Effects that the model holds from the start.
    backend : Backend
    noise_inflation : float
        Factor on the standard deviations of the data.
    """

    experiment: Experiment
    wanted: Sequence[Effect]
    assumed: tuple[LocatedEffect, ...]
    backend: backends.Backend
    noise_inflation: float = 1.0

    @decorators.cached_property
    def looked_for(self) -> Sequence[hypotheses.Hypothesis]:
        """Every effect at every place, with its prior."""
        return hypotheses.hypotheses(self.experiment, self.wanted, self.assumed)

    @decorators.cached_property
    def start(self) -> Estimate:
        """The shear model with the modes as given, on the requested backend, so that a failing one is found at once."""

        def fit(by: backends.Backend) -> Estimate:
            if self.general is None:
                return efficient(self.experiment, by, self.assumed)
            own = [np.array(placed.start) for placed in self.assumed]
            theta = np.concatenate([symmetric(self.general, self.experiment.stories), *own])
            return fitted(Misfit(self.experiment, self.assumed), theta, by)

        return with_stand_in(self.backend, fit, (errors.UnsuitableError,))[0]

    @decorators.cached_property
    def expectation(self) -> domain.EffectPrior:
        """Priors of effects and frame, in units of a typical floor and story of the first fit."""
        mass, stiffness = (np.median(each) for each in self.experiment.levels(self.start.theta))
        scale = Scale.of(self.experiment, mass, stiffness)
        stds = {
            item.placed: item.placed.effect.expecting(size=item.size).expected_sizes(scale)
            for item in self.looked_for
            if item.size is not None
        }
        return domain.EffectPrior(scale, stds)

    @decorators.cached_property
    def general(self) -> Floats | None:
        """Frame that turns with all of its centers free, without effects; None for other frames."""
        if not self.experiment.symmetric:
            return None
        return efficient(replace(self.experiment, symmetric=False), backends.get("auto")).theta

    def run(self) -> list[Search]:
        """Run the searches: with the modes numbered as given, then with each numbering near the best.

        Each search runs to its end.

        Raises
        ------
        NoSolutionError
            If the shear model could not be fitted to the modes as given.
        """
        experiment = self.experiment
        given = self.start_search(hypotheses.Numbering(experiment))
        given.run()
        others = list(self._possible(hypotheses.named_numberings(experiment)))
        if given.base.improbable or given.best.effects:
            others += self._possible(hypotheses.overlooked_in_all(experiment))
        if given.unsatisfied:
            # Before a statement of the shear model is rejected, the mode numbers are questioned one test at a time.
            others += self._possible(hypotheses.overlooked_in_one(experiment))
        near = [given]
        for search in ranking.ranked(others, lambda search: search.base.score, same=ranking.SAME_ODDS):
            search.visit([given.best.effects])
            if search.best.score >= max(each.best.score for each in near) - WITHIN:
                search.run()
                near.append(search)
        duals = [other for search in near if (other := self._dual(search)) is not None]
        for search in (*near, *duals):
            search.visit_ties()
            search.refine()
            search.visit_twins()
        return [*near, *duals]

    def start_search(self, numbering: hypotheses.Numbering) -> Search:
        """Begin a search under one numbering of the modes, with its shear model fitted."""
        theta = self.start.theta
        if numbering.changes:
            theta = nearest_start(Misfit(numbering.experiment, self.assumed))
        return self._search(numbering, theta)

    def _search(self, numbering: hypotheses.Numbering, theta: Floats) -> Search:
        # Far from the data a full fit may follow an endless curved valley; effects are searched for from there, too.
        fitter = Fitter(numbering, self.backend, self.looked_for, self.assumed, self.expectation, general=self.general)
        noise = self.start.misfit.noise
        misfit = Misfit(numbering.experiment, self.assumed, None, noise, self.expectation, self.noise_inflation)
        return Search(fitter, fitter.fit(misfit, theta, gauss_newton.ROUGH))

    def _possible(self, numberings: Iterable[hypotheses.Numbering]) -> Iterator[Search]:
        """Begin a search under each numbering for which a frame satisfies the declarations."""
        for numbering in numberings:
            try:
                yield self.start_search(numbering)
            except errors.CvxshearError:
                continue

    def _dual(self, search: Search) -> Search | None:
        """Visit sets whose frames are far from the frame of the search, because frequencies alone do not exclude them.

        If the data do not distinguish a frame from its dual, begin a search at the dual of the shear model. Return None
        otherwise, or if the dual start leads to the same frame.
        """
        numbering = search.fitter.numbering
        if not hypotheses.few_floors_seen(numbering.experiment):
            return None
        found = [search.visit_from(self._duals(search)), self._visit_changes(search)]
        if any(found):
            search.run()
        if not hypotheses.dual_fits_as_well(numbering.experiment):
            return None
        theta = search.base.estimate.theta.copy()
        frame = theta[: 2 * numbering.experiment.stories]
        frame[:] = hypotheses.dual_frame(frame)
        try:
            other = self._search(numbering, theta)
        except errors.CvxshearError:
            # The declarations exclude the dual.
            return None
        same = np.allclose(other.base.estimate.theta, search.base.estimate.theta, rtol=other_frames.INSEPARABLE)
        if same or other.base.score < search.base.score - WITHIN:
            # The same frame, or another that hardly fits.
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
            (dual, hypotheses.dual_frame(model.estimate.theta[: 2 * n]))
            for model in search.beam
            if (dual := hypotheses.dual_set(model.effects, known, n)) is not None
        ]

    def _visit_changes(self, search: Search) -> bool:
        """Visit every change of a state that has a dual, from several frames; return whether a better fit was found.

        These are the frame of each single state and its dual. The shear model of all states lies between their frames,
        and may be nearer to another minimum.
        """
        base, experiment = search.base.estimate, search.fitter.experiment
        n = experiment.stories
        placed = [each.placed for each in self.looked_for if each.placed.effect.dual(each.placed.place, n)]
        frames = []
        for state in experiment.states if placed else ():
            left_out = {
                each.name: np.ones(len(each.frequencies), dtype=bool)
                for each in experiment.configurations
                if each.state != state
            }
            misfit = Misfit(
                experiment, self.assumed, left_out, base.misfit.noise, self.expectation, self.noise_inflation
            )
            frame = search.fitter.fit(misfit, base.theta, gauss_newton.ROUGH).theta[: 2 * n]
            frames += [frame, hypotheses.dual_frame(frame)]
        return search.visit_alone(placed, frames)
