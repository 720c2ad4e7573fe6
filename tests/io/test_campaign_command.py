"""Run `cvxshear modes` and `cvxshear loop` on several records, with figures, tables and a report."""

from __future__ import annotations

import json

import numpy as np
import pytest

import cvxshear
from cvxshear.cli import main
from tests.io.campaign import frame, write_records


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("records")
    write_records(path)
    return path


@pytest.fixture
def run(folder, capsys, monkeypatch, shared_modes):
    monkeypatch.chdir(folder)

    def call(*arguments):
        with pytest.raises(SystemExit) as stopped:
            main(list(arguments))
        return stopped.value.code, capsys.readouterr()

    return call


def test_three_records_one_file(run, tmp_path):
    status, shown = run("modes", "bare.toml", "loaded.toml", "after.toml", "-o", str(tmp_path / "test.toml"))
    assert status == 0, shown.err
    for name in ("bare", "loaded", "after"):
        assert f"{name}: 3 modes at floors 1, 2, 3" in shown.out
    assert len(cvxshear.load(tmp_path / "test.toml").configurations) == 3


def test_a_failure_is_named_and_the_others_are_written(run, folder, tmp_path):
    (folder / "zz.toml").write_text((folder / "bare.toml").read_text().replace('"floor1"', '"flor1"'))
    status, shown = run(
        "modes", "bare.toml", "zz.toml", "-o", str(tmp_path / "test.toml"), "--json", str(tmp_path / "a.json")
    )
    (folder / "zz.toml").unlink()
    assert status == 2
    assert shown.err.startswith("cvxshear: zz.toml: ")
    assert [each.name for each in cvxshear.load(tmp_path / "test.toml").configurations] == ["bare"]
    said = json.loads((tmp_path / "a.json").read_text())
    assert [each["file"] for each in said["failed"]] == ["zz.toml"]
    assert [each["file"] for each in said["records"]] == ["bare.toml"]


def test_the_loop_names_the_softer_story(run, tmp_path):
    arguments = ("--effects", "story_change", "--json", str(tmp_path / "a.json"))
    status, shown = run("loop", "bare.toml", "loaded.toml", "after.toml", *arguments)
    assert status == 0, shown.err
    said = json.loads((tmp_path / "a.json").read_text())
    effect = max(said["effects"], key=lambda item: abs(next(iter(item["parameters"].values()))))
    assert (effect["name"], effect["story"]) == ("story_change", 2)
    assert next(iter(effect["parameters"].values())) == pytest.approx(-0.15, abs=0.01)
    assert len(said["records"]) == 3


def test_poles_picked_on_the_command_line_and_in_the_file(run, folder, tmp_path):
    exact = frame("bare").modes()[0]
    status, shown = run("modes", "bare.toml", "--pick", f"{exact[2]:.2f},{exact[0]:.2f}", "--json", "-")
    assert status == 0, shown.err
    np.testing.assert_allclose(json.loads(shown.out)["frequencies"], exact[[0, 2]], rtol=1e-3)
    text = (folder / "bare.toml").read_text().replace("[record]", f"[record]\npick = [{exact[1]:.2f}]")
    (folder / "picked.toml").write_text(text)
    status, shown = run("modes", "picked.toml", "--json", "-")
    (folder / "picked.toml").unlink()
    np.testing.assert_allclose(json.loads(shown.out)["frequencies"], exact[[1]], rtol=1e-3)
    status, shown = run("modes", "bare.toml", "--pick", "1;2")
    assert status == 2
    assert "--pick must be numbers with commas between" in shown.err


def test_figures_tables_and_a_report(run, tmp_path):
    pytest.importorskip("openpyxl")
    status, shown = run(
        "modes", "bare.toml", "loaded.toml",
        "--figure", f"shapes:{tmp_path / 'shapes.svg'}", "--figure", str(tmp_path / "first.png"),
        "--report", str(tmp_path / "report.html"), "--csv", str(tmp_path / "modes.csv"), "--xlsx",
        str(tmp_path / "modes.xlsx"), "--quiet",
    )  # fmt: skip
    assert status == 0, shown.err
    assert {path.name for path in tmp_path.iterdir()} == {
        "shapes.svg", "first.png", "report.html", "modes.csv", "modes.xlsx"
    }  # fmt: skip
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for said in ("Stabilization diagram", "cvxshear modes bare.toml loaded.toml", "figure-functions"):
        assert said in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert (tmp_path / "modes.csv").read_text().startswith('configuration,mode,"frequency, Hz"')


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["modes", "bare.toml", "--figure", "stabilisation:a.png"], "did you mean 'stabilization'?"),
        (["modes", "bare.toml", "--figure", "mac:a.gif"], "a.gif must end in .svg or .png or .pdf"),
        (["modes", "bare.toml", "--csv", "bare.csv"], "would be written over bare.csv"),
        (["modes", "bare.toml", "-o", "bare.toml"], "would be written over bare.toml"),
        (["loop", "bare.toml", "paper"], "paper"),
        (["identify", "paper", "--figure", "functions:a.png"], "no figure 'functions' here; there are frame, "),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(run, folder, arguments, expected):
    before = sorted(folder.iterdir())
    status, shown = run(*arguments)
    assert status == 2
    assert expected in shown.err
    assert shown.out == ""
    assert sorted(folder.iterdir()) == before
