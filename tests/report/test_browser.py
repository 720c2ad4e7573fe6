"""Test reports in a headless Chromium; without one on the PATH these are skipped, or fail where CI is set."""

import json
import os
import shutil

import numpy as np
import pytest

import cvxshear
from cvxshear import backends
from cvxshear.fit.efficient import efficient
from cvxshear.records import identify_modes
from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.records.simulate import PAPER_FRAME, base_record, hammer_record
from cvxshear.report.html import render
from cvxshear.response import predict
from tests.report.conftest import table
from tests.report.test_modal_figures import twenty_modes
from tests.response.common import damped_frame, declared, shaking

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
DESKTOP, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}
A4 = {"width": 680, "height": 1000}


def missing(what):
    """Skip, or fail if the tests are mandatory."""
    if os.environ.get("CI"):
        pytest.fail(f"the browser tests need {what}")
    pytest.skip(f"needs {what}")


@pytest.fixture(scope="module")
def browser():
    path = next((found for name in NAMES if (found := shutil.which(name))), None)
    if path is None:
        missing(f"a Chromium on the PATH, under one of the names {', '.join(NAMES)}")
    try:
        from playwright.sync_api import sync_playwright  # noqa: PLC0415
    except ImportError:
        missing("the package playwright")
    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=path, args=list(FLAGS))
        yield started
        started.close()


