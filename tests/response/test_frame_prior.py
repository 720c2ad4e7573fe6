"""Test a frame in a record, its prior and the evidence of changes, against explicit normal distributions."""

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
from cvxshear.response import DampedModel, Fitted, frame_prior
from cvxshear.response.innovations import Filter
from cvxshear.response.state_space import Noise, Setting, dynamics, recursion
from cvxshear.response.uncertain import Damped, UncertainFrame
from cvxshear.response.varied_frame import VariedFrame
from tests.frames import chain
from tests.response.common import damped_frame, damped_measurement, driven, matrices, pole_ratios

CHANGES = (
    frame_prior.FrameChange("story", 0.5 * np.eye(5)[:, :1], -2.5),
    frame_prior.FrameChange("story", 0.5 * np.eye(5)[:, 1:2], -2.5),
    frame_prior.FrameChange("gain", 0.8 * np.eye(5)[:, 4:], -3.0),
    frame_prior.FrameChange("masses", np.random.default_rng(1).standard_normal((5, 2)), -2.0),
)
"""Possible changes of a frame with five unknowns."""


def drawn(seed, inflation=1.7):
    """Draw a likelihood of five unknowns and its linearization point."""
    rng = np.random.default_rng(seed)
    U, c = 3.0 * rng.standard_normal((6, 5)), rng.standard_normal(6)
    return frame_prior.Likelihood(U, c, inflation), rng.standard_normal(5)


def gaussian(changed, form_std):
    """Return a prior whose mean, covariance and evidence depend on the deviation of the form."""
    spread = np.diag([0.1, 0.2, 0.1, 0.5, 0.5]) ** 2 + 0.3 * form_std + form_std**2 * np.eye(5)
    spread += sum(CHANGES[each].columns @ CHANGES[each].columns.T for each in changed)
    return frame_prior.Gaussian(np.array([0.1, -0.1, 0.0, 0.2, form_std]), spread, -30.0 * form_std)


def log_density(at, p, prior):
    """Return the log density of the normal data U x + c about zero, with variance `inflation`, at the true x."""
    seen = at.U @ (p - prior.mean) - at.c
    spread = at.U @ prior.covariance @ at.U.T + at.inflation * np.eye(len(seen))
    return stats.multivariate_normal.logpdf(seen, np.zeros(len(seen)), spread)


@pytest.mark.parametrize("seed", range(3))
def test_evidence_and_posterior_are_those_of_a_normal_distribution(seed):
    (at, p), prior = drawn(seed), gaussian((), 0.03)
    linear = frame_prior.Linear(at, p, prior)
    sets = [(), (0, 2), (1, 3)]
    alone, *freed = linear.evidences(CHANGES, sets)
    for found, chosen in zip(freed, sets[1:], strict=True):
        expected = log_density(at, p, gaussian(chosen, 0.03)) - log_density(at, p, prior)
        assert found - alone == pytest.approx(expected)
    other = gaussian((), 0.1)
    (found,) = frame_prior.Linear(at, p, other).evidences(CHANGES, [()])
    assert found - alone == pytest.approx(log_density(at, p, other) - log_density(at, p, prior) - 30.0 * (0.1 - 0.03))
    mean, covariance = linear.posterior()
    expected = np.linalg.inv(np.linalg.inv(prior.covariance) + at.U.T @ at.U / at.inflation)
    np.testing.assert_allclose(covariance, expected, atol=1e-10)
    seen = at.U @ (p - prior.mean) - at.c
    np.testing.assert_allclose(mean, prior.mean + expected @ at.U.T @ seen / at.inflation, atol=1e-9)


def test_a_dashpot_has_no_evidence_where_it_would_be_negative():
    """Two directly measured unknowns, one of each sign."""
    at, prior = frame_prior.Likelihood(np.eye(2), np.array([-2.0, 2.0]), 1.0), (np.zeros(2), 0.01 * np.eye(2), 0.0)
    linear = frame_prior.Linear(at, np.zeros(2), frame_prior.Gaussian(*prior))
    sets = [(), (0,), (1,), (0, 1)]
    either, positive = (
        linear.evidences([frame_prior.FrameChange(kind, np.eye(2)[:, [place]], 0.0) for place in range(2)], sets)
        for kind in ("story", "dashpot")
    )
    assert np.isfinite(positive).tolist() == [True, True, False, False]
    assert positive[:2] == either[:2]


