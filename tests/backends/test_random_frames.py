"""Test random frames with exact modes, on every backend."""

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from cvxshear import Experiment, backends, identify
from tests.frames import experiment

FIRST_ORDER = ("osqp", "scs", "cvxpy-osqp", "cvxpy-scs")
ACCURACY = {name: 1e-5 if name in FIRST_ORDER else 1e-6 for name in ["auto", *backends.available()]}
FEW = settings(
    max_examples=6, deadline=None, derandomize=True, phases=[Phase.generate], suppress_health_check=list(HealthCheck)
)


@st.composite
def frames(draw):
    n = draw(st.integers(2, 12))
    ratio = st.floats(0.5, 2.0)
    mass = np.array(draw(st.lists(ratio, min_size=n, max_size=n))) * draw(st.sampled_from([1.0, 2e4]))
    stiffness = np.array(draw(st.lists(ratio, min_size=n, max_size=n))) * mass.mean() * 1e3
    start = np.array(draw(st.lists(ratio, min_size=n, max_size=n)))
    return mass, stiffness, start * mass.sum() / start.sum()


@pytest.mark.parametrize("name", backends.available())
@FEW
@given(frames())
def test_every_backend_recovers_a_frame_whatever_the_initial_mass(name, frame):
    mass, stiffness, start = frame
    of = Experiment.from_dict(experiment(mass, stiffness))
    shot = identify(of, "one-shot", name).frame
    np.testing.assert_allclose(shot.floor_mass, mass, rtol=ACCURACY[name])
    np.testing.assert_allclose(shot.story_stiffness, stiffness, rtol=ACCURACY[name])
    # The iteration converges linearly: its error at the end is several times e of Eq. 15.
    iterated = identify(of, "two-stage", name, initial_mass=start, tolerance=1e-8).parts[0]
    np.testing.assert_allclose(iterated.frame.floor_mass, mass, rtol=ACCURACY[name])
    np.testing.assert_allclose(iterated.frame.story_stiffness, stiffness, rtol=ACCURACY[name])
    assert iterated.converged
