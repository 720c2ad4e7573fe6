"""Test readers and writers: the same record in every format, and a round trip of modes."""

import tomllib

import numpy as np
import pytest
from scipy import io

import cvxshear
from cvxshear.io.arrays import read_mat, read_uff
from cvxshear.io.csv import read_csv
from cvxshear.io.modes import write_merged
from cvxshear.io.record_tables import read_record
from cvxshear.io.toml import write_measurement
from cvxshear.records import IdentifiedRecord, from_arrays
from cvxshear.util.errors import InputError
from tests.fuzz.files import write_universal
from tests.records.shared import channels, csv

NAMES = ["t", "force", "a1", "a2"]
CHANNELS = """
[[channel]]
column = "force"
quantity = "force"
floor = 2
calibration = 10.0

[[channel]]
column = "a2"
floor = 2
sign = -1

[[channel]]
column = "a1"
floor = 1
calibration = 2.0
"""


@pytest.fixture
def values() -> np.ndarray:
    random = np.random.default_rng(4)
    return np.column_stack([np.arange(300) / 50, random.standard_normal((300, 3))])


def record_file(folder, file, more="", channels=CHANNELS, driven="force"):
    path = folder / "record.toml"
    path.write_text(f'[record]\ninput = "{driven}"\nfile = "{file}"\n{more}\n{channels}')
    return path


def check(record, values):
    assert record.sampling_rate == pytest.approx(50.0)
    np.testing.assert_array_equal(record.floors, [1, 2])
    assert record.runs[0].floor == 2
    np.testing.assert_allclose(record.runs[0].responses[:, 0], 2 * values[:, 2], rtol=1e-6)
    np.testing.assert_allclose(record.runs[0].responses[:, 1], -values[:, 3], rtol=1e-6)
    np.testing.assert_allclose(record.runs[0].excitation, 10 * values[:, 1], rtol=1e-6)


def test_csv(tmp_path, values):
    csv(tmp_path / "a.csv", NAMES, values)
    check(read_record(record_file(tmp_path, "a.csv")).record, values)


@pytest.mark.parametrize(("separator", "comma"), [(";", True), ("\t", False), (" ", False)])
def test_other_separators(tmp_path, values, separator, comma):
    lines = [separator.join(NAMES)]
    lines += [separator.join(f"{value:.9g}" for value in row) for row in values]
    text = "# a comment\n" + "\n".join(lines)
    (tmp_path / "a.txt").write_text(text.replace(".", ",") if comma else text, encoding="utf-8-sig")
    check(read_record(record_file(tmp_path, "a.txt")).record, values)


def test_line_numbers_count_comments(tmp_path):
    rows = "\n".join("1,2" for _ in range(40))
    (tmp_path / "a.csv").write_text(f"# made by hand\n\na,b\n{rows}\n3,x\n")
    with pytest.raises(InputError, match=r'line 44: column "b" holds \'x\''):
        read_csv(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("read", "name", "content", "said"),
    [
        (read_csv, "a.csv", b"1,2\n3,4\n", "line 1: the first line must name the columns"),
        (read_mat, "a.mat", b"nothing of the kind" * 20, "cannot be read as a MAT file"),
        (read_uff, "a.uff", b"nothing\n", r"a\.uff"),
        (read_uff, "b.uff", None, "no such file"),
    ],
)
def test_a_file_that_is_none_of_its_kind(tmp_path, read, name, content, said):
    if read is read_uff:
        pytest.importorskip("pyuff")
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said):
        read(tmp_path / name)


def test_mat_version_5(tmp_path, values):
    io.savemat(tmp_path / "a.mat", {"t": values[:, 0], "force": values[:, 1], "test": {"acc": values[:, 2:]}, "n": 3})
    channels = CHANNELS.replace('"a2"', '"test.acc[2]"').replace('"a1"', '"test.acc[1]"')
    check(read_record(record_file(tmp_path, "a.mat", channels=channels)).record, values)


def test_every_array_of_a_mat_file_is_what_scipy_wrote_there(tmp_path, values):
    held = {
        "whole": np.arange(300, dtype=np.int16), "large": np.arange(600, dtype=np.uint64).reshape(300, 2) + 2**52,
        "single": values[:, 1].astype(np.float32), "logical": values[:, 1] > 0, "few": np.arange(3.0),
        "complex": values[:, 2] + 1j * values[:, 1], "cells": np.array([values[:, 0], "x"], dtype=object),
        "run": {"a": values[:, 2:], "inner": {"b": values[:, [1]].T}, "text": "words"},
    }  # fmt: skip
    for compress in (False, True):
        io.savemat(tmp_path / "a.mat", held, do_compression=compress)
        ours = read_mat(tmp_path / "a.mat")
        expected = {
            "whole": held["whole"], "large[1]": held["large"][:, 0], "large[2]": held["large"][:, 1],
            "single": held["single"], "logical": held["logical"], "complex_re": values[:, 2],
            "complex_im": values[:, 1], "cells[1]": values[:, 0], "run.inner.b": values[:, 1],
            **{f"run.a[{place + 1}]": column for place, column in enumerate(values[:, 2:].T)},
        }  # fmt: skip
        assert set(ours.names) == set(expected)
        for name, column in expected.items():
            np.testing.assert_array_equal(ours.values[:, ours.names.index(name)], column)


