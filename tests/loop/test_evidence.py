"""Compare evidence with brute-force integration: importance sampling of two-story frames, and quadrature."""

import numpy as np
import pytest
from scipy import integrate, special, stats

from cvxshear import Experiment, backends, close_loop
from cvxshear.effects import Scale
from cvxshear.fit.domain import MASS_WIDTH, STIFFNESS_WIDTH, EffectPrior
from cvxshear.fit.efficient import fitted
from cvxshear.fit.gauss_newton import Accuracy
from cvxshear.fit.gaussian import log_interval, log_normal_between
from cvxshear.fit.misfit import WIDTH, Misfit
from cvxshear.loop.fitter import log_evidence
from tests.effects.common import placed as put
from tests.frames import chain, configuration, experiment

MASS, STIFFNESS = np.array([11.0, 9.0]), np.array([24e3, 20e3])
HEIGHTS = np.array([0.4, 0.4])
ADDED = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
STD = np.array([0.002, 0.01])
SCALE = Scale(10.0, 22e3, HEIGHTS)
SAMPLES = 20000
FREEDOM = 5


SPRING = put("ground_spring", floor=2)
GAIN = put("sensor_gain", floor=1)
GRAVITY = put("gravity")
TOTAL = put("total_mass")


def matrices(mass, stiffness, added, effect, x):
    """Return M (..., 2, 2), K and sensor gains of many frames at once, from explicit formulas."""
    M = np.zeros((len(mass), 2, 2))
    M[:, 0, 0], M[:, 1, 1] = mass[:, 0] + added[0], mass[:, 1] + added[1]
    k = stiffness.copy()
    gain = np.ones((len(mass), 2))
    if effect is GRAVITY:
        load = 9.81 * np.stack([M[:, 0, 0] + M[:, 1, 1], M[:, 1, 1]], axis=1)
        k = k - x[:, None] * load / HEIGHTS
    if effect is GAIN:
        gain[:, 0] += x
    K = np.empty_like(M)
    K[:, 0, 0], K[:, 1, 1] = k.sum(axis=1), k[:, 1]
    K[:, 0, 1] = K[:, 1, 0] = -k[:, 1]
    if effect is SPRING:
        K[:, 1, 1] += x
    return M, K, gain


def chi2s(of, mass, stiffness, effect, x):
    """Return sums of squares of frequencies and of shapes in the default standard deviations, (S,) each."""
    frequency, shape = np.zeros(len(mass)), np.zeros(len(mass))
    for each in of.configurations:
        M, K, gain = matrices(mass, stiffness, each.added_mass, effect, x)
        root = np.sqrt(np.einsum("sii->si", M))
        values, vectors = np.linalg.eigh(K / root[:, :, None] / root[:, None, :])
        shapes = (vectors / root[:, :, None] * gain[:, :, None]).transpose(0, 2, 1)
        z = np.log(np.sqrt(np.maximum(values, 1e-300)) / (2 * np.pi) / each.frequencies) / STD[0]
        frequency += np.sum(z**2, axis=1)
        measured = each.mode_shapes
        scale = np.sum(shapes * measured, axis=2) / np.sum(shapes**2, axis=2)
        largest = np.max(np.abs(measured), axis=1)[:, None]
        shape += np.sum(((scale[:, :, None] * shapes - measured) / (STD[1] * largest)) ** 2, axis=(1, 2))
    return frequency, shape


def log_prior_of(effect, x):
    """Evaluate the densities of docs/theory/loop.md: Student's t with four degrees, its positive half, uniform."""
    if effect is SPRING:
        return np.where(x >= 0, np.log(2.0) + stats.t.logpdf(x, 4, scale=2200.0), -np.inf)
    if effect is GRAVITY:
        return stats.uniform.logpdf(x, 1.0, 0.2)
    return stats.t.logpdf(x, 4, scale={GAIN: 0.05, TOTAL: 0.1}[effect])


