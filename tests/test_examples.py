"""The scripts in examples/ run without a warning and show what they say they show."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest

from cvxshear.records.simulate import PAPER_FRAME
from tests.frames import EXAMPLES

SHOWN = {
    "physical_bounds": r"without bounds .* 34 % off\nwith bounds .* 17 % off",
    "compare_backends": r"bounded mass +\d+ backends, farthest [\w-]+: \d+e-\d+ from the consensus",
    "floor_ratio": r"no prior .*= 2\.742\nwithin 2 % .*= 2\.014\nexact .*= 2\.000",
    "los_alamos": r"ambiguous, 8 effects\n(state \d .*\n){8}",
    "own_datum": r"drawings alone +m = \[10\.8 .*\nwith the gauge +m = \[10\. +7\.5 +5\. \] ± \[0\.06",
    "before_and_after": r"before_and_after\.toml: 2 states, 4 tests",
    "own_prior": r"not weighed .*= 10\.79 kg\nweighed .*= 12\.44 kg",
    "own_backend": r"slsqp +m = (.*) kg\nclarabel +m = \1 kg",
    "close_the_loop": r"verdict: explained\ngravity: .*gamma.*: 1\.2.*\n.*1\.83 % before, 0\.34 % after",
    "modes_from_hammer": r"mode 1: 1\.0336 Hz .*[\s\S]*floor_mass 1: 10\.01 ± 0\.05 kg\nfloor_mass 2: 7\.51 ± ",
    "plan_a_test": r"floors \[1, 4, 6, 7\][\s\S]*1 test: .* 0\.00\n.*2 tests: .*\[10\.0, 10\.0\].* 0\.9",
    "three_shaker_records": r"bare\.toml, bare\.csv: 30720 samples at 256 Hz, stamped 0\.004, .*, 0\.023, \.\.\. s",
    "own_effect": r"brace: b = 39\d ± \d N/m",
}


def test_every_script_has_its_expectation():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(SHOWN)


def shown(name, folder):
    """What an example prints."""
    found = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / f"{name}.py")], capture_output=True, text=True, check=False,
        cwd=folder, encoding="utf-8", env={**os.environ, "PYTHONUTF8": "1"},
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    return found.stdout


@pytest.mark.parametrize("name", SHOWN)
def test_example_shows_what_it_says(name, tmp_path):
    said = shown(name, tmp_path)
    assert re.search(SHOWN[name], said), said


def test_the_hammer_finds_the_frame_within_what_it_states(tmp_path):
    """Every mass and stiffness within two standard deviations of the frame that was hit, and those below 1 %."""
    found = re.findall(r"(\S+) ± (\S+) (?:kg|N/m)", shown("modes_from_hammer", tmp_path))
    values, stds = np.array(found, dtype=float).T
    truth = np.concatenate([PAPER_FRAME.masses, PAPER_FRAME.stiffnesses])
    assert np.all(np.abs(values - truth) < 2 * stds)
    assert np.all(stds < 0.01 * truth)
