"""Test that a faulty record gives an error with the channel and the line."""

import numpy as np
import pytest

from cvxshear.io.modes import modes_from_file
from cvxshear.io.record_tables import read_record
from cvxshear.records import Channel, FrfRecord, FrfRun, Run, TimeRecord, identify_modes
from cvxshear.records.simulate import PAPER_FRAME, base_record
from cvxshear.util.errors import CvxshearError, InputError, NoSolutionError, UnsuitableError
from tests.records.shared import channels, csv

RECORD = """
[record]
input = "base"
file = "test.csv"
{more}
""" + channels("ground", "a1", "a2", "a3", first=0)
NAMES = ["t", "ground", "a1", "a2", "a3"]


@pytest.fixture(scope="module")
def good() -> np.ndarray:
    record = base_record(PAPER_FRAME, 0, noise=0.01, duration=150.0)
    time = np.arange(record.runs[0].samples) / 20
    return np.column_stack([time, record.runs[0].excitation, record.runs[0].responses])


def written(folder, values, more="", names=NAMES, text=RECORD):
    csv(folder / "test.csv", names, values)
    path = folder / "record.toml"
    path.write_text(text.format(more=more))
    return path


def refused(path) -> str:
    with pytest.raises(InputError) as caught:
        modes_from_file(path, output=path.parent / "out.toml")
    assert not (path.parent / "out.toml").exists()
    return str(caught.value)


def test_the_good_one_is_read(tmp_path, good):
    result, _ = modes_from_file(written(tmp_path, good))
    np.testing.assert_allclose(result.frequencies, PAPER_FRAME.modes()[0], rtol=1e-3)
    # A declared rate within one percent of the stamps' is taken.
    assert read_record(written(tmp_path, good, "sampling_rate = 20.1")).record.sampling_rate == 20.1


def test_swapped_channels(tmp_path, good):
    """They are exchanged, and the message names both with their lines."""
    sound, _ = modes_from_file(written(tmp_path, good))
    found, _ = modes_from_file(written(tmp_path, good[:, [0, 1, 3, 2, 4]]))
    (message,) = (finding.message for finding in found.findings if finding.kind == "swapped channels")
    for said in ('"a1"', '"a2"', "line 11 of record.toml", "line 15 of record.toml", "exchanged"):
        assert said in message
    np.testing.assert_allclose(found.mode_shapes, sound.mode_shapes, rtol=1e-6)


def pieces(path, pick=None):
    """Return the runs of the record in the file, and the notes of the reader."""
    found = read_record(path)
    return [(run.start, run.samples) for run in found.record.runs], [note.message for note in found.notes]


def test_pieces_beside_a_gap(tmp_path, good):
    """At 20 Hz, forty missing samples after 50 s divide the record into two runs; a short run is omitted."""
    runs, said = pieces(written(tmp_path, np.delete(good, slice(1000, 1040), axis=0)))
    assert runs == [(0.0, 1000), (52.0, len(good) - 1040)]
    assert "the clock jumps 1 time; the longest sound pieces" in said[0]
    assert "are used as runs of their own: 0 to 49.95 s, 52 to" in said[0]
    runs, said = pieces(written(tmp_path, np.delete(good, slice(100, 140), axis=0)))
    assert [samples for _, samples in runs] == [len(good) - 140]
    assert "100 of " in said[0]


def test_pieces_beside_nan(tmp_path, good):
    values = good.copy()
    values[1000:1010, 3] = np.nan
    runs, said = pieces(written(tmp_path, values))
    assert runs == [(0.0, 1000), (50.5, len(good) - 1010)]
    assert "10 of " in said[0]
    result, _ = modes_from_file(tmp_path / "record.toml")
    np.testing.assert_allclose(result.frequencies, PAPER_FRAME.modes()[0], rtol=1e-3)
    assert "pieces" in {finding.kind for finding in result.findings}


def changed(place, values):
    """Return a change of the samples: other values at a place."""

    def change(samples):
        samples = samples.copy()
        samples[place] = values(samples) if callable(values) else values
        return samples

    return change


