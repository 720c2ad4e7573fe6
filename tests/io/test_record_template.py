"""Create a record file from a logger's file: its columns, units and rate, and a readable record."""

import gzip
import subprocess
import sys
from datetime import datetime, timedelta

import numpy as np
import pytest
from scipy import io

from cvxshear.io import formats
from cvxshear.io.csv import Columns
from cvxshear.io.modes import modes_from_file
from cvxshear.io.record_tables import read_record
from cvxshear.util.errors import InputError
from tests.fuzz.files import columns
from tests.records.shared import TWO_STORY_FREQUENCIES, csv, two_story_frf

GRAVITY = 9.80665
"""Standard gravity, m/s2 (CGPM 1901)."""


@pytest.fixture(scope="module")
def values():
    """Return time, ground and three floors, m/s2, 20 Hz."""
    return columns()


def text(header: str, values, separator: str = ",", comma: bool = False) -> str:
    lines = [separator.join(f"{value:.9g}" for value in row) for row in values]
    rows = "\n".join(lines)
    return header + (rows.replace(".", ",") if comma else rows) + "\n"


TABS, SEMICOLONS = {"separator": "\t"}, {"separator": ";"}
HEADS = {
    "plain": ("time,ground,acc_1,acc_2,acc_3\n", {}, 1.0),
    "brackets": ("Time [s],Base [g],acc_1 (g),acc_2 (g),acc_3 (g)\n", {}, GRAVITY),
    "a line of units": ("Time,Table,a1,a2,a3\ns,mm/s2,mm/s²,mm/s^2,mm/s/s\n", {}, 1e-3),
    "a preamble": ("Logger 7\nOperator: A. B., C\n\nStart,2024-05-01\nt,ground,f1,f2,f3\n", {}, 1.0),
    "semicolons, decimal comma, Latin-1": (
        "Brücke Nord\nZeit [s];Boden [m/s²];Stock 1 [m/s²];Stock 2 [m/s²];Stock 3 [m/s²]\n",
        {"separator": ";", "comma": True},
        1.0,
    ),
    "tabs": ("t\tinput (cm/s2)\tch1 (gal)\tch2 (Gal)\tch3 (cm/s²)\n", TABS, 1e-2),
    "tabs, and no unit for the time": ("t\tinput\tch1\tch2\tch3\n\tcm/s2\tgal\tgal\tcm/s2\n", TABS, 1e-2),
    "commented header": ("# t ground a1 a2 a3\n", {"separator": " "}, 1.0),
    "a roof without a number": ("Zeit;Tisch;Etage 1;Etage 2;Dach\ns;cm/s2;cm/s2;cm/s2;cm/s2\n", SEMICOLONS, 1e-2),
    "levels of a building": ("time,GL,1F,2F,RF\ns,gal,gal,gal,gal\n", {}, 1e-2),
    "a base between other words": ("time_s,base_acc_g,f1_acc_g,f2_acc_g,f3_acc_g\n", {}, GRAVITY),
    "axes in brackets": ("Time;Base g;Level 1 (N) g;Level 2 (North), g;Level 3 (N) g\n", SEMICOLONS, GRAVITY),
    "units at the ends": ("time_s,table_x_mg,ch1_x_mg,ch2_x_mg,ch3_x_mg\n", {}, 1e-3 * GRAVITY),
}


@pytest.fixture
def begin(printed, tmp_path):
    """Return the text of the record file that `new` makes of a logger's file, and its record."""

    def call(file):
        assert printed("new", "--record", tmp_path / file, "-o", tmp_path / "record.toml") == ""
        return (tmp_path / "record.toml").read_text(encoding="utf-8"), read_record(tmp_path / "record.toml").record

    return call


def check(record, values, factor=1.0):
    assert record.sampling_rate == pytest.approx(20.0, rel=1e-6)
    assert (record.input, record.floors.tolist()) == ("base", [1, 2, 3])
    np.testing.assert_allclose(record.runs[0].responses, factor * values[:, 2:], rtol=1e-6)
    np.testing.assert_allclose(record.runs[0].excitation, factor * values[:, 1], rtol=1e-6)


@pytest.mark.parametrize("kind", HEADS)
def test_headers(kind, values, begin, tmp_path):
    header, options, factor = HEADS[kind]
    encoding = "latin-1" if "ü" in header else "utf-8"
    (tmp_path / "a.csv").write_text(text(header, values, **options), encoding=encoding)
    said, record = begin("a.csv")
    check(record, values, factor)
    # Every guess is marked: the kind of input, the time, four floors, and the units if there are any.
    assert said.count("GUESSED") == 1 + 6 + 4 * (factor != 1.0 or "m/s²" in header)


