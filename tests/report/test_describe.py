"""Test the description of a result: its facts, and their equality in terminal, prompt, page and notebook."""

import dataclasses
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.cells import cell_len

import cvxshear
from cvxshear import close_loop
from cvxshear.fit.gauss_newton import Ending
from cvxshear.fit.results import IdentifiedFrame
from cvxshear.loop.posterior import Rival
from cvxshear.loop.results import VERDICTS, Verdict
from cvxshear.report import terminal
from cvxshear.report.blocks import describe, table_of_rows
from cvxshear.report.headline import carried_by, chi2_by_kind, headline
from cvxshear.report.html import render
from cvxshear.report.identified import frame_table, in_words
from cvxshear.report.terminal import notebook_html, plain_table
from cvxshear.util import quantities
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import chance
from tests.report.conftest import NASTY, experiment, table

EVERY = ["paper", "eight", "unexplained", "twenty", "nine", "ambiguous"]


def test_the_headline_of_an_explained_frame_names_size_probability_and_errors(paper):
    (effect,) = paper.effects
    said = headline(paper)
    assert said.startswith(effect.size.removesuffix(")"))
    assert f"{100 * effect.probability:.1f} % probable); the largest frequency error falls from" in said
    before, after = (step.estimate.quality.max_frequency_error for step in (paper.before, paper.after))
    assert said.endswith(f"from {100 * before:.2f} % to {100 * after:.2f} %.")


def test_what_to_test_next_says_one_thing_of_what_may_be_there_besides(paper):
    """If candidates remain, the averaged frame includes them; otherwise, no test is needed."""

    def said(result):
        (section,) = (each for each in describe(result).sections if each.key == "next")
        return section.parts[0].text

    left = [item for item in paper.candidates[1:] if item.probability > 0.05 and not item.confounded_with]
    assert len(left) > 3
    named = ", ".join(f"{item.placed.label} ({chance(item.probability)})" for item in left[:2])
    assert f"may be there besides: {named} or {len(left) - 2} more." in said(paper)
    assert "masses and stiffnesses allow for that" in said(paper)
    assert "of the final model" not in said(paper)
    sure = dataclasses.replace(paper, candidates=paper.candidates[:1])
    assert said(sure).endswith("allow for what else may be there.")
    assert "besides" not in said(sure)


def test_an_ambiguous_headline_names_the_rivals_with_their_probabilities(ambiguous):
    said = headline(ambiguous)
    (effect,) = ambiguous.effects
    assert effect.rivals
    for rival in effect.rivals:
        assert f"{rival.placed.label} ({chance(rival.probability)})" in said
    assert "in its place" in said
    twin = dataclasses.replace(effect.rivals[0], twin=True)
    said = headline(dataclasses.replace(ambiguous, effects=(dataclasses.replace(effect, rivals=(twin,)),)))
    assert f"these data cannot distinguish it from {twin.placed.label}" in said
    alone = dataclasses.replace(ambiguous, effects=(dataclasses.replace(effect, probability=0.9, rivals=()),))
    assert "that it is there at all is less sure than 95 %" in headline(alone)


def test_several_effects_make_a_sentence_that_can_be_read(paper):
    (effect,) = paper.effects
    other = dataclasses.replace(effect, size="5.0 ± 0.2 kg missing on floor 1", probability=0.97)
    two = headline(dataclasses.replace(paper, effects=(effect, other)))
    assert " and 5.0 ± 0.2 kg missing on floor 1 (97.0 % probable); the largest " in two
    three = headline(dataclasses.replace(paper, effects=(effect, other, other)))
    assert three.startswith(f"3 effects were found, the first: {effect.size.removesuffix(')')}")
    assert len(three) < 300
    rival = Rival(paper.candidates[1].placed, 0.2, False)
    doubtful = dataclasses.replace(other, rivals=(rival,))
    several = headline(dataclasses.replace(paper, verdict="ambiguous", effects=(effect, doubtful)))
    assert f"would explain them as well in place of {effect.placed.label}" in several
    many = dataclasses.replace(paper, verdict="ambiguous", effects=(effect, doubtful, doubtful))
    assert "in place of 2 of them something else would explain the data as well" in headline(many)
    assert repr(many).endswith("and 1 more>")
    unsure = dataclasses.replace(effect, placed=rival.placed, probability=0.92)
    said = headline(dataclasses.replace(paper, verdict="ambiguous", effects=(effect, unsure)))
    assert f"but that {rival.placed.label} is there at all is less sure than 95 %" in said


