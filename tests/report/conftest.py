"""Provide results for all tests of figures and reports, computed once for all processes."""

import dataclasses

import numpy as np
import pytest

import cvxshear
from cvxshear.paper import paper_setups
from cvxshear.report.blocks import Table, describe
from tests import closed
from tests.fe.experiments import simulated

NASTY = '<img src="http://example.org/x" onerror="alert(1)"> $a_$ & 结构'
"""Name with characters that are special in HTML, figures or formulas."""


def experiment(effect, stories, configurations=2, seed=3, **options):
    declared, _ = simulated(
        effect, stories=stories, configurations=configurations, rng=np.random.default_rng(seed), **options
    )
    return declared


def parts(of, kind):
    return [part for section in describe(of).sections for part in section.parts if isinstance(part, kind)]


def table(of, key):
    """Return a table of the description of a result."""
    return next(part for part in parts(of, Table) if part.key == key)


@pytest.fixture(scope="session")
def paper():
    return closed.paper()


@pytest.fixture(scope="session")
def eight():
    return closed.close_loop(
        cvxshear.Experiment.from_dict(experiment("base_rocking", 8), name="eight stories"),
        effects=["base_rocking", "gravity", "axial_columns"],
    )


@pytest.fixture(scope="session")
def unexplained():
    declared = experiment("sensor_gain", 3)
    declared["configuration"][0]["name"] = NASTY
    result = closed.close_loop(cvxshear.Experiment.from_dict(declared, name=NASTY), effects=["story_change"])
    assert result.verdict == "unexplained"
    return result


@pytest.fixture(scope="session")
def twenty():
    return closed.close_loop(
        cvxshear.Experiment.from_dict(experiment("base_rocking", 20, 1, modes=10), name="twenty stories"),
        effects=["base_rocking"],
    )


@pytest.fixture(scope="session")
def nine():
    """Return nine configurations; the fifth has an undeclared mass."""
    return closed.close_loop(
        cvxshear.Experiment.from_dict(experiment("added_mass", 3, 9), name="nine states"),
        effects=["added_mass", "gravity"],
    )


@pytest.fixture(scope="session")
def ambiguous():
    """Return one configuration with column elongation that resembles joint rotation."""
    result = closed.close_loop(
        cvxshear.Experiment.from_dict(experiment("axial_columns", 3, 1, noise=0.002), name="one test"),
        effects=["axial_columns", "joint_rotation", "mass_coupling"],
    )
    assert result.verdict == "ambiguous"
    return result


@pytest.fixture(scope="session")
def study():
    return closed.noise_study(paper_setups(), ("two-stage", "one-shot"), samples=50)


@pytest.fixture(scope="session")
def six_story():
    return closed.six_story_study(samples=4)


@pytest.fixture(scope="session")
def comparison(paper):
    return cvxshear.compare_backends(paper.experiment)


@pytest.fixture
def no_heights(paper):
    """Return the paper's result without declared heights."""
    frame = dataclasses.replace(paper.experiment.frame, story_heights=None)
    experiment = dataclasses.replace(paper.experiment, frame=frame)
    return cvxshear.identify(experiment, method="two-stage")
