"""What the whole suite shares: its options, and the command line run in this process."""

import os
import re
from collections import Counter

# One thread a process: the tests run in one process a core. It must be said before numpy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest

from cvxshear.cli import main


def pytest_addoption(parser):
    parser.addoption(
        "--fuzz-budget",
        type=int,
        default=60,
        metavar="N",
        help="mutated files that each reader is tried with; those that it takes go on to identify, loop and modes",
    )


def pytest_itemcollected(item):
    """Tests that share what a file makes once stay in one process; all others go to whichever process is free."""
    shared = item._fixtureinfo.name2fixturedefs.values()
    if any(definitions[-1].scope == "module" for definitions in shared) and not item.get_closest_marker("xdist_group"):
        item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))


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
