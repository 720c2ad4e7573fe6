"""Compare matrices, modes, readings and the affine map with closed forms, difference quotients and members."""

import numpy as np
import pytest
from scipy import linalg

from cvxshear.model import (
    FrameSystem,
    Observation,
    attached_share,
    frame_modes,
    mode_derivatives,
    modes,
    shear_system,
    stiffness_matrix,
    transformation,
)
from cvxshear.motions import ONE_MOTION, THREE_MOTIONS, center, center_slopes, products, unit_derivatives
from cvxshear.programs.formulations import pair_products
from cvxshear.util.errors import NoModesError
from tests.fe.plan_frames import random_frame

MASS, STIFFNESS = np.array([4.0, 3.0, 2.0]), np.array([900.0, 700.0, 400.0])


@pytest.mark.parametrize("stories", [1, 2, 5, 9])
def test_stiffness_is_tridiagonal_and_in_equilibrium(stories):
    """A displaced floor deforms its two stories and pulls at the neighboring floors, not at others."""
    k = np.random.default_rng(stories).uniform(1e4, 4e4, stories)
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


@pytest.mark.parametrize("stories", [1, 3, 39, 40, 60])
def test_a_uniform_frame_has_the_frequencies_of_a_uniform_chain(stories):
    """omega_r = 2 sqrt(k / m) sin((2 r - 1) pi / (4 N + 2)); shapes follow sin(i (2 r - 1) pi / (2 N + 1))."""
    system = shear_system(np.full(stories, 5.0), np.full(stories, 2e3))
    found, r = modes(system.M, system.K), np.arange(1, stories + 1)
    np.testing.assert_allclose(
        found.frequencies, np.sqrt(2e3 / 5.0) / np.pi * np.sin((2 * r - 1) * np.pi / (4 * stories + 2)), rtol=1e-10
    )
    np.testing.assert_allclose(found.shapes @ system.M @ found.shapes.T, np.eye(stories), atol=1e-10)
    expected = np.sin(np.outer(2 * r - 1, r) * np.pi / (2 * stories + 1))
    expected *= np.sign(np.sum(expected * found.shapes, axis=1))[:, None] / np.linalg.norm(expected, axis=1)[:, None]
    np.testing.assert_allclose(found.shapes, expected / np.sqrt(5.0), atol=1e-9)
    assert np.all(found.shapes.max(axis=1) >= -found.shapes.min(axis=1) - 1e-12)


def test_a_tall_frame_that_is_no_chain_has_the_modes_of_its_matrices():
    rng = np.random.default_rng(1)
    n = 45
    K, M = stiffness_matrix(rng.uniform(1e3, 2e3, n)), np.diag(rng.uniform(1.0, 3.0, n))
    for springs, masses in (((0, 9), None), (None, (3, 4)), (None, None)):
        K_, M_ = K.copy(), M.copy()
        if springs:
            K_[np.ix_(springs, springs)] += 500.0 * np.array([[1, -1], [-1, 1]])
        if masses:
            M_[masses, masses[::-1]] = 0.3
        found = modes(M_, K_)
        np.testing.assert_allclose(found.eigenvalues, linalg.eigh(K_, M_, eigvals_only=True), rtol=1e-9)
        np.testing.assert_allclose(found.shapes @ M_ @ found.shapes.T, np.eye(n), atol=1e-12)
        np.testing.assert_allclose(K_ @ found.shapes.T, M_ @ found.shapes.T * found.eigenvalues, atol=1e-8)


@pytest.mark.parametrize("stories", [3, 45])
def test_a_frame_without_modes_is_refused(stories):
    K = stiffness_matrix(np.full(stories, 1e3))
    with pytest.raises(NoModesError, match="the mass matrix is not positive definite"):
        modes(np.diag(np.linspace(-1.0, 1.0, stories)), K)
    with pytest.raises(NoModesError, match="not stable: the lowest eigenvalue is -"):
        modes(np.eye(stories), K - 500.0 * np.eye(stories))


TALL = np.random.default_rng(0).uniform(0.7, 1.3, (2, 45)) * [[1.0], [2.0]]


