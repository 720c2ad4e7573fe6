"""Identify the asymmetric cases of the IASC-ASCE benchmark: ``python -m tests.studies asymmetric``.

The modes are those of tests/fe/space_frames.py, with noise of 0.2 % of a frequency and 1 % of a shape's largest entry.
A pattern's loss is the difference of two identified states, the undamaged one and its own.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

import cvxshear
from cvxshear.fit.turning_floors import TurningFrame
from tests.fe.space_frames import SIDE, iasc_asce

Losses = NDArray[np.float64]

METHOD = "one-shot"
NOISE = 0.01
TOTAL_MASS = 10717.2
"""All floors with the heavy slab, kg."""
BRACE = 12.0576
"""Stiffness of a brace along its face, MN/m."""
LOSSES = {
    1: {("x", 1): 4.0, ("y", 1): 4.0},
    2: {("x", 1): 4.0, ("y", 1): 4.0, ("x", 3): 4.0, ("y", 3): 4.0},
    3: {("y", 1): 1.0},
    4: {("y", 1): 1.0, ("x", 3): 1.0},
    5: {("y", 1): 1.0, ("x", 3): 1.0},
    6: {("y", 1): 1 / 3},
}
"""Braces that are lost, by pattern, direction and story."""
CASES = {"case 4, 12 degrees of freedom": True, "case 5, 120 degrees of freedom": False}


def identified(pattern: int, rigid: bool, noise: float = NOISE, seed: int = 0) -> TurningFrame:
    """Identify one state with its total mass declared."""
    frame = iasc_asce(pattern, rigid=rigid)
    return cvxshear.identify(
        frame.experiment((2 * SIDE, 2 * SIDE), noise, seed, total_mass=TOTAL_MASS), method=METHOD
    ).frame


def losses(before: TurningFrame, after: TurningFrame) -> tuple[Losses, Losses]:
    """Return the stiffness lost in x and y of each story, MN/m, shape (N, 2), and its deviations."""
    lost = (before.story_stiffness - after.story_stiffness) / 1e6
    std = np.hypot(before.story_stiffness_std, after.story_stiffness_std) / 1e6
    return lost[:, [0, 1], [0, 1]], std[:, [0, 1], [0, 1]]


def side(before: TurningFrame, after: TurningFrame, story: int, direction: str) -> float:
    """Return where across its direction a story lost stiffness, m: the lost force in x acts at y, and the other way."""
    lost = (before.story_stiffness - after.story_stiffness)[story - 1]
    return float(lost[1, 2] / lost[1, 1] if direction == "y" else -lost[0, 2] / lost[0, 0])


def lines(rigid: bool) -> Iterator[str]:
    """Yield the floors of the undamaged frame, then a row for each story and direction that a pattern damages."""
    before = identified(0, rigid)
    floors = zip(before.floor_mass, before.mass_center, before.inertia, strict=True)
    for floor, (mass, (x, y), inertia) in enumerate(floors, 1):
        yield (f"floor {floor}: {mass:.0f} kg, center ({1e3 * x:+.0f}, {1e3 * y:+.0f}) mm, {inertia:.0f} kg m2")
    for story, K in enumerate(before.story_stiffness / 1e6, 1):
        yield f"story {story}: x {K[0, 0]:.1f}, y {K[1, 1]:.1f} MN/m, rotation {K[2, 2]:.0f} MN m"
    yield "| pattern | story | lost, MN/m | in truth | at | largest change elsewhere |"
    yield "|---|---|---|---|---|---|"
    for pattern, braces in LOSSES.items():
        after = identified(pattern, rigid, seed=pattern)
        lost, std = losses(before, after)
        changes = {
            (axis, story): (lost[story - 1, column], std[story - 1, column])
            for story in range(1, 5)
            for column, axis in enumerate("xy")
        }
        other = max(changes.keys() - braces.keys(), key=lambda place: abs(changes[place][0]))
        elsewhere = "{1}, {0}: {2:+.1f} ± {3:.1f}".format(*other, *changes[other])
        for place, count in braces.items():
            (axis, story), (change, deviation) = place, changes[place]
            at = f"{'yx'['xy'.index(axis)]} = {side(before, after, story, axis):+.2f} m" if count <= 1 else "–"
            yield (
                f"| {pattern} | {story}, {axis} | {change:.1f} ± {deviation:.1f} | {count * BRACE:.1f} | {at} | "
                f"{elsewhere} |"
            )


def main() -> None:
    """Print both cases."""
    for name, rigid in CASES.items():
        print(f"\n{name}")
        for line in lines(rigid):
            print(line, flush=True)


if __name__ == "__main__":
    main()
