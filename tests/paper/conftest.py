import pytest

from cvxshear.paper import reproduce


@pytest.fixture(scope="session")
def reproduction():
    """Reproduce the whole paper, with few samples for Table 3."""
    return reproduce(samples=(100, 1000))
