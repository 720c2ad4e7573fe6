"""If a declared value makes a unit doubtful, the check warns and does not refuse."""

import re

import numpy as np
import pytest

from cvxshear import Experiment
from cvxshear.measurement.reading import repeated_configurations
from cvxshear.screening import screen
from tests.fe.experiments import simulated
from tests.fe.plan_frames import random_frame
from tests.frames import configuration, experiment

MASS = np.array([2.1e5, 2.0e5, 1.9e5])
STIFFNESS = np.array([3.0e8, 2.6e8, 2.2e8])
ADDED = [0.0, 0.0, 4e4]
"""Added masses on a three-story building: a load on its roof."""


def building(*, frame=None, frequency=1.0, prior=()):
    tables = [configuration(MASS, STIFFNESS), configuration(MASS, STIFFNESS, ADDED)]
    for table in tables:
        table["frequencies"] = [frequency * value for value in table["frequencies"]]
    return experiment(MASS, STIFFNESS, *tables, frame={"total_mass": float(MASS.sum()), **(frame or {})}, prior=prior)


def told(declared):
    items = screen(Experiment.from_dict(declared))
    assert not any(item.refuses for item in items)
    return [item.name for item in items]


@pytest.mark.parametrize(
    ("frame", "names"),
    [
        ({"story_heights": 3.2, "gravity": 9.81}, []),
        ({"story_heights": 3200.0}, ["heights"]),
        ({"story_heights": 320.0}, ["heights"]),
        ({"gravity": 981.0}, ["gravity"]),
        ({"gravity": 32.2}, ["gravity"]),
        ({"gravity": 1.0}, ["gravity"]),
        ({"total_mass": 600.0}, ["masses"]),
        ({"total_mass": 6e8}, ["masses"]),
        ({"total_mass": 600.0, "story_heights": 3.2}, ["masses"]),
        ({"total_mass": 1.0, "total_mass_placeholder": True, "story_heights": 3.2}, ["total_mass"]),
    ],
)
def test_a_declaration_is_asked_about_where_it_looks_wrong(frame, names):
    """Units; a placeholder is no mass in tons."""
    assert told(building(frame=frame)) == names


def test_masses_are_told_in_the_units_of_the_library():
    (item,) = screen(Experiment.from_dict(building(frame={"total_mass": 2.0e6})))
    total, std = re.match(
        r"the added masses changed .* a frame of ([0-9.]+) t \(give or take ([0-9]+) %\), and 2000 t are", item.found
    ).groups()
    assert float(total) == pytest.approx(MASS.sum() / 1e3, rel=1e-2)
    assert 0 < float(std) < 30
    alone = building(frame={"total_mass": 600.0, "story_heights": 3.2})
    alone["configuration"].pop()
    assert [item.found for item in screen(Experiment.from_dict(alone))] == [
        "floors of 200 kg each under stories of 3.2 m look like masses in t"
    ]


def test_rad_per_second_are_told_from_a_buildings_height():
    stories = 10
    mass, stiffness = np.full(stories, 3e5), np.full(stories, 1.2e9)
    table = configuration(mass, stiffness)
    assert told(experiment(mass, stiffness, table, frame={"total_mass": 3e6, "story_heights": 3.5})) == []
    table["frequencies"] = [2 * np.pi * value for value in table["frequencies"]]
    assert told(experiment(mass, stiffness, table, frame={"total_mass": 3e6, "story_heights": 3.5})) == [
        "angular_frequency"
    ]


@pytest.mark.parametrize(
    ("key", "value", "names"),
    [
        ("frequency_std", 0.1, ["deviations"]),
        ("frequency_std", 1e-5, []),
        ("frequency_std", [0.002, 0.004, 0.02], []),
        ("mode_shape_std", 1.0, ["deviations"]),
        ("mode_shape_std", 0.1, []),
    ],
)
def test_deviations_in_percent_are_asked_about(key, value, names):
    declared = building()
    declared["configuration"][1][key] = value
    assert told(declared) == names


def test_a_copied_configuration_is_found():
    declared = building()
    declared["configuration"] += [{**declared["configuration"][1], "name": f"copy {i}"} for i in (1, 2)]
    assert repeated_configurations(Experiment.from_dict(declared)) == (("test 2", "copy 1", "copy 2"),)
    assert told(declared) == ["repeated"]