def test_a_column_that_is_no_motion_is_left_out_and_said(values, begin, tmp_path):
    table = np.column_stack([values, 20 + 0.001 * np.arange(len(values))])
    (tmp_path / "a.csv").write_text(text("time,ground,a1,a2,a3,temp_degC\n", table))
    said, record = begin("a.csv")
    check(record, values)
    assert "# Left out, no motion by its name: temp_degC" in said


def test_a_gap_is_said_and_what_a_frame_may_need_is_listed(values, begin, tmp_path):
    (tmp_path / "a.csv").write_text(text("time,ground,a1,a2,a3\n", np.delete(values, slice(300, 340), axis=0)))
    said, record = begin("a.csv")
    assert "GUESSED: mostly steps of 0.05 s, and 1 other step; gaps part a record into runs" in said
    assert [each.start for each in record.runs] == [0.0, 17.0]
    for key in ("stories = 4", 'reference = "bare"', "story_heights = 3.0"):
        assert f"\n# {key}  # " in said


CLOCKS = {
    "one column, ISO": ("Timestamp", "{:%Y-%m-%d %H:%M:%S.%f}"),
    "one column, twice twelve hours": ("Time", "{:%m/%d/%Y %I:%M:%S.%f %p}"),
    "a date and a time": ("Date;Time", "{:%Y-%m-%d};{:%H:%M:%S.%f}"),
    "a date with points and a time": ("Datum;Uhrzeit", "{:%d.%m.%Y};{:%H:%M:%S.%f}"),
}


@pytest.mark.parametrize("kind", CLOCKS)
def test_stamps(kind, values, begin, tmp_path):
    """Dates and times pass midnight, in steps of 50 ms."""
    header, form = CLOCKS[kind]
    start = datetime(2024, 5, 1, 23, 59, 45)
    stamps = [start + timedelta(seconds=0.05 * place) for place in range(len(values))]
    numbers = [";".join(f"{value:.9g}" for value in row[1:]) for row in values]
    body = "\n".join(f"{form.format(stamp, stamp)};{row}" for stamp, row in zip(stamps, numbers, strict=True))
    (tmp_path / "a.csv").write_text(f"{header};ground;a1;a2;a3\n{body}\n")
    check(begin("a.csv")[1], values)