@pytest.mark.parametrize(
    ("change", "more", "expected"),
    [
        (changed((slice(57, None, 40), 3), np.nan), "", ("test.csv, line 59", '"a2" holds nan')),
        (changed((slice(600, 2200), 3), np.nan), "", ("test.csv, line 602", '"a2" holds nan')),
        # The header is line 1, so the sample 1201 is line 1202.
        (
            changed((slice(1200, None), 0), lambda good: good[1200, 0] + np.arange(len(good) - 1200) / 50),
            "",
            ('line 1203: column "t" has two sampling rates, 20 Hz and from here 50 Hz',),
        ),
        (changed(([200, 201], 0), lambda good: good[[201, 200], 0]), "", ('line 202: column "t"',)),
        (lambda good: good, "sampling_rate = 20.3", ("sampling_rate = 20.3", "ticks at 20")),
        (lambda good: good[:3], "", ("test.csv has 3 samples",)),
        (lambda good: good[:100], "", ("at least 128 are needed",)),
        (lambda good: good[:, :4], "", ('has no column "a3"; it has t, ground, a1, a2', "line 19 of record.toml")),
    ],
)
def test_wrong_samples(tmp_path, good, change, more, expected):
    values = change(good)
    message = refused(written(tmp_path, values, more, names=NAMES[: values.shape[1]]))
    assert [part for part in expected if part not in message] == []


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            lambda lines: [*lines[:12], lines[12].rpartition(",")[0] + ",overload", *lines[13:]],
            "test.csv, line 13: column \"a3\" holds 'overload', which is not a number",
        ),
        (lambda lines: [], "test.csv is empty"),
        (lambda lines: lines[:1], "has a header and no samples"),
        (lambda lines: [*lines, "1,2"], "line 3002 has 2 cells where the header names 5 columns"),
        (None, "test.csv: no such file"),
    ],
)
def test_wrong_text(tmp_path, good, change, expected):
    path, table = written(tmp_path, good), tmp_path / "test.csv"
    if change is None:
        table.unlink()
    else:
        table.write_text("\n".join(change(table.read_text().splitlines())))
    assert expected in refused(path)


def test_an_empty_cell_is_missing(tmp_path, good):
    path = written(tmp_path, good)
    lines = (tmp_path / "test.csv").read_text().splitlines()
    cells = lines[30].split(",")
    lines[30] = ",".join([*cells[:2], "", *cells[3:]])
    (tmp_path / "test.csv").write_text("\n".join(lines))
    assert pieces(path)[0] == [(1.5, len(good) - 30)]


@pytest.mark.parametrize(("start", "end", "samples"), [(10.0, 40.0, 600), (10.0, None, None), (None, 30.0, 600)])
def test_start_and_end(tmp_path, good, start, end, samples):
    said = "".join(f"{key} = {value}\n" for key, value in (("start", start), ("end", end)) if value is not None)
    path = written(tmp_path, good)
    path.write_text(path.read_text().replace('file = "test.csv"', "") + f'\n[[run]]\nfile = "test.csv"\n{said}')
    run = read_record(path).record.runs[0]
    assert run.samples == (len(good) - 200 if samples is None else samples)
    first = 200 if start else 0
    np.testing.assert_allclose(run.responses[:, 0], good[first : first + run.samples, 2], rtol=1e-6)


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("g", 9.80665), ("m/s2", 1.0), ("mm/s2", 1e-3), ("cm/s2", 1e-2), ("gal", 1e-2), ("in/s2", 0.0254)],
)
def test_units_of_a_channel(tmp_path, good, unit, factor):
    more = f'floor = 3\nunit = "{unit}"\nposition = [1.0, -2]\ndirection = 90'
    record = read_record(written(tmp_path, good, text=RECORD.replace("floor = 3", more))).record
    np.testing.assert_allclose(record.runs[0].responses[:, 2], factor * good[:, 4], rtol=1e-5)
    top = record.channels[2]
    assert (top.unit, top.position, top.direction) == (unit, (1.0, -2.0), 90.0)


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ('unit = "furlong"', "unit must be one of m/s2, g, "),
        ('unit = "kN"\nquantity = "acceleration"', "unit = 'kN' is one of force, not of acceleration"),
        ("position = [1.0]", "position (m, along and across) must have 2 entries, not 1"),
        ('direction = "north"', "direction (degrees) must be a number, not 'north'"),
    ],
)
def test_units_and_places_that_are_wrong(tmp_path, good, more, expected):
    assert expected in refused(written(tmp_path, good[:200], text=RECORD.replace("floor = 3", f"floor = 3\n{more}")))


def test_a_run_that_ends_before_it_starts(tmp_path, good):
    path = written(tmp_path, good)
    text = path.read_text().replace('file = "test.csv"', "")
    path.write_text(text + '\n[[run]]\nfile = "test.csv"\nstart = 5\nend = 4\n')
    assert "run 1: end = 4 s must come after start = 5 s" in refused(path)
    path.write_text(text + '\n[[run]]\nfile = "test.csv"\nstart = 1e6\n')
    assert "has 0 samples between start and end of the run; it lasts" in refused(path)


