"""Combine several records into one measurement: their modes, joint estimates, contradictions, and the commands."""

import dataclasses
import json

import joblib
import numpy as np
import pytest

import cvxshear
from cvxshear.io.modes import identify_modes_many, write_merged
from cvxshear.records import IdentifiedRecord, from_arrays, merged
from cvxshear.util.errors import InputError, NoSolutionError
from tests.io.campaign import ADDED, MASSES, SOFTER, STIFFNESSES, frame, write_records


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("records")
    write_records(path)
    return path


@pytest.fixture(scope="module")
def tests(folder):
    return identify_modes_many([folder / f"{name}.toml" for name in ("bare", "loaded", "after")])


def given(name, file, frame=(), priors=(), added=None, **options):
    modes = from_arrays([3.0, 9.0], [[0.5, 1.0], [1.0, -0.6]], name=name, **options)
    return IdentifiedRecord(file, modes, dict(frame), priors, added)


def test_every_record_is_identified(tests):
    for name, test in zip(("bare", "loaded", "after"), tests, strict=True):
        np.testing.assert_allclose(test.modes.frequencies, frame(name).modes()[0], rtol=1e-3)
        assert test.state == ("after" if name == "after" else "bare")


def test_one_configuration_a_record(tests, tmp_path):
    write_merged(tmp_path / "test.toml", tests)
    experiment = cvxshear.load(tmp_path / "test.toml")
    assert [each.name for each in experiment.configurations] == ["bare", "loaded", "after"]
    assert [each.state for each in experiment.configurations] == ["bare", "bare", "after"]
    np.testing.assert_array_equal(experiment.configurations[1].added_mass, ADDED)
    assert "Modes of loaded by subspace" in (tmp_path / "test.toml").read_text()


def test_from_files_to_the_change(tests):
    """Recover the masses and the lost stiffness of the simulated records."""
    before = cvxshear.Experiment.from_dict(merged(tests[:2]))
    after = cvxshear.Experiment.from_dict(merged(tests[2:]))
    first, last = cvxshear.identify(before).frame, cvxshear.identify(after).frame
    np.testing.assert_allclose(first.floor_mass, MASSES, rtol=0.01)
    np.testing.assert_allclose(first.story_stiffness, STIFFNESSES, rtol=0.01)
    np.testing.assert_allclose(last.story_stiffness / first.story_stiffness, SOFTER, atol=0.01)


def test_the_reference_stands_where_there_is_anything_to_compare_with_it(tests):
    assert merged(tests)["frame"]["reference"] == "bare"
    assert merged(tests[:2])["frame"]["reference"] == "bare"
    repaired = dataclasses.replace(tests[2], modes=dataclasses.replace(tests[2].modes, name="repaired"), state=None)
    with pytest.raises(InputError, match="reference must be one of after, repaired, not 'bare'"):
        cvxshear.Experiment.from_dict(merged([tests[2], repaired]))
    # A single state is the frame itself, without a second state for comparison.
    one = tests[2]
    assert "reference" not in merged([one])["frame"]
    assert "reference" not in one.modes.to_experiment(one.frame, state=one.state)["frame"]
    assert one.frame["reference"] == "bare"


def test_one_that_fails_does_not_lose_the_others(folder):
    broken = folder / "broken.toml"
    broken.write_text((folder / "bare.toml").read_text().replace('"floor2"', '"flor2"'))
    noise = np.random.default_rng(0).standard_normal((2000, 4))
    np.savetxt(folder / "noise.csv", noise, delimiter=",", header="force,floor1,floor2,floor3", comments="")
    text = (folder / "bare.toml").read_text().replace('file = "bare.csv"', 'file = "noise.csv"\nsampling_rate = 50.0')
    (folder / "noise.toml").write_text(text)
    found = identify_modes_many([broken, folder / "bare.toml", folder / "noise.toml"])
    assert isinstance(found[0], InputError)
    assert str(found[0]).startswith(f"{broken}: ")
    assert "flor2" in str(found[0])
    np.testing.assert_allclose(found[1].modes.frequencies, frame("bare").modes()[0], rtol=1e-3)
    assert isinstance(found[2], NoSolutionError | InputError)
    assert "noise.toml" in str(found[2])


@pytest.mark.filterwarnings("ignore")
def test_the_same_over_dask(folder, tests):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.Client(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None),
        joblib.parallel_config(backend="dask"),
    ):
        found = identify_modes_many([folder / "bare.toml"], jobs=-1)
    np.testing.assert_array_equal(found[0].modes.frequencies, tests[0].modes.frequencies)


def test_progress_counts_records(folder):
    seen = []
    identify_modes_many(
        [folder / "bare.toml"] * 2, progress=lambda done, total: seen.append((done, total)), method="subspace"
    )
    assert seen == [(1, 2), (2, 2)]


