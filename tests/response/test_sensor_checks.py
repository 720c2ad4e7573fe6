"""What is said of sensors and of a record's strength, by plain sums; and what is given when something else is."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from cvxshear.response.recording import ENVELOPE_PERIODS, QUIETEST, RecordedRun, Recording
from cvxshear.response.sensor_checks import whiteness, widening
from cvxshear.response.uncertain import UncertainFrame


def test_whiteness_is_ljung_and_boxs_statistic_over_all_runs():
    rng = np.random.default_rng(0)
    runs = [rng.standard_normal((count, 2)) for count in (300, 200)]
    for run in runs:
        run[7:, 1] -= 0.6 * run[:-7, 1]
    weights = [np.ones_like(run) for run in runs]
    # A spike counts as one of five deviations, a gap not at all.
    weights[0][50, 0], runs[0][50, 0] = 0.3, 40.0
    weights[1][[3, 4], 0], runs[1][[3, 4], 0] = 0.0, np.nan
    smoothed = [SimpleNamespace(innovations=run, weights=each) for run, each in zip(runs, weights, strict=True)]
    work = SimpleNamespace(recording=SimpleNamespace(floors=np.array([2, 4]), step=0.02))
    found = whiteness(work, smoothed)
    assert [(each.floor, each.spikes, each.missing) for each in found] == [(2, 1, 2), (4, 0, 0)]
    assert (found[1].lag, found[1].p_value < 1e-9, found[0].p_value > 0.01) == (pytest.approx(0.14), True, True)
    runs[0][50, 0], runs[1][[3, 4], 0] = 5.0, 0.0
    for channel, each in enumerate(found):
        series = [run[:, channel] for run in runs]
        power = sum(x**2 for run in series for x in run)
        count = 500 - 2 * (channel == 0)
        rho = [
            sum(a * b for run in series for a, b in zip(run[lag:], run, strict=False)) / power for lag in range(1, 21)
        ]
        box = count * (count + 2) * sum(r**2 / (count - lag) for lag, r in enumerate(rho, 1))
        assert each.size == pytest.approx(np.sqrt(power / count))
        assert abs(each.correlation) == pytest.approx(max(map(abs, rho)))
        assert each.correlation in [pytest.approx(r) for r in rho]
        assert each.p_value == pytest.approx(stats.chi2.sf(box, 20), rel=1e-6)


def test_short_runs_have_fewer_lags():
    run = SimpleNamespace(innovations=np.array([[1.0], [-1.0], [2.0]]), weights=np.ones((3, 1)))
    (found,) = whiteness(SimpleNamespace(recording=SimpleNamespace(floors=[1], step=0.5)), [run])
    box = 15 * ((-3 / 6) ** 2 / 2 + (2 / 6) ** 2 / 1)
    assert (found.correlation, found.lag) == (pytest.approx(-0.5), 0.5)
    assert found.p_value == pytest.approx(stats.chi2.sf(box, 2))


def test_bands_are_widened_by_what_sensors_missed():
    def check(error):
        return SimpleNamespace(error=error, stated=2.0)

    assert widening([]) == widening([check(1.0), check(1.5)]) == 1.0
    assert widening([check(6.0), check(2.0)]) == pytest.approx(np.sqrt(5.0))


def test_the_envelope_is_the_strength_around_a_sample_in_powers_of_two():
    """A motion that is four times as strong in its second half, with a gap that takes the strength around it."""
    period, rate = 0.5, 100.0
    half = 10 * round(ENVELOPE_PERIODS * period * rate)
    motion = np.repeat([1.0, 4.0], half) * np.tile([1.0, -1.0], half)
    measured = np.column_stack([motion, 3.0 * motion])
    measured[half // 2 : half // 2 + 5] = np.nan
    quiet = np.column_stack([np.tile([1e-9, -1e-9], 500)] * 2)
    recording = Recording(
        (RecordedRun(measured, np.zeros(2 * half), "a"), RecordedRun(quiet, np.zeros(1000), "b")),
        rate,
        np.array([1, 3]),
        "base",
    )
    strong, weak = recording.envelopes(period)
    # Mean squares of the runs, and of all samples together.
    whole = (half + 16 * half) / (2 * half + 1000)
    for place, level in ((half // 2, 1.0), (half // 4, 1.0), (half + half // 2, 4.0)):
        assert strong[place] == 2.0 ** np.round(np.log2(level / np.sqrt(whole)))
    assert np.all(weak == 2.0 ** np.round(np.log2(QUIETEST)))


@pytest.fixture
def uncertain():
    """Three masses, three stiffnesses and an effect, with a covariance of everything with everything."""
    root = np.random.default_rng(1).standard_normal((7, 7)) * [1, 1, 1, 50, 60, 70, 0.1]
    theta = np.array([10.0, 9.0, 8.0, 2e3, 3e3, 2.5e3, 0.4])
    fitted = SimpleNamespace(
        experiment=SimpleNamespace(stories=3), covariance=root.T @ root, theta=theta, misfit=1.7, root=None
    )
    return SimpleNamespace(fitted=fitted)


def test_stiffnesses_given_the_rest_have_the_inverse_of_their_block_of_the_precision(uncertain):
    found = UncertainFrame.conditional_stiffness(uncertain)
    k = uncertain.fitted.theta[3:6]
    given = np.linalg.inv(np.linalg.inv(uncertain.fitted.covariance)[3:6, 3:6])
    np.testing.assert_allclose(found, 1.7 * given / np.outer(k, k), rtol=1e-6)
    uncertain.fitted.covariance = None
    np.testing.assert_array_equal(UncertainFrame.conditional_stiffness(uncertain), np.zeros((3, 3)))
    assert UncertainFrame.nuisance_root(uncertain).shape == (7, 0)


def test_masses_and_effects_take_the_stiffnesses_along(uncertain):
    """L L' is their covariance, and the regression of the stiffnesses on them goes with each column."""
    L = UncertainFrame.nuisance_root(uncertain)
    C, rest = uncertain.fitted.covariance, [0, 1, 2, 6]
    np.testing.assert_allclose(L[rest] @ L[rest].T, 1.7 * C[np.ix_(rest, rest)], rtol=1e-9)
    regression = np.linalg.solve(C[np.ix_(rest, rest)], C[rest][:, 3:6]).T
    np.testing.assert_allclose(L[3:6], regression @ L[rest], rtol=1e-7)


def test_a_known_total_takes_a_direction_of_the_masses_away(uncertain):
    keep = np.eye(7)
    keep[:3, :3] -= 1 / 3
    uncertain.fitted.covariance = keep @ uncertain.fitted.covariance @ keep
    L = UncertainFrame.nuisance_root(uncertain)
    assert L.shape == (7, 3)
    np.testing.assert_allclose(L[:3].sum(axis=0), 0.0, atol=1e-9)


def test_a_record_is_as_long_as_its_runs_together():
    runs = [RecordedRun(np.random.default_rng(n).standard_normal((n, 1)), np.zeros(n), f"{n}") for n in (300, 500)]
    assert Recording(tuple(runs), 200.0, np.array([2]), "base").seconds == pytest.approx(4.0)
