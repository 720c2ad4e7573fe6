"""Identification of frames whose floors turn, against frames assembled from columns and point masses."""

import numpy as np
import pytest

import cvxshear
from cvxshear.motions import center
from tests.fe.plan_frames import random_frame
from tests.studies.turning import bound, identified_deviations, identified_values, true_values


def identified(frame, method="one-shot", **options):
    return cvxshear.identify(frame.experiment(**options), method=method)


@pytest.mark.parametrize("method", ["one-shot", "efficient"])
@pytest.mark.parametrize("seed", range(7))
def test_exact_modes_give_masses_centers_inertias_and_stories(seed, method):
    stories = 2 + seed % 7
    frame = random_frame(stories, seed)
    result = identified(frame, method, modes={2: 6, 3: 6, 4: 7, 5: 9, 6: 9, 7: 10, 8: 12}[stories])
    found = result.frame
    a = frame.plan[0]
    np.testing.assert_allclose(found.floor_mass, frame.floor_mass, rtol=1e-8)
    np.testing.assert_allclose(found.mass_center, frame.mass_center, atol=1e-8 * a)
    np.testing.assert_allclose(found.inertia, frame.inertia, rtol=1e-8)
    for story, K in enumerate(found.story_stiffness):
        expected = frame.story(story)
        sizes = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(K / sizes, expected / sizes, atol=1e-8)
        np.testing.assert_allclose(found.stiffness_center[story], center(expected[None])[0][0], atol=1e-8 * a)
    assert found.undetermined == ()
    assert result.fit.max_frequency_error < 1e-8
    assert result.fit.min_mac == pytest.approx(1.0, abs=1e-10)


@pytest.mark.parametrize("method", ["one-shot", "efficient"])
@pytest.mark.parametrize("noise", [0.0, 0.005])
@pytest.mark.parametrize("stories", [2, 4])
def test_without_eccentricity_the_scale_of_the_inertias_is_open(stories, noise, method):
    """The rotations are modes of their own: their inertias and stiffnesses have a common factor."""
    frame = random_frame(stories, 31, symmetric=True)
    result = identified(frame, method, noise=noise, seed=2, std=max(noise, 1e-6))
    found = result.frame
    (group,) = found.undetermined
    floors = range(1, stories + 1)
    assert set(group) == {f"{name} {floor}" for name in ("inertia", "story_stiffness rr") for floor in floors}
    assert np.all(np.isnan(found.inertia))
    assert np.all(np.isnan(found.story_stiffness[:, 2, 2]))
    np.testing.assert_allclose(found.floor_mass, frame.floor_mass, rtol=max(8 * noise, 1e-8))
    np.testing.assert_allclose(found.mass_center, 0.0, atol=max(8 * noise, 1e-8) * frame.plan[0])
    for story, K in enumerate(found.story_stiffness):
        np.testing.assert_allclose(K[:2, :2], frame.story(story)[:2, :2], atol=max(20 * noise, 1e-8) * K[1, 1])
    assert result.fit.max_frequency_error < max(3 * noise, 1e-8)
    if not noise:
        assert result.fit.min_mac == pytest.approx(1.0, abs=1e-10)


@pytest.mark.parametrize("method", ["one-shot", "efficient"])
def test_a_plan_tells_the_scale_of_the_inertias(method):
    frame = random_frame(3, 31, symmetric=True)
    found = identified(frame, method, plan=True).frame
    assert found.undetermined == ()
    expected = frame.floor_mass * np.sum(np.square(frame.plan)) / 12
    np.testing.assert_allclose(found.inertia / found.inertia.mean(), frame.inertia / frame.inertia.mean(), rtol=1e-4)
    assert np.all(np.abs(found.inertia - expected) < 3 * found.inertia_std)
    assert 0.05 < found.inertia_std[0] / found.inertia[0] < 0.2


