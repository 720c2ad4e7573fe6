"""Test whether the tests notice a wrong sign: change copies of modules slightly, and run the related tests.

`python -m tests.mutation --mutants 100 --seed 1 [--module planning/planner.py] [--seconds 120]` draws changes (a sign,
an operator, a comparison, a constant, a negated condition, a dropped return) over the package. It runs the related
tests on a copy of the project in a temporary folder, prints the number of changes that the tests found, and lists the
others. A change that makes the tests exceed the time limit counts as found. Changes without any effect are left out:
annotations, messages, choices of a word, printed forms, sizes that numpy fills in, and guards against division by zero.

The related tests follow from the imports and names in each file, see `tests_of`; no recording is needed.
"""

import argparse
import ast
import functools
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

import cvxshear

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("cvxshear", "tests", "examples", "docs", "pyproject.toml", "README.md")

UNCHANGED = {"builtin", "cli", "io", "measurement", "report", "screening", "util"}
"""Rooms whose modules are not changed: they check, read and print."""

NOT_ASKED = {"benchmarks", "docs", "fe", "fuzz", "studies"}
"""Folders of tests that do not run on a change: documents and damaged files check few numbers and take long."""

LEFT_OUT = {
    "test_bad_input.py", "test_browser.py", "test_calibration.py", "test_fresh_machine.py", "test_house.py",
    "test_import.py", "test_lowest_versions.py", "test_measured_frames.py", "test_nested.py", "test_writing.py",
}  # fmt: skip
"""Excluded tests in other folders, for the same reason."""

OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.MatMult: ast.Mult,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.And: ast.Or, ast.Or: ast.And, ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE,
}  # fmt: skip

BOUNDARY = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
"""Replacements of comparisons between whole numbers: the limit shifts by one. Real numbers are equal only by design, so
< and <= are equivalent there; for them the direction is reversed."""

LIMIT_OF_ROUNDING = 1e-3
"""Limit of a tolerance: smaller numbers are tolerances. A factor of two does not matter for these, so they are
multiplied by a thousand."""

TINY = 1e-100
"""Limit of a number that only keeps a divisor or a logarithm from zero: no result of a frame is so small."""


@dataclass(frozen=True)
class Mutant:
    """A change: the module from the package's folder, the place among its nodes, the line, and a description."""

    module: str
    place: int
    line: int
    words: str


def mutants(module):
    """Return every possible change of a module."""
    tree = ast.parse((ROOT / "cvxshear" / module).read_text())
    left_out = _not_changed(tree)
    found = []
    for place, node in enumerate(ast.walk(tree)):
        if id(node) not in left_out and (words := change(node, apply=False)) is not None:
            found.append(Mutant(module, place, node.lineno, words))
    return found


def _not_changed(tree):
    """Return nodes without effect on results: annotations, messages, docstrings, choices of a word, printed forms,
    sizes that numpy fills in, and tiny numbers that only keep a divisor from zero."""
    found = set()
    for node in ast.walk(tree):
        parts = [getattr(node, key, None) for key in ("annotation", "returns", "decorator_list", "bases")]
        if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom):
            parts.append(node)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            parts.append(node)
        if _is_choice_of_text(node):
            parts.append(node)
        if isinstance(node, ast.Return) and (isinstance(node.value, ast.JoinedStr) or _is_choice_of_text(node.value)):
            parts.append(node)
        if isinstance(node, ast.FunctionDef) and node.name in ("__repr__", "__str__"):
            parts.append(node)
        if isinstance(node, ast.Constant) and isinstance(node.value, float) and 0 < node.value < TINY:
            parts.append(node)
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "reshape":
            # numpy takes -2 as it takes -1: for the size that is left.
            parts += [each.operand for each in node.args if isinstance(each, ast.UnaryOp)]
        for part in parts:
            for each in part if isinstance(part, list) else [part]:
                if each is not None:
                    found.update(id(inner) for inner in ast.walk(each))
    return found


def _is_text(node):
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _is_choice_of_text(node):
    return isinstance(node, ast.IfExp) and all(_is_text(each) for each in (node.body, node.orelse))


def change(node, *, apply):
    """Describe the possible change at a node and apply it on request. Return None if no change is possible."""
    before = ast.unparse(node) if hasattr(node, "lineno") else ""
    for kinds, possible, changed, words in CHANGES:
        if isinstance(node, kinds) and possible(node):
            if apply:
                changed(node)
            return f"{words} {before.splitlines()[0]}"
    return None