def test_what_any_file_says_of_the_frame_stands_once():
    prior = {"kind": "value", "quantity": "floor_mass", "at": 1, "value": 5.0}
    tests = [
        given("a", "a.toml", {"total_mass": 20.0, "story_heights": 0.4}, [prior]),
        given("b", "b.toml", {"story_heights": [0.4, 0.4], "gravity": 9.8}, [dict(prior)]),
    ]
    declared = merged(tests)
    assert declared["frame"] == {"stories": 2, "total_mass": 20.0, "story_heights": 0.4, "gravity": 9.8}
    assert declared["prior"] == [prior]


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        ({"frame": {"total_mass": 20}}, {"frame": {"total_mass": 21}}, "total_mass is 20 by a.toml, 21 by b.toml"),
        ({"stories": 2}, {"stories": 3}, "stories is 2 by a.toml, 3 by b.toml; say record: stories"),
        (
            {"priors": [{"kind": "value", "quantity": "floor_mass", "at": 1, "value": 5.0}]},
            {"priors": [{"kind": "value", "quantity": "floor_mass", "at": 1, "value": 6.0}]},
            "by a.toml and .* by b.toml speak of the same thing and differ",
        ),
    ],
)
def test_contradictions_name_both_files(one, other, expected):
    with pytest.raises(InputError, match=expected):
        merged([given("a", "a.toml", **one), given("b", "b.toml", **other)])


def test_two_records_of_one_name():
    with pytest.raises(InputError, match=r'a\.toml and b\.toml are both named "same"'):
        merged([given("same", "a.toml"), given("same", "b.toml")])


def test_a_mass_that_nobody_gave():
    alone = [given("a", "a.toml"), given("b", "b.toml")]
    assert merged(alone)["frame"]["total_mass"] == 1.0
    loaded = [alone[0], dataclasses.replace(alone[1], added_mass=[0.0, 2.0])]
    assert "total_mass" not in merged(loaded)["frame"]


@pytest.fixture
def in_folder(folder, monkeypatch, shared_modes):
    """Work in the folder of the records, and identify their modes once."""
    monkeypatch.chdir(folder)
    return folder


def test_a_failure_is_named_and_the_others_are_written(run, in_folder, tmp_path):
    (in_folder / "zz.toml").write_text((in_folder / "bare.toml").read_text().replace('"floor1"', '"flor1"'))
    status, _, err = run("modes", "bare.toml", "zz.toml", "-o", tmp_path / "test.toml", "--json", tmp_path / "a.json")
    (in_folder / "zz.toml").unlink()
    assert status == 2
    assert err.startswith("cvxshear: zz.toml: ")
    assert [each.name for each in cvxshear.load(tmp_path / "test.toml").configurations] == ["bare"]
    said = json.loads((tmp_path / "a.json").read_text())
    assert [each["file"] for each in said["failed"]] == ["zz.toml"]
    assert [each["file"] for each in said["records"]] == ["bare.toml"]


def test_the_loop_names_the_softer_story(printed, in_folder, tmp_path):
    arguments = ("--effects", "story_change", "--json", tmp_path / "a.json")
    printed("loop", "bare.toml", "loaded.toml", "after.toml", *arguments)
    said = json.loads((tmp_path / "a.json").read_text())
    effect = max(said["effects"], key=lambda item: abs(next(iter(item["parameters"].values()))))
    assert (effect["name"], effect["story"]) == ("story_change", 2)
    assert next(iter(effect["parameters"].values())) == pytest.approx(-0.15, abs=0.01)
    assert len(said["records"]) == 3


def test_poles_picked_on_the_command_line_and_in_the_file(run, printed, refused, in_folder, tmp_path):
    exact = frame("bare").modes()[0]
    out = printed("modes", "bare.toml", "--pick", f"{exact[2]:.2f},{exact[0]:.2f}", "--json", "-")
    np.testing.assert_allclose(json.loads(out)["frequencies"], exact[[0, 2]], rtol=1e-3)
    text = (in_folder / "bare.toml").read_text().replace("[record]", f"[record]\npick = [{exact[1]:.2f}]")
    (in_folder / "picked.toml").write_text(text)
    out = printed("modes", "picked.toml", "--json", "-")
    (in_folder / "picked.toml").unlink()
    np.testing.assert_allclose(json.loads(out)["frequencies"], exact[[1]], rtol=1e-3)
    assert "--pick must be numbers with commas between" in refused("modes", "bare.toml", "--pick", "1;2")


def test_figures_tables_and_a_report(printed, in_folder, tmp_path):
    pytest.importorskip("openpyxl")
    printed(
        "modes", "bare.toml", "loaded.toml",
        "--figure", f"shapes:{tmp_path / 'shapes.svg'}", "--figure", tmp_path / "first.png",
        "--report", tmp_path / "report.html", "--csv", tmp_path / "modes.csv", "--xlsx",
        tmp_path / "modes.xlsx", "--quiet",
    )  # fmt: skip
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
        (["loop", "bare.toml", "paper"], "paper"),
        (["identify", "paper", "--figure", "functions:a.png"], "no figure 'functions' here; there are frame, "),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(refused, in_folder, arguments, expected):
    before = sorted(in_folder.iterdir())
    assert expected in refused(*arguments)
    assert sorted(in_folder.iterdir()) == before
