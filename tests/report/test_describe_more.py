"""What `check`, `plan` and `predict` say is described once too: terminal, prompt and notebook show the same of it."""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.cells import cell_len

import cvxshear
from cvxshear.planning import plan
from cvxshear.report import terminal
from cvxshear.report.describe import Sentence, Table, describe
from cvxshear.response import DampedModel, Drive, Motion, RecordPrediction, predict, response
from cvxshear.screening import Screening
from tests.planning.common import slow_covariance, tapered
from tests.response.common import damped_frame, declared, matrices, pole_ratios, shaking
from tests.report.conftest import NASTY

SWAPPED = Path(__file__).resolve().parents[2] / "examples" / "swapped_sensors.toml"


def table(of, key):
    parts = [part for section in describe(of).sections for part in section.parts]
    return next(part for part in parts if isinstance(part, Table) and part.key == key)


def sentences(of):
    return [part for section in describe(of).sections for part in section.parts if isinstance(part, Sentence)]


@pytest.fixture(scope="module")
def planned():
    return plan(tapered(4), 2, modes=3)


@pytest.fixture(scope="module")
def predicted():
    mass, stiffness, dashpots = damped_frame(3)
    M, C, K = matrices(mass, stiffness, dashpots)
    experiment = cvxshear.Experiment.from_dict(declared(mass, stiffness, pole_ratios(M, C, K)), name="three")
    excitation = shaking()
    measured = response(DampedModel(M, C, K, np.ones(3)), Drive(excitation), 0.01).acceleration
    motion = Motion(
        name="shaken", sampling_rate=100.0, input="base", drives=(Drive(excitation),), floors=np.array([1, 2, 3]),
        measured=(measured,), added_mass=np.zeros(3),
    )  # fmt: skip
    return predict(experiment, motion, damping="story", detrend=False)
