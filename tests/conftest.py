"""Configure the whole suite: its options, the order and grouping of tests, and commands run in this process."""

import functools
import gc
import os
import re
import tempfile
from collections import Counter
from pathlib import Path

# Use one thread per process, because each core runs one test process. This must be set before numpy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
import typer.main
from xdist.scheduler import LoadScopeScheduling

from cvxshear.cli import main
from tests.docs.runner import KEPT_IN, once

TESTS = Path(__file__).parent

COSTS = TESTS / "costs.txt"
"""Largest processor time of each test, in seconds, for tests over half a second; `python -m pytest --costs` adds to
it."""

COSTLY, LONG = 0.5, 1.0
"""Lowest processor seconds for an entry in that table, and for the mark `long`. About one test in ten is long; these
take half of the total time. `python -m pytest -m "not long"` leaves them to CI."""

ON_MEASURED = "docs/measured/"
"""Part of the names of tests of pages on measured frames. These take half of the time of all pages, so they have
their own process."""

PAGES = "tests/docs/test_blocks.py"
"""File of the tests of pages. One process runs all pages, and the first test pays for shared results, so only measured
frames are marked long."""

SHARING = re.compile(r"^@(functools\.)?cache$|scope=.module.", re.MULTILINE)
"""Pattern of a file whose tests share a cached object."""


# Typer rebuilds the whole command line for every command, which takes longer than most commands.
typer.main.get_command = functools.cache(typer.main.get_command)

BEGAN = pytest.StashKey()

OBJECTS = 50_000
"""Number of new objects between two garbage collections. With Python's 700, collection takes a tenth of the time of a
drawing."""


def pytest_addoption(parser):
    parser.addoption(
        "--fuzz-budget",
        type=int,
        default=60,
        metavar="N",
        help="mutated files that each reader is tried with; those that it takes go on to identify, loop and modes",
    )
    parser.addoption("--costs", action="store_true", help=f"write what each test costs into {COSTS.name}")


def pytest_configure(config):
    """Create a folder for results shared by all processes of this run; delete it at the end."""
    if not hasattr(config, "workerinput") and KEPT_IN not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="cvxshear-tests-")
        os.environ[KEPT_IN] = folder.name
        config.add_cleanup(folder.cleanup)
        config.add_cleanup(lambda: os.environ.pop(KEPT_IN))


def pytest_collection_finish():
    """Exclude imported objects from garbage collection, because they live until the process ends."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(OBJECTS, 20, 20)


@functools.cache
def costs():
    """Return the costs of tests by their names."""
    lines = COSTS.read_text(encoding="utf-8").splitlines()
    return {name: float(seconds) for seconds, _, name in (line.partition(" ") for line in lines)}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark long tests, and start the longest tests first. A long test at the end would keep one process busy alone."""
    groups = Counter()
    for item in items:
        cost = costs().get(item.nodeid, 0.0)
        groups[group_of(config, item.nodeid)] += cost
        if ON_MEASURED in item.nodeid or (cost >= LONG and not item.nodeid.startswith(PAGES)):
            item.add_marker(pytest.mark.long)
    items.sort(key=lambda item: -groups[group_of(config, item.nodeid)])


def spent():
    """Return processor seconds of this process and of its finished children."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    item.stash[BEGAN] = spent()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    if call.when == "teardown":
        item.user_properties.append(("cost", spent() - item.stash[BEGAN]))
    return (yield)


@functools.cache
def shares(path):
    """Return whether the tests of a file belong in one process."""
    return bool(SHARING.search(path.read_text(encoding="utf-8")))


def group_of(config, nodeid):
    """Name the group of tests for one process: the tests that share an object of their file, or a single test."""
    file = nodeid.partition("::")[0]
    if not shares(config.rootpath / file):
        return nodeid
    return f"{file}, measured" if ON_MEASURED in nodeid else file


class Sharing(LoadScopeScheduling):
    """Keep the tests of a group in one process; give the others to any free process.

    `--dist loadgroup` would do the same, but xdist 3.8 finds no group in the test names of pytest 9.2.
    """

    def _split_scope(self, nodeid):
        return group_of(self.config, nodeid)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    # Keep the order of collection; do not sort by number of tests.
    config.option.loadscopereorder = False
    return Sharing(config, log)


@pytest.fixture(scope="session")
def fuzz_budget(request):
    return request.config.getoption("--fuzz-budget")


@pytest.fixture
def run(capsys):
    """Return status, standard output and standard error of a command."""

    def call(*arguments):
        with pytest.raises(SystemExit) as stopped:
            main([str(argument) for argument in arguments])
        shown = capsys.readouterr()
        return stopped.value.code, shown.out, shown.err

    return call


@pytest.fixture
def printed(run):
    """Return the standard output of a command that succeeds without a message."""

    def call(*arguments):
        status, out, err = run(*arguments)
        assert (status, err) == (0, "")
        return out

    return call


@pytest.fixture
def refused(run):
    """Return the message of a command that ends with status 2 and prints nothing else."""

    def call(*arguments):
        status, out, err = run(*arguments)
        assert (status, out) == (2, "")
        assert "Traceback" not in err
        return err

    return call


@pytest.fixture
def shared_loops(monkeypatch):
    """Close the loop of a measurement once for all commands of the tests that use this fixture."""
    import cvxshear.response.sources  # noqa: PLC0415 - loaded by the tests that need it
    from tests.closed import close_loop  # noqa: PLC0415

    for place in (cvxshear, cvxshear.response.sources):
        monkeypatch.setattr(place, "close_loop", close_loop)


@pytest.fixture
def shared_modes(monkeypatch):
    """Identify the modes of a record once for all tests that use this fixture."""
    import cvxshear.io.modes  # noqa: PLC0415
    from tests.closed import identify_modes  # noqa: PLC0415

    monkeypatch.setattr(cvxshear.io.modes, "identify_modes", identify_modes)


@pytest.fixture(scope="module")
def shared_drawings():
    """Draw the figures of a report once for all reports of the same results in the files that use this fixture."""
    page = pytest.importorskip("cvxshear.report.html")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "drawings", once(page.drawings))
        yield


def needed(reason):
    """Return the requirement of a skipped test, from its reason."""
    reason = reason.removeprefix("Skipped: ")
    missing = re.match(r"could not import '([^'.]+)", reason)
    return f"the package {missing[1]}" if missing else reason.partition(": ")[0]


def pytest_terminal_summary(terminalreporter, config):
    """Print one line about skipped tests: the missing requirements, and the number of tests that need each."""
    if config.getoption("--costs"):
        write_costs(each for kind in ("passed", "failed", "error", "") for each in terminalreporter.stats.get(kind, []))
    skipped = Counter(needed(report.longrepr[2]) for report in terminalreporter.stats.get("skipped", []))
    if skipped:
        what = "; ".join(f"{reason} ({count})" for reason, count in sorted(skipped.items()))
        terminalreporter.write_line(f"skipped: {skipped.total()} tests, for want of what they name: {what}")


def write_costs(reports):
    """Write the largest known cost of each test. The first test that runs pays for shared results."""
    known = dict(costs())
    for each in reports:
        if each.when == "teardown":
            known[each.nodeid] = max(known.get(each.nodeid, 0.0), dict(each.user_properties)["cost"])
    order = sorted((name for name in known if known[name] >= COSTLY), key=lambda name: -known[name])
    COSTS.write_text("".join(f"{known[name]:.1f} {name}\n" for name in order), encoding="utf-8")
