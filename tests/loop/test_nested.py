"""Compare log Z with nested sampling on one problem of tests/studies/nested.py with few points."""

import pytest

from tests.studies.nested import PROBLEMS, compared

LIVE, DRAWS = 100, 2000
APPROXIMATION = 0.1
"""Allowed error of Laplace's approximation, in addition to four standard errors of the sampling."""


def test_the_evidence_is_that_of_nested_sampling():
    """`test_evidence.py` integrates other problems; `python -m tests.studies nested` samples all of them."""
    pytest.importorskip("dynesty", reason="dynesty is not installed")
    found, *sampled = compared(PROBLEMS[0], LIVE, draws=DRAWS)
    for exact, error in sampled:
        assert found == pytest.approx(exact, abs=4 * error + APPROXIMATION)
    assert sampled[-1][1] < 0.1
