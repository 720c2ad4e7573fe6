"""Test a frame's variation in a record: matrices by their modes, and its prior from independent normal numbers."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import linalg, stats

import cvxshear
from cvxshear import backends
from cvxshear.fit.efficient import efficient
from cvxshear.measurement.declaration import ExpectedEffect
from cvxshear.response import DampedModel, Fitted, varied_frame
from cvxshear.response import frame_prior as module
from cvxshear.response.frame_prior import FramePrior, ModalRows
from cvxshear.response.state_space import Filter, Noise, Setting, dynamics, recursion
from cvxshear.response.uncertain import Damped, UncertainFrame
from cvxshear.response.varied_frame import VariedFrame
from tests.frames import chain
from tests.response.common import damped_frame, declared, matrices, pole_ratios

SIZES = (3, 3, 3, 4)
"""Numbers of stories, damping factors (last a dashpot), directions of masses and effects (last a gain), form errors."""


@pytest.mark.parametrize("changed", [(), (1,), (0, 2), (1, 3), (1, 4)])
@pytest.mark.parametrize("same", [False, True])
@pytest.mark.parametrize("mass_std", [0.0, 0.05])
def test_the_prior_is_conditioned_on_the_modes_like_any_normal_numbers(changed, same, mass_std):
    """All unknowns are sums of independent normal numbers w; the modes measure some with errors of one."""
    rng = np.random.default_rng(3)
    root = 0.01 * rng.standard_normal((3, 3))
    own, share = np.array([0.3, 0.2]), np.array([0.02, 0.05, np.inf])
    measured = ModalRows(20.0 * rng.standard_normal((7, 10)), rng.standard_normal(7))
    measured.J[:, 5] = 0.0
    heavier = rng.standard_normal((13, 3))
    varied = SimpleNamespace(
        own_std=own, sizes=SIZES, nuisance_share=share, heavier_floors=heavier, sensor_gains=slice(8, 9),
        dashpots=slice(5, 6),
    )  # fmt: skip
    prior = FramePrior(varied, 2, root @ root.T, 0.4, 0.05, 0.1, 0.02, measured)
    form_std, scatter = 0.03, 0.003
    found = prior.gaussian(changed, form_std, scatter, mass_std, 0.01, same=same)

    # Gains count in percent: 1 % for each, and 5 % more for a wrong one.
    off = 5.0 if 4 in changed and not same else 0.0
    nuisances = np.array([*np.sqrt(1.0 + form_std**2 / share[:2] ** 2 / 2), np.hypot(1.0, off)])
    shift = 0.0 if same else 1.0
    story = [
        root, shift * 0.15 * np.ones((3, 1)), shift * scatter * np.eye(3),
        shift * 0.4 * np.eye(3)[:, [story for story in changed if story < 3]],
    ]  # fmt: skip
    # Each ratio varies by itself and with all others; a dashpot can be present.
    damping = [np.diag(np.hypot(own, shift * 0.3)), shift * 0.5 * np.ones((2, 1))]
    dashpot = np.array([[np.hypot(1e-3, shift * (1.0 if 3 in changed else 0.0))]])
    rest = np.diag([*nuisances, *np.full(4, form_std)])
    unknowns = linalg.block_diag(np.hstack(story), np.hstack(damping), dashpot, rest, np.eye(2))
    tested = linalg.block_diag(root, rest)
    width = unknowns.shape[1] - 3 - 7 - 2
    numbers = np.hstack([tested[:, :3], np.zeros((10, width)), tested[:, 3:], np.zeros((10, 2))])
    seen = measured.J @ numbers
    posterior = np.linalg.inv(np.eye(len(seen.T)) + seen.T @ seen)
    np.testing.assert_allclose(found.mean, unknowns @ posterior @ seen.T @ measured.data, atol=1e-12)
    covariance = unknowns @ posterior @ unknowns.T
    covariance[:13, :13] += (0.0 if same else mass_std**2) * heavier @ heavier.T
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-12)
    density = stats.multivariate_normal.logpdf(measured.data, np.zeros(7), np.eye(7) + seen @ seen.T)
    assert found.evidence == pytest.approx(density + 3.5 * np.log(2 * np.pi), rel=1e-9)


@pytest.mark.parametrize("sizes", [module.FORM_STDS, module.SCATTER_STDS])
def test_sizes_that_are_compared_leave_no_gap_wider_than_half_a_decade(sizes):
    """Any size between two neighbors differs from one by at most a factor of 1.8."""
    steps = np.divide(sizes[1:], sizes[:-1])
    assert np.all((steps > 3 - 1e-9) & (steps < 10 / 3 + 1e-9))


def centre(kind):
    """Return a three-story frame with a kind of damping, and its dashpots, factors or ratios."""
    mass, stiffness, dashpots = damped_frame(3)
    M, C, K = matrices(mass, stiffness, dashpots)
    if kind == "rayleigh":
        C = 0.4 * M + 1e-3 * K
        return Damped(DampedModel(M, C, K, np.ones(3)), None, np.array([0.4, 1e-3])), stiffness, np.zeros(3)
    if kind == "story":
        return Damped(DampedModel(M, C, K, np.ones(3)), SimpleNamespace(values=dashpots)), stiffness, np.zeros(3)
    return Damped(DampedModel(M, C, K, np.ones(3))), stiffness, np.array([0.01, 0.02, 0.03])


def varied(kind, **more):
    damped, stiffness, ratios = centre(kind)
    directions = len(more.get("dM", [0]))
    none = {name: np.zeros((directions, 3, 3)[: 3 if name != "dgain" else 2]) for name in ("dM", "dK", "dgain")}
    frame = VariedFrame(
        damped, stiffness, ratios, np.ones(2 if kind == "rayleigh" else 3), form=np.zeros((0, 3, 3)),
        log_gain=np.zeros((directions, 4)), gains=0,
        measured=np.array([True, True, False]), dashpot=np.zeros(0), **none,
    )  # fmt: skip
    return replace(frame, **more)


@pytest.mark.parametrize("kind", ["story", "rayleigh", "modal"])
def test_factors_and_directions_change_what_they_say(kind):
    rng = np.random.default_rng(5)
    damped, stiffness, ratios = centre(kind)
    M, K = damped.model.M, damped.model.K
    dM, form = np.diag([0.3, -0.2, 0.1])[None], 50.0 * (K @ K / 1e5)[None]
    frame = varied(kind, dM=dM, dK=0.01 * K[None], dgain=np.array([[0.0, 0.1, 0.0]]), form=form)
    assert frame.sizes == (3, 2 if kind == "rayleigh" else 3, 1, 1)
    story, damping = 0.2 * rng.standard_normal(3), 0.3 * rng.standard_normal(frame.sizes[1])
    found = frame.model(np.array([*story, *damping, 0.7, 0.02]))
    np.testing.assert_allclose(found.M, M + 0.7 * dM[0])
    heavier = np.mean(np.diag(found.M) / np.diag(M))
    stories = chain(np.ones(3), 1.007 * stiffness * np.exp(story))[1]
    np.testing.assert_allclose(found.K, stories + 0.02 * heavier * form[0])
    np.testing.assert_allclose(found.gain, [1.0, 1.07, 1.0])
    if kind == "story":
        expected = heavier * chain(np.ones(3), damped_frame(3)[2] * np.exp(damping))[1]
    elif kind == "rayleigh":
        expected = 0.4 * np.exp(damping[0]) * found.M + 1e-3 * np.exp(damping[1]) * found.K
    else:
        expected = found.C
        np.testing.assert_allclose(pole_ratios(found.M, found.C, found.K), ratios * np.exp(damping))
    np.testing.assert_allclose(found.C, expected)


@pytest.mark.parametrize("kind", ["story", "rayleigh", "modal"])
def test_a_dashpot_of_one_story_couples_the_modes(kind):
    """The dashpot's matrix is added; modal damping loses the dashpot's share of the measured ratios, but not all."""
    damped, _, ratios = centre(kind)
    M, K = damped.model.M, damped.model.K
    frame = varied(kind, dashpot=np.array([20.0, 30.0, 40.0]))
    assert frame.dashpots == slice(3 + len(frame.own_std), 3 + frame.sizes[1])
    unknowns = np.zeros(sum(frame.sizes))
    without = frame.model(unknowns).C
    unknowns[frame.dashpots] = [0.0, 0.5, 0.0]
    own = chain(np.ones(3), np.array([0.0, 15.0, 0.0]))[1]
    left = frame.model(unknowns).C - own
    if kind != "modal":
        np.testing.assert_allclose(left, without)
        return
    squares, shapes = linalg.eigh(K, M)
    given = np.diag(shapes.T @ own @ shapes) / (2 * np.sqrt(squares) * ratios)
    beside = shapes.T @ left @ shapes
    np.testing.assert_allclose(beside, np.diag(np.diag(beside)), atol=1e-12)
    part = np.diag(beside) / (2 * np.sqrt(squares) * ratios)
    # f^2 = (1 - s) f + s / 100 gives 1 without a dashpot; the third ratio was not measured.
    given[2] = 0.0
    np.testing.assert_allclose(part**2, (1 - given) * part + 0.01 * given)
    assert np.all((part[:2] > 0) & (part[:2] < 1))


@pytest.mark.parametrize("kind", ["story", "modal"])
def test_a_frame_with_all_masses_and_stiffnesses_larger_moves_alike(kind):
    """Base motion cannot distinguish a scaled frame from the original, for any factors and form errors."""
    M, K = centre(kind)[0].model.M, centre(kind)[0].model.K
    frame = varied(kind, dM=0.3 * M[None], dK=0.3 * K[None], form=50.0 * (K @ K / 1e5)[None])
    unknowns = np.array([0.1, -0.2, 0.1, 0.3, 0.1, -0.1, 0.0, 0.02])
    light, heavy = frame.model(unknowns), frame.model(unknowns + 0.5 * np.eye(8)[6])
    for name in ("M", "C", "K"):
        np.testing.assert_allclose(getattr(heavy, name), 1.15 * getattr(light, name))


def test_larger_motions_and_smaller_gains_look_alike():
    """A common factor on two sensors and the ground sensor: equal readings mean a larger motion of the floors."""
    log_gain = 0.01 * np.eye(4)[[0, 2, 3]]
    frame = varied("modal", dM=np.zeros((3, 3, 3)), dK=np.zeros((3, 3, 3)), dgain=np.zeros((3, 3)), log_gain=log_gain)
    usual, larger = (frame.model(np.array([0.0] * 6 + gains)) for gains in ([0.0] * 3, [-5.0, -5.0, 5.0]))
    np.testing.assert_allclose(larger.gain[[0, 2]] * larger.input_gain, usual.gain[[0, 2]])
    assert larger.input_gain == pytest.approx(np.exp(0.05))
    setting = Setting(np.array([1, 3]), 0.01, 0, True, 10.0, 50.0, np.array([3.0, 2.0, 1.0]), usual.M)
    noise = Noise(np.array([0.01, 0.02]), 0.05, 0.0)
    a, b = (dynamics(model, noise, setting) for model in (usual, larger))
    excitation = np.random.default_rng(2).standard_normal((200, 2))
    moves = [recursion(each.A, np.eye(9), each.driven(excitation), np.zeros(9)) for each in (a, b)]
    np.testing.assert_allclose(moves[1], np.exp(0.05) * moves[0], atol=1e-12)
    np.testing.assert_allclose(moves[1] @ b.H.T, moves[0] @ a.H.T, atol=1e-9)
    # The covariance of the innovations, with the missed forces, is the same.
    np.testing.assert_allclose(Filter.settled(b).S, Filter.settled(a).S, rtol=1e-6)


def test_a_heavier_floor_leaves_the_stories_as_they_are():
    M, K = centre("modal")[0].model.M, centre("modal")[0].model.K
    dM = np.array([np.diag(row) for row in ([0.1, 0.0, 0.0], [0.0, 0.2, 0.1], [0.1, 0.1, 0.3])]) * M
    dK = np.array([0.1, 0.15, 0.2])[:, None, None] * K
    frame = varied("modal", dM=dM, dK=dK, dgain=np.zeros((3, 3)))
    found = frame.model(0.01 * frame.heavier_floors[:, 1])
    np.testing.assert_allclose(found.M, M * np.array([1.0, 1.01, 1.0]))
    np.testing.assert_allclose(found.K, K, rtol=1e-3)


def test_errors_of_the_form_couple_the_modes_they_name():
    """Mass-normalized modes have the errors e_ij omega_i omega_j; modes beyond the measured ones have larger errors."""
    mass, stiffness, dashpots = damped_frame(8)
    M, C, K = matrices(mass, stiffness, dashpots)
    form = varied_frame._form(DampedModel(M, C, K, np.ones(8)), 6)
    squares, shapes = linalg.eigh(K, M)
    between = shapes.T @ form @ shapes / np.sqrt(np.outer(squares, squares))
    expected = []
    for i, j in [*((mode, mode) for mode in range(8)), *itertools.combinations(range(6), 2)]:
        entry = np.zeros((8, 8))
        entry[i, j] = entry[j, i] = max(1, i + 2 - 6)
        expected.append(entry)
    np.testing.assert_allclose(np.abs(between), expected, atol=1e-9)


def test_the_share_of_a_direction_is_what_it_changes_of_masses_and_of_eigenvalues():
    M, K = centre("modal")[0].model.M, centre("modal")[0].model.K
    dM, dK = np.array([0.03 * M, 0.0 * M]), np.array([0.04 * K, 1e-9 * K])
    frame = varied("modal", dM=dM, dK=dK, dgain=np.zeros((2, 3)))
    np.testing.assert_allclose(frame.nuisance_share, [0.05, 1e-4])


def test_the_first_samples_are_those_of_a_period():
    frame = varied("modal")
    M, K = frame.centre.model.M, frame.centre.model.K
    period = 2 * np.pi / np.sqrt(linalg.eigvalsh(K, M)[0])
    assert frame.first_samples(period / 40.2) == 40
    assert frame.first_samples(2 * period) == 2


@pytest.mark.parametrize("noise", ["additive", "multiplicative"])
@pytest.mark.parametrize("said", [True, False])
def test_modes_are_told_from_their_frequencies_and_from_shapes_at_their_best_scale(noise, said):
    mass, stiffness, _ = damped_frame(4)
    M, K = chain(mass, stiffness)
    squares, shapes = linalg.eigh(K, M)
    gain = np.array([1.0, 1.1, 1.0, 0.9])
    rng = np.random.default_rng(2)
    configuration = declared(mass, stiffness, [0.01] * 4, rng=rng)["configuration"][0]
    seen = np.array(configuration["mode_shapes"])
    seen[1, :] = np.nan
    seen[2, [0, 3]] = np.nan
    test = SimpleNamespace(
        frequencies=np.array(configuration["frequencies"]), modes=np.arange(1, 5), measured_floors=np.arange(1, 5),
        mode_shapes=seen, mode_shape_noise=noise,
        frequency_std=0.003 if said else None, mode_shape_std=np.array([0.01, 0.02, 0.03, 0.04]) if said else None,
    )  # fmt: skip
    found = module._standardized(test, DampedModel(M - np.eye(4), 0 * K, K, gain), np.ones(4))
    expected = list(np.log(2 * np.pi * test.frequencies / np.sqrt(squares)) / (0.003 if said else 0.005))
    for mode in (0, 2, 3):
        there = np.isfinite(seen[mode])
        row = seen[mode, there]
        std = (test.mode_shape_std[mode] if said else 0.02) * (
            np.abs(row) if noise == "multiplicative" else np.abs(row).max()
        )
        entry = (shapes[:, mode] * gain)[there] / std
        scale = np.linalg.lstsq(entry[:, None], row / std, rcond=None)[0]
        expected += list(row / std - scale * entry)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.fixture(scope="module")
def uncertain():
    mass, stiffness, dashpots = damped_frame(3)
    M, C, K = matrices(mass, stiffness, dashpots)
    table = declared(mass, stiffness, pole_ratios(M, C, K), rng=np.random.default_rng(1))
    solver = backends.get("auto")
    experiment = cvxshear.Experiment.from_dict(table)
    return UncertainFrame.of(Fitted.of(efficient(experiment, solver)), experiment.configurations[0], None, solver)


def test_what_the_modes_say_is_linear_in_small_changes(uncertain):
    """For each unknown, an eigenvalue problem gives the change of frequencies and shapes."""
    frame = VariedFrame.around(uncertain)
    rows = ModalRows.around(uncertain, frame)
    N, D, W, X = frame.sizes
    assert (N, W > 0, X) == (3, True, 6)
    assert rows.J.shape == (len(rows.data), N + W + X)
    # The residuals of the fit have the size of the declared errors.
    assert 0.01 < float(np.mean(rows.data**2)) < 3.0
    measured = uncertain.configuration
    for place, step in ((0, 1e-4), (2, 1e-4), (N, 1e-2), (N + W, 1e-4), (N + W + X - 1, 1e-4)):
        z = np.zeros(N + W + X)
        z[place] = step
        model = frame.model(np.concatenate([z[:N], np.zeros(D), z[N:]]))
        frequencies = np.sqrt(linalg.eigvalsh(model.K, model.M)) / (2 * np.pi)
        left = np.log(measured.frequencies / frequencies) / 0.002
        np.testing.assert_allclose(rows.data[:3] - rows.J[:3, place] * step, left, atol=2e-3)


def test_the_prior_has_what_the_file_expects_of_a_story(uncertain):
    frame = VariedFrame.around(uncertain)
    found = FramePrior.around(uncertain, frame, 4)
    usual = cvxshear.effects.named(["story_change"])[0]
    assert found.change_std == pytest.approx(float(usual.sizes(None)[0]))
    assert (1.0 - found.probability) ** 3 == pytest.approx(1.0 - usual.probability)
    # The frame has modal damping with declared ratios of 10 % deviation.
    np.testing.assert_allclose(found.varied.own_std, np.full(3, 0.1))
    assert (found.varied, found.others) == (frame, 4)
    # The masses are known. The stiffnesses have at least the deviations of the fit.
    assert np.all(np.sqrt(np.diag(found.identified)) < 0.05)


def test_a_file_may_expect_something_else_of_every_story(uncertain):
    said = {"name": "story_change", "size": 0.3, "probability": 0.2}
    experiment = replace(
        uncertain.fitted.experiment,
        expected=(ExpectedEffect("story_change", size=0.9, probability=0.1, story=2), ExpectedEffect(**said)),
    )
    frame = replace(uncertain, fitted=replace(uncertain.fitted, experiment=experiment))
    found = FramePrior.around(frame, VariedFrame.around(frame), 4)
    assert found.change_std == 0.3
    assert (1.0 - found.probability) ** 3 == pytest.approx(0.8)
