"""Importing the library, and showing the help of its commands, loads no slow modules."""

import subprocess
import sys
from importlib import import_module
from types import ModuleType

import pytest

import cvxshear

SLOW = (
    "cvxpy", "qpsolvers", "clarabel", "osqp", "highspy", "piqp", "proxsuite", "quadprog", "daqp", "scs",
    "joblib", "threadpoolctl", "matplotlib", "jinja2", "pandas", "h5py", "pyuff", "pytest", "scipy.stats",
)  # fmt: skip


def loaded_by(statement):
    code = f"{statement}\nimport sys\nprint('loaded:', ' '.join(sorted(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(found.stdout.rpartition("loaded:")[2].split())


@pytest.mark.parametrize(
    "statement",
    ["import cvxshear", "import cvxshear; dir(cvxshear)", "import cvxshear; cvxshear.Experiment, cvxshear.load"],
)
def test_importing_cvxshear_loads_no_solver_no_plotting_and_no_command_line(statement):
    modules = loaded_by(statement)
    assert "cvxshear.util.errors" in modules
    assert modules.isdisjoint({*SLOW, "typer", "rich", "cvxshear.cli"})


@pytest.mark.parametrize("arguments", [["--help"], ["identify", "--help"], ["backends", "--help"], ["--version"]])
def test_help_loads_the_command_line_alone(arguments):
    run = f"try:\n    main({arguments})\nexcept SystemExit as end:\n    assert not end.code"
    modules = loaded_by(f"from cvxshear.cli import main\n{run}")
    assert "typer" in modules
    assert modules.isdisjoint({*SLOW, "numpy", "scipy"})


@pytest.mark.parametrize(
    "statement",
    [
        "from cvxshear import backends; assert 'cvxpy-scs' in backends.available(); backends.get('daqp')",
        "import cvxshear; cvxshear.identify(cvxshear.load('paper'), 'two-stage')",
    ],
)
def test_names_of_backends_and_the_closed_form_import_no_solver(statement):
    assert loaded_by(statement).isdisjoint(SLOW)


def test_importing_records_and_the_paper_loads_no_plotting_no_reader_and_no_terminal():
    unwanted = {"matplotlib", "pyuff", "h5py", "pyoma2", "rich", "typer"}
    assert loaded_by("import cvxshear.records, cvxshear.paper").isdisjoint(unwanted)


def test_the_public_names_are_what_their_modules_define():
    assert set(cvxshear.__all__) <= set(dir(cvxshear))
    for name in cvxshear.__all__:
        value = getattr(cvxshear, name)
        if isinstance(value, ModuleType):
            assert value is sys.modules[f"cvxshear.{name}"]
        else:
            assert getattr(sys.modules[value.__module__], name) is value


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'cvxshear' has no attribute 'identfy'"):
        cvxshear.identfy  # noqa: B018


def test_importing_cvxshear_changes_no_numpy_setting():
    modules = subprocess.run(
        [sys.executable, "-c", "import numpy; a = numpy.geterr(); import cvxshear; print(a == numpy.geterr())"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert modules.stdout.strip() == "True"


def test_the_studies_import():
    for part in ("starting", "scaling", "many", "peers", "solvers", "planning"):
        assert callable(import_module(f"tests.studies.{part}").main)
