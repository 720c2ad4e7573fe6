"""What the documentation shows runs, and prints what the page says it prints."""

import ast
import functools
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import cvxshear
from tests.docs import runner
from tests.docs.runner import Block, blocks, commands

pytestmark = pytest.mark.xdist_group("pages")  # run once, and looked at by every test

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(path for path in DOCS.rglob("*.md"))]
RUN = [page for page in PAGES if any(block.language in ("python", "console") for block in blocks(page.read_text()))]
TOLERANCE = 0.02
"""Relative difference of two printed numbers that a page need not be mended for: other machines round otherwise."""

PLACE = re.compile(r"`([\w/]+\.py):([\w.]+)`")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")


@functools.cache
def results():
    found = subprocess.run(
        [sys.executable, "-W", "error", runner.__file__, str(ROOT / "examples"), *map(str, RUN)],
        capture_output=True,
        text=True,
        check=False,
        # The folder of the tests comes first otherwise, and with it the checkout's package in place of the wheel's.
        env={**os.environ, "PYTHONSAFEPATH": "1"},
    )
    assert found.returncode == 0, found.stderr
    return json.loads(found.stdout)


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def alike(shown: str, printed: str) -> bool:
    """Whether two lines agree: word for word, numbers within `TOLERANCE`; "..." stands for any words."""
    if "..." in shown.split():
        before, _, after = shown.partition("...")
        return printed.split()[: len(before.split())] == before.split() and printed.rstrip().endswith(after.strip())
    if NUMBER.sub("#", shown).split() != NUMBER.sub("#", printed).split():
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(abs(float(a) - float(b)) <= TOLERANCE * max(abs(float(a)), abs(float(b))) + last(a) for a, b in pairs)


def last(number: str) -> float:
    """One unit of the last digit of a printed number."""
    digits, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))


def missing(shown: str, printed: str) -> list[str]:
    """The lines shown that were not printed, or not in this order."""
    lines = iter(printed.splitlines())
    wanted = [line for line in shown.splitlines() if line.strip() and line.strip() != "..."]
    return [line for line in wanted if not any(alike(line, other) for other in lines)]


def shown_outputs(page: Path) -> list[tuple[str, str]]:
    """Key of `runner.run_page`, and the output that the page shows for it."""
    found: list[tuple[str, str]] = []
    before: Block | None = None
    for block in blocks(page.read_text()):
        if block.language == "output" and not block.lacks_data:
            assert before is not None, f"{name_of(page)}: the output at line {block.line} belongs to no python block"
            found.append((str(before.line), block.text))
        elif block.language == "console" and block.runs:
            found += [(f"{block.line}:{place}", shown) for place, (_, shown) in enumerate(commands(block))]
        before = block if block.language == "python" and block.runs else before
    return found


@pytest.mark.parametrize("page", RUN, ids=name_of)
def test_every_block_of_the_page_runs(page):
    printed = results()[str(page)]
    assert "error" not in printed, printed["error"]
    if any(block.lacks_data for block in blocks(page.read_text())):
        pytest.skip(f"measured data beside the project (CVXSHEAR_SHARED): the blocks of {name_of(page)} read them")


@pytest.mark.parametrize("page", [page for page in RUN if shown_outputs(page)], ids=name_of)
def test_the_page_shows_what_is_printed(page):
    printed = results()[str(page)]
    for key, shown in shown_outputs(page):
        assert key in printed, f"{name_of(page)}: the block at line {key} was not run"
        assert not missing(shown, printed[key]), f"line {key} prints\n{printed[key]}"


@pytest.mark.parametrize("page", [page for page in PAGES if PLACE.search(page.read_text())], ids=name_of)
def test_every_place_in_the_code_exists(page):
    for path, name in PLACE.findall(page.read_text()):
        source = Path(cvxshear.__file__).parent / path
        assert source.is_file(), f"{name_of(page)} names {path}, which is not there"
        assert name in names_in(source), f"{name_of(page)} names {name}, which is not in {path}"


@functools.cache
def names_in(source: Path) -> set[str]:
    """Functions, classes, their methods (as Class.method) and constants of a module."""
    found: set[str] = set()
    for node in ast.parse(source.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{inner.name}" for inner in node.body if isinstance(inner, ast.FunctionDef)}
        if isinstance(node, ast.Assign):
            found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return found


def test_a_changed_number_is_seen():
    assert missing("chi-square  244.8 on 9", "chi-square 244.8 on 9") == []
    assert missing("chi-square 244.8 on 9", "chi-square 144.8 on 9") == ["chi-square 244.8 on 9"]
    assert missing("EXPLAINED: ... 1.84 %", "EXPLAINED: the shear model, from 1.84 %") == []
    assert missing("EXPLAINED: ... 1.84 %", "ADEQUATE: the shear model, from 1.84 %") != []
    assert missing("b\na", "a\nb") == ["a"]


def test_a_failing_block_is_seen(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\nx = 1\n```\n\n```python\nprint(x)\n1 / 0\n```\n")
    printed = runner.run_page(page)
    assert "ZeroDivisionError" in printed["error"]
    assert "line 5" not in printed["error"]
    assert "block at line 6" in printed["error"]


def test_a_command_that_fails_is_seen(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```console\n$ cvxshear identify nowhere.toml\n```\n")
    assert "exit status 2" in runner.run_page(page)["error"]
