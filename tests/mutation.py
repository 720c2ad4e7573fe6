"""Do the tests notice a wrong sign? Small changes are made to copies of modules, and the tests that concern them run.

`python -m tests.mutation --mutants 100 --seed 1 [--module planning/chances.py] [-n 2] [--limit 300]` draws changes (a
sign, an operator, a comparison, a constant, a condition negated, a return dropped) over the rooms of `CONCERNED`, runs
the tests named there on a copy of the project in a temporary folder, prints how many changes were found and lists the
others. A change that takes the tests beyond the limit counts as found.
"""

import argparse
import ast
import os
import queue
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("cvxshear", "tests", "examples", "docs", "pyproject.toml", "README.md")

CONCERNED = {
    "planning": (
        "planning/test_information.py", "planning/test_expected_noise.py", "planning/test_chances.py",
        "planning/test_windows.py", "planning/test_choice.py", "planning/test_plan.py",
    ),
    "programs": ("test_programs.py", "test_priors.py", "test_properties.py", "test_fast.py"),
    "priors": ("test_priors.py", "test_programs.py", "test_experiment.py"),
    "backends": (
        "test_backends.py", "test_certificates.py", "test_compiled.py", "test_working_set.py",
        "test_comparison.py",
    ),
    "effects": ("effects", "test_states.py"),
    "data": ("test_data.py", "test_priors.py", "test_efficient.py"),
    "fit": ("test_efficient.py", "test_noise.py", "test_smooth.py", "test_separation.py", "test_evidence.py"),
    "loop": ("test_evidence.py", "test_posterior.py", "test_search.py", "test_loop.py", "test_next_sensors.py"),
    "response": ("response",),
    "modal": ("modal",),
    "model": ("test_linear.py", "test_efficient.py", "test_fast.py"),
    "paper": ("paper",),
}
"""Rooms whose modules are changed, and the tests that are to notice it, in the order in which they run."""  # fmt: skip

OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.MatMult: ast.Mult,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


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


def _other_operator(node):
    if isinstance(node, ast.Compare):
        node.ops[0] = OPERATORS[type(node.ops[0])]()
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
    node.value = node.value + 1 if isinstance(node.value, int) else 2 * node.value + (node.value == 0)


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


def tests_of(module):
    return CONCERNED[module.split("/")[0]]


def drawn(count, seed, only=()):
    """So many changes, each module as likely as it has places."""
    modules = [
        str(path.relative_to(ROOT / "cvxshear"))
        for room in CONCERNED
        for path in sorted((ROOT / "cvxshear" / room).glob("*.py"))
    ]
    chosen = [each for each in modules if not only or any(each.startswith(name) for name in only)]
    every = [mutant for module in chosen for mutant in mutants(module)]
    return random.Random(seed).sample(every, min(count, len(every)))


def passes(folder, tests, limit):
    """Whether these tests pass in a copy of the project; False too where they take longer than the limit."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    run = subprocess.Popen(
        [*command, *(f"tests/{name}" for name in tests)],
        cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"},
    )  # fmt: skip
    try:
        return run.wait(limit) == 0
    except subprocess.TimeoutExpired:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
        return False


def survivors(some, jobs, limit, say=print):
    """The changes that were tried, and those of them that no test noticed.

    Each process has a copy of the project of its own.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folders = queue.Queue()
        for place in range(jobs):
            folder = Path(temporary) / str(place)
            for name in COPIED:
                source = ROOT / name
                ignored = shutil.ignore_patterns("__pycache__")
                if source.is_dir():
                    shutil.copytree(source, folder / name, ignore=ignored)
                else:
                    shutil.copy(source, folder / name)
            folders.put(folder)

        def survives(mutant):
            folder = folders.get()
            path = folder / "cvxshear" / mutant.module
            before = path.read_text()
            try:
                path.write_text(mutated(before, mutant))
                alive = passes(folder, tests_of(mutant.module), limit)
            finally:
                path.write_text(before)
                folders.put(folder)
            say(f"{'NOT FOUND' if alive else 'found'}: {mutant.module}:{mutant.line} {mutant.words[:100]}")
            return alive

        # Tests that fail without any change would find every change.
        for tests in sorted({tests_of(each.module) for each in some}):
            folder = folders.get()
            if not passes(folder, tests, 10 * limit):
                say(f"left out, since they fail without any change: {', '.join(tests)}")
                some = [each for each in some if tests_of(each.module) != tests]
            folders.put(folder)
        with ThreadPoolExecutor(jobs) as pool:
            return some, [mutant for mutant, alive in zip(some, pool.map(survives, some), strict=True) if alive]


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--mutants", type=int, default=30, help="how many changes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--module", action="append", default=[], help="a room or a module, such as fit/noise.py; again")
    parser.add_argument("-n", "--jobs", type=int, default=1, help="processes")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds for the tests of one change")
    given = parser.parse_args()
    some = drawn(given.mutants, given.seed, given.module)
    tried, left = survivors(some, given.jobs, given.limit, lambda line: print(line, flush=True))
    print(f"{len(tried) - len(left)} of {len(tried)} changes found (seed {given.seed})")
    for mutant in left:
        print(f"  cvxshear/{mutant.module}:{mutant.line}: {mutant.words}")


if __name__ == "__main__":
    main()
