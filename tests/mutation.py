"""Do the tests notice a wrong sign? Small changes are made to copies of modules, and tests that concern them are run.

`python -m tests.mutation --mutants 100 --seed 1 [--module planning/chances.py] [--seconds 40]` draws changes (a sign,
an operator, a comparison, a constant, a condition negated, a return dropped) over `ROOMS`, runs the tests that concern
each on a copy of the project in a temporary folder, prints how many changes were found and lists the others. A change
that takes the tests beyond the limit counts as found.

Which tests concern a change is read from what they import and name, see `tests_of`: nothing has to be recorded.
"""

import argparse
import ast
import functools
import inspect
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

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("cvxshear", "tests", "examples", "docs", "pyproject.toml", "README.md")

ROOMS = (
    "planning", "programs", "priors", "backends", "effects", "data", "fit", "loop", "response", "records", "model",
    "paper",
)  # fmt: skip
"""Rooms whose modules are changed."""

ASKED = (
    "test_*.py", "util", "priors", "measurement", "programs", "backends", "model", "effects", "data", "fit", "loop",
    "records", "screening", "response", "planning", "paper", "formats",
)  # fmt: skip
"""Tests that may be run on a change; those of documents, commands, reports and damaged files say little about numbers
and take long."""

LEFT_OUT = (
    "test_bad_input.py", "test_calibration.py", "test_house.py", "test_import.py", "test_lowest_versions.py",
    "test_hostile_files.py", "test_measured_frames.py", "test_nested.py", "test_streams.py", "test_writing.py",
)  # fmt: skip
"""Of these, for the same reason."""

OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.MatMult: ast.Mult,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.And: ast.Or, ast.Or: ast.And, ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE,
}  # fmt: skip

BOUNDARY = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
"""Comparisons of whole numbers: one more or less. Real numbers are never equal but by design, so that < in place of <=
changes nothing; between those the direction is changed."""

LIMIT_OF_ROUNDING = 1e-3
"""Numbers below are tolerances, which twice as large do the same; they are made a thousand times as large."""


@dataclass(frozen=True)
class Mutant:
    """A change: the module from the package's folder, the place among its nodes, the line, and the change in words."""

    module: str
    place: int
    line: int
    words: str


def mutants(module):
    """Every change that can be made to a module."""
    tree = ast.parse((ROOT / "cvxshear" / module).read_text())
    left_out = _not_changed(tree)
    found = []
    for place, node in enumerate(ast.walk(tree)):
        if id(node) not in left_out and (words := change(node, apply=False)) is not None:
            found.append(Mutant(module, place, node.lineno, words))
    return found


def _not_changed(tree):
    """Nodes whose change changes nothing that runs, or words alone: annotations, texts, messages, docstrings."""
    found = set()
    for node in ast.walk(tree):
        parts = [getattr(node, key, None) for key in ("annotation", "returns", "decorator_list", "bases")]
        if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom):
            parts.append(node)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            parts.append(node)
        for part in parts:
            for each in part if isinstance(part, list) else [part]:
                if each is not None:
                    found.update(id(inner) for inner in ast.walk(each))
    return found


def change(node, *, apply):
    """Say what can be changed at a node, and change it if asked to; None where nothing can."""
    before = ast.unparse(node) if hasattr(node, "lineno") else ""
    for kinds, possible, changed, words in CHANGES:
        if isinstance(node, kinds) and possible(node):
            if apply:
                changed(node)
            return f"{words} {before.splitlines()[0]}"
    return None


def _whole(node):
    """Whether a side of a comparison is a whole number as it stands: a count, a length, a place."""
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
"""Nodes, whether one can be changed, how, and the words for it."""


def mutated(source, mutant):
    """The source of a module with one change."""
    tree = ast.parse(source)
    change(list(ast.walk(tree))[mutant.place], apply=True)
    return ast.unparse(ast.fix_missing_locations(tree))


def functions(tree, around=""):
    """Name, as Python qualifies it, and node of each function of a module."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield f"{around}{node.name}", node
            yield from functions(node, f"{around}{node.name}.<locals>.")
        else:
            yield from functions(node, f"{around}{node.name}." if isinstance(node, ast.ClassDef) else around)


@functools.cache
def every_function():
    """Of each module the functions: name, first line, last line, and the names that stand in it."""
    package, found = ROOT / "cvxshear", {}
    for path in package.rglob("*.py"):
        for name, node in functions(ast.parse(path.read_text())):
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            words = {getattr(each, "id", getattr(each, "attr", None)) for each in ast.walk(node)}
            found.setdefault(str(path.relative_to(package)), []).append((name, first, node.end_lineno, words))
    return found


def runs(mutant):
    """Where a change is run: in the innermost function around it, or where the constant or class is named."""
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
    """Of each file of tests that may be asked: the modules of cvxshear that it imports, and the words in it."""
    found = {}
    for path in sorted(path for name in ASKED for path in (ROOT / "tests").glob(name)):
        for file in [path] if path.suffix else sorted(path.glob("test_*.py")):
            if file.name not in LEFT_OUT:
                text = file.read_text()
                found[str(file.relative_to(ROOT))] = imported(ast.parse(text)), set(re.findall(r"\w+", text))
    return found


def imported(tree):
    """The modules of cvxshear that a file imports, public names by where they are defined."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            for each in node.names:
                home = cvxshear._HOMES.get(each.name, node.module) if node.module == "cvxshear" else node.module
                found |= {home, f"{home}.{each.name}"}
    return {each for each in found if each.startswith("cvxshear.")}


FARTHEST = 4
"""Calls between a test and a change up to which the nearer is run first; beyond, nearly everything calls everything."""


