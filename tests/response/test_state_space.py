"""Test the discrete model of a frame and its noise against the differential equations."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, linalg

from cvxshear.response.innovations import Filter, strongest
from cvxshear.response.state_space import Noise, Setting, discretized, doubled, dynamics, recursion
from tests.frames import chain

MASS, STIFFNESS = np.array([4.0, 3.0, 2.0]), np.array([900.0, 700.0, 500.0])
HEIGHTS = np.array([3.0, 2.8, 2.5])
GAIN, STORY_FORCE, STEP = np.array([1.0, 1.1, 0.9]), np.array([5.0, 3.0, 2.0]), 0.03
INPUT = 0.97
NOISE = Noise(np.array([0.1, 0.2]), 0.04, 0.7)
CASES = {"base": 0, "force": 2}


def frame():
    M, K = chain(MASS, STIFFNESS)
    C = 0.02 * M + 0.003 * K + np.diag([0.0, 0.4, 0.0])
    return SimpleNamespace(M=M, K=K, C=C, gain=GAIN, heights=HEIGHTS, input_gain=INPUT)


def setting(case):
    return Setting(np.array([1, 3]), STEP, CASES[case], 6.0, STORY_FORCE, frame().M)


def slope(case, x, p):
    """Return x' of displacements, velocities and relative story forces, and the total accelerations."""
    model, force_floor = frame(), CASES[case]
    u, v, f = x[:3], x[3:6], x[6:9]
    missed = INPUT * STORY_FORCE * f
    on_floors = missed - np.append(missed[1:], 0.0) - model.K @ u - model.C @ v
    ground = INPUT * p
    if force_floor:
        on_floors[force_floor - 1] += INPUT * p
        ground = 0.0
    total = on_floors / MASS
    return np.concatenate([v, total - ground, -6.0 * f]), total