def _whole(node):
    """Return whether a side of a comparison is recognizably a whole number: a count, a length, a place."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int)
    return isinstance(node, ast.Call) and getattr(node.func, "id", "") in {"len", "int"}


def _other_operator(node):
    if isinstance(node, ast.Compare):
        counted = any(_whole(side) for side in (node.left, *node.comparators))
        kind = type(node.ops[0])
        node.ops[0] = (BOUNDARY if counted and kind in BOUNDARY else OPERATORS)[kind]()
    else:
        node.op = OPERATORS[type(node.op)]()


def _has_other_operator(node):
    if isinstance(node, ast.BinOp) and any(isinstance(each, ast.JoinedStr) for each in (node.left, node.right)):
        return False
    return type(node.ops[0] if isinstance(node, ast.Compare) else node.op) in OPERATORS


def _other_sign(node):
    node.op = ast.UAdd()


def _negated(node):
    node.test = ast.UnaryOp(ast.Not(), node.test)


def _other_number(node):
    if isinstance(node.value, int):
        node.value += 1
    elif 0 < node.value < LIMIT_OF_ROUNDING:
        node.value *= 1000.0
    else:
        node.value = 2 * node.value + (node.value == 0)


def _nothing(node):
    node.value = None


def _is_number(node):
    return isinstance(node.value, int | float) and not isinstance(node.value, bool)


def _returns_something(node):
    return node.value is not None and not (isinstance(node.value, ast.Constant) and node.value.value is None)


CHANGES = (
    (ast.BinOp | ast.AugAssign | ast.BoolOp | ast.Compare, _has_other_operator, _other_operator, "operator of"),
    (ast.UnaryOp, lambda node: isinstance(node.op, ast.USub), _other_sign, "sign of"),
    (ast.If | ast.IfExp | ast.While, lambda node: True, _negated, "condition of"),
    (ast.Constant, _is_number, _other_number, "number"),
    (ast.Return, _returns_something, _nothing, "dropped:"),
)
"""For each kind of node: a test whether it can be changed, the change, and its description."""


def mutated(source, mutant):
    """Return the source of a module with one change."""
    tree = ast.parse(source)
    change(list(ast.walk(tree))[mutant.place], apply=True)
    return ast.unparse(ast.fix_missing_locations(tree))


def functions(tree, around=""):
    """Return the qualified name and the node of each function in a module."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield f"{around}{node.name}", node
            yield from functions(node, f"{around}{node.name}.<locals>.")
        else:
            yield from functions(node, f"{around}{node.name}." if isinstance(node, ast.ClassDef) else around)


@functools.cache
def every_function():
    """Return for each module its functions: name, first line, last line, and the names used in it."""
    package, found = ROOT / "cvxshear", {}
    for path in package.rglob("*.py"):
        for name, node in functions(ast.parse(path.read_text())):
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            words = {getattr(each, "id", getattr(each, "attr", None)) for each in ast.walk(node)}
            found.setdefault(str(path.relative_to(package)), []).append((name, first, node.end_lineno, words))
    return found


def runs(mutant):
    """Return the function that runs a change: the innermost one around it, or those that name the constant or class."""
    around = [each for each in every_function().get(mutant.module, ()) if each[1] <= mutant.line <= each[2]]
    if around:
        return {f"{mutant.module}:{max(around, key=lambda each: each[1])[0]}"}
    tree = ast.parse((ROOT / "cvxshear" / mutant.module).read_text())
    node = next(each for each in tree.body if each.lineno <= mutant.line <= each.end_lineno)
    targets = [node] if isinstance(node, ast.ClassDef) else getattr(node, "targets", [getattr(node, "target", node)])
    names = {getattr(each, "id", getattr(each, "name", None)) for target in targets for each in ast.walk(target)}
    own = f"{node.name}." if isinstance(node, ast.ClassDef) else None
    return {
        f"{module}:{name}"
        for module, some in every_function().items()
        for name, _, _, words in some
        if (names - {None}) & words or (own and module == mutant.module and name.startswith(own))
    }


@functools.cache
def asked():
    """Return for each selected test file the imported modules of cvxshear and the words in the file."""
    found = {}
    for file in sorted((ROOT / "tests").glob("*/test_*.py")):
        if file.name not in LEFT_OUT and file.parent.name not in NOT_ASKED:
            text = file.read_text()
            found[str(file.relative_to(ROOT))] = imported(ast.parse(text)), set(re.findall(r"\w+", text))
    return found


