"""What the whole suite shares: its options, who runs what in which order, and the command line run in this process."""

import functools
import gc
import os
import re
import tempfile
from collections import Counter
from pathlib import Path

# One thread a process: the tests run in one process a core. It must be said before numpy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
import typer.main
from xdist.scheduler import LoadScopeScheduling

from cvxshear.cli import main
from tests.docs.runner import KEPT_IN, once

TESTS = Path(__file__).parent

LONGEST_FIRST = (
    "docs/test_blocks.py", "response/test_reconstruction.py", "fuzz/test_hostile_names.py", "test_numbering.py",
    "docs/test_build.py", "response/test_predict.py", "response/test_real_records.py", "test_calibration.py", "report/",
    "response/", "modal/", "test_nested.py", "test_loop.py", "test_hostile_files.py", "test_measured_frames.py",
)  # fmt: skip
"""What takes longest, in this order, before all else: begun last it would keep one process busy while others wait."""

SHARING = re.compile(r"^@(functools\.)?cache$|scope=.module.", re.MULTILINE)
"""In a file whose tests look at something that is made once."""


# Typer writes the whole command line anew for every command, which takes longer than most of them.
typer.main.get_command = functools.cache(typer.main.get_command)

OBJECTS = 50_000
"""New objects after which garbage is looked for; by Python's 700 a tenth of the time of a drawing goes into that."""


def pytest_addoption(parser):
    parser.addoption(
        "--fuzz-budget",
        type=int,
        default=60,
        metavar="N",
        help="mutated files that each reader is tried with; those that it takes go on to identify, loop and modes",
    )


def pytest_configure(config):
    """What is computed once for all processes of this run has a folder, which goes with it."""
    if not hasattr(config, "workerinput") and KEPT_IN not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="cvxshear-tests-")
        os.environ[KEPT_IN] = folder.name
        config.add_cleanup(folder.cleanup)
        config.add_cleanup(lambda: os.environ.pop(KEPT_IN))


def pytest_collection_finish():
    """What has been imported lives as long as the process: the search for garbage need not walk through it."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(OBJECTS, 20, 20)


def pytest_collection_modifyitems(items):
    places = [str(TESTS / each) for each in LONGEST_FIRST]

    def place(item):
        return next((at for at, path in enumerate(places) if str(item.path).startswith(path)), len(places))

    items.sort(key=place)


@functools.cache
def shares(path):
    """Whether the tests of a file belong into one process."""
    return bool(SHARING.search(path.read_text(encoding="utf-8")))


class Sharing(LoadScopeScheduling):
    """Tests that look at something that their file makes once stay in one process; others go to whichever is free.

    `--dist loadgroup` would do the same, but xdist 3.8 finds no group in the names that pytest 9.2 gives its tests.
    """

    def _split_scope(self, nodeid):
        file = nodeid.partition("::")[0]
        if not shares(self.config.rootpath / file):
            return nodeid
        # Pages on measured frames take as long as all others: each half has a process.
        return f"{file}, measured" if "docs/measured/" in nodeid else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    # In the order of collection, not by number of tests.
    config.option.loadscopereorder = False
    return Sharing(config, log)


@pytest.fixture(scope="session")
def fuzz_budget(request):
    return request.config.getoption("--fuzz-budget")


@pytest.fixture
def run(capsys):
    """Status, standard output and standard error of a command."""

    def call(*arguments):
        with pytest.raises(SystemExit) as stopped:
            main([str(argument) for argument in arguments])
        shown = capsys.readouterr()
        return stopped.value.code, shown.out, shown.err

    return call


@pytest.fixture
def shared_loops(monkeypatch):
    """The loop of a measurement is closed once for all commands of the tests that ask for this."""
    import cvxshear.planning.design  # noqa: PLC0415 - loaded by the tests that need it
    import cvxshear.response.sources  # noqa: PLC0415
    from tests.closed import close_loop  # noqa: PLC0415

    for place in (cvxshear, cvxshear.planning.design, cvxshear.response.sources):
        monkeypatch.setattr(place, "close_loop", close_loop)


@pytest.fixture
def shared_modes(monkeypatch):
    """The modes of a record are identified once for all tests that ask for this."""
    import cvxshear.files.modes  # noqa: PLC0415
    from tests.closed import identify_modes  # noqa: PLC0415

    monkeypatch.setattr(cvxshear.files.modes, "identify_modes", identify_modes)


@pytest.fixture(scope="module")
def shared_drawings():
    """The figures of a report are drawn once for all reports of the same results in the files that ask for this."""
    page = pytest.importorskip("cvxshear.report.html")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "drawings", once(page.drawings))
        yield


def needed(reason):
    """What a skipped test would need, as its reason says."""
    reason = reason.removeprefix("Skipped: ")
    missing = re.match(r"could not import '([^'.]+)", reason)
    return f"the package {missing[1]}" if missing else reason.partition(": ")[0]


def pytest_terminal_summary(terminalreporter):
    """One line for all that was skipped: what is not here, and how many tests need it."""
    skipped = Counter(needed(report.longrepr[2]) for report in terminalreporter.stats.get("skipped", []))
    if skipped:
        what = "; ".join(f"{reason} ({count})" for reason, count in sorted(skipped.items()))
        terminalreporter.write_line(f"skipped: {skipped.total()} tests, for want of what they name: {what}")