@pytest.fixture(scope="module")
def reports(paper, eight, unexplained, comparison, shared_drawings, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports")
    results = {"paper": paper, "eight": eight, "unexplained": unexplained}
    for name, result in results.items():
        (folder / f"{name}.html").write_text(render(result, f"cvxshear loop {name}.toml", comparison))
    base = base_record(PAPER_FRAME, 0, noise=0.01, duration=240.0)
    records = (hammer_record(PAPER_FRAME, 0, noise=0.01, hits=2), base)
    modes = [identify_modes(record, functions=True) for record in records]
    (folder / "modes.html").write_text(render(modes, "cvxshear modes a.toml b.toml"))
    (folder / "tall.html").write_text(render([twenty_modes(modes[0].sweep)], "cvxshear modes c.toml"))
    return folder, results


@pytest.fixture(scope="module")
def pages():
    """Return the open reports by name, because loading a report is slower than a change of view."""
    return {}


@pytest.fixture
def opened(browser, reports, pages):
    """Open a report; at the end, check that it gave no errors and loaded no other file."""
    called = []

    def load(name):
        page = browser.new_page()
        said, asked = [], []
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto((reports[0] / f"{name}.html").as_uri())
        return page, said, asked

    def call(name, viewport=DESKTOP, media="screen", color_scheme="light"):
        pages[name] = pages.get(name) or load(name)
        page = pages[name][0]
        page.set_viewport_size(viewport)
        page.emulate_media(media=media, color_scheme=color_scheme)
        called.append(name)
        return page

    yield call
    for name in called:
        _, said, asked = pages[name]
        assert said == []
        assert all(url.startswith(("file:", "data:")) for url in asked)
        assert len([url for url in asked if url.startswith("file:")]) == 1


def assert_fits(page, parts=None):
    """Assert that the page, and these parts of it, do not run over their edges."""
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    for part in page.query_selector_all(parts) if parts else ():
        assert part.evaluate("each => each.scrollWidth <= each.clientWidth"), part.get_attribute("aria-label")


EVERY = pytest.mark.parametrize("name", ["paper", "eight", "unexplained"])


@EVERY
def test_the_page_says_what_the_json_says(opened, reports, name):
    page = opened(name)
    result = json.loads(json.dumps(reports[1][name].to_dict()))
    assert page.inner_text("#verdict") == result["verdict"]
    assert json.loads(page.text_content("#result")) == result
    errors = table(reports[1][name], "errors")
    rows = [row.query_selector_all("th, td") for row in page.query_selector_all("#errors tbody tr")]
    assert [tuple(cell.inner_text() for cell in row) for row in rows] == list(errors.rows)
    written = set(zip(errors.columns[1].values, errors.columns[2].values, strict=True))
    assert written == {(result["before"][key], result["after"][key]) for key in result["before"]} - {(None, None)}
    # The table has one row per floor and their sum.
    assert len(page.query_selector_all("#identified tbody tr")) == len(result["frame"]["floor_mass"]) + 1
    for effect in result["effects"]:
        assert effect["size"].removesuffix(")")[1:] in page.inner_text("#headline")


@EVERY
@pytest.mark.parametrize("viewport", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_figures_have_size_and_the_page_does_not_run_over_its_edge(opened, name, viewport):
    page = opened(name, viewport)
    drawings = page.query_selector_all(".drawing svg")
    assert len(drawings) >= 4
    for drawing in drawings:
        box = drawing.bounding_box()
        assert box["width"] > 50
        assert box["height"] > 50
    assert_fits(page, ".scroll:has(> .cards)")


@pytest.mark.parametrize("viewport", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_a_prediction_does_not_run_over_its_edge(browser, tmp_path, viewport):
    mass, stiffness, _ = damped_frame(12)
    estimate = efficient(cvxshear.Experiment.from_dict(declared(mass, stiffness, [0.02] * 12)), backends.get("auto"))
    prediction = predict(estimate, DrivenRecord((DrivenRun(shaking(600)),), 100.0))
    (tmp_path / "p.html").write_text(render(prediction, "cvxshear"))
    page = browser.new_page(viewport=viewport)
    page.goto((tmp_path / "p.html").as_uri())
    drawings = page.query_selector_all(".drawing svg")
    assert len(drawings) == 2
    assert all(drawing.bounding_box()["height"] > 50 for drawing in drawings)
    assert len(page.query_selector_all(".scroll")) >= 3
    assert_fits(page, ".scroll" if viewport is DESKTOP else None)
    page.close()


@pytest.mark.parametrize(("name", "figures"), [("modes", 4), ("tall", 3)])
@pytest.mark.parametrize("viewport", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_the_report_of_modes_does_not_run_over_its_edge_and_can_be_read(opened, name, figures, viewport):
    page = opened(name, viewport)
    drawings = page.query_selector_all(".drawing svg")
    assert len(drawings) == figures
    for drawing in drawings:
        shown, natural = drawing.bounding_box()["width"], float(drawing.get_attribute("width"))
        # The smallest letters have 6.5 points in a drawing of natural width, with 1.4 pixels per point.
        assert 0.85 * natural <= shown <= natural
    assert_fits(page, ".scroll" if viewport is DESKTOP else None)
    ids = page.evaluate("[...document.querySelectorAll('[id]')].map(each => each.id)")
    assert [each for each in set(ids) if ids.count(each) > 1] == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_letters_and_lines_of_a_drawing_stand_out_from_the_page(opened, scheme):
    page = opened("paper", color_scheme=scheme)
    shades = page.evaluate(
        """() => {
            const shade = text => { const c = text.match(/\\d+/g).map(Number); return (c[0] + c[1] + c[2]) / 3; };
            const svg = document.querySelector("#figure-shapes svg");
            const line = [...svg.querySelectorAll("path")].find(each => /stroke: var\\(--c0072b2/.test(each.outerHTML))
                || svg.querySelector("use");
            return [getComputedStyle(document.body).backgroundColor, getComputedStyle(svg).fill,
                    getComputedStyle(line).stroke].filter(each => /rgb/.test(each)).map(shade);
        }"""
    )
    paper, *inks = shades
    assert (paper < 60) == (scheme == "dark")
    assert inks
    assert all(abs(ink - paper) > 80 for ink in inks)


def test_a_mode_sways_on_a_screen_and_stands_still_elsewhere(opened):
    """The frame at rest reaches from -30 to 30, and its largest sway is 30; the animation takes two seconds."""
    page = opened("paper")
    ends = """time => {
        const svg = document.querySelector("#figure-swaying svg");
        svg.pauseAnimations(); svg.setCurrentTime(time);
        const box = svg.querySelector(".moving path:not(.rest)").getBBox();
        return [box.x, box.x + box.width];
    }"""
    for time, expected in ((0.0, [-30, 60]), (0.5, [-30, 30]), (1.0, [-60, 30]), (2.0, [-30, 60])):
        np.testing.assert_allclose(page.evaluate(ends, time), expected, atol=0.2)
    seen = [page.locator(f"#figure-swaying {each} >> nth=0") for each in (".moving", ".still", ".hold")]
    assert [each.is_visible() for each in seen] == [True, False, True]
    page.check(".hold input")
    assert [each.is_visible() for each in seen] == [False, True, True]
    page.uncheck(".hold input")
    page.emulate_media(reduced_motion="reduce")
    assert [each.is_visible() for each in seen] == [False, True, False]
    page.emulate_media(reduced_motion="no-preference", media="print")
    assert [each.is_visible() for each in seen] == [False, True, False]


def test_the_report_is_whole_without_scripts_and_a_mouse(browser, reports):
    context = browser.new_context(java_script_enabled=False, viewport=DESKTOP)
    page = context.new_page()
    page.goto((reports[0] / "paper.html").as_uri())
    assert page.inner_text("#verdict") == "explained"
    assert page.query_selector(".drawing svg").bounding_box()["width"] > 50
    # The first Tab stop is the link to the result.
    page.keyboard.press("Tab")
    assert page.inner_text(":focus") == "To the result"
    context.close()


@EVERY
def test_nothing_is_cut_off_on_paper(opened, name, tmp_path):
    page = opened(name, A4, media="print")
    assert_fits(page)
    assert not page.is_visible("nav")
    sheet = tmp_path / "report.pdf"
    page.pdf(path=sheet, prefer_css_page_size=True)
    assert sheet.read_bytes().startswith(b"%PDF")
