"""Test a frame before a test, declared by files of design values, results or measurements."""

import numpy as np
import pytest

import cvxshear
from cvxshear.planning.design import Design
from cvxshear.util.errors import InputError
from tests.frames import configuration, experiment, modes_of

STIFFNESS = {"kind": "nominal", "quantity": "story_stiffness", "values": [2e4, 1e4], "std": 0.1}
MASS = {"kind": "nominal", "quantity": "floor_mass", "values": [12.0, 8.0], "std": 0.05}
RESULT = {
    "frame": {
        "floor_mass": [10.0, 8.0], "floor_mass_std": [0.1, 0.4],
        "story_stiffness": [2e4, 1e4], "story_stiffness_std": [200.0, 0.0],
    },
    "assumed": [{"name": "ground_spring", "floor": 1, "parameters": {"k": 300.0}}],
    "effects": [
        {"name": "ground_spring", "floor": 2, "parameters": {"k": 500.0}, "std": {"k": 50.0}},
        {"name": "added_mass", "floor": 2, "configuration": "test 2", "parameters": {"m": 1.0}, "std": {"m": 0.1}},
    ],
}  # fmt: skip


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
    np.testing.assert_allclose(design.theta, [*mass, 2e4, 1e4])
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


def test_a_result_is_known_as_surely_as_it_says():
    """Rows of relative changes are 1 / (coefficient of variation); without a deviation, a value is exact or open."""
    design = Design.of_result(RESULT, "earlier")
    assert [placed.label for placed in design.effects] == ["ground spring at floor 1", "ground spring at floor 2"]
    np.testing.assert_allclose(design.theta, [10.0, 8.0, 2e4, 1e4, 300.0, 500.0])
    np.testing.assert_allclose(design.units, design.theta)
    np.testing.assert_allclose(np.abs(design.known()), np.diag([100.0, 20.0, 100.0, 0.0, 0.0, 10.0])[[0, 1, 2, 5]])
    np.testing.assert_allclose(np.abs(design.fixed()), [[0, 0, 0, 1]])
    assert (design.scale.floor_mass, design.scale.story_stiffness) == (9.0, 1.5e4)


def test_a_result_that_says_too_little_is_refused():
    with pytest.raises(InputError, match="earlier holds no frame with standard deviations"):
        Design.of_result({"frame": {**RESULT["frame"], "floor_mass_std": None}}, "earlier")
    gravity = {**RESULT, "effects": [{"name": "gravity", "parameters": {"gamma": 1.0}, "std": {"gamma": 0.1}}]}
    with pytest.raises(InputError, match="holds gravity, which cannot be made again without the measurement"):
        Design.of_result(gravity, "earlier")


def test_measured_frequencies_stand_beside_those_of_the_frame():
    """The second test's masses exceed the declared ones: its frequencies disagree, the others agree."""
    mass, stiffness = [10.0, 8.0, 6.0], [2e4, 1.5e4, 1e4]
    bare = configuration(mass, stiffness, name="bare", frequency_std=1e-5)
    loaded = configuration(mass, stiffness, [0, 0, 3.0], modes=[1, 3], name="loaded", frequency_std=0.1)
    loaded["frequencies"] = [0.9 * each for each in loaded["frequencies"]]
    of = cvxshear.Experiment.from_dict(experiment(mass, stiffness, bare, loaded))
    design = Design.of_experiment(of)
    found = design.measured_frequencies()
    assert [(each.configuration, each.mode) for each in found] == [
        ("bare", 1), ("bare", 2), ("bare", 3), ("loaded", 1), ("loaded", 3),
    ]  # fmt: skip
    expected = [*modes_of(mass, stiffness)[0], *modes_of(np.add(mass, [0, 0, 3.0]), stiffness)[0][[0, 2]]]
    np.testing.assert_allclose([each.expected for each in found], expected, rtol=2e-3)
    np.testing.assert_allclose([each.error for each in found], [0, 0, 0, 1 / 0.9 - 1, 1 / 0.9 - 1], atol=3e-3)
    assert (design.measured, Design.of_experiment(of, fresh=True).measured) == (of, None)
    assert (design.state, Design.of_experiment(of, configuration="loaded").state) == (None, "loaded")
    assert design.declared == of.configurations
