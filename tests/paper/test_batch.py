"""Compare the batched closed forms with `identify` for each sample."""

import numpy as np
import pytest

from cvxshear import identify
from cvxshear.paper.batch import one_shot_batch, two_stage_batch
from cvxshear.paper.scatter import noise_study
from cvxshear.paper.setups import Setup, three_story

FIVE_STORY = Setup(
    floor_mass=np.array([2000.0, 1900.0, 1800.0, 1500.0, 1100.0]),
    story_stiffness=np.array([3.1e6, 2.9e6, 2.6e6, 2.0e6, 1.4e6]),
    mode_shape_std=0.01,
)
BATCHES = {"two-stage": two_stage_batch, "one-shot": one_shot_batch}


@pytest.mark.parametrize("method", BATCHES)
@pytest.mark.parametrize(
    "setup", [three_story(0.01), three_story(0.05), FIVE_STORY], ids=["1 %", "5 %", "five stories"]
)
def test_a_batch_is_identify_sample_by_sample(method, setup):
    frequencies, shapes = setup.draw(np.random.default_rng(1), 15)
    batch = BATCHES[method](shapes, frequencies, float(setup.floor_mass.sum()))
    assert batch.positive.all()
    for sample in range(15):
        part = identify(setup.experiment(frequencies[sample], shapes[sample]), method).parts[0]
        np.testing.assert_allclose(batch.floor_mass[sample], part.frame.floor_mass, rtol=1e-9)
        np.testing.assert_allclose(batch.story_stiffness[sample], part.frame.story_stiffness, rtol=1e-9)
        assert batch.iterations[sample] == part.iterations


@pytest.mark.parametrize(("start", "iterations"), [((9.5, 7.5, 5.5), 14), ((7.5, 7.5, 7.5), 16)])
def test_exact_modes_give_the_frame_in_the_papers_number_of_iterations(start, iterations):
    setup = three_story(0.01)
    frequencies, shapes = setup.exact()
    batch = two_stage_batch(shapes[None], frequencies[None], 22.5, np.array(start))
    assert batch.iterations == [iterations]
    np.testing.assert_allclose(batch.floor_mass[0], setup.floor_mass, rtol=1e-6)
    np.testing.assert_allclose(batch.story_stiffness[0], setup.story_stiffness, rtol=1e-6)


def test_the_answer_does_not_depend_on_the_scale_of_the_shapes():
    frequencies, shapes = three_story(0.05).draw(np.random.default_rng(2), 5)
    scaled = shapes * np.array([1e-3, -4.0, 1e4])[:, None]
    once, again = (two_stage_batch(each, frequencies, 22.5) for each in (shapes, scaled))
    np.testing.assert_allclose(again.floor_mass, once.floor_mass, rtol=1e-9)
    np.testing.assert_allclose(again.story_stiffness, once.story_stiffness, rtol=1e-9)


@pytest.mark.parametrize("method", BATCHES)
def test_where_a_mass_would_be_negative_the_study_takes_the_bounded_answer(method):
    """At 40 % noise some samples need the bounds, which the closed forms do not have."""
    setup, samples = three_story(0.4), 40
    study = noise_study([setup], (method,), samples, seed=3)
    stream = np.random.SeedSequence(3).spawn(1)[0]
    frequencies, shapes = setup.draw(np.random.default_rng(stream), samples)
    batch = BATCHES[method](shapes, frequencies, 22.5)
    outside = np.flatnonzero(~batch.positive)
    assert 0 < outside.size < samples
    assert np.isnan(batch.floor_mass[outside]).all()
    sample = outside[0]
    frame = identify(setup.experiment(frequencies[sample], shapes[sample]), method).frame
    np.testing.assert_allclose(study.scatters[0].estimates[sample, :3], frame.floor_mass, rtol=1e-9)
    assert np.all(study.scatters[0].estimates[sample] >= -1e-6)
