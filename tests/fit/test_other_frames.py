"""Frequencies alone can belong to several frames; `identify` lists them all."""

import math

import numpy as np
import pytest

from cvxshear import identify
from tests.frames import modes_of

BENCH = {"frame": {"floor_masses": [5.36] * 3}, "configuration": [{"frequencies": [7.203, 20.961, 30.435]}]}
ANYWHERE = 400
"""Starting points of the independent search: over ten times the fits of the library."""


def exact_frames(mass, eigenvalues):
    """Return every root of the equations of the frequencies, shape (r, N): damped Newton steps from many points."""
    n, rng = len(mass), np.random.default_rng(0)
    T, root = np.eye(n) - np.eye(n, k=1), 1 / np.sqrt(mass)
    x = 1.7 * rng.standard_normal((ANYWHERE * n, n))
    x += (np.log(eigenvalues).sum() + np.log(mass).sum()) / n - x.mean(axis=1, keepdims=True)
    for _ in range(100):
        k = np.exp(x)
        found, shapes = np.linalg.eigh(np.einsum("ij,sj,kj->sik", T, k, T) * np.outer(root, root))
        drift = np.einsum("ij,sik->sjk", T, shapes * root[:, None])
        J = (drift**2 * k[:, :, None] / found[:, None, :]).transpose(0, 2, 1)
        r = np.log(found / eigenvalues)
        normal = J.transpose(0, 2, 1) @ J + (1e-9 + 0.1 * np.sum(r**2, axis=1))[:, None, None] * np.eye(n)
        step = np.linalg.solve(normal, np.einsum("sij,si->sj", J, r)[..., None])[..., 0]
        x -= step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True))
    roots = []
    for each in x[np.abs(r).max(axis=1) < 1e-9]:
        if all(np.abs(each - other).max() > 1e-4 for other in roots):
            roots.append(each)
    return np.exp(roots)


def closest(frame, others):
    return min(np.max(np.abs(np.log(frame / other))) for other in others)


def test_three_frequencies_of_a_bench_frame_fit_two_frames():
    found = identify(BENCH)
    (other,) = found.other_frames
    np.testing.assert_allclose(found.frame.story_stiffness, [52.5e3, 57.6e3, 66.1e3], rtol=2e-3)
    np.testing.assert_allclose(other.story_stiffness, [155.3e3, 31.8e3, 40.6e3], rtol=2e-3)
    np.testing.assert_allclose(other.floor_mass, [5.36] * 3)
    assert other.chi2 < 1e-6
    assert 0.2 < other.probability < 0.5
    assert found.to_dict()["other_frames"] == [other.to_dict()]
    assert "Other frames that fit as well" in str(found)
    assert "155.3, 31.76, 40.55" in str(found)


def frame_of(stories, seed):
    """Draw masses and stiffnesses; return the masses and the squared circular frequencies."""
    rng = np.random.default_rng(seed)
    mass, stiffness = rng.uniform(8, 12, stories), rng.uniform(15e3, 30e3, stories)
    return mass, (2 * np.pi * modes_of(mass, stiffness)[0]) ** 2


@pytest.mark.parametrize("seed", range(9))
def test_every_exact_frame_is_listed(seed):
    mass, eigenvalues = frame_of(3 + seed % 3, 1000 + seed)
    frequencies = (np.sqrt(eigenvalues) / (2 * np.pi)).tolist()
    found = identify({"frame": {"floor_masses": mass.tolist()}, "configuration": [{"frequencies": frequencies}]})
    listed = [found.frame.story_stiffness, *(each.story_stiffness for each in found.other_frames)]
    exact = exact_frames(mass, eigenvalues)
    assert len(exact) > 1
    assert all(closest(frame, listed) < 1e-3 for frame in exact)
    assert sum(each.probability for each in found.other_frames) < 1
    assert found.others.searched == f"all {math.factorial(len(mass))} roots of the equations of {len(mass)} frequencies"


def test_the_proposed_test_tells_the_frames_apart():
    """The two frames of the bench have frequencies under the proposed mass that differ as the result says."""
    found = identify(BENCH)
    test, (other,) = found.others.next_test, found.other_frames
    added = np.zeros(3)
    added[test.floor - 1] = test.added_mass
    first, second = (
        np.log(modes_of(np.full(3, 5.36) + added, each.story_stiffness)[0]) for each in (found.frame, other)
    )
    # A test with the default deviation, and two frames whose frequencies in it are known about as well.
    assert np.linalg.norm(first - second) / 0.002 > test.standard_deviations > 3
    assert f"kg more on floor {test.floor} of" in str(found)
    assert found.to_dict()["next_test"] == test.to_dict()


def test_frames_of_few_sensors_are_searched_from_random_points():
    found = identify({**BENCH, "frame": {"total_mass": 16.08}, "configuration": [
        {"frequencies": [7.203, 20.961, 30.435]}, {"frequencies": [6.5, 19.5, 29.2], "added_mass": [0, 0, 2.0]}
    ]})  # fmt: skip
    assert found.others.searched == "fits from random frames, until 60 in a row found no new one"


def test_data_that_determine_the_frame_have_no_other():
    """With shapes at all floors there are more data than unknowns, so no search is needed."""
    f, shapes = modes_of([5.36] * 3, [52.5e3, 57.6e3, 66.1e3])
    table = {"frequencies": list(f), "mode_shapes": np.asarray(shapes).tolist()}
    assert identify({**BENCH, "configuration": [table]}).other_frames == ()