def test_a_mode_that_looks_like_the_one_before_is_asked_about():
    """Torsion has 1.6 times the first frequency; sensors off the center measure it as sine shapes."""
    n, sensors = 8, np.array([2, 5, 8])
    angle = (2 * np.arange(1, n + 1) - 1) * np.pi / (2 * n + 1)
    frequency, shapes = 10.0 * np.sin(angle / 2), np.sin(np.outer(angle, sensors))
    table = {"frequencies": frequency[:3].tolist(), "mode_shapes": shapes[:3].tolist(), "measured_floors": [2, 5, 8]}
    declared = {"frame": {"stories": n, "total_mass": 8.0}, "configuration": [table]}
    assert told(declared) == []
    seen = [frequency[0], 1.6 * frequency[0], frequency[1]]
    twisted = [shapes[0], shapes[0] + [0.03, -0.04, 0.0], shapes[1]]
    table |= {"frequencies": seen, "mode_shapes": [row.tolist() for row in twisted]}
    assert "look_alike" in [item.name for item in screen(Experiment.from_dict(declared))]


def test_tests_that_were_repeated_are_no_copies():
    """Two states of the same masses, or single frequencies equal after rounding, are no copies either."""
    declared = building()
    again = {**declared["configuration"][1], "name": "again"}
    again["frequencies"] = [1.0001 * value for value in again["frequencies"]]
    declared["configuration"].append(again)
    assert repeated_configurations(Experiment.from_dict(declared)) == ()
    alone = [{"name": f"test {i}", "frequencies": [2.5, 7.1]} for i in (1, 2)]
    few = {"frame": {"stories": 2, "total_mass": 10.0}, "configuration": alone}
    assert repeated_configurations(Experiment.from_dict(few)) == ()


@pytest.mark.parametrize("factor", [2 * np.pi, 60.0, 1000.0])
def test_one_configuration_in_another_unit_of_frequency_is_refused_until_it_is_accepted(factor):
    declared = building()
    third = configuration(MASS, STIFFNESS * [1.0, 0.7, 1.0])
    declared["configuration"].append({"name": "after", **third})
    assert told(declared) == []
    declared["configuration"][1]["frequencies"] = [factor * f for f in declared["configuration"][1]["frequencies"]]
    found = screen(Experiment.from_dict(declared))
    assert [(item.name, item.configuration, item.refuses) for item in found] == [("frequency_unit", "test 2", True)]
    declared["frame"]["accept"] = ["frequency_unit"]
    assert [item.name for item in screen(Experiment.from_dict(declared)) if item.refuses] == []


def test_a_story_that_lost_nearly_everything_changes_no_unit():
    """The modes of a changed frame do not all change by one factor."""
    declared = building()
    declared["configuration"].append({"name": "after", **configuration(MASS, STIFFNESS * [0.02, 1.0, 1.0])})
    assert "frequency_unit" not in {item.name for item in screen(Experiment.from_dict(declared))}


@pytest.mark.parametrize(("unit", "factor"), [("t", 1e-3), ("kN", 9.81e-3), ("N", 9.81)])
def test_added_masses_in_another_unit_are_named(unit, factor):
    declared, _ = simulated(None, stories=5, configurations=3, rng=np.random.default_rng(3))
    assert told(declared) == []
    for table in declared["configuration"]:
        table["added_mass"] = [factor * value for value in table["added_mass"]]
    items = screen(Experiment.from_dict(declared))
    assert any("added_mass" in item.found and f"like {unit}" in item.found for item in items)


@pytest.mark.parametrize(
    ("positions", "named"),
    [(1.0, []), (1e3, ["outside_plan"]), (np.array([6.0, 4.5]), ["outside_plan"])],
    ids=["m", "mm", "from a corner"],
)
def test_sensors_outside_the_plan_are_asked_about(positions, named):
    """Sensors at the corners of the plan are inside."""
    frame = random_frame(2, 3)
    declared = frame.experiment(6, plan=True).to_dict()
    for sensor in declared["configuration"][0]["sensors"]:
        place = np.array(sensor["position"])
        sensor["position"] = (place + positions if np.ndim(positions) else place * positions).tolist()
    found = screen(Experiment.from_dict(declared))
    assert [item.name for item in found] == named
    assert not any(item.refuses for item in found)
