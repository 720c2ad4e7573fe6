"""One softer story seen by sensors at no floor or two: `python -m tests.benchmarks.few_floors [FRAMES [SEED]]`.

Frames of five to seven stories whose floors and stories scatter by a tenth, tested bare, then with one story that lost
a fifth, bare and with a known mass on the top floor. Printed is, for frequencies alone and for shapes at two floors, in
how many the softer story is found or a rival of what is found, and in how many something else is named with 95 % or
more.
"""

from __future__ import annotations

import sys

import numpy as np

from cvxshear import Experiment
from cvxshear.loop import close_loop
from tests.frames import modes_of

LOSS, LOAD = 0.2, 0.15
"""Part of its stiffness that the story lost, and the known mass over that of a floor."""
FREQUENCY_STD, SHAPE_STD = 0.001, 0.01
SURE = 0.95


def tested(rng, floors):
    """A measurement file as a dict, and the story (from 1) that lost stiffness."""
    stories = int(rng.integers(5, 8))
    mass = 1e4 * np.exp(0.1 * rng.standard_normal(stories))
    stiffness = 3e7 * np.linspace(1.0, 0.6, stories) * np.exp(0.1 * rng.standard_normal(stories))
    soft = int(rng.integers(stories))
    softer = stiffness * np.where(np.arange(stories) == soft, 1 - LOSS, 1.0)
    load = LOAD * 1e4 * (np.arange(stories) == stories - 1)
    seen = np.unique(np.linspace(stories, 1, floors).round().astype(int)) if floors else np.zeros(0, dtype=int)
    tables = []
    for name, k, added in (("before", stiffness, 0 * load), ("after", softer, 0 * load), ("loaded", softer, load)):
        frequencies, shapes = modes_of(mass + added, k)
        noise = 1 + FREQUENCY_STD * rng.standard_normal(stories)
        table = {
            "name": name, "state": "before" if name == "before" else "after", "added_mass": added.tolist(),
            "frequencies": (frequencies * noise).tolist(), "frequency_std": FREQUENCY_STD,
        }  # fmt: skip
        if floors:
            noise = rng.standard_normal((stories, len(seen)))
            shown = shapes[:, seen - 1] / np.abs(shapes[:, seen - 1]).max(axis=1, keepdims=True)
            table |= {
                "measured_floors": seen.tolist(), "mode_shapes": (shown + SHAPE_STD * noise).tolist(),
                "mode_shape_std": SHAPE_STD,
            }  # fmt: skip
        tables.append(table)
    frame = {"total_mass": float(mass.sum()), "story_heights": 3.0, "reference": "before"}
    return {"frame": frame, "configuration": tables}, soft + 1


def trial(rng, floors):
    """Whether the softer story is found or a rival, and whether anything else is named for sure."""
    declared, soft = tested(rng, floors)
    closure = close_loop(Experiment.from_dict(declared))
    wanted = f'story change at story {soft} of "after"'
    named = {item.placed.label: item.probability for item in closure.effects}
    rivals = {rival.placed.label for item in closure.effects for rival in item.rivals}
    return wanted in named or wanted in rivals, any(p >= SURE for label, p in named.items() if label != wanted)


def main(frames=20, seed=1):
    print("| sensors | frames | softer story found or a rival | something else at 95 % or more |")
    print("|---:|---:|---:|---:|")
    for floors in (0, 2):
        rng = np.random.default_rng([seed, floors])
        found, false = np.sum([trial(rng, floors) for _ in range(frames)], axis=0)
        print(f"| {floors} | {frames} | {found} | {false} |", flush=True)


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
