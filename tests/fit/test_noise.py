"""Test undeclared noise: its marginal, its estimates, and the quantities that it must not change."""

import numpy as np
import pytest
from scipy.integrate import simpson

from cvxshear import Experiment, backends, close_loop, identify
from cvxshear.data import NoiseFactors
from cvxshear.fit.efficient import efficient
from cvxshear.fit.gaussian import SizeMarginal, UnknownSize
from cvxshear.fit.misfit import Misfit, NoiseAtFit
from cvxshear.priors import Value
from tests.frames import configuration, experiment

MASS = np.array([21e3, 19e3, 19.5e3, 18e3, 17e3, 20e3])
STIFFNESS = np.array([30e6, 36e6, 33e6, 27e6, 22e6, 25e6])
ADDED = (None, [2e3, 6e3, 4e3, 7e3, 3e3, 5e3], [9e3, 0, 0, 4e3, 0, 0])
STDS = ("frequency_std", "mode_shape_std")
DEFAULTS = {"frequency": 0.002, "mode_shape": 0.01}


def experiment_with(seed, frequency, shape, *, declare=(), frame=None, prior=()):
    """Return three tests with this noise; only the named standard deviations are declared, with their true values."""
    rng = np.random.default_rng(seed)
    true = {"frequency_std": frequency, "mode_shape_std": shape}
    tables = []
    for added in ADDED:
        table = configuration(MASS, STIFFNESS, added, rng=rng, shape_noise=shape, frequency_noise=frequency)
        for key, value in true.items():
            del table[key]
            if key in declare:
                table[key] = value
        tables.append(table)
    frame = {"total_mass": float(MASS.sum())} if frame is None else frame
    return Experiment.from_dict(experiment(MASS, STIFFNESS, *tables, frame=frame, prior=prior))


def marginal_of(misfit, at, free):
    rows = [at.unknown == place for place in range(len(misfit.unknown))]
    factors = [misfit.noise.of(item.key) for item in misfit.unknown]
    parts = [at.J[own] @ free for own in rows], [at.r[own] for own in rows]
    return SizeMarginal(misfit.unknown, factors, *parts, free.T @ (at.J.T @ at.r))


@pytest.mark.parametrize("u", [[0.0, 0.0], [1.1, -0.4], [-0.8, 0.9]])
def test_the_marginal_s_derivative(u):
    estimate = efficient(experiment_with(1, 0.004, 0.008), backends.get("auto"))
    of = marginal_of(estimate.misfit, estimate.fit.at, estimate.free_directions)
    at = of.here + np.array(u)
    _, gradient = of.negative(at)
    step = 1e-5
    differences = [
        (of.negative(at + step * unit)[0] - of.negative(at - step * unit)[0]) / (2 * step) for unit in np.eye(2)
    ]
    np.testing.assert_allclose(gradient, differences, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("frequency", "shape"), [(0.002, 0.01), (0.006, 0.005), (0.001, 0.02), (0.005, 0.03)])
def test_two_unknown_noises_are_each_found_by_itself(frequency, shape):
    """Root mean square of the errors in their stated deviations, over simulated tests of each pair of noises."""
    z = []
    for seed in range(3):
        found = identify(experiment_with(seed, frequency, shape)).to_dict()
        fit = efficient(experiment_with(seed, frequency, shape), backends.get("auto"))
        estimate = fit.noise.to_dict()
        for kind, true in (("frequency", frequency), ("mode_shape", shape)):
            z.append((estimate[kind]["factor"] - true / DEFAULTS[kind]) / estimate[kind]["std"])
        assert estimate["displacement"] is None
        assert found["fit"]["p_value"] is None
        assert np.sqrt(np.mean(((fit.theta - np.concatenate([MASS, STIFFNESS])) / fit.std) ** 2)) < 2
    assert np.sqrt(np.mean(np.square(z))) < 1.8


def test_only_what_is_undeclared_is_estimated():
    estimate = efficient(experiment_with(3, 0.006, 0.02, declare=["frequency_std"]), backends.get("auto"))
    assert estimate.noise.kinds == ("mode_shape",)
    assert dict(estimate.noise.noise.factors)["mode_shape"] == pytest.approx(2.0, rel=0.25)
    both = efficient(experiment_with(3, 0.006, 0.02, declare=["frequency_std", "mode_shape_std"]), backends.get("auto"))
    assert both.noise.kinds == ()
    assert both.quality.p_value is not None


