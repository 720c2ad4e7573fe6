"""The blocks of the documentation and the scripts in examples/ run and print the expected outputs."""

import ast
import functools
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import cvxshear
from cvxshear.records.simulate import PAPER_FRAME
from tests.docs import runner
from tests.docs.runner import Block, blocks, commands
from tests.frames import EXAMPLES

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(path for path in DOCS.rglob("*.md"))]
RUN = [page for page in PAGES if any(block.language in ("python", "console") for block in blocks(page.read_text()))]
TOLERANCE = 0.02
"""Largest relative difference of two printed numbers that agree: machines round differently."""

SCRIPT = re.compile(r"python examples/(\w+)\.py")
PLACE = re.compile(r"`([\w/]+\.py):([\w.]+)`")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")


SHOWN = {
    "physical_bounds": r"without bounds .* 34 % off\nwith bounds .* 17 % off",
    "compare_backends": r"bounded mass +\d+ backends, farthest [\w-]+: \d+e-\d+ from the auto",
    "floor_ratio": r"no prior .*= 2\.742\nwithin 2 % .*= 2\.014\nexact .*= 2\.000",
    "los_alamos": r"ambiguous, 8 effects\n(state \d .*\n){8}",
    "own_datum": r"drawings alone +m = \[10\.8 .*\nwith the gauge +m = \[10\. +7\.5 +5\. \] ± \[0\.06",
    "before_and_after": r"before_and_after\.toml: 2 states, 4 tests",
    "own_prior": r"not weighed .*= 10\.79 kg\nweighed .*= 12\.44 kg",
    "own_backend": r"slsqp +m = (.*) kg\nclarabel +m = \1 kg",
    "close_the_loop": r"verdict: explained\ngravity: .*gamma.*: 1\.2.*\n.*1\.83 % before, 0\.34 % after",
    "modes_from_hammer": r"mode 1: 1\.0336 Hz .*[\s\S]*floor_mass 1: 10\.00 ± 0\.05 kg\nfloor_mass 2: 7\.50 ± ",
    "plan_a_test": r"2 sensors: floors \[2, 8\].*\n4 sensors: floors \[1, 4, 6, 7\]",
    "three_shaker_records": r"bare\.toml, bare\.csv: 30720 samples at 256 Hz, stamped 0\.004, .*, 0\.023, \.\.\. s",
    "many_tests": r"21 files in monitoring",
    "roving_sensors": r"low: floors \[1, 2, 6\], \[1\.71.*\n.*\nhigh: floors \[4, 5, 6\]",
    "own_effect": r"brace: b = 39\d ± \d N/m",
}
"""One pattern for the output of each script in examples/."""


def script_calls(page: Path) -> dict[str, str]:
    """Return the key of the output of each script in examples/ that the page runs, see `runner.run_page`."""
    found = {}
    for block in blocks(page.read_text()):
        for place, (command, _) in enumerate(commands(block) if block.language == "console" and block.runs else []):
            if script := SCRIPT.fullmatch(command):
                found[script[1]] = f"{block.line}:{place}"
    return found


def measured(page: Path) -> bool:
    """Whether a page covers measured frames: these take longest and run in a process of their own."""
    return page.parent.name == "measured"


def place_of(name: str) -> str:
    """Name a script by the first page that runs it."""
    return " ".join([*[name_of(page) for page in RUN if name in script_calls(page)][:1], name])


@functools.cache
def ran(of_measured: bool) -> tuple[subprocess.CompletedProcess[str], dict[Path, dict[str, str]]]:
    """The process that ran these pages, and the scripts on each: one that failed is not run again for every page."""
    with tempfile.TemporaryDirectory() as folder:
        pages = [page for page in RUN if measured(page) == of_measured]
        if not of_measured:
            # Scripts that no page runs stand on a page of their own.
            rest = Path(folder) / "rest.md"
            left = sorted(set(SHOWN).difference(*map(script_calls, RUN)))
            rest.write_text("\n".join(f"```console\n$ python examples/{name}.py\n```" for name in left))
            pages.append(rest)
        # Pages that register a part of their own come last: it takes part in every loop after it.
        pages.sort(key=lambda page: "register(" in page.read_text())
        found = subprocess.run(
            [sys.executable, "-W", "error", runner.__file__, str(EXAMPLES), *map(str, pages)],
            capture_output=True,
            text=True,
            check=False,
            # The folder of the tests comes first otherwise, and with it the checkout's package instead of the wheel's.
            env={**os.environ, "PYTHONSAFEPATH": "1"},
        )
        return found, {page: script_calls(page) for page in pages}


@functools.cache
def results(of_measured: bool):
    """Return the outputs of these pages and of each script; one process runs them all."""
    found, scripts_of = ran(of_measured)
    assert found.returncode == 0, found.stderr
    printed = json.loads(found.stdout)
    scripts = {
        name: printed[str(page)].get(key, printed[str(page)].get("error", ""))
        for page, called in scripts_of.items()
        for name, key in called.items()
    }
    return printed, scripts


def said_by(name: str) -> str:
    """Return the output of a script."""
    return results("docs/measured/" in place_of(name))[1][name]


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def alike(shown: str, printed: str) -> bool:
    """Whether two lines agree: word for word, numbers within `TOLERANCE`; "..." replaces any words."""
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
    printed = results(measured(page))[0][str(page)]
    assert "error" not in printed, printed["error"]
    if any(block.lacks_data for block in blocks(page.read_text())):
        pytest.skip(f"measured data beside the project (CVXSHEAR_SHARED): the blocks of {name_of(page)} read them")


@pytest.mark.parametrize("page", [page for page in RUN if shown_outputs(page)], ids=name_of)
def test_the_page_shows_what_is_printed(page):
    printed = results(measured(page))[0][str(page)]
    for key, shown in shown_outputs(page):
        assert key in printed, f"{name_of(page)}: the block at line {key} was not run"
        assert not missing(shown, printed[key]), f"line {key} prints\n{printed[key]}"


def test_every_script_has_its_expectation():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(SHOWN)


@pytest.mark.parametrize("name", SHOWN, ids=place_of)
def test_a_script_shows_what_it_says(name):
    said = said_by(name)
    assert re.search(SHOWN[name], said), said


def test_the_hammer_finds_the_frame_within_what_it_states():
    """Every mass and stiffness within two standard deviations of the frame that was hit, and those below 1 %."""
    found = re.findall(r"(\S+) ± (\S+) (?:kg|N/m)", said_by("modes_from_hammer"))
    values, stds = np.array(found, dtype=float).T
    truth = np.concatenate([PAPER_FRAME.masses, PAPER_FRAME.stiffnesses])
    assert np.all(np.abs(values - truth) < 2 * stds)
    assert np.all(stds < 0.01 * truth)


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


def test_a_failing_block_or_command_is_seen(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\nx = 1\n```\n\n```python\nprint(x)\n1 / 0\n```\n")
    printed = runner.run_page(page)
    assert "ZeroDivisionError" in printed["error"]
    assert "line 5" not in printed["error"]
    assert "block at line 6" in printed["error"]
    page.write_text("```console\n$ cvxshear identify nowhere.toml\n```\n")
    assert "exit status 2" in runner.run_page(page)["error"]
