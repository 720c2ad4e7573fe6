"""Test the command `check`, and the checks that identify, loop and modes report before they run."""

import json
from pathlib import Path

import numpy as np
import pytest

import cvxshear
from cvxshear.io.toml import write_measurement
from tests.fe.experiments import simulated
from tests.screening.mistakes import with_mistake


@pytest.fixture
def swapped(tmp_path):
    """Return a file with two sensors exchanged."""
    declared, _ = simulated(None, stories=4, configurations=1, rng=np.random.default_rng(3))
    wrong, _, word = with_mistake("swapped_sensors", declared, np.random.default_rng(3))
    write_measurement(tmp_path / "swapped.toml", wrong)
    return tmp_path / "swapped.toml", word


def test_nothing_looks_wrong_with_the_paper(printed):
    assert printed("check", "paper") == "paper: nothing looks wrong\n"
    said = json.loads(printed("check", "paper", "--json", "-"))
    about = said.pop("about")
    assert said == {"name": "paper", "refused": False, "doubtful": False, "findings": [], "record": []}
    assert (about["cvxshear"], [file["name"] for file in about["files"]]) == (cvxshear.__version__, ["paper"])


def test_a_mistake_is_status_two_with_what_to_change(run, swapped):
    file, word = swapped
    status, out, _ = run("check", file)
    assert status == 2
    assert 'MISTAKE: swapped_sensors in configuration "test 1"' in out
    assert word in out
    assert 'accept = ["swapped_sensors"]' in out
    status, out, _ = run("check", file, "--json", "-")
    assert status == 2
    (item,) = json.loads(out)["findings"]
    assert (item["name"], item["configuration"], item["refuses"]) == ("swapped_sensors", "test 1", True)


@pytest.mark.parametrize("command", ["identify", "loop", "plan"])
def test_a_mistake_is_refused_before_anything_is_fitted(refused, swapped, tmp_path, command):
    file, word = swapped
    err = refused(command, file, "--json", tmp_path / "result.json")
    assert word in err
    assert 'accept = ["swapped_sensors"]' in err
    assert not (tmp_path / "result.json").exists()


def test_what_is_accepted_is_fitted(run, printed, swapped):
    file, _ = swapped
    file.write_text(file.read_text().replace("[frame]", '[frame]\naccept = ["swapped_sensors"]'))
    out = printed("check", file)
    assert "accepted beforehand: swapped_sensors" in out
    assert run("identify", file)[0] == 0


def test_a_doubt_stands_above_the_result(run, printed, tmp_path):
    declared, _ = simulated(None, stories=3, configurations=1, rng=np.random.default_rng(1))
    declared["frame"]["gravity"] = 981.0
    write_measurement(tmp_path / "test.toml", declared)
    assert run("check", tmp_path / "test.toml")[0] == 0
    assert run("check", tmp_path / "test.toml", "--strict")[0] == 3
    out = printed("identify", tmp_path / "test.toml")
    assert out.startswith("WARNING: gravity = 981 m/s² is not the Earth's")
    (warning,) = json.loads(run("identify", tmp_path / "test.toml", "--json", "-")[1])["warnings"]
    assert warning["name"] == "gravity"
    out = printed("plan", tmp_path / "test.toml")
    assert out.startswith("WARNING: gravity = 981 m/s² is not the Earth's")
    assert json.loads(run("plan", tmp_path / "test.toml", "--json", "-")[1])["warnings"] == [warning]


def test_design_values_have_no_modes_to_look_through(run):
    design = Path(__file__).parents[2] / "examples/eight_story_design.toml"
    assert "warnings" not in json.loads(run("plan", design, "--modes", "2", "--json", "-")[1])


def test_a_model_that_the_noise_rules_out_says_so_first(printed, tmp_path):
    for effect, begins in ((None, "test:"), ("ground_spring", "RULED OUT:")):
        declared, _ = simulated(
            effect, stories=4, configurations=2, rng=np.random.default_rng(2), floor=3 if effect else None
        )
        write_measurement(tmp_path / "test.toml", declared)
        out = printed("identify", tmp_path / "test.toml")
        assert out.startswith(begins)
    assert "'cvxshear loop' on the same file" in out


def test_a_file_of_the_other_kind_is_told_what_it_is(refused, tmp_path, swapped):
    record = tmp_path / "record.toml"
    record.write_text('[record]\nfile = "frf.csv"\n[[channel]]\ncolumn = "floor1"\nfloor = 1\n')
    err = refused("identify", record)
    assert "is a record file" in err
    assert "cvxshear modes" in err
    err = refused("modes", swapped[0])
    assert "is a measurement file" in err
    assert "cvxshear identify" in err
