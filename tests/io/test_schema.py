"""The published JSON schemas accept all written results, and refuse invalid ones."""

import copy
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import cvxshear
from cvxshear.io.templates import template
from cvxshear.records import IdentifiedRecord, from_arrays, identify_modes, merged
from cvxshear.records.simulate import PAPER_FRAME, base_record
from cvxshear.screening.screen import Screening
from cvxshear.util.errors import InputError
from tests import closed
from tests.fe.plan_frames import random_frame
from tests.frames import EXAMPLES, MEASURED
from tests.fuzz import files

jsonschema = pytest.importorskip("jsonschema")
SCHEMAS = Path(__file__).parents[2] / "docs" / "schema"


def validator(name):
    schema = json.loads((SCHEMAS / f"{name}.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def faults(name, said):
    """Return the errors found by the schema."""
    return [error.message for error in validator(name).iter_errors(said)]


def test_every_schema_is_one():
    results = {"backends", "check", "history", "identify", "loop", "modes", "plan", "predict", "reconstruct"}
    assert {path.stem for path in SCHEMAS.glob("*.json")} == {"measurement", *results}
    for path in SCHEMAS.glob("*.json"):
        validator(path.stem)


@pytest.mark.parametrize("path", MEASURED, ids=lambda path: path.stem)
def test_measurement_files(path):
    assert faults("measurement", tomllib.loads(path.read_text(encoding="utf-8"))) == []
    assert faults("measurement", cvxshear.load(path).to_dict()) == []


def test_a_new_file_and_a_merged_one():
    assert faults("measurement", tomllib.loads(template(4))) == []
    modes = [from_arrays([3.0, 9.0], [[0.5, 1.0], [1.0, -0.6]], name=name) for name in ("a", "b")]
    frame = {"total_mass": 20.0, "reference": "bare"}
    tests = [IdentifiedRecord(f"{each.name}.toml", each, frame, (), [0.0, 1.0], "bare") for each in modes]
    assert faults("measurement", merged(tests)) == []


def test_every_table_of_a_measurement_file():
    declared = cvxshear.load(EXAMPLES / "three_story.toml").to_dict()
    declared["configuration"][0] |= {"damping_ratios": [0.01] * 3, "damping_ratio_std": 0.1}
    declared["configuration"][0] |= {"date": "2024-05-03", "temperature": -3.5, "amplitude": 0.02}
    declared["configuration"].append({"name": "again", "repeats": {"frequencies": [[2.0], [2.1]], "block": ["a", "b"]}})
    declared["configuration"].append({"name": "more", "frequencies": [2.0], "frequency_covariance": [[1e-6]]})
    declared["static"] = [{"force": [0.0, 0.0, 10.0], "displacement": [0.005, 0.01, 0.02], "displacement_std": 0.01}]
    declared["effect"] = [{"name": "sensor_gain", "floor": 2, "size": 0.02, "probability": 0.3}]
    declared["damping"] = {"kind": "story"}
    assert faults("measurement", cvxshear.Experiment.from_dict(declared).to_dict()) == []
    for table, key in (("static", "forces"), ("effect", "sized")):
        wrong = copy.deepcopy(declared)
        wrong[table][0][key] = 1.0
        assert not validator("measurement").is_valid(wrong)
        with pytest.raises(InputError):
            cvxshear.Experiment.from_dict(wrong)


@pytest.mark.parametrize(
    ("key", "value"),
    [("frequencies", ["2.0"]), ("added_mass", [-1.0]), ("damping_ratios", 2.0), ("frequency", [2.0]), ("csv", "a.csv")],
)
def test_the_schema_refuses_what_the_reader_refuses(key, value):
    declared = cvxshear.load(EXAMPLES / "three_story.toml").to_dict()
    declared["configuration"][0][key] = value
    assert not validator("measurement").is_valid(declared)
    with pytest.raises(InputError):
        cvxshear.Experiment.from_dict(declared)


@pytest.mark.parametrize("method", ["efficient", "two-stage", "one-shot", "berman"])
def test_identifications(method):
    assert faults("identify", cvxshear.identify(cvxshear.load(EXAMPLES / "paper.toml"), method=method).to_dict()) == []


@pytest.mark.parametrize("symmetric", [False, True])
def test_the_identification_of_floors_that_turn(symmetric):
    experiment = random_frame(2, 5, symmetric=symmetric).experiment()
    assert faults("measurement", experiment.to_dict()) == []
    assert faults("identify", cvxshear.identify(experiment, method="one-shot").to_dict()) == []


def test_loop_and_backends():
    said = closed.paper().to_dict()
    assert faults("loop", said) == []
    broken = copy.deepcopy(said)
    broken["verdict"] = "perhaps"
    assert not validator("loop").is_valid(broken)
    three = cvxshear.load(EXAMPLES / "three_story.toml")
    assert faults("backends", cvxshear.compare_backends(three, names=["kkt", "clarabel"]).to_dict()) == []


def test_checks_of_a_sound_file_and_of_one_with_a_mistake():
    declared = cvxshear.load(EXAMPLES / "three_story.toml").to_dict()
    assert faults("check", Screening.of(cvxshear.Experiment.from_dict(declared)).to_dict()) == []
    declared["frame"]["gravity"] = 981.0
    said = Screening.of(cvxshear.Experiment.from_dict(declared)).to_dict()
    assert said["findings"]
    assert faults("check", said) == []


@pytest.mark.parametrize("more", [{}, {"tests": 2, "added_mass": 2.0}])
def test_plans(more):
    assert faults("plan", cvxshear.plan(EXAMPLES / "three_story.toml", sensors=2, **more).to_dict()) == []


def test_motions_in_a_record():
    """Motions are predicted and reconstructed, with and without a measured base, with and without limits."""
    record = base_record(PAPER_FRAME, 0, noise=0.01, duration=10.0)
    declared = cvxshear.load(EXAMPLES / "three_story.toml").to_dict()
    declared["frame"] |= {"story_heights": 0.3}
    declared["configuration"][0]["damping_ratios"] = [0.01] * 3
    plain = cvxshear.Experiment.from_dict(declared)
    limited = cvxshear.Experiment.from_dict({**declared, "limits": {"story_drift": [0.005, 0.01]}})
    assert faults("predict", cvxshear.predict(plain, record).to_dict()) == []
    found = cvxshear.reconstruct(limited, record, leave_out=False).to_dict()
    assert faults("reconstruct", found) == []
    found["limits"][0]["probability"][0] = 1.0000000000000002
    assert not validator("reconstruct").is_valid(found)
    # Without a fit, the sensors are left out in turn very quickly.
    left_out = cvxshear.reconstruct(plain, record, fit=False).to_dict()
    assert left_out["checks"]
    assert faults("reconstruct", left_out) == []


def test_modes_of_one_record_and_of_several(tmp_path, run):
    record = base_record(PAPER_FRAME, 0, noise=0.01, duration=150.0)
    assert faults("modes", json.loads(json.dumps(identify_modes(record).to_dict()))) == []
    (shaken,) = record.runs
    table = np.column_stack([np.arange(shaken.samples) / record.sampling_rate, shaken.excitation, shaken.responses])
    np.savetxt(tmp_path / "sound.csv", table, delimiter=",", header="t,ground,a1,a2,a3", comments="")
    (tmp_path / "a.toml").write_text(files.record_text("sound.csv"))
    (tmp_path / "b.toml").write_text(files.record_text("absent.csv"))
    status, out, _ = run("modes", tmp_path / "a.toml", tmp_path / "b.toml", "--json", "-")
    assert status == 2
    printed = json.loads(out)
    assert faults("modes", printed) == []
    assert [Path(each["file"]).name for each in printed["failed"]] == ["b.toml"]
    assert np.isfinite(printed["records"][0]["frequencies"]).all()
