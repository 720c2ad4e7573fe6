"""The next test may require additional sensors. With them, the verdict is more certain."""

import json
from pathlib import Path

import numpy as np
import pytest

from cvxshear import Experiment, close_loop
from tests.fe.experiments import simulated

NOISE = 3.0
SEED = 2


def measured(rng, **keys):
    """Return a five-story frame whose joints turn, with three times the usual noise, declared correctly."""
    declared, _ = simulated("joint_rotation", stories=5, rng=rng, noise=NOISE, **keys)
    for each in declared["configuration"]:
        each["frequency_std"] = (NOISE * np.asarray(each["frequency_std"])).tolist()
        each["mode_shape_std"] = (NOISE * np.asarray(each["mode_shape_std"])).tolist()
    return declared


def kept(table, floors):
    """Return a configuration measured at these floors alone."""
    shapes = np.asarray(table["mode_shapes"])[:, np.array(floors) - 1]
    return {**table, "measured_floors": list(floors), "mode_shapes": shapes.tolist()}


@pytest.fixture(scope="module")
def first():
    return measured(np.random.default_rng(SEED), configurations=1, measured_floors=[1, 5])


@pytest.fixture(scope="module")
def before(first):
    return close_loop(Experiment.from_dict(first), effects=["joint_rotation", "axial_columns"])


def test_two_sensors_in_much_noise_want_a_third(before):
    proposed = before.next_test
    assert before.verdict == "ambiguous"
    assert set(proposed.measured_floors) > {1, 5}
    assert len(proposed.measured_floors) == 3
    assert proposed.standard_deviations > 3


def test_carrying_it_out_makes_the_verdict_surer(first, before):
    proposed = before.next_test
    added = np.zeros((2, 5))
    added[1, proposed.floor - 1] = proposed.added_mass
    second = measured(np.random.default_rng(SEED), configurations=2, added_mass=added.tolist())["configuration"][1]
    both = {**first, "configuration": [*first["configuration"], kept(second, proposed.measured_floors)]}
    after = close_loop(Experiment.from_dict(both), effects=["joint_rotation", "axial_columns"])
    was, now = ({item.placed.effect.name: item.probability for item in each.candidates} for each in (before, after))
    assert after.verdict == "explained"
    assert was["joint_rotation"] < 0.8
    assert now["joint_rotation"] > 0.99


def test_it_is_said_in_words_and_in_the_documented_json(before):
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((Path(__file__).parents[2] / "docs/schema/loop.json").read_text(encoding="utf-8"))
    said = json.loads(json.dumps(before.to_dict()))
    jsonschema.Draft202012Validator(schema).validate(said)
    (third,) = set(before.next_test.measured_floors) - {1, 5}
    assert said["next_test"]["measured_floors"] == sorted([1, third, 5])
    assert f"measure again, with a sensor at floor {third} too" in " ".join(str(before).split())
