"""Test the text of the report: self-contained, equal to the result, and without markup from input files."""

import dataclasses
import datetime
import html
import json
import re
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

import cvxshear
from cvxshear import close_loop
from cvxshear.loop.results import VERDICTS
from cvxshear.report.blocks import describe
from cvxshear.report.html import drawings, render
from cvxshear.report.terminal import notebook_html
from cvxshear.util.errors import InputError
from tests.report.conftest import NASTY, experiment

COMMAND = "cvxshear loop 'a & b.toml' --report <out>.html"
VOID = {"meta", "link", "br", "img", "hr", "input"}


class Page(HTMLParser):
    """Tags, ids and headings of a page; every opened tag must be closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.ids, self.attributes = [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes.append((tag, dict(attrs)))
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def text(unexplained):
    return render(unexplained, COMMAND)


@pytest.fixture(scope="module")
def page(text):
    return Page(text)


@pytest.fixture(scope="module")
def drawn(paper):
    """Return the figures of the paper's frame, drawn once."""
    return drawings(paper)


@pytest.fixture
def drawn_once(drawn, monkeypatch):
    monkeypatch.setattr("cvxshear.report.html.drawings", lambda result: drawn)


@pytest.fixture
def of_paper(paper, comparison, drawn_once):
    return render(paper, COMMAND, comparison)


def test_nothing_of_a_file_is_let_through_as_markup(text, page):
    assert "<img" not in text
    assert html.escape(NASTY, quote=False).split('"')[0] in text
    assert "img" not in page.tags
    assert "script" not in page.tags
    assert html.escape(COMMAND, quote=False).replace("'", "&#39;") in text


def test_the_page_refers_to_nothing_outside_itself(page):
    for tag, attributes in page.attributes:
        for name in ("src", "href", "xlink:href", "action", "data", "poster"):
            assert attributes.get(name, "#").startswith(("#", "data:")), (tag, attributes)
    assert "http-equiv" in dict(page.attributes[[tag for tag, _ in page.attributes].index("meta") + 2][1])


def test_ids_are_unique_and_every_reference_has_its_aim(text, page):
    assert len(page.ids) == len(set(page.ids))
    aims = set(re.findall(r'href="#([^"]+)"', text)) | set(re.findall(r"url\(#([^)]+)\)", text))
    assert aims
    assert aims <= set(page.ids)


