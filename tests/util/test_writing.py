"""Test the writing of files: complete or not at all, without replacing another file, and refused before the
computation."""

from __future__ import annotations

import ast
import errno
import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import cvxshear
from cvxshear.util.errors import InputError
from cvxshear.util.writing import check_output, ending_of, same_file, write_file
from tests.fuzz import files

PACKAGE = Path(cvxshear.__file__).parent
WRITING = {
    "savefig", "savetxt", "savez", "savez_compressed", "savemat", "rename", "replace", "mkstemp", "dump",
}  # fmt: skip


def content_of(folder: Path) -> dict[str, bytes]:
    return {each.name: each.read_bytes() for each in folder.iterdir() if each.is_file()}


def test_a_file_is_written_and_written_again(tmp_path):
    path = tmp_path / "a.json"
    write_file(path, "ä\n")
    path.chmod(0o640)
    write_file(path, b"b")
    assert content_of(tmp_path) == {"a.json": b"b"}
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_new_file_has_the_rights_of_every_other_new_file(tmp_path):
    (tmp_path / "b").write_text("")
    write_file(tmp_path / "a", "")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_half_a_surrogate_pair_stands_as_its_escape(tmp_path):
    write_file(tmp_path / "a", "x\udcff")
    assert (tmp_path / "a").read_bytes() == b"x\\udcff"


def test_a_link_is_replaced_and_what_it_points_to_is_left(tmp_path):
    (tmp_path / "other").write_text("mine")
    (tmp_path / "a").symlink_to(tmp_path / "other")
    write_file(tmp_path / "a", "new")
    assert (tmp_path / "other").read_text() == "mine"
    assert not (tmp_path / "a").is_symlink()
    assert (tmp_path / "a").read_text() == "new"


def test_a_link_that_waits_where_the_new_file_is_made_is_not_followed(tmp_path, monkeypatch):
    (tmp_path / "other").write_text("mine")
    monkeypatch.setattr("secrets.token_hex", lambda _: "guessed")
    (tmp_path / ".guessed.part").symlink_to(tmp_path / "other")
    with pytest.raises(InputError, match="cannot be written: File exists"):
        write_file(tmp_path / "a", "new")
    assert (tmp_path / "other").read_text() == "mine"


@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_the_old_file_and_nothing_beside_it(tmp_path, monkeypatch, step, error):
    path = tmp_path / "a"
    path.write_text("old")

    def fail(*_):
        raise error

    monkeypatch.setattr(os, step, fail)
    expected = InputError if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(expected):
        write_file(path, "new")
    assert content_of(tmp_path) == {"a": b"old"}


def test_what_is_written_has_reached_the_disk_before_it_takes_the_place(tmp_path, monkeypatch):
    order = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda file: (order.append("flushed"), fsync(file)))
    monkeypatch.setattr(os, "replace", lambda a, b: (order.append("renamed"), replace(a, b)))
    write_file(tmp_path / "a", "x")
    assert order == ["flushed", "renamed"]