def test_an_unexplained_headline_says_where_the_residual_sits(unexplained):
    assert unexplained.remains[0] in headline(unexplained)
    assert "no effect that was looked for accounts for it" in headline(unexplained)


def test_an_adequate_headline_says_within_which_noise(paper):
    adequate = dataclasses.replace(paper, verdict="adequate", effects=(), steps=paper.steps[-1:])
    factor = paper.noise.to_dict()["frequency"]["factor"]
    assert f"within an estimated noise of {0.2 * factor:.2f} % of frequencies" in headline(adequate)
    assert f"gravity comes first ({chance(paper.candidates[0].probability)}, before 50.0 %)" in headline(adequate)


def test_the_headline_names_the_error_of_the_data_that_carried_the_verdict(paper):
    """A sensor gain changes no frequency, so its evidence lies in the shapes."""
    tested = cvxshear.Experiment.from_dict(experiment("sensor_gain", 3), name="gain")
    found = close_loop(tested, effects=["sensor_gain"])
    assert found.effects[0].placed.effect.name == "sensor_gain"
    shares = carried_by(found.before.estimate, found.estimate)
    assert next(iter(shares)) == "mode_shape"
    assert sum(shares.values()) == pytest.approx(1.0)
    first, last = (step.estimate.quality.max_shape_error for step in (found.before, found.after))
    assert f"the largest mode-shape error falls from {100 * first:.2f} % to {100 * last:.2f} %" in headline(found)
    assert re.search("Of the fall in chi-square, 9. % lie in the mode shapes and", terminal.text(found, width=1000))
    # By kind of data, the residual is the whole chi-square, because there is no prior.
    assert sum(chi2_by_kind(paper.estimate).values()) == pytest.approx(paper.estimate.chi2)
    same = headline(dataclasses.replace(paper, steps=(paper.after, paper.after)))
    assert "the largest frequency error stays at 0.34 %" in same


def test_a_provisional_effect_is_never_told_as_found(paper):
    found = dataclasses.replace(paper, verdict="unexplained", remains=("mode 2 of Structure 1",))
    said = terminal.text(found, width=1000)
    assert said.startswith("UNEXPLAINED: a significant residual is left in mode 2 of Structure 1; provisionally, ")
    assert "Provisional effects" in said
    assert "Effects found" not in said
    assert "None of them counts as found" in said


def test_a_verdict_from_outside_has_its_words_everywhere(paper, comparison, monkeypatch):
    mine = Verdict("postponed", "Somebody must look again.", "", "look again at {found}; {place}; {change}",
                   "nothing to look at", "Look again.", "#123456", "#abcdef")  # fmt: skip
    monkeypatch.setitem(VERDICTS, "postponed", mine)
    found = dataclasses.replace(paper, verdict="postponed")
    said = terminal.text(found, width=1000)
    assert said.startswith("POSTPONED: look again at ")
    # A part of the template without data in the result is omitted.
    assert "probable); the largest frequency error falls" in said.splitlines()[0]
    assert "Somebody must look again." in said
    assert "Look again." in describe(found)["next"].parts[0].text
    monkeypatch.setattr("cvxshear.report.html.drawings", lambda _: {})
    page = render(found, "cvxshear", comparison)
    assert '<span id="verdict">postponed</span>' in page
    assert "--tone: #123456; --tone-dark: #abcdef" in page
    assert (found.to_dict()["verdict"], found.to_dict()["provisional"]) == ("postponed", False)
    assert "postponed" in repr(found)
    with pytest.raises(ValueError, match=r"'wrong'.*may name model, found"):
        dataclasses.replace(mine, name="wrong", headline="{effects}")


def test_every_verdict_is_on_the_page_that_explains_them():
    page = (Path(__file__).parents[2] / "docs" / "howto" / "read-the-verdict.md").read_text()
    for verdict in VERDICTS.values():
        assert f"| `{verdict.name}` | {verdict.sentence} | {verdict.advice} |" in page