def test_a_date_and_a_time_in_a_workbook(values, begin, tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Date", "Time", "ground", "a1", "a2", "a3"])
    start = datetime(2024, 5, 1, 23, 59, 45)
    for place, row in enumerate(values.tolist()):
        stamp = start + timedelta(seconds=0.05 * place)
        book.active.append([stamp.date(), stamp.time(), *row[1:]])
    book.save(tmp_path / "a.xlsx")
    check(begin("a.xlsx")[1], values)


@pytest.mark.parametrize(("header", "form"), [("time_s", "{:.4g}"), ("T_ms", "{:.4g}"), ("stamp no", "{:.4g}")])
def test_a_column_of_time_with_few_digits(header, form, values, printed, tmp_path):
    """Stamps have four significant digits, as a logger prints them."""
    factor = 1e3 if header == "T_ms" else 1.0
    stamps = [form.format(factor * 0.05 * place) for place in range(len(values))]
    body = "\n".join(
        ",".join([stamp, *(f"{value:.9g}" for value in row[1:])]) for stamp, row in zip(stamps, values, strict=True)
    )
    (tmp_path / "a.csv").write_text(f"{header},ground,a1,a2,a3\n{body}\n")
    out = printed("new", "--record", tmp_path / "a.csv")
    assert f'time = "{header}"' in out
    assert "floor = 3" in out
    assert "floor = 4" not in out.replace("# stories = 4", "")


@pytest.mark.parametrize("stamp", ["2024-02-31 10:00:00", "25:00:00", "10:61:00"])
def test_a_stamp_that_is_none(stamp, values, refused, tmp_path):
    (tmp_path / "a.csv").write_text(text(f"t,ground,a1,a2,a3\n{stamp},0,0,0,0\n", values))
    err = refused("new", "--record", tmp_path / "a.csv", "-o", tmp_path / "r.toml")
    assert f"line 2 holds {stamp!r}, which is no date or time" in err


def test_milliseconds(values, begin, tmp_path):
    (tmp_path / "a.csv").write_text(text("time [ms],ground,a1,a2,a3\n", values * [1e3, 1, 1, 1, 1]))
    check(begin("a.csv")[1], values)


@pytest.mark.parametrize(
    ("line", "rate"), [("Sampling rate: 20 Hz", 20.0), ("fs = 20,0", 20.0), ("SampleFreq;20", 20.0)]
)
def test_a_rate_in_the_preamble(line, rate, values, begin, tmp_path):
    (tmp_path / "a.csv").write_text(text(f"Logger\n{line}\nground;a1;a2;a3\n", values[:, 1:], ";"))
    said, record = begin("a.csv")
    check(record, values)
    assert f"sampling_rate = {rate}  # Hz, GUESSED from" in said


def test_no_rate_is_to_be_filled_in(values, run, refused, tmp_path):
    (tmp_path / "a.csv").write_text(text("ground,a1,a2,a3\n", values[:, 1:]))
    assert run("new", "--record", tmp_path / "a.csv", "-o", tmp_path / "r.toml")[0] == 0
    assert "record: give sampling_rate, in Hz" in refused("modes", tmp_path / "r.toml")
    said = (tmp_path / "r.toml").read_text().replace("# sampling_rate = 100.0", "sampling_rate = 20.0")
    (tmp_path / "r.toml").write_text(said)
    check(read_record(tmp_path / "r.toml").record, values)


RATES = {"fs": 20.0, "Fs": 20, "dt": 0.05, "sampling_rate": 20.0}


@pytest.mark.parametrize("name", RATES)
@pytest.mark.parametrize("ending", ["mat", "npz"])
def test_a_rate_as_a_number_of_its_own(ending, name, values, begin, tmp_path):
    write = io.savemat if ending == "mat" else lambda path, arrays: np.savez(path, **arrays)
    write(tmp_path / f"a.{ending}", {"ground": values[:, 1], "floors": values[:, 2:], name: RATES[name]})
    said, record = begin(f"a.{ending}")
    check(record, values)
    assert f'sampling_rate = 20  # Hz, GUESSED from "{name}" in the file' in said
    assert "the file says" not in said  # the 1 of floors[1] is no unit
    # A record file without a rate accepts it as well.
    (tmp_path / "b.toml").write_text("\n".join(each for each in said.splitlines() if "sampling_rate" not in each))
    check(read_record(tmp_path / "b.toml").record, values)


def test_several_files_are_the_runs_of_one_record(values, run, printed, refused, tmp_path):
    for place, part in enumerate((values[:300], values[300:]), 1):
        (tmp_path / f"hit{place}.csv").write_text(text("t,Hammer [N],a1,a2,a3\n", part))
    files = [tmp_path / "hit1.csv", tmp_path / "hit2.csv"]
    assert printed("new", "--record", *files, "-o", tmp_path / "r.toml") == ""
    said = (tmp_path / "r.toml").read_text().replace("input_floor = 3", "input_floor = 1", 1)
    (tmp_path / "r.toml").write_text(said)
    record = read_record(tmp_path / "r.toml").record
    assert [(each.floor, each.samples) for each in record.runs] == [(1, 300), (3, 300)]
    np.testing.assert_allclose(record.runs[1].responses, values[300:, 2:], rtol=1e-6)
    (tmp_path / "hit2.csv").write_text(text("t,Hammer [N],a1,a2\n", values[:, :4]))
    assert 'hit2.csv has no column "a3"' in refused("new", "--record", *files, "-o", tmp_path / "r2.toml")
    assert not (tmp_path / "r2.toml").exists()
    assert run("new", files[0])[0] == 2


def test_functions(run, printed, tmp_path):
    """Accelerances of a two-story frame with floors of 2 and 1 kg, with one file per driven floor."""
    frequencies = np.arange(0.0, 32.0, 1 / 64)
    for floor in (1, 2):
        functions = two_story_frf(frequencies, 0.01, floor)
        parts = np.column_stack([frequencies, *(part for each in functions.T for part in (each.real, each.imag))])
        csv(tmp_path / f"set-{floor}.csv", ["freq", "floor1_re", "floor1_im", "floor2_re", "floor2_im"], parts)
    assert printed("new", "--record", tmp_path / "set-1.csv", tmp_path / "set-2.csv", "-o", tmp_path / "r.toml") == ""
    assert "from the order of the files: the floor" in (tmp_path / "r.toml").read_text()
    result, _ = modes_from_file(tmp_path / "r.toml")
    np.testing.assert_allclose(result.frequencies, TWO_STORY_FREQUENCIES, rtol=1e-3)
    np.testing.assert_allclose(np.linalg.inv(result.mode_shapes.T @ result.mode_shapes), np.diag([2.0, 1.0]), atol=0.05)
    csv(tmp_path / "b.csv", ["freq", "floor1", "floor2"], np.column_stack([frequencies, frequencies, frequencies]))
    assert "no pair of columns such as floor1_re" in run("new", "--record", tmp_path / "b.csv")[2]


NAMES = ("time", "ground", "a1", "a2", "a3")


def xlsx(path, values):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (["Test of May"], [], ["Time [s]", "ground", "a1", "a2", "a3"], *values.tolist()):
        book.active.append(row)
    book.save(path)


WRITERS = {
    "csv.gz": lambda path, values: path.write_bytes(gzip.compress(text(",".join(NAMES) + "\n", values).encode())),
    "mat": lambda path, values: io.savemat(path, dict(zip(NAMES, values.T, strict=True))),
    "npz": lambda path, values: np.savez(path, **dict(zip(NAMES, values.T, strict=True))),
    "npy": lambda path, values: np.save(path, np.rec.fromarrays(values.T, names=",".join(NAMES))),
    "xlsx": xlsx,
}


@pytest.mark.parametrize("ending", WRITERS)
def test_kinds_of_files(ending, values, begin, tmp_path):
    WRITERS[ending](tmp_path / f"a.{ending}", values)
    check(begin(f"a.{ending}")[1], values)


def test_a_roof_over_floors_without_sensors(values, begin, tmp_path):
    (tmp_path / "a.csv").write_text(text("t,Level 2,Level 4,Roof\n", values[:, :4]))
    said, record = begin("a.csv")
    assert (record.input, record.floors.tolist()) == ("none", [2, 4, 5])
    assert "as low as it can be: CHECK how many stories there are" in said


def test_a_force(values, begin, tmp_path):
    (tmp_path / "a.csv").write_text(text("t,Hammer [kN],acc_1 [g],acc_2 [g],acc_3 [g]\n", values))
    said, record = begin("a.csv")
    assert (record.input, record.runs[0].floor) == ("force", 3)
    assert "floor = 3  # GUESSED as the top, no name says where the force acts: CHECK" in said
    np.testing.assert_allclose(record.runs[0].excitation, 1e3 * values[:, 1], rtol=1e-6)
    np.testing.assert_allclose(record.runs[0].responses, GRAVITY * values[:, 2:], rtol=1e-6)


@pytest.mark.parametrize("command", ["modes", "loop", "check", "identify"])
def test_a_command_says_how_to_begin(command, values, refused, tmp_path):
    (tmp_path / "a.csv").write_text(text("time,ground,a1,a2,a3\n", values))
    err = refused(command, tmp_path / "a.csv")
    assert f"'cvxshear new --record {tmp_path}/a.csv -o a.toml' writes a record file" in err


@pytest.mark.parametrize("header", ["Zeit [s]\tStock 1 [m/s²]\n", "t\ta1\n"])
def test_text_of_a_logger_is_no_toml(header, values, run, refused, tmp_path):
    (tmp_path / "a.txt").write_text(text(header, values[:, :2], separator="\t"), encoding="latin-1")
    assert "writes a record file" in refused("modes", tmp_path / "a.txt")
    (tmp_path / "b.txt").write_text("[record\n")
    assert "is not valid TOML" in run("modes", tmp_path / "b.txt")[2]


def test_a_format_of_ones_own(values, begin, run, tmp_path, monkeypatch):
    """One more line in the table is enough for record files, `new` and messages."""

    def read(path, limit):
        return Columns(str(path), ("time", "ground", "a1", "a2", "a3"), np.frombuffer(path.read_bytes()).reshape(-1, 5))

    monkeypatch.setattr(formats, "FORMATS", list(formats.FORMATS))
    formats.register(formats.Format("raw", (".raw64",), "raw numbers", read))
    (tmp_path / "a.raw64").write_bytes(np.ascontiguousarray(values).tobytes())
    check(begin("a.raw64")[1], values)
    assert ".raw64" in formats.endings_of("columns")
    assert "a.raw64 is raw numbers, which does not say" in run("modes", tmp_path / "a.raw64")[2]
    help_of_new = (
        "from cvxshear.io.formats import Format, register; register(Format('raw', ('.raw64',), 'raw', 'a:b'))\n"
        "from cvxshear.cli import main; main(['new', '--help'])"
    )
    said = subprocess.run([sys.executable, "-c", help_of_new], capture_output=True, text=True, check=True).stdout
    assert ".raw64" in said
    with pytest.raises(ValueError, match=r"the ending \.csv is that of delimited text already"):
        formats.register(formats.Format("mine", (".csv",), "mine", read))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read as a table: .*No such file"),
        ("1 x", r"cannot be read as a table: .*'x'"),
        ("1", "cannot be read as a table: not enough"),
    ],
)
def test_what_a_reader_of_ones_own_stumbles_on_is_an_error_of_the_file(tmp_path, content, said):
    """The file does not exist, holds no number, or has too few cells in a line."""

    def read(path):
        first, second = path.read_text().split()
        return {"frequencies": [float(first)], "mode_shapes": [[float(second)]]}

    path = tmp_path / "a.lab"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=said):
        formats.Format("lab", (".lab",), "a table", modes=read).read_modes(path)