def test_a_pipe_is_written_to(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    heard = []
    reader = threading.Thread(target=lambda: heard.append(path.read_bytes()))
    reader.start()
    write_file(path, "x")
    reader.join()
    assert heard == [b"x"]
    assert stat.S_ISFIFO(path.stat().st_mode)


@pytest.fixture
def terminal():
    """Return both ends of a terminal, a device that no other program uses."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    yield ours, os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def test_a_device_is_written_to(tmp_path, terminal):
    ours, name = terminal
    (tmp_path / "link").symlink_to(name)
    for place in (name, tmp_path / "link"):
        check_output(place, endings=(".html",))
        write_file(place, "x")
        assert os.read(ours, 10) == b"x"
    assert stat.S_ISCHR(Path(name).stat().st_mode)
    assert (tmp_path / "link").is_symlink()


def test_a_device_has_no_ending_to_go_by(tmp_path, terminal):
    _, name = terminal
    os.mkfifo(tmp_path / "pipe.png")
    assert ending_of(name, ("svg", "png"), "a figure is written as") == "svg"
    assert ending_of(tmp_path / "pipe.png", ("svg", "png"), "a figure is written as") == "png"
    with pytest.raises(InputError, match=r"a figure is written as \.svg or \.png"):
        ending_of(tmp_path / "none", ("svg", "png"), "a figure is written as")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device here")
def test_what_does_not_fit_on_a_device_is_told_after_the_result(run):
    for option in ("-o", "--csv"):
        status, out, err = run("plan", "paper", "--fresh", option, "/dev/full")
        assert status == 2
        assert out.startswith("Measure every floor")
        assert err == "cvxshear: /dev/full cannot be written: No space left on device\n"


@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="no such name here")
def test_an_open_file_of_the_process_is_written_on_from_where_it_stands(tmp_path):
    code = (
        "import sys; from cvxshear.util.writing import write_file; "
        "print('a', flush=True); write_file('/dev/stdout', 'b')"
    )
    with (tmp_path / "out").open("w") as out:
        subprocess.run([sys.executable, "-c", code], stdout=out, check=True)
    assert content_of(tmp_path) == {"out": b"a\nb"}


PLACES = {
    "nothing": ("", "the name of the file to write is empty"),
    "no such folder": ("none/a.json", "none/a.json cannot be written: there is no folder none"),
    "a file for a folder": ("file/a.json", "file/a.json cannot be written: there is no folder file"),
    "too long a name": ("x" * 300, f"{'x' * 300} cannot be written: File name too long"),
    "read-only": ("frozen", "frozen is read-only; name another file, or make it writable"),
    "no folder to write in": ("/proc/a.json", "/proc/a.json cannot be written: "),
}


@pytest.mark.parametrize("kind", PLACES)
def test_a_place_that_cannot_be_written_to(kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    Path("frozen").write_text("")
    Path("frozen").chmod(0o444)
    place, message = PLACES[kind]
    for function in (check_output, lambda path: write_file(path, "x")):
        with pytest.raises(InputError) as caught:
            function(place)
        assert str(caught.value).startswith(message)
    assert sorted(os.listdir()) == ["file", "frozen"]


def test_what_the_content_was_made_from_is_kept(tmp_path):
    (tmp_path / "a").write_text("mine")
    (tmp_path / "b").hardlink_to(tmp_path / "a")
    (tmp_path / "c").symlink_to(tmp_path / "a")
    for name in "abc":
        with pytest.raises(InputError, match=r"would be written over .*, which it is made from; name another"):
            check_output(tmp_path / name, keep=[tmp_path / "a"])
    assert (tmp_path / "a").read_text() == "mine"
    assert same_file(tmp_path / "new", tmp_path / "x" / ".." / "new")


def test_no_other_module_writes():
    """Only the module `writing` contains calls that write a file; `responses` fills streams in memory."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        calls = (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call))
        for node in calls:
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            owner = getattr(getattr(node.func, "value", None), "id", "")
            modes = [each.value for each in node.args if isinstance(each, ast.Constant) and isinstance(each.value, str)]
            if (
                name in {"write_text", "write_bytes"}
                or (name in {"open", "fdopen"} and {"w", "wb", "a", "x"} & set(modes))
                or (name in WRITING and owner in {"os", "np", "io", "shutil", "json", "tempfile"})
            ):
                found.add((path.relative_to(PACKAGE).as_posix(), name))
    own = {("util/writing.py", "fdopen"), ("util/writing.py", "replace")}
    assert {each for each in found if each[0] != "report/responses.py"} == own


KILLED = """
import os, signal, sys
from cvxshear.util.writing import write_file

def die(*arguments):
    if sys.argv[1] == "fdopen":
        os.write(arguments[0], b"half")
    os.kill(os.getpid(), signal.SIGKILL)

setattr(os, sys.argv[1], die)
write_file("a", "new")
"""


@pytest.mark.parametrize("step", ["fdopen", "fsync", "replace"])
def test_killed_in_the_middle(step, tmp_path):
    """Signal 9 at each step leaves the old file. A remaining temporary file does not disturb later writers."""
    path = tmp_path / "a"
    path.write_text("old")
    assert subprocess.run([sys.executable, "-c", KILLED, step], cwd=tmp_path, check=False).returncode == -9
    assert path.read_text() == "old"
    write_file(path, "new")
    assert {each.name for each in tmp_path.iterdir() if each.suffix != ".part"} == {"a"}


# The commands.


REFUSED = {
    "an empty name": (["identify", "paper", "--json", ""], "--json: the name of the file to write is empty"),
    "a folder": (["identify", "paper", "--json", "."], "--json: . is a folder; name a file in it"),
    "a report that is no page": (["loop", "paper", "--report", "a.pdf"], "--report: a.pdf must end in .html or .htm"),
    "a figure that is none": (["loop", "paper", "--figure", "a.doc"], "--figure: a.doc must end in .svg or .png or"),
    "JSON under another's name": (
        ["identify", "paper", "--json", "m.toml"], "--json: m.toml must end in .json",
    ),
    "no folder": (["loop", "paper", "--report", "none/a.html"], "--report: none/a.html cannot be written: there is no"),
    "the input, by a link": (["identify", "m.toml", "--json", "link.json"], "--json: link.json would be written over"),
    "the record": (["modes", "r.toml", "-o", "r.toml"], "--output: r.toml would be written over r.toml, which is read"),
    "the raw record": (["modes", "r.toml", "--json", "raw.json"], "--json: raw.json would be written over sound.csv"),
    "one file twice": (["loop", "paper", "--figure", "a.svg", "--json", "twin.json"], "--json and --figure name"),
    "the design that a plan is for": (["plan", "m.toml", "-o", "m.toml"], "--output: m.toml would be written over m.t"),
    "the raw record that is predicted": (
        ["predict", "paper", "--out", "sound.csv", "--record", "r.toml"], "--out: sound.csv would be written over",
    ),
    "the model that predicts": (
        ["predict", "s.json", "--record", "r.toml", "--json", "s.json"], "--json: s.json would be written over",
    ),
    "a record of which the measurement is made": (
        ["predict", "r.toml", "--record", "r.toml", "--report", "raw.html"], "--report: raw.html would be written over",
    ),
    "time series and peaks": (
        ["predict", "paper", "--record", "r.toml", "--out", "b.csv", "--csv", "b.csv"],
        "--csv and --out name the same file, b.csv",
    ),
    "what is compared": (["backends", "m.toml", "--json", "link.json"], "--json: link.json would be written over m.to"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_a_bad_output_is_refused_before_the_run(kind, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cvxshear.fit.identification", lambda *_, **__: pytest.fail("it ran"))
    monkeypatch.setattr("cvxshear.screening.close_loop", lambda *_, **__: pytest.fail("it ran"))
    monkeypatch.setattr("cvxshear.io.modes.identify_modes", lambda *_, **__: pytest.fail("it ran"))
    monkeypatch.setattr("cvxshear.planning.plan", lambda *_, **__: pytest.fail("it ran"))
    monkeypatch.setattr("cvxshear.response.predict", lambda *_, **__: pytest.fail("it ran"))
    Path("m.toml").write_bytes(files.measurement())
    files.table(tmp_path)
    Path("r.toml").write_text(files.record_text("sound.csv"))
    Path("link.json").hardlink_to("m.toml")
    Path("raw.json").symlink_to("sound.csv")
    Path("raw.html").symlink_to("sound.csv")
    Path("s.json").write_text('{"verdict": "adequate"}')
    Path("s.toml").symlink_to("s.json")
    Path("a.svg").write_text("")
    Path("twin.json").symlink_to("a.svg")
    before = content_of(tmp_path)
    arguments, message = REFUSED[kind]
    status, out, err = run(*arguments)
    assert status == 2
    assert err.startswith(f"cvxshear: {message}")
    assert out == ""
    assert content_of(tmp_path) == before


@pytest.mark.parametrize(
    ("arguments", "options", "printed"),
    [
        (("identify", "paper", "--method", "two-stage"), {"--json": ".json"}, "13.045"),
        (("plan", "paper", "--fresh"), {"-o": ".toml", "--csv": ".csv"}, "Measure every floor in 1 test"),
    ],
)
def test_the_result_is_printed_where_its_files_cannot_be_written(
    arguments, options, printed, run, tmp_path, monkeypatch
):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    status, out, err = run(*arguments, *(word for key, end in options.items() for word in (key, tmp_path / f"a{end}")))
    assert status == 2
    assert printed in out
    assert err.count("cannot be written: No space left on device") == len(options)
    assert not content_of(tmp_path)
