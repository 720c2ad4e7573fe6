"""Test noise studies: samples, statistics by hand, the Cramer-Rao bound by differences, and efficiency."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from cvxshear import InputError, UnsuitableError, identify
from cvxshear.paper import noise_study, paper_setups, six_story_study
from cvxshear.paper.scatter import CLOSED_FORMS, Scatter, two_stage_batch
from cvxshear.paper.setups import Setup, bound, six_story, three_story
from cvxshear.report.studied import in_percent
from cvxshear.report.terminal import text

ALLOWED = 1.10
"""Largest ratio of root-mean-square error to Cramer-Rao bound for the efficient method."""

COVERED = (0.93, 0.97)
"""Allowed range of the share of 95 % intervals that contain the truth."""


def ratio_error(samples):
    """Return the standard deviation of error / bound by chance, for a root mean square of normal errors."""
    return 1 / np.sqrt(2 * samples)


def coverage_error(samples):
    return np.sqrt(0.95 * 0.05 / samples)


def check_efficient(scatter):
    samples = len(scatter.estimates)
    assert scatter.answered.all()
    assert np.max(scatter.ratio) <= ALLOWED + 3 * ratio_error(samples)
    # A ratio below one would mean a wrong bound.
    assert np.min(scatter.ratio) >= 1 - 4 * ratio_error(samples)
    assert np.min(scatter.coverage) >= COVERED[0] - 3 * coverage_error(samples)
    assert np.max(scatter.coverage) <= COVERED[1] + 3 * coverage_error(samples)
    # The bias is at most chance plus a tenth of the scatter.
    assert np.all(np.abs(scatter.bias) < 3 * scatter.bias_error + 0.1 * scatter.relative_bound)


@pytest.mark.parametrize(("sigma", "samples"), [(0.01, 40), (0.05, 60)])
def test_the_efficient_method_reaches_the_bound_on_the_papers_frame(sigma, samples):
    check_efficient(noise_study(paper_setups([sigma]), ("efficient",), samples, seed=11).scatters[0])


def test_the_efficient_method_reaches_the_bound_on_incomplete_data():
    check_efficient(six_story_study(60, seed=12).scatters[0])


def test_the_two_stage_method_is_two_to_seven_times_above_the_bound():
    scatter = noise_study(paper_setups([0.05]), ("two-stage",), 2000, seed=13).scatters[0]
    assert 1.8 < np.min(scatter.ratio) < 2.1
    assert 7.0 < np.max(scatter.ratio) < 8.0
    assert scatter.coverage is None


def by_hand():
    setup = Setup(np.array([2.0]), np.array([100.0]), 0.01)
    estimates = np.array([[2.0, 90.0], [2.0, 104.0], [2.0, 112.0], [np.nan, np.nan]])
    std = np.array([[0.1, 5.0], [0.1, 5.0], [0.1, 7.0], [np.nan, np.nan]])
    return Scatter(setup, "efficient", estimates, std, np.array([0.0, 4.0]), 0.5)


def test_the_statistics_by_hand():
    scatter = by_hand()
    assert scatter.mean[1] == pytest.approx(102.0)
    assert scatter.bias[1] == pytest.approx(0.02)
    # Deviations -12, 2, 10 from the mean: 248 / 2 is the variance.
    assert scatter.variation[1] == pytest.approx(np.sqrt(124) / 102)
    assert scatter.bias_error[1] == pytest.approx(np.sqrt(124 / 3) / 100)
    # Errors -10, 4, 12.
    assert scatter.rmse[1] == pytest.approx(np.sqrt(260 / 3) / 100)
    assert scatter.ratio[1] == pytest.approx(np.sqrt(260 / 3) / 4)
    # 10 > 9.8, 4 < 9.8, 12 < 13.7.
    assert scatter.coverage[1] == pytest.approx(2 / 3)
    # One story has no ratio: its mass is the total. A sample without an answer is counted and left out.
    assert np.isnan(scatter.ratio[0])
    assert (scatter.to_dict()["ratio"][0], scatter.to_dict()["failures"]) == (None, 1)
    assert (scatter.samples, scatter.failures) == (4, 1)


def test_all_methods_see_the_same_samples_and_a_seed_repeats_them():
    study = noise_study(paper_setups([0.02]), ("two-stage", "one-shot"), 20, seed=4)
    again = noise_study(paper_setups([0.02]), ("one-shot",), 20, seed=4)
    other = noise_study(paper_setups([0.02]), ("one-shot",), 20, seed=5)
    np.testing.assert_array_equal(study.of("one-shot").estimates, again.scatters[0].estimates)
    assert not np.allclose(again.scatters[0].estimates, other.scatters[0].estimates, rtol=1e-6)


@pytest.mark.parametrize("backend", ["clarabel", "osqp"])
def test_the_backend_does_not_change_the_answer(backend):
    setups = paper_setups([0.03])
    closed_form, iterative = (
        noise_study(setups, ("efficient",), 5, seed=6, backend=name).scatters[0] for name in ("kkt", backend)
    )
    np.testing.assert_allclose(iterative.estimates, closed_form.estimates, rtol=1e-6)


def test_progress_counts_every_identification():
    seen = []
    noise_study(
        paper_setups([0.01, 0.02]), ("one-shot", "efficient"), 3, seed=7, progress=lambda *each: seen.append(each)
    )
    assert seen == sorted(seen)
    assert seen[-1] == (12, 12)


def test_two_processes_give_the_same_figures():
    alone, together = (noise_study(paper_setups([0.03]), ("efficient",), 6, seed=9, jobs=jobs) for jobs in (1, 2))
    np.testing.assert_array_equal(alone.scatters[0].estimates, together.scatters[0].estimates)
    np.testing.assert_array_equal(alone.scatters[0].stated_std, together.scatters[0].stated_std)
    assert np.all(np.isfinite(alone.scatters[0].stated_std))


def test_a_method_that_cannot_use_the_data_says_so():
    with pytest.raises(UnsuitableError, match=r"two-stage cannot use .* it needs all 6 modes"):
        noise_study([six_story()], ("two-stage",), 5)


@pytest.mark.parametrize(
    ("change", "message"), [({"samples": 1}, "samples"), ({"seed": -1}, "seed"), ({"methods": ("best",)}, "method")]
)
def test_a_study_that_is_none_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        noise_study(paper_setups(), **change)


def test_what_the_study_has_not_is_refused():
    study = noise_study(paper_setups([0.01]), ("one-shot",), 3)
    assert study.of("one-shot", 0.01) is study.scatters[0]
    with pytest.raises(InputError, match=r"no method 'one-shot' at mode_shape_std 0\.02"):
        study.of("one-shot", 0.02)


def test_json_and_terminal_have_the_figures():
    study = noise_study([three_story(0.05)], ("two-stage", "efficient"), 4, seed=8)
    assert json.loads(json.dumps(study.to_dict()))["scatters"][0]["method"] == "two-stage"
    shown = text(study, width=150)
    assert all(f"{value:.2f}" in shown for value in 100 * study.scatters[0].relative_bound)
    assert "shape noise 5 %, frequencies exact" in shown
    assert "truth in the 95 % interval" in shown


FIVE_STORY = Setup(
    floor_mass=np.array([2000.0, 1900.0, 1800.0, 1500.0, 1100.0]),
    story_stiffness=np.array([3.1e6, 2.9e6, 2.6e6, 2.0e6, 1.4e6]),
    mode_shape_std=0.01,
)


@pytest.mark.parametrize("method", CLOSED_FORMS)
@pytest.mark.parametrize(
    "setup", [three_story(0.01), three_story(0.05), FIVE_STORY], ids=["1 %", "5 %", "five stories"]
)
def test_a_batch_is_identify_sample_by_sample(method, setup):
    frequencies, shapes = setup.draw(np.random.default_rng(1), 15)
    batch = CLOSED_FORMS[method](shapes, frequencies, float(setup.floor_mass.sum()))
    for found, *sample in zip(batch, frequencies, shapes, strict=True):
        frame = identify(setup.experiment(*sample), method).frame
        np.testing.assert_allclose(found, np.append(frame.floor_mass, frame.story_stiffness), rtol=1e-9)


def test_the_answer_does_not_depend_on_the_scale_of_the_shapes():
    frequencies, shapes = three_story(0.05).draw(np.random.default_rng(2), 5)
    scaled = shapes * np.array([1e-3, -4.0, 1e4])[:, None]
    once, again = (two_stage_batch(each, frequencies, 22.5) for each in (shapes, scaled))
    np.testing.assert_allclose(again, once, rtol=1e-9)


@pytest.mark.parametrize("method", CLOSED_FORMS)
def test_where_a_mass_would_be_negative_the_study_takes_the_bounded_answer(method):
    """At 40 % noise some samples need the bounds, which the closed forms do not have."""
    setup, samples = three_story(0.4), 40
    study = noise_study([setup], (method,), samples, seed=3)
    stream = np.random.SeedSequence(3).spawn(1)[0]
    frequencies, shapes = setup.draw(np.random.default_rng(stream), samples)
    batch = CLOSED_FORMS[method](shapes, frequencies, 22.5)
    outside = np.flatnonzero(np.isnan(batch).all(axis=1))
    assert 0 < outside.size < samples
    assert np.isfinite(np.delete(batch, outside, axis=0)).all()
    sample = outside[0]
    frame = identify(setup.experiment(frequencies[sample], shapes[sample]), method).frame
    np.testing.assert_allclose(study.scatters[0].estimates[sample, :3], frame.floor_mass, rtol=1e-9)
    assert np.all(study.scatters[0].estimates[sample] >= -1e-6)


MASS, STIFFNESS = np.array([10.0, 7.5, 5.0]), np.array([1800.0, 1200.0, 600.0])


def test_the_exact_modes_are_those_of_the_paper():
    frequencies, shapes = three_story(0.01).exact()
    np.testing.assert_allclose(frequencies, [1.0336, 2.2099, 3.2812], atol=5e-5)
    np.testing.assert_allclose(np.max(np.abs(shapes), axis=1), 1.0)
    np.testing.assert_allclose((shapes * MASS) @ shapes.T * (1 - np.eye(3)), 0.0, atol=1e-12)


def test_multiplicative_noise_goes_with_the_entry_and_the_frequencies_stay_exact():
    setup = three_story(0.04)
    exact_frequencies, exact = setup.exact()
    frequencies, shapes = setup.draw(np.random.default_rng(5), 4000)
    assert np.all(frequencies == exact_frequencies)
    # The standard deviation of 4000 samples scatters by 1.1 %.
    np.testing.assert_allclose((shapes / exact).std(axis=0), 0.04, rtol=0.05)


def test_additive_noise_goes_with_the_largest_entry():
    setup = six_story(0.02)
    exact_frequencies, exact = setup.exact()
    frequencies, shapes = setup.draw(np.random.default_rng(6), 4000)
    np.testing.assert_allclose((shapes - exact).std(axis=0), 0.02, rtol=0.05)
    np.testing.assert_allclose((frequencies / exact_frequencies).std(axis=0), 1e-3, rtol=0.05)
    assert exact.shape == (4, 5)


def test_an_experiment_declares_noise_total_floors_and_modes():
    setup = six_story()
    experiment = setup.experiment(*setup.exact())
    configuration = experiment.configurations[0]
    assert experiment.frame.total_mass == pytest.approx(52.0)
    assert configuration.modes.tolist() == [1, 2, 3, 4]
    assert configuration.measured_floors.tolist() == [1, 2, 4, 5, 6]
    assert experiment.noise_declared
    assert np.all(configuration.mode_shape_std == 0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"floor_mass": [10.0, -7.5, 5.0]}, "floor_mass"),
        ({"story_stiffness": [1800.0, 1200.0]}, "story_stiffness"),
        ({"mode_shape_std": 0.0}, "mode_shape_std"),
        ({"mode_shape_noise": "multiplied"}, "mode_shape_noise"),
        ({"modes": [1, 4]}, "modes"),
        ({"measured_floors": [2, 1]}, "measured_floors"),
    ],
)
def test_a_setup_that_is_none_is_refused(change, message):
    given = {"floor_mass": MASS, "story_stiffness": STIFFNESS, "mode_shape_std": 0.01, **change}
    with pytest.raises(InputError, match=message):
        Setup(**given)


STEP = 1e-5
"""Relative step of the central differences; their error is of order step^2."""


def modal_data(setup, theta):
    """Return logarithms of the measured frequencies, shape (m,), and shapes of unit modal mass, shape (m, n)."""
    n = setup.stories
    root = np.sqrt(theta[:n])
    drift = np.eye(n) - np.eye(n, k=-1)
    eigenvalues, vectors = np.linalg.eigh((drift.T * theta[n:]) @ drift / np.outer(root, root))
    shapes = vectors / root[:, None]
    # The largest entry of a mode has one sign over a step of the differences.
    shapes = shapes * np.sign(shapes[np.argmax(np.abs(shapes), axis=0), np.arange(n)])
    which = setup.modes - 1
    return 0.5 * np.log(eigenvalues[which]), shapes[np.ix_(setup.measured_floors - 1, which)].T


def by_differences(setup):
    """Return the smallest standard deviations of an unbiased estimator, shape (2N,)."""

    def stacked(theta):
        frequencies, shapes = modal_data(setup, theta)
        return np.concatenate([frequencies, shapes.ravel()])

    truth = setup.truth
    frequencies, shapes = modal_data(setup, truth)
    spread = np.abs(shapes)
    if setup.mode_shape_noise == "additive":
        spread = np.max(spread, axis=1, keepdims=True)
    std = np.concatenate([
        np.full(len(frequencies), setup.frequency_std),
        np.broadcast_to(setup.mode_shape_std * spread, shapes.shape).ravel(),
    ])  # fmt: skip
    slopes = [(stacked(truth + STEP * row) - stacked(truth - STEP * row)) / (2 * STEP) for row in np.diag(truth)]
    scales = linalg.block_diag(*shapes.reshape(len(shapes), -1, 1))
    J = np.hstack([np.array(slopes).T, np.vstack([np.zeros((len(frequencies), len(shapes))), scales])])
    total = np.concatenate([setup.floor_mass, np.zeros(J.shape[1] - setup.stories)])
    Z = linalg.null_space(total[None])
    root = np.linalg.inv(np.linalg.qr((J / std[:, None]) @ Z, mode="r"))
    return truth * np.linalg.norm((Z @ root)[: len(truth)], axis=1)


@pytest.mark.parametrize("setup", [three_story(0.03), six_story()], ids=["three stories", "six stories"])
def test_it_is_that_of_difference_quotients_with_the_scales_as_parameters(setup):
    np.testing.assert_allclose(bound(setup), by_differences(setup), rtol=1e-7)


def test_the_papers_frame_at_five_percent():
    setup = three_story(0.05)
    percent = 100 * bound(setup) / setup.truth
    np.testing.assert_allclose(percent, [1.29, 2.72, 1.79, 2.20, 1.39, 0.79], atol=0.005)


def test_one_story_by_hand():
    """The total is the mass, so k = m (2 pi f)^2 has twice the frequency's relative standard deviation."""
    setup = Setup(np.array([3.0]), np.array([500.0]), 0.01, frequency_std=2e-3, exact_frequencies=False)
    np.testing.assert_allclose(bound(setup), [0.0, 500.0 * 2 * 2e-3], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("setup", [three_story(0.03), six_story()], ids=["three stories", "six stories"])
def test_at_exact_data_the_efficient_method_states_the_bound(setup):
    frame = identify(setup.experiment(*setup.exact())).frame
    stated = np.concatenate([frame.floor_mass_std, frame.story_stiffness_std])
    np.testing.assert_allclose(by_differences(setup), stated, rtol=1e-4)


DOCUMENTED = (Path(__file__).parents[2] / "docs" / "noise-study.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "setup", [*paper_setups(), six_story()], ids=lambda each: f"{each.stories}-{each.mode_shape_std}"
)
def test_the_bounds(setup):
    assert f"Cramér-Rao bound, % | {' | '.join(in_percent(bound(setup) / setup.truth))} |" in DOCUMENTED


@pytest.mark.parametrize("floor", range(1, 7))
def test_the_bound_by_the_floor_without_a_sensor(floor):
    setup = replace(six_story(), measured_floors=np.delete(np.arange(1, 7), floor - 1))
    largest = np.max(bound(setup) / setup.truth)
    assert re.search(rf"^\| {floor} \| {100 * largest:.1f} \|", DOCUMENTED, re.MULTILINE)


def test_the_measured_efficiency_and_coverage():
    """Read six tables. In each, the efficient method's lines follow its name."""
    efficient = [part.split("\n\n")[0] for part in DOCUMENTED.split("| efficient | bias, %")[1:]]
    assert len(efficient) == 6
    for table in efficient:
        ratios, held = (
            np.array(line.split("|")[3:-1], dtype=float)
            for line in table.splitlines()
            if line.startswith(("|  | error / bound", "|  | truth in the 95 %"))
        )
        assert np.max(ratios) <= 1.10
        assert np.all((held >= 93) & (held <= 97))