def test_states_and_frame_come_first_then_the_probabilities_of_the_result(ambiguous):
    document = describe(ambiguous)
    keys = [section.key for section in document.sections if section.parts]
    assert keys[:6] == ["verdict", "limits", "states", "frame", "effects", "candidates"]
    assert [section.key for section in document.sections if section.appendix] == [
        "declared", "frequencies", "not-considered", "effort"
    ]  # fmt: skip
    rows = [row[1:3] for row in table(ambiguous, "candidates-table").rows]
    assert rows == [(chance(item.prior), chance(item.probability)) for item in ambiguous.candidates]
    (effect,) = ambiguous.effects
    shown = [row[1] for row in table(ambiguous, "effects-table").rows]
    assert shown == [chance(item.probability) for item in (effect, *effect.rivals)]


def test_the_frame_that_a_person_reads_is_the_averaged_one(paper):
    identified = table(paper, "identified")
    lowest, total = (row for row in identified.rows[-2:])
    assert (lowest[0], total[0]) == ("1", "sum")
    assert float(total[1]) == pytest.approx(paper.averaged.floor_mass.sum(), rel=1e-4)
    shown = (paper.averaged.floor_mass[0], paper.averaged.story_stiffness[0] / 1000)
    for cell, value in zip(lowest[1:3], shown, strict=True):
        text = cell.split(" ± ")[0]
        assert abs(float(text) - value) <= 0.5001 * 10.0 ** -len(text.partition(".")[2])


def test_the_noise_is_told_in_percent_and_as_a_factor(paper, unexplained):
    said = terminal.text(paper)
    factor, std = (paper.noise.to_dict()["mode_shape"][key] for key in ("factor", "std"))
    assert f"{factor:.2f} ± {std:.2f} % (estimated: {factor:.2f} ± {std:.2f} times the default)" in said
    assert "noise of frequencies  as stated" in terminal.text(unexplained)
    one = {"frame": {"total_mass": 10.0}, "configuration": [{"frequencies": [2.0], "mode_shapes": [[1.0]]}]}
    assert "noise of mode shapes  the default: neither stated" in str(close_loop(one))


def test_a_fit_that_did_not_converge_is_said_wherever_its_numbers_are_shown(paper):
    fit = dataclasses.replace(paper.estimate.fit, reason=Ending.STEP_LIMIT)
    step = dataclasses.replace(paper.after, estimate=dataclasses.replace(paper.estimate, fit=fit))
    document = describe(dataclasses.replace(paper, steps=(paper.before, step)))
    assert any("NOT CONVERGED" in getattr(part, "text", "") for part in document["limits"].parts)
    found = cvxshear.identify(paper.experiment)
    stopped = dataclasses.replace(found, parts=(dataclasses.replace(found.parts[0], reason=Ending.STEP_LIMIT),))
    assert "NOT CONVERGED. " in str(stopped)
    assert "not converged" in repr(stopped)


@pytest.mark.parametrize("result", EVERY)
def test_print_shows_the_terminals_summary_folded_at_eighty_columns(result, request):
    found = request.getfixturevalue(result)
    said = str(found)
    assert max(cell_len(line) for line in said.splitlines()) <= 80
    assert said.startswith(f"{found.verdict.upper()}: ")
    assert len(said) < 20_000
    assert "nan" not in said.replace("resonan", "")


@pytest.mark.parametrize("result", EVERY)
def test_a_prompt_shows_one_short_line(result, request):
    found = request.getfixturevalue(result)
    for each in (found, found.experiment):
        assert "\n" not in repr(each)
        assert len(repr(each)) < 250
        assert notebook_html(each).count("<table") >= 1


def test_the_other_results_show_themselves(paper, study, comparison):
    assert repr(cvxshear.identify(paper.experiment, "two-stage")).startswith(
        "<Identification paper: two-stage, 2 stories"
    )
    assert repr(comparison).startswith(f"<Comparison paper: {len(cvxshear.backends.available())} backends on ")
    assert repr(study).startswith("<NoiseStudy 5 setups, 50 samples each, by two-stage, one-shot")
    for each in (study, comparison):
        assert max(map(cell_len, str(each).splitlines())) <= 80
        assert "<table" in notebook_html(each)


def test_a_wide_table_is_folded_and_loses_nothing():
    numbers = [f"{value:.5f}" for value in np.linspace(0, 1, 40)]
    wide = plain_table("title", "mode", *(f"floor {i}" for i in range(1, 41)), rows=[("1", *numbers)])
    console = terminal.Console(width=60, color_system=None)
    with console.capture() as captured:
        console.print(wide)
    shown = captured.get()
    assert max(map(cell_len, shown.splitlines())) <= 60
    assert all(number in shown for number in numbers)
    blocks = shown.removeprefix("title\n").split("\n\n")
    assert len(blocks) > 3
    assert all("mode" in block and "floor" in block for block in blocks)