def test_a_declared_standard_deviation_is_never_rescaled():
    """Errors four times the declared noise do not change the stated deviations."""
    declare = ["frequency_std", "mode_shape_std"]
    honest = experiment_with(4, 0.001, 0.01, declare=declare).to_dict()
    worse = experiment_with(4, 0.004, 0.04, declare=declare).to_dict()
    for table in worse["configuration"]:
        table["frequency_std"], table["mode_shape_std"] = 0.001, 0.01
    honest, worse = (identify(Experiment.from_dict(each)) for each in (honest, worse))
    np.testing.assert_allclose(worse.frame.story_stiffness_std, honest.frame.story_stiffness_std, rtol=0.1)
    assert worse.fit.p_value < 1e-6
    assert honest.fit.p_value > 1e-3


@pytest.mark.parametrize(("frequency", "shape"), [(0.0002, 0.001), (0.008, 0.04)])
def test_a_prior_s_standard_deviation_is_never_rescaled(frequency, shape):
    """One floor's mass, known to 5 %, alone determines the scale. Its deviation stays 5 % for any noise."""
    rng = np.random.default_rng(5)
    table = configuration(MASS, STIFFNESS, rng=rng, shape_noise=shape, frequency_noise=frequency)
    del table["frequency_std"], table["mode_shape_std"]
    prior = Value("floor_mass", at=1, value=MASS[0], std=0.05)
    of = Experiment.from_dict(experiment(MASS, STIFFNESS, table, frame={}, prior=[prior.to_dict()]))
    estimate = efficient(of, backends.get("auto"))
    assert estimate.std[0] / estimate.theta[0] == pytest.approx(0.05, rel=0.02)


def test_the_rows_of_a_prior_and_of_declared_data_carry_no_factor():
    of = experiment_with(6, 0.004, 0.02, declare=["mode_shape_std"])
    of = of.with_priors([Value("story_stiffness", at=2, value=36e6, std=0.05)])
    theta = np.concatenate([1.01 * MASS, 0.97 * STIFFNESS])
    noises = (NoiseFactors(), NoiseFactors((("frequency", 10.0),)))
    plain, tenfold = (Misfit(of, noise=noise).evaluate(theta) for noise in noises)
    open_rows = plain.unknown == 0
    assert open_rows.sum() == 18
    np.testing.assert_allclose(tenfold.r[open_rows], plain.r[open_rows] / 10, rtol=1e-12)
    np.testing.assert_array_equal(tenfold.r[~open_rows], plain.r[~open_rows])
    np.testing.assert_array_equal(tenfold.J[~open_rows], plain.J[~open_rows])


def test_noise_that_no_instrument_has_is_improbable():
    """Modes 1 and 3 are exchanged: the factors grow, but not beyond the limit for noise."""
    table = configuration(MASS, STIFFNESS)
    del table["frequency_std"], table["mode_shape_std"]
    shapes = table["mode_shapes"]
    shapes[0], shapes[2] = shapes[2], shapes[0]
    frame = {"total_mass": float(MASS.sum())}
    of = Experiment.from_dict(experiment(MASS, STIFFNESS, table, frame=frame))
    estimate = efficient(of, backends.get("auto"))
    assert estimate.quality.max_frequency_error > 0.05 or estimate.quality.max_shape_error > 0.05
    assert estimate.p_value < 0.01
    sound = efficient(experiment_with(7, 0.004, 0.02), backends.get("auto"))
    assert sound.p_value > 0.01


def test_a_mode_that_cannot_be_ends_in_numbers():
    """A frequency of 3e12 Hz makes the frequency noise unbounded; its curvature is 1e20 times the shape noise's."""
    shapes = [[0.301849953584011, 6.48535272e11, 1.0], [-0.678977475, -0.606599092, 1.0], [2.43962752, -2.54193618, 1]]
    tested = {"frequencies": [1.03359792, 2.20985874, 3.28118804e12], "mode_shapes": shapes}
    declared = {"frame": {"stories": 3, "total_mass": 22.5}, "configuration": [tested]}
    closure = close_loop(Experiment.from_dict(declared), effects=["sensor_gain"])
    assert closure.verdict == "unexplained"
    factors = [closure.noise.to_dict()[kind]["factor"] for kind in ("frequency", "mode_shape")]
    assert np.all(np.isfinite(factors))


