"""Test the command line as a user sees it: output, JSON, exit status, and no incomplete files."""

import hashlib
import inspect
import json
import re
import subprocess
import sys

import numpy as np
import pytest
import typer
from typer.main import get_command

import cvxshear
from cvxshear import backends
from cvxshear.backends.base import Tolerances
from cvxshear.cli import app
from cvxshear.io.modes import identify_modes_many
from cvxshear.planning import Declared
from cvxshear.records import identify_modes
from tests.frames import EXAMPLES

pytestmark = pytest.mark.usefixtures("shared_loops")

THREE = str(EXAMPLES / "three_story.toml")


def test_identify_prints_the_papers_answer(printed):
    out = printed("identify", "paper", "--method", "two-stage")
    for number in ("13.045", "25.517", "18.285", "25.176", "24.054", "23.842"):
        assert number in out


def test_json_stands_alone_on_standard_output(printed):
    result = json.loads(printed("identify", THREE, "--initial-mass", "9.5,7.5,5.5", "--json", "-"))
    assert set(result) >= {"method", "backend", "converged", "iterations", "frame", "fit", "predictions", "history"}
    # An initial mass means the paper's method.
    assert (result["method"], result["iterations"]) == ("two-stage", 14)
    assert result["frame"]["floor_mass"] == pytest.approx([10, 7.5, 5], rel=1e-5)


def test_floors_that_turn_are_identified(printed):
    """The theory page of the example has the expected masses."""
    frame = json.loads(printed("identify", EXAMPLES / "turning_floors.toml", "--json", "-"))["frame"]
    np.testing.assert_allclose(frame["floor_mass"], [42e3, 36e3, 30e3], rtol=0.01)


def test_several_configurations_leave_the_top_null(run):
    result = json.loads(run("identify", "paper", "--method", "one-shot", "--json", "-")[1])
    assert result["frame"] is None
    assert [item["name"] for item in result["configurations"]] == ["Structure 1", "Structure 2", "Structure 3"]


def test_json_into_a_file_comes_with_the_tables(printed, tmp_path):
    out = tmp_path / "result.json"
    shown = printed("identify", "paper", "--json", str(out))
    found = json.loads(out.read_text())
    assert found["method"] == "efficient"
    assert f"chi-square {found['fit']['chi2']:.2f} on {found['fit']['dof']} degrees of freedom" in shown
    assert list(tmp_path.iterdir()) == [out]


def test_the_loop_tells_its_story_and_writes_a_report_and_a_figure(printed, tmp_path):
    report, figure, result = (tmp_path / name for name in ("report.html", "residual.svg", "result.json"))
    written = ("--report", str(report), "--figure", str(figure), "--json", str(result))
    out = printed("loop", "paper", *written)
    assert f"cvxshear loop paper --report {report}" in report.read_text(encoding="utf-8")
    assert figure.read_text(encoding="utf-8").startswith("<?xml")
    assert json.loads(result.read_text())["verdict"] == "explained"
    assert re.search(r"the weight above takes 1\.200 ± 0\.072 times P/h from every story's stiffness", out)
    for said in (
        "EXPLAINED",
        "99.9 % probable",
        "1.83 %        0.34 %",
        "shear model  with effects",
        "predicted from",
        "rivals: none",
    ):
        assert said in out


def test_effects_can_be_restricted_and_assumed(run):
    result = json.loads(run("loop", "paper", "--effects", "sensor_gain, story_change", "--json", "-")[1])
    assert {item["name"] for item in result["candidates"]} == {"sensor_gain", "story_change"}
    assumed = json.loads(run("loop", "paper", "--assume", "gravity,gravity", "--json", "-")[1])
    assert [each["name"] for each in assumed["assumed"]] == ["gravity"]


def test_backends_lists_every_installed_one(run, printed):
    result = json.loads(run("backends", THREE, "--json", "-")[1])
    assert {row["backend"] for row in result["rows"]} == set(backends.available())
    kinds = {"mass", "stiffness", "one-shot", "bounded mass", "bounded stiffness", "singular stiffness", "step"}
    assert {row["kind"] for row in result["rows"]} == kinds
    assert all(row["difference"] < 1e-6 for row in result["rows"] if not row["failure"])
    failed = {(row["kind"].split()[0], row["backend"]) for row in result["rows"] if row["failure"]}
    # Goldfarb and Idnani's method needs a positive definite Hessian.
    assert failed == {("bounded", "kkt"), ("singular", "kkt"), ("singular", "quadprog")}
    out = printed("backends", THREE, "--names", "")
    assert "takes no active bound" in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["identify", "nowhere.toml"], "cvxshear: nowhere.toml: no such file"),
        (["identify", "paper", "--metod", "one-shot"], "--metod"),
        (["identify", "paper", "--backend", "gurobo"], "no backend named 'gurobo' is installed here"),
        (["identify", "paper", "--method", "twostage"], "did you mean 'two-stage'"),
        (["identify", THREE, "--initial-mass", "9.5;7.5"], "--initial-mass must be numbers with commas between"),
        (["loop", "paper", "--effects", "gravty"], "did you mean 'gravity'"),
        (["loop", "paper", "--assume", "sensor_gain"], "can sit at 8 places"),
        (["modes", "paper"], "paper is a measurement file"),
        (["identify", "x" * 300], "cannot be read: "),
        (["identify", "paper", "--csv", "-"], "--csv: - must end in .csv"),
    ],
)
def test_bad_input_is_status_two_one_line_and_no_traceback(refused, arguments, said):
    assert said in refused(*arguments)


