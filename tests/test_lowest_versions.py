"""The constraints for tests with the lowest versions agree with pyproject.toml."""

import re
import tomllib

import pytest

from tests.lowest_versions import PYPROJECT, TESTS, lowest_versions

PROJECT = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]


def test_the_tests_that_are_run_with_them_are_there():
    assert [each for each in TESTS if not (PYPROJECT.parent / "tests" / each).exists()] == []


def test_every_requirement_of_every_extra_has_a_lowest_version():
    found = lowest_versions(PROJECT, tuple(PROJECT["optional-dependencies"]))
    text = PYPROJECT.read_text(encoding="utf-8")
    for name, lowest in found.items():
        assert re.search(rf'"{re.escape(name)}(\[\w+\])?>={re.escape(lowest)}"', text)
    assert {"numpy", "cvxpy", "highspy", "pytest", "sphinx", "pyoma-2"} <= set(found)


def test_extras_that_name_each_other_are_followed_once():
    project = {
        "name": "frame",
        "dependencies": ["numpy>=1.26", "tomli-w >= 1.0"],
        "optional-dependencies": {
            "plot": ["matplotlib>=3.8"],
            "all": ["frame[plot, all]", "dask[distributed]>=2024.1"],
            "other": ["never"],
        },
    }
    wanted = {"dask": "2024.1", "matplotlib": "3.8", "numpy": "1.26", "tomli-w": "1.0"}
    assert lowest_versions(project, ("all",)) == wanted
    assert lowest_versions(project, ()) == {"numpy": "1.26", "tomli-w": "1.0"}


@pytest.mark.parametrize("requirement", ["numpy", "numpy<3", "numpy==2.0", "dask[distributed]"])
def test_a_requirement_without_a_lowest_version_is_refused(requirement):
    with pytest.raises(ValueError, match="promises no lowest version; write it as name>=version"):
        lowest_versions({"name": "frame", "dependencies": [requirement]}, ())
