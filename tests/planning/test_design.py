"""Test a frame before a test, declared by files of design values or measurements."""

import numpy as np
import pytest

import cvxshear
from cvxshear.planning.design import Design
from cvxshear.util.errors import InputError
from tests.frames import configuration, experiment

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