def test_a_failing_solver_is_status_one_with_its_reason(run, monkeypatch):
    monkeypatch.setattr("cvxshear.backends.base.TOLERANCES", Tolerances(optimality=0.0))
    status, _, err = run("identify", THREE, "--backend", "osqp")
    assert status == 1
    assert "backend osqp: inaccurate solution" in err


def test_a_bad_file_leaves_an_old_result_alone(refused, tmp_path):
    out = tmp_path / "result.json"
    out.write_text("old")
    refused("identify", str(tmp_path / "missing.toml"), "--json", str(out))
    assert out.read_text() == "old"


def test_the_version_is_the_packages(printed):
    out = printed("--version")
    assert cvxshear.__version__ in out


def test_help_gives_an_example_for_every_command(printed):
    commands = [each for each in typer.main.get_command(app).commands if each != "study"]
    assert {"check", "identify", "loop", "modes", "plan", "predict", "backends", "reproduce"} <= set(commands)
    for command in commands:
        out = printed(command, "--help")
        assert f"Example: cvxshear {command}" in out


def test_piped_output_has_no_escape_codes():
    found = subprocess.run(
        [sys.executable, "-m", "cvxshear", "identify", THREE], capture_output=True, text=True, check=True
    )
    assert "\x1b" not in found.stdout
    assert found.stderr == ""


def test_json_says_where_it_comes_from(printed, tmp_path, monkeypatch):
    """Compare version, date, title and the SHA-256 of every input file with the system's tool."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    path = tmp_path / "a.toml"
    path.write_bytes((EXAMPLES / "three_story.toml").read_bytes() + b'[report]\ntitle = "North"\n')
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    for command in (["identify"], ["check"], ["backends", "--names", "kkt"], ["plan"]):
        said = json.loads(printed(command[0], path, *command[1:], "--json", "-"))["about"]
        assert (said["cvxshear"], said["date"]) == (cvxshear.__version__, "2023-11-14T22:13:20+00:00")
        assert said["sha256"] == digest
        assert said["files"] == [{"name": str(path), "sha256": digest}]
        assert said["title"] == "North"


@pytest.mark.parametrize(("data", "status"), [("three_story.toml", 0), ("paper.toml", None)])
def test_strict(data, status, run):
    """Status 3 means an unreliable verdict, and only this."""
    options = ["loop", EXAMPLES / data, "--effects", "ground_spring", "--json", "-"]
    usual, out, _ = run(*options)
    found, again, _ = run(*options, "--strict")
    assert usual == 0
    assert json.loads(again)["verdict"] == json.loads(out)["verdict"]
    assert found == (0 if json.loads(out)["verdict"] in ("adequate", "explained") else 3)
    assert status is None or found == status


def test_verbose():
    found = subprocess.run(
        [sys.executable, "-m", "cvxshear", "-v", "identify", str(EXAMPLES / "three_story.toml"), "--json", "-"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "cvxshear.io.formats: read " in found.stderr
    json.loads(found.stdout)


FUNCTIONS = {
    "identify": [cvxshear.identify],
    "loop": [cvxshear.close_loop],
    "backends": [cvxshear.compare_backends],
    "plan": [cvxshear.plan, Declared],
    "predict": [cvxshear.predict],
    "reconstruct": [cvxshear.reconstruct],
    "modes": [identify_modes, identify_modes_many],
}
"""Commands and their equivalent Python functions with the objects that these take."""

OF_THE_COMMAND = {
    "csv", "figure", "help", "jobs", "json", "out", "output", "quiet", "record", "report", "strict", "xlsx",
}  # fmt: skip
"""Options for the files to read and write, and for the display of results."""


@pytest.mark.parametrize("name", FUNCTIONS)
def test_options_are_called_as_the_parameters_of_the_functions(name):
    command = get_command(app).commands[name]
    options = {each.opts[0].lstrip("-").replace("-", "_") for each in command.params if "--" in each.opts[0]}
    parameters = {each for function in FUNCTIONS[name] for each in inspect.signature(function).parameters}
    assert options - OF_THE_COMMAND - parameters == set()
