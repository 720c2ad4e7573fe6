"""Programs compiled by cvxpy once, against cvxpy solving them itself."""

import cvxpy as cp
import numpy as np
import pytest
from scipy import sparse

from cvxshear import UnsuitableError
from cvxshear.backends import cvxpy_backend
from cvxshear.backends.compiled import FIRST_MARK, Compiled, _places
from cvxshear.programs import LeastSquares

SHAPES = [(4, 1, 2, False), (4, 0, 3, False), (4, 2, 0, False), (3, 1, 2, True)]


def numbers(shape, seed):
    """Numbers for every parameter, zeros and negative ones among them; z = 0 satisfies the inequalities."""
    n, a, g, _ = shape
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((g, n))
    F[:, 0] = 0.0
    return {
        "q": rng.standard_normal(n), "C": rng.standard_normal((n, n)), "E": rng.standard_normal((a, n)),
        "e": 0.1 * rng.standard_normal(a), "F": F, "f": rng.uniform(0.1, 0.3, g),
    }  # fmt: skip


# Older cvxpy calls OSQP in a way that OSQP warns of; the backend passes over what solvers warn about.
@pytest.mark.filterwarnings("ignore:The default value of raise_error:PendingDeprecationWarning")
@pytest.mark.parametrize("solver", ["CLARABEL", "OSQP", "SCS"])
@pytest.mark.parametrize("shape", SHAPES)
def test_new_numbers_give_what_cvxpy_gives_for_them(solver, shape):
    compiled = Compiled(cvxpy_backend._parametrised(*shape), solver, cvxpy_backend.ACCURATE[solver])
    for seed in range(3):
        given = numbers(shape, seed)
        found = compiled.solve(given)
        whole = cvxpy_backend._parametrised(*shape)
        for name, parameter in whole.parameters.items():
            parameter.value = given[name]
        whole.problem.solve(solver="CLARABEL")
        assert found.status == cp.OPTIMAL
        np.testing.assert_allclose(found.z, whole.z.value, atol=2e-6)
        for name, constraint in whole.constraints.items():
            np.testing.assert_allclose(found.duals[name], constraint.dual_value, atol=2e-5)


def test_numbers_of_inequalities_up_to_a_power_of_two_are_one_shape(monkeypatch):
    compiled = []
    original = cvxpy_backend._parametrised
    monkeypatch.setattr(cvxpy_backend, "_parametrised", lambda *shape: compiled.append(shape) or original(*shape))
    backend = cvxpy_backend.Cvxpy("CLARABEL")
    target = np.array([3.0, 2.0, 1.0, 4.0, 5.0])
    for held in (3, 4, 5):
        upper = np.full(5, np.inf)
        upper[:held] = 0.5
        found = backend.solve(LeastSquares(np.eye(5), target, upper=upper))
        np.testing.assert_allclose(found.x, np.where(np.arange(5) < held, 0.5, target), atol=1e-9)
    assert compiled == [(5, 0, 4, False), (5, 0, 8, False)]


def test_a_cvxpy_that_changes_the_parameters_is_noticed():
    data = {"A": sparse.csc_array(np.array([[FIRST_MARK, 2 * (FIRST_MARK + 1)]])), "b": np.array([7.0]), "dims": None}
    with pytest.raises(UnsuitableError, match=r"does not hand .* as they are; choose a backend that is not cvxpy's"):
        dict(_places(data, 2))
