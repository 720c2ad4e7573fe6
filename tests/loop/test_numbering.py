"""Test hypotheses about mode numbers in the loop, on finite-element frames with one mode overlooked."""

import copy
import dataclasses
import functools
import json

import numpy as np
import pytest

import cvxshear
from cvxshear import Experiment, backends
from cvxshear.fit.efficient import efficient
from cvxshear.io.toml import write_measurement
from cvxshear.loop.close import search_for_effects
from cvxshear.loop.hypotheses import Numbering, named_numberings, overlooked_in_all, overlooked_in_one
from cvxshear.records import identify_modes
from cvxshear.records.diagnostics import A_MODE, left_out, overlooked_modes
from cvxshear.records.picking import PoleCandidate
from cvxshear.records.simulate import KnownFrame, shaker_record
from cvxshear.util.errors import InputError
from tests.fe.experiments import simulated


def measured_frame(effect, seed, *, stories=7, floors=(2, 3, 5, 7), modes=5, configurations=1):
    tested = {"stories": stories, "configurations": configurations, "measured_floors": list(floors), "modes": modes}
    return simulated(effect, rng=np.random.default_rng(seed), **tested)


def lose(declared, mode, where=slice(None)):
    """Remove one mode from the test without declaring this."""
    for each in declared["configuration"][where]:
        for key in ("frequencies", "mode_shapes", "frequency_std", "mode_shape_std"):
            if isinstance(each.get(key), list):
                each[key] = [row for number, row in enumerate(each[key], 1) if number != mode]
        each.pop("modes", None)
    return declared


FIVE = (("stories", 5), ("floors", (2, 3, 5)), ("modes", 4))
"""A smaller frame, which takes a third of the time of the frame with seven stories."""


@functools.cache
def closed_without(mode, effect, configurations, tests, size, seed):
    """Return the file of a frame with one mode overlooked in the first tests, the truth, and the result of the loop."""
    declared, truth = measured_frame(effect, seed, configurations=configurations, **dict(size))
    lose(declared, mode, slice(tests))
    return declared, truth, search_for_effects(Experiment.from_dict(declared))


def numbers(closure):
    return dict(closure.numberings[0].changes)


@pytest.mark.parametrize(
    ("effect", "configurations", "lost", "tests", "size", "seed", "verdicts"),
    [
        # A tank's own motion would add a mode too; with a single test, it keeps a probability of a fifth.
        (None, 1, 3, 1, (), 41, {"ambiguous"}),
        ("gravity", 2, 2, 2, FIVE, 41, {"explained"}),
        # The spring at floor 4 has 95 %, the same spring at floor 5 the rest.
        ("ground_spring", 2, 3, 1, FIVE, 42, {"explained", "ambiguous"}),
    ],
)
def test_an_overlooked_mode_is_found_and_nothing_is_put_in_its_place(
    effect, configurations, lost, tests, size, seed, verdicts
):
    declared, truth, closure = closed_without(lost, effect, configurations, tests, size, seed)
    left = tuple(mode for mode in range(1, dict(size).get("modes", 5) + 1) if mode != lost)
    assert numbers(closure) == {each["name"]: left for each in declared["configuration"][:tests]}
    assert closure.numberings[0].probability > 0.75
    assert closure.verdict in verdicts
    assert [(item.placed.effect.name, item.placed.place.floor) for item in closure.effects] == [
        (name, floor) for name, floor, *_ in truth["effects"]
    ]
    z = (closure.frame.floor_mass - truth["floor_mass"]) / closure.frame.floor_mass_std
    assert np.abs(z).max() < 4.0


def test_before_is_the_model_with_the_numbers_as_given():
    closure = closed_without(2, "gravity", 2, 2, FIVE, 41)[2]
    assert [step.action for step in closure.steps] == [
        "the shear model, the modes numbered as given",
        "with the modes numbered otherwise",
        "with gravity",
    ]
    assert [each.modes.tolist() for each in closure.before.estimate.experiment.configurations] == [[1, 2, 3]] * 2
    errors = [step.estimate.quality.max_frequency_error for step in (closure.before, closure.after)]
    assert errors[0] > 0.02
    assert errors[1] < 0.01
    said = closure.to_dict()
    assert said["numberings"][0]["changes"][0] == {"configuration": "test 1", "modes": [1, 3, 4]}
    assert said["models"][0]["numbering"] == said["numberings"][0]["changes"]
    page = " ".join(str(closure).split())
    assert 'the modes of "test 1" and "test 2" are 1, 3 and 4 of the frame' in page


@pytest.mark.parametrize("effect", [None, "joint_rotation"])
def test_right_numbers_stay(effect):
    declared, truth = measured_frame(effect, 43, configurations=2, **dict(FIVE))
    closure = search_for_effects(Experiment.from_dict(declared))
    assert not numbers(closure)
    assert closure.numberings[0].probability > 0.99
    assert [item.placed.effect.name for item in closure.effects] == [name for name, *_ in truth["effects"]]


