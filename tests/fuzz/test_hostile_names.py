"""Put harmful names through every output of every command: no formula, control character or traceback comes out."""

import ast
import csv
import functools
import io
import json
import re
import sys
import tempfile
import tomllib
import unicodedata
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cvxshear import compare_backends
from cvxshear.io.toml import load
from cvxshear.records import identify_modes
from cvxshear.screening.mistakes import mistakes
from cvxshear.util.writing import cell_text
from tests.io.campaign import write_records

NAMES = (
    # Spreadsheets read these as formulas; some hide the formula.
    "=1+1", "+1+1", "-1+1", "@SUM(1+1)", '=HYPERLINK("http://x.y","z")', "=cmd|' /C calc'!A0", "＝1+1", "＋1", "－1",
    "＠A1", " =1+1", "'=1+1", "a,=1+1", "a;=1+1", 'a",=1+1', "a\t=1+1", "a\n=1+1", "\t=1+1", "\r=1+1", "\n=1+1",
    "0x1p3", "1e5",
    # These control a terminal, or some file types cannot hold them.
    "a\x00b", "a\x01b", "\x07", "\x1b[31mred", "\x1b]0;t\x07", "a\x7fb", "a\x85b", "a\x9bb", "a\u2028b", "a\u202eb",
    "a\u200bb", "\ufeffa", "a\ufffe", "a\r\nb",
    # These end a string, a comment or an element, or are markup.
    '"""', "'''", "\\", "a\\", "*/", "]]>", "--><script>alert(1)</script>", "<b>&amp;", "[bold]a[/bold]", "$\\frac{$",
    "{title}", "{0}", "%s", "[/]", "#",
    # These are invalid as names of a sheet, or two of them collide.
    "History", "history", "a/b\\c?*[1]:", "'a'", "x" * 40, "x" * 41, "X" * 40,
)  # fmt: skip
WORST = ("$\\frac{$", "a\x00b", "\x1b[31mred", "a\u202eb", "<b>&amp;", "]]>", "--><script>alert(1)</script>", "x" * 41)
"""One name of each kind that a drawing or a page cannot hold unchanged. These go through every figure of every
report."""

MASSES = (10.0, 8.0)
STIFFNESSES = (20e3, 15e3)
FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠", "\t", "\r")
"""First letters of a formula in spreadsheet programs (OWASP)."""


def toml_string(name: str) -> str:
    """Write a TOML string with every letter as a number, without the writer under test."""
    return '"' + "".join(f"\\U{ord(each):08x}" for each in name) + '"'


def configuration(name: str, added: float) -> str:
    """Return a configuration of two floors with its exact modes to six digits."""
    m1, m2 = MASSES[0], MASSES[1] + added
    k1, k2 = STIFFNESSES
    # The quadratic in omega^2 of two floors.
    a, b, c = m1 * m2, -((k1 + k2) * m2 + k2 * m1), k1 * k2
    squares = [(-b - sign * (b * b - 4 * a * c) ** 0.5) / (2 * a) for sign in (1, -1)]
    shapes = [[1.0, (k1 + k2 - each * m1) / k2] for each in squares]
    return (
        f"[[configuration]]\nname = {toml_string(name)}\nadded_mass = [0, {added}]\n"
        f"frequencies = {[round(each**0.5 / (2 * np.pi), 6) for each in squares]}\n"
        f"mode_shapes = {np.round(shapes, 6).tolist()}\nfrequency_std = 0.001\nmode_shape_std = 0.01\n"
        "damping_ratios = 0.01\n"
    )


def measurement(path, names):
    parts = [configuration(name, 0.25 * (place % 8)) for place, name in enumerate(names)]
    path.write_text("[frame]\ntotal_mass = 18.0\nstory_heights = 3.0\n" + "".join(parts), encoding="utf-8")
    assert [each.name for each in load(path).configurations] == list(names)
    return path


