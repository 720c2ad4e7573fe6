"""Count the lines of code of each capability of the package.

python -m tests.studies size prints the table; python -m tests.studies size records io
lists the modules of these rooms. A line of code is not blank, a comment or a docstring.
"""

import ast
import statistics
import sys
from pathlib import Path

import cvxshear

ROOT = Path(cvxshear.__file__).parent

CAPABILITIES = {
    "declare a measurement and what is known beforehand": ("measurement", "priors"),
    "compare a shear frame, with effects, with data": ("effects", "data"),
    "identify, on interchangeable backends": ("programs", "backends", "fit"),
    "find what the shear model lacks": ("loop",),
    "records to modes with their uncertainty": ("records",),
    "read and write files; find mistakes in them": ("io", "screening"),
    "predict and reconstruct motion": ("response",),
    "plan a test": ("planning",),
    "recompute the paper": ("paper",),
    "terminal, page, notebook, figures, sheets, command line": ("report", "cli"),
    "what every room uses, and the public face": ("util", ""),
}
"""Capabilities of the package with their rooms; the empty name is the top level."""


def measured(path):
    """Return a module's lines and its lines of code."""
    lines = path.read_text(encoding="utf-8").splitlines()
    documented = set()
    for node in ast.walk(ast.parse("\n".join(lines))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            documented |= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    code = [
        number not in documented and bool(line.strip()) and not line.strip().startswith("#")
        for number, line in enumerate(lines, 1)
    ]
    return len(lines), sum(code)


def table():
    found = {}
    for path in sorted(ROOT.rglob("*.py")):
        *room, name = path.relative_to(ROOT).parts
        found.setdefault(room[0] if room else "", []).append((*measured(path), name != "__init__.py"))
    rows = []
    for words, rooms in [*CAPABILITIES.items(), ("all", tuple(found))]:
        modules = [each for room in rooms for each in found[room]]
        where = ", ".join(f"`{room}`" for room in rooms if room) if words != "all" else ""
        median = statistics.median(lines for lines, _, counts in modules if counts)
        code = sum(each[1] for each in modules)
        rows.append(f"| {words} | {where} | {len(modules)} | {code:,} | {median:.0f} |")
    head = "| for | rooms | modules | lines of code | median module, lines |\n"
    return f"{head}|---|---|---|---|---|\n" + "\n".join(rows) + "\n\n"


if __name__ == "__main__":
    if len(sys.argv) == 1:
        print(table())
    for room in sys.argv[1:]:
        for path in sorted((ROOT / room).rglob("*.py")):
            lines, code = measured(path)
            print(f"{path.relative_to(ROOT)!s:45}{lines:6d} lines, {code:4d} of code")