def names_of(mutant):
    """The names of the functions and classes in which a change is run, of those that name them, and so on; each with
    the number of calls between."""
    new = {each for where in runs(mutant) for each in where.partition(":")[2].split(".") if len(each) > 3}
    found = dict.fromkeys(new, 0)
    for calls in range(1, FARTHEST):
        around = (name for some in every_function().values() for name, _, _, words in some if new & words)
        new = {each for name in around for each in name.split(".") if len(each) > 3} - found.keys()
        found |= dict.fromkeys(new, calls)
    return found


def said_around(mutant):
    """The words, parts of names among them, in the innermost function around a change, else in its line."""
    around = [each for each in every_function().get(mutant.module, ()) if each[1] <= mutant.line <= each[2]]
    _, first, last, _ = max(around, key=lambda each: each[1], default=(None, mutant.line, mutant.line, None))
    return parts_of("\n".join((ROOT / "cvxshear" / mutant.module).read_text().splitlines()[first - 1 : last]))


def parts_of(text):
    """The words of a text in small letters, names taken apart."""
    return frozenset(re.findall(r"[a-z]{4,}", text.lower()))


def tests_of(mutant):
    """The files of tests that concern a change, the nearest first.

    Near are those that import its module, that name its function, or the constant's, and that stand in the folder of
    its room, are called like its module, or import anything of its room.
    """
    room, stem = mutant.module.removesuffix(".py").split("/")[0], Path(mutant.module).stem
    module = "cvxshear." + mutant.module.removesuffix(".py").replace("/", ".")
    names = names_of(mutant)
    near = {}
    for file, (modules, words) in asked().items():
        own = 4 * any(each.startswith(module) for each in modules) + 3 * any(names.get(word) == 0 for word in words)
        place = 2 * (f"tests/{room}/" in file or f"test_{stem}" in file or f"test_{room}" in file)
        near[file] = own + place + any(each.startswith(f"cvxshear.{room}") for each in modules)
    return tuple(sorted((file for file in near if near[file]), key=lambda file: (-near[file], file)))


def drawn(count, seed, only=()):
    """So many changes, each module as likely as it has places."""
    modules = [
        str(path.relative_to(ROOT / "cvxshear"))
        for room in ROOMS
        for path in sorted((ROOT / "cvxshear" / room).glob("*.py"))
    ]
    chosen = [each for each in modules if not only or any(each.startswith(name) for name in only)]
    every = [mutant for module in chosen for mutant in mutants(module)]
    return random.Random(seed).sample(every, min(count, len(every)))


WAITED = 20
"""Times its limit on computing that a process is waited for: one that waits for itself computes nothing."""

QUIET = ("-W", "ignore::pytest.PytestAssertRewriteWarning")
"""pytest has been imported, with its plugins, before it is asked."""


class Watcher:
    """A plugin of pytest that runs tests by the calls between them and a change, then by the words that they share
    with it, those that few tests have before others.

    It writes down the first test that fails, and skips what is left after so many seconds of running tests.
    """

    def __init__(self, path, names, said, seconds):
        self._path, self._names, self._said, self._seconds = path, names, said, seconds
        self._began = None

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        """Put the nearest first again, after `conftest` has put first what takes longest."""
        shared = {item: self._said & parts_of(" ".join(said_in(item))) for item in items}
        often = Counter(word for words in shared.values() for word in words)

        def place(item):
            calls = min((self._names[each] for each in said_in(item) & self._names.keys()), default=FARTHEST)
            return calls, -sum(1.0 / often[word] for word in shared[item])

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
    """The words in the source of a test, and in that of the fixtures and functions of its file that it names."""
    given = item._fixtureinfo.name2fixturedefs.values()
    return frozenset().union(*(words_of(each) for each in (item.function, *(some[-1].func for some in given))))


@functools.cache
def words_of(function):
    """The words in the source of a function, and in that of the functions of its file that it names."""
    words = set(re.findall(r"\w+", inspect.getsource(function)))
    beside = (function.__globals__.get(each) for each in words - {function.__name__})
    near = [each for each in beside if inspect.isfunction(each) and each.__module__ == function.__module__]
    return words.union(*(re.findall(r"\w+", inspect.getsource(each)) for each in near))


def warm_up():
    """Import what tests import, once: each change is tried in a process that is forked from this one."""
    pytest.main(["--collect-only", "-q", "-q", "-n", "0", "-p", "no:cacheprovider", *QUIET, *asked()])
    for name in list(sys.modules):
        if name.partition(".")[0] in {"cvxshear", "tests"} and name != __name__:
            del sys.modules[name]


def first_failure(folder, tests, names, said, given, broken=()):
    """Name the first of these tests that fails in a copy of the project; empty where the process ends before, or takes
    longer than the limit, None where all pass."""
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
        # Seconds of computing: on a machine that is busy with something else no test takes longer by those.
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
    """The changes that no test noticed. A test that fails without the change, too, has noticed nothing."""
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
                # A process that ends without a word has found the change only where it does not end so without it.
                if first_failure(folder, (failed,) if failed else tests, names, said, given, broken) is None:
                    break
                if failed:
                    say(f"left out, since it fails without any change: {failed}")
                    broken.add(failed)
                else:
                    # Without the change they take too long as well: the last file is left out.
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
    parser.add_argument("--module", action="append", default=[], help="a room or a module, such as fit/noise.py; again")
    parser.add_argument("--seconds", type=int, default=40, help="of computing, after which no further test is begun")
    parser.add_argument("--limit", type=int, default=120, help="seconds of computing for the tests of one change")
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
