"""`check` names the sensor whose place or direction is wrong, on frames of tests/fe whose floors turn."""

import dataclasses

import numpy as np
import pytest

import cvxshear
from cvxshear.measurement.configuration import Sensor
from cvxshear.screening import Screening, refuse_mistakes, screen
from tests.fe.plan_frames import random_frame
from tests.fe.space_frames import SIDE, iasc_asce

NOISE = 0.005


def declared(experiment, place, **wrong):
    """Return the experiment with another place or direction of one sensor in its file."""
    (tested,) = experiment.configurations
    sensors = list(tested.sensors)
    sensors[place] = dataclasses.replace(sensors[place], **wrong)
    return dataclasses.replace(experiment, configurations=(dataclasses.replace(tested, sensors=tuple(sensors)),))


@pytest.mark.parametrize("seed", range(8))
def test_sound_files_have_no_findings(seed):
    frame = random_frame(2 + seed % 3, seed, symmetric=seed % 4 == 3)
    experiment = frame.experiment(noise=NOISE, seed=seed, std=NOISE)
    found = Screening.of(experiment)
    assert (found.refused, found.findings) == (False, ())


@pytest.mark.parametrize("seed", range(6))
def test_a_reversed_or_turned_sensor_is_named(seed):
    """Three sensors a floor, the fewest that tell its motions apart."""
    frame = random_frame(2 + seed % 2, seed)
    experiment = frame.experiment(noise=NOISE, seed=seed, std=NOISE)
    place = int(np.random.default_rng(seed).integers(3 * frame.stories))
    right = experiment.configurations[0].sensors[place].direction
    (found,) = screen(declared(experiment, place, direction=right + 180.0))
    assert found.name == "sensor_direction"
    assert f"sensor {place + 1} (floor {place // 3 + 1}" in found.found
    assert f"direction = {right:g}" in found.change


def test_a_place_with_x_and_y_exchanged_is_named_and_can_be_accepted():
    experiment = random_frame(2, 6).experiment(noise=NOISE, seed=6, std=NOISE)
    x, y = experiment.configurations[0].sensors[5].position
    wrong = declared(experiment, 5, position=(y, x))
    (found,) = screen(wrong)
    assert "sensor_position" in (found.name, *found.rivals)
    assert f"[{x:g}, {y:g}]" in found.change
    with pytest.raises(cvxshear.InputError, match="stands elsewhere"):
        refuse_mistakes(wrong)
    accepted = dataclasses.replace(wrong, frame=dataclasses.replace(wrong.frame, accept=("sensor_position",)))
    assert screen(accepted) == ()


def test_exchanged_sensors_are_named():
    frame = random_frame(2, 3)
    experiment = frame.experiment(noise=NOISE, seed=1, std=NOISE)
    (tested,) = experiment.configurations
    order = [0, 4, 2, 3, 1, 5]
    sensors: list[Sensor] = [tested.sensors[place] for place in order]
    wrong = dataclasses.replace(experiment, configurations=(dataclasses.replace(tested, sensors=tuple(sensors)),))
    (found,) = screen(wrong)
    assert found.name == "swapped_sensors"
    assert "sensor 2 (floor 2" in found.found
    assert "sensor 5 (floor 1" in found.found


def test_turning_joints_are_no_mistake_of_a_sensor():
    """The benchmark with 120 degrees of freedom has a large chi-square for any sensors."""
    experiment = iasc_asce(4).experiment((2 * SIDE, 2 * SIDE), 0.01, 3, total_mass=10717.2)
    assert screen(experiment) == ()
    right = experiment.configurations[0].sensors[6].direction
    (found,) = screen(declared(experiment, 6, direction=right + 180.0))
    assert found.name == "sensor_direction"
    assert "sensor 7" in found.found
