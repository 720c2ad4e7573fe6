"""Closing the loop: the shear model, the sets of effects that it may lack, and what the data say of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import Effect, Placed, Scale
from cvxshear.effects.state import heights_of
from cvxshear.fit.efficient import Estimate, efficient
from cvxshear.fit.expectation import Expectation
from cvxshear.fit.gauss_newton import CONVERGED_STEP
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.start import nearest_start
from cvxshear.loop.conclusion import conclude
from cvxshear.loop.fitter import ROUGH, Fitter
from cvxshear.loop.hypotheses import Hypothesis, assumed, chosen, hypotheses
from cvxshear.loop.numbering import Numbering
from cvxshear.loop.otherwise import searches
from cvxshear.loop.results import Closure
from cvxshear.loop.search import Search
from cvxshear.measurement.experiment import Experiment
from cvxshear.priors import Prior
from cvxshear.util.errors import InputError, UnsuitableError
from cvxshear.util.typing import Floats


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
        Which effects to look for, names or objects of your own; the whole catalogue where not given. An object brings
        its own probability and expected size (`Effect.expecting`).
    assume : sequence of str or Placed, optional
        Effects that are in the model from the start.
    backend : str or Backend, optional
    priors : sequence of Prior, optional
        Besides those of the experiment.
    jobs : int, optional
        Processes over which sets of effects are fitted; -1 takes every core.

    Returns
    -------
    Closure

    Raises
    ------
    InputError
        Where an effect is not known, cannot be assumed for this experiment, or does not say how large it may be.
    NoSolutionError
        Where the shear model itself could not be fitted by this backend.
    """
    experiment = experiment.with_priors(tuple(priors))
    wanted = chosen(effects)
    solver = backends.get(backend)
    there = _declared(experiment, solver, assumed(experiment, assume))
    looked_for = hypotheses(experiment, wanted, there)
    start = _first(experiment, solver, there)

    def begun(numbering: Numbering) -> Search:
        known, theta = numbering.experiment, start.theta
        if numbering.changes:
            theta = nearest_start(Misfit(known, there))
        # What is typical of the frame goes by its own fit: that of a wrong numbering may be anything.
        expectation = _expectation(known, theta, looked_for)
        fitter = Fitter(numbering, solver, looked_for, there, expectation, jobs=jobs)
        misfit = Misfit(known, there, None, start.misfit.noise, expectation)
        return Search(fitter, fitter.fit(misfit, theta, ROUGH if numbering.changes else CONVERGED_STEP))

    return conclude(searches(experiment, begun), looked_for, wanted)


def _first(experiment: Experiment, backend: Backend, there: tuple[Placed, ...]) -> Estimate:
    """The first fit, on the backend that was asked for: one that does not solve it is not fit for the others either.

    Only where the backend takes no such programs (active inequalities) another one stands in.
    """
    try:
        return efficient(experiment, backend, there)
    except UnsuitableError:
        if backend.name == "auto":
            raise
        return efficient(experiment, backends.get("auto"), there)


def _declared(experiment: Experiment, backend: Backend, there: tuple[Placed, ...]) -> tuple[Placed, ...]:
    """The assumed effects; one that these data do not determine is held at its starting value."""
    if not there:
        return there
    found = _first(experiment, backend, there)
    known = found.uncertainty.determined
    return tuple(
        placed if np.all(known[found.own(placed)]) else Placed(placed.effect, placed.place, placed.start)
        for placed in there
    )


def _expectation(experiment: Experiment, theta: Floats, looked_for: Sequence[Hypothesis]) -> Expectation:
    """What is expected of the effects and, in units of a typical floor and story of a first fit, of the frame."""
    n = experiment.stories
    mass, stiffness = np.median(theta[:n]), np.median(theta[n : 2 * n])
    scale = Scale(float(mass), float(stiffness), heights_of(experiment))
    stds = {
        item.placed: np.concatenate([[item.size], item.placed.effect.sizes(scale)[1:]])
        for item in looked_for
        if item.size is not None
    }
    found = Expectation(scale, stds)
    for item in looked_for:
        for parameter, std in zip(item.placed.effect.parameters, found.of(item.placed), strict=True):
            if np.isinf(std) and np.isinf(parameter.upper - parameter.lower):
                raise InputError(
                    f"nothing says how large {parameter.name} of the effect {item.placed.effect.name} may be: give the "
                    "effect `sizes`, or the parameter finite bounds"
                )
    return found
