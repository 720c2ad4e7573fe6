import pytest

from cvxshear.paper import reproduce


@pytest.fixture(scope="session")
def reproduction():
    """Everything, Table 3 with few samples."""
    return reproduce(samples=(100, 1000))