EARTHQUAKE = channels("{0}", "{1}", first=0)


@pytest.mark.parametrize(
    ("ground", "roof"), [("*.acc[1]", "*.acc[2]"), ("quake[*].g", "quake[*].r"), ("g_*", "r_*"), ("a[*][1]", "a[*][2]")]
)
def test_earthquakes_in_one_file_are_runs(tmp_path, ground, roof):
    random = np.random.default_rng(6)
    lengths = [300, 260, 280] if "a[" not in ground else [300] * 3
    motions = [random.standard_normal((length, 2)) for length in lengths]
    if ground == "*.acc[1]":
        tables = {f"eq{number}": {"acc": each, "dt": 0.02} for number, each in enumerate(motions, 9)}
    elif ground == "g_*":
        tables = {f"{name}_{number}": each[:, place] for number, each in enumerate(motions) for place, name in
                  enumerate("gr")} | {"fs": 50.0}  # fmt: skip
    elif ground == "quake[*].g":
        tables = {"quake": [{"g": each[:, 0], "r": each[:, 1]} for each in motions], "fs": 50.0}
    else:
        tables = {"a": np.stack(motions, axis=2), "fs": 50.0}
    io.savemat(tmp_path / "quakes.mat", tables)
    record = read_record(record_file(tmp_path, "quakes.mat", "", EARTHQUAKE.format(ground, roof), "base")).record
    assert record.sampling_rate == pytest.approx(50.0)
    assert len({run.name for run in record.runs}) == 3
    for run, each in zip(record.runs, motions, strict=True):
        np.testing.assert_allclose(np.column_stack([run.excitation, run.responses]), each)


def test_an_earthquake_without_a_channel_is_named(tmp_path):
    io.savemat(tmp_path / "quakes.mat", {"eq1": {"g": np.ones(300), "r": np.ones(300)}, "eq2": {"g": np.ones(300)}})
    path = record_file(tmp_path, "quakes.mat", "sampling_rate = 50", EARTHQUAKE.format("*.g", "*.r"), "base")
    with pytest.raises(InputError, match=r'quakes.mat, eq2: there is no column "eq2.r"'):
        read_record(path)
    path.write_text(path.read_text().replace("*.g", "shake*.g"))
    with pytest.raises(InputError, match=r'has no column "shake\*.g"'):
        read_record(path)


@pytest.mark.parametrize(("unit", "times"), [("mm/s", 1), ("mm", 2)])
def test_a_ground_that_moves_is_differentiated(tmp_path, unit, times):
    time = np.arange(4000) / 100.0
    phases, w = np.array([0.3, 1.1, 2.0]), 2 * np.pi * np.array([0.8, 2.1, 5.3])
    size = np.array([0.5, 1.0, 2.0])
    moved = size / (1j * w) ** times * np.exp(1j * (np.outer(time, w) + phases))
    noise = 1e-3 * np.random.default_rng(7).standard_normal(len(time))
    roof = (size * np.exp(1j * (np.outer(time, w) + phases))).sum(axis=1).real
    csv(tmp_path / "record.csv", ["g", "r"], np.column_stack([1000 * moved.sum(axis=1).real + noise, roof]))
    channels = EARTHQUAKE.format("g", "r").replace("floor = 0", f'floor = 0\nunit = "{unit}"')
    found = read_record(record_file(tmp_path, "record.csv", "sampling_rate = 100", channels, "base"))
    inner = slice(100, -100)
    np.testing.assert_allclose(found.record.runs[0].excitation[inner], roof[inner], atol=0.05)
    (note,) = found.notes
    assert note.kind == "ground"
    assert 5.3 < note.numbers["noise_from"] < 30.0


def test_mat_version_7(tmp_path, values):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["t"], file["force"] = values[:, [0]].T, values[:, [1]].T
        file["acc"] = values[:, 2:].T
        file["h"] = np.zeros((1, 300), dtype=[("real", "f8"), ("imag", "f8")])
    header = b"MATLAB 7.3 MAT-file".ljust(512)
    content = (tmp_path / "a.mat").read_bytes()
    (tmp_path / "a.mat").write_bytes(header + content[512:])
    channels = CHANNELS.replace('"a2"', '"acc[2]"').replace('"a1"', '"acc[1]"')
    check(read_record(record_file(tmp_path, "a.mat", channels=channels)).record, values)
    assert {"h_re", "h_im"} <= set(read_mat(tmp_path / "a.mat").names)


def test_universal_file(tmp_path, values):
    columns = dict(zip([(9, 1), (1, 1), (2, -1)], values.T[1:], strict=True))
    write_universal(tmp_path / "a.uff", columns, 0.02)
    channels = CHANNELS.replace('"force"\nquantity', '"9x"\nquantity').replace('"a2"', '"2x-"').replace('"a1"', '"1x"')
    record = read_record(record_file(tmp_path, "a.uff", channels=channels)).record
    check(record, values)


