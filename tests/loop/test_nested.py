"""Compare log Z with nested sampling on three problems of tests/studies/nested.py with few points."""

import pytest

from tests.studies.nested import PROBLEMS, compared

LIVE, DRAWS = 100, 2000
APPROXIMATION = 0.1
"""Allowed error of Laplace's approximation, in addition to four standard errors of the sampling."""


@pytest.mark.parametrize("problem", [PROBLEMS[0], PROBLEMS[2], PROBLEMS[6]], ids=lambda problem: problem.name)
def test_the_evidence_is_that_of_nested_sampling(problem):
    pytest.importorskip("dynesty", reason="dynesty is not installed")
    found, *sampled = compared(problem, LIVE, draws=DRAWS)
    for exact, error in sampled:
        assert found == pytest.approx(exact, abs=4 * error + APPROXIMATION)
    assert sampled[-1][1] < 0.1