def test_the_probability_of_other_modes_is_that_of_their_evidence_and_their_odds():
    """Two numberings differ in their numbers alone: prior odds times the ratio of their evidence.

    One floor and three frequencies carry little information: the prior odds remain, and the page names a measurement
    that decides.
    """
    declared, _ = measured_frame(None, 44, modes=3, floors=(7,))
    (configuration,) = declared["configuration"]
    sets = []
    for probability in (0.1, 0.5):
        configuration["other_modes"] = [{"modes": [1, 2, 4], "probability": probability}]
        closure = search_for_effects(Experiment.from_dict(declared), effects=["total_mass"])
        given, other = (next(p.probability for p in closure.numberings if bool(p.changes) == b) for b in (False, True))
        sets.append(other / given / (probability / (1.0 - probability)))
    assert sets[0] == pytest.approx(sets[1], rel=1e-9)
    assert 1e-3 < sets[0] < 1e3
    assert closure.verdict == "ambiguous"
    assert 0.1 < closure.numberings[1].probability < 0.5
    page = " ".join(str(closure).split())
    assert "AMBIGUOUS: " in page
    assert "Sensors at more floors: the changes of sign" in page
    assert 'the modes of "test 1" are 1, 2 and 4 of the frame' in page


def test_the_loop_weighs_what_a_file_names_and_check_refuses(tmp_path, run):
    declared, _ = measured_frame(None, 41, **dict(FIVE))
    (configuration,) = lose(declared, 3)["configuration"]
    path = tmp_path / "a.toml"
    write_measurement(path, declared)
    status, _, told = run("loop", path, "--json", "-")
    assert status == 2
    assert "write modes = [1, 2, 4]" in told
    configuration["other_modes"] = [{"modes": [1, 2, 4], "probability": 0.3}]
    write_measurement(path, declared)
    _, out, _ = run("loop", path, "--effects", "attached_mass,ground_spring,sensor_gain", "--json", "-")
    result = json.loads(out)
    assert result["numberings"][0]["changes"] == [{"configuration": "test 1", "modes": [1, 2, 4]}]
    assert [(item["name"], item["refuses"]) for item in result["warnings"]] == [("missing_mode", False)]


def test_shapes_at_every_floor_that_contradict_their_numbers_put_them_in_question():
    declared, _ = measured_frame(None, 46, stories=5, floors=range(1, 6), modes=4)
    (found,) = overlooked_in_all(Experiment.from_dict(lose(declared, 3)))[1:2]
    assert found.changes == (("test 1", (1, 2, 4)),)
    closure = search_for_effects(Experiment.from_dict(declared))
    assert numbers(closure) == {"test 1": (1, 2, 4)}
    assert not closure.effects


def test_what_is_in_question():
    declared, _ = measured_frame(None, 45, configurations=2)
    experiment = Experiment.from_dict(declared)
    in_all = overlooked_in_all(experiment)
    expected = [(1, 3, 4, 5, 6), (1, 2, 4, 5, 6), (1, 2, 3, 5, 6), (1, 2, 3, 4, 6)]
    assert [dict(item.changes)["test 1"] for item in in_all] == expected
    assert all(len(item.changes) == 2 for item in in_all)
    assert len(overlooked_in_one(experiment)) == 8
    odds = sum(np.exp(item.log_odds) for item in (*in_all, *overlooked_in_one(experiment)))
    assert odds == pytest.approx(0.05 / 0.95)
    # The odds are relative to the given numbers, which have odds of one.
    assert np.exp(Numbering(experiment).log_odds) == 1.0
    assert named_numberings(experiment) == []


@pytest.mark.parametrize("given", [{"floors": range(1, 8)}, {"modes": 7}])
def test_what_tells_its_number_is_not_in_question(given):
    """The numbers are certain if shapes are known at every floor, or if a test contains all modes."""
    declared, _ = measured_frame(None, 46, **given)
    assert overlooked_in_all(Experiment.from_dict(declared)) == []


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([{"modes": [1, 2, 4]}], "probability"),
        ([{"modes": [1, 2], "probability": 0.1}], "modes must have 3 entries, one a frequency, not 2"),
        ([{"modes": [1, 2, 3], "probability": 0.1}], "those of the configuration itself"),
        ([{"modes": [1, 2, 8], "probability": 0.1}], "names mode 8; a frame of 7 stories has 7"),
        ([{"modes": [1, 2, 4], "probability": 1.0}], "must be below 1"),
        ([{"modes": [1, 2, 4], "probability": 0.5}, {"modes": [1, 2, 5], "probability": 0.5}], "add up to 1"),
        ([{"modes": [1, 2, 4], "probability": 0.1}] * 2, "same modes twice"),
        ([[1, 2, 4]], "must be a table"),
    ],
)
def test_other_modes_that_cannot_be(value, message):
    declared, _ = measured_frame(None, 47, modes=3)
    declared["configuration"][0]["other_modes"] = value
    with pytest.raises(InputError, match=message):
        Experiment.from_dict(declared)


