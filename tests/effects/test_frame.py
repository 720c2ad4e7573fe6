"""Test the forward model: the frame's matrices, its modes, and their derivatives."""

import numpy as np
import pytest

from cvxshear.model.shear import (
    System,
    mass_matrix,
    mode_derivatives,
    modes,
    shear_system,
    stiffness_matrix,
    transformation,
)
from cvxshear.util.errors import NoModesError

MASS = np.array([10.0, 7.5, 5.0])
STIFFNESS = np.array([1800.0, 1200.0, 600.0])


def random_frame(rng, stories):
    return rng.uniform(5.0, 15.0, stories), rng.uniform(1e4, 4e4, stories)


@pytest.mark.parametrize("stories", [1, 2, 5, 9])
def test_stiffness_is_tridiagonal_and_in_equilibrium(stories):
    """A displaced floor deforms its two adjacent stories, pulls at the neighboring floors, and does not load the
    others."""
    _, k = random_frame(np.random.default_rng(stories), stories)
    K = stiffness_matrix(k)
    for floor in range(stories):
        forces = np.zeros(stories + 2)
        forces[floor] -= k[floor]
        forces[floor + 1] += k[floor]
        if floor + 1 < stories:
            forces[floor + 1] += k[floor + 1]
            forces[floor + 2] -= k[floor + 1]
        np.testing.assert_allclose(K[:, floor], forces[1 : stories + 1], rtol=1e-15, atol=0)
    np.testing.assert_array_equal(K, K.T)


def test_transformation_gives_story_drifts():
    u = np.array([0.3, 0.5, -0.2])
    np.testing.assert_allclose(transformation(3).T @ u, [0.3, 0.2, -0.7], rtol=1e-15)


def test_mass_matrix():
    np.testing.assert_array_equal(mass_matrix(MASS), [[10.0, 0, 0], [0, 7.5, 0], [0, 0, 5.0]])


def test_frequencies_of_the_papers_three_story_frame():
    """Compare with section 5 of the paper, to its four printed decimals."""
    found = modes(mass_matrix(MASS), stiffness_matrix(STIFFNESS))
    np.testing.assert_allclose(found.frequencies, [1.0336, 2.2099, 3.2812], rtol=0, atol=5e-5)


@pytest.mark.parametrize("stories", [1, 2, 3, 8, 30])
def test_modes_of_a_uniform_frame(stories):
    """omega_j = 2 sqrt(k/m) sin a_j and phi_ij ~ sin 2 i a_j, with a_j = (2j - 1) pi / (4n + 2)."""
    m, k = 3.0, 700.0
    found = modes(mass_matrix(np.full(stories, m)), stiffness_matrix(np.full(stories, k)))
    angle = (2 * np.arange(1, stories + 1) - 1) * np.pi / (4 * stories + 2)
    omega = 2 * np.sqrt(k / m) * np.sin(angle)
    np.testing.assert_allclose(found.eigenvalues, omega**2, rtol=1e-11)
    np.testing.assert_allclose(found.frequencies, omega / (2 * np.pi), rtol=1e-11)
    waves = np.sin(2 * np.outer(angle, np.arange(1, stories + 1)))
    waves /= np.sqrt(m * np.sum(waves**2, axis=1, keepdims=True))
    np.testing.assert_allclose(np.abs(found.shapes), np.abs(waves), rtol=0, atol=1e-11)
    np.testing.assert_allclose(np.abs(np.sum(m * found.shapes * waves, axis=1)), 1.0, rtol=1e-11)


@pytest.mark.parametrize("stories", [1, 4, 12])
def test_modes_are_orthonormal(stories):
    rng = np.random.default_rng(stories + 100)
    m, k = random_frame(rng, stories)
    M = mass_matrix(m) + 0.5 * (np.eye(stories, k=1) + np.eye(stories, k=-1))
    K = stiffness_matrix(k)
    found = modes(M, K)
    np.testing.assert_allclose(found.shapes @ M @ found.shapes.T, np.eye(stories), rtol=0, atol=1e-12)
    spectrum = found.shapes @ K @ found.shapes.T
    np.testing.assert_allclose(spectrum, np.diag(found.eigenvalues), rtol=0, atol=1e-12 * found.eigenvalues[-1])
    assert np.all(np.diff(found.eigenvalues) > 0)


