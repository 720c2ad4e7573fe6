"""Test unusual standard streams, unusual names, and commands that are interrupted or lose a process."""

import contextlib
import gc
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

from cvxshear.cli import main
from cvxshear.util.errors import InputError, LostProcessError, printable
from cvxshear.util.parallel import each
from tests.fuzz import files

COMMAND = [sys.executable, "-W", "error", "-m", "cvxshear"]
NAME = "[red]A[/red]\x1b[31m\nB\u202e\u0000 :smile: $\\frac{$ <b>&amp; ±"
SHOWN = r"[red]A[/red]\x1b[31m\nB\u202e\x00 :smile: $\frac{$ <b>&amp; ±"


def test_what_would_steer_a_terminal_stands_as_its_escape():
    assert printable(NAME) == SHOWN
    assert printable("x\u2028y\x9b\udcff\u200f\r\t") == r"x\u2028y\x9b\udcff\u200f\r\t"
    assert printable("Gebäude 中 ±") == "Gebäude 中 ±"
    assert str(InputError("a\x1bb")) == r"a\x1bb"


@pytest.fixture
def named(tmp_path):
    """Return a measurement whose configuration and file have the worst possible name."""
    text = files.measurement().decode().replace('name = "', f"name = {json.dumps(NAME)} # ", 1)
    path = os.fsencode(tmp_path) + b"/evil\x1b[31m[bold]\xff.toml"
    with open(path, "w", encoding="utf-8") as file:
        file.write(text)
    return os.fsdecode(path)


def test_a_terminal_without_the_letters(named):
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    shown = subprocess.run([*COMMAND, "identify", named], capture_output=True, env=environment, check=True)
    assert not shown.stderr
    assert r"<b>&amp; \xb1" in shown.stdout.decode("ascii")
    json_of = subprocess.run(
        [*COMMAND, "identify", named, "--json", "-"], capture_output=True, env=environment, check=True
    )
    assert json.loads(json_of.stdout)["predictions"][0]["configuration"] == NAME


def shell(command: str) -> tuple[int, str, str]:
    line = " ".join([*COMMAND, "identify", "paper", "--method", "two-stage", command])
    found = subprocess.run(["bash", "-c", f"set -o pipefail; {line}"], capture_output=True, text=True, check=False)
    return found.returncode, found.stdout, found.stderr


FULL = "cvxshear: standard output cannot be written: No space left on device\n"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
@pytest.mark.parametrize("options", ["identify paper --json -", "--help", "--version", "new"])
def test_a_standard_output_that_takes_nothing(options):
    line = f"{sys.executable} -m cvxshear {options} > /dev/full"
    found = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert (found.returncode, found.stderr) == (1, FULL)


WAITING = 120
"""Limit in seconds for a command that might wait forever, and for processes to start."""

OUTLIVING = 2
"""Longest time in seconds that a process may outlive its parent, from `cvxshear.util.parallel`."""


def test_a_pipe_is_refused_and_not_waited_for(tmp_path, run):
    """A pipe can be read once, and a command may open a file twice."""
    os.mkfifo(tmp_path / "pipe.toml")
    status, out, err = run("identify", tmp_path / "pipe.toml")
    assert (status, out) == (2, "")
    assert "is a device or a pipe; save what it gives in a file" in err


def test_the_file_is_written_where_standard_output_takes_nothing(tmp_path):
    status, _, complaint = shell(f"--json {tmp_path}/a.json > /dev/full")
    assert (status, complaint) == (1, FULL)
    assert json.loads((tmp_path / "a.json").read_text())["method"] == "two-stage"


INTERRUPTED = """
import runpy, sys

class Interrupting:
    def find_spec(self, name, *_):
        if name == sys.argv[1]:
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupting())
runpy.run_module("cvxshear", run_name="__main__")
"""


@pytest.mark.parametrize("module", ["rich.console", "cvxshear.loop"])
def test_an_interruption_while_loading_has_no_traceback(module):
    """Interrupt like Ctrl-C at the import of the command line and of a module that a command needs."""
    code = INTERRUPTED.replace("sys.argv[1]", repr(module))
    code = f"import sys; sys.argv[1:] = ['loop', 'paper']\n{code}"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout, found.stderr) == (130, "", "")


def killed(_):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_process_is_told(capsys, monkeypatch):
    with pytest.raises(LostProcessError, match="one of the processes was ended from outside, after 0 of 4 things"):
        each(killed, range(4), jobs=2)

    def lose(*_, **__):
        raise LostProcessError("one of the processes was ended from outside")

    monkeypatch.setattr("cvxshear.screening.close_loop", lose)
    monkeypatch.setattr("cvxshear.close_loop", lose)
    with pytest.raises(SystemExit) as stopped:
        main(["loop", "paper", "--jobs", "2"])
    assert stopped.value.code == 1
    assert capsys.readouterr().err == "cvxshear: one of the processes was ended from outside\n"


def _half(value):
    return value / 2


def test_who_stops_hears_nothing_of_what_was_under_way():
    """Interrupt between two results with Ctrl-C. joblib warns when it drops the remaining work."""

    def stop(done, count):
        assert (done, count) == (3, 40)
        raise KeyboardInterrupt

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with pytest.raises(KeyboardInterrupt):
            each(_half, range(40), jobs=2, progress=stop)
        gc.collect()
    assert [str(warning.message) for warning in said] == []


def test_nothing_is_said_of_a_reader_that_has_gone():
    running = subprocess.Popen(
        [*COMMAND, "identify", "paper"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    running.stdout.close()
    with contextlib.closing(running.stderr):
        assert running.stderr.read() == ""
    assert running.wait() == 1


def alive(group: int) -> list[str]:
    """Return the processes of a group, without zombies."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            # After the name in parentheses follow state, parent and group.
            state, _, of_group = path.read_text().rpartition(")")[2].split()[:3]
            if int(of_group) == group and state != "Z":
                found.append((path.parent / "cmdline").read_text().replace("\0", " "))
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc here")
@pytest.mark.parametrize("ending", ["SIGKILL", "SIGTERM", "SIGINT"])
def test_nothing_outlives_its_parent(ending):
    """Two processes work for a third one. Ctrl-C ends it; a terminal sends the signal to all three."""
    line = [sys.executable, "-m", "cvxshear", "study", "noise", "--jobs", "2", "--samples", "1000000", "--methods"]
    found = subprocess.Popen(
        [*line, "efficient"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        # A shell that runs the tests in the background lets them and their children ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509 - no threads here
    )  # fmt: skip
    try:
        _ended_by(found, ending)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(found.pid, signal.SIGKILL)


def _ended_by(found, ending):
    """End the parent once the others work. Their work would take far longer than the test waits."""
    assert within(WAITING, lambda: len(alive(found.pid)) >= 3)
    number = getattr(signal, ending)
    (os.killpg if ending == "SIGINT" else os.kill)(found.pid, number)
    out, err = found.communicate(timeout=WAITING)
    if ending == "SIGINT":
        assert (found.returncode, out, err) == (130, "", "")
    assert within(OUTLIVING, lambda: not alive(found.pid)), alive(found.pid)


def within(seconds, true):
    """Return whether a condition becomes true within some seconds, without waiting longer than necessary."""
    until = time.monotonic() + seconds
    while not (found := true()) and time.monotonic() < until:
        time.sleep(0.05)
    return found
