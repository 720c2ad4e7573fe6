"""Compare the affine map from parameters to matrices with frames assembled member by member."""

import numpy as np
import pytest
from scipy import linalg

from cvxshear.model import shear_system
from cvxshear.motions import ONE_MOTION, THREE_MOTIONS, center, center_slopes, products, unit_derivatives
from cvxshear.programs.formulations import pair_products
from tests.fe.plan_frames import random_frame


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
