"""What the whole suite shares: its options, and the command line run in this process."""

import os

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