@pytest.mark.parametrize("case", CASES)
def test_a_step_is_the_solution_of_the_differential_equations(case):
    """Check each state by itself, and a start from rest under an excitation that is linear over the step."""
    found = dynamics(frame(), NOISE, setting(case))
    n = setting(case).states
    assert found.A.shape == (n, n)

    def stepped(x, begin, end):
        solved = integrate.solve_ivp(
            lambda t, x: slope(case, x, begin + (end - begin) * t / STEP)[0], (0, STEP), x, rtol=1e-10, atol=1e-12
        )
        return solved.y[:, -1]

    np.testing.assert_allclose(found.A, np.array([stepped(unit, 0.0, 0.0) for unit in np.eye(n)]).T, atol=1e-8)
    np.testing.assert_allclose(found.before, stepped(np.zeros(n), 1.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(found.after, stepped(np.zeros(n), 0.0, 1.0), atol=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_sensors_and_outputs_show_what_the_equations_say(case):
    found, force_floor = dynamics(frame(), NOISE, setting(case)), CASES[case]
    x, p = np.random.default_rng(1).standard_normal(setting(case).states), 0.7
    _, total = slope(case, x, p)
    np.testing.assert_allclose(found.H @ x + found.direct * p, (GAIN * total)[[0, 2]])
    np.testing.assert_allclose(found.R, [0.01, 0.04])
    acting = INPUT * p * (np.arange(1, 4) == force_floor)
    story = [np.sum((acting - MASS * total)[i:]) for i in range(3)]
    # The outputs include the base moment, because heights are known.
    expected = [*total, *x[:3], *np.diff(x[:3], prepend=0.0), *story, HEIGHTS @ story]
    np.testing.assert_allclose(found.outputs.of(x[None], np.array([[9.0, p]]))[0], expected)


@pytest.mark.parametrize("case", CASES)
def test_the_noise_has_the_deviations_that_were_asked_for(case):
    """A step adds the integral of e^At; an error of 0.7 in the excitation acts in both steps of its sample."""
    found = dynamics(frame(), NOISE, setting(case))
    np.testing.assert_allclose(found.P0, linalg.solve_discrete_lyapunov(found.A, found.Q), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.diag(found.P0))[6:], [0.04] * 3)
    n = len(found.A)
    rates = np.array([slope(case, unit, 0.0)[0] for unit in np.eye(n)]).T
    density = np.zeros(n)
    density[6:9] = 2 * 6.0 * 0.04**2
    nodes, weights = np.polynomial.legendre.leggauss(12)
    powers = [linalg.expm(rates * STEP * (1 + node) / 2) for node in nodes]
    integral = sum(w * STEP / 2 * (e * density) @ e.T for w, e in zip(weights, powers, strict=True))
    own = 0.7 * (found.before + found.after)
    np.testing.assert_allclose(found.Q, integral + np.outer(own, own), rtol=1e-6, atol=1e-12)
    settled = linalg.solve_discrete_are(found.A.T, found.H.T, found.Q, np.diag(found.R))
    np.testing.assert_allclose(Filter.settled(found).P, settled, rtol=1e-5, atol=1e-10)


def test_base_motion_does_not_tell_how_heavy_a_frame_is():
    """Twice the masses, dashpots and stiffnesses give the same motion and the same missed motion."""
    one, double = frame(), frame()
    double.M, double.C, double.K = 2 * one.M, 2 * one.C, 2 * one.K
    plain, heavy = (dynamics(each, NOISE, setting("base")) for each in (one, double))
    for name in ("A", "before", "after", "Q", "H", "direct", "R"):
        np.testing.assert_allclose(getattr(heavy, name), getattr(plain, name), rtol=1e-9, atol=1e-14, err_msg=name)


@pytest.mark.parametrize("samples", [1, 200, 256, 319, 320, 321, 64 * 128 + 70])
def test_a_recursion_by_blocks_is_the_one_sample_by_sample(samples):
    rng = np.random.default_rng(samples)
    F = np.array([[0.9, 0.2, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.0, 0.5]])
    B, signals, x = rng.standard_normal((2, 3)), rng.standard_normal((samples, 2)), np.array([1.0, -2.0, 3.0])
    found = recursion(F, B, signals, x)
    expected = []
    for each in signals:
        expected.append(x)
        x = F @ x + B.T @ each
    np.testing.assert_allclose(found, expected, atol=1e-10)


@pytest.mark.parametrize("fastest", [30.0, 3000.0, 3e5])
def test_the_noise_of_a_step_in_which_a_mode_dies_away_is_what_is_missing_to_its_stationary_covariance(fastest):
    """Q = P - A P A' with the stationary P from scipy's Lyapunov equation, for decays of up to 3,000 over a step."""
    rates = np.array([[0.0, 1.0, 0.0], [-400.0, -fastest, 50.0], [0.0, 0.0, -8.0]])
    A, _, _, Q = discretized(rates, np.zeros(3), np.diag([0.0, 0.0, 3.0]), 0.01)
    np.testing.assert_allclose(A, linalg.expm(0.01 * rates), rtol=1e-9, atol=1e-14)
    P = linalg.solve_continuous_lyapunov(rates, -np.diag([0.0, 0.0, 3.0]))
    np.testing.assert_allclose(Q, P - A @ P @ A.T, rtol=1e-6, atol=1e-12 * np.max(P))
    assert np.min(linalg.eigvalsh(Q)) > -1e-15 * np.max(Q)


def test_a_transition_that_grows_without_limit_has_no_covariance():
    A, Q = np.diag([0.5, 0.9]), np.array([[2.0, 1.0], [1.0, 3.0]])
    np.testing.assert_allclose(doubled(A, Q), linalg.solve_discrete_lyapunov(A, Q))
    with pytest.raises(linalg.LinAlgError, match="64 bits"):
        doubled(1e3 * A, Q)


def test_the_strongest_part_of_a_record_is_that_of_all_channels_relative_to_their_means():
    y = np.random.default_rng(3).standard_normal((300, 2)) * [1.0, 50.0]
    y[120:180, 0] = -2.0 * np.abs(y[120:180, 0])
    y[200, 1] = 300.0
    sums = [np.sum(y[at : at + 60] ** 2 / np.mean(y**2, axis=0)) for at in range(241)]
    assert strongest(y, 60) == slice(np.argmax(sums), np.argmax(sums) + 60)
    assert strongest(y, 300) == slice(0, 300)
