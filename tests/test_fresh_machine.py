"""Results must not depend on the machine or on settings of the process: masks, copies, floating-point traps, dates."""

import copy
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cvxshear
from cvxshear.effects import Effect, Parameter
from cvxshear.records import from_arrays
from cvxshear.records.motion import DrivenRecord, DrivenRun
from tests import closed
from tests.frames import configuration, experiment

MASS, STIFFNESS = [10.0, 7.5, 5.0], [1800.0, 1200.0, 600.0]


def three_stories(**changes):
    test = {**configuration(MASS, STIFFNESS), **changes}
    return experiment(MASS, STIFFNESS, test)


def test_a_masked_entry_of_a_shape_is_not_measured():
    shapes = np.array(configuration(MASS, STIFFNESS)["mode_shapes"])
    masked = np.ma.masked_array(shapes, mask=[[0, 0, 0], [0, 1, 0], [0, 0, 0]])
    found = cvxshear.Experiment.from_dict(three_stories(mode_shapes=masked)).configurations[0].mode_shapes
    expected = shapes.copy()
    expected[1, 1] = np.nan
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("key", "size"), [("added_mass", 3), ("frequencies", 3), ("frequency_std", 3)])
def test_a_masked_number_is_refused_with_its_place(key, size):
    values = np.ma.masked_array(np.arange(1.0, size + 1), mask=[0, 1, 0])
    with pytest.raises(cvxshear.InputError, match=rf"{key}, entry 2 must be a number, not None"):
        cvxshear.Experiment.from_dict(three_stories(**{key: values}))


def test_masked_modes_of_another_program_are_refused():
    with pytest.raises(cvxshear.InputError, match="mode_shapes, row 1, entry 2 is not finite, or masked"):
        from_arrays([1.0, 2.0], np.ma.masked_array([[0.5, 1.0], [1.0, -0.5]], mask=[[0, 1], [0, 0]]))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))])
def test_the_arrays_of_a_copy_are_read_only(copied):
    of = copied(cvxshear.load("paper"))
    for test in of.configurations:
        for name in ("frequencies", "mode_shapes", "added_mass", "modes", "measured_floors"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(test, name)[0] = 1


def test_the_callers_floating_point_traps_are_not_the_librarys():
    expected = closed.paper()
    with np.errstate(all="raise"):
        found = cvxshear.close_loop("paper")
        solution = cvxshear.programs.one_shot_masses("paper", configuration="Structure 1").solve("clarabel")
        assert np.geterr()["under"] == "raise"
    assert found.verdict == expected.verdict
    np.testing.assert_array_equal(found.frame.floor_mass, expected.frame.floor_mass)
    assert solution.x.sum() == pytest.approx(31.33)


def run(*words, **environment):
    return subprocess.run(
        [sys.executable, "-m", "cvxshear", *words],
        capture_output=True, text=True, check=False, env={**os.environ, **environment},
    )  # fmt: skip


@pytest.mark.parametrize("stamp", ["", "99999999999999", "-99999999999999", "soon", "1" * 5000])
def test_a_date_that_is_none_is_refused(stamp, tmp_path):
    found = run("identify", "paper", "--json", str(tmp_path / "a.json"), SOURCE_DATE_EPOCH=stamp)
    assert found.returncode == 2
    assert "SOURCE_DATE_EPOCH" in found.stderr
    assert "seconds since 1970" in " ".join(found.stderr.split())
    assert list(tmp_path.iterdir()) == []


def test_a_report_of_one_story_prints_nothing_of_lapack(tmp_path):
    path = tmp_path / "one.toml"
    path.write_text(
        "[frame]\nstories = 1\ntotal_mass = 10.0\n[[configuration]]\nname = 'a'\nfrequencies = [2.0]\n"
        "mode_shapes = [[1.0]]\n"
    )
    found = run("loop", str(path), "--report", str(tmp_path / "report.html"))
    assert found.returncode == 0, found.stderr
    assert "DORMQR" not in found.stdout + found.stderr
    assert "<html" in Path(tmp_path / "report.html").read_text()


class Broken(Effect):
    """A spring to the base whose matrix is not finite at the second floor."""

    name = "broken"
    summary = "A spring holds a floor to the base."
    formula = "K + b e e'"
    source = "made for this test"
    stage = "spring"
    sits_at = ("floor",)
    parameters = (Parameter("b", "N/m", lower=0.0),)
    usual = 100.0

    def apply(self, state, place, values, own):
        matrix = np.zeros((1, *state.system.K.shape))
        matrix[0, place.floor - 1, place.floor - 1] = np.nan if place.floor == 2 else 1.0
        return state.plus_stiffness(values, matrix, own)


class WrongShape(Broken):
    """A spring to the base whose matrix is too small at the second floor."""

    name = "small"

    def apply(self, state, place, values, own):
        size = 2 if place.floor == 2 else 3
        return state.plus_stiffness(values, np.eye(size)[None], own)


@pytest.mark.parametrize(
    ("effect", "said"),
    [(Broken(), "(?s)broken.*finite"), (WrongShape(), r"small at floor 2: .*\(1, 2, 2\), not \(1, 3, 3\)")],
)
def test_an_effect_that_is_wrong_at_one_floor_is_named(effect, said):
    """The check at registration uses the first and the last place only."""
    with pytest.raises(cvxshear.FaultyEffectError, match=said):
        cvxshear.close_loop(three_stories(), effects=[effect])


def test_a_masked_sample_of_a_response_is_missing():
    responses = np.ma.masked_array([[1.0], [2.0], [3.0]], mask=[[0], [1], [0]])
    run_ = DrivenRun([1.0, 0.0, 0.0], responses=responses)
    np.testing.assert_array_equal(run_.responses, [[1.0], [np.nan], [3.0]])
    assert not copy.deepcopy(run_).responses.flags.writeable


def test_a_masked_added_mass_of_a_record_is_refused():
    masked = np.ma.masked_array([1.0, 2.0], mask=[0, 1])
    with pytest.raises(cvxshear.InputError, match="added_mass, entry 2 must be a number, not None"):
        DrivenRecord([DrivenRun([1.0, 0.0])], 100.0, added_mass=masked)