@pytest.mark.parametrize("seed", range(3))
def test_answers_have_the_probabilities_of_all_sets_of_changes_and_of_all_widths(seed):
    """All error widths are equally probable."""
    at, p = drawn(seed)
    found = frame_prior.possible_answers(at, SimpleNamespace(changes=CHANGES, gaussian=gaussian), p)
    logs = {
        (changed, width): log_density(at, p, gaussian(changed, width)) - 30.0 * width
        + sum(CHANGES[each].log_odds for each in changed)
        for size in range(5)
        for changed in itertools.combinations(range(len(CHANGES)), size)
        for width in frame_prior.FORM_STDS
    }  # fmt: skip
    best = max(logs.values())
    kept = {key: np.exp(value - best) for key, value in logs.items() if value > best + np.log(frame_prior.LEAST_WEIGHT)}
    total = sum(kept.values())
    assert len(found) == len(kept) > 4
    for each in found:
        assert each.probability == pytest.approx(kept[each.prior] / total)
    assert [each.probability for each in found] == sorted((each.probability for each in found), reverse=True)


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
    # A frame that is softer as a whole has a softer form, too.
    np.testing.assert_allclose(found.K, stories + 0.02 * heavier * np.exp(story.mean()) * form[0])
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


def test_errors_of_form_couple_the_six_lowest_modes_and_are_larger_beyond_the_measured_ones():
    experiment, solver = cvxshear.Experiment.from_dict(damped_measurement(8, modes=range(1, 6))), backends.get("auto")
    frame = UncertainFrame.of(Fitted.of(efficient(experiment, solver)), experiment.configurations[0], None, solver)
    modes = frame.centre.model.modes
    unit = modes.shapes / np.sqrt(modes.eigenvalues)[:, None]
    modal = unit @ VariedFrame.around(frame).form @ unit.T
    expected = np.diag([1.0] * 5 + [2.0, 3.0, 4.0])
    expected[:6, :6] += 1.0 - np.eye(6)
    np.testing.assert_allclose(modal.sum(axis=0), expected, atol=1e-9)
    assert len(modal) == 8 + 15


def test_larger_motions_and_smaller_gains_look_alike():
    """A common factor on two sensors and the ground sensor: equal readings mean a larger motion of the floors."""
    log_gain = 0.01 * np.eye(4)[[0, 2, 3]]
    frame = varied("modal", dM=np.zeros((3, 3, 3)), dK=np.zeros((3, 3, 3)), dgain=np.zeros((3, 3)), log_gain=log_gain)
    usual, larger = (frame.model(np.array([0.0] * 6 + gains)) for gains in ([0.0] * 3, [-5.0, -5.0, 5.0]))
    np.testing.assert_allclose(larger.gain[[0, 2]] * larger.input_gain, usual.gain[[0, 2]])
    assert larger.input_gain == pytest.approx(np.exp(0.05))
    setting = Setting(np.array([1, 3]), 0.01, 0, 10.0, np.array([3.0, 2.0, 1.0]), usual.M)
    noise = Noise(np.array([0.01, 0.02]), 0.05, 0.0)
    a, b = (dynamics(model, noise, setting) for model in (usual, larger))
    excitation = np.random.default_rng(2).standard_normal((200, 2))
    moves = [recursion(each.A, np.eye(9), driven(each, excitation), np.zeros(9)) for each in (a, b)]
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


@pytest.fixture(scope="module")
def uncertain():
    solver = backends.get("auto")
    experiment = cvxshear.Experiment.from_dict(damped_measurement(3, rng=np.random.default_rng(1)))
    return UncertainFrame.of(Fitted.of(efficient(experiment, solver)), experiment.configurations[0], None, solver)


def test_what_the_modes_say_is_linear_in_small_changes(uncertain):
    """For each unknown, an eigenvalue problem gives the change of frequencies and shapes."""
    frame = VariedFrame.around(uncertain)
    J, data = frame_prior.modal_rows(uncertain, frame)
    N, D, W, X = frame.sizes
    assert (N, W > 0, X) == (3, True, 6)
    assert J.shape == (len(data), N + W + X)
    # The residuals of the fit have the size of the declared errors.
    assert 0.01 < float(np.mean(data**2)) < 3.0
    measured = uncertain.configuration
    for place, step in ((0, 1e-4), (2, 1e-4), (N, 1e-2), (N + W, 1e-4), (N + W + X - 1, 1e-4)):
        z = np.zeros(N + W + X)
        z[place] = step
        model = frame.model(np.concatenate([z[:N], np.zeros(D), z[N:]]))
        frequencies = np.sqrt(linalg.eigvalsh(model.K, model.M)) / (2 * np.pi)
        left = np.log(measured.frequencies / frequencies) / 0.002
        np.testing.assert_allclose(data[:3] - J[:3, place] * step, left, atol=2e-3)


