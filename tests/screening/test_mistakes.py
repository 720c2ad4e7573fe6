"""Mistakes are named with their correction, and sound frames pass."""

import numpy as np
import pytest

from cvxshear import Experiment, InputError, load
from cvxshear.measurement.declaration import MISTAKES as NAMES
from cvxshear.measurement.declaration import NAMES as ALL_NAMES
from cvxshear.screening import refuse_mistakes, screen
from tests.fe.experiments import simulated
from tests.frames import EXAMPLES, configuration, experiment
from tests.screening.mistakes import MISTAKES, with_mistake
from tests.studies.calibration import EFFECTS

MASS = np.array([12.0, 10.0, 9.0, 8.0])
STIFFNESS = np.array([26e3, 24e3, 21e3, 20e3])


def found(declared):
    return screen(Experiment.from_dict(declared))


def four_stories(**keys):
    return experiment(MASS, STIFFNESS, configuration(MASS, STIFFNESS, rng=np.random.default_rng(0), **keys))


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize(("stories", "effect"), [(4, None), (5, "base_rocking")])
def test_each_mistake_is_named_with_what_to_change(mistake, stories, effect):
    rng = np.random.default_rng(stories)
    declared, _ = simulated(effect, stories=stories, configurations=2, rng=rng)
    wrong, where, word = with_mistake(mistake, declared, rng)
    items = found(wrong)
    assert [item.configuration for item in items] == where
    for item in items:
        assert item.name == mistake
        assert item.refuses
        assert word in item.change


def test_the_names_of_the_mistakes_are_those_that_accept_takes():
    # Sensors have places and directions of their own where the floors turn (test_sensors_that_turn.py).
    assert set(MISTAKES) == set(NAMES) - {"signs", "sensor_direction", "sensor_position"}


@pytest.mark.parametrize("effect", EFFECTS)
@pytest.mark.parametrize("missing", [False, True])
def test_an_effect_of_practical_size_is_no_mistake(effect, missing):
    floors, modes = ([1, 3, 4, 5], 3) if missing else (None, None)
    declared, _ = simulated(
        effect, stories=5, configurations=2, rng=np.random.default_rng(5), measured_floors=floors, modes=modes
    )
    assert found(declared) == ()


@pytest.mark.parametrize("example", ["three_story", "five_story", "noisy_three_story", "paper"])
def test_the_examples_are_without_a_finding(example):
    assert screen(load(EXAMPLES / f"{example}.toml")) == ()


@pytest.mark.parametrize("ratio", [1e-6, 3e-4, 3e3, 1e6])
@pytest.mark.parametrize("what", ["stiffness", "mass"])
def test_a_frame_of_very_different_stories_or_floors_is_right(what, ratio):
    """Frames on bearings, with a stiff basement, or under a tank: exact to four digits, and with the declared noise."""
    for stories, noise in ((3, 0.0), (4, 1.0), (6, 1.0)):
        rng = np.random.default_rng(stories)
        values = {"mass": rng.uniform(5, 15, stories), "stiffness": rng.uniform(2e4, 4e4, stories)}
        values[what][int(rng.integers(stories))] *= ratio
        table = configuration(**values, rng=rng, shape_noise=0.01 * noise, frequency_noise=0.001 * noise)
        table["mode_shapes"] = np.round(table["mode_shapes"], 4).tolist()
        assert not [item for item in found(experiment(values["mass"], values["stiffness"], table)) if item.refuses]


@pytest.mark.parametrize("seed", range(12))
def test_a_frame_whose_stories_all_differ_by_up_to_three_thousand_is_right(seed):
    """The stiffnesses are in any order, the largest is three thousand times the smallest."""
    rng = np.random.default_rng([38, seed])
    stories = int(rng.integers(2, 7))
    stiffness = 2e4 * 3000.0 ** rng.permutation(np.linspace(0, 1, stories))
    mass = 10.0 * rng.uniform(0.8, 1.2, stories)
    table = configuration(mass, stiffness, rng=rng, shape_noise=0.01, frequency_noise=0.001)
    assert [item.name for item in found(experiment(mass, stiffness, table)) if item.refuses] == []


