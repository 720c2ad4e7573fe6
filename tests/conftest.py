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

COSTS = TESTS / "costs.txt"
"""Most processor seconds that each test has taken, from half of one on; `python -m pytest --costs` adds to it."""

COSTLY, LONG = 0.5, 1.0
"""Processor seconds from which on a test stands in that table, and from which on it is marked `long`: one in twenty
tests, which take half of the time of all. `python -m pytest -m "not long"` leaves them to CI."""

ON_MEASURED = "docs/measured/"
"""In the names of tests of pages on measured frames, which take as long as all others: each half has a process."""

PAGES = "tests/docs/test_blocks.py"
"""One process runs all pages, and whichever test asks first pays for it: of these only measured frames are long."""

SHARING = re.compile(r"^@(functools\.)?cache$|scope=.module.", re.MULTILINE)
"""In a file whose tests look at something that is made once."""


# Typer writes the whole command line anew for every command, which takes longer than most of them.
typer.main.get_command = functools.cache(typer.main.get_command)

BEGAN = pytest.StashKey()

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
    parser.addoption("--costs", action="store_true", help=f"write what each test costs into {COSTS.name}")


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


@functools.cache
def costs():
    """What tests cost, by their names."""
    lines = COSTS.read_text(encoding="utf-8").splitlines()
    return {name: float(seconds) for seconds, _, name in (line.partition(" ") for line in lines)}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark what is long, and begin what takes longest before all else: last it would keep one process busy alone."""
    groups = Counter()
    for item in items:
        cost = costs().get(item.nodeid, 0.0)
        groups[group_of(config, item.nodeid)] += cost
        if ON_MEASURED in item.nodeid or (cost >= LONG and not item.nodeid.startswith(PAGES)):
            item.add_marker(pytest.mark.long)
    items.sort(key=lambda item: -groups[group_of(config, item.nodeid)])


def spent():
    """Processor seconds of this process and of those that it has waited for."""
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
    """Whether the tests of a file belong into one process."""
    return bool(SHARING.search(path.read_text(encoding="utf-8")))


def group_of(config, nodeid):
    """Name what runs in one process: the tests that look at something that their file makes once, or a test alone."""
    file = nodeid.partition("::")[0]
    if not shares(config.rootpath / file):
        return nodeid
    return f"{file}, measured" if ON_MEASURED in nodeid else file


class Sharing(LoadScopeScheduling):
    """Tests of a group stay in one process; others go to whichever is free.

    `--dist loadgroup` would do the same, but xdist 3.8 finds no group in the names that pytest 9.2 gives its tests.
    """

    def _split_scope(self, nodeid):
        return group_of(self.config, nodeid)


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
    import cvxshear.io.modes  # noqa: PLC0415
    from tests.closed import identify_modes  # noqa: PLC0415

    monkeypatch.setattr(cvxshear.io.modes, "identify_modes", identify_modes)


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


def pytest_terminal_summary(terminalreporter, config):
    """One line for all that was skipped: what is not here, and how many tests need it."""
    if config.getoption("--costs"):
        write_costs(each for kind in ("passed", "failed", "error", "") for each in terminalreporter.stats.get(kind, []))
    skipped = Counter(needed(report.longrepr[2]) for report in terminalreporter.stats.get("skipped", []))
    if skipped:
        what = "; ".join(f"{reason} ({count})" for reason, count in sorted(skipped.items()))
        terminalreporter.write_line(f"skipped: {skipped.total()} tests, for want of what they name: {what}")


def write_costs(reports):
    """Write what each test cost, or has cost before where that was more: who comes first pays for what is shared."""
    known = dict(costs())
    for each in reports:
        if each.when == "teardown":
            known[each.nodeid] = max(known.get(each.nodeid, 0.0), dict(each.user_properties)["cost"])
    order = sorted((name for name in known if known[name] >= COSTLY), key=lambda name: -known[name])
    COSTS.write_text("".join(f"{known[name]:.1f} {name}\n" for name in order), encoding="utf-8")
