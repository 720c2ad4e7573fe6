"""Test Gauss-Newton on problems of one and two unknowns: its end and the reason, with given steps."""

from types import SimpleNamespace

import numpy as np
import pytest

from cvxshear import backends
from cvxshear.fit.domain import Domain
from cvxshear.fit.gauss_newton import (
    ROUGH,
    Accuracy,
    Ending,
    gauss_newton,
    halved,
    made_feasible,
    satisfied,
    step_program,
)
from cvxshear.fit.optimality import PlainResiduals
from cvxshear.priors.base import Constraints
from cvxshear.programs import LeastSquares
from cvxshear.programs.constraints import NamedConstraints
from cvxshear.util.errors import NoModesError, NoSolutionError

AUTO = backends.get("auto")


def free(n, **more):
    return Domain((), np.ones(n), np.full(n, np.inf), **more)


class Problem:
    """Residuals that are a function of the unknowns, with difference quotients as derivatives."""

    def __init__(self, function, beyond=np.inf):
        self.function, self.beyond = function, beyond

    def evaluate(self, theta, *, derivatives=True):
        if np.any(theta > self.beyond):
            raise NoModesError("too far")
        steps = 1e-6 * np.eye(len(theta))
        J = np.transpose([(self.function(theta + step) - self.function(theta - step)) / 2e-6 for step in steps])
        return PlainResiduals(self.function(theta), J)


class Refusing:
    """A backend that leaves its first programs unsolved."""

    name = "refusing"

    def __init__(self, refusals, after=0):
        self.refusals, self.after, self.weights = refusals, after, []

    def solve(self, program, *, bounded=True):
        self.weights.append(program.R[-1, -1])
        self.after -= 1
        if self.after < 0 < self.refusals:
            self.refusals -= 1
            raise NoSolutionError(self.name, "gave up")
        return AUTO.solve(program, bounded=bounded)


def test_a_step_is_held_back_by_weights_in_proportion_to_sensitivities():
    J, r, theta = np.array([[3.0, 0.0], [4.0, 2.0]]), np.array([1.0, -2.0]), np.array([0.5, 0.2])
    program = step_program(PlainResiduals(r, J), theta, free(2), 0.1)
    np.testing.assert_allclose(program.R.T @ program.R, J.T @ J + np.diag([0.5, 0.2]) ** 2)
    np.testing.assert_allclose(program.R.T @ program.s, -J.T @ r)


def test_a_linear_problem_ends_with_a_step_of_nothing():
    A, b = np.array([[1.0, 2.0], [0.0, 1.0], [1.0, 0.0]]), np.array([1.0, 2.0, 3.0])
    found = gauss_newton(Problem(lambda x: A @ x - b), np.zeros(2), free(2), AUTO)
    np.testing.assert_allclose(found.theta, np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-9)
    assert (found.reason, found.steps, found.converged) == (Ending.STATIONARY, 2, True)
    assert found.optimality.step < 1e-6
    rough = gauss_newton(Problem(lambda x: A @ x - b), np.zeros(2), free(2), AUTO, ROUGH)
    assert rough.optimality is None
    once = gauss_newton(Problem(lambda x: A @ x - b), np.zeros(2), free(2), AUTO, Accuracy(1e-6, 1))
    assert (once.reason, once.steps, once.converged) == (Ending.STEP_LIMIT, 1, False)


def test_a_valley_that_bends_is_followed_to_its_end():
    """Rosenbrock's valley is a thousand deviations wide: residuals 1e4 (y - x^2) and 1e3 (1 - x)."""
    valley = Problem(lambda x: np.array([1e4 * (x[1] - x[0] ** 2), 1e3 * (1 - x[0])]))
    found = gauss_newton(valley, np.array([-1.2, 1.0]), free(2), AUTO)
    np.testing.assert_allclose(found.theta, 1.0, atol=1e-6)
    assert found.converged


def test_too_long_a_step_is_halved():
    at = PlainResiduals(np.array([2.0]), np.eye(1))
    for size, factor in ((4.0, 0.5), (1.0, 1.0), (13.0, 0.25), (30.0, None)):
        taken = halved(Problem(lambda x: x + 2.0), np.zeros(1), np.array([-size]), at, free(1), 2)
        assert (taken is None) == (factor is None)
        if taken is not None:
            assert (taken[0], taken[1].objective) == (-factor * size, pytest.approx((2 - factor * size) ** 2))
    assert halved(Problem(lambda x: x + 2.0), np.zeros(1), np.array([-4.0]), at, free(1), 0) is None
    # A step to a point without modes, or beyond the domain, is halved as well.
    up = PlainResiduals(np.array([-2.0]), np.eye(1))
    assert halved(Problem(lambda x: x - 2.0, beyond=1.5), np.zeros(1), np.array([2.0]), up, free(1), 2)[0] == 1.0
    near = free(1, farthest=np.array([1.5]))
    assert halved(Problem(lambda x: x - 2.0), np.zeros(1), np.array([2.0]), up, near, 2)[0] == 1.0


