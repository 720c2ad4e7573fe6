"""Test what the loop reports beside its verdict: its basis, the candidates, the sets and the state of the next test."""

import re

import numpy as np
import pytest
from scipy import stats

from cvxshear import close_loop, identify
from cvxshear.effects import named
from cvxshear.priors import Bounds, Ratio
from tests.frames import configuration, experiment

MASS, STIFFNESS = [10.0, 8.0, 6.0], [2e4, 1.5e4, 1e4]
STDS = {"frequency": "frequency_std", "mode shape": "mode_shape_std"}


def measured(*added, seed=1, undeclared=(), frame=None, **keys):
    """Return a file with tests of a three-story frame, each with this added mass on the top floor."""
    rng = np.random.default_rng(seed)
    tests = []
    for mass in added or (0.0,):
        test = configuration(
            MASS, STIFFNESS, [0.0, 0.0, mass], rng=rng, shape_noise=0.01, frequency_noise=0.001, **keys
        )
        tests.append({key: value for key, value in test.items() if key not in undeclared})
    return experiment(MASS, STIFFNESS, *tests, frame=frame)


@pytest.fixture(scope="module")
def wrong_sensor():
    """Return the result for a sensor at floor 2 that reads a fifth too much."""
    file = measured(0.0, 2.0)
    for test in file["configuration"]:
        test["mode_shapes"] = (np.array(test["mode_shapes"]) * [1.0, 1.2, 1.0]).tolist()
    return close_loop(file, effects=["sensor_gain", "ground_spring", "added_mass"])


@pytest.mark.parametrize("undeclared", [(), ("mode shape",), ("frequency", "mode shape")])
def test_the_verdict_rests_on_the_noise_that_was_stated_or_estimated(undeclared):
    said = close_loop(measured(0.0, 2.0, undeclared=[STDS[kind] for kind in undeclared]), effects=[]).rests_on[0]
    stated, estimated = len(undeclared) < 2, bool(undeclared)
    assert said.startswith("stated" if stated and estimated else "the stated" if stated else "estimated noise")
    plurals = {"frequency": "frequencies", "mode shape": "mode shapes"}
    named = [kind for kind, plural in plurals.items() if re.search(rf"\b{plural} [\d.]+ %", said)]
    assert sorted(named) == sorted(undeclared)


def test_declared_inequalities_are_assumptions_of_the_verdict():
    priors = [Bounds("story_stiffness", upper=5e4), Ratio("floor_mass", of=1, to=2, value=1.25)]
    said = [each for each in close_loop(measured(), effects=[], priors=priors).rests_on if "as declared" in each]
    assert len(said) == 1
    assert "5" in said[0]


def test_stiffnesses_are_averaged_without_gravity_that_the_data_do_not_tell():
    """In one test, gravity equals a change of every stiffness (P / h); its prior probability is one half."""
    tall = measured(frame={"total_mass": 24.0, "story_heights": 0.5})
    result = close_loop(tall, effects=["gravity"])
    (gravity,) = result.candidates
    assert gravity.probability == pytest.approx(0.5, abs=0.2)
    np.testing.assert_allclose(result.averaged.story_stiffness, result.frame.story_stiffness, rtol=1e-3)
    np.testing.assert_allclose(result.averaged.story_stiffness_std, result.frame.story_stiffness_std, rtol=0.1)
    assert any("gravity" in each for each in result.information)


@pytest.mark.parametrize(
    ("frame", "added", "keys", "word"),
    [
        (None, (0.0, 2.0), {}, None),
        ({}, (0.0, 2.0), {}, "added mass"),
        ({"total_mass": 24.0, "total_mass_std": 0.1}, (0.0, 2.0), {}, "added mass"),
        ({}, (0.0,), {"mass_normalized": True}, "forces and motions"),
    ],
)
def test_what_all_masses_scale_with_is_an_assumption_unless_their_total_is_exact(frame, added, keys, word):
    file = measured(*added, frame=frame, **keys)
    said = [each for each in close_loop(file, effects=[]).rests_on if "added mass" in each or "forces and" in each]
    assert [word in each for each in said] == ([] if word is None else [True])


def test_a_candidate_of_the_verdict_has_its_gain_and_others_that_of_the_linearised_model(wrong_sensor):
    result = wrong_sensor
    (found,) = result.effects
    assert (found.placed.effect.name, found.placed.place.floor) == ("sensor_gain", 2)
    first, *others = result.candidates
    assert first.placed == found.placed
    assert (first.chi2, first.dof) == (pytest.approx(result.after.quality.chi2), result.after.quality.dof)
    gain = result.before.quality.chi2 - result.after.quality.chi2
    assert first.p_value == pytest.approx(min(1.0, len(result.candidates) * stats.chi2.sf(gain, 1)), abs=1e-12)
    assert first.probability == pytest.approx(found.probability)
    for each in others:
        assert each.chi2 <= first.chi2 + 1e-9
        assert each.dof == first.dof - 1
        assert each.probability <= max(each.prior, 0.05)
    assert [each.probability for each in others] == sorted((each.probability for each in others), reverse=True)


