"""Vary the declarations of the Los Alamos file: ``python -m tests.studies los_alamos_declared``.

The variants are the file itself, and files with scaled or undeclared frequency deviations, without the four exclusions,
or without the story ratios. The table has the verdict, how many of the eight changes come first at their place, how
many are rivals there, and the false findings with 95 % or more.
"""

from __future__ import annotations

import dataclasses
import os
from concurrent.futures import ProcessPoolExecutor

import cvxshear
from cvxshear.loop.close import search_for_effects

CHANGED = {
    "state 2": ("added_mass", 1), "state 3": ("added_mass", 2),
    "state 4": ("story_change", 2), "state 5": ("story_change", 2),
    "state 6": ("story_change", 3), "state 7": ("story_change", 3),
    "state 8": ("story_change", 4), "state 9": ("story_change", 4),
}  # fmt: skip
"""True changes of the frame (LA-14393, Table 2): kind, and floor or story."""

FACTORS = (0.75, 1.25, 1.5)
SURE = 0.95


def variants() -> dict[str, cvxshear.Experiment]:
    """Return the experiments, keyed by the changed declaration."""
    declared = cvxshear.load("los-alamos")
    found = {"as declared": declared}
    for factor in (*FACTORS, None):
        configurations = tuple(
            dataclasses.replace(each, frequency_std=None if factor is None else factor * each.frequency_std)
            for each in declared.configurations
        )
        words = "noise undeclared" if factor is None else f"noise {factor:g} times as large"
        found[words] = dataclasses.replace(declared, configurations=configurations)
    looked_for = tuple(each for each in declared.expected if not each.exclude)
    found["no exclusions"] = dataclasses.replace(declared, expected=looked_for)
    found["no ratios of stories"] = dataclasses.replace(declared, priors=())
    return found


def line(task: tuple[str, cvxshear.Experiment]) -> str:
    """Return one line of the table."""
    words, experiment = task
    closure = search_for_effects(experiment)

    def at(placed: cvxshear.effects.LocatedEffect) -> tuple[str, tuple[str, int | None]]:
        where = placed.place.story if placed.effect.name == "story_change" else placed.place.floor
        return placed.place.state or "", (placed.effect.name, where)

    right = set(CHANGED.items())
    first = {at(item.placed) for item in closure.effects} & right
    rivals = {at(rival.placed) for item in closure.effects for rival in item.rivals} & right - first
    false = [item.placed.label for item in closure.effects if item.probability >= SURE and at(item.placed) not in right]
    final = closure.after.estimate
    return (
        f"{words:24s} {closure.verdict:11s} {len(first)} first, {len(rivals)} among rivals of 8; "
        f"chi-square {final.chi2:.0f} of {final.dof}; false: {', '.join(false) or '-'}"
    )


def main() -> None:
    """Print the table."""
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for text in pool.map(line, variants().items()):
            print(text, flush=True)


if __name__ == "__main__":
    main()