def test_universal_file_of_one_set(tmp_path, values):
    write_universal(tmp_path / "a.uff", {(1, 1): values[:, 2]}, 0.02)
    path = tmp_path / "record.toml"
    path.write_text('[record]\nfile = "a.uff"\n[[channel]]\ncolumn = "1x"\nfloor = 1\n')
    np.testing.assert_allclose(read_record(path).record.runs[0].responses[:, 0], values[:, 2], rtol=1e-5)


def test_measurement_file_says_what_was_given(tmp_path):
    tested = {"frequencies": [1.0, 2.5e-1 * 8], "mode_shapes": [[0.5, float("nan")], [1.0, -0.25]]}
    tested |= {"name": 'an "odd" name\\', "modes": [1, 2], "mass_normalized": False}
    ratio = {"kind": "ratio", "quantity": "story_stiffness", "of": 1, "to": 2, "value": 1.0, "std": 0.1}
    declared = {"frame": {"stories": 2, "total_mass": 12.0}, "prior": [ratio], "configuration": [tested]}
    write_measurement(tmp_path / "a.toml", declared, ["a comment\nthat [breaks] its line", "word " * 60])
    text = (tmp_path / "a.toml").read_text()
    again = tomllib.loads(text)
    assert np.isnan(again["configuration"][0]["mode_shapes"][0].pop())
    assert np.isnan(declared["configuration"][0]["mode_shapes"][0].pop())
    assert again == declared
    assert all(len(line) <= 120 for line in text.splitlines())


def test_frame_and_priors_pass_through(tmp_path, values):
    csv(tmp_path / "a.csv", NAMES, values)
    more = "[frame]\ntotal_mass = 20.0\nstory_heights = 0.4\n[[prior]]\nkind = 'monotone'\n"
    more += "quantity = 'story_stiffness'\ndirection = 'decreasing'"
    path = record_file(tmp_path, "a.csv", more)
    path.write_text("added_mass = [0.0, 1.5]\n" + path.read_text())
    found = read_record(path)
    given = from_arrays([3.0, 9.0], [[0.5, 1.0], [1.0, -0.6]])
    test = IdentifiedRecord("a.toml", given, found.frame, found.priors, found.added_mass)
    write_merged(tmp_path / "out.toml", [test])
    experiment = cvxshear.load(tmp_path / "out.toml")
    assert experiment.frame.total_mass == 20.0
    assert len(experiment.priors) == 1
    np.testing.assert_array_equal(experiment.configurations[0].added_mass, [0.0, 1.5])


def test_a_file_that_would_be_refused_is_not_written(tmp_path):
    given = from_arrays([3.0, 9.0], [[0.5, 1.0], [1.0, -0.6]])
    with pytest.raises(InputError, match="floor_masses"):
        write_merged(tmp_path / "out.toml", [IdentifiedRecord("a.toml", given, {"floor_masses": [1.0, -2.0]})])
    assert not list(tmp_path.iterdir())


def test_an_unknown_mass_is_said(tmp_path):
    given = from_arrays([3.0, 9.0], [[0.5, 1.0], [1.0, -0.6]])
    write_merged(tmp_path / "out.toml", [IdentifiedRecord("a.toml", given, {})])
    said = " ".join((tmp_path / "out.toml").read_text().replace("\n#", " ").split())
    assert "nothing tells how heavy the frame is: total_mass = 1 is written in its place" in said
    assert cvxshear.load(tmp_path / "out.toml").frame.total_mass == 1.0


@pytest.mark.parametrize("direction", [100, -100])
def test_a_direction_that_the_universal_file_does_not_know_has_its_number(tmp_path, values, direction):
    write_universal(tmp_path / "a.uff", {(1, 1): values[:, 2]}, 0.02)
    text = (tmp_path / "a.uff").read_text()
    lines = text.splitlines()
    head = lines[7]
    assert head[41:55] == "         1   1"
    lines[7] = f"{head[:51]}{direction:4d}{head[55:]}"
    (tmp_path / "a.uff").write_text("\n".join(lines) + "\n")
    assert read_uff(tmp_path / "a.uff").names == ("time", "1d100" if direction > 0 else "1d100-")


def test_rows_of_a_shape_are_lines_of_the_file(tmp_path):
    shapes = [[0.1234567891, float("nan")], [1.0, -2.5e-7]]
    declared = {"configuration": [{"name": "a [\n1,\n] b", "frequencies": [3, 9.5], "mode_shapes": shapes}]}
    write_measurement(tmp_path / "a.toml", declared, ["said\n of\x1b it"])
    text = (tmp_path / "a.toml").read_text(encoding="utf-8")
    assert text.startswith("# said of\\x1b it\n\n")
    assert "frequencies = [3, 9.5]\n" in text
    assert "    [0.12345679, nan],\n    [1.0, -2.5e-07],\n" in text
    assert tomllib.loads(text)["configuration"][0]["name"] == "a [\n1,\n] b"
