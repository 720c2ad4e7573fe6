"""Close the loop on floors that turn: the symmetric frame, and what it lacks.

Frames and their modes come from columns and weights (tests/fe/plan_frames.py), the benchmark's from its members.
"""

import numpy as np
import pytest
from scipy import linalg

import cvxshear
from cvxshear.report.figures.style import applicable
from tests.fe.plan_frames import random_frame
from tests.studies import eccentric
from tests.studies.eccentric import NOISE, damaged, drawn

BRACE = {"x": 12.0576 / 106.6, "y": 12.0576 / 67.9}
"""Share of a brace in a story of the benchmark, from its stiffnesses in MN/m."""


def named(result):
    return {item.placed.label: item for item in result.effects}


@pytest.mark.parametrize("seed", [1, 3])
def test_a_moved_mass_is_found_with_its_distance(seed):
    frame, moved = drawn(seed)
    result = cvxshear.close_loop(eccentric.tested(frame, seed))
    assert result.verdict == "explained"
    (found,) = result.effects
    assert moved.found(result)
    assert result.before.p_value < 1e-9
    assert result.after.p_value > 0.01
    assert result.after.quality.errors["max_shape_error"] < 0.2 * result.before.quality.errors["max_shape_error"]
    assert found.placed.place.to_dict()["part"] == moved.part
    np.testing.assert_allclose(result.frame.mass_center, frame.mass_center, atol=3 * found.std["e"])
    np.testing.assert_allclose(result.averaged.floor_mass, frame.floor_mass, rtol=0.05)


def test_a_frame_that_is_symmetric_lacks_nothing():
    frame = random_frame(3, 5, symmetric=True)
    result = cvxshear.close_loop(eccentric.tested(frame, 5))
    assert result.verdict == "adequate"
    assert not result.effects
    assert result.frame.undetermined, "nothing couples the rotations with the displacements"


def test_a_frame_whose_centers_all_differ_has_no_single_cause():
    frame = random_frame(2, 3)
    result = cvxshear.close_loop(eccentric.tested(frame, 3))
    assert "other centers" in named(result)
    found = result.frame
    errors = (found.mass_center - frame.mass_center) / found.mass_center_std
    assert np.max(np.abs(errors)) < 4.0
    np.testing.assert_allclose(found.floor_mass, frame.floor_mass, rtol=0.05)


def test_damage_is_found_at_its_side_beside_the_heavy_slab():
    """Pattern 4 of the asymmetric benchmark: a brace of story 1 along y at x > 0, one of story 3 along x at y < 0."""
    result = damaged(4, rigid=True)
    found = named(result)
    assert set(found) == {
        'story change at story 1 in y at x > 0 of "after"', 'story change at story 3 in x at y < 0 of "after"',
        "eccentric mass at floor 4 in x", "eccentric mass at floor 4 in y",
    }  # fmt: skip
    assert all(item.probability > 0.95 for item in result.effects)
    for label, item in found.items():
        (value,), (std,) = item.parameters.values(), item.std.values()
        expected = -BRACE["y" if "in y" in label else "x"] if "story" in label else -0.048
        assert abs(value - expected) < 3.5 * std
    shown = [text.get_text() for axes in result.figure("plans").axes for text in axes.texts]
    sizes = [item.parameters["change"] for label, item in found.items() if "story" in label]
    assert sorted(shown) == sorted(f"{100 * size:.1f} %" for size in sizes)


def test_a_mass_at_a_corner_is_found_with_its_place():
    frame, loaded = (random_frame(3, 8, symmetric=True) for _ in range(2))
    mass, (x, y) = 0.1 * frame.floor_mass[1], (3.0, -2.0)
    loaded.weights[1] = np.vstack([loaded.weights[1], [x, y, mass]])
    declared = frame.experiment(9, NOISE, 1, std=NOISE).to_dict()
    after = loaded.experiment(9, NOISE, 2, std=NOISE).to_dict()["configuration"][0] | {"name": "after"}
    declared["frame"]["reference"] = "test"
    result = cvxshear.close_loop(declared | {"configuration": [*declared["configuration"], after]})
    (found,) = result.effects
    assert found.placed.label == 'added mass at floor 2 of "after"'
    for name, expected in (("mass", mass), ("x", x), ("y", y)):
        assert abs(found.parameters[name] - expected) < 3.5 * found.std[name]


