"""Test declared masses that the shapes contradict, on frames of the independent finite-element program."""

import numpy as np
import pytest

from cvxshear import Experiment
from cvxshear.screening import screen
from tests.fe.experiments import simulated
from tests.frames import configuration, experiment
from tests.studies.calibration import EFFECTS


def floor_masses_declared(effect=None, stories=5, configurations=2, seed=3):
    """Return a measurement file with the true floor masses instead of their total."""
    declared, truth = simulated(effect, stories=stories, configurations=configurations, rng=np.random.default_rng(seed))
    del declared["frame"]["total_mass"]
    declared["frame"]["floor_masses"] = truth["floor_mass"].tolist()
    return declared, truth["floor_mass"]


def found(declared):
    return screen(Experiment.from_dict(declared))


@pytest.mark.parametrize("effect", EFFECTS)
def test_true_masses_are_not_doubted_whatever_the_shear_model_lacks(effect):
    declared, _ = floor_masses_declared(effect, seed=5)
    assert found(declared) == ()


@pytest.mark.parametrize("floor", [1, 3, 5])
@pytest.mark.parametrize("factor", [0.75, 1.3])
def test_one_wrong_floor_mass_is_warned_of_with_what_it_weighs(floor, factor):
    declared, mass = floor_masses_declared()
    declared["frame"]["floor_masses"][floor - 1] *= factor
    (item,) = found(declared)
    assert (item.name, item.refuses) == ("floor_mass", False)
    assert item.found.startswith(f"floor {floor} weighs ")
    assert float(item.found.split()[3]) == pytest.approx(mass[floor - 1], rel=0.05)


def test_floor_masses_listed_from_the_top_are_refused():
    declared, _ = floor_masses_declared()
    declared["frame"]["floor_masses"].reverse()
    (item,) = found(declared)
    assert (item.name, item.refuses) == ("masses_from_top", True)


def test_design_values_listed_from_the_top_are_refused():
    mass, stiffness = np.array([14.0, 12.0, 10.0, 7.0]), np.array([26e3, 24e3, 21e3, 20e3])
    nominal = {"kind": "nominal", "quantity": "floor_mass", "std": 0.05}
    for values, names in ((mass, []), (mass[::-1], ["masses_from_top"])):
        table = configuration(mass, stiffness, rng=np.random.default_rng(0), shape_noise=0.01, frequency_noise=0.001)
        prior = [{**nominal, "values": values.tolist()}]
        assert [item.name for item in found(experiment(mass, stiffness, table, prior=prior))] == names


@pytest.mark.parametrize(("tilt", "names"), [(0.15, []), (0.4, ["masses_from_top"])])
def test_design_stiffnesses_that_tilt_the_other_way_within_their_deviations_are_not_doubted(tilt, names):
    """Ten stories have the deviation 0.1. Errors of 1.5 deviations at both ends are no mistake, errors of 4 are."""
    height = np.linspace(-1.0, 1.0, 10)
    mass, stiffness = np.full(10, 10.0), 20e3 * (1 + tilt * height)
    prior = {"kind": "nominal", "quantity": "story_stiffness", "values": stiffness[::-1].tolist(), "std": 0.1}
    table = configuration(mass, stiffness, rng=np.random.default_rng(7), shape_noise=0.001, frequency_noise=0.0001)
    stated = {**table, "frequency_std": 0.0001, "mode_shape_std": 0.001}
    assert [item.name for item in found(experiment(mass, stiffness, stated, prior=[prior]))] == names


@pytest.mark.parametrize("moved", [1, 2])
def test_a_load_on_another_floor_is_warned_of(moved):
    declared, _ = floor_masses_declared()
    for each in declared["configuration"]:
        each["state"] = "as built"
    assert found(declared) == ()
    table = declared["configuration"][1]
    (place,) = np.flatnonzero(table["added_mass"])
    table["added_mass"] = np.roll(table["added_mass"], moved).tolist()
    (item,) = found(declared)
    assert (item.name, item.refuses) == ("added_mass", False)
    assert f"lay on floor {place + 1} and not on" in item.found


@pytest.mark.parametrize(("unit", "factor"), [("t", 1e-3), ("kN", 9.81e-3), ("N", 9.81)])
@pytest.mark.parametrize("height", [True, False])
def test_added_masses_in_another_unit_are_named_and_not_the_total(unit, factor, height):
    """Floors of stories of 0.39 m have about 10 kg each. Without heights, either unit can be wrong."""
    declared, _ = floor_masses_declared(configurations=3)
    if not height:
        del declared["frame"]["story_heights"]
    for table in declared["configuration"]:
        table["added_mass"] = [factor * value for value in table["added_mass"]]
    items = found(declared)
    assert any("added_mass" in item.found and f"like {unit}" in item.found for item in items)