def test_sets_are_listed_once_from_a_thousandth_on(wrong_sensor):
    models = wrong_sensor.models
    chances = [each.probability for each in models]
    assert chances == sorted(chances, reverse=True)
    assert min(chances) >= 1e-3
    assert 0.99 < sum(chances) <= 1.0 + 1e-9
    assert len({frozenset(each.effects) for each in models}) == len(models)


@pytest.mark.parametrize("reference", [False, True])
def test_the_next_test_is_of_a_state_that_still_stands(reference):
    """Without declared states the first test can be repeated; of declared states only the last one."""
    frame = {"total_mass": 24.0} | ({"reference": "before"} if reference else {})
    file = measured(0.0, 0.0, frame=frame, measured_floors=[1, 3])
    for test, state in zip(file["configuration"], ("before", "after"), strict=True):
        test.update({"state": state} if reference else {})
    file["configuration"][1]["frequencies"][0] *= 0.98
    result = close_loop(file)
    assert result.verdict == "ambiguous"
    assert result.next_test is None or result.next_test.state in (["after"] if reference else ["test 1", "test 2"])


def test_the_probability_of_an_effect_is_shared_by_its_places_as_the_file_expects_it():
    """All three floors together have 2 %. A floor declared with 30 % has 30 %; excluded floors get no share."""
    (gain,) = named(["sensor_gain"])

    def priors(*expected):
        result = close_loop(measured() | {"effect": list(expected)}, effects=["sensor_gain"])
        return {each.placed.place.floor: each.prior for each in result.candidates}

    plain = priors()
    assert 1 - np.prod([1 - each for each in plain.values()]) == pytest.approx(gain.probability)
    said = priors({"name": "sensor_gain", "floor": 2, "probability": 0.3, "size": 0.2},
                  {"name": "sensor_gain", "floor": 3, "exclude": True})  # fmt: skip
    assert sorted(said) == [1, 2]
    assert said[2] == pytest.approx(0.3)
    assert 1 - said[1] == pytest.approx((1 - gain.probability) ** (1 / 2))
    anywhere = priors({"name": "sensor_gain", "probability": 0.5})
    assert 1 - np.prod([1 - each for each in anywhere.values()]) == pytest.approx(0.5)


@pytest.mark.parametrize(("story", "parts"), [(1, "its columns or its feet"), (3, "its columns or its joints")])
def test_rivals_that_soften_one_story_are_one_finding_of_that_story(story, parts):
    """A looser end of the columns softens the lowest or highest story alone, exactly as softer columns do."""
    softer = np.array(STIFFNESS)
    softer[story - 1] *= 0.9
    rng = np.random.default_rng(1)
    tests = [
        configuration(MASS, stiffness, rng=rng, shape_noise=0.01, frequency_noise=0.001, name=name)
        for name, stiffness in (("before", STIFFNESS), ("after", softer.tolist()))
    ]
    result = close_loop(experiment(MASS, STIFFNESS, *tests, frame={"total_mass": 24.0, "reference": "before"}))
    assert str(result).startswith(f"AMBIGUOUS: story {story} lost ")
    assert f"; but whether {parts}, these data do not tell; " in " ".join(str(result).split())
    (effect,) = result.effects
    assert effect.story.probability == pytest.approx(
        effect.probability + sum(rival.probability for rival in effect.rivals if rival.placed in effect.story.parts)
    )
    assert effect.story.probability > 0.9 > effect.probability


def test_other_frames_that_fit_are_listed_with_the_test_that_tells_them():
    """Three frequencies of equal floors fit two frames (tests/fit/test_other_frames.py)."""
    bench = {"frame": {"floor_masses": [5.36] * 3}, "configuration": [{"frequencies": [7.203, 20.961, 30.435]}]}
    result, found = close_loop(bench), identify(bench)
    ((loop,), (alone,)) = result.other_frames, found.other_frames
    np.testing.assert_allclose(loop.story_stiffness, alone.story_stiffness, rtol=1e-3)
    assert loop.probability == pytest.approx(alone.probability, rel=0.1)
    assert result.to_dict()["other_frames"] == [loop.to_dict()]
    assert result.next_test.added_mass > 0
    assert result.next_test.standard_deviations > 10
    assert "that the frame is this one of the 2 that fit" in result.rests_on
    assert "155.3, 31.7" in str(result)
