"""Apply the loop to the IASC-ASCE benchmark: ``python -m tests.studies damage_patterns``.

The study runs for each direction, with declared floor masses or with only their total. One run takes each pattern
with the undamaged frame; one run takes all seven states. The table has the verdict, the changes found at their story
(named or rival), the false findings with 95 % or more, and the lost brace stiffness of the all-brace patterns.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

import cvxshear
from cvxshear.loop.close import search_for_effects

BRACES = 48.23
"""Stiffness of all braces in a story, MN/m."""

DAMAGED = {
    "x": {1: [1], 2: [1, 3], 3: [], 4: [3], 5: [3], 6: []},
    "y": {1: [1], 2: [1, 3], 3: [1], 4: [1], 5: [1], 6: [1]},
}
"""Stories with removed braces in one direction, by pattern."""

SURE = 0.95


def experiment_of(direction: str, patterns: tuple[int, ...], masses: bool) -> cvxshear.Experiment:
    """Return the undamaged frame and some patterns, with declared floor masses or only their total."""
    whole = cvxshear.load(f"iasc-asce-{direction}")
    names = {"pattern 0", *(f"pattern {number}" for number in patterns)}
    kept = tuple(each for each in whole.configurations if each.name in names)
    frame = whole.frame
    if not masses:
        frame = dataclasses.replace(frame, floor_masses=None, total_mass=float(frame.floor_masses.sum()))
    return dataclasses.replace(whole, frame=frame, configurations=kept)


def told(task: tuple[str, tuple[int, ...], bool]) -> str:
    """Return one line of the table."""
    direction, patterns, masses = task
    closure = search_for_effects(experiment_of(direction, patterns, masses))
    changes = {(number, story) for number in patterns for story in DAMAGED[direction][number]}
    found, rivals, false, braces = set(), set(), [], []
    for item in closure.effects:
        place, name = item.placed.place, item.placed.effect.name
        number = int(place.state.split()[1]) if place.state is not None else 0
        at = (number, place.story)
        if name == "story_change" and at in changes:
            found.add(at)
            if number in (1, 2):
                k = closure.frame.story_stiffness[place.story - 1] / 1e6
                braces.append(f"{-item.parameters['change'] * k:.1f}")
        elif item.placed.effect.kind == "cause" and number and item.probability >= SURE:
            false.append(f"{item.placed.label} {100 * item.probability:.0f} %")
        near = [rival.placed for rival in item.rivals if rival.placed.effect.name == "story_change"]
        rivals |= {(int(each.place.state.split()[1]), each.place.story) for each in near} & changes
    who = "all" if len(patterns) > 1 else str(patterns[0])
    what = "floor masses" if masses else "total mass"
    missed = sorted(changes - found - rivals)
    count = f"{len(found)} + {len((rivals - found) & changes)} of {len(changes)}"
    return (
        f"{direction}  {who:3s}  {what:12s}  {closure.verdict:11s}  {count}  "
        f"{', '.join(false) or '-':40s}  {', '.join(braces):16s}"
        + (f"  missed: {', '.join(f'{story} in pattern {number}' for number, story in missed)}" if missed else "")
    )


def lines() -> Iterator[str]:
    """Yield the lines of the table."""
    yield f"direction, patterns, declared, verdict, named + rivals, false, braces lost (of {BRACES} MN/m)"
    tasks = [
        (direction, patterns, masses)
        for direction in DAMAGED
        for masses in (True, False)
        for patterns in (*((number,) for number in DAMAGED[direction]), tuple(DAMAGED[direction]))
    ]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        yield from pool.map(told, tasks)


def main() -> None:
    """Print the table."""
    for line in lines():
        print(line, flush=True)


if __name__ == "__main__":
    main()
