"""Candidates: which effects can be looked for, their fits, and their ranking."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cvxshear.backends import Backend
from cvxshear.effects import Effect, Placed
from cvxshear.errors import CvxshearError, InputError
from cvxshear.experiment import Experiment
from cvxshear.identification.efficient import Estimate
from cvxshear.identification.misfit import Misfit
from cvxshear.loop.fitter import Fitter
from cvxshear.loop.significance import log_p_gain
from cvxshear.loop.tangent import Tangent
from cvxshear.parallel import each
from cvxshear.typing import Floats, Json

ROUGH = 1e-2
"""Tolerance of Gauss-Newton, in standard deviations, of a first fit: enough to see which candidates are in reach."""

IN_REACH = 50.0
"""Chi-square above the best at which a candidate is out of reach, and its rough fit is left as it is."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One more effect, and the fit with it.

    Parameters
    ----------
    placed : Placed
    estimate : Estimate or None
        None where the fit failed.
    log_p : float
        Of its gain over the model it was added to; 0 where the fit failed.
    confounded_with : tuple of str
        Parameters that the data cannot tell it from; empty where they can.
    failure : str
        Why there is no fit.
    """

    placed: Placed
    estimate: Estimate | None
    log_p: float
    confounded_with: tuple[str, ...] = ()
    failure: str = ""

    @property
    def admissible(self) -> bool:
        """Whether it was fitted, and the data determine its parameters."""
        return self.estimate is not None and not self.confounded_with

    def to_dict(self) -> Json:
        """Name, place, parameters and figures of the fit."""
        result = {**self.placed.to_dict(), "parameters": None, "chi2": None, "dof": None, "p_value": None}
        if self.estimate is not None:
            result["chi2"], result["dof"] = self.estimate.chi2, self.estimate.dof
            result["p_value"] = self.estimate.quality.p_value
            if not self.confounded_with:
                result["parameters"] = parameters_of(self.estimate, self.placed)
        result["gain_p_value"] = float(np.exp(self.log_p))
        result["confounded_with"] = list(self.confounded_with)
        result["failure"] = self.failure
        return result


def parameters_of(estimate: Estimate, placed: Placed) -> dict[str, float]:
    """The values of an effect's parameters by name."""
    values = estimate.theta[estimate.own(placed)]
    return {item.name: float(value) for item, value in zip(placed.effect.parameters, values, strict=True)}


def possible(experiment: Experiment, effects: Sequence[Effect], taken: Sequence[Placed]) -> list[Placed]:
    """Every effect at every place where it can sit and does not sit yet."""
    there = {(placed.effect.name, placed.place) for placed in taken}
    return [
        Placed(effect, place)
        for effect in effects
        if not effect.lacks(experiment)
        for place in effect.places(experiment)
        if (effect.name, place) not in there
    ]


def fit_candidates(tangent: Tangent, placed: Sequence[Placed], fitter: Fitter) -> list[Candidate]:
    """Fit the tangent's model with each of these effects added, best first.

    Admissible candidates come first, in order of the significance of their gain.
    """
    base = tangent.base
    rough = _roughly(tangent, placed, fitter)
    best = min((item.estimate.chi2 for item in rough if item.estimate is not None), default=np.inf)
    reach = best + IN_REACH * _noise(base, best)
    found = [
        _refined(base, item, fitter) if item.estimate is not None and item.estimate.chi2 < reach else item
        for item in rough
    ]
    return sorted(
        found, key=lambda item: (not item.admissible, item.log_p, item.estimate.chi2 if item.estimate else np.inf)
    )


def _roughly(tangent: Tangent, placed: Sequence[Placed], fitter: Fitter) -> list[Candidate]:
    """The rough fit of each candidate, over processes where the fitter has several."""
    if fitter.jobs == 1 or len(placed) < 2:
        return [fit_candidate(tangent, item, fitter, ROUGH) for item in placed]
    found = each(partial(_counted, tangent, fitter.backend), placed, jobs=fitter.jobs)
    fitter.fits += sum(fits for _, fits, _ in found)
    fitter.programs += sum(programs for _, _, programs in found)
    return [_own(tangent.base, item, candidate) for item, (candidate, _, _) in zip(placed, found, strict=True)]


def _counted(tangent: Tangent, backend: Backend, placed: Placed) -> tuple[Candidate, int, int]:
    """A rough fit in another process, with the fits and programs that it took."""
    fitter = Fitter(backend)
    return fit_candidate(tangent, placed, fitter, ROUGH), fitter.fits, fitter.programs


def _own(base: Estimate, placed: Placed, found: Candidate) -> Candidate:
    """A candidate from another process with this one's effects in it: there they were copies."""
    estimate = found.estimate
    if estimate is not None:
        estimate = dataclasses.replace(estimate, misfit=Misfit(base.experiment, (*base.effects, placed)))
    return dataclasses.replace(found, placed=placed, estimate=estimate)


def _noise(base: Estimate, best: float) -> float:
    """The variance that chi-square is measured in: 1, or what the best candidate leaves a degree of freedom."""
    return 1.0 if base.experiment.noise_declared else best / max(base.dof - 1, 1)


def _refined(base: Estimate, rough: Candidate, fitter: Fitter) -> Candidate:
    """A candidate fitted to full accuracy from where its rough fit ended."""
    assert rough.estimate is not None
    try:
        estimate = fitter.fit(rough.estimate.misfit, rough.estimate.theta)
    except CvxshearError as error:
        return Candidate(rough.placed, None, 0.0, failure=str(error))
    return dataclasses.replace(rough, estimate=estimate, log_p=log_p_gain(base, estimate) if rough.admissible else 0.0)


def fit_candidate(tangent: Tangent, placed: Placed, fitter: Fitter, tolerance: float) -> Candidate:
    """Fit the tangent's model with one more effect, starting from where it ended."""
    base = tangent.base
    if not tangent.score(placed).determined:
        return Candidate(placed, None, 0.0, confounded_with=tangent.confounders(placed))
    misfit = Misfit(base.experiment, (*base.effects, placed))
    try:
        estimate = fitter.fit(misfit, _nearer_start(misfit, tangent, placed), tolerance)
    except CvxshearError as error:
        return Candidate(placed, None, 0.0, failure=str(error))
    if not np.all(estimate.uncertainty.determined[estimate.own(placed)]):
        return Candidate(placed, estimate, 0.0, confounded_with=tangent.confounders(placed))
    return Candidate(placed, estimate, log_p_gain(base, estimate))


def _nearer_start(misfit: Misfit, tangent: Tangent, placed: Placed) -> Floats:
    """The linearised model's minimum, or the fit as it is with the effect's own start: the one that fits better."""
    plain, predicted = np.concatenate([tangent.base.theta, placed.start]), tangent.predicted(placed)
    try:
        better = misfit.evaluate(predicted, derivatives=False).chi2 < misfit.evaluate(plain, derivatives=False).chi2
    except InputError:
        # Outside the model's domain: the linearised model is no guide here.
        return plain
    return predicted if better else plain
