"""A plan held against simulated tests: do its standard deviations hold, and its probabilities of the right verdict."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import Placed, compose
from cvxshear.fit.efficient import Estimate, fitted
from cvxshear.fit.misfit import Misfit
from cvxshear.measurement.experiment import Configuration, Experiment, Prior
from cvxshear.model.shear import modes
from cvxshear.planning.apart import SURE, evidence_of
from cvxshear.planning.results import Plan
from cvxshear.planning.targets import Target
from cvxshear.planning.template import predicted
from cvxshear.priors.nominal import Nominal
from cvxshear.priors.value import Value
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class TestScatter:
    """Errors of the frame over simulated tests.

    Parameters
    ----------
    observed, expected : ndarray, shape (2N,)
        Standard deviations of floor masses and story stiffnesses, kg and N/m, seen and as planned; nan where a
        parameter is known exactly or stays open.
    samples : int
    """

    observed: Floats
    expected: Floats
    samples: int

    @property
    def ratio(self) -> float:
        """Root mean square of observed over expected standard deviations."""
        return float(np.sqrt(np.nanmean((self.observed / self.expected) ** 2)))


def scatter(plan: Plan, samples: int, seed: int) -> TestScatter:
    """Simulate the planned tests and identify the frame from each.

    Design values are drawn too, about the frame that is there: that they are good to 5 % says no more and no less.

    Parameters
    ----------
    plan : Plan
        For the frame.
    samples : int
    seed : int
    """
    rng = np.random.default_rng(seed)
    exact, design, solver = predicted(plan), plan.model.design, backends.get("auto")
    found = np.array([_fit(_drawn(exact, plan, rng), (), design.sizes, solver).theta for _ in range(samples)])
    expected = np.concatenate([plan.chosen.floor_mass_std, plan.chosen.story_stiffness_std])
    known = expected > 1e-9 * design.sizes
    observed = np.sqrt(np.mean((found - design.sizes) ** 2, axis=0))
    return TestScatter(np.where(known, observed, np.nan), np.where(known, expected, np.nan), samples)


def right_verdicts(plan: Plan, samples: int, seed: int) -> dict[str, float]:
    """How often each effect of a plan, present in its expected size, is named with 95 % from simulated tests.

    Every model, none of the effects and each alone, is fitted to the same data; a model's evidence follows by Laplace's
    approximation from its chi-square, its effect's value, and the planned standard deviation of that.

    Parameters
    ----------
    plan : Plan
        For telling effects apart.
    samples : int
        Of each effect.
    seed : int

    Returns
    -------
    dict
        By the effect's label.
    """
    rng = np.random.default_rng(seed)
    targets, solver = plan.model.targets, backends.get("auto")
    # Standard deviations of each effect's value in its size, alone in the model: of the frame and it.
    alone = [1.0 / each.distance for each in plan.apart if each.distance is not None]
    models = list(zip((None, *targets), (0.0, *alone), strict=True))
    result = {}
    for place, truth in enumerate(targets):
        exact = _with_effect(predicted(plan), truth, plan)
        right = 0
        for _ in range(samples):
            test = _drawn(exact, plan, rng)
            evidence = [_log_evidence(test, each, std, plan, solver) for each, std in models]
            likely = np.exp(np.array(evidence) - max(evidence))
            right += bool(likely[place + 1] >= SURE * likely.sum())
        result[truth.placed.label] = right / samples
    return result


def _fit(test: Experiment, effects: Sequence[Placed], start: Floats, solver: Backend) -> Estimate:
    return fitted(Misfit(test, effects), start, solver)


def _log_evidence(test: Experiment, target: Target | None, std: float, plan: Plan, solver: Backend) -> float:
    """Logarithm of the evidence, up to what all models share."""
    sizes = plan.model.design.sizes
    if target is None:
        return -_fit(test, (), sizes, solver).chi2 / 2
    found = _fit(test, (target.placed,), np.append(sizes, target.null + target.size), solver)
    # The evidence of the linear model at the value found, its chi-square put in place of the linear one.
    own = 1.0 / std**2
    y = own * (found.theta[-1] - target.null) / target.size
    return float(evidence_of(target, own, np.array(y)) - found.chi2 / 2 - y**2 / (2 * own))


def _drawn(exact: Experiment, plan: Plan, rng: np.random.Generator) -> Experiment:
    """The experiment with noise on the planned tests and on the design values."""
    tests = tuple(_noisy(each, rng) if each.name in plan.names else each for each in exact.configurations)
    return dataclasses.replace(exact, configurations=tests, priors=tuple(_redrawn(each, rng) for each in exact.priors))


def _noisy(test: Configuration, rng: np.random.Generator) -> Configuration:
    frequencies = test.frequencies * np.exp(test.log_frequency_std * rng.standard_normal(len(test.frequencies)))
    shapes = test.mode_shapes + test.entry_std * rng.standard_normal(test.mode_shapes.shape)
    return dataclasses.replace(test, frequencies=np.sort(frequencies), mode_shapes=shapes)


def _redrawn(prior: Prior, rng: np.random.Generator) -> Prior:
    """The design values as another engineer would have them, who is as sure of them."""
    if isinstance(prior, Nominal) and prior.std is not None:
        return dataclasses.replace(
            prior, values=prior.values * (1 + prior.std * rng.standard_normal(len(prior.values)))
        )
    if isinstance(prior, Value) and prior.std is not None:
        return dataclasses.replace(prior, value=prior.value * (1 + prior.std * rng.standard_normal()))
    return prior


def _with_effect(exact: Experiment, target: Target, plan: Plan) -> Experiment:
    """The planned tests on a frame that has the effect, in its expected size."""
    theta = np.append(plan.model.design.sizes, target.null + target.size)
    tests = []
    for each in exact.configurations:
        state = compose(exact, each, (target.placed,), theta)
        found = modes(state.system.M, state.system.K)
        shapes = state.observation.shown(found.shapes[each.modes - 1], each.measured_floors - 1)
        scale = np.sum(shapes * each.mode_shapes, axis=1) / np.sum(shapes**2, axis=1)
        tests.append(
            dataclasses.replace(
                each, frequencies=found.frequencies[each.modes - 1], mode_shapes=shapes * scale[:, None]
            )
        )
    return dataclasses.replace(exact, configurations=tuple(tests))
