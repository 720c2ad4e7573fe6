"""One frequency that all other data contradict is named; no sound file is accused."""

import re

import numpy as np
import pytest

from cvxshear import Experiment
from cvxshear.model import modes, stiffness_matrix
from cvxshear.screening import screen
from tests.fe.experiments import simulated

LOADS = [[0, 0, 0, 0, 0], [0, 0, 6, 0, 6], [6, 0, 0, 6, 0]]


def five_stories(effect=None, tests=3, *, shapes=True, states=None, seed=4):
    """Return a file of a five-story finite-element frame, tested under different loads, and its true frequencies."""
    declared, truth = simulated(
        effect, stories=5, configurations=tests, rng=np.random.default_rng(seed), added_mass=LOADS[:tests],
        configuration=tests if effect == "story_change" else None,
    )  # fmt: skip
    for table, state in zip(declared["configuration"], states or ["as built"] * tests, strict=True):
        table["state"] = state
        if not shapes:
            del table["mode_shapes"], table["mode_shape_std"], table["measured_floors"]
    return declared, truth["frequencies"]


def named(declared):
    return [item for item in screen(Experiment.from_dict(declared)) if item.name == "frequency"]


@pytest.mark.parametrize(
    ("tests", "shapes", "effect", "states", "test", "mode", "factor"),
    [
        (2, True, None, None, 1, 3, 1.05),
        (1, True, None, None, 0, 2, 0.9),
        (3, True, "story_change", ["before", "before", "after"], 2, 1, 1.1),
        (3, False, None, None, 1, 2, 1.08),
    ],
)
def test_the_wrong_number_is_named_with_what_all_others_say(tests, shapes, effect, states, test, mode, factor):
    declared, true = five_stories(effect, tests, shapes=shapes, states=states)
    table = declared["configuration"][test]
    assert not named(declared)
    table["frequencies"][mode - 1] *= factor
    (item,) = named(declared)
    assert item.refuses
    assert item.found.startswith(f'mode {mode} of "{table["name"]}" has ')
    value, std = item.found.split("all other data say ")[1].split(" Hz")[0].split(" ± ")
    assert abs(float(value) - true[test][mode - 1]) < 4 * float(std)
    assert f'check the frequency of mode {mode} of "{table["name"]}"' in item.change
    declared["frame"]["accept"] = ["frequency"]
    assert not named(declared)


@pytest.mark.parametrize("effect", ["joint_rotation", "ground_spring", "story_change"])
@pytest.mark.parametrize("shapes", [True, False])
def test_a_frame_that_is_otherwise_than_modeled_is_not_accused(effect, shapes):
    """The frame is not accused either if the file does not declare the last test's other state."""
    assert not named(five_stories(effect, shapes=shapes, seed=7)[0])


def test_what_nothing_contradicts_or_nobody_weighs_is_left_alone():
    alone, _ = five_stories(tests=1, shapes=False)
    alone["configuration"][0]["frequencies"][1] *= 1.1
    unstated, _ = five_stories(tests=2)
    unstated["configuration"][0]["frequencies"][1] *= 1.1
    for table in unstated["configuration"]:
        del table["frequency_std"]
    assert not named(alone)
    assert not named(unstated)


def test_a_tuned_mass_in_one_state_is_a_doubt_that_says_both():
    """A damper of 4 % of the frame splits the first mode in two. The lower one has the first mode's shape."""
    rng, N = np.random.default_rng(5), 5
    mass, stiffness = 100 * rng.uniform(0.8, 1.2, N), 1e6 * rng.uniform(0.8, 1.2, N)
    bare = modes(np.diag(mass), stiffness_matrix(stiffness))
    own, at = 0.04 * mass.sum(), np.array([0.0, 0.0, 1.0, 0.0, 0.0, -1.0])
    tied = np.pad(stiffness_matrix(stiffness), ((0, 1), (0, 1)))
    tied += own * (2 * np.pi * 0.9 * bare.frequencies[0]) ** 2 * np.outer(at, at)
    damped = modes(np.diag([*mass, own]), tied)
    tables = [
        {
            "name": name, "frequency_std": 1e-3, "mode_shape_std": 1e-2,
            "frequencies": (found.frequencies[rows] * np.exp(1e-3 * rng.standard_normal(N))).tolist(),
            "mode_shapes": (
                found.shapes[rows][:, :N] / np.abs(found.shapes[rows][:, :N]).max(axis=1, keepdims=True)
                + 1e-2 * rng.standard_normal((N, N))
            ).tolist(),
        }
        for name, found, rows in (("before", bare, range(N)), ("with", damped, [0, 2, 3, 4, 5]))
    ]  # fmt: skip
    declared = {"frame": {"total_mass": float(mass.sum())}, "configuration": tables}
    (item,) = named(declared)
    assert not item.refuses
    assert item.found.startswith('mode 1 of "with" has ')
    said = re.search(r'a mass of (.*) kg on floor 3 of "with" swings by itself at (.*) Hz', item.found)
    weight, frequency = said.groups()
    assert float(weight) == pytest.approx(own, rel=0.8)
    assert float(frequency) == pytest.approx(0.9 * bare.frequencies[0], rel=0.05)
    tables[1]["frequencies"] = (bare.frequencies * np.where(np.arange(N) == 2, 1.08, 1.0)).tolist()
    tables[1]["mode_shapes"] = bare.shapes.tolist()
    (item,) = named(declared)
    assert item.refuses
    assert item.found.startswith('mode 3 of "with" has ')
