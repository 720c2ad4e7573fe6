"""Compare the linearized model with fits, evidences and finite differences."""

import numpy as np
import pytest
from scipy import integrate, stats

from cvxshear import Experiment, backends
from cvxshear.effects import Scale
from cvxshear.fit.domain import EffectPrior
from cvxshear.fit.efficient import efficient, fitted_with
from cvxshear.fit.gaussian import LOG_SIZES, SizeMarginal, UnknownSize, gains_by_size, student_weights
from cvxshear.fit.misfit import Misfit
from cvxshear.loop.fitter import log_evidence
from cvxshear.loop.linear import Linearised
from tests.effects.common import placed as put
from tests.frames import configuration, experiment, modes_of

MASS = np.array([21e3, 19e3, 19.5e3, 18e3, 17e3])
STIFFNESS = np.array([30e6, 36e6, 33e6, 27e6, 22e6])
MISSED = 150.0
SCALE = Scale(19e3, 30e6, np.ones(5))


MASS_3 = put("added_mass", floor=3, state="test 2")
GAIN_2 = put("sensor_gain", floor=2)
CHANGE_4 = put("story_change", story=4, state="test 1")
SPRING_2 = put("ground_spring", floor=2)
TOTAL = put("total_mass")
LACKING = [MASS_3, GAIN_2, CHANGE_4, SPRING_2, TOTAL]
EXPECTED = EffectPrior(SCALE)


@pytest.fixture(scope="module")
def base():
    """Fit the shear model to two tests. The second has a small undeclared mass at floor 3."""
    rng = np.random.default_rng(0)
    added = np.array([0.0, 2e3, 4e3, 0.0, 6e3])
    first, second = (
        configuration(MASS, STIFFNESS, each, rng=rng, shape_noise=0.01, frequency_noise=0.001) for each in (None, added)
    )
    frequencies, shapes = modes_of(MASS + added + MISSED * np.eye(5)[2], STIFFNESS)
    second["frequencies"] = (frequencies * (1 + 0.001 * rng.standard_normal(5))).tolist()
    second["mode_shapes"] = (shapes + 0.01 * rng.standard_normal(shapes.shape)).tolist()
    of = Experiment.from_dict(experiment(MASS, STIFFNESS, first, second, frame={"total_mass": float(MASS.sum())}))
    start = efficient(of, backends.get("auto"))
    return fitted_with(Misfit(of, (), expectation=EXPECTED), start.theta, backends.get("auto"))


@pytest.fixture(scope="module")
def linear(base):
    return Linearised(base, LACKING, EXPECTED)


def refitted(base, *effects):
    misfit = Misfit(base.experiment, effects, expectation=EXPECTED)
    own = [value for each in effects for value in each.start]
    return fitted_with(misfit, np.concatenate([base.theta, own]), backends.get("auto"))


@pytest.mark.parametrize("placed", LACKING, ids=lambda placed: placed.label)
def test_the_gain_is_the_difference_of_evidences(base, linear, placed):
    """The difference is at most a tenth of a log unit, caused by the model's curvature; the gains are some units."""
    expected = log_evidence(refitted(base, placed), EXPECTED) - log_evidence(base, EXPECTED)
    assert linear.gains[LACKING.index(placed)] == pytest.approx(expected, abs=0.1)


def test_effects_are_added_in_the_order_of_the_evidences_of_fits(base, linear):
    """In each round the largest sum of evidence and log odds is added, until none is positive."""
    log_odds, taken = np.array([4.0, 3.0, 3.0, 4.0, 4.0]), []
    while len(taken) < len(LACKING):
        now = log_evidence(refitted(base, *taken), EXPECTED)
        gains = [
            -np.inf if placed in taken else log_evidence(refitted(base, *taken, placed), EXPECTED) - now + odds
            for placed, odds in zip(LACKING, log_odds, strict=True)
        ]
        if max(gains) < 0:
            break
        taken.append(LACKING[np.argmax(gains)])
    assert linear.forward(log_odds) == taken
    assert 2 < len(taken) < len(LACKING)


def test_the_promised_decrease_and_the_predicted_minimum_are_those_of_the_fit_for_a_small_effect(base, linear):
    fitted = refitted(base, MASS_3)
    assert linear.precision_gained(MASS_3) > 2
    wide = EffectPrior(SCALE, {MASS_3: np.array([1e9])})
    free = fitted_with(
        Misfit(base.experiment, [MASS_3], expectation=wide), np.append(base.theta, 0.0), backends.get("auto")
    )
    assert linear.decrease(MASS_3) == pytest.approx(base.fit.at.objective - free.fit.at.objective, rel=0.05)
    np.testing.assert_allclose(linear.predicted([MASS_3])[:10], fitted.theta[:10], rtol=2e-3)
    assert linear.predicted([MASS_3])[10] == pytest.approx(fitted.theta[10], rel=0.1)


def test_the_predicted_minimum_with_a_total_mass_keeps_what_it_says(base, linear):
    """The prediction keeps sum m = total (1 + e) and lies near the fit."""
    found = linear.predicted([TOTAL])
    assert found[:5].sum() == pytest.approx(MASS.sum() * (1 + found[10]), rel=1e-9)
    fitted = refitted(base, TOTAL)
    assert found[10] == pytest.approx(fitted.theta[10], abs=0.3 * fitted.std[10])


