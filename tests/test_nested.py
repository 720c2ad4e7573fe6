"""log Z against nested sampling, three of the problems of tests/benchmarks/nested.py with few live points."""

import pytest

from tests.benchmarks.nested import PROBLEMS, compared

LIVE = 150
APPROXIMATION = 0.3
"""What Laplace's approximation itself may be off, beside three standard errors of the sampling."""


@pytest.mark.parametrize("problem", [PROBLEMS[0], PROBLEMS[2], PROBLEMS[6]], ids=lambda problem: problem.name)
def test_the_evidence_is_that_of_nested_sampling(problem):
    pytest.importorskip("dynesty", reason="dynesty is not installed")
    found, exact, error = compared(problem, LIVE)
    assert found == pytest.approx(exact, abs=3 * error + APPROXIMATION)
