"""If a declared value makes a unit doubtful, the check warns and does not refuse."""

import re

import numpy as np
import pytest

from cvxshear import Experiment
from cvxshear.measurement.reading import repeated_configurations
from cvxshear.screening import screen
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
        ({"total_mass_std": 1e-8}, ["deviations"]),
        ({"story_heights": [3.2, 6.4, 9.6]}, ["elevations"]),
        ({"story_heights": [3.5, 6.6, 9.7]}, ["elevations"]),
        ({"story_heights": [4.0, 3.0, 3.0]}, []),
        ({"story_heights": [3.0, 3.2, 3.4]}, []),
        ({"story_heights": [4.5, 7.5, 10.5]}, ["elevations"]),
        ({"story_heights": [6.0, 7.5, 9.0]}, []),
    ],
)
def test_a_declaration_is_asked_about_where_it_looks_wrong(frame, names):
    """Units, elevations in place of heights, and impossible deviations; a placeholder is no mass in tons."""
    assert told(building(frame=frame)) == names


def test_masses_are_told_in_the_units_of_the_library():
    (item,) = screen(Experiment.from_dict(building(frame={"total_mass": 2.0e6})))
    total, std = re.match(
        r"the added masses changed .* a frame of ([0-9.]+) t \(give or take ([0-9]+) %\), and 2000 t are", item.found
    ).groups()
    assert float(total) == pytest.approx(MASS.sum() / 1e3, rel=1e-2)
    assert 0 < float(std) < 30
    alone = building(frame={"total_mass": 52178.9 * 3, "story_heights": 0.3})
    alone["configuration"].pop()
    assert [item.found for item in screen(Experiment.from_dict(alone))] == [
        "floors of 52.2 t each under stories of 0.3 m look like masses in g"
    ]


@pytest.mark.parametrize("loads", [[ADDED], [ADDED, [5e4, 0.0, 0.0]]])
def test_one_load_is_named_before_the_total_only_where_no_other_load_agrees_with_it(loads):
    """The total is 2000 t instead of 600 t. One load determines only load over total; two loads show which is wrong."""
    tables = [configuration(MASS, STIFFNESS, added) for added in ([0.0, 0.0, 0.0], *loads)]
    (item,) = screen(Experiment.from_dict(experiment(MASS, STIFFNESS, *tables, frame={"total_mass": 2.0e6})))
    if len(loads) > 1:
        assert item.name == "total_mass"
        return
    assert (item.name, item.rivals) == ("added_mass", ("total_mass",))
    size = float(item.found.split("agrees with ")[1].split()[0])
    assert size == pytest.approx(40.0 * 2.0e6 / MASS.sum(), rel=0.1)


def test_a_load_with_its_decimal_point_in_another_place_is_named_with_its_size():
    mass, stiffness = np.array([2.0, 2.0, 1.8, 1.5]), np.array([3.0e3, 2.8e3, 2.6e3, 2.0e3])
    loads = np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5], [0.0, 0.0, 0.5, 0.0]])
    tables = [configuration(mass, stiffness, load) for load in loads]
    tables[1]["added_mass"] = [0.0, 0.0, 0.0, 5.0]
    (item,) = screen(Experiment.from_dict(experiment(mass, stiffness, *tables)))
    assert (item.name, item.rivals) == ("added_mass", ("total_mass",))
    assert '0.5 kg in place of 5 kg on floor 4 of "test 2"' in item.found


def test_the_total_of_a_model_in_tons_is_no_load_in_grams():
    """Floors of 20 g do not suit stories of half a meter."""
    mass, load = MASS / 1e4, np.array(ADDED) / 1e4
    tables = [configuration(mass, STIFFNESS / 1e4), configuration(mass, STIFFNESS / 1e4, load.tolist())]
    frame = {"total_mass": float(mass.sum()) / 1e3, "story_heights": 0.5}
    (item,) = screen(Experiment.from_dict(experiment(mass, STIFFNESS, *tables, frame=frame)))
    assert (item.name, item.found.split(": ")[1]) == ("masses", "total_mass (or floor_masses) looks like t")


def test_masses_in_tons_are_told_from_heights_where_one_configuration_is_all_there_is():
    declared = building(frame={"total_mass": 600.0, "story_heights": 3.2})
    declared["configuration"].pop()
    assert told(declared) == ["masses"]


