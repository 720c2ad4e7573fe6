"""Compare the certificate of a fit with closed forms and another solver, on problems with linear residuals."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from cvxshear.fit.domain import Domain
from cvxshear.fit.optimality import PlainResiduals, best_step, derivative_error, optimality, sensitivities, violation
from cvxshear.priors import Constraints
from cvxshear.programs.constraints import NamedConstraints
from cvxshear.util.errors import NoModesError

WEIGHT = 1e-7


class Linear:
    """Residuals J theta - s, with derivatives wrong by a factor; `refused` marks points without residuals."""

    def __init__(self, J, s, *, factor=1.0, refused=lambda theta: False):
        self.J, self.s, self.factor, self.refused = np.asarray(J), np.asarray(s), factor, refused

    def evaluate(self, theta, /, *, derivatives=True):
        if self.refused(theta):
            raise NoModesError("none here")
        return PlainResiduals(self.J @ theta - self.s, self.factor * self.J)


def domain(scale, **said):
    return Domain((NamedConstraints("said", Constraints(**said)),), np.array(scale), np.full(len(scale), np.inf))


def drawn(seed=3, rows=9, unknowns=4):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((rows, unknowns)) * [1.0, 30.0, 0.2, 4.0][:unknowns], rng.standard_normal(rows)


def test_sensitivities_are_lengths_of_columns_up_to_a_limit():
    J = np.array([[3.0, 0.0, 1e9], [4.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(sensitivities(J, domain([1.0, 2.0, 4.0])), [5.0, 1.0, 2.5e6])


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        # Sizes plus units: 2 and 1 / 5; a thousandth of 40, twice, because the sensitivity is zero; 3 and 1 / 10.
        ({"A": [[1.0, 0.0, 0.0]], "b": [2.1]}, 0.1 / 2.2),
        ({"A": [[0.0, 2.0, 0.0]], "b": [-0.02]}, 0.04 / (2 * (0.01 + 0.04))),
        ({"G": [[1.0, 0.0, -2.0]], "h": [7.5]}, 0.5 / (2.2 + 2 * 3.1)),
        ({"G": [[1.0, 0.0, -2.0]], "h": [8.5]}, 0.0),
        ({"lower": [-9.0, 0.03, -9.0]}, 0.02 / 0.05),
        ({"upper": [9.0, 9.0, -3.2]}, 0.2 / 3.1),
    ],
)
def test_a_violation_is_relative_to_the_sizes_of_its_terms(said, expected):
    theta = np.array([2.0, 0.01, -3.0])
    at = Linear(np.diag([5.0, 0.0, 10.0]), np.ones(3)).evaluate(theta)
    said = {key: np.array(value) for key, value in said.items()}
    # If a parameter has no sensitivity, its unit is its size: a thousandth of its maximum.
    assert violation(theta, at, domain([1.0, 40.0, 1.0], **said)) == pytest.approx(expected, rel=1e-9)


def test_the_best_step_is_the_solution_of_the_constrained_program():
    J, s = drawn()
    theta = np.array([0.5, 0.1, 2.0, -1.0])
    at = Linear(J, s).evaluate(theta)
    free, length = best_step(theta, at, domain(np.ones(4)), WEIGHT)
    np.testing.assert_allclose(free, np.linalg.lstsq(J, s, rcond=None)[0] - theta, rtol=1e-6)
    assert length @ length == pytest.approx(at.objective - np.sum((J @ (theta + free) - s) ** 2))
    # One parameter is on a bound that the step would cross, one on a bound that it leaves. Other bounds are too far
    # away.
    lower, upper = np.where(free < 0, theta, -1e9), np.where(free > 0, theta, 1e9)
    lower[2], upper[2], lower[3], upper[3] = -1e9, 1e9, -1e9, 1e9
    lower[3 if free[3] > 0 else 2] = theta[3 if free[3] > 0 else 2]
    held, _ = best_step(theta, at, domain(np.ones(4), lower=lower, upper=upper), WEIGHT)
    expected = lsq_linear(J, -at.r, (lower - theta - 1e-15, upper - theta + 1e-15), tol=1e-14)
    np.testing.assert_allclose(held, expected.x, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("twice", [False, True])
def test_a_step_keeps_equalities_those_said_twice_included(twice):
    J, s = drawn()
    theta, A = np.array([0.5, 0.1, 2.0, -1.0]), np.array([[1.0, 1.0, 1.0, 1.0], [0.0, 2.0, -1.0, 0.0]])
    A = np.concatenate([A, A[:1] + A[1:]]) if twice else A
    at = Linear(J, s).evaluate(theta)
    step, _ = best_step(theta, at, domain(np.ones(4), A=A, b=A @ theta), WEIGHT)
    within = np.linalg.svd(A)[2][2:].T
    np.testing.assert_allclose(step, -within @ np.linalg.lstsq(J @ within, at.r, rcond=None)[0], rtol=1e-6)


@pytest.mark.parametrize("factor", [1.0, 1.1, 0.8, 1.01])
def test_the_error_of_derivatives_that_are_wrong_by_a_factor(factor):
    """At residuals of zero, the slope of |r|^2 is wrong by 2 (f - 1) |J d|^2, relative to the stated slope."""
    J, s = drawn()
    theta = np.linalg.lstsq(J, s, rcond=None)[0]
    problem = Linear(J, J @ theta, factor=factor)
    found = derivative_error(problem, theta, problem.evaluate(theta), domain(np.ones(4)))
    assert found == pytest.approx(abs(factor - 1) / max(factor, factor**2), rel=1e-6, abs=1e-9)


def test_the_error_is_looked_for_on_the_other_side_where_one_has_no_residuals():
    J, s = drawn(unknowns=1)
    theta = np.linalg.lstsq(J, s, rcond=None)[0]
    whole = Linear(J, J @ theta, factor=1.1)
    for refused, error in (
        (lambda at: at[0] > theta[0], 0.1 / 1.21),
        (lambda at: at[0] < theta[0], 0.1 / 1.21),
        (lambda at: at[0] != theta[0], 0.0),
    ):
        problem = Linear(J, J @ theta, factor=1.1, refused=refused)
        found = derivative_error(problem, theta, whole.evaluate(theta), domain(np.ones(1)))
        assert found == pytest.approx(error, rel=1e-6)


def test_the_certificate_has_all_three():
    J, s = drawn()
    theta = np.linalg.lstsq(J, s, rcond=None)[0] + [0.3, 0.0, 0.0, 0.0]
    problem, within = Linear(J, s), domain(np.ones(4), upper=np.array([theta[0] - 0.1, 9.0, 9.0, 9.0]))
    found = optimality(problem, theta, problem.evaluate(theta), within, WEIGHT)
    unit = 1 / max(np.linalg.norm(J[:, 0]), 1 / abs(theta[0]))
    assert found.violation == pytest.approx(0.1 / (abs(theta[0]) + unit))
    assert found.step == pytest.approx(0.3 * np.linalg.norm(J[:, 0]), rel=1e-5)
    assert found.derivative_error < 1e-9