def test_the_prior_is_a_sum_of_independent_normal_numbers_given_the_modes(uncertain):
    """The unknowns are numbers w times columns; the modes measure some of them with errors of one."""
    frame = VariedFrame.around(uncertain, [1, 3])
    prior = frame_prior.FramePrior.around(uncertain, frame, 6)
    (N, D, W, X), size = frame.sizes, sum(frame.sizes)
    form_std, changed = 0.03, (1, 3, 6)
    assert [prior.changes[each].kind for each in changed] == ["story", "dashpot", "gain"]
    root = np.linalg.cholesky(prior.identified)
    # Errors of form leave masses and effects as uncertain as they change masses and modal stiffnesses.
    moved = [frame.model(0.01 * row) for row in np.eye(size)[N + D : N + D + W - 3]]
    plain, shapes = frame.model(np.zeros(size)), uncertain.centre.model.modes.shapes
    sizes = [np.concatenate([np.diag(each.M), np.diag(shapes @ each.K @ shapes.T)]) for each in (*moved, plain)]
    share = 100.0 * np.sqrt(2.0) * np.sqrt(np.mean((np.array(sizes[:-1]) / sizes[-1] - 1.0) ** 2, axis=1))
    nuisances = np.append(np.sqrt(1.0 + (form_std / share) ** 2 / len(share)), np.full(3, 0.001))
    tests = linalg.block_diag(root, np.diag([*nuisances, *np.full(X, form_std)]))
    J, data = prior.measured
    seen = J @ tests
    posterior = np.linalg.inv(np.eye(len(seen.T)) + seen.T @ seen)
    in_tests = np.zeros((size + 6, len(tests)))
    in_tests[:N, :N], in_tests[N + D : size, N:] = root, tests[N:, N:]
    # Each ratio varies by itself and with all others; the stories do so, too; each error of form varies by itself.
    own = np.zeros((size + 6, size + 6))
    own[:N, :N] = 0.15**2 + 0.003**2 * np.eye(N)
    own[N : N + N, N : N + N] = 0.5**2 + np.diag(frame.own_std**2 + 0.3**2)
    own[N + N : N + D, N + N : N + D] = 1e-6 * np.eye(N)
    own[size - X : size, size - X : size] = (0.15 * form_std) ** 2 * np.eye(X)
    own[size:, size:] = np.diag([1.0] * 4 + [1e-6] * 2)
    own[1, 1] += 0.25**2
    own[N + N, N + N] += 1.0
    own[size - X - 3, size - X - 3] += 0.05**2
    found = prior.gaussian(changed, form_std)
    np.testing.assert_allclose(found.covariance, in_tests @ posterior @ in_tests.T + own, atol=1e-9)
    np.testing.assert_allclose(found.mean, in_tests @ posterior @ seen.T @ data, atol=1e-9)
    density = stats.multivariate_normal.logpdf(data, np.zeros(len(seen)), np.eye(len(seen)) + seen @ seen.T)
    assert found.evidence == pytest.approx(density + 0.5 * len(seen) * np.log(2 * np.pi), rel=1e-9)


@pytest.mark.parametrize("said", [None, {"name": "story_change", "size": 0.3, "probability": 0.2}])
def test_the_prior_has_what_the_catalogue_or_the_file_expects_of_a_story(uncertain, said):
    usual = cvxshear.effects.named(["story_change"])[0]
    size, probability = float(usual.sizes(None)[0]), usual.probability
    if said is not None:
        size, probability = said["size"], said["probability"]
        one = ExpectedEffect("story_change", size=0.9, probability=0.1, story=2)
        experiment = replace(uncertain.fitted.experiment, expected=(one, ExpectedEffect(**said)))
        uncertain = replace(uncertain, fitted=replace(uncertain.fitted, experiment=experiment))
    found = frame_prior.FramePrior.around(uncertain, VariedFrame.around(uncertain), 4)
    stories = [each for each in found.changes if each.kind == "story"]
    assert [np.flatnonzero(each.columns).tolist() for each in stories] == [[0], [1], [2]]
    for each in stories:
        assert np.linalg.norm(each.columns) == pytest.approx(size)
        assert (1.0 - 1.0 / (1.0 + np.exp(-each.log_odds))) ** 3 == pytest.approx(1.0 - probability)
    # The masses are known. The stiffnesses have at least the deviations of the fit.
    assert np.all(np.sqrt(np.diag(found.identified)) < 0.05)