def test_other_modes_survive_a_file(tmp_path):
    declared, _ = measured_frame(None, 47, modes=3)
    declared["configuration"][0]["other_modes"] = [{"modes": [1, 2, 4], "probability": 0.25}]
    write_measurement(tmp_path / "a.toml", Experiment.from_dict(declared).to_dict())
    (other,) = cvxshear.load(tmp_path / "a.toml").configurations[0].other_modes
    assert (other.modes.tolist(), other.probability) == ([1, 2, 4], 0.25)


def shaken(floors, **keys):
    """Return the modes of eight stories, shaken at floor 7 (a node of mode 3), with sensors at some floors."""
    frame = KnownFrame(np.full(8, 10.0), np.linspace(40000.0, 25000.0, 8), 0.01)
    record = shaker_record(frame, 1, noise=0.02, floor=7, sampling_rate=40.0)
    kept = [floor - 1 for floor in floors]
    runs = tuple(dataclasses.replace(run, responses=run.responses[:, kept]) for run in record.runs)
    channels = tuple(record.channels[place] for place in kept)
    return frame, identify_modes(dataclasses.replace(record, channels=channels, runs=runs, stories=8), **keys)


def test_the_signs_of_a_record_at_some_floors_tell_that_a_mode_is_lacking():
    frame, modes = shaken([2, 4, 6, 8])
    assert modes.modes.tolist()[:5] == [1, 2, 4, 5, 6]
    np.testing.assert_allclose(modes.frequencies, frame.modes()[0][modes.modes - 1], rtol=2e-3)


def test_a_record_that_lacks_a_mode_is_numbered_by_the_loop_where_its_signs_do_not_tell():
    frame, _ = shaken([3, 5, 8])
    driven = frame.modes()[0][[0, 1, 3, 4, 5]]
    _, modes = shaken([3, 5, 8], pick=driven.tolist(), method="subspace")
    assert modes.modes.tolist() == [1, 2, 3, 4, 5]
    rivals = ["attached_mass", "ground_spring", "sensor_gain", "story_change", "gravity"]
    closure = search_for_effects(Experiment.from_dict(modes.to_experiment({"floor_masses": [10.0] * 8})), rivals)
    assert numbers(closure) == {modes.name: (1, 2, 4, 5, 6)}
    assert not closure.effects


def pole(frequency, **judged):
    return PoleCandidate(((0, round(100 * frequency)),), 2j * np.pi * frequency, np.ones(2), 1.0, 0.0, **judged)


def test_a_resonance_without_a_shape_puts_the_numbers_above_it_in_doubt():
    found = np.array([1.0, 3.0, 7.0])
    weak, spurious = pole(5.0, physical=False, shaky=True), pole(6.0, physical=False)
    poles = [pole(1.0), pole(3.0), weak, spurious, pole(7.0), pole(9.0)]
    chosen = [poles[0], poles[1], poles[4]]
    left = left_out(poles, chosen)
    assert [item.frequency for item in left] == pytest.approx([5.0, 9.0])
    (finding,) = overlooked_modes(found, np.array([1, 2, 3]), left[:1], floors=3, stories=6)
    assert finding.numbers["modes"] == [1, 2, 4]
    assert finding.numbers["probability"] == A_MODE
    assert "between modes 2 and 3 lies a resonance that is not among them, at 5 Hz" in finding.message
    assert "what is called mode 3 is mode 4" in finding.message
    # At most one mode is overlooked: two resonances between others share its probability.
    two = overlooked_modes(found, np.array([1, 2, 3]), [pole(2.0), weak], floors=3, stories=6)
    assert [(item.numbers["modes"], item.numbers["probability"]) for item in two] == [
        ([1, 3, 4], pytest.approx(A_MODE / 2)), ([1, 2, 4], pytest.approx(A_MODE / 2)),
    ]  # fmt: skip
    assert overlooked_modes(found, np.array([1, 2, 3]), left, floors=6, stories=6) == []
    assert overlooked_modes(found, np.array([1, 2, 3]), left[1:], floors=3, stories=6) == []
    assert overlooked_modes(found, np.array([1, 2, 3]), left, floors=2, stories=3) == []


def test_hopeless_numbers_lose_nothing_that_is_declared():
    """A misfit that no frame removes must not lead to infinite stiffnesses, nor change the declared total mass."""
    declared, truth = measured_frame(None, 900, stories=8, floors=(1, 2, 3, 5, 6, 8), modes=7)
    for lost in (2, 3, 4):
        theta = efficient(Experiment.from_dict(lose(copy.deepcopy(declared), lost)), backends.get("auto")).theta
        assert theta[:8].sum() == pytest.approx(truth["floor_mass"].sum(), rel=1e-9)
        assert theta[8:].max() < 1e7 * truth["story_stiffness"].max()