def test_two_runs_of_two_rates(tmp_path, good):
    csv(tmp_path / "one.csv", NAMES, good)
    slow = good.copy()
    slow[:, 0] *= 2
    csv(tmp_path / "two.csv", NAMES, slow)
    text = RECORD.replace('file = "test.csv"', "") + '\n[[run]]\nfile = "one.csv"\n[[run]]\nfile = "two.csv"\n'
    path = tmp_path / "record.toml"
    path.write_text(text.format(more=""))
    message = refused(path)
    assert "two.csv is sampled at 10 Hz" in message


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('input = "base"', 'input = "bass"', "must be one of none, free_decay, force, base, not 'bass'; did you mean"),
        ("floor = 3", "flor = 3", "unknown key 'flor'; did you mean 'floor'?"),
        ("floor = 3", "floor = 3\nsign = 2", "sign must be 1 or -1, not 2"),
        ("floor = 3", "floor = 3\ncalibration = 0.0", "calibration = 0 must be greater than 0"),
        ('column = "a3"', 'column = "a2"', 'channel "a2" was declared before, in line 15'),
        ("floor = 0", "floor = 4", 'input = "base" needs one channel on the ground'),
        ('input = "base"', 'input = "force"', 'needs one channel with quantity = "force"'),
        ("floor = 3", "floor = 3\naxis = 'y'", "the channels point along x, y; say which with record: axis"),
        ('input = "base"', 'input = "base"\nband = [5.0, 2.0]', "must be ascending, in Hz"),
        (RECORD, "[record]", "record.toml: the key 'channel' is missing"),
        ("[record]", "[recrd]", "unknown key 'recrd'; did you mean 'record'?"),
        ('input = "base"', 'input = "base', "is not valid TOML"),
    ],
)
def test_wrong_record_file(tmp_path, good, old, new, expected):
    message = refused(written(tmp_path, good[:200], text=RECORD.replace(old, new)))
    assert expected in message
    assert str(tmp_path) in message


def test_frf_on_different_lines(tmp_path):
    frequencies = np.arange(1, 65) / 8
    columns = np.column_stack([frequencies, np.ones((64, 2))])
    csv(tmp_path / "one.csv", ["frequency", "a1_re", "a1_im"], columns)
    columns[:, 0] *= 2
    csv(tmp_path / "two.csv", ["frequency", "a1_re", "a1_im"], columns)
    path = tmp_path / "record.toml"
    path.write_text(
        '[record]\nkind = "frf"\n[[channel]]\ncolumn = "a1"\nfloor = 1\n'
        '[[run]]\nfile = "one.csv"\ninput_floor = 1\n[[run]]\nfile = "two.csv"\ninput_floor = 1\n'
    )
    assert "different frequency lines" in refused(path)


def test_uneven_frequency_lines():
    frequencies = np.concatenate([np.arange(1, 40), np.arange(41, 80)]) * 0.5
    with pytest.raises(InputError, match=r"after 19\.5 Hz comes 20\.5 Hz where the step is 0\.5 Hz"):
        FrfRecord((Channel("a", 1),), runs=(FrfRun(np.ones((78, 1)), 1),), frequencies=frequencies)


def test_arrays_are_checked_too():
    values = np.random.default_rng(0).standard_normal((500, 2))
    values[7, 1] = np.inf
    with pytest.raises(InputError, match='channel "b" \\(floor 2\\) holds inf at sample 8'):
        TimeRecord((Channel("a", 1), Channel("b", 2)), runs=(Run(values),), sampling_rate=50.0)


def test_unsuitable_method_names_a_suitable_one():
    record = base_record(PAPER_FRAME, 0, noise=0.01, duration=60.0)
    with pytest.raises(UnsuitableError, match='method "ssi" cannot use input = "base"; use "subspace"'):
        identify_modes(record, method="ssi")
    with pytest.raises(InputError, match="did you mean 'subspace'"):
        identify_modes(record, method="subspac")


def test_noise_alone_has_no_modes():
    values = np.random.default_rng(3).standard_normal((4000, 3))
    channels = tuple(Channel(f"a{floor}", floor) for floor in (1, 2, 3))
    record = TimeRecord(channels, runs=(Run(values),), sampling_rate=50.0)
    with pytest.raises(CvxshearError) as caught:
        identify_modes(record)
    assert isinstance(caught.value, NoSolutionError | InputError)
