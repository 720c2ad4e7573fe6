"""Compare problems of cvxpy, compiled once with numbers as parameters, with solutions by hand."""

import numpy as np
import pytest
from scipy.optimize import minimize

from cvxshear.backends import cvxpy_backend
from cvxshear.backends.canonical import Canonical
from cvxshear.programs import LeastSquares

SHAPES = [(4, 1, 2, False), (4, 0, 3, False), (4, 2, 0, False), (3, 1, 2, True)]


def scaled(shape, seed):
    """Return a scaled program of this shape with zeros and negative numbers; z = 0 satisfies the inequalities."""
    n, a, g, singular = shape
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((g, n))
    F[:, 0] = 0.0
    C = rng.standard_normal((n, n)) if singular else np.eye(n)
    return Canonical(
        C, rng.standard_normal(n), rng.standard_normal((a, n)), 0.1 * rng.standard_normal(a), F,
        rng.uniform(0.1, 0.3, g), singular, np.eye(n), 1.0, np.ones(a), np.ones(g), np.ones(a, dtype=bool),
    )  # fmt: skip


def by_scipy(problem):
    constraints = [
        {"type": "eq", "fun": lambda z: problem.E @ z - problem.e, "jac": lambda z: problem.E},
        {"type": "ineq", "fun": lambda z: problem.f - problem.F @ z, "jac": lambda z: -problem.F},
    ]
    found = minimize(
        lambda z: 0.5 * np.sum((problem.C @ z - problem.q) ** 2), np.zeros(len(problem.q)),
        jac=lambda z: problem.C.T @ (problem.C @ z - problem.q), constraints=constraints, method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    )  # fmt: skip
    return found.x


# Older cvxpy calls OSQP in a deprecated way; the backend ignores warnings of solvers.
@pytest.mark.filterwarnings("ignore:The default value of raise_error:PendingDeprecationWarning")
@pytest.mark.parametrize("solver", ["CLARABEL", "OSQP", "SCS"])
@pytest.mark.parametrize("shape", SHAPES)
def test_new_numbers_in_a_compiled_problem_give_their_own_answer(solver, shape):
    backend = cvxpy_backend.Cvxpy(solver)
    for seed in range(3):
        problem = scaled(shape, seed)
        found = backend.answer(problem)
        np.testing.assert_allclose(found.z, by_scipy(problem), atol=2e-6)
        gradient = problem.C.T @ (problem.C @ found.z - problem.q) + problem.E.T @ found.y + problem.F.T @ found.w
        np.testing.assert_allclose(gradient, 0.0, atol=2e-5)
        assert found.status == "optimal"
        assert found.iterations >= 0
    assert len(backend.compiled) == 1


def test_numbers_of_inequalities_up_to_a_power_of_two_are_one_shape(monkeypatch):
    compiled = []
    original = cvxpy_backend.parametrised
    monkeypatch.setattr(cvxpy_backend, "parametrised", lambda *shape: compiled.append(shape) or original(*shape))
    backend = cvxpy_backend.Cvxpy("CLARABEL")
    target = np.array([3.0, 2.0, 1.0, 4.0, 5.0])
    for held in (3, 4, 5):
        upper = np.full(5, np.inf)
        upper[:held] = 0.5
        found = backend.solve(LeastSquares(np.eye(5), target, upper=upper))
        np.testing.assert_allclose(found.x, np.where(np.arange(5) < held, 0.5, target), atol=1e-9)
    assert compiled == [(5, 0, 4, False), (5, 0, 8, False)]
