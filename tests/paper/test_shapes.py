"""Recover the modes of Fig. 8 from Table 6."""

import numpy as np
import pytest
from scipy import linalg

from cvxshear import Configuration, Experiment, Frame, identify, load
from cvxshear.paper.reproduction import recovered, recovered_shapes
from cvxshear.paper.tables import PRINTED, values


@pytest.mark.parametrize("name", PRINTED["table_4"])
def test_they_are_those_of_the_built_in_file(name):
    found = recovered(name)
    shapes = next(each for each in load("paper").configurations if each.name == name).mode_shapes
    np.testing.assert_allclose([found.first, found.second], shapes[:, 0] / shapes[:, 1], atol=5e-6)
    assert found.misfit < 1e-5


@pytest.mark.parametrize("name", PRINTED["table_4"])
def test_the_modes_are_orthogonal_on_the_printed_masses(name):
    found = recovered(name)
    m1, m2 = values(PRINTED["table_6_mass"][name])
    assert m1 * found.first * found.second + m2 == pytest.approx(0.0, abs=1e-9 * m2)


def test_shapes_that_the_method_was_given_come_back():
    first, second, frequencies = 0.55, -1.6, np.array([3.1, 8.0])
    experiment = Experiment(
        Frame(total_mass=40.0), (Configuration(frequencies, np.array([[first, 1.0], [second, 1.0]])),)
    )
    frame = identify(experiment, "two-stage").frame
    found = recovered_shapes(frame.floor_mass, frame.story_stiffness, frequencies)
    assert (found.first, found.second) == pytest.approx((first, second), rel=1e-6)
    assert found.misfit < 1e-6


@pytest.mark.parametrize("name", PRINTED["table_4"])
def test_table_7_follows_from_table_6_alone(name):
    """Compute the eigenvalues of a two by two matrix."""
    m1, m2 = values(PRINTED["table_6_mass"][name])
    k1, k2 = (1e3 * each for each in values(PRINTED["table_6_stiffness"][name]))
    eigenvalues = linalg.eigh([[k1 + k2, -k2], [-k2, k2]], np.diag([m1, m2]), eigvals_only=True)
    printed = values(PRINTED["table_7"][name])
    np.testing.assert_allclose(np.sqrt(eigenvalues) / (2 * np.pi), printed, atol=5.01e-4)
