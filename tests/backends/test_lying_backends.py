"""Test backends that return wrong answers as solved: no method accepts them."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.optimize import nnls

from cvxshear import Experiment, NoSolutionError, backends, close_loop, identify
from cvxshear.fit.domain import Domain, domain_of
from cvxshear.fit.gauss_newton import gauss_newton
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.optimality import PlainResiduals, optimality
from cvxshear.fit.start import uniform
from cvxshear.priors import Constraints
from cvxshear.programs.constraints import NamedConstraints
from tests.frames import configuration, experiment

MASS, STIFFNESS = np.array([12.8, 18.5]), np.array([21.1e3, 35.6e3])

LIES = {
    "nothing": lambda z, _: np.zeros_like(z),
    "a line": lambda z, _: 1.1 * z + 0.1,
    "a ten-thousandth off": lambda z, _: (1 + 1e-4) * z,
    "noise": lambda z, _: z + 1e-3 * np.random.default_rng(len(z)).standard_normal(len(z)),
    "entries exchanged": lambda z, _: z[::-1].copy(),
    "half the step": lambda z, _: 0.5 * z,
    "the step backwards": lambda z, _: -z,
    "nan": lambda z, _: np.full_like(z, np.nan),
    "infinite": lambda z, _: np.full_like(z, np.inf),
    "the other half of the entries": lambda z, _: np.where(np.arange(len(z)) % 2, z, 0.0),
}


class Liar(backends.Backend):
    """Solve every program, and return another answer."""

    name = "liar"

    def __init__(self, lie):
        self.lie = lie

    def answer(self, problem):
        right = backends.get("daqp" if len(problem.F) else "kkt").answer(problem)
        return dataclasses.replace(right, z=self.lie(right.z, problem))


def frame():
    """Return two states with noisy modes, soft priors, and the total mass."""
    rng = np.random.default_rng(2)
    tests = [
        configuration(MASS, STIFFNESS, added, rng=rng, shape_noise=0.01, frequency_noise=0.001)
        for added in (None, [13.5, 8.6])
    ]
    return Experiment.from_dict(experiment(MASS, STIFFNESS, *tests))


METHODS = {
    **{
        method: (lambda of, by, method=method: identify(of, method, backend=by))
        for method in ("two-stage", "one-shot", "berman", "qi", "efficient")
    },
    "loop": lambda of, by: close_loop(of, effects=["gravity", "sensor_gain"], backend=by),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("method", METHODS)
def test_a_lie_is_refused_by_every_method(method, lie):
    with np.errstate(all="ignore"), pytest.raises(NoSolutionError, match="backend liar"):
        METHODS[method](frame(), Liar(LIES[lie]))


@pytest.mark.parametrize("method", METHODS)
def test_the_truth_is_not(method):
    METHODS[method](frame(), Liar(lambda z, _: z))


class Guest(backends.Backend):
    """Return half of another backend's step, and certify it."""

    name = "guest"

    def __init__(self, share):
        self.share = share

    def answer(self, problem):
        raise AssertionError("never asked")

    def solve(self, program, *, bounded=True):
        right = backends.get("auto").solve(program)
        return dataclasses.replace(right, point=dataclasses.replace(right.point, x=self.share * right.x))


@pytest.mark.parametrize("share", [0.0, -1.0])
def test_the_end_of_a_fit_is_judged_by_the_problem_and_not_by_its_steps(share):
    """A backend that certifies its own wrong steps ends a fit away from the minimum."""
    of = frame()
    theta = uniform(of)
    with pytest.raises(NoSolutionError, match="ended where a step of another solver lowers the misfit"):
        gauss_newton(Misfit(of), theta, domain_of(of, (), theta), Guest(share))


def test_an_exact_total_that_a_solver_misses_is_refused():
    of = frame()
    theta = uniform(of)

    class Missing(Guest):
        def solve(self, program, *, bounded=True):
            return super().solve(program.replace(A=None, b=None))

    with pytest.raises(NoSolutionError, match="breaks an exact statement"):
        gauss_newton(Misfit(of), theta, domain_of(of, (), theta), Missing(1.0))


class Line:
    """The residuals A theta - b, with derivatives that may be wrong."""

    def __init__(self, A, b, wrong=1.0):
        self.A, self.b = A, b
        self.J = A * np.where(np.arange(A.shape[1]) == 1, wrong, 1.0)

    def evaluate(self, theta, *, derivatives=True):
        return PlainResiduals(self.A @ theta - self.b, self.J)


@pytest.mark.parametrize("wrong", [2.0, 0.5, -1.0, 1.02, 0.0])
def test_wrong_derivatives_are_found_by_difference_quotients(wrong):
    rng = np.random.default_rng(4)
    A, b = rng.standard_normal((20, 4)), rng.standard_normal(20)
    domain = Domain((), np.ones(4), np.full(4, np.inf))
    backend = backends.get("auto")
    assert gauss_newton(Line(A, b), np.ones(4), domain, backend).optimality.derivative_error < 1e-6
    with pytest.raises(NoSolutionError, match="derivatives of the misfit"):
        gauss_newton(Line(A, b, wrong), np.linalg.lstsq(A, b, rcond=None)[0], domain, backend)


def test_the_best_step_is_that_of_nonnegative_least_squares():
    """Every parameter is on a bound; parameters with a gradient away from their bound move."""
    rng = np.random.default_rng(5)
    A, b = rng.standard_normal((30, 3)), rng.standard_normal(30)
    for signs in itertools.product((1.0, -1.0), repeat=3):
        lower = np.where(np.array(signs) > 0, 0.0, -np.inf)
        upper = np.where(np.array(signs) > 0, np.inf, 0.0)
        said = [NamedConstraints("signs", Constraints(lower=lower, upper=upper))]
        problem, zero = Line(A, b), np.zeros(3)
        found = optimality(problem, zero, problem.evaluate(zero), Domain(said, np.ones(3), np.full(3, np.inf)), 1e-7)
        expected, _ = nnls(A * signs, b)
        assert found.step == pytest.approx(np.linalg.norm(A @ (signs * expected)), rel=1e-6, abs=1e-9)