def test_the_prediction_keeps_an_effect_within_its_bounds(linear):
    (parameter,) = SPRING_2.effect.parameters
    assert linear.predicted([SPRING_2])[-1] >= parameter.lower
    assert (linear.predicted([SPRING_2])[-1] == parameter.lower) == (linear.decrease(SPRING_2) == 0.0)


def test_how_much_surer_an_effect_is_known_is_the_ratio_of_precisions(base, linear):
    """Compare 1 + (expected size / deviation from the data alone)^2 with a fit without a prior on the effect."""
    for placed in (MASS_3, GAIN_2, CHANGE_4):
        wide = EffectPrior(SCALE, {placed: np.array([1e9])})
        free = fitted_with(
            Misfit(base.experiment, [placed], expectation=wide),
            np.append(base.theta, placed.start),
            backends.get("auto"),
        )
        expected = 1 + (EXPECTED.of(placed)[0] / free.uncertainty.std()[10]) ** 2
        assert linear.precision_gained(placed) == pytest.approx(expected, rel=0.1)


def test_what_a_frame_changes_instead_of_a_story_is_first_of_all_that_story(linear):
    names = [f"{kind} {i}" for kind in ("mass", "stiffness") for i in range(1, 6)]
    assert linear.confounders(CHANGE_4, names)[0] == "stiffness 4"
    assert set(linear.confounders(CHANGE_4, names, share=0.0)) == set(names)
    assert linear.confounders(CHANGE_4, names, share=0.999) == ("stiffness 4",)


def drawn_normal(seed):
    """Return the slope b and the information h of two parameters' columns and a residual, and the expected sizes."""
    rng = np.random.default_rng(seed)
    columns, r = rng.standard_normal((6, 2)) * [3.0, 0.5], rng.normal(0.0, 2.0, 6)
    return -columns.T @ r, columns.T @ columns, np.array([0.4, 1.5])


def gained(b, h, stds):
    """Return the log of the integral of exp(b'x - x'h x / 2) over x, normal about zero with these deviations."""
    H = h + np.diag(stds**-2.0)
    return 0.5 * b @ np.linalg.solve(H, b) - 0.5 * np.linalg.slogdet(np.diag(stds**2) @ H)[1]


def over_log_sizes(log_gain, points=4001):
    """Return the log of the mean of a gain over a normal variable, and where gain times density is largest."""
    t = np.linspace(-9.0, 9.0, points)
    logs = np.array([log_gain(each) for each in t]) + stats.norm.logpdf(t)
    return np.log(integrate.trapezoid(np.exp(logs - logs.max()), t)) + logs.max(), t[np.argmax(logs)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("width", [0.5, 1.5])
def test_a_common_size_is_integrated_out(seed, width):
    b, h, stds = drawn_normal(seed)
    expected, best = over_log_sizes(lambda t: gained(b, h, np.exp(width * t) * stds))
    found = gains_by_size(stds * b, stds[:, None] * h * stds, width * LOG_SIZES) - 0.5 * LOG_SIZES**2
    integral = np.logaddexp.reduce(found) - np.logaddexp.reduce(-0.5 * LOG_SIZES**2)
    assert integral == pytest.approx(expected, abs=1e-3)
    assert LOG_SIZES[np.argmax(found)] == pytest.approx(best, abs=0.13)


@pytest.mark.parametrize("tail", [3.0, 4.0, 10.0, np.inf])
@pytest.mark.parametrize("distance", [0.0, 1.0, 20.0])
def test_students_distribution_is_a_mixture_of_normal_ones(tail, distance):
    parts = student_weights(tail) + stats.norm.logpdf(distance, scale=np.exp(LOG_SIZES))
    expected = stats.norm.logpdf(distance) if np.isinf(tail) else stats.t.logpdf(distance, tail)
    assert np.logaddexp.reduce(parts) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("size", [0.3, 1.0, 6.0])
@pytest.mark.parametrize("width", [0.5, 1.5])
def test_an_accuracy_that_is_left_open_is_integrated_out_the_fit_following(size, width):
    """Five of twelve residuals have the variance multiplied by e^2u, and e^2u - 1 has a log-normal prior."""
    rng = np.random.default_rng(1)
    Q = np.linalg.qr(rng.standard_normal((12, 3)))[0]
    r = rng.standard_normal(12) * np.where(np.arange(12) < 5, size, 1.0)
    r -= Q @ (Q.T @ r)

    def log_gain(t):
        u = 0.5 * np.log1p(np.exp(2 * width * t))
        weight = np.where(np.arange(12) < 5, np.exp(-u), 1.0)
        rows, sides = weight[:, None] * Q, weight * r
        left = sides - rows @ np.linalg.lstsq(rows, sides, rcond=None)[0]
        return 0.5 * (r @ r - left @ left) - 0.5 * np.linalg.slogdet(rows.T @ rows)[1] - 5 * u

    expected, best = over_log_sizes(log_gain, 1001)
    found, factor = SizeMarginal([UnknownSize("", 5, width, above_one=True)], [1.0], [Q[:5]], [r[:5]]).over_grid()
    assert found == pytest.approx(expected, abs=1e-2)
    assert np.log(np.expm1(2 * factor)) / 2 == pytest.approx(width * best, abs=0.13 * width)