def sound_text(text: str, kind: str) -> None:
    """Assert that a text is valid for its kind, and has no character that controls, reverses or hides text."""
    found = {each for each in text if unicodedata.category(each) in ("Cc", "Cf", "Zl", "Zp", "Cs") and each != "\n"}
    assert not found, (kind, found)
    if kind == ".json":
        json.loads(text)
    elif kind == ".toml":
        tomllib.loads(text)
    elif kind == ".py":
        compile(ast.parse(text), "script", "exec")
    elif kind == ".svg":
        ElementTree.fromstring(text)
    elif kind == ".csv":
        for row in csv.reader(io.StringIO(text)):
            assert not [cell for cell in row if cell.lstrip(" '") != cell and not cell.startswith(("'", " "))]
            assert not [cell for cell in row if formula(cell)], row


def formula(cell: str) -> bool:
    """Return whether a program would read a cell as a formula. A number with its sign is no formula."""
    try:
        float(cell)
    except ValueError:
        return cell.lstrip(" ").startswith(FORMULA)
    return False


def sound_workbook(content: bytes) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.load_workbook(io.BytesIO(content))
    titles = book.sheetnames
    assert len({each.lower() for each in titles}) == len(titles)
    assert all(len(each) <= 31 and not re.search(r"[\\/*?:\[\]]", each) and each.strip("'") == each for each in titles)
    for text in titles:
        sound_text(text, ".xlsx")
    for page in book:
        for row in page.iter_rows():
            for cell in row:
                assert cell.data_type != "f"
                if isinstance(cell.value, str):
                    sound_text(cell.value, ".xlsx")
                    assert not formula(cell.value)


def sound(path) -> None:
    content = path.read_bytes()
    assert content
    if path.suffix == ".xlsx":
        sound_workbook(content)
    elif path.suffix in (".json", ".toml", ".py", ".svg", ".csv", ".html"):
        sound_text(content.decode("utf-8"), path.suffix)


def check(printed, folder, *arguments, outputs, as_json=True) -> None:
    """Run a command with all its outputs and check each; if `as_json`, also check JSON on standard output."""
    options = [part for option, name in outputs for part in (option, name.replace("OUT", str(folder / "out")))]
    out = printed(*arguments, *options)
    sound_text(out, "terminal")
    for _, name in outputs:
        sound(folder / f"out{name.partition('OUT')[2]}")
    if as_json:
        out = printed(*arguments, "--json", "-")
        sound_text(out, ".json")


OPTIONS = {".json": "--json", ".csv": "--csv", ".xlsx": "--xlsx", ".html": "--report", ".toml": "-o"}


def into(*endings: str, figures=()) -> list[tuple[str, str]]:
    """Return the options that request files of these endings, and these figures."""
    drawn = [("--figure", f"{kind}:OUT-{kind}.svg") for kind in figures]
    return [(OPTIONS[ending], f"OUT{ending}") for ending in endings] + drawn


SOUND: set[tuple[bytes, bytes]] = set()
"""Added masses and frequencies of sound tests, whatever their names."""


@pytest.fixture(autouse=True)
def looked_at_once(monkeypatch):
    """Search for mistakes only once in tests that differ in names alone."""

    def found(test):
        key = test.added_mass.tobytes(), test.frequencies.tobytes()
        if key not in SOUND:
            assert not mistakes(test)
            SOUND.add(key)
        return []

    monkeypatch.setattr(sys.modules[mistakes.__module__], "mistakes", found)


def few(start: int) -> list[str]:
    return list(NAMES[start::6])


@pytest.mark.parametrize("start", range(6))
def test_identify(start, printed, tmp_path):
    file = measurement(tmp_path / "a.toml", few(start))
    kinds = into(".json", ".csv", ".xlsx", figures=["frame", "mac"])
    check(printed, tmp_path, "identify", file, outputs=kinds, as_json=start == 0)


def test_identify_each_configuration(printed, tmp_path):
    file = measurement(tmp_path / "a.toml", NAMES)
    kinds = into(".json", ".csv", ".xlsx")
    check(printed, tmp_path, "identify", file, "--method", "two-stage", outputs=kinds, as_json=False)


