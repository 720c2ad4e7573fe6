"""Which rules of the loop matter: each is neutralized in turn, and the verdicts on a frozen set of frames are compared.

python -m tests.studies.ablation --frames 1 --seed 41 prints a table with a row for each rule: the frames whose verdict
or causes change, those that become right or wrong, and the time relative to the unchanged loop. `--rule NAME` runs one
rule, `--list` prints the names. A frame with a cause of the catalogue is right if exactly its causes are named. A frame
with a cause outside the catalogue is right if no false cause has 95 % or more.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.studies import calibration, outside

SURE = 0.95

RULES: dict[str, tuple[str, dict[str, Any]]] = {
    "many causes are weighed against an unknown one": ("loop.posterior", {"MANY_CAUSES": 99}),
    "causes must have been made more probable": ("loop.posterior", {"RAISED": 1.0}),
    "six sets and six further effects": ("loop.search", {"BEAM": 3}),
    "sets within a thousandth of the best are followed": ("loop.search", {"WITHIN": 4.0}),
    "two equal sets are both expanded": ("loop.search", {"TIE": 0.0}),
    "at most 600 small fits": ("loop.search", {"MOST_WORK": 200}),
    "at most twenty starts of motions and frames": ("loop.search", {"MOST_STARTS": 4}),
    "effects on accuracy": ("loop.search", {"RESCALING": 0}),
    "a second mode is no peak": ("fit.gaussian", {"SECOND_MODE": np.inf}),
}
"""Name of a rule, the module that holds it, and the neutral values of its constants."""


@dataclass(frozen=True)
class Frame:
    """One frame of the set: `source` is "placed" or a kind of `tests.studies.outside`."""

    source: str
    number: int
    trial: Any = None


@dataclass(frozen=True)
class Outcome:
    """What the loop says of a frame, and whether it is right."""

    verdict: str
    causes: frozenset[tuple[Any, ...]]
    right: bool
    seconds: float


def frames(count: int, seed: int) -> list[Frame]:
    """Draw the frozen set: known causes, pairs of them, none, and causes outside the catalogue."""
    trials = [*calibration.trials(count, seed), *calibration.pairs(count, seed), *calibration.nothing(count, seed)]
    placed = [Frame("placed", number, trial) for number, trial in enumerate(trials)]
    return placed + [Frame(kind, 1000 * seed + i) for kind in outside.KINDS for i in range(count)]


def outcome(task: tuple[Frame, str | None]) -> Outcome:
    """Close the loop on a frame with a rule neutralized."""
    frame, rule = task
    with neutralized(rule):
        begun = time.process_time()
        if frame.trial is not None:
            found = calibration.outcome(frame.trial)
            return Outcome(found.verdict, found.found, found.word == "exact", time.process_time() - begun)
        found = outside.outcome((frame.source, frame.number))
        causes = frozenset((name,) for name, probability in found.named if probability >= SURE)
        return Outcome(found.verdict, causes, not found.false, time.process_time() - begun)


@contextmanager
def neutralized(rule: str | None) -> Iterator[None]:
    """Set the constants of a rule to their neutral values, in every module of the loop that imports them."""
    if rule is None:
        yield
        return
    home, values = RULES[rule]
    importlib.import_module(f"cvxshear.{home}")
    changed = [
        (module, name, getattr(module, name))
        for path, module in list(sys.modules.items())
        if path.startswith(("cvxshear.loop", "cvxshear.fit"))
        for name in values
        if hasattr(module, name)
    ]
    try:
        for module, name, _ in changed:
            setattr(module, name, values[name])
        yield
    finally:
        for module, name, value in changed:
            setattr(module, name, value)


def compared(before: Sequence[Outcome], after: Sequence[Outcome]) -> tuple[int, int, int, float]:
    """Count the frames that change, become right and become wrong; and divide the times."""
    pairs = list(zip(before, after, strict=True))
    changed = sum((a.verdict, a.causes) != (b.verdict, b.causes) for a, b in pairs)
    better, worse = sum(b.right and not a.right for a, b in pairs), sum(a.right and not b.right for a, b in pairs)
    return changed, better, worse, sum(b.seconds for b in after) / sum(a.seconds for a in before)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1, help="of each kind")
    parser.add_argument("--seed", type=int, default=41)
    parser.add_argument("--rule", action="append", choices=RULES)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--list", action="store_true", help="print the rules")
    chosen = parser.parse_args()
    if chosen.list:
        print("\n".join(RULES))
        return
    drawn = frames(chosen.frames, chosen.seed)
    with ProcessPoolExecutor(chosen.jobs) as pool:
        before = list(pool.map(outcome, [(frame, None) for frame in drawn]))
        right = sum(each.right for each in before)
        print(f"{len(drawn)} frames, {right} right, {sum(each.seconds for each in before):.0f} s")
        print("| rule neutralized | verdicts or causes that change | become right | become wrong | time |")
        print("|---|---|---|---|---|", flush=True)
        for rule in chosen.rule or RULES:
            after = list(pool.map(outcome, [(frame, rule) for frame in drawn]))
            changed, better, worse, ratio = compared(before, after)
            print(f"| {rule} | {changed} | {better} | {worse} | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main()