def imported(tree):
    """Return the modules of cvxshear that a file imports; public names count for their defining modules."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            for each in node.names:
                public = getattr(cvxshear, each.name, None) if node.module == "cvxshear" else None
                home = getattr(public, "__module__", node.module)
                found |= {home, f"{home}.{each.name}"}
    return {each for each in found if each.startswith("cvxshear.")}


FARTHEST = 4
"""Largest number of calls between a test and a change for which nearer tests run first. Beyond it, almost all functions
call each other."""


def names_of(mutant):
    """Return names of functions and classes that run a change, of their callers, and so on, each with the number of
    calls between."""
    own = {each for where in runs(mutant) for each in where.partition(":")[2].split(".")}
    new = {each for each in own if len(each) > 3}
    if not new:
        # A name as short as `_of` is looked for in its own module.
        around = (name for name, _, _, words in every_function().get(mutant.module, ()) if own & words)
        new = {each for name in around for each in name.split(".") if len(each) > 3}
    found = dict.fromkeys(new, 0)
    for calls in range(1, FARTHEST):
        around = (name for some in every_function().values() for name, _, _, words in some if new & words)
        new = {each for name in around for each in name.split(".") if len(each) > 3} - found.keys()
        found |= dict.fromkeys(new, calls)
    return found


def said_around(mutant):
    """Return the words, including parts of names, in the innermost function around a change, or else in its line."""
    around = [each for each in every_function().get(mutant.module, ()) if each[1] <= mutant.line <= each[2]]
    _, first, last, _ = max(around, key=lambda each: each[1], default=(None, mutant.line, mutant.line, None))
    return parts_of("\n".join((ROOT / "cvxshear" / mutant.module).read_text().splitlines()[first - 1 : last]))


def parts_of(text):
    """Return the words of a text in lower case, with names split into parts."""
    return frozenset(re.findall(r"[a-z]{4,}", text.lower()))


def tests_of(mutant):
    """Return the test files related to a change, the nearest first.

    A file is near if it imports the module, names the function or constant, lies in the folder of the module's room,
    has the module's name, or imports anything from the room. It is related, too, if it names a caller.
    """
    room, stem = mutant.module.removesuffix(".py").split("/")[0], Path(mutant.module).stem
    module = "cvxshear." + mutant.module.removesuffix(".py").replace("/", ".")
    names = names_of(mutant)
    near = {}
    for file, (modules, words) in asked().items():
        own = 4 * any(each.startswith(module) for each in modules) + 3 * any(names.get(word) == 0 for word in words)
        place = 2 * (f"tests/{room}/" in file or f"test_{stem}" in file or f"test_{room}" in file)
        near[file] = own + place + any(each.startswith(f"cvxshear.{room}") for each in modules)
        near[file] += 0.5 * any(word in names for word in words)
    return tuple(sorted((file for file in near if near[file]), key=lambda file: (-near[file], file)))


def drawn(count, seed, only=()):
    """Draw changes; the probability of a module is proportional to its number of possible changes."""
    paths = [path.relative_to(ROOT / "cvxshear") for path in sorted((ROOT / "cvxshear").rglob("*.py"))]
    modules = [str(path) for path in paths if path.parts[0] not in UNCHANGED]
    chosen = [each for each in modules if not only or any(each.startswith(name) for name in only)]
    every = [mutant for module in chosen for mutant in mutants(module)]
    return random.Random(seed).sample(every, min(count, len(every)))


WAITED = 20
"""Longest time for a process, relative to its limit of computing time. A deadlocked process uses no computing time."""

QUIET = ("-W", "ignore::pytest.PytestAssertRewriteWarning")
"""Option to silence a warning: pytest and its plugins are imported before the run."""


class Watcher:
    """A pytest plugin that sorts tests by the calls between them and a change, then by shared words for their time.

    Rare words count more. It records the first failing test and skips the remaining tests after the time limit.
    """

    def __init__(self, path, names, said, seconds):
        self._path, self._names, self._said, self._seconds = path, names, said, seconds
        self._began = None

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        """Sort again by nearness, because `conftest` puts the longest tests first."""
        from tests.conftest import COSTLY, costs  # noqa: PLC0415 - those of the copy

        shared = {item: self._said & parts_of(" ".join(said_in(item))) for item in items}
        often = Counter(word for words in shared.values() for word in words)

        def place(item):
            calls = min((self._names[each] for each in said_in(item) & self._names.keys()), default=FARTHEST)
            near = sum(1.0 / often[word] for word in shared[item])
            return calls, -near / max(costs().get(item.nodeid, 0.0), COSTLY)

        items.sort(key=place)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item):
        if self._began is None:
            self._began = time.process_time()
        if time.process_time() - self._began > self._seconds:
            pytest.skip("enough")

    def pytest_runtest_logreport(self, report):
        if report.failed and not self._path.exists():
            self._path.write_text(report.nodeid)

    pytest_collectreport = pytest_runtest_logreport


def said_in(item):
    """Return the words in the source of a test and of the fixtures and functions of its file that it names."""
    every = words_of_functions(item.path)
    own = every.get(item.originalname, frozenset())
    return own.union(*(every[name] for name in own & every.keys()))


@functools.cache
def words_of_functions(path):
    """Return the words in each function of a file of tests."""
    text = path.read_text()
    nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    return {node.name: frozenset(re.findall(r"\w+", ast.get_source_segment(text, node))) for node in nodes}


def warm_up():
    """Import the tests' modules once: each change is tried in a process forked from this one."""
    pytest.main(["--collect-only", "-q", "-q", "-n", "0", "-p", "no:cacheprovider", *QUIET, *asked()])
    for name in list(sys.modules):
        if name.partition(".")[0] in {"cvxshear", "tests"} and name != __name__:
            del sys.modules[name]


