"""Test measured frames with a fact known from another source: the loop finds the cause and adds no other effect."""

import tomllib

import numpy as np
import pytest

import cvxshear
from cvxshear.io.toml import MEASURED_FRAMES, built_in_text
from tests.closed import built_in
from tests.frames import shared
from tests.studies import built_in_files

# LA-14393, Table 2: the kind of change, its floor or story, its size. A column at 12.5 % of its bending stiffness
# reduces its story stiffness by 7/32.
DONE_AT_LOS_ALAMOS = {
    "state 2": ("added_mass", 1, 1.2),
    "state 3": ("added_mass", 2, 1.2),
    "state 4": ("story_change", 2, -0.21875),
    "state 5": ("story_change", 2, -0.4375),
    "state 6": ("story_change", 3, -0.21875),
    "state 7": ("story_change", 3, -0.4375),
    "state 8": ("story_change", 4, -0.21875),
    "state 9": ("story_change", 4, -0.4375),
}

MIRROR = {"added_mass": {1: 4, 2: 3, 3: 2, 4: 1}, "story_change": {2: 4, 3: 3, 4: 2}}
"""Mirror image of each floor with an equal plate, and of each equal story between them."""


def level(placed):
    return placed.place.floor or placed.place.story


def names(closure):
    return sorted(item.placed.label for item in closure.effects)


def test_los_alamos_has_one_change_a_state_of_the_kind_and_size_that_was_made():
    closure = built_in("los-alamos")
    assert closure.verdict in ("explained", "ambiguous")
    found = {item.placed.place.state: item for item in closure.effects}
    assert len(closure.effects) == len(found) == 8
    assert set(found) == set(DONE_AT_LOS_ALAMOS)
    for state, (name, _, size) in DONE_AT_LOS_ALAMOS.items():
        assert found[state].placed.effect.name == name
        (value,) = found[state].parameters.values()
        assert value == pytest.approx(size, rel=0.3)


def test_los_alamos_names_six_of_eight_at_their_place_and_the_others_as_ties():
    """The frame is nearly its own mirror image: mirrored states 2 and 4 change the log evidence by less than 0.2."""
    first = 0
    for item in built_in("los-alamos").effects:
        name, at, _ = DONE_AT_LOS_ALAMOS[item.placed.place.state]
        if level(item.placed) == at:
            first += 1
            continue
        tied = [rival for rival in item.rivals if rival.placed.effect.name == name and level(rival.placed) == at]
        assert tied
        assert tied[0].probability > 0.25
        assert level(item.placed) == MIRROR[name][at]
    assert first >= 6


def test_los_alamos_is_told_from_frequencies_alone():
    closure = built_in("los-alamos")
    assert all(not each.mode_shapes.size for each in closure.experiment.configurations)
    assert closure.before.estimate.chi2 > 1000
    assert closure.estimate.chi2 < 40


@pytest.mark.parametrize("name", built_in_files.MINI)
def test_the_joints_of_the_mini_table_turn(name):
    closure = built_in(name)
    assert names(closure) == ["joint rotation"]
    assert closure.verdict == "explained"
    assert closure.effects[0].probability > 0.95
    assert closure.before.estimate.chi2 > 100
    assert closure.estimate.chi2 < 25
    assert closure.after.held_out < 0.5 * closure.before.held_out


@pytest.mark.parametrize("columns", ["flexible", "stiff"])
def test_both_records_of_a_mini_table_say_the_same(columns):
    """Results of an earthquake and a sine of different amplitudes agree within three of their deviations."""
    (one,), (other,) = (built_in(f"mini-{columns}-{record}").effects for record in ("northridge", "sine"))
    difference = one.parameters["eta"] - other.parameters["eta"]
    assert abs(difference) < 3 * np.hypot(one.std["eta"], other.std["eta"])


def test_joints_turn_more_between_stiff_columns():
    """eta is the columns' stiffness relative to the beams', and the beams are the same."""
    (flexible,), (stiff,) = built_in("mini-flexible-sine").effects, built_in("mini-stiff-sine").effects
    assert stiff.parameters["eta"] > 2 * flexible.parameters["eta"]


def test_the_floors_of_southampton_weigh_what_they_should():
    """Equal floors agree within 4 %, and their mean within 6 % of a sister's nominal 5.36 kg; no mass is declared."""
    closure = built_in("southampton")
    for frame in (closure.frame, closure.averaged):
        np.testing.assert_allclose(frame.floor_mass, frame.floor_mass.mean(), rtol=0.04)
        assert frame.floor_mass.mean() == pytest.approx(5.36, rel=0.06)
    assert closure.verdict == "ambiguous"
    assert all(item.rivals for item in closure.effects)
    assert closure.estimate.chi2 < 25


def test_the_columns_of_the_eighteen_stories_stretch():
    closure = built_in("e-defense")
    assert sorted(names(closure)) == ["axial columns", "base rocking"]
    # With these few floors and modes, springs between all floors fit equally well, and so do some springs with turning
    # joints.
    rivals = [rival for item in closure.effects for rival in item.rivals]
    assert {rival.placed.effect.name for rival in rivals} <= {"other_stiffness", "joint_rotation"}
    assert all(rival.probability < 0.1 for rival in rivals)
    assert all(item.probability > 0.75 for item in closure.effects)
    assert closure.before.estimate.chi2 > 200
    assert closure.estimate.chi2 < 40
    assert closure.after.held_out < closure.before.held_out


@pytest.mark.parametrize("name", MEASURED_FRAMES)
def test_a_built_in_frame_says_where_it_comes_from(name):
    text = built_in_text(name)
    assert "Source: " in text.partition("[frame]")[0]
    assert cvxshear.load(name).name == name


@pytest.mark.parametrize("direction", ["x", "y"])
def test_the_benchmark_is_the_published_one_with_the_stated_noise(direction):
    shared("data", "iasc-asce")
    assert built_in_files.benchmark(direction) == built_in_text(f"iasc-asce-{direction}")


def test_the_loosened_joints_are_the_published_ones():
    shared("data", "ucl-loosened-joints")
    assert built_in_files.loosened_joints() == built_in_text("ucl-loosened-joints")


@pytest.mark.parametrize("name", [*built_in_files.MINI, "southampton"])
def test_modes_that_are_built_in_are_those_of_the_records(name, tmp_path):
    """They agree within a tenth of their standard deviations."""
    shared("data", "southampton" if name == "southampton" else "mini-shake-table")
    (now,) = tomllib.loads(built_in_files.from_record(built_in_files.record_of(name, tmp_path)))["configuration"]
    (then,) = tomllib.loads(built_in_text(name))["configuration"]
    then_f, now_f = np.array(then["frequencies"]), np.array(now["frequencies"])
    assert np.all(np.abs(now_f / then_f - 1.0) < 0.1 * np.array(then["frequency_std"]))
    then_s, now_s = np.array(then["mode_shapes"]), np.array(now["mode_shapes"])
    largest = np.abs(then_s).max(axis=1, keepdims=True)
    assert np.all(np.abs(now_s - then_s) < 0.1 * np.array(then["mode_shape_std"]) * largest)