def sampled(of, estimate, effect, seed, *, undeclared=False):
    """Return the log of the integral of likelihood times prior over all free parameters, by importance sampling, and
    its error.

    The sum of the floor masses is declared, so they vary along (1, -1) / sqrt(2) in units of a typical floor. If an
    effect releases the sum, they also shift uniformly.
    """
    dims = 3 + (effect is not None) + 2 * undeclared
    unit, own = 10.0 / np.sqrt(2), 2200.0 if effect is SPRING else 1.0
    theta = estimate.theta
    center = np.zeros(dims)
    center[1:3] = theta[2:4] / 22e3
    center[0] = (theta[0] - theta[1]) / 2 / unit
    if effect is not None:
        center[3] = theta[4] / own
    if undeclared:
        center[-2:] = np.log([dict(estimate.misfit.noise.factors)[kind] for kind in ("frequency", "mode_shape")])

    def log_posterior(z):
        x = own * z[:, 3] if effect is not None else np.zeros(len(z))
        total = MASS.sum() * of.frame.total_mass / MASS.sum() * (1 + (x if effect is TOTAL else 0.0))
        mass = np.stack([total / 2 + unit * z[:, 0], total / 2 - unit * z[:, 0]], axis=1)
        stiffness = 22e3 * z[:, 1:3]
        good = np.all(mass > 0, axis=1) & np.all(stiffness > 0, axis=1)
        prior = log_prior_of(effect, x) if effect is not None else np.zeros(len(z))
        good &= np.isfinite(prior)
        mass, stiffness = np.where(good[:, None], mass, 10.0), np.where(good[:, None], stiffness, 22e3)
        logs = np.log(mass / 10.0), np.log(stiffness / 22e3)
        value = prior - sum(each.sum(axis=1) for each in logs)
        about_mean = logs[1] - logs[1].mean(axis=1, keepdims=True)
        value -= 0.5 * np.sum((logs[0] / MASS_WIDTH) ** 2 + (about_mean / STIFFNESS_WIDTH) ** 2, axis=1)
        chi2 = chi2s(of, mass, stiffness, effect, np.where(good, x, 0.0))
        if undeclared:
            u = z[:, -2:]
            counts = np.array([2.0, 2.0]) * len(of.configurations)
            value += stats.norm.logpdf(u, scale=WIDTH).sum(axis=1) - u @ counts
            chi2 = chi2[0] * np.exp(-2 * u[:, 0]), chi2[1] * np.exp(-2 * u[:, 1])
        return np.where(good, value - 0.5 * (chi2[0] + chi2[1]), -np.inf)

    rng = np.random.default_rng(seed)
    spread = np.diag([0.02, 0.02, 0.02, *([0.05] * (effect is not None)), *([0.3] * 2 * undeclared)]) ** 2
    for _ in range(20):
        # Adapt to the weighted samples, so that the last round has nearly the right distribution.
        z = stats.multivariate_t.rvs(center, spread, df=FREEDOM, size=SAMPLES, random_state=rng)
        logs = log_posterior(z) - stats.multivariate_t.logpdf(z, center, spread, df=FREEDOM)
        weights = np.exp(logs - logs.max())
        effective = weights.sum() ** 2 / np.sum(weights**2)
        value = logs.max() + np.log(weights.mean())
        if effective > SAMPLES / 3:
            break
        tempered = np.exp((logs - logs.max()) * min(1.0, 10.0 / np.ptp(np.sort(logs)[-SAMPLES // 100 :])))
        tempered /= tempered.sum()
        center = tempered @ z
        spread = 1.5 * ((z - center).T * tempered) @ (z - center)
    assert effective > SAMPLES / 20
    return value + np.log(own)


def measured(seed, *, spring=0.0, total=1.0, undeclared=False, tests=3):
    rng = np.random.default_rng(seed)
    tables = []
    for added in ADDED[:tests]:
        M, K = chain(MASS + added, STIFFNESS)
        K[1, 1] += spring
        root = np.sqrt(np.diag(M))
        values, vectors = np.linalg.eigh(K / np.outer(root, root))
        shapes = (vectors / root[:, None]).T
        shapes /= np.max(np.abs(shapes), axis=1, keepdims=True)
        table = {
            "added_mass": added.tolist(),
            "frequencies": (np.sqrt(values) / (2 * np.pi) * np.exp(STD[0] * rng.standard_normal(2))).tolist(),
            "mode_shapes": (shapes + STD[1] * rng.standard_normal((2, 2))).tolist(),
        }
        if not undeclared:
            table |= {"frequency_std": float(STD[0]), "mode_shape_std": float(STD[1])}
        tables.append(table)
    frame = {"total_mass": float(total * MASS.sum()), "story_heights": HEIGHTS.tolist()}
    return Experiment.from_dict(experiment(MASS, STIFFNESS, *tables, frame=frame))


def fit(of, effect):
    effects = () if effect is None else (effect,)
    start = np.concatenate([MASS * of.frame.total_mass / MASS.sum(), STIFFNESS, *(each.start for each in effects)])
    return fitted(Misfit(of, effects, expectation=EffectPrior(SCALE)), start, backends.get("auto"), Accuracy(1e-9))


CASES = {
    "a spring that is there": (SPRING, {"spring": 900.0}),
    "a spring pressed on its bound": (SPRING, {"spring": -500.0}),
    "a gain that is not there": (GAIN, {}),
    "gamma even on its interval": (GRAVITY, {}),
    "gamma that one test hides in the stiffnesses": (GRAVITY, {"tests": 1}),
    "a total mass that is off": (TOTAL, {"total": 0.93}),
}


@pytest.mark.parametrize("undeclared", [False, True], ids=["declared", "undeclared"])
@pytest.mark.parametrize("case", CASES)
def test_the_evidence_of_an_effect_is_the_ratio_of_the_integrals(case, undeclared):
    """Laplace's approximation is accurate to some hundredths of a unit here, slightly less with unknown noise."""
    effect, keys = CASES[case]
    of = measured(3, undeclared=undeclared, **keys)
    without, with_it = fit(of, None), fit(of, effect)
    assert (abs(with_it.theta[-1]) < 1e-6) == (case == "a spring pressed on its bound")
    expectation = EffectPrior(SCALE)
    found = log_evidence(with_it, expectation) - log_evidence(without, expectation)
    exact = sampled(of, with_it, effect, 1, undeclared=undeclared)
    exact -= sampled(of, without, None, 2, undeclared=undeclared)
    assert found == pytest.approx(exact, abs=0.25 if undeclared else 0.06)


@pytest.mark.parametrize(
    ("lower", "upper", "slope", "std"),
    [
        (-1.0, 2.0, 0.3, 0.5), (0.0, np.inf, 4.0, 1.0), (0.0, np.inf, 400.0, 0.3), (-np.inf, 0.0, -50.0, 2.0),
        (0.0, 0.2, -1.0, 10.0), (0.0, np.inf, -30.0, 1.0), (-0.1, 0.1, 1e4, 5.0), (3.0, 4.0, 0.0, 0.1),
    ],
)  # fmt: skip
def test_the_integral_over_an_interval_far_tails_included(lower, upper, slope, std):
    """Compare with adaptive quadrature of the integrand relative to its largest value on the interval."""

    def exponent(t):
        return -slope * t - t**2 / (2 * std**2)

    top = float(np.clip(-slope * std**2, lower, upper))
    width = min(std, 1.0 / max(abs(slope + top / std**2), 1e-300))
    left, right = max(lower, top - 40 * width), min(upper, top + 40 * width)
    value, _ = integrate.quad(lambda t: np.exp(exponent(t) - exponent(top)), left, right, epsabs=0, limit=200)
    expected = exponent(top) + np.log(value) - np.log(std * np.sqrt(2 * np.pi))
    assert log_interval(lower, upper, slope, std) == pytest.approx(expected, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize(
    ("a", "b"), [(-1.0, 2.0), (5.0, 6.0), (-40.0, -39.0), (39.0, 40.0), (-np.inf, -30.0), (0.0, 0.1)]
)
def test_the_normal_between_two_points_keeps_its_digits_in_either_tail(a, b):
    """Compare with the scaled complementary error function, which is accurate in the tails."""
    low, high = (a, b) if b <= 0 else (-b, -a) if a >= 0 else (None, None)
    if low is None:
        expected = np.log(stats.norm.cdf(b) - stats.norm.cdf(a))
    else:
        near = special.erfcx(-high / np.sqrt(2)) / 2
        far = 0.0 if np.isinf(low) else special.erfcx(-low / np.sqrt(2)) / 2 * np.exp((high**2 - low**2) / 2)
        expected = -(high**2) / 2 + np.log(near - far)
    assert log_normal_between(a, b) == pytest.approx(expected, rel=1e-10)


def test_a_frame_a_thousand_times_as_heavy_and_stiff_has_the_same_odds():
    """The modes are the same. Stories that must not stiffen upwards are at their limit in both unit systems."""
    mass, stiffness = np.array([10.0, 8.0, 6.0]), np.array([9e3, 9.3e3, 5e3])
    rng = np.random.default_rng(5)
    added = (np.zeros(3), np.array([0.0, 4.0, 0.0]))
    tables = [configuration(mass, stiffness, each, rng=rng, shape_noise=0.01, frequency_noise=0.001) for each in added]
    prior = [{"kind": "monotone", "quantity": "story_stiffness", "direction": "decreasing"}]
    found = []
    for factor in (1.0, 1000.0):
        tests = [{**table, "added_mass": (factor * each).tolist()} for table, each in zip(tables, added, strict=True)]
        declared = experiment(factor * mass, factor * stiffness, *tests, prior=prior)
        loop = close_loop(Experiment.from_dict(declared), effects=["ground_spring", "sensor_gain"])
        assert loop.estimate.uncertainty.active
        found.append({tuple(placed.label for placed in each.effects): each.probability for each in loop.models})
    assert len(found[0]) > 2
    assert found[1] == pytest.approx(found[0], rel=1e-5)