@pytest.mark.parametrize(
    ("frame", "which", "rounding"),
    [
        ((MASS, STIFFNESS), slice(None), 1e-9), ((MASS, STIFFNESS), slice(1, 3), 1e-9),
        ((MASS, STIFFNESS), [0, 2], 1e-9), (TALL, [0, 3], 1e-6),
    ],
)  # fmt: skip
def test_derivatives_of_modes_are_their_difference_quotients(frame, which, rounding):
    theta, h = np.concatenate(frame), 1e-6
    system = shear_system(*frame)
    dlam, dphi = mode_derivatives(modes(system.M, system.K), system, which)

    def at(values):
        there = shear_system(*np.split(values, 2))
        return modes(there.M, there.K)

    for p, value in enumerate(theta):
        ends = [at(theta + sign * h * value * np.eye(len(theta))[p]) for sign in (1, -1)]
        np.testing.assert_allclose(
            dlam[p], (ends[0].eigenvalues - ends[1].eigenvalues)[which] / (2 * h * value), rtol=1e-6, atol=1e-8
        )
        np.testing.assert_allclose(
            dphi[p], (ends[0].shapes - ends[1].shapes)[which] / (2 * h * value), rtol=1e-5, atol=rounding
        )


@pytest.mark.parametrize("which", [slice(None), slice(2, 5), slice(6, 8), slice(7, None)])
@pytest.mark.parametrize("added", [False, True])
def test_rank_one_derivatives_and_added_terms_are_those_of_the_whole_matrices(which, added):
    """Two further parameters have no effect on the matrices, or are a mass and a spring; then one is added to both."""
    plain, rng = shear_system(MASS, STIFFNESS), np.random.default_rng(0)
    dM, dK = (np.concatenate([each, np.zeros((2, 3, 3))]) for each in (plain.dM, plain.dK))
    found = FrameSystem(ONE_MOTION, plain.M, plain.K, 8)
    if added:
        units = rng.standard_normal((3, 3, 3))
        found = found.plus("M", np.array([0.5]), units[:1], slice(6, 7))
        found = found.plus("K", np.array([0.5, 2.0]), units[1:], slice(6, 8))
        dM[6] += units[0]
        dK[6:] += units[1:]
        np.testing.assert_allclose(found.M, plain.M + 0.5 * units[0])
        np.testing.assert_allclose(found.K, plain.K + 0.5 * units[1] + 2.0 * units[2])
        assert [name for name, _ in found.arrays()] == ["M", "K", "dM", "dK"]
    found, dM, dK = found.by(which), dM[which], dK[which]
    np.testing.assert_array_equal(found.dM, dM)
    np.testing.assert_array_equal(found.dK, dK)
    phi, phi_j, u = rng.standard_normal((3, 3)), rng.standard_normal((3, 2)), rng.standard_normal(3)
    by_stiffness, by_mass = found.modal_products(phi, phi_j)
    np.testing.assert_allclose(by_stiffness, phi.T @ dK @ phi_j, atol=1e-12)
    np.testing.assert_allclose(by_mass, phi.T @ dM @ phi_j, atol=1e-12)
    np.testing.assert_allclose(found.stiffness_slopes(u), dK @ u, atol=1e-12)


def test_the_share_of_attached_masses_adds_up_to_their_number():
    """Shapes that are orthonormal in M are complete: summed over all modes, each mass has the energy of one mode."""
    M, K = np.diag([4.0, 3.0, 2.0, 0.05, 0.1]), np.zeros((5, 5))
    K[:3, :3] = stiffness_matrix(STIFFNESS)
    for own, floor, stiffness in ((3, 0, 40.0), (4, 2, 2.0)):
        K[np.ix_((floor, own), (floor, own))] += stiffness * np.array([[1, -1], [-1, 1]])
    found = modes(M, K)
    share = attached_share(found, M, 3)
    assert share.sum() == pytest.approx(2.0)
    expected = [sum(M[at, at] * shape[at] ** 2 for at in (3, 4)) for shape in found.shapes]
    np.testing.assert_allclose(share, expected)
    assert np.all(share >= 0)
    plain = shear_system(MASS, STIFFNESS)
    kept = frame_modes(found, M, 3)
    np.testing.assert_allclose(found.frequencies[kept], modes(plain.M, plain.K).frequencies, rtol=0.1)
    np.testing.assert_array_equal(frame_modes(modes(plain.M, plain.K), plain.M, 3), [0, 1, 2])


