"""Options of the whole suite."""

import pytest


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