@pytest.fixture
def one_comparison(monkeypatch):
    """Reuse one comparison of backends in every report; it contains no name of a file."""
    page = pytest.importorskip("cvxshear.report.html")
    monkeypatch.setattr(page, "compare_backends", lambda *_, **__: comparison())


@functools.cache
def comparison():
    return compare_backends(load("paper"), ["kkt", "clarabel"], repeats=1)


@pytest.mark.parametrize("start", range(6))
def test_loop(start, printed, tmp_path, one_comparison, monkeypatch):
    """Draw two figures with all names. The next test checks the figures of the report."""
    file = measurement(tmp_path / "a.toml", few(start))
    monkeypatch.setattr("cvxshear.report.html.drawings", lambda *_: {})
    kinds = into(".json", ".csv", ".xlsx", ".html", figures=["frame", "mac"])
    check(printed, tmp_path, "loop", file, "--effects", "ground_spring", outputs=kinds, as_json=False)


def test_a_report_of_a_loop(printed, tmp_path, one_comparison, shared_loops):
    """A figure fails on these names if it does not escape them."""
    file = measurement(tmp_path / "a.toml", WORST)
    check(printed, tmp_path, "loop", file, "--effects", "ground_spring", outputs=into(".html"))


def test_check(printed, tmp_path):
    check(printed, tmp_path, "check", measurement(tmp_path / "a.toml", NAMES), outputs=into(".json"))


def test_backends(printed, tmp_path):
    file = measurement(tmp_path / "a.toml", few(0)[:4])
    check(printed, tmp_path, "backends", file, "--names", "kkt,clarabel", "--repeats", "1", outputs=into(".json"))


@pytest.mark.parametrize("start", range(0, 6, 3))
def test_plan(start, printed, tmp_path):
    file = measurement(tmp_path / "a.toml", few(start))
    kinds = into(".json", ".toml", ".csv")
    check(printed, tmp_path, "plan", file, "--added-mass", "5", outputs=kinds)


SAMPLES = 960
"""Samples of the record. It is short because the identified values do not matter here; the names do."""

PIECES = 6
"""Number of pieces left out in turn for the standard deviations. Their values do not matter here."""


@pytest.fixture
def few_pieces(monkeypatch):
    monkeypatch.setattr("cvxshear.io.modes.identify_modes", functools.partial(identify_modes, blocks=PIECES))


@functools.cache
def shaken():
    """Return a shortened record file and its table."""
    with tempfile.TemporaryDirectory() as folder:
        (file,) = write_records(Path(folder), "\n[frame]\ntotal_mass = 22.5\n", ("bare",))
        text = file.read_text(encoding="utf-8")
        return text, (Path(folder) / "bare.csv").read_text().splitlines()[: 1 + SAMPLES]


def records(folder, names, states=(), others=()) -> list:
    """Write files of one record with these names for record, file, state, and third and second channel."""
    text, (header, *rows) = shaken()
    made = []
    for place, name in enumerate(names):
        (folder / f"{place}").mkdir()
        renamed = {"floor3": name.strip() or "c"}
        if others:
            renamed["floor2"] = others[place].strip() or "d"
        line = ",".join(quoted(renamed.get(each, each)) for each in header.split(","))
        (folder / f"{place}" / "data.csv").write_text("\n".join([line, *rows]), encoding="utf-8")
        columns = [each.strip() for each in next(csv.reader([line]))]
        said = text.replace('"bare.csv"', '"data.csv"')
        for before, column in zip(header.split(","), columns, strict=True):
            said = said.replace(f'"{before}"', toml_string(column))
        path = folder / f"{place}" / f"{file_name(name)}.toml"
        said = said.replace("[record]", f"[record]\nname = {toml_string(name)}")
        state = states[place] if states else name
        path.write_text(said.replace('state = "bare"', f"state = {toml_string(state)}"), encoding="utf-8")
        made.append(path)
    return made


def quoted(name: str) -> str:
    """Return a cell of CSV on one line."""
    return '"' + name.replace('"', '""').replace("\n", " ").replace("\r", " ") + '"'


