"""Compare the programs with the printed equations of the paper."""

import numpy as np
import pytest

from cvxshear import backends
from cvxshear.programs import LeastSquares
from cvxshear.programs.constraints import remaining
from cvxshear.programs.formulations import normalized, one_shot_rows
from tests.frames import modes_of

MASS = np.array([10.0, 7.5, 5.0])
STIFFNESS = np.array([1800.0, 1200.0, 600.0])


def noisy_shapes(seed=0, noise=0.05):
    _, shapes = modes_of(MASS, STIFFNESS)
    return (shapes * (1 + noise * np.random.default_rng(seed).standard_normal(shapes.shape))).T


def test_one_shot_does_not_depend_on_the_scale_of_noisy_modes():
    phi = noisy_shapes(2)
    a = backends.get("kkt").solve(one_shot_rows(phi, 22.5)).x
    b = backends.get("kkt").solve(one_shot_rows(phi * np.array([3.0, -0.2, 1e3]), 22.5)).x
    np.testing.assert_allclose(a, b, rtol=1e-9)


@pytest.mark.parametrize("mass", [MASS, np.diag(MASS) + 0.3 * np.ones((3, 3))])
def test_normalized_shapes_have_unit_modal_mass(mass):
    phi = normalized(noisy_shapes(4), mass)
    full = np.diag(mass) if mass.ndim == 1 else mass
    np.testing.assert_allclose(np.diag(phi.T @ full @ phi), 1.0, rtol=1e-12)


def test_weights_enter_as_the_diagonal_of_w():
    program = LeastSquares(np.eye(2), np.array([1.0, 2.0]), W=np.array([2.0, 3.0]))
    R, s = program.weighted
    np.testing.assert_array_equal(R, [[2.0, 0.0], [0.0, 3.0]])
    np.testing.assert_array_equal(s, [2.0, 6.0])


def test_bounds_become_rows_in_the_order_that_is_documented():
    program = LeastSquares(
        np.eye(2), np.zeros(2), G=np.array([[1.0, 1.0]]), h=np.array([5.0]),
        lower=np.array([-np.inf, 1.0]), upper=np.array([2.0, np.inf]),
    )  # fmt: skip
    rows, side = program.inequalities
    np.testing.assert_array_equal(rows, [[1, 1], [0, -1], [1, 0]])
    np.testing.assert_array_equal(side, [5, -1, 2])


def test_a_remainder_of_rounding_alone_is_zero():
    rows, origin = np.ones((1, 3)), np.array([0.1, 0.2, 0.3])
    assert remaining(np.array([0.6]), rows, origin)[0] == 0.0
    assert remaining(np.array([0.6 + 1e-9]), rows, origin)[0] == pytest.approx(1e-9, rel=1e-6)
