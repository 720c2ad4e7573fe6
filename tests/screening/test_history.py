"""Trends over many tests: steps, slopes and temperature are found at their place and size, and none without."""

import html
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import cvxshear
from cvxshear.io.toml import load, write_measurement
from cvxshear.util.errors import InputError
from tests.studies.history import STEP_AT, STORIES, TESTS, TRENDS, write_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("monitoring")
    write_folder(path, 1, **TRENDS)
    return path


@pytest.fixture(scope="module")
def found(folder):
    return cvxshear.history(folder)


def test_a_step_a_slope_and_the_influence_of_temperature_are_found(found):
    assert {each.kind: each.story for each in found.changes} == STORIES
    for each, size in zip(sorted(found.changes, key=lambda item: item.kind), (-0.05, -0.03, -0.001), strict=True):
        assert each.probability > 0.95
        assert abs(each.size - size) < 3 * each.std < 0.3 * abs(size)


def test_a_step_begins_at_its_test(found):
    (step,) = [each for each in found.changes if each.kind == "step"]
    assert f"{STEP_AT:02d}" in (step.test, *step.other_tests)


def test_each_test_has_its_stiffness_and_the_fitted_one_follows_it(found):
    assert found.story_stiffness.shape == found.fitted.shape == (TESTS, 4)
    scatter = (found.story_stiffness - found.fitted) / found.story_stiffness_std
    assert 0.7 < np.sqrt(np.mean(scatter**2)) < 1.3


def test_files_in_place_of_a_folder(folder):
    few = cvxshear.history(sorted(folder.glob("*.toml"))[:3])
    assert few.story_stiffness.shape == (3, 4)
    assert not [each for each in few.changes if each.probability > 0.95 and each.kind == "step"]


def test_a_test_that_is_there_twice_counts_once(folder, tmp_path):
    for at in range(5):
        shutil.copy(folder / f"{at:02d}.toml", tmp_path)
    shutil.copy(folder / "01.toml", tmp_path / "05.toml")
    assert cvxshear.history(tmp_path).story_stiffness.shape == (5, 4)


def test_nothing_is_found_without(tmp_path):
    write_folder(tmp_path, 2)
    assert cvxshear.history(tmp_path).changes == ()


def test_the_command_writes_report_figure_table_and_json(found, folder, tmp_path, printed):
    out = {ending: tmp_path / f"h.{ending}" for ending in ("json", "html", "svg", "csv")}
    said = printed(
        "history", folder, "--json", out["json"], "--report", out["html"], "--figure", out["svg"], "--csv", out["csv"]
    )
    written = json.loads(out["json"].read_text())
    assert [each["text"] for each in written["changes"]] == [each.text for each in found.changes]
    page = html.unescape(out["html"].read_text())
    assert all(each.text in said and each.text in page for each in found.changes)
    assert len(written["about"]["files"]) == len(out["csv"].read_text().splitlines()) - 1 == TESTS
    assert len(found.to_dataframe()) == TESTS
    jsonschema = pytest.importorskip("jsonschema")
    schema = Path(__file__).parents[2] / "docs" / "schema" / "history.json"
    jsonschema.validate(written, json.loads(schema.read_text()))


def test_a_broken_file_and_one_with_a_mistake_are_skipped(folder, tmp_path, run):
    for at in range(6):
        shutil.copy(folder / f"{at:02d}.toml", tmp_path)
    (tmp_path / "02.toml").write_text("[frame]\ntotal_mass = \n")
    swapped = load(folder / "03.toml").to_dict()
    swapped["configuration"][0]["mode_shapes"] = np.array(swapped["configuration"][0]["mode_shapes"])[:, [1, 0, 2, 3]]
    write_measurement(tmp_path / "03.toml", swapped)
    status, said, _ = run("history", tmp_path)
    assert status == 2
    assert "02.toml is not valid TOML" in said
    assert "03.toml: configuration" in said
    assert ", 4 tests: " in said


@pytest.mark.parametrize(
    ("table", "key", "value", "message"),
    [
        ("frame", "total_mass", 50.0, "02.toml declares another frame than"),
        ("configuration", "date", None, "date is missing in 02; give it in every test or in none"),
    ],
)
def test_tests_that_do_not_belong_together_are_refused(folder, tmp_path, table, key, value, message):
    for at in range(3):
        shutil.copy(folder / f"{at:02d}.toml", tmp_path)
    declared = load(tmp_path / "02.toml").to_dict()
    (declared[table][0] if table == "configuration" else declared[table])[key] = value
    declared["configuration"][0] = {k: v for k, v in declared["configuration"][0].items() if v is not None}
    write_measurement(tmp_path / "02.toml", declared)
    with pytest.raises(InputError, match=message):
        cvxshear.history(tmp_path)


def test_too_few_tests_and_no_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match="a history needs 3 tests, found 0 in"):
        cvxshear.history(tmp_path)
    with pytest.raises(InputError, match="nowhere is no folder; name one with measurement files"):
        cvxshear.history(tmp_path / "nowhere")
