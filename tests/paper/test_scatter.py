"""Test the noise study: its statistics by hand, its samples, and the efficiency of the efficient method."""

import json

import numpy as np
import pytest

from cvxshear import InputError, UnsuitableError, identify
from cvxshear.paper import noise_study, paper_setups, six_story_study
from cvxshear.paper.scatter import CLOSED_FORMS, Scatter, two_stage_batch
from cvxshear.paper.setups import Setup, six_story, three_story
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
