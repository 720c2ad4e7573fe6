"""Test a frame before a test, and the information of floors and tests against another eigenvalue solver."""

import numpy as np
import pytest

import cvxshear
from cvxshear.planning.choice import candidates
from cvxshear.planning.design import Design
from cvxshear.planning.expected_tests import UNKNOWN_STDS, Declared
from cvxshear.util.errors import InputError
from tests.frames import configuration, experiment
from tests.planning.common import NOISE, design, frame_model, information_of, slow_covariance, tapered

FLOORS = np.array([0, 2, 4])


@pytest.mark.parametrize("added", [[np.zeros(5)], [np.zeros(5), np.array([0, 4e3, 0, 0, 9e3])]])
def test_the_covariance_is_that_of_numerical_derivatives_with_a_free_scale_a_mode(added):
    of = tapered(5)
    model = frame_model(of)
    tests = [model.expected(masses) for masses in added]
    slow = slow_covariance(of, added, FLOORS, 3, NOISE, mass_std=0.02, stiffness_std=0.1)
    found = model.covariance(tests, FLOORS)
    np.testing.assert_allclose(np.sqrt(np.diag(found)), np.sqrt(np.diag(slow)), rtol=2e-4)


def test_floors_add_up_with_the_scales_as_parameters_as_shapes_do_with_the_scales_eliminated():
    model = frame_model(tapered(6))
    tests = [model.expected(np.zeros(6)), model.expected(np.full(6, 3e3))]
    of = model.sensors(tests, 3)
    added_up = of.covariance(of.own(information_of(of, FLOORS)))
    eliminated = model.covariance(tests, FLOORS)
    # Each scale has the standard deviation of an unknown parameter, so scales are almost free.
    np.testing.assert_allclose(added_up, eliminated, rtol=1e-4, atol=1e-9)


def test_one_test_more_can_be_a_candidate_as_well():
    model = frame_model(tapered(4))
    tests = [model.expected(np.zeros(4)), model.expected(np.array([0, 0, 0, 8e3]))]
    of = model.choices(tests, FLOORS[:2], 1)
    np.testing.assert_allclose(
        of.covariance(of.own(information_of(of, [1]))), model.covariance(tests[1:], FLOORS[:2]), rtol=1e-8
    )


def test_equal_shares_of_all_candidates_are_the_unit_of_information():
    model = frame_model(tapered(6))
    of = model.sensors([model.expected(np.zeros(6))], 2)
    np.testing.assert_allclose(of.information(np.full(6, 2 / 6)), np.eye(len(of.base)), atol=1e-8)


def test_a_single_sensor_tells_nothing_of_a_shape_whose_scale_is_free():
    model = frame_model(tapered(5))
    tests = [model.expected(np.zeros(5))]
    alone = model.covariance(tests, np.array([4]))
    np.testing.assert_allclose(alone, model.covariance(tests, np.array([1])), rtol=1e-9)


def test_a_known_total_takes_a_direction_away():
    mass = [9.0, 7.0, 5.0]
    of = design(mass, [2e3, 1.5e3, 1e3], frame={"total_mass": 21.0})
    model = frame_model(of)
    covariance = model.covariance([model.expected(np.zeros(3))], np.arange(3))
    total = np.concatenate([mass, np.zeros(3)])
    assert total @ covariance @ total == pytest.approx(0.0, abs=1e-12)
    assert np.sqrt(covariance[0, 0]) > 1e-4


def test_known_masses_are_no_part_of_the_question():
    priors = [{"kind": "nominal", "quantity": "story_stiffness", "values": [2e3, 1e3], "std": 0.1}]
    of = Design.of_file({"frame": {"floor_masses": [9.0, 7.0]}, "prior": priors}, "test")
    assert frame_model(of, modes=2).question.shape == (2, 4)
    with pytest.raises(InputError, match="known exactly already"):
        frame_model(of, modes=2, quantities=("floor_mass",)).sensors([], 1)