def test_the_gain_of_two_unknown_noises_is_their_integral_on_a_grid():
    """Integrate exp(-|W(u)(J x + r)|^2 / 2) over x and the priors of both logarithms over u, with full matrices."""
    rng = np.random.default_rng(8)
    tables = [
        configuration([10.0, 8.0, 6.0], [9e3, 7e3, 5e3], added, rng=rng, shape_noise=0.02, frequency_noise=0.003)
        for added in (None, [0.0, 4.0, 0.0])
    ]
    for table in tables:
        del table["frequency_std"], table["mode_shape_std"]
    of = Experiment.from_dict(experiment([10.0, 8.0, 6.0], [9e3, 7e3, 5e3], *tables))
    estimate = efficient(of, backends.get("auto"))
    misfit, theta = estimate.misfit, estimate.theta
    at = misfit.evaluate(theta)
    free = estimate.uncertainty.root_of(at.triangle[0])
    found = NoiseAtFit.of(misfit, at, free).estimate()
    here = np.log([misfit.noise.of(kind) for kind in ("frequency", "mode_shape")])
    # Rows that change with doubled frequency noise belong to frequencies: six, and 2 x 3 x (3 - 1) ratios.
    doubled = NoiseFactors((("frequency", 2 * np.exp(here[0])), ("mode_shape", np.exp(here[1]))))
    moved = np.linalg.norm(misfit.replaced(noise=doubled).evaluate(theta).J, axis=1)
    is_frequency = moved < 0.75 * np.linalg.norm(at.J, axis=1)
    assert is_frequency.sum() == 6
    counts = np.array([6, 12])

    def value(u):
        weight = np.where(is_frequency, *np.exp(here - u))
        J, r = weight[:, None] * (at.J @ free), weight * at.r
        x = np.linalg.lstsq(J, -r, rcond=None)[0]
        volume = np.linalg.slogdet(J.T @ J)[1]
        return -np.sum((J @ x + r) ** 2) / 2 - volume / 2 - counts @ u - u @ u / (2 * 0.7**2)

    marginal = marginal_of(misfit, at, free)
    points = here + np.array([[0.3, -0.5], [-0.6, 0.2]])
    first, second = marginal.values(points)
    assert first - second == pytest.approx(value(points[0]) - value(points[1]), rel=1e-6)
    assert [first, second] == pytest.approx([-marginal.negative(each)[0] for each in points], rel=1e-12)
    grid = [np.linspace(here[i] - 3.5, here[i] + 3.5, 141) for i in range(2)]
    density = np.array([[value(np.array([a, b])) for b in grid[1]] for a in grid[0]])
    top = density.max()
    integral = top + np.log(simpson(simpson(np.exp(density - top), grid[1]), grid[0]))
    expected = integral + np.sum(at.r**2) / 2 - 2 * np.log(0.7 * np.sqrt(2 * np.pi))
    assert found.gain == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("left_out", [STDS, (*STDS, "mode_shapes", "measured_floors")])
def test_shapes_of_a_single_sensor_tell_nothing_whatever_their_noise(left_out):
    """Each shape's scale is free, so its single entry carries no information; frequencies determine the frame."""
    tables = [configuration(MASS, STIFFNESS, added, measured_floors=[3], modes=[1, 2, 3]) for added in ADDED]
    tables = [{key: value for key, value in table.items() if key not in left_out} for table in tables]
    declared = experiment(MASS, STIFFNESS, *tables, frame={"floor_masses": MASS.tolist()})
    found = efficient(Experiment.from_dict(declared), backends.get("auto"))
    np.testing.assert_allclose(found.theta[6:], STIFFNESS, rtol=1e-4)
    assert found.dof == 9 - 6


@pytest.mark.parametrize(("above_one", "expected"), [(False, np.log(3.0)), (True, np.log(np.sqrt(8.0)))])
def test_a_factor_has_the_value_that_is_normal_beforehand(above_one, expected):
    """The value is the logarithm of the factor 3 itself, or of s in 3 = sqrt(1 + s^2)."""
    size = UnknownSize("frequency", 5.0, 0.7, above_one)
    assert size.coordinate(3.0) == pytest.approx(expected, rel=1e-12)
    assert size.log_factor(expected)[0] == pytest.approx(np.log(3.0), rel=1e-12)
