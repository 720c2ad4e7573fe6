"""Measurement files of frames whose floors turn: motions, plan, sensors and the places of added masses."""

import copy
import tomllib

import numpy as np
import pytest

import cvxshear
from cvxshear.io.toml import write_measurement

FILE = """
[frame]
motions = ["x", "y", "rotation"]
plan = [12.0, 9.0]
total_mass = 1e5

[[configuration]]
name = "a"
added_mass = [100.0, 200.0]
added_mass_position = [[1.0, 2.0], [0.0, 0.0]]
frequencies = [1.0, 2.0]
sensors = [
    {floor = 1, position = [5.0, 3.0], direction = 0.0},
    {floor = 1, position = [5.0, 3.0], direction = 90.0},
    {floor = 2, position = [-5.0, 3.0]},
]
mode_shapes = [[1.0, 2.0, 3.0], [2.0, nan, 1.0]]
"""


def test_a_file_is_read_and_written_as_it_is(tmp_path):
    declared = tomllib.loads(FILE)
    experiment = cvxshear.Experiment.from_dict(declared)
    assert experiment.stories == 2
    assert experiment.frame.turns
    write_measurement(tmp_path / "a.toml", experiment.to_dict())
    back = cvxshear.load(tmp_path / "a.toml")
    assert repr(back.to_dict()) == repr(experiment.to_dict())
    assert back.to_dict()["configuration"][0]["sensors"] == [
        {"direction": 0.0, **each} for each in declared["configuration"][0]["sensors"]
    ]
    assert "2 stories" in repr(back)
    assert str(back)


def test_a_sensor_reads_the_motion_of_its_place_along_its_direction():
    """A floor turns by a small angle: the corner at (5, 3) moves by angle * (-3, 5)."""
    first, second, third = cvxshear.Experiment.from_dict(tomllib.loads(FILE)).configurations[0].sensors
    motion = np.array([0.01, 0.02, 1e-3])
    np.testing.assert_allclose(first.row @ motion, 0.01 - 3 * 1e-3, rtol=1e-12)
    np.testing.assert_allclose(second.row @ motion, 0.02 + 5 * 1e-3, rtol=1e-12)
    np.testing.assert_allclose(third.row @ motion, 0.01 - 3 * 1e-3, rtol=1e-12)


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("frame", "motions"), ["y"], "motions must be"),
        (("frame", "motions"), 3, "motions must be"),
        (("frame", "motions"), ["x"], "plan belongs to floors that turn"),
        (("frame", "plan"), [1.0], "plan must have 2 entries"),
        (("frame", "plan"), [[1.0, 2.0], [3.0]], "plan, entry 2 must have 2 entries"),
        (("frame", "plan"), [[1.0, 2.0]], "speaks of 2 stories, frame: plan of 1"),
        (("frame", "plan"), 3.0, "plan must be a list of pairs"),
        (("frame", "plan_std"), -1.0, "plan_std = -1 must be greater than 0"),
        (("configuration", 0, "sensors"), 3, "sensors must be a list of sensors"),
        (("configuration", 0, "sensors"), [], "sensors must not be empty"),
        (("configuration", 0, "sensors"), None, "sensors must give the floor, position and direction"),
        (("configuration", 0, "sensors"), [{"floor": 1}], "'position' is missing"),
        (("configuration", 0, "sensors", 0, "floor"), 7, "floor = 7 must lie between 1 and 2"),
        (("configuration", 0, "sensors", 0, "position"), [1.0], "position must have 2 entries, x and y"),
        (("configuration", 0, "sensors", 0, "angle"), 1.0, "unknown key 'angle'"),
        (("configuration", 0, "sensors", 0, "direction"), "N", "direction must be a number"),
        (("configuration", 0, "sensors", 1), {"floor": 1, "position": [4.0, 3.0]}, "read the same motion"),
        (("configuration", 0, "measured_floors"), [1, 2, 3], "give sensors alone"),
        (("configuration", 0, "mode_shapes"), [[1.0, 2.0], [1.0, 1.0]], "sensors has 3 entries"),
        (("configuration", 0, "added_mass_position"), [[1.0, 2.0]], "must have 2 entries, one a floor"),
        (("configuration", 0, "added_mass"), None, "is given, but no added_mass"),
        (("configuration", 0, "modes"), [1, 7], "a frame of 2 stories has 6"),
        (("prior",), [{"kind": "bounds", "quantity": "story_stiffness", "lower": 1.0}], "one motion per floor"),
    ],
)
def test_bad_files_are_refused_by_key(place, value, said):
    declared = table = copy.deepcopy(tomllib.loads(FILE))
    for key in place[:-1]:
        table = table[key]
    table[place[-1]] = value
    with pytest.raises(cvxshear.InputError) as error:
        cvxshear.Experiment.from_dict(declared)
    assert said in str(error.value)


def test_sensors_and_places_of_masses_belong_to_floors_that_turn():
    for key in ("sensors", "added_mass_position"):
        declared = tomllib.loads(FILE)
        declared["frame"] = {"total_mass": 1e5, "stories": 2}
        others = {"sensors": "added_mass_position", "added_mass_position": "sensors"}
        declared["configuration"][0] |= {others[key]: None, "mode_shapes": [[1.0, 2.0], [2.0, 1.0]]}
        if key == "sensors":
            declared["configuration"][0]["sensors"] = declared["configuration"][0]["sensors"][:2]
        with pytest.raises(cvxshear.InputError, match="belongs to floors that turn"):
            cvxshear.Experiment.from_dict(declared)
    declared = tomllib.loads(FILE)
    declared["frame"] |= {"plan_std": 0.3}
    assert cvxshear.Experiment.from_dict(declared).frame.plan_std == 0.3
    del declared["frame"]["plan"]
    with pytest.raises(cvxshear.InputError, match="plan_std belongs to plan"):
        cvxshear.Experiment.from_dict(declared)


@pytest.mark.parametrize(
    "use", [lambda path: cvxshear.plan(path, sensors=2), lambda path: cvxshear.identify(path, method="two-stage")]
)
def test_what_takes_one_motion_per_floor_refuses_the_others(use, tmp_path):
    (tmp_path / "a.toml").write_text(FILE)
    with pytest.raises(cvxshear.UnsuitableError, match="turn"):
        use(tmp_path / "a.toml")
