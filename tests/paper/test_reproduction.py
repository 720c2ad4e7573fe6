"""Test the whole reproduction: counted results, displayed results, and the documentation."""

import json
from pathlib import Path

import numpy as np
import pytest

from cvxshear import InputError
from cvxshear.paper import PaperRow, reproduce
from cvxshear.paper.reproduction import DIFFERS, MISPRINTED, ROUNDED, TO_THE_DIGIT, same_digits
from cvxshear.report.studied import printed_beside_recomputed
from cvxshear.report.terminal import text

DOCS = Path(__file__).parents[2] / "docs" / "paper.md"


@pytest.fixture(scope="module")
def reproduction():
    """Reproduce the whole paper, with few samples for Table 3."""
    return reproduce(samples=(100, 1000))


def test_every_printed_result_is_met_or_accounted_for(reproduction):
    counted = {
        name: sum(row.verdict == name for section in reproduction.sections if section.counted for row in section.rows)
        for name in (TO_THE_DIGIT, ROUNDED, MISPRINTED, DIFFERS)
    }
    assert counted == {TO_THE_DIGIT: 73, ROUNDED: 11, MISPRINTED: 1, DIFFERS: 0}
    assert "85 printed results" in reproduction.summary


def test_what_was_only_met_from_rounded_figures_is_named(reproduction):
    """The report names the errors in percent that the paper computed from rounded tables."""
    places = {row.where for section in reproduction.sections for row in section.rows if row.verdict == ROUNDED}
    assert all(place.startswith(("Table 8", "Section 5.1", "Section 7")) for place in places)


def test_json_has_the_documented_fields(reproduction):
    result = json.loads(json.dumps(reproduction.to_dict()))
    assert set(result) == {"backend", "samples", "seed", "summary", "sections"}
    row = result["sections"][0]["rows"][0]
    assert {"what", "where", "printed", "recomputed", "difference", "agrees"} <= set(row)
    assert row["printed"] == "10"


def test_the_terminal_shows_every_section_with_brackets_and_signs(reproduction):
    shown = text(reproduction, width=140)
    for said in ("Ref. [17]", "Ref. [23]", "misprint", "-0.004", "0.11290", "about 5", reproduction.sections[-1].title):
        assert said in shown
    assert "-0.00000 " not in shown


def test_the_documentation_has_the_tables_that_the_command_prints(reproduction):
    """The last digits of random samples depend on numpy's version; the pages leave out the most frequent agreement."""
    documented = DOCS.read_text(encoding="utf-8")
    for section in reproduction.sections:
        if section.title.startswith(("Table 3", "Fig. 6", "Tables 4 and 5")):
            continue
        table = printed_beside_recomputed(section)
        rows = ((*cells[:-1], cells[-1].removesuffix(TO_THE_DIGIT)) for cells in table.rows)
        lines = [f"| {' | '.join(cells)} |" for cells in (table.head, *rows)]
        for line in (f"## {section.title}", *lines, *section.notes):
            assert line in documented
    assert reproduction.summary in documented


@pytest.mark.parametrize(
    ("row", "verdict"),
    [
        (PaperRow("x", "here", "1.50", 1.4961), TO_THE_DIGIT),
        (PaperRow("x", "here", "1.50", 1.4886), DIFFERS),
        (PaperRow("x", "here", "1.50", 1.4886, from_rounded=1.5), ROUNDED),
        (PaperRow("x", "here", "-0.004", 0.113, misprint=True), MISPRINTED),
        (PaperRow("x", "here", "0.30", 0.10, std_error=0.05, chance=0.1), "-2.0 standard errors"),
        (PaperRow("x", "here", "about 5", 4.5), ""),
    ],
)
def test_the_verdict_on_a_row(row, verdict):
    assert row.verdict == verdict


@pytest.mark.parametrize(
    ("number", "printed", "same"),
    [
        (9.9999956, "10", True),
        (7.54, "7.5", True),
        (7.56, "7.5", False),
        (-1e-16, "0", True),
        (-0.0249, "-0.025", True),
    ],
)
def test_digits(number, printed, same):
    assert same_digits(number, printed) is same


def test_a_number_of_samples_that_is_none_is_refused():
    with pytest.raises(InputError, match="samples"):
        reproduce(samples=(0,))


def section_of(reproduction, title):
    """Return the first section whose title begins with these words."""
    return next(each for each in reproduction.sections if each.title.startswith(title))


@pytest.mark.parametrize(
    "title", ["Table 3: error of the mean, 100 samples", "Table 3: error of the mean, 1,000 samples"]
)
def test_chance_explains_table_3(reproduction, title):
    section = section_of(reproduction, title)
    distances = np.array([row.distance for row in section.rows])
    assert len(distances) == 30
    assert np.max(np.abs(distances)) < 3.5
    # If the printed figures came from another method, the distances would not be of order one.
    assert 0.4 < np.sqrt(np.mean(distances**2)) < 1.5


def test_the_standard_error_falls_with_the_samples(reproduction):
    few, many = (section_of(reproduction, f"Table 3: error of the mean, {count} samples") for count in ("100", "1,000"))
    ratios = [a.std_error / b.std_error for a, b in zip(few.rows, many.rows, strict=True)]
    # sqrt(1000 / 100); the standard deviation of 100 samples scatters by 7 %.
    assert np.mean(ratios) == pytest.approx(np.sqrt(10), rel=0.08)


def test_the_mean_is_within_one_percent(reproduction):
    """Test the paper's claim at a noise level with small random scatter."""
    rows = section_of(reproduction, "Table 3: error of the mean, 1,000 samples").rows
    assert max(abs(row.recomputed) for row in rows) < 1.0


def test_the_coefficients_of_variation(reproduction):
    rows = section_of(reproduction, "Fig. 6").rows
    # The reference figures come from another 2,000 samples, rounded to 0.1.
    for row, reference in zip(rows, [4.5, 5.2, 6.5, 8.0, 4.0, 6.0], strict=True):
        assert abs(row.recomputed - reference) < 0.05 + 3 * np.sqrt(2) * row.std_error