def test_headers_that_must_be_wrapped_cost_no_number():
    """The columns fit only with wrapped headers; rich would equalize their widths and truncate the last one."""
    names = ("floor / story", "mass, kg", *["as planned"] * 3, "all floors", "stiffness, MN/m", "one less", "one more")
    cells = ("4", "16647", "1.67 %", "1.85 %", "1.53 %", "1.46 %", "69.58", "1.55 %", "3.64 %")
    table = plain_table("title", *names, rows=[cells])
    for width in range(78, 130):
        console = terminal.Console(width=width, color_system=None)
        with console.capture() as captured:
            console.print(table)
        assert "3.64 %" in captured.get(), width
        assert "1.55 %" in captured.get(), width


def test_names_are_data(unexplained):
    steering = "a[bold]b\x1b[31m\r\n\u202ec"
    renamed = dataclasses.replace(unexplained.experiment, name=steering)
    for said in (str(renamed), repr(renamed), notebook_html(renamed)):
        assert "\x1b" not in said
        assert "\u202e" not in said
        assert "a[bold]b\\x1b[31m\\r\\n\\u202ec" in said
    joined = " ".join(line.strip() for line in str(unexplained).splitlines())
    assert NASTY in joined


def test_quantities_have_units_that_fit_their_size():
    assert quantities.with_std(18_500.0, 120.0, "kg") == "18.50 ± 0.12 t"
    assert quantities.with_std(3.01, 0.03, "kg") == "3.010 ± 0.030 kg"
    assert quantities.with_std(4.1e6, 2e4, "N/m") == "4100 ± 20 kN/m"
    assert quantities.per_force(1.7e-11, 3e-12, "rad/(N m)") == "0.0170 ± 0.0030 rad/(GN m)"
    assert quantities.per_force(2.5e-6, None, "1/(N m2)") == "2.5 1/(MN m2)"
    assert quantities.per_force(3.0, 0.2, "m/N") == "3.00 ± 0.20 m/N"
    assert quantities.with_std(1.7e-11, 3e-12, "rad/(N m)") == "(1.70 ± 0.30)e-11 rad/(N m)"
    assert quantities.with_std(float("nan"), None, "kg") == "not determined"
    assert quantities.with_std(6.675, 1e-16, "kg") == "6.675 kg"
    assert quantities.percent(1.2e-6) == "< 0.01 %"
    assert quantities.percents([0.0001, 0.00002, None, 0.0]) == ["0.010 %", "0.002 %", "–", "0.000 %"]
    assert quantities.percents([0.001, -0.001, -1e-7, 0.0], sign=True) == ["+0.10 %", "-0.10 %", "0.00 %", "0.00 %"]
    assert [quantities.signed(value, 1) for value in (0.04, -0.04, -0.06, 1.0)] == ["0.0", "0.0", "-0.1", "+1.0"]
    assert [quantities.equals(value) for value in (0.0123, 1e-12)] == ["p = 0.012", "p < 1e-9"]
    assert quantities.with_stds([0.5, 1.0, -0.25], [0.0123, 0.0, 0.001]) == ["0.500 ± 0.012", "1.000", "-0.250 ± 0.001"]
    assert quantities.with_stds([1.0, 0.5], [0.01, 0.01]) == ["1.000 ± 0.010", "0.500 ± 0.010"]
    assert quantities.with_stds([0.5, math.nan], [math.nan, math.nan]) == ["0.5000", "–"]
    assert [quantities.ranged(row) for row in ([1, 2, 3], [1, 2, 3, 4], [1, 11, 12, 13, 14], [2])] == [
        "1, 2, 3", "1 to 4", "1, 11 to 14", "2",
    ]  # fmt: skip
    assert quantities.significants([160.94, 9.97, None]) == ["160.9", "10.0", "–"]
    assert [quantities.significant(value, 2) for value in (110.0, 3.75, 1e-7)] == ["110", "3.8", "1.0e-07"]
    assert [chance(value) for value in (0.0, 0.218, 0.9986, 1.0)] == ["< 0.1 %", "21.8 %", "99.9 %", "> 99.9 %"]


