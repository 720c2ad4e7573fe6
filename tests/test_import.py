"""Importing the library loads neither plotting nor the command line."""

import subprocess
import sys
from importlib import import_module


def loaded_by(statement):
    code = f"{statement}\nimport sys\nprint(' '.join(sorted(sys.modules)))"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()


def test_importing_cvxshear_loads_neither_matplotlib_nor_the_command_line():
    modules = loaded_by("import cvxshear")
    assert "cvxshear.identification" in modules
    for unwanted in ("matplotlib", "typer", "rich", "cvxshear.cli", "pytest"):
        assert unwanted not in modules


def test_importing_cvxshear_changes_no_numpy_setting():
    modules = subprocess.run(
        [sys.executable, "-c", "import numpy; a = numpy.geterr(); import cvxshear; print(a == numpy.geterr())"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert modules.stdout.strip() == "True"


def test_the_benchmarks_import():
    for part in ("large", "many", "peers", "solvers"):
        assert callable(import_module(f"tests.benchmarks.{part}").main)