def test_a_wrong_gain_is_found_at_its_sensor():
    frame = random_frame(3, 9, symmetric=True)
    declared = frame.experiment(9, 0.002, 3, std=0.002).to_dict()
    shapes = np.array(declared["configuration"][0]["mode_shapes"])
    shapes[:, 4] *= 1.1
    declared["configuration"][0]["mode_shapes"] = shapes.tolist()
    (found,) = cvxshear.close_loop(declared).effects
    assert found.placed.effect.name == "sensor_gain"
    assert found.placed.place.floor == 2
    assert "along 90 degrees" in found.placed.place.part
    assert found.parameters["g"] == pytest.approx(0.1, abs=3.5 * found.std["g"])


def test_the_tables_have_floors_stories_and_both_models():
    result = cvxshear.close_loop("examples/turning_floors.toml")
    assert set(named(result)) == {
        "eccentric mass at floor 1 in x", "eccentric mass at floor 1 in y", "eccentric stiffness in x"
    }  # fmt: skip
    table = result.to_dataframe()
    np.testing.assert_allclose(table["mass_center_x_m"], result.averaged.mass_center[:, 0])
    np.testing.assert_allclose(table["stiffness_center_x_m"], result.averaged.stiffness_center[:, 0])
    assert "symmetric model" in str(result)
    assert {entry.name for entry in applicable(result)} == {"plans", "plan_shapes"}


def test_effects_of_other_floors_are_refused_by_name():
    frame = random_frame(2, 3, symmetric=True)
    with pytest.raises(cvxshear.InputError, match="floors that do not turn"):
        cvxshear.close_loop(eccentric.tested(frame, 3), assume=["wall"])
    with pytest.raises(cvxshear.InputError, match="floors that turn"):
        cvxshear.close_loop("paper", assume=["eccentric_mass"])


def test_motions_that_no_sensor_sees_keep_their_prior_odds():
    """Sensors along x amid every floor of a symmetric frame: nothing tells of y and rotation."""
    frame = random_frame(3, 5, symmetric=True)
    sensors = [{"floor": floor, "position": [0.0, 0.0], "direction": 0.0} for floor in (1, 2, 3)]
    rng = np.random.default_rng(1)
    M, K = (matrix[::3, ::3] for matrix in frame.matrices)
    values, vectors = linalg.eigh(K, M)
    shapes = vectors.T / np.max(np.abs(vectors), axis=0)[:, None] + 0.01 * rng.standard_normal((3, 3))
    test = {"frequencies": np.sqrt(values) / (2 * np.pi), "mode_shapes": shapes, "sensors": sensors}
    test |= {"mode_shape_std": 0.01, "frequency_std": 0.002}
    declared = {"motions": ["x", "y", "rotation"], "total_mass": float(frame.floor_mass.sum())}
    seldom = {"name": "eccentric_stiffness", "probability": 0.01}
    result = cvxshear.close_loop({"frame": declared, "configuration": [test], "effect": [seldom]})
    assert not result.effects
    assert result.frame.unseen == ("y", "rotation")
    (of_all,) = [each.prior for each in result.candidates if each.placed.label == "eccentric stiffness in x"]
    # All stories count as three of the twelve places in x and y.
    assert of_all == pytest.approx(1.0 - 0.99**0.25)
    by_prior = [each for each in result.candidates if each.placed.effect.name.startswith("eccentric")]
    assert all(0.5 * each.prior < each.probability <= 1.01 * each.prior for each in by_prior)
    np.testing.assert_allclose(result.frame.floor_mass, frame.floor_mass, rtol=0.05)


def test_three_modes_leave_the_masses_to_their_prior():
    """The first mode in x, in y and of rotation fit any floors; their masses keep wide deviations about even ones."""
    frame = random_frame(4, 7, symmetric=True)
    result = cvxshear.close_loop(frame.experiment(3, 0.01, 2, std=0.01, plan=True))
    assert not result.effects
    assert np.all(result.averaged.floor_mass_std > 0.3 * result.averaged.floor_mass)
    assert np.all(np.abs(result.averaged.floor_mass / frame.floor_mass - 1.0) < 1.0)


def test_an_oblique_wall_turns_the_axes_of_its_story():
    frame = random_frame(3, 9, symmetric=True)
    stiffness = 0.3 * frame.columns[1][:, 2].sum()
    frame.columns[1] = np.vstack([frame.columns[1], [0.0, 0.0, stiffness, 0.0, np.pi / 6]])
    result = cvxshear.close_loop(frame.experiment(9, NOISE, 4, std=NOISE))
    (found,) = result.effects
    K = frame.story(1)
    assert found.placed.label == "turned axes at story 2"
    assert found.parameters["o"] == pytest.approx(2 * K[0, 1] / (K[0, 0] + K[1, 1]), abs=3.5 * found.std["o"])
    np.testing.assert_allclose(result.frame.story_stiffness[1, 0, 1], K[0, 1], rtol=0.1)
