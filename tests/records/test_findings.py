"""Test the messages about records: each is used, and each use fills all its gaps."""

import ast
from pathlib import Path
from string import Formatter

import cvxshear
from cvxshear.records.clocks import FAULT_SIZES
from cvxshear.records.record import SENTENCES, finding
from cvxshear.records.result import OVERLOOKED_KIND


def keys_of(node, named):
    """Return the keys of a dict in a call, with the keys of named and spread dicts."""
    if isinstance(node, ast.Name):
        return named.get(node.id, set())
    if not isinstance(node, ast.Dict):
        return set()
    found = set()
    for key, value in zip(node.keys, node.values, strict=True):
        # A key of None marks a spread dict.
        found |= keys_of(value, named) if key is None else {key.value} if isinstance(key, ast.Constant) else set()
    return found


def said():
    """Return the message's key and the names for its gaps, for each call of `finding` in the package."""
    for path in Path(cvxshear.__file__).parent.rglob("*.py"):
        for function in (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)):
            named = {}
            for node in ast.walk(function):
                if isinstance(node, ast.Assign | ast.AugAssign) and isinstance(node.value, ast.Dict):
                    (target,) = node.targets if isinstance(node, ast.Assign) else [node.target]
                    if isinstance(target, ast.Name):
                        named.setdefault(target.id, set()).update(keys_of(node.value, {}))
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "finding":
                    key, numbers = node.args
                    words = ({word.arg} if word.arg else keys_of(word.value, named) for word in node.keywords)
                    filled = keys_of(numbers, named).union(*words)
                    kinds = FAULT_SIZES if isinstance(key, ast.Attribute) else {OVERLOOKED_KIND: ""}
                    for kind in [key.value] if isinstance(key, ast.Constant) else kinds:
                        yield kind, filled | {kinds.get(kind, "")}


def test_every_gap_of_every_sentence_is_filled():
    found = list(said())
    assert {key for key, _ in found} == set(SENTENCES)
    for key, filled in found:
        gaps = {name for _, name, _, _ in Formatter().parse(SENTENCES[key]) if name}
        assert gaps <= filled, key


def test_a_number_is_written_in_the_unit_that_its_gap_asks_for():
    found = finding("rotation", {"mode": 2, "share": 0.0625})
    assert found.kind == "rotation"
    assert found.numbers == {"mode": 2, "share": 0.0625}
    assert found.message.startswith("mode 2: 6 % of the motion at its frequency is rotation")
    offset = finding("clock offset", {"channel": "a", "reference": "b"}, by=0.01234, late="late", spread="0.5")
    assert offset.message.startswith('the clock of "a" is 12.34 ms late (std 0.5 ms) against that of "b"')
