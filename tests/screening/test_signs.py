"""Count the sign changes of a shear frame's modes, certain or not."""

import itertools

import numpy as np
import pytest

from cvxshear import Experiment
from cvxshear.measurement.reading import MeasuredModes, fewest_changes, most_changes, violations
from tests.frames import configuration, experiment, modes_of


def counted(signs):
    return sum(a != b for a, b in itertools.pairwise(signs))


@pytest.mark.parametrize("length", [1, 2, 3, 5])
def test_fewest_and_most_changes_are_those_of_every_way_to_settle_the_uncertain_signs(length):
    for signs in itertools.product((-1.0, 0.0, 1.0), repeat=length):
        settled = [
            counted(choice)
            for choice in itertools.product(*[(sign,) if sign else (-1.0, 1.0) for sign in signs])
        ]  # fmt: skip
        assert fewest_changes(np.array(signs)) == min(settled)
        assert most_changes(np.array(signs)) == max(settled)


def read(table, stories):
    mass, stiffness = np.full(stories, 10.0), np.full(stories, 2e4)
    return MeasuredModes.of(Experiment.from_dict(experiment(mass, stiffness, table)).configurations[0])


@pytest.mark.parametrize("stories", [1, 2, 5, 30])
def test_no_mode_of_a_shear_frame_violates_the_rule(stories):
    rng = np.random.default_rng(stories)
    mass, stiffness = rng.uniform(5, 20, stories), rng.uniform(1e4, 5e4, stories)
    assert not violations(read(configuration(mass, stiffness), stories))
    floors = sorted((rng.choice(stories, (stories + 1) // 2, replace=False) + 1).tolist())
    assert not violations(read(configuration(mass, stiffness, measured_floors=floors), stories))


def test_a_mode_with_another_number_violates_it():
    mass, stiffness = np.full(4, 10.0), np.full(4, 2e4)
    table = configuration(mass, stiffness, modes=[1, 2, 4])
    assert not violations(read(table, 4))
    (said,) = violations(read({**table, "modes": [1, 2, 3]}, 4))
    assert said == "mode 3 changes sign 3 times from the ground up, and a shear frame's twice"
    (said,) = violations(read({**table, "modes": [1, 3, 4]}, 4))
    assert said == "mode 3 changes sign once from the ground up, and a shear frame's twice"


def test_a_sign_within_the_noise_is_no_violation():
    _, shapes = modes_of(np.full(3, 10.0), np.full(3, 2e4))
    table = configuration(np.full(3, 10.0), np.full(3, 2e4))
    shapes[0, 0] = -0.1
    assert not violations(read({**table, "mode_shapes": shapes.tolist()}, 3))
    shapes[0, 0] = -0.4
    assert violations(read({**table, "mode_shapes": shapes.tolist()}, 3))
    assert not violations(read({**table, "mode_shapes": shapes.tolist(), "mode_shape_std": 0.1}, 3))