@pytest.mark.parametrize("method", ["one-shot", "efficient"])
def test_a_direction_that_no_sensor_sees_is_named(method):
    """A frame that is symmetric about the x axis; its sensors read x at both edges."""
    frame = random_frame(2, 31, symmetric=True)
    for weights in frame.weights:
        weights[weights[:, 1] > 0, 2] *= 1.6
    b = frame.plan[1]
    sensors = [{"floor": floor, "position": [0.0, y], "direction": 0.0} for floor in (1, 2) for y in (-b / 2, b / 2)]
    declared = frame.experiment(sensors=sensors).to_dict()
    tested = declared["configuration"][0]
    seen = np.max(np.abs(tested["mode_shapes"]), axis=1) > 1e-9
    for key in ("frequencies", "frequency_std", "mode_shape_std", "mode_shapes"):
        tested[key] = np.asarray(tested[key])[seen].tolist()
    del tested["modes"]
    result = cvxshear.identify(declared, method=method)
    found = result.frame
    assert found.unseen == ("y",)
    np.testing.assert_allclose(found.floor_mass, frame.floor_mass, rtol=1e-7)
    np.testing.assert_allclose(found.mass_center[:, 1], frame.mass_center[:, 1], rtol=1e-7)
    np.testing.assert_allclose(found.inertia, frame.inertia, rtol=1e-7)
    for story in range(2):
        K = frame.story(story)
        np.testing.assert_allclose(
            found.story_stiffness[story][[0, 2, 0], [0, 2, 2]], K[[0, 2, 0], [0, 2, 2]], rtol=1e-6, atol=1e-9 * K[0, 0]
        )
    named = {name for group in found.undetermined for name in group}
    for floor in (1, 2):
        open_ones = {"mass_center_x", "story_stiffness yy", "story_stiffness xy", "story_stiffness yr"}
        assert {f"{name} {floor}" for name in open_ones} <= named
    assert np.all(np.isnan(found.story_stiffness[:, 1, 1]))
    assert result.fit.max_frequency_error < 1e-7


def test_deviations_are_those_of_many_tests():
    """Errors over deviations have a root mean square of about one, over 40 tests of one frame."""
    frame = random_frame(2, 3)
    expected = {
        "floor_mass": frame.floor_mass, "mass_center": frame.mass_center, "inertia": frame.inertia,
        "story_stiffness": np.array([frame.story(story) for story in range(2)]),
    }  # fmt: skip
    scores = {name: [] for name in expected}
    for seed in range(40):
        found = identified(frame, noise=0.002, seed=seed, std=0.002).frame
        for name, value in expected.items():
            scores[name].append((getattr(found, name) - value) / getattr(found, f"{name}_std"))
    for name, each in scores.items():
        assert 0.75 < np.sqrt(np.mean(np.square(each))) < 1.3, name


@pytest.mark.parametrize("noise", [0.002, 0.01])
def test_errors_of_the_efficient_method_are_those_of_the_bound(noise):
    """Twelve tests of one frame: the bound is computed from difference quotients (`tests/studies/turning.py`)."""
    frame = random_frame(2, 3)
    limit, true = bound(frame, 6, noise), true_values(frame)
    errors, scores = [], []
    for seed in range(12):
        found = identified(frame, "efficient", modes=6, noise=noise, seed=seed, std=noise)
        errors.append((identified_values(found.frame) - true) / limit)
        scores.append((identified_values(found.frame) - true) / identified_deviations(found.frame))
        np.testing.assert_allclose(identified_deviations(found.frame) / limit, 1.0, atol=50 * noise)
        assert found.fit.p_value > 1e-4
    assert np.sqrt(np.mean(np.square(errors))) < 1.2
    assert np.mean(np.abs(scores) < 1.96) > 0.9


def test_a_story_that_hardly_resists_rotation_is_found():
    """Nearly all of the stiffness of story 2 is at one place, so its matrix is singular but for a ten-thousandth."""
    frame = random_frame(2, 1)
    a = frame.plan[0]
    frame.columns[1] = np.array([[0.3 * a, 0.0, 2e7, 3e7, 0.0], [-0.3 * a, 0.0, 1e3, 2e4, 0.0]])
    found = identified(frame, "efficient")
    assert np.linalg.eigvalsh(found.frame.story_stiffness[1] / [1, 1, a] / [[1], [1], [a]])[0] < 1e-3 * 2e7
    np.testing.assert_allclose(found.frame.story_stiffness[1], frame.story(1), rtol=1e-7, atol=1e-3)
    assert found.parts[0].active == ()
    noisy = identified(frame, "efficient", noise=0.002, seed=1, std=0.002)
    assert noisy.fit.p_value > 1e-3
    error = np.diag(noisy.frame.story_stiffness[1] - frame.story(1))
    assert np.all(np.abs(error) < 4 * np.diag(noisy.frame.story_stiffness_std[1]))


def test_states_and_known_masses_are_fitted_together():
    """Two tests of one frame: a known mass off the center tells the scale of the inertias of a symmetric frame."""
    frame = random_frame(2, 31, symmetric=True)
    load = np.array([2.0, 1.5, 0.2 * frame.floor_mass[1]])
    loaded = type(frame)(frame.plan, frame.columns, [frame.weights[0], np.vstack([frame.weights[1], load])])
    declared = frame.experiment(name="bare", state="as built").to_dict()
    more = loaded.experiment(
        name="loaded", state="as built", added_mass=[0.0, load[2]], added_mass_position=[[0.0, 0.0], load[:2].tolist()]
    )
    declared["configuration"] += more.to_dict()["configuration"]
    found = cvxshear.identify(declared)
    assert found.frame.undetermined == ()
    np.testing.assert_allclose(found.frame.inertia, frame.inertia, rtol=1e-6)
    np.testing.assert_allclose(found.frame.mass_center, 0.0, atol=1e-6)
    assert len(found.fit.errors) > 0
    assert [each.configuration for each in found.parts[0].predictions] == ["bare", "loaded"]