def test_what_nothing_is_known_of_keeps_the_vague_standard_deviation():
    question = np.eye(2)
    of = candidates(np.eye(2) / UNKNOWN_STDS, np.zeros((0, 2)), np.array([[[1e3, 0.0]]]), question, 1.0)
    std = np.sqrt(np.diag(of.covariance(of.own(information_of(of, [0])))))
    np.testing.assert_allclose(std, [1e-3, UNKNOWN_STDS], rtol=1e-6)


STIFFNESS = {"kind": "nominal", "quantity": "story_stiffness", "values": [2e4, 1e4], "std": 0.1}
MASS = {"kind": "nominal", "quantity": "floor_mass", "values": [12.0, 8.0], "std": 0.05}


@pytest.mark.parametrize(
    ("frame", "priors", "mass"),
    [
        ({"floor_masses": [9.0, 7.0]}, [STIFFNESS, MASS], [9.0, 7.0]),
        ({"total_mass": 30.0}, [STIFFNESS], [15.0, 15.0]),
        ({"total_mass": 30.0}, [STIFFNESS, MASS], [18.0, 12.0]),
        ({}, [MASS, STIFFNESS], [12.0, 8.0]),
    ],
)
def test_design_values_are_at_the_total_that_is_declared(frame, priors, mass):
    design = Design.of_file({"frame": frame, "prior": priors}, "of mine")
    np.testing.assert_allclose(design.floor_mass, mass)
    np.testing.assert_allclose(design.sizes, [*mass, 2e4, 1e4])
    assert (design.stories, design.name, design.measured) == (2, "of mine", None)
    # Exact declarations are rows of relative changes: each mass, or the sum of both.
    exact = {"floor_masses": np.eye(2, 4), "total_mass": [[*np.array(mass) / sum(mass), 0, 0]]}
    np.testing.assert_allclose(design.fixed(), exact.get(next(iter(frame), ""), np.zeros((0, 4))))


@pytest.mark.parametrize(
    ("frame", "priors", "message"),
    [
        ({}, [MASS], "no story stiffness is expected"),
        ({}, [STIFFNESS], "no floor mass is expected"),
        ({"stories": 3}, [MASS, STIFFNESS], "2 story stiffnesses, 2 floor masses and frame: stories = 3 must agree"),
        ({"floor_masses": [1, 2, 3]}, [STIFFNESS], "2 story stiffnesses, 3 floor masses"),
        ({}, STIFFNESS, "must be a list of tables"),
    ],
)
def test_design_values_that_do_not_go_together_are_refused(frame, priors, message):
    with pytest.raises(InputError, match=message):
        Design.of_file({"frame": frame, "prior": priors}, "of mine")


def test_a_measured_frame_is_the_one_that_fits_best():
    mass, stiffness = [10.0, 8.0, 6.0], [2e4, 1.5e4, 1e4]
    bare = configuration(mass, stiffness, name="bare", frequency_std=1e-5)
    of = cvxshear.Experiment.from_dict(experiment(mass, stiffness, bare))
    design = Design.of_experiment(of)
    np.testing.assert_allclose(design.sizes, [*mass, *stiffness], rtol=1e-6)
    assert (design.measured, Design.of_experiment(of, fresh=True).measured) == (of, None)
    assert design.declared == of.configurations


def test_the_noise_of_a_plan_is_the_median_of_the_tests_before():
    """Shapes may have any size; a test of frequencies alone says nothing of shapes."""
    shown = configuration([4.0, 3.0], [900.0, 700.0], frequency_std=0.003, mode_shape_std=0.02)
    shown["mode_shapes"] = (3.0 * np.array(shown["mode_shapes"])).tolist()
    alone = {"frequencies": shown["frequencies"][:1], "frequency_std": 0.005}
    tests = cvxshear.Experiment.from_dict(experiment([4.0, 3.0], [900.0, 700.0], shown, alone)).configurations
    assert Declared.of_tests(tests).frequency_std == pytest.approx(0.003)
    assert Declared.of_tests(tests).mode_shape_std == pytest.approx(0.02)
    assert Declared.of_tests(tests[1:]) == Declared(0.005)
    assert Declared.of_tests([]) == Declared()