def sensors(gains):
    """Return readings of three floors with gains on some of them, and an attached mass without a sensor."""
    found = Observation(np.eye(3))
    for own, (floor, gain) in enumerate(gains, 2):
        found = found.scaled(floor, 1 + gain, own)
    return found.extended()


@pytest.mark.parametrize("floors", [slice(None), np.array([0, 2])])
@pytest.mark.parametrize("which", [slice(None), slice(3, None), slice(0, 3)])
def test_slopes_of_readings_are_their_difference_quotients(floors, which):
    """Two gains on one floor multiply; parameters 0 and 1 change the motion alone."""
    rng = np.random.default_rng(2)
    motion, slopes = rng.standard_normal((2, 4)), rng.standard_normal((5, 2, 4))
    gains = [(0, 0.1), (2, -0.2), (0, 0.3)]
    here, h = sensors(gains), 1e-6
    expected = []
    for p in range(5):
        ends = []
        for sign in (1, -1):
            moved = [(floor, gain + sign * h * (p == own)) for own, (floor, gain) in enumerate(gains, 2)]
            ends.append(sensors(moved).shown(motion + sign * h * slopes[p], floors))
        expected.append((ends[0] - ends[1]) / (2 * h))
    found = here.shown_slopes(motion, slopes[which], which, floors)
    np.testing.assert_allclose(found, np.array(expected)[which], atol=1e-8)
    np.testing.assert_allclose(here.gain, [1.1 * 1.3, 1.0, 0.8])
    np.testing.assert_allclose(here.shown(motion, floors), (motion[:, :3] * here.gain)[:, floors])


@pytest.mark.parametrize("stories", [1, 2, 5])
def test_the_map_gives_the_matrices_of_frames_assembled_from_members(stories):
    frame = random_frame(stories, seed=stories)
    masses, entries = frame.parameters
    found = THREE_MOTIONS.masses(masses), THREE_MOTIONS.stiffnesses(entries)
    for matrix, slopes, expected in zip(found, unit_derivatives(THREE_MOTIONS, stories), frame.matrices, strict=True):
        size = np.max(np.abs(expected))
        np.testing.assert_allclose(matrix, expected, rtol=1e-10, atol=1e-12 * size)
        np.testing.assert_allclose(np.tensordot([*masses, *entries], slopes, 1), matrix, atol=1e-9 * size)


def test_one_motion_per_floor_is_the_shear_frame():
    mass, stiffness = np.array([4.0, 3.0, 2.0]), np.array([900.0, 700.0, 400.0])
    system = shear_system(mass, stiffness)
    np.testing.assert_allclose(ONE_MOTION.masses(mass), system.M, rtol=1e-14)
    np.testing.assert_allclose(ONE_MOTION.stiffnesses(stiffness), system.K, rtol=1e-14)
    shapes = np.random.default_rng(1).standard_normal((3, 3))
    rows = products(shapes, shapes, ONE_MOTION.mass_basis)[np.triu_indices(3)]
    np.testing.assert_allclose(rows, pair_products(shapes), rtol=1e-14)


def test_centers_of_mass_and_of_stiffness():
    """The point masses have the same mass center; a force at the center of stiffness does not turn the floor."""
    frame = random_frame(3, seed=7)
    masses = THREE_MOTIONS.masses(frame.parameters[0])
    blocks = np.array([masses[at : at + 3, at : at + 3] for at in (0, 3, 6)])
    places, central = center(blocks)
    np.testing.assert_allclose(places, frame.mass_center, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(central, frame.inertia, rtol=1e-9)
    for story in range(3):
        K = frame.story(story)
        x, y = center(K[None])[0][0]
        for force in ([1.0, 0.0, -y], [0.0, 1.0, x]):
            motion = linalg.solve(K, force)
            assert abs(motion[2]) < 1e-12 * np.max(np.abs(motion))
    slopes = center_slopes(blocks, THREE_MOTIONS.mass_basis)
    for place in range(4):
        step = 1e-6 * abs(blocks[0][0, 0])
        moved = [center(blocks + sign * step * THREE_MOTIONS.mass_basis[place]) for sign in (-1, 1)]
        for slope, (below, above) in zip(slopes, zip(*moved, strict=True), strict=True):
            difference = (above - below) / (2 * step)
            size = np.max(np.abs(slope))
            np.testing.assert_allclose(slope[..., place], difference, rtol=1e-5, atol=1e-6 * size)
