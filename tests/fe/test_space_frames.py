"""Compare frames in space with formulas and the published modes of the benchmark; identify them."""

import csv

import numpy as np
import pytest

import cvxshear
from tests.fe.space_frames import MACHINE, WALLED_PLAN, Bar, bar_stiffness, iasc_asce, walled
from tests.frames import shared
from tests.studies.asymmetric import BRACE, LOSSES, SIDE, identified, losses, side

PUBLISHED = (8.58788, 9.18059, 14.57956, 23.45219, 25.94589, 36.81298, 40.64587, 42.20972, 46.97827, 56.73733, 62.96357,
             81.04580)  # fmt: skip
"""Frequencies of the symmetric undamaged frame with 120 degrees of freedom, Hz."""


def test_a_cantilever_in_space():
    """Check L^3 / 3EI in both planes, L / EA and L / GJ for loads along the axes of a skew member."""
    first, second = np.array([2.0, 1.0, 2.0]) / 3, np.array([1.0, -2.0, 0.0]) / np.sqrt(5)
    third, length = np.cross(first, second), 1.7
    K = bar_stiffness(Bar(9.0, (2.0, 5.0), 3.0), np.zeros(3), length * first, second)
    flexibility = np.linalg.inv(K[6:, 6:])
    for axis, expected in ((first, length / 9.0), (second, length**3 / 6.0), (third, length**3 / 15.0)):
        assert axis @ flexibility[:3, :3] @ axis == pytest.approx(expected, rel=1e-12)
    assert first @ flexibility[3:, 3:] @ first == pytest.approx(length / 3.0, rel=1e-12)
    # A force along the second axis turns the tip about the third, by L^2 / 2EI.
    assert third @ flexibility[3:, :3] @ second == pytest.approx(length**2 / 4.0, rel=1e-12)
    hinged = bar_stiffness(Bar(9.0, (2.0, 5.0), 3.0), np.zeros(3), length * first, second, hinged=True)
    assert second @ hinged[6:9, 6:9] @ second == pytest.approx(3 * 2.0 / length**3, rel=1e-12)


def frequencies(frame):
    return np.sqrt(frame.model.modes()[0]) / (2 * np.pi)


def test_the_benchmark_has_its_published_frequencies():
    frame = iasc_asce(heavy_slab=False)
    assert len(frame.model.coordinates) == 120
    np.testing.assert_allclose(frequencies(frame)[:12], PUBLISHED, rtol=5e-5)


@pytest.mark.parametrize(("model", "rtol"), [("12", 3e-5), ("120", 1.2e-4)])
def test_every_pattern_has_its_published_frequencies(model, rtol):
    """The published members have a small inertia about their own axes; here their mass is lumped at points."""
    with (shared("data", "iasc-asce") / "modes.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["model"] == model]
    for pattern in range(7):
        expected = [float(row["hz"]) for row in rows if row["damage"] == str(pattern)]
        found = frequencies(iasc_asce(pattern, heavy_slab=False, rigid=model == "12"))
        np.testing.assert_allclose(found[: len(expected)], expected, rtol=rtol)


def test_rigid_joints_give_masses_centers_stories_and_every_lost_brace():
    before = identified(0, rigid=True, noise=0.0)
    # 150 kg more at (-0.625, -0.625) m on a roof of 1809.9 kg.
    center = -0.625 * 150 / 1959.9
    np.testing.assert_allclose(before.floor_mass, [3452.4, 2652.4, 2652.4, 1959.9], rtol=1e-4)
    np.testing.assert_allclose(before.mass_center, [[0, 0], [0, 0], [0, 0], [center, center]], atol=1e-5)
    np.testing.assert_allclose(before.stiffness_center, 0.0, atol=1e-5)
    for K in before.story_stiffness / 1e6:
        np.testing.assert_allclose(K, np.diag([106.6007, 67.9044, 232.0221]), rtol=1e-5, atol=1e-3)
    for pattern, braces in LOSSES.items():
        after = identified(pattern, rigid=True, noise=0.0)
        lost, _ = losses(before, after)
        expected = [[braces.get((axis, story), 0.0) * BRACE for axis in "xy"] for story in range(1, 5)]
        np.testing.assert_allclose(lost, expected, atol=1e-3)
        for (axis, story), count in braces.items():
            if count <= 1:
                assert side(before, after, story, axis) == pytest.approx(SIDE if axis == "y" else -SIDE, rel=1e-3)


def test_turning_joints_leave_masses_and_the_place_of_every_lost_brace():
    """The shear model lacks the joints' rotation: masses are right to 0.2 %, stories and losses are not."""
    before = identified(0, rigid=False, noise=0.0)
    np.testing.assert_allclose(before.floor_mass, [3452.4, 2652.4, 2652.4, 1959.9], rtol=2e-3)
    np.testing.assert_allclose(before.mass_center[3], -0.0478, atol=5e-4)
    for pattern, braces in LOSSES.items():
        after = identified(pattern, rigid=False, noise=0.0)
        lost, _ = losses(before, after)
        for place, axis in enumerate("xy"):
            stories = {story for direction, story in braces if direction == axis}
            if stories:
                assert {int(each) + 1 for each in np.argsort(-lost[:, place])[: len(stories)]} == stories
        for (axis, story), count in braces.items():
            if count <= 1:
                assert lost[story - 1, "xy".index(axis)] == pytest.approx(count * BRACE, rel=0.3)
                assert side(before, after, story, axis) * (1 if axis == "y" else -1) == pytest.approx(SIDE, rel=0.25)


def test_noise_leaves_losses_within_their_deviations():
    scores = []
    before = identified(0, rigid=True)
    for pattern, braces in LOSSES.items():
        lost, std = losses(before, identified(pattern, rigid=True, seed=pattern))
        expected = [[braces.get((axis, story), 0.0) * BRACE for axis in "xy"] for story in range(1, 5)]
        scores.append((lost - expected) / std)
    assert np.sqrt(np.mean(np.square(scores))) < 1.5


def test_a_wall_and_a_machine():
    """The wall bends as a cantilever, which no story does; floors and the side of the wall are right."""
    frame = walled()
    result = cvxshear.identify(frame.experiment(WALLED_PLAN, total_mass=322_000), method="one-shot").frame
    (_, *place), mass = MACHINE
    np.testing.assert_allclose(result.floor_mass, [130_600, 100_600, 90_800], rtol=2e-3)
    # The wall's line mass differs a little from a column's, at x = 6 m.
    np.testing.assert_allclose(result.mass_center[0], np.array(place) * mass / 130_600, atol=0.01)
    np.testing.assert_allclose(result.mass_center[1:], 0.0, atol=0.01)
    assert np.all(result.stiffness_center[1:, 0] > 1.0)