def test_headings_descend_one_at_a_time_and_images_have_words(page):
    levels = [int(tag[1]) for tag in page.tags if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert np.diff(levels).max() == 1
    drawings = [attributes for _, attributes in page.attributes if attributes.get("role") == "img"]
    # Without effects, the verdict has the picture of the frame.
    assert len(drawings) == 4
    assert all(attributes["aria-label"].strip() for attributes in drawings)
    hidden = [attributes for tag, attributes in page.attributes if tag == "svg" and attributes.get("role") != "img"]
    assert len(hidden) >= 4
    assert all(attributes["aria-hidden"] == "true" for attributes in hidden)


def contrast(foreground, background):
    """Return the contrast of two colors (such as #1b1b1b) by the accessibility guidelines (WCAG)."""

    def luminance(colour):
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    light, dark = sorted([luminance(foreground), luminance(background)], reverse=True)
    return (light + 0.05) / (dark + 0.05)


def test_letters_stand_out_from_what_is_behind_them(text):
    """Check light and dark mode: letters on the page and on shaded parts, and the verdict's mark beside the page."""
    themes = [dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", part)) for part in re.findall(r":root {([^}]*)}", text)]
    assert len(themes) == 2
    for colours, tone in zip(themes, ("colour", "dark"), strict=True):
        for name in ("ink", "quiet", "link", "warn"):
            assert min(contrast(colours[name], colours[ground]) for ground in ("paper", "shade")) > 4.5
        for verdict in VERDICTS.values():
            assert contrast(getattr(verdict, tone), colours["paper"]) > 4.5


@pytest.mark.usefixtures("drawn_once")
def test_the_head_of_a_report_is_what_the_file_says(paper, comparison, drawn_once):
    heading = {"title": "Frame 7 after repair", "client": "A & B <Ltd>", "date": datetime.date(2026, 11, 20)}
    declared = {**paper.experiment.to_dict(), "report": heading}
    tested = cvxshear.Experiment.from_dict(declared)
    assert cvxshear.Experiment.from_dict(tested.to_dict()).report == tested.report
    page = render(dataclasses.replace(paper, experiment=tested), COMMAND, comparison)
    assert "<dt>client</dt><dd>A &amp; B &lt;Ltd&gt;</dd>" in page
    assert "<dt>date</dt><dd>2026-11-20</dd>" in page
    assert "<h1>Frame 7 after repair</h1>" in page
    with pytest.raises(InputError, match="report: title must be a text that is not empty, not 3"):
        cvxshear.Experiment.from_dict({**declared, "report": {"title": 3}})


def test_the_first_screen_is_the_picture_of_what_was_found(of_paper):
    order = ("verdict", "headline", "figure-findings", "states", "identified", "effects-table", "candidates-table",
             "errors", "next", "appendix", "tests", "not-looked-for", "backends")  # fmt: skip
    places = [of_paper.index(f'id="{each}"') for each in order]
    assert places == sorted(places)
    assert Page(of_paper).tags[:1] == ["html"]


def test_the_whole_result_and_measurement_stand_in_the_report(text, unexplained):
    found = {key: html.unescape(re.search(rf'<pre id="{key}">(.*?)</pre>', text, re.DOTALL)[1]) for key in
             ("result", "measurement")}  # fmt: skip
    assert json.loads(found["result"]) == json.loads(json.dumps(unexplained.to_dict()))
    again = cvxshear.Experiment.from_dict(json.loads(found["measurement"]))
    assert again.configurations[0].name == NASTY
    assert again.configurations[0].frequencies == pytest.approx(unexplained.experiment.configurations[0].frequencies)


def test_what_was_not_measured_is_null_in_the_report(paper, comparison, drawn_once):
    declared = paper.experiment.to_dict()
    declared["configuration"][0]["damping_ratios"] = [0.01, np.nan]
    tested = dataclasses.replace(paper, experiment=cvxshear.Experiment.from_dict(declared))
    written = re.search(r'<pre id="measurement">(.*?)</pre>', render(tested, COMMAND, comparison), re.DOTALL)[1]
    assert json.loads(html.unescape(written))["configuration"][0]["damping_ratios"] == [0.01, None]


def test_results_show_themselves_in_a_notebook(paper, unexplained, comparison):
    shown = notebook_html(paper)
    assert paper.effects[0].size.removesuffix(")") in html.unescape(shown)
    assert shown.count('<img src="data:image/png;base64,') == 1
    assert f"{paper.averaged.story_stiffness[0] / 1000:.1f}" in shown
    Page(shown)
    assert '<img src="http' not in notebook_html(unexplained)
    identified = notebook_html(cvxshear.identify(paper.experiment, method="two-stage"))
    assert "stiffness, kN/m" in identified
    assert "25.517" in identified
    Page(identified)
    Page(notebook_html(comparison))


def test_importing_the_library_loads_no_report_and_a_printed_result_loads_nothing_that_it_does_not_need():
    code = (
        "import cvxshear, sys\n"
        "found = cvxshear.identify(cvxshear.load('paper'))\n"
        "before = {name for name in sys.modules if name.startswith('cvxshear')}\n"
        "print(any('report' in name for name in before), len(str(found)) > 100)\n"
        "print(len([name for name in sys.modules if name.startswith('cvxshear') and name not in before]))\n"
        "print('matplotlib' in sys.modules, 'jinja2' in sys.modules)\n"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, count, last = shown.stdout.splitlines()
    assert (first, last) == ("False True", "False False")
    assert int(count) < 10


def states_table(result, key="stories"):
    """Return the rows of a table of states by their floor or story, the lowest first."""
    tables = [part for part in describe(result)["states"].parts if part.key.split("-")[0] == key]
    return [[cell for each in tables for cell in each.rows[-place][bool(each is not tables[0]) :]]
            for place in range(1, result.experiment.stories + 1)]  # fmt: skip


def test_what_gravity_takes_from_the_stories_of_each_state(paper):
    """P-delta of bending columns by hand: 6/5 of the weight above story 1 over its height."""
    mass, stiffness = paper.frame.floor_mass, paper.frame.story_stiffness[0]
    averaged = paper.averaged.story_stiffness[0]
    lowest = states_table(paper)[0]
    for cell, added in zip(lowest[2:], (22.1, 50.1, 77.1), strict=True):
        load = 1.2 * 9.81 * (mass.sum() + added) / 0.39
        left, change = cell.removesuffix(" %)").split(" (")
        # The change belongs to the verdict's set; it starts from the averaged value.
        assert float(left) == pytest.approx(averaged * (1 - load / stiffness) / 1e3, rel=1e-4)
        value, std = map(float, change.split(" ± "))
        assert value == pytest.approx(-100 * load / stiffness, rel=2e-3)
        # The load is proportional to gamma, so both have one relative deviation.
        assert std / abs(value) == pytest.approx(paper.effects[0].std["gamma"] / 1.2, rel=0.5)


def test_what_rocking_takes_from_every_story(eight):
    """A force of 1 N at the top turns the base by z_top / k_theta; each story drifts by its height times this angle."""
    theta, z = eight.judged.theta, 0.39 * np.arange(1, 9)
    drift = 1.0 / theta[8:16] + 0.39 * z[-1] * theta[16]
    softer = [float(row[2].split(" (")[1].split(" ± ")[0]) for row in states_table(eight)]
    assert softer == pytest.approx(100 * (1.0 / drift / theta[8:16] - 1.0), abs=0.05)


def test_before_after_and_change_of_the_story_that_lost_stiffness():
    """The reference state is before; the floor that got an undeclared mass has a table of its own."""
    declared = experiment("story_change", 3, 2, noise=1e-3)
    names = [each.setdefault("state", each["name"]) for each in declared["configuration"]]
    declared["frame"]["reference"] = names[0]
    tested = cvxshear.Experiment.from_dict(declared)
    kinds = {item.name: item for item in cvxshear.effects.catalogue()}
    for name, key in (("story_change", "stories"), ("added_mass", "floors")):
        placed = cvxshear.effects.LocatedEffect(kinds[name], kinds[name].places(tested)[-1])
        result = close_loop(tested, effects=[], assume=[placed])
        place = placed.place.story or placed.place.floor
        rows = states_table(result, key)
        for number, (_, before, after) in enumerate(rows, 1):
            assert ("(" in after) == (number == place)
            if number != place:
                assert after == before
        size = result.judged.theta[-1]
        whole = 1.0 if name == "story_change" else result.frame.floor_mass[place - 1]
        value = float(rows[place - 1][2].split(" (")[1].split(" ± ")[0])
        assert value == pytest.approx(100 * size / whole, rel=0.01)
        assert len(describe(result)["states"].parts) == 1


def sways(outline):
    """Return the sway of each floor in the outline of a frame, in halves of its width."""
    corners = np.array(re.findall(r"L(-?[\d.]+) (-?[\d.]+)h60", outline), dtype=float)
    return corners[:, 0] / 30 + 1


def test_the_modes_in_motion_are_those_of_the_final_model(paper, of_paper):
    """The page states the predicted shapes, and its outlines show them."""
    drawing = re.search(r'<figure id="figure-swaying">(.*?)</figure>', of_paper, re.DOTALL)[1]
    assert "<script" not in of_paper
    panels = re.findall(r"<title>mode (\d): .*?up: (.*?)</title>(.*?)</g></g>", drawing, re.DOTALL)
    assert [int(mode) for mode, _, _ in panels] == [1, 2]
    predicted = paper.estimate.predictions[0].mode_shapes
    expected = [shape / shape[np.argmax(np.abs(shape))] for shape in predicted]
    for (_, stated, drawn), shape in zip(panels, expected, strict=True):
        np.testing.assert_allclose([float(each) for each in stated.split(", ")], shape, atol=6e-4)
        left, right, again = (sways(each) for each in re.search(r'values="(M.*?)"', drawn)[1].split(";"))
        np.testing.assert_allclose([left, right, again], [shape, -shape, shape], atol=2e-3)
        still = re.search(r'class="still"><path class="rest" d=".*?"/><path d="(.*?)"', drawn)[1]
        np.testing.assert_allclose(sways(still), shape, atol=2e-3)
