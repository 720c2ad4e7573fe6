"""Closing the loop: fit, look at the residual, add the effect that explains it, and again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import Effect, Placed, catalogue, named
from cvxshear.errors import InputError
from cvxshear.experiment import Experiment
from cvxshear.identification.efficient import Estimate, efficient
from cvxshear.identification.misfit import Misfit
from cvxshear.loop.candidates import Candidate, fit_candidates, parameters_of, possible
from cvxshear.loop.fitter import Fitter
from cvxshear.loop.held_out import held_out_frequency_error
from cvxshear.loop.information import information
from cvxshear.loop.next_test import next_test
from cvxshear.loop.residual import where_it_sits
from cvxshear.loop.results import Closure, Found, Step
from cvxshear.loop.significance import FAMILY_LEVEL, RESIDUAL_LEVEL, log_p_gain, not_worse, significant_gain
from cvxshear.loop.tangent import Tangent
from cvxshear.priors import Prior

MOST_EFFECTS = 6
"""Effects after which the loop stops adding: a model with more is a description, not an explanation."""

MOST_EXCHANGES = 6
"""Times that an accepted effect may be exchanged for a better one."""


def close_loop(
    experiment: Experiment,
    effects: Sequence[str | Effect] | None = None,
    assume: Sequence[str | Placed] = (),
    backend: str | Backend = "auto",
    priors: Sequence[Prior] = (),
    *,
    jobs: int = 1,
) -> Closure:
    """Find the physical effects that the shear model lacks.

    Parameters
    ----------
    experiment : Experiment
    effects : sequence of str or Effect, optional
        Which effects to look for, names or objects of your own; the whole catalogue where not given.
    assume : sequence of str or Placed, optional
        Effects that are in the model from the start.
    backend : str or Backend, optional
    priors : sequence of Prior, optional
        Besides those of the experiment.
    jobs : int, optional
        Processes over which the candidates of a step are fitted; -1 takes every core.

    Returns
    -------
    Closure

    Raises
    ------
    InputError
        Where an effect is not known, or cannot be assumed for this experiment.
    NoSolutionError
        Where the shear model itself could not be fitted.
    """
    experiment = experiment.with_priors(tuple(priors))
    wanted = (
        catalogue()
        if effects is None
        else tuple(each if isinstance(each, Effect) else named([each])[0] for each in effects)
    )
    loop = _Loop(experiment, wanted, Fitter(backends.get(backend), jobs=jobs))
    return loop.run(assumed(experiment, assume))


def assumed(experiment: Experiment, assume: Sequence[str | Placed]) -> tuple[Placed, ...]:
    """The effects that are declared from the start; one named alone must have only one place to sit."""
    result = []
    for each in assume:
        if isinstance(each, Placed):
            result.append(each)
            continue
        (effect,) = named([each])
        if effect.lacks(experiment):
            raise InputError(
                f"effect {each} cannot be assumed: the experiment does not declare {effect.lacks(experiment)}"
            )
        places = effect.places(experiment)
        if len(places) > 1:
            raise InputError(f"effect {each} can sit at {len(places)} places; assume it as Placed(effect, Place(...))")
        result.append(Placed(effect, places[0]))
    return tuple(result)


class _Loop:
    """The state of the procedure: the steps so far and the last ranking."""

    def __init__(self, experiment: Experiment, wanted: Sequence[Effect], fitter: Fitter) -> None:
        self.experiment = experiment
        self.wanted = wanted
        self.fitter = fitter
        self.steps: list[Step] = []
        self.ranking: list[Candidate] = []
        self.declared: tuple[Placed, ...] = ()
        self._fitted: dict[frozenset[Placed], list[Candidate]] = {}
        self._last_tangent: Tangent | None = None

    @property
    def now(self) -> Estimate:
        return self.steps[-1].estimate

    @property
    def added(self) -> list[Placed]:
        return [placed for placed in self.now.effects if placed not in self.declared]

    def run(self, declared: tuple[Placed, ...]) -> Closure:
        base, self.declared = self._start(declared)
        self._record(
            base, "the shear model" if not declared else f"the shear model with {_listed(declared)} assumed", 0
        )
        while len(self.added) < MOST_EFFECTS and self._add():
            self._remove()
        found = self._exchange()
        return self._closure(found)

    def _start(self, declared: tuple[Placed, ...]) -> tuple[Estimate, tuple[Placed, ...]]:
        """The first fit; an assumed effect that these data do not determine is held at its starting value."""
        base = efficient(self.experiment, self.fitter.backend, declared)
        self.fitter.fits += 1
        self.fitter.programs += base.fit.steps
        known = base.uncertainty.determined
        if all(np.all(known[base.own(placed)]) for placed in declared):
            return base, declared
        held = tuple(
            placed if np.all(known[base.own(placed)]) else Placed(placed.effect, placed.place, placed.start)
            for placed in declared
        )
        return efficient(self.experiment, self.fitter.backend, held), held

    def _record(self, estimate: Estimate, action: str, tried: int, p_value: float | None = None) -> None:
        p_value = estimate.quality.p_value if p_value is None else p_value
        self.steps.append(Step(estimate, action, tried, p_value, held_out_frequency_error(estimate, self.fitter)))

    def _add(self) -> bool:
        """Add the best candidate where its gain is significant; whether one was added."""
        base = self.now
        there = possible(self.experiment, self.wanted, base.effects)
        if not there or not self._residual_calls_for_more(there):
            return False
        self.ranking = self._candidates(base, there)
        family = sum(item.admissible for item in self.ranking)
        best = self.ranking[0]
        if not base.experiment.noise_declared:
            self._note_family_p(best, family)
        if not best.admissible or best.estimate is None or not significant_gain(best.log_p, family):
            return False
        self._record(best.estimate, f"added {best.placed.label}", family)
        return True

    def _residual_calls_for_more(self, there: Sequence[Placed]) -> bool:
        """Whether the residual is significant: as a whole, or in the direction of some candidate."""
        base = self.now
        p_value = base.quality.p_value
        if p_value is None or p_value < FAMILY_LEVEL:
            return True
        tangent = self._tangent(base)
        best = max(tangent.score(placed).gain for placed in there)
        return significant_gain(float(stats.chi2.logsf(best, 1)), len(there))

    def _candidates(self, base: Estimate, there: Sequence[Placed]) -> list[Candidate]:
        """The candidates fitted on top of a base; the same base is not fitted to again."""
        key = frozenset(base.effects)
        if key not in self._fitted:
            self._fitted[key] = fit_candidates(self._tangent(base), there, self.fitter)
        wanted = set(there)
        return [item for item in self._fitted[key] if item.placed in wanted]

    def _tangent(self, base: Estimate) -> Tangent:
        """The linearised model at a fit, made once."""
        if self._last_tangent is None or self._last_tangent.base is not base:
            self._last_tangent = Tangent(base)
        return self._last_tangent

    def _note_family_p(self, best: Candidate, family: int) -> None:
        """With an estimated noise scale, the residual's test is that of the best candidate among all."""
        last = self.steps[-1]
        p_value = min(1.0, float(np.exp(best.log_p)) * family) if best.admissible else None
        self.steps[-1] = Step(last.estimate, last.action, last.tried, p_value, last.held_out)

    def _remove(self) -> None:
        """Take out again what is not needed any more."""
        for placed in self.added[:-1]:
            without = self._without(placed)
            if not significant_gain(log_p_gain(without, self.now), len(self.ranking)):
                self._record(without, f"removed {placed.label}", 0)

    def _without(self, placed: Placed) -> Estimate:
        """The fit of the model without one of its effects."""
        now = self.now
        own = now.own(placed)
        theta = np.delete(now.theta, np.arange(own.start, own.stop))
        kept = [item for item in now.effects if item is not placed]
        return self.fitter.fit(Misfit(self.experiment, kept), theta)

    def _exchange(self) -> list[Found]:
        """Try every other effect in the place of each; exchange it where the data prefer another."""
        for _ in range(MOST_EXCHANGES):
            found = [self._found(placed) for placed in self.added]
            better = [(rival, item) for item, rivals in found for rival in rivals if _preferred(rival, self.now)]
            if not better:
                return [item for item, _ in found]
            rival, item = max(
                better, key=lambda pair: self.now.chi2 - (pair[0].estimate.chi2 if pair[0].estimate else np.inf)
            )
            assert rival.estimate is not None
            self._record(rival.estimate, f"exchanged {item.placed.label} for {rival.placed.label}", 0)
        return [item for item, _ in (self._found(placed) for placed in self.added)]

    def _found(self, placed: Placed) -> tuple[Found, list[Candidate]]:
        """An added effect with its rivals, and all candidates in its place."""
        without = self._without(placed)
        there = possible(self.experiment, self.wanted, self.now.effects)
        others = self._candidates(without, there)
        rivals = tuple(
            item
            for item in others
            if item.admissible and item.estimate is not None and not_worse(item.estimate, self.now)
        )
        own = self.now.own(placed)
        std = [None if np.isnan(value) else float(value) for value in self.now.std[own]]
        names = [item.name for item in placed.effect.parameters]
        found = Found(
            placed,
            parameters_of(self.now, placed),
            dict(zip(names, std, strict=True)),
            rivals,
            log_p_gain(without, self.now),
        )
        return found, others

    def _closure(self, found: list[Found]) -> Closure:
        last = self.steps[-1]
        significant = last.p_value is not None and last.p_value < RESIDUAL_LEVEL
        if significant:
            verdict = "unexplained"
        elif any(item.rivals for item in found):
            verdict = "ambiguous"
        else:
            verdict = "explained" if found else "adequate"
        rivals = [rival.estimate for item in found for rival in item.rivals if rival.estimate is not None]
        return Closure(
            experiment=self.experiment,
            backend=self.fitter.backend.name,
            verdict=verdict,
            rests_on=_rests_on(self.now),
            steps=tuple(self.steps),
            effects=tuple(found),
            assumed=self.declared,
            candidates=tuple(self.ranking),
            not_considered={
                each.name: each.lacks(self.experiment) for each in self.wanted if each.lacks(self.experiment)
            },
            remains=tuple(where_it_sits(self.now)) if significant else (),
            information=information(self.now, self.ranking),
            next_test=next_test(self.now, rivals) if rivals else None,
            fits=self.fitter.fits,
            programs=self.fitter.programs,
        )


def _preferred(rival: Candidate, now: Estimate) -> bool:
    """Whether the data prefer a rival to what was accepted, beyond what rounding makes."""
    return (
        rival.admissible and rival.estimate is not None and rival.estimate.chi2 < now.chi2 - 1e-6 * max(1.0, now.chi2)
    )


def _listed(placed: Sequence[Placed]) -> str:
    return ", ".join(item.label for item in placed)


def _rests_on(estimate: Estimate) -> str:
    """What the verdict rests on."""
    if estimate.dof <= 0:
        return "nothing that could speak against it: the model has as many parameters as there are data"
    if estimate.experiment.noise_declared:
        return "the declared standard deviations (chi-square test)"
    return (
        "an estimate of the noise from the residual itself, since not every standard deviation is declared (F tests): "
        f"{estimate.noise_scale:.2g} times the default weights"
    )
