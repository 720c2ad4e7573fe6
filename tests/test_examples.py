"""The scripts in examples/ run without a warning and show what they say they show."""

import re
import subprocess
import sys

import pytest

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
    "close_the_loop": r"verdict: explained\nthe shear model lacks gravity: .*\n.*1\.83 % before, 0\.34 % after",
    "modes_from_hammer": r"mode 1: 1\.0336 Hz .*[\s\S]*masses: \['10\.0\d kg', '7\.5\d kg', '5\.0\d kg'\]",
    "plan_a_test": r"floors \[1, 4, 6, 7\][\s\S]*1 test: .* 0\.00\n.*2 tests: .*\[10\.0, 10\.0\].* 0\.9",
    "three_shaker_records": r"bare\.toml, bare\.csv: 30720 samples at 256 Hz, stamped 0\.004, .*, 0\.023, \.\.\. s",
    "own_effect": r"brace: b = 39\d ± \d N/m",
}


def test_every_script_has_its_expectation():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(SHOWN)


@pytest.mark.parametrize("name", SHOWN)
def test_example_shows_what_it_says(name, tmp_path):
    found = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / f"{name}.py")],
        capture_output=True, text=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    assert re.search(SHOWN[name], found.stdout), found.stdout
