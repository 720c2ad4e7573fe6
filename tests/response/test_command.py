"""Tests of `cvxshear predict`, and of the damping output of `identify` and `loop`."""

import errno
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

import cvxshear
from cvxshear.io.modes import modes_from_file
from cvxshear.io.toml import write_measurement
from cvxshear.response import DampedModel, DrivenRun, predict, response
from tests.records.shared import channels, csv
from tests.response.common import damped_frame, damped_measurement, matrices, shaking

SHAKEN = ("frame.toml", "--record", "shaken.toml")

pytestmark = pytest.mark.usefixtures("shared_loops")

RECORD = """
added_mass = [0, 0, 0]

[record]
name = "shaken"
input = "base"
file = "shaken.csv"
""" + channels("ground", first=0)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Write a measurement file, a record with its floors, and a record of the ground alone."""
    monkeypatch.chdir(tmp_path)
    M, C, K = matrices(*damped_frame(3))
    write_measurement("frame.toml", damped_measurement(3))
    excitation = shaking(1500)
    found = response(DampedModel(M, C, K, np.ones(3)), DrivenRun(excitation), 0.01).acceleration
    table = np.column_stack([0.01 * np.arange(1500), excitation, found])
    csv(tmp_path / "shaken.csv", ["time", "ground", "floor1", "floor2", "floor3"], table)
    (tmp_path / "shaken.toml").write_text(RECORD + channels("floor1", "floor2", "floor3"))
    (tmp_path / "ground.toml").write_text(RECORD)
    return tmp_path


def test_predict_beside_the_record(folder, printed):
    said = json.loads(printed("predict", *SHAKEN, "--json", "-"))
    assert {"before", "after", "peaks", "damping", "remarks"} <= set(said)
    assert set(said["after"]) == {"floors", "nrmse", "rms_ratio", "peak_ratio", "frf_error"}
    assert said["after"]["floors"] == [1, 2, 3]
    assert max(said["after"]["nrmse"]) < 0.05
    assert np.shape(said["after"]["frf_error"]) == (3, 3)
    assert said["damping"]["kind"] == "modal"
    assert len(said["peaks"]["story_drift_std"]) == 3
    assert said["peaks"]["base_shear"] > 0


def test_predict_for_people(folder, printed):
    out = printed("predict", *SHAKEN, "--damping", "story")
    assert "predicted accelerations beside the measured" in out
    assert "peaks ± standard deviation" in out
    assert "story dashpots" in out
    assert "moment" in out


def test_a_ground_motion_alone_is_enough(folder, run, printed):
    said = json.loads(printed("predict", "frame.toml", "--record", "ground.toml", "--json", "-"))
    assert said["after"] is None
    assert any("no accelerations of floors" in remark for remark in said["remarks"])
    _, whole, _ = run("predict", *SHAKEN, "--json", "-")
    compared = json.loads(whole)["peaks"]
    for name, values in said["peaks"].items():
        # The record's evidence of model errors only widens the deviations. The peaks stay.
        if name.endswith("_std"):
            assert np.all(np.array(compared[name]) >= np.array(values))
        else:
            assert values == compared[name]


def test_a_record_file_in_place_of_an_experiment(folder):
    """The command identifies the modes of the record first."""
    given = cvxshear.identify("shaken.toml")
    modes = cvxshear.Experiment.from_dict(modes_from_file("shaken.toml")[1])
    np.testing.assert_array_equal(given.frame.floor_mass, cvxshear.identify(modes).frame.floor_mass)
    assert given.experiment.name == "shaken"


def test_files_and_figures(folder, printed):
    wanted = ["s.npz", "h.svg", "p.png"]
    printed("predict", *SHAKEN, "--out", "s.npz", "--figure", "history:h.svg", "--figure", "peaks:p.png")
    assert all((folder / name).stat().st_size > 0 for name in wanted)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("predict", "nowhere.toml", "--record", "shaken.toml"), "nowhere.toml: no such file"),
        (("predict", "frame.toml", "--record", "frame.toml"), "is a measurement file (it has [[configuration]]), not"),
        (("predict", *SHAKEN, "--damping", "viscous"), "damping must be one of modal, story"),
        (("predict", *SHAKEN, "--out", "x.doc"), "--out: x.doc must end in .csv or .mat"),
        (("predict", *SHAKEN, "--figure", "mac:x.svg"), "no figure 'mac' here; there are history"),
        (("predict", *SHAKEN, "--figure", "peaks:x.doc"), "--figure: x.doc must end in .svg or"),
        (("predict", *SHAKEN, "--backend", "none"), "no backend named 'none'"),
        (("predict", "paper", "--record", "shaken.toml"), "speaks of floor 3, the frame has 2 stories"),
        (("predict", "paper", "--record", "two.toml"), "nothing tells how the frame is damped"),
        (("reconstruct", "frame.toml", "--record", "ground.toml"), "no floor's acceleration was recorded"),
        (("reconstruct", *SHAKEN, "--out", "a.xyz"), "--out: a.xyz must end in .csv or"),
        (("reconstruct", *SHAKEN, "--configuration", "other"), "configuration must be"),
    ],
)
def test_bad_input(folder, refused, arguments, message):
    (folder / "two.toml").write_text(RECORD.replace("[0, 0, 0]", "[0, 0]"))
    before = sorted(folder.iterdir())
    assert message in refused(*arguments)
    assert sorted(folder.iterdir()) == before


def test_the_prediction_is_printed_where_a_file_cannot_be_written_after_all(folder, run, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    before = sorted(folder.iterdir())
    status, out, err = run("predict", *SHAKEN, "--out", "s.csv", "--csv", "p.csv", "--figure", "peaks:p.svg")
    assert status == 2
    assert "peaks ± standard deviation" in out
    assert err.count("cannot be written: No space left on device") == 3
    assert sorted(folder.iterdir()) == before


def test_a_record_as_the_model_is_that_of_its_modes(folder, printed):
    """The command also examines the record for mistakes. The function does not; both give the same prediction."""
    said = json.loads(printed("predict", "shaken.toml", "--record", "shaken.toml", "--json", "-"))
    assert [each["name"] for each in said.pop("warnings")] == ["total_mass"]
    assert any("have no scale" in remark for remark in said["remarks"])
    assert said.pop("about")["files"]
    assert said == json.loads(json.dumps(predict("shaken.toml", "shaken.toml").to_dict()))


def test_a_mistake_is_refused_before_anything_is_predicted(folder, refused, monkeypatch):
    path = folder / "frame.toml"
    declared = cvxshear.load(path).to_dict()
    for row in declared["configuration"][0]["mode_shapes"]:
        row[0], row[2] = row[2], row[0]
    write_measurement(path, declared)
    with monkeypatch.context() as patched:
        patched.setattr("cvxshear.response.predict", lambda *_, **__: pytest.fail("it ran"))
        err = refused("predict", *SHAKEN)
    assert "To mend it:" in err
    assert "[frame] accept = [" in err


def test_doubts_are_told_with_a_prediction(folder, run, printed):
    """Story heights of 4 km suggest a height in millimeters."""
    path = folder / "frame.toml"
    declared = cvxshear.load(path).to_dict()
    declared["frame"]["story_heights"] = [4000.0] * 3
    write_measurement(path, declared)
    out = printed("predict", *SHAKEN)
    assert out.count("WARNING: ") == 1
    (item,) = json.loads(run("predict", *SHAKEN, "--json", "-")[1])["warnings"]
    assert "story_heights" in item["found"]


def test_reconstruct_writes_all_it_is_asked_for(folder, printed):
    """Floors 1 and 3 carry sensors; one sensor has a gap."""
    text = (folder / "shaken.csv").read_text().splitlines()[:1001]
    cells = text[700].split(",")
    text[700] = ",".join([*cells[:2], "nan", *cells[3:]])
    (folder / "shaken.csv").write_text("\n".join(text) + "\n")
    (folder / "two.toml").write_text(RECORD + channels("floor1") + channels("floor3", first=3))
    (folder / "frame.toml").write_text((folder / "frame.toml").read_text() + "\n[limits]\nstory_drift = [0.0001]\n")
    names = ["two.json", "two.html", "two.csv", "two.npz"]
    out = printed(
        "reconstruct", "frame.toml", "--record", "two.toml", "--json", names[0], "--report", names[1], "--csv",
        names[2], "--out", names[3],
    )  # fmt: skip
    said = json.loads(Path("two.json").read_text())
    assert said["measured_floors"] == [1, 3]
    assert said["missing"] == [1, 0]
    assert [check["floor"] for check in said["checks"]] == [1, 3]
    assert len(said["limits"][0]["probability"]) == 3
    page = Path("two.html").read_text()
    assert "each measured floor from the other sensors alone" in page
    assert 'id="figure-drifts"' in page
    # The owner's questions come first. The record follows.
    assert re.search(r"Story \d drifted most: .*; limit 0.01 %: passed in .* under base motion", " ".join(out.split()))
    # The frame has a dashpot in each story. Modal damping cannot represent them, and one of them is named.
    assert re.search(
        r'id="headline">Story \d drifted most: [^<]*no single story changed; story \d damps by itself[^<]*</p>'
        r"\s*<p>[^<]*under base motion", page,
    )  # fmt: skip
    head = Path("two.csv").read_text().splitlines()[0]
    assert head.startswith('floor / story,"floor acceleration, m/s²","floor acceleration std, m/s²"')
    with np.load("two.npz") as series:
        assert {"drift_2", "drift_std_2", "shear_1"} <= set(series)
