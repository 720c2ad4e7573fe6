"""The site builds from a clean checkout, a warning counting as an error."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs import runner

ROOT = Path(__file__).parents[2]
NEEDED = ("sphinx", "myst_parser", "numpydoc", "furo", "latex2mathml", "matplotlib")

BUILD = f"""
import runpy, sys
runpy.run_path({runner.__file__!r})["share"]()
from sphinx.cmd.build import main
sys.exit(main(sys.argv[1:]))
"""
"""As `python -m sphinx`, but loops that pages of `test_blocks` close as well are closed once."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    absent = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if absent and os.environ.get("CI"):
        pytest.fail(f"continuous integration must install the docs extra; missing: {', '.join(absent)}")
    if absent:
        pytest.skip(f"needs the docs extra; missing: {', '.join(absent)}")
    folder = tmp_path_factory.mktemp("docs")
    # The figures of the gallery are drawn beside its page, so the build has a copy to itself.
    for name in ("docs", "examples"):
        shutil.copytree(ROOT / name, folder / name)
    for name in ("CHANGELOG.md", "README.md"):
        shutil.copy(ROOT / name, folder)
    found = subprocess.run(
        [sys.executable, "-P", "-c", BUILD, "-W", "-q", "-b", "html", "docs", "build/docs"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    complaints = [line for line in found.stderr.splitlines() if " INFO " not in line and line.strip()]
    assert found.returncode == 0, "\n".join(complaints)
    return folder / "build" / "docs"


def test_every_page_is_there(site):
    pages = {path.relative_to(ROOT / "docs").with_suffix("") for path in (ROOT / "docs").rglob("*.md")}
    assert pages == {
        path.relative_to(site).with_suffix("")
        for path in site.rglob("*.html")
        if path.stem not in {"genindex", "py-modindex", "search"}
    }


def test_every_image_is_there_with_an_alternative_text(site):
    found = set()
    for page in site.rglob("*.html"):
        for image in re.findall(r"<img[^>]*>", page.read_text()):
            assert re.search(r'alt="[^"]{3,}"', image), f"{page.name}: {image}"
            found.add((page.parent / re.search(r' src="([^"]+)"', image)[1]).resolve())
    assert len(found) > 5
    assert all(path.stat().st_size > 0 for path in found)


def test_the_pages_fetch_nothing(site):
    for page in site.rglob("*.html"):
        fetched = re.findall(r'<(?:script|link|img|iframe)[^>]*(?:src|href)="(https?:[^"]+)"', page.read_text())
        assert not fetched, f"{page.name} would fetch {fetched}"


def test_the_public_face_is_in_the_reference(site):
    import cvxshear  # noqa: PLC0415

    text = "".join(path.read_text() for path in (site / "api").glob("*.html"))
    documented = set(re.findall(r'id="cvxshear\.(?:\w+\.)*(\w+)"', text))
    modules = {"backends", "effects", "priors", "programs"}
    assert set(cvxshear.__all__) - modules <= documented
    assert {*cvxshear.effects.__all__, *cvxshear.priors.__all__, *cvxshear.backends.__all__} - {
        "QUANTITIES",
        "QUANTITY_UNITS",
    } <= documented


def test_every_figure_is_in_the_reference(site):
    figures = pytest.importorskip("cvxshear.report.figures")
    page = (site / "api" / "figures.html").read_text()
    assert [name for name in figures.__all__ if f'id="cvxshear.report.figures.{name}"' not in page] == []