def test_a_hopeless_fit_is_given_up_after_three_steps_that_bring_little():
    """The misfit falls by one part in a hundred per step, from residuals of ten deviations."""

    class Slow:
        name = "slow"

        def solve(self, program, *, bounded=True):
            return SimpleNamespace(x=np.array([-0.05]))

    found = gauss_newton(Problem(lambda x: x + 10.0), np.zeros(1), free(1), Slow(), Accuracy(1e-3, 30, 0.02))
    assert (found.reason, found.steps) == (Ending.FLAT, 3)
    found = gauss_newton(Problem(lambda x: x + 10.0), np.zeros(1), free(1), Slow(), Accuracy(1e-3, 30, 0.009))
    assert (found.reason, found.steps) == (Ending.STEP_LIMIT, 30)
    near = gauss_newton(Problem(lambda x: x + 4.9), np.zeros(1), free(1), Slow(), Accuracy(1e-3, 20, 0.5))
    assert near.reason is Ending.STEP_LIMIT


def test_a_backend_that_refuses_is_asked_again_with_more_damping_six_times():
    line = Problem(lambda x: x - 3.0)
    for refusals in (1, 3):
        backend = Refusing(refusals)
        found = gauss_newton(line, np.zeros(1), free(1), backend)
        assert found.theta[0] == pytest.approx(3.0)
        expected = np.cumprod([1e-7, 1e5, *(2.0 ** np.arange(2, 7))])[: refusals + 1]
        np.testing.assert_allclose(backend.weights[: refusals + 1], expected, rtol=1e-6)
    # After six refusals the damped step is nearly zero and another solver's step is better; the seventh ends the fit.
    for refusals, said in ((6, "a step of another solver"), (7, "gave up")):
        backend = Refusing(refusals)
        with pytest.raises(NoSolutionError, match=said):
            gauss_newton(line, np.zeros(1), free(1), backend)
        assert (len(backend.weights) == 7) is (refusals == 7)
    # If no solved step lowers the misfit, an unsolved step could still do so: the fit is refused.
    kink = Problem(lambda x: np.array([1.0 + np.abs(x[0]), 1.0 - 0.5 * x[0]]))
    with pytest.raises(NoSolutionError, match="gave up"):
        gauss_newton(kink, np.zeros(1), free(1), Refusing(1))


def test_a_start_that_breaks_a_statement_is_moved_to_the_nearest_that_keeps_it():
    """Distances are relative to each unknown's size: from (1, 1), with sizes 1 and 2, x + y = 3 gives (1.2, 1.8)."""
    said = Constraints(A=np.ones((1, 2)), b=np.array([3.0]))
    domain = Domain([NamedConstraints("sum", said)], np.array([1.0, 2.0]), np.full(2, np.inf))
    np.testing.assert_allclose(made_feasible(np.ones(2), domain, AUTO), [1.2, 1.8])
    kept = np.array([1.0, 2.0])
    assert made_feasible(kept, domain, AUTO) is kept
    found = gauss_newton(Problem(lambda x: x - np.array([1.0, 1.0])), np.zeros(2), domain, AUTO)
    np.testing.assert_allclose(found.theta, 1.5, atol=1e-6)


@pytest.mark.parametrize(("off", "kept"), [(0.0, True), (2.2e-13, True), (3.0e-13, False)])
def test_a_statement_is_kept_to_rounding_of_its_terms(off, kept):
    """A row (1, 1) of unknowns of sizes 1 and 2 has terms of sqrt(5)."""
    scale = np.array([1.0, 2.0])
    base = {"R": np.eye(2), "s": np.zeros(2)}
    for sign in (1.0, -1.0):
        assert satisfied(LeastSquares(**base, A=np.ones((1, 2)), b=np.array([sign * off])), scale) is kept
    assert satisfied(LeastSquares(**base, G=np.ones((1, 2)), h=np.array([-off])), scale) is kept
    assert satisfied(LeastSquares(**base, G=np.ones((1, 2)), h=np.array([off])), scale)
