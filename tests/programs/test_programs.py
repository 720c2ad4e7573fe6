"""Compare the programs with the printed equations of the paper."""

import numpy as np
import pytest

from cvxshear import backends
from cvxshear.model import stiffness_matrix
from cvxshear.programs import LeastSquares
from cvxshear.programs.constraints import remaining
from cvxshear.programs.formulations import mass_rows, normalized, one_shot_rows, stiffness_rows
from tests.frames import chain, modes_of

MASS = np.array([10.0, 7.5, 5.0])
STIFFNESS = np.array([1800.0, 1200.0, 600.0])


def noisy_shapes(seed=0, noise=0.05):
    _, shapes = modes_of(MASS, STIFFNESS)
    return (shapes * (1 + noise * np.random.default_rng(seed).standard_normal(shapes.shape))).T


def printed_rows(phi):
    """Return Eq. 8, row by row: phi_ki phi_kj for i <= j."""
    n, m = phi.shape
    return np.array([[phi[k, i] * phi[k, j] for k in range(n)] for i in range(m) for j in range(i, m)])


def test_mass_correction_is_the_solution_of_equation_14():
    start = np.array([7.5, 7.5, 7.5])
    phi = normalized(noisy_shapes(), start)
    A = printed_rows(phi)
    M_B = phi.T @ np.diag(start) @ phi
    B = np.array([(1.0 if i == j else 0.0) - M_B[i, j] for i in range(3) for j in range(i, 3)])
    kkt = np.zeros((4, 4))
    kkt[:3, :3], kkt[:3, 3], kkt[3, :3] = 2 * A.T @ A, 1.0, 1.0
    printed = np.linalg.solve(kkt, np.concatenate([2 * A.T @ B, [0.0]]))[:3]
    found = backends.get("kkt").solve(mass_rows(phi, start, 22.5)).x
    np.testing.assert_allclose(found, printed, rtol=1e-10)
    assert abs(found.sum()) < 1e-12


def test_stiffness_is_the_solution_of_equation_24():
    frequencies, _ = modes_of(MASS, STIFFNESS)
    phi = normalized(noisy_shapes(1), MASS)
    eigenvalues = (2 * np.pi * frequencies) ** 2
    T = np.array([[1, -1, 0], [0, 1, -1], [0, 0, 1.0]])
    X = printed_rows(T.T @ phi)
    Y = np.array([eigenvalues[i] if i == j else 0.0 for i in range(3) for j in range(i, 3)])
    printed = np.linalg.solve(X.T @ X, X.T @ Y)
    np.testing.assert_allclose(backends.get("kkt").solve(stiffness_rows(phi, eigenvalues)).x, printed, rtol=1e-10)


def test_one_shot_is_exact_for_exact_modes_of_any_scale():
    _, shapes = modes_of(MASS, STIFFNESS)
    scaled = shapes.T * np.array([3.0, -0.2, 1e3])
    np.testing.assert_allclose(backends.get("kkt").solve(one_shot_rows(scaled, 22.5)).x, MASS, rtol=1e-10)


def test_one_shot_does_not_depend_on_the_scale_of_noisy_modes():
    phi = noisy_shapes(2)
    a = backends.get("kkt").solve(one_shot_rows(phi, 22.5)).x
    b = backends.get("kkt").solve(one_shot_rows(phi * np.array([3.0, -0.2, 1e3]), 22.5)).x
    np.testing.assert_allclose(a, b, rtol=1e-9)


def test_normal_matrix_follows_from_gram_matrices():
    """A'A = (G o G + Q Q') / 2 with G = P P' and Q = P o P, since A has a row for every pair i <= j."""
    P = noisy_shapes(3)
    A = mass_rows(P, MASS, 22.5).R
    G, Q = P @ P.T, P * P
    np.testing.assert_allclose(A.T @ A, (G * G + Q @ Q.T) / 2, rtol=1e-12)


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


def test_transformation_gives_the_stiffness_matrix_of_the_chain():
    np.testing.assert_allclose(stiffness_matrix(STIFFNESS), chain(MASS, STIFFNESS)[1], rtol=1e-15)
