"""Run commands on every file that is read: finite numbers or a message, and a status of 0, 1 or 2."""

import json
import math

import numpy as np
import pytest
from hypothesis import assume, given, seed
from hypothesis import strategies as st

from cvxshear.io.toml import load
from cvxshear.util.errors import CvxshearError
from tests.fuzz import files
from tests.fuzz.mutations import PLACES, WORD, apply, damaged, many
from tests.records.shared import csv

SHARE = 5
"""Ratio of the budgets of readers and commands. A command takes far longer than a reader."""

VALUES = (0.0, -1.0, 1e-30, 1e30, 1e-12, 1e12, 0.5, 2.0, 100.0, 1e6)


def numbers(value):
    if isinstance(value, dict):
        for each in value.values():
            yield from numbers(each)
    elif isinstance(value, list):
        for each in value:
            yield from numbers(each)
    elif isinstance(value, float):
        yield value


def assert_sound(status, out, err):
    """Assert that a command ended with finite numbers in JSON or with a message of one line."""
    assert status in (0, 1, 2)
    if status == 0:
        assert all(math.isfinite(each) for each in numbers(json.loads(out)))
        assert not err
    else:
        assert err.startswith("cvxshear: ")
        assert err.count("\n") == 1


def with_value(content: bytes, place: float, value: float) -> bytes:
    """Multiply or replace one of the numbers in the text."""
    words = [found for found in WORD.finditer(content) if found.group().replace(b".", b"").isdigit()]
    found = words[int(place * len(words))]
    text = f"{float(found.group()) * value:.9g}" if value > 0 else f"{value:.9g}"
    return content[: found.start()] + text.encode() + content[found.end() :]


METHODS = (("base", "subspace"), ("none", "ssi"), ("free_decay", "era"))

CHANGES = st.lists(st.tuples(PLACES, st.sampled_from(VALUES)), min_size=1, max_size=3)


@pytest.mark.parametrize("command", ["identify", "loop"])
def test_a_measurement_that_is_read_is_identified_or_refused(command, fuzz_budget, tmp_path, run):
    path = tmp_path / "x.toml"
    options = {"identify": [["--method", each] for each in ("efficient", "two-stage", "one-shot", "berman", "qi")]}
    choices = options.get(command, [["--effects", "ground_spring,story_change"], []])

    @seed(5)
    @many(fuzz_budget // (SHARE if command == "identify" else 4 * SHARE))
    @given(CHANGES, damaged(1), st.booleans(), st.sampled_from(choices))
    def check(changes, edits, as_bytes, chosen):
        content = files.measurement()
        for place, value in changes:
            content = with_value(content, place, value)
        path.write_bytes(apply(content, edits) if as_bytes else content)
        try:
            load(path)
        except CvxshearError:
            assume(False)
        assert_sound(*run(command, path, *chosen, "--json", "-"))

    check()


def test_a_record_that_is_read_has_modes_or_is_refused(fuzz_budget, tmp_path, run):
    path = tmp_path / "x.toml"
    sound = files.columns()
    kinds = ("constant", "huge", "tiny", "spike", "step", "repeat", "zeros", "copy", "integers")
    column = st.tuples(st.sampled_from(kinds), st.integers(1, 4), PLACES)

    @seed(6)
    @many(fuzz_budget // (2 * SHARE))
    @given(st.lists(column, min_size=1, max_size=3), st.sampled_from(METHODS), st.integers(128, 600))
    def check(changes, how, length):
        driven, method = how
        values = sound[:length].copy()
        for kind, place, share in changes:
            values[:, place] = _spoilt(values[:, place], kind, share, values[:, 1 + place % 4])
        csv(tmp_path / "x.csv", ["t", "ground", "a1", "a2", "a3"], values)
        path.write_text(files.record_text("x.csv").replace("base", driven))
        assert_sound(*run("modes", path, "--method", method, "--quiet", "--json", "-"))

    check()


def _spoilt(column: np.ndarray, kind: str, share: float, other: np.ndarray) -> np.ndarray:
    at = int(share * len(column))
    result = column.copy()
    if kind in ("constant", "zeros"):
        return np.full(len(column), 0.0 if kind == "zeros" else 3.0)
    if kind in ("huge", "tiny"):
        return column * (1e25 if kind == "huge" else 1e-25)
    if kind == "spike":
        result[at] = 1e20
    if kind == "step":
        result[at:] += 1e6
    if kind == "repeat":
        return np.resize(column[: 2 + at % 7], len(column))
    return {"copy": other, "integers": np.round(column)}.get(kind, result)
