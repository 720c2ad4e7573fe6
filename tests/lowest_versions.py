"""Print the lowest versions in pyproject.toml as a constraints file for pip: ``python tests/lowest_versions.py``.

The output has a line ``name==lowest`` for every requirement of the package and of the requested extras (default
``test``), including extras required by these. A requirement without a lowest version is refused, because no test could
check it. ``--tests`` prints the tests for these versions instead.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

PYPROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)\s*(?:\[(?P<extras>[^\]]*)\])?\s*(?:>=\s*(?P<lowest>[\w.]+))?\s*(?:$|[,;])")

COMPANIONS = ("click<8.3", "pyparsing<3.3")
"""Upper limits for dependencies of the lowest Typer and Matplotlib. Newer versions of these dependencies deprecate
functions that the lowest versions call. They still work,
and the warning does not concern users of this package, but the tests treat every warning as an error."""

TESTS = (
    "test_import.py", "backends/test_backends.py", "backends/test_certificates.py",
    "programs/test_formulations.py", "fit/test_identify.py", "fit/test_efficient.py", "cli/test_cli.py",
    "util/test_writing.py", "test_lowest_versions.py", "io", "records/test_formats.py",
    "records/test_adapters.py", "planning/test_choice.py", "response/test_files.py",
    "report/test_figures.py", "report/test_html.py",
)  # fmt: skip
"""Files and folders of tests that use other packages: solvers, readers, matplotlib, jinja, rich, typer, joblib."""


def lowest_versions(project: dict[str, Any], extras: tuple[str, ...] = ("test",)) -> dict[str, str]:
    """Return the lowest version of every requirement of a project and its extras, by the requirement's name.

    A requirement without a lowest version is a ValueError.
    """
    found: dict[str, str] = {}
    waiting, seen = [*extras], set(extras)
    requirements = list(project["dependencies"])
    while requirements or waiting:
        if not requirements:
            requirements += project["optional-dependencies"][waiting.pop()]
            continue
        requirement = requirements.pop()
        parts = REQUIREMENT.match(requirement)
        if parts is not None and parts["name"] == project["name"]:
            further = {extra.strip() for extra in (parts["extras"] or "").split(",")} - seen
            waiting += sorted(further)
            seen |= further
        elif parts is None or parts["lowest"] is None:
            raise ValueError(f"pyproject.toml: {requirement!r} promises no lowest version; write it as name>=version.")
        else:
            found[parts["name"]] = parts["lowest"]
    return dict(sorted(found.items()))


def main() -> None:
    """Print the constraints, or the tests."""
    if sys.argv[1:] == ["--tests"]:
        sys.stdout.writelines(f"tests/{each}\n" for each in TESTS)
        return
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    for name, lowest in lowest_versions(project, tuple(sys.argv[1:]) or ("test",)).items():
        sys.stdout.write(f"{name}=={lowest}\n")
    sys.stdout.writelines(f"{companion}\n" for companion in COMPANIONS)


if __name__ == "__main__":
    main()