def test_largest_entry_of_a_shape_is_positive():
    rng = np.random.default_rng(3)
    for _ in range(10):
        m, k = random_frame(rng, 6)
        shapes = modes(mass_matrix(m), stiffness_matrix(k)).shapes
        assert np.all(shapes.max(axis=1) == np.abs(shapes).max(axis=1))


def test_a_frame_that_buckles_is_refused():
    K = stiffness_matrix(STIFFNESS) - 500.0 * np.eye(3)
    with pytest.raises(NoModesError, match="not stable"):
        modes(mass_matrix(MASS), K)


@pytest.mark.parametrize("least", [0.0, -1.0])
def test_a_mass_matrix_that_is_not_positive_is_refused(least):
    with pytest.raises(NoModesError, match="mass matrix is not positive definite"):
        modes(np.diag([10.0, least, 5.0]), stiffness_matrix(STIFFNESS))


def test_shear_system_is_linear_in_its_parameters():
    """The derivatives times the parameters add up to the matrices."""
    system = shear_system(MASS, STIFFNESS)
    every = np.concatenate([MASS, STIFFNESS])
    np.testing.assert_allclose(np.einsum("p,pij->ij", every, system.dM), system.M, rtol=1e-14)
    np.testing.assert_allclose(np.einsum("p,pij->ij", every, system.dK), system.K, rtol=1e-14)
    for p in range(3):
        moved = MASS + (np.arange(3) == p)
        np.testing.assert_allclose(mass_matrix(moved) - system.M, system.dM[p], rtol=1e-13, atol=1e-12)
        stiffer = STIFFNESS + (np.arange(3) == p)
        np.testing.assert_allclose(stiffness_matrix(stiffer) - system.K, system.dK[3 + p], rtol=1e-10, atol=1e-10)
    assert not system.dM[3:].any()
    assert not system.dK[:3].any()


def full_system(rng, stories, parameters):
    """Return full matrices, linear in some parameters."""

    def symmetric(scale):
        A = rng.standard_normal((parameters, stories, stories))
        return scale * (A + A.transpose(0, 2, 1)) / 2

    m, k = random_frame(rng, stories)
    return System(mass_matrix(m), stiffness_matrix(k), symmetric(1.0), symmetric(2e3))


@pytest.mark.parametrize("which", [slice(None), slice(0, 2), [0, 3], np.array([1, 2, 4])])
def test_derivatives_of_modes(which):
    """Compare with central differences of the eigenproblem. Their error at this step is about 1e-7 of the values."""
    system = full_system(np.random.default_rng(11), 5, 4)
    at = modes(system.M, system.K)
    dlam, dphi = mode_derivatives(at, system, which)
    step = 1e-4
    assert dlam.shape == (4, len(at.eigenvalues[which]))
    assert dphi.shape == (4, len(at.eigenvalues[which]), 5)
    for p in range(4):
        ahead = modes(system.M + step * system.dM[p], system.K + step * system.dK[p])
        behind = modes(system.M - step * system.dM[p], system.K - step * system.dK[p])
        by_lam = (ahead.eigenvalues - behind.eigenvalues)[which] / (2 * step)
        by_phi = (ahead.shapes - behind.shapes)[which] / (2 * step)
        np.testing.assert_allclose(dlam[p], by_lam, rtol=1e-6, atol=1e-6 * np.max(np.abs(dlam)))
        np.testing.assert_allclose(dphi[p], by_phi, rtol=1e-6, atol=1e-6 * np.max(np.abs(dphi)))


def test_derivatives_of_frequencies_scale_as_they_must():
    """Scaling all masses or all stiffnesses gives sum m dlam/dm = -lambda and sum k dlam/dk = lambda; shapes scale with
    the masses only."""
    system = shear_system(MASS, STIFFNESS)
    at = modes(system.M, system.K)
    dlam, dphi = mode_derivatives(at, system, slice(None))
    np.testing.assert_allclose(MASS @ dlam[:3], -at.eigenvalues, rtol=1e-12)
    np.testing.assert_allclose(STIFFNESS @ dlam[3:], at.eigenvalues, rtol=1e-12)
    np.testing.assert_allclose(np.einsum("p,pij->ij", MASS, dphi[:3]), -0.5 * at.shapes, rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.einsum("p,pij->ij", STIFFNESS, dphi[3:]), np.zeros((3, 3)), rtol=0, atol=1e-13)