def file_name(name: str) -> str:
    return name.replace("/", " ").replace("\0", " ")[:80]


@pytest.mark.parametrize("start", range(6))
def test_modes(start, printed, tmp_path, few_pieces):
    made = records(tmp_path, few(start)[:5])
    check(printed, tmp_path, "modes", *made, outputs=into(".json", ".csv", ".xlsx", ".toml"), as_json=False)


def test_a_report_of_modes(printed, tmp_path, few_pieces):
    """A report of modes draws four figures per record. Here each name in a record file is hostile in turn."""
    made = records(tmp_path, WORST[:2], WORST[2:4], WORST[4:6])
    check(printed, tmp_path, "modes", *made, outputs=into(".html"), as_json=False)


@pytest.mark.parametrize("start", range(6))
def test_figures_and_files_of_one_record(start, printed, tmp_path, few_pieces):
    (made,) = records(tmp_path, few(start)[:1], few(start)[1:2], few(start)[2:3])
    kinds = into(".csv", ".xlsx", figures=["shapes", "stabilization"])
    check(printed, tmp_path, "modes", made, outputs=kinds, as_json=False)


PLACED = (*WORST, "=1+1", '=HYPERLINK("http://x.y","z")', "＠A1", "a\n=1+1", '"""', "\\", "{0}", "[/]")
"""Names that can break drawings, pages, tables, scripts and terminals, for the four names in a prediction."""


@pytest.mark.parametrize("start", range(4))
def test_predict(start, printed, tmp_path):
    """Each hostile name is used for the frame's file and configuration, the record, its state and a channel."""
    four = PLACED[start::4]
    name, of_record, state, channel = (*four[start:], *four[:start])
    record = records(tmp_path, [of_record], [state], [channel])[0]
    file = measurement(tmp_path / f"{file_name(name)}.toml", [name, "b"])
    text = (
        record.read_text(encoding="utf-8").replace("[0.0, 0.0, 0.0]", "[0.0, 0.0]").replace("floor = 3", "floor = 2", 1)
    )
    # Two floors: the third channel is left out.
    record.write_text(text[: text.rindex("[[channel]]")] + "\n", encoding="utf-8")
    kinds = [*into(".json", ".html"), ("--figure", "peaks:OUT-peaks.svg"), ("--out", "OUT.csv")]
    asked = ("predict", file, "--record", record, "--configuration", name)
    check(printed, tmp_path, *asked, outputs=kinds, as_json=start == 0)


@pytest.mark.parametrize("name", NAMES)
def test_new_names_a_file(name, run, tmp_path):
    table = tmp_path / f"{file_name(name)}.csv"
    table.write_text("frequency,floor 1,floor 2\n3.5,0.6,1\n9.1,1,-0.7\n")
    status, out, err = run("new", "--from", table, "-o", tmp_path / "new.toml")
    assert (status, out, err) == (0, "", "")
    sound(tmp_path / "new.toml")
    assert (tmp_path / tomllib.loads((tmp_path / "new.toml").read_text())["configuration"][0]["csv"]) == table
    assert run("identify", tmp_path / "new.toml")[0] == 0


def test_a_name_of_no_letters_is_refused(refused, tmp_path):
    """A file name that is no UTF-8 cannot be written in TOML."""
    table = tmp_path / "a\udcff.csv"
    table.write_text("frequency,floor 1,floor 2\n3.5,0.6,1\n9.1,1,-0.7\n")
    err = refused("new", "--from", table, "-o", tmp_path / "new.toml")
    assert r"a\udcff.csv: a name that is no UTF-8 text cannot stand in TOML" in err
    assert not (tmp_path / "new.toml").exists()


@pytest.mark.parametrize("name", NAMES)
def test_a_cell_holds_the_name(name):
    """Harmless names stay unchanged, and the apostrophe never makes two names equal."""
    shown = cell_text(name)
    assert not formula(shown)
    if name.isprintable() and not formula(name.lstrip(" '")):
        assert shown == name