def test_a_sign_that_noise_can_have_turned_is_passed_over():
    declared = four_stories(shape_noise=0.0)
    shapes = np.array(declared["configuration"][0]["mode_shapes"])
    row, column = np.unravel_index(np.argmin(np.abs(shapes)), shapes.shape)
    shapes[row, column] = -0.01 * np.sign(shapes[row, column])
    declared["configuration"][0]["mode_shapes"] = shapes.tolist()
    declared["configuration"][0]["mode_shape_std"] = abs(0.5 * shapes[row, column]) + 0.1
    assert found(declared) == ()


def test_repairs_that_the_data_cannot_tell_apart_are_named_together():
    """With three stories, listing the floors from the top and exchanging the first and the third are the same."""
    table = configuration(MASS[:3], STIFFNESS[:3])
    table["mode_shapes"] = [row[::-1] for row in table["mode_shapes"]]
    (item,) = found(experiment(MASS[:3], STIFFNESS[:3], table))
    assert {item.name, *item.rivals} == {"floors_from_top", "swapped_sensors"}
    assert item.change.startswith("One of: ")
    assert "floors 1 and 3" in item.change


def test_two_mistakes_are_signs_that_no_single_change_mends():
    declared = four_stories()
    rows = declared["configuration"][0]["mode_shapes"]
    rows[0][1] *= -1
    rows[1], rows[3] = rows[3], rows[1]
    items = found(declared)
    assert [item.refuses for item in items] == [True]


def test_what_is_accepted_is_not_told():
    declared, _ = simulated(None, stories=4, configurations=1, rng=np.random.default_rng(1))
    wrong, _, _ = with_mistake("sensor_sign", declared, np.random.default_rng(1))
    with pytest.raises(InputError, match=r'configuration "test 1".*\[frame\] accept = \["sensor_sign"\]'):
        refuse_mistakes(Experiment.from_dict(wrong))
    wrong["frame"]["accept"] = ["sensor_sign"]
    accepted = Experiment.from_dict(wrong)
    assert refuse_mistakes(accepted) == ()
    assert accepted.to_dict()["frame"]["accept"] == ["sensor_sign"]
    assert Experiment.from_dict(accepted.to_dict()).frame.accept == ("sensor_sign",)


@pytest.mark.parametrize(
    ("accept", "said"),
    [
        (["sensor_sing"], "did you mean 'sensor_sign'"),
        (["everything"], "frame: accept must be one of sensor_sign, "),
        ("signs", "frame: accept must be a list of names, not 'signs'"),
    ],
)
def test_a_name_that_no_finding_has_is_refused(accept, said):
    declared = four_stories()
    declared["frame"]["accept"] = accept
    with pytest.raises(InputError, match=said):
        Experiment.from_dict(declared)


@pytest.mark.parametrize("seed", range(8))
def test_nonsense_is_judged_without_an_error(seed):
    """Shapes are random, of any scale, with entries and whole rows missing."""
    rng = np.random.default_rng(seed)
    count, width = int(rng.integers(1, 5)), int(rng.integers(1, 6))
    shapes = rng.standard_normal((count, width)) * 10.0 ** rng.uniform(-20, 20, (count, 1))
    shapes[rng.random(shapes.shape) < 0.2] = np.nan
    table = {"frequencies": np.sort(10.0 ** rng.uniform(-8, 8, count)).tolist(), "mode_shapes": shapes.tolist()}
    for item in found({"frame": {"total_mass": 1.0, "stories": 5}, "configuration": [{
        **table, "measured_floors": list(range(1, width + 1)),
    }]}):  # fmt: skip
        assert item.name in ALL_NAMES


def test_a_tall_frame_is_judged_by_its_signs():
    mass, stiffness = np.full(40, 1e4), np.full(40, 1e8)
    table = configuration(mass, stiffness)
    assert found(experiment(mass, stiffness, table)) == ()
    table["mode_shapes"] = [[-row[0], *row[1:]] for row in table["mode_shapes"]]
    (item,) = found(experiment(mass, stiffness, table))
    assert (item.name, item.refuses) == ("signs", True)