def test_text_json_and_table():
    result = identified(random_frame(2, 3), noise=0.002, seed=1, std=0.002)
    said = str(result)
    for word in ("mass, t", "center x", "inertia", "story_stiffness"):
        assert word.replace("story_stiffness", "stiffness") in said
    frame = result.to_dict()["frame"]
    assert np.shape(frame["story_stiffness"]) == (2, 3, 3)
    assert np.shape(frame["mass_center_std"]) == (2, 2)
    table = result.to_dataframe()
    np.testing.assert_allclose(table["mass_center_x_m"], result.frame.mass_center[:, 0])
    np.testing.assert_allclose(table["story_stiffness_xr_N"], result.frame.story_stiffness[:, 0, 2])
    assert "one-shot" in repr(result)


@pytest.mark.parametrize("method", ["two-stage", "berman", "qi"])
def test_other_methods_refuse(method):
    with pytest.raises(cvxshear.UnsuitableError, match="methods efficient and one-shot"):
        cvxshear.identify(random_frame(2, 3).experiment(), method=method)


def test_every_backend_solves_the_programs_of_a_frame_that_turns():
    """A matrix inequality that is active is for conic solvers; without one, all solvers reach the closed form."""
    comparison = cvxshear.compare_backends("examples/turning_floors.toml", ["kkt", "quadprog", "clarabel"], repeats=1)
    held = {row.backend: row.failure for row in comparison.rows if row.kind == "bounded mass"}
    assert not held["clarabel"]
    assert "matrix inequality" in held["quadprog"]
    assert all(row.difference < 1e-9 for row in comparison.rows if row.kind != "bounded mass")


@pytest.mark.parametrize("method", ["one-shot", "efficient"])
def test_priors_of_floor_masses_hold(method):
    """An exact ratio holds to rounding and an active bound is named; exact modes do not notice what is true of them."""
    frame = random_frame(3, 4)
    mass = frame.floor_mass
    exact, noisy = frame.experiment(9).to_dict(), frame.experiment(9, 0.01, 2, std=0.01).to_dict()
    true = {"kind": "ratio", "quantity": "floor_mass", "of": 2, "to": 1, "value": mass[1] / mass[0]}
    found = cvxshear.identify(exact | {"prior": [true]}, method=method).frame
    np.testing.assert_allclose(found.floor_mass, mass, rtol=1e-7)
    alike = {"kind": "ratio", "quantity": "floor_mass", "of": 3, "to": 2, "value": 1.3}
    found = cvxshear.identify(noisy | {"prior": [alike]}, method=method).frame
    assert found.floor_mass[2] / found.floor_mass[1] == pytest.approx(1.3, rel=1e-9)
    heavy = {"kind": "bounds", "quantity": "floor_mass", "lower": [1.02 * mass[0], 0.0, 0.0]}
    result = cvxshear.identify(noisy | {"prior": [heavy]}, method=method)
    assert result.frame.floor_mass[0] == pytest.approx(1.02 * mass[0], rel=1e-6)
    assert any("floor_mass" in each.name for each in result.parts[0].active)


def test_a_soft_prior_of_masses_weighs_by_its_deviation():
    """A nominal mass of tiny deviation is met; one of a huge deviation changes nothing."""
    frame = random_frame(3, 4)
    noisy = frame.experiment(9, 0.01, 2, std=0.01).to_dict()
    nominal = 1.05 * frame.floor_mass
    plain = cvxshear.identify(noisy).frame.floor_mass
    for std, expected in ((1e-5, nominal / nominal.sum() * frame.floor_mass.sum()), (100.0, plain)):
        prior = {
            "kind": "nominal", "quantity": "floor_mass", "values": nominal.tolist(), "std": std, "free_scale": True
        }  # fmt: skip
        found = cvxshear.identify(noisy | {"prior": [prior]}).frame.floor_mass
        np.testing.assert_allclose(found, expected, rtol=2e-4)


def test_three_modes_leave_the_floors_open():
    """The first mode in x, in y and of rotation: no orthogonality tells floors of four apart."""
    frame = random_frame(4, 7, symmetric=True)
    result = cvxshear.identify(frame.experiment(3, 0.01, 2, std=0.01, plan=True))
    (group,) = (each for each in result.undetermined if "floor_mass 1" in each)
    assert {f"floor_mass {floor}" for floor in range(1, 5)} <= set(group)
    assert np.all(np.isnan(result.frame.floor_mass))
