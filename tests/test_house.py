"""Test the order of imports: no module imports from a later room, and no modules import each other in a circle."""

import ast
from pathlib import Path

import cvxshear
from tests.studies.size import CAPABILITIES, measured

ROOT = Path(cvxshear.__file__).parent

ROOMS = (
    # General tools, then the motions of a floor, and measured and declared quantities with their priors.
    ("util",), ("version",), ("priors",), ("motions",), ("measurement",),
    # The convex programs of a measurement, and the solvers of such programs.
    ("programs",), ("backends",),
    # The model, the effects that act on it, and the data compared with it.
    ("model",), ("effects",), ("data",),
    # Methods and estimators built from programs.
    ("fit",), ("loop",),
    # Records and files, one or several: both end in an experiment.
    ("records",), ("io",), ("screening",),
    # Uses of an identified frame.
    ("response",), ("planning",),
    # The published numbers, reports, the public interface, the command line.
    ("paper",), ("report",), ("__init__",), ("cli",), ("__main__",),
)  # fmt: skip
"""Rooms in order. A room imports from itself and from earlier rooms."""

LEVEL = {name: level for level, names in enumerate(ROOMS) for name in names}


def modules():
    """Return every module of the package: its dotted name and its source."""
    found = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = ["cvxshear", *path.relative_to(ROOT).with_suffix("").parts]
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path.read_text()
    return found


def imported(source, known):
    """Return the modules of the package that a module imports, also inside functions, each with its line."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            # If a name is no module, it belongs to the module in the statement.
            targets = [
                whole if (whole := f"{node.module}.{alias.name}") in known else node.module for alias in node.names
            ]
        else:
            continue
        yield from ((target, node.lineno) for target in targets if target.split(".")[0] == "cvxshear")


def room(name):
    parts = name.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def arrows():
    """Return (importing module, imported module, line) over the whole package."""
    known = modules()
    return [
        (name, target, line)
        for name, source in known.items()
        for target, line in imported(source, known)
        if target != name
    ]


def circles(edges):
    """Return groups of modules that import each other, directly or in a circle."""
    following = {}
    for start, end, _ in edges:
        following.setdefault(start, set()).add(end)

    def reached(start):
        seen, todo = set(), [start]
        while todo:
            for end in following.get(todo.pop(), ()):
                if end not in seen:
                    seen.add(end)
                    todo.append(end)
        return seen

    reach = {name: reached(name) for name in following}
    in_circle = {name for name, seen in reach.items() if name in seen}
    return {
        frozenset(other for other in in_circle if other in reach[name] and name in reach[other]) for name in in_circle
    }


def test_every_module_has_its_room():
    assert sorted({room(name) for name in modules()} - set(LEVEL)) == []


def test_nothing_imports_upward():
    upward = [
        f"{name}:{line} imports {target}" for name, target, line in arrows() if LEVEL[room(target)] > LEVEL[room(name)]
    ]
    assert upward == []


def test_no_circle_of_modules():
    """A package's `__init__` gathers its own modules; these imports do not count."""
    assert [sorted(circle) for circle in circles(arrows())] == []


def test_imports_inside_functions_and_circles_are_seen():
    """Test the helper functions on known examples."""
    known = {"cvxshear.a": "", "cvxshear.b": ""}
    inside = "def f():\n    from cvxshear import b\n    import cvxshear.a\n"
    assert list(imported(inside, known)) == [("cvxshear.b", 2), ("cvxshear.a", 3)]
    assert circles([("a", "b", 1), ("b", "c", 1), ("c", "b", 1)]) == {frozenset({"b", "c"})}
    assert circles([("a", "b", 1), ("b", "c", 1)]) == set()


def test_every_room_counts_towards_a_capability():
    rooms = [name for names in CAPABILITIES.values() for name in names]
    folders = {name for name in LEVEL if (ROOT / name).is_dir()}
    assert sorted(rooms) == sorted({*folders, ""})


def repeated(found):
    """Return the names with several places, and these places."""
    return {name: places for name, places in found.items() if len(places) > 1}


def assigned(node):
    """Return the names that a statement assigns, also inside a tuple or list."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)]


def test_a_name_means_one_thing():
    """No two files, constants or classes share a name, and no parameter is named `of`."""
    files, constants, classes, parameters = {}, {}, {}, []
    for path in sorted(ROOT.rglob("*.py")):
        where = str(path.relative_to(ROOT))
        files.setdefault(path.name, []).append(where)
        tree = ast.parse(path.read_text())
        for node in tree.body:
            for name in assigned(node):
                if name.isupper():
                    constants.setdefault(name, set()).add(where)
            if isinstance(node, ast.ClassDef):
                classes.setdefault(node.name, set()).add(where)
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                given = [*node.args.args, *node.args.kwonlyargs]
                parameters += [f"{where}:{node.lineno}" for each in given if each.arg == "of"]
    assert set(repeated(files)) <= {"__init__.py", "base.py", "results.py"}
    assert repeated(constants) == {}
    assert repeated(classes) == {}
    assert parameters == []


BUDGET = {"lines of code": 24_883, "modules": 149, "numeric constants": 336, "lines of imports": 1_875}
"""Limits of the package's size. A change that needs more raises the limit, as a decision that its review sees."""


def sizes():
    """Count lines of code, modules, numeric constants of modules, and lines of imports."""
    found = dict.fromkeys(BUDGET, 0)
    for path in ROOT.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found["modules"] += 1
        found["lines of code"] += measured(path)[1]
        found["lines of imports"] += sum(
            node.end_lineno - node.lineno + 1
            for node in ast.walk(tree)
            if isinstance(node, ast.Import | ast.ImportFrom)
        )
        found["numeric constants"] += sum(numeric_constants(tree))
    return found


def numeric_constants(tree):
    """For each name in capitals that a module assigns: whether its value holds a number and no text."""
    for node in tree.body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        values = [each.value for each in ast.walk(node.value) if isinstance(each, ast.Constant)]
        numbers = [each for each in values if isinstance(each, int | float) and not isinstance(each, bool)]
        numeric = bool(numbers) and not any(isinstance(each, str) for each in values)
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            for name in ast.walk(target):
                if isinstance(name, ast.Name) and name.id.isupper():
                    yield numeric


def test_the_package_stays_within_its_budget():
    assert {name: size for name, size in sizes().items() if size > BUDGET[name]} == {}