def first_failure(folder, tests, names, said, given, broken=()):
    """Name the first failing test in a copy of the project. The name is empty if the process ends early or exceeds the
    limit. Return None if all pass."""
    told = folder / "failed.txt"
    told.unlink(missing_ok=True)
    child = os.fork()
    if child == 0:
        os.setsid()
        os.chdir(folder)
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nowhere, stream)
        sys.path[:] = [str(folder), *(each for each in sys.path if each not in ("", str(ROOT)))]
        os.environ["PYTHONPATH"] = str(folder)
        # The limit counts seconds of computing, so other work on the machine does not matter.
        resource.setrlimit(resource.RLIMIT_CPU, (given.limit, given.limit))
        options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", *QUIET]
        options += [f"--deselect={each}" for each in broken]
        try:
            os._exit(int(pytest.main([*options, *tests], plugins=[Watcher(told, names, said, given.seconds)])))
        except BaseException:
            os._exit(99)
    until = time.monotonic() + WAITED * given.limit
    while time.monotonic() < until:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return None if status == 0 else told.read_text() if told.exists() else ""
        time.sleep(0.05)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return ""


def survivors(some, given, say=print):
    """Return the changes that the tests did not notice. A test that fails without the change does not count."""
    left, sound, broken = [], set(), set()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, folder / name)
        for mutant in some:
            path, began = folder / "cvxshear" / mutant.module, time.monotonic()
            before, failed, tests = path.read_text(), None, tests_of(mutant)
            names, said = names_of(mutant), said_around(mutant)
            while tests:
                path.write_text(mutated(before, mutant))
                failed = first_failure(folder, tests, names, said, given, broken)
                path.write_text(before)
                if failed is None or failed in sound:
                    break
                # A process that ends without a result has found the change only if it gives a result without the
                # change.
                if first_failure(folder, (failed,) if failed else tests, names, said, given, broken) is None:
                    break
                if failed:
                    say(f"left out, since it fails without any change: {failed}")
                    broken.add(failed)
                else:
                    # The tests take too long without the change as well: leave out the last file.
                    tests = tests[:-1]
                failed = None
            if failed is None:
                left.append(mutant)
            elif failed:
                sound.add(failed)
            what = f"NOT FOUND by {len(tests)} files" if failed is None else f"found by {failed.rpartition('::')[2]}"
            say(f"{what}: {mutant.module}:{mutant.line} {mutant.words[:100]} ({time.monotonic() - began:.0f} s)")
    return left


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--mutants", type=int, default=30, help="how many changes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--module", action="append", default=[], help="a room or a module, such as fit/start.py; again")
    parser.add_argument("--seconds", type=int, default=120, help="of computing, after which no further test is begun")
    parser.add_argument("--limit", type=int, default=200, help="seconds of computing for the tests of one change")
    given = parser.parse_args()
    some = drawn(given.mutants, given.seed, given.module)
    sys.dont_write_bytecode = True
    warm_up()
    left = survivors(some, given, lambda line: print(line, flush=True))
    print(f"{len(some) - len(left)} of {len(some)} changes found (seed {given.seed})")
    for mutant in left:
        print(f"  cvxshear/{mutant.module}:{mutant.line}: {mutant.words}")


if __name__ == "__main__":
    main()