def test_units_of_time_are_told_from_design_values_and_from_what_frames_do():
    design = [
        {"kind": "nominal", "quantity": "story_stiffness", "values": (1.1 * STIFFNESS).tolist(), "std": 0.2},
        {"kind": "nominal", "quantity": "floor_mass", "values": MASS.tolist(), "std": 0.1},
    ]
    assert told(building(prior=design)) == []
    assert told(building(prior=design, frequency=2 * np.pi)) == ["angular_frequency"]
    # Time in milliseconds makes frequencies in kHz.
    assert told(building(frequency=1e-3)) == ["time_unit"]
    up_to_scale = [{**item, "free_scale": True} for item in design]
    assert told(building(prior=up_to_scale, frequency=2 * np.pi)) == []


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
        ("frequency_std", 1e-9, ["deviations"]),
        ("frequency_std", 0.1, ["deviations"]),
        ("frequency_std", 1e-5, []),
        ("frequency_std", [0.002, 0.004, 0.02], []),
        ("mode_shape_std", 1e-30, ["deviations"]),
        ("mode_shape_std", 1.0, ["deviations"]),
        ("mode_shape_std", 0.1, []),
    ],
)
def test_deviations_that_no_instrument_has_and_percent_are_asked_about(key, value, names):
    declared = building()
    declared["configuration"][1][key] = value
    assert told(declared) == names


@pytest.mark.parametrize(("digits", "said"), [(1, ["frequencies", "shapes"]), (3, []), (None, [])])
def test_numbers_that_were_rounded_by_more_than_their_deviations_are_asked_about(digits, said):
    mass, stiffness = np.full(4, 2e5), np.full(4, 3e8)
    table = configuration(mass, stiffness) | {"frequency_std": 0.001, "mode_shape_std": 0.01}
    for key in ("frequencies", "mode_shapes") if digits else ():
        values = np.array(table[key])
        values = values / np.abs(values).max() if key == "mode_shapes" else values
        table[key] = np.round(values, digits).tolist()
    found = screen(Experiment.from_dict(experiment(mass, stiffness, table)))
    words = [item.found.split()[1] for item in found if "are rounded to 0.1" in item.found]
    assert words == said


def test_so_are_those_of_soft_statements():
    prior = {"kind": "value", "quantity": "story_stiffness", "at": 1, "value": float(STIFFNESS[0])}
    assert told(building(prior=[{**prior, "std": 1e-12}])) == ["deviations"]
    assert told(building(prior=[{**prior, "std": 1e-3}])) == []
    assert told(building(prior=[prior])) == []


def test_a_copied_configuration_is_found():
    declared = building()
    declared["configuration"] += [{**declared["configuration"][1], "name": f"copy {i}"} for i in (1, 2)]
    assert repeated_configurations(Experiment.from_dict(declared)) == (("test 2", "copy 1", "copy 2"),)
    assert told(declared) == ["repeated"]


def test_a_mode_that_looks_like_the_one_before_is_asked_about():
    """Torsion has 1.6 times the first frequency. Sensors off the center of a uniform frame measure it as sine
    shapes."""
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


@pytest.mark.parametrize(
    ("load", "shapes", "names"), [(0.5, True, ["repeated"]), (0.5, False, ["repeated"]), (1e-3, False, [])]
)
def test_a_copy_under_another_load_is_asked_about_where_the_load_must_have_shown(load, shapes, names):
    table = configuration(MASS, STIFFNESS)
    if not shapes:
        del table["mode_shapes"], table["mode_shape_std"], table["measured_floors"]
    loaded = table | {"added_mass": (load * MASS).tolist()}
    declared = experiment(MASS, STIFFNESS, table, loaded)
    found = [item for item in screen(Experiment.from_dict(declared)) if item.name == "repeated"]
    assert [item.name for item in found] == names
    assert all("have other added mass, and the same modes" in item.found for item in found)


@pytest.mark.parametrize(("load", "asked"), [(0.5, True), (1e-3, False)])
def test_frequencies_pasted_from_a_test_under_another_load_are_asked_about(load, asked):
    table, loaded = configuration(MASS, STIFFNESS), configuration(MASS, STIFFNESS, (load * MASS).tolist())
    table["mode_shapes"] = (np.array(table["mode_shapes"]) * 1.001).tolist()
    loaded["frequencies"] = table["frequencies"]
    found = screen(Experiment.from_dict(experiment(MASS, STIFFNESS, table, loaded)))
    assert any("and the same frequencies to the last digit" in item.found for item in found) == asked


@pytest.mark.parametrize(
    ("states", "asked"),
    [
        (("before", "befor"), True), (("before", "beofre"), True), (("after", "After"), True),
        (("before", "after"), False),
        (("day 1", "day 11"), False), (("case a", "case b"), False), (("NE", "N"), False), (("storyA", "story"), False),
    ],
)  # fmt: skip
def test_states_one_letter_apart_are_asked_about(states, asked):
    tables = [configuration(MASS, STIFFNESS, rng=np.random.default_rng(len(name)), state=name) for name in states]
    declared = experiment(MASS, STIFFNESS, *tables)
    found = [item for item in screen(Experiment.from_dict(declared)) if item.name == "states"]
    assert bool(found) == asked
    assert all(f'"{states[0]}", "{states[1]}"' in item.found for item in found)


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