def test_results_become_tables_of_pandas(paper):
    pandas = pytest.importorskip("pandas")
    apart = cvxshear.identify(paper.experiment, "two-stage").to_dataframe()
    assert isinstance(apart, pandas.DataFrame)
    assert apart["configuration"].tolist() == [name for i in (1, 2, 3) for name in [f"Structure {i}"] * 2]
    assert apart["floor_mass_kg"].iloc[:2].tolist() == pytest.approx([13.045, 18.285], abs=5e-4)
    assert apart["floor_mass_std_kg"].isna().all()
    closed = paper.to_dataframe()
    assert closed["story_stiffness_N_per_m"].tolist() == paper.averaged.story_stiffness.tolist()
    assert closed["floor_mass_std_kg"].tolist() == paper.averaged.floor_mass_std.tolist()


def test_without_pandas_the_extra_is_named(paper, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pip install pandas"):
        paper.to_dataframe()


def test_masses_in_tonnes_are_told_so(paper):
    unknown = np.full(2, np.nan)
    heavy = IdentifiedFrame(1000 * paper.frame.floor_mass, 1000 * paper.frame.story_stiffness, unknown, unknown)
    found = cvxshear.identify(paper.experiment, "two-stage")
    parts = tuple(dataclasses.replace(part, frame=heavy) for part in found.parts)
    first = table(dataclasses.replace(found, parts=parts), "identified-1")
    assert first.head == ("floor / story", "mass, t", "stiffness, MN/m")
    *floors, total = (float(row[1]) for row in first.rows)
    assert floors == pytest.approx(paper.frame.floor_mass[::-1], rel=1e-3)
    assert total == pytest.approx(31.33)


def test_parameters_are_said_in_words():
    stories = [f"story_stiffness {place}" for place in range(1, 6)]
    assert in_words([*stories, "floor_mass 2"]) == "story stiffnesses 1 to 5 and floor mass 2"
    assert in_words(["floor_mass 3", "floor_mass 1", "gravity"]) == "floor masses 1, 3 and gravity"


def test_what_is_held_fast_has_one_format_in_its_column():
    """The masses are declared, a stiffness is not, and one value is undetermined."""
    frame = IdentifiedFrame(
        np.array([21020.0, 20612.0, 21224.0]),
        np.array([120e6, 98.3e6, math.nan]),
        np.zeros(3),
        np.array([9.5e6, 0.0, math.nan]),
    )
    *rows, _ = frame_table(frame, "", quantities.AUTOMATIC).rows
    assert [row[1] for row in rows] == ["21.224", "20.612", "21.020"]
    assert [row[2] for row in rows] == ["not determined", "98.3", "120.0 ± 9.5"]


def test_where_mass_was_added_is_told_in_the_unit_of_the_frame():
    declared = experiment(None, 6, 2)
    for each, added in zip(declared["configuration"], ([0.0] * 6, [0.0, 0.0, 500.0, 0.0, 0.0, 0.0]), strict=True):
        each["added_mass"] = added
    declared["frame"]["total_mass"] = 106.5e3
    rows = table(cvxshear.Experiment.from_dict(declared), "tests").rows
    assert [row[3] for row in rows] == ["none", "0.5 t on floor 3"]
    for each in declared["configuration"]:
        del each["mode_shapes"], each["mode_shape_std"], each["measured_floors"]
    rows = table(cvxshear.Experiment.from_dict(declared), "tests").rows
    assert [row[2] for row in rows] == ["none", "none"]


def test_a_wide_table_goes_below_itself():
    wide = table_of_rows("k", "title", ("floor", *(f"mode {mode}" for mode in range(1, 8))), [tuple("abcdefgh")])
    parts = wide.folded(3)
    assert [part.head for part in parts] == [
        ("floor", "mode 1", "mode 2", "mode 3"), ("floor", "mode 4", "mode 5", "mode 6"), ("floor", "mode 7"),
    ]  # fmt: skip
    assert [part.rows[0] for part in parts] == [tuple("abcd"), tuple("aefg"), tuple("ah")]
    assert len({part.key for part in parts}) == 3
    assert wide.folded(7) == (wide,)


def test_print_in_a_notebook_shows_the_text_alone(paper, monkeypatch):
    shown = []
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr("rich.jupyter.display", lambda *args: shown.append(args))
    assert str(paper).startswith("EXPLAINED")
    assert shown == []
