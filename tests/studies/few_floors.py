"""Find softer stories with few or no sensors: `python -m tests.studies few_floors [FRAMES [SEED]]`.

The first frames have five to seven stories; their masses and stiffnesses scatter by a tenth. They are tested bare, then
with a story that lost a fifth, both bare and with a known mass on the top floor. Sensors are at two floors or none.
The second frames have three to five stories, frequencies alone and no known mass. In each of two states, a different
story lost a fifth. The table counts the softer stories found (named or rival) and the other findings with 95 % or more.
"""

from __future__ import annotations

import sys

import numpy as np

from cvxshear import Experiment
from cvxshear.loop.close import search_for_effects
from tests.frames import modes_of

LOSS, LOAD = 0.2, 0.15
"""Lost part of the story's stiffness, and the known mass relative to a floor's mass."""
FREQUENCY_STD, SHAPE_STD = 0.001, 0.01
SURE = 0.95


def drawn(rng, stories):
    """Return random floor masses and story stiffnesses."""
    mass = 1e4 * np.exp(0.1 * rng.standard_normal(stories))
    return mass, 3e7 * np.linspace(1.0, 0.6, stories) * np.exp(0.1 * rng.standard_normal(stories))


def softer(stiffness, story):
    """Return the stiffnesses with a loss in one story, counted from 1."""
    return stiffness * np.where(np.arange(1, len(stiffness) + 1) == story, 1 - LOSS, 1.0)


def table(rng, name, state, mass, stiffness, added, seen):
    """Return a test as a dict, with shapes at these floors."""
    frequencies, shapes = modes_of(mass + added, stiffness)
    noise = 1 + FREQUENCY_STD * rng.standard_normal(len(mass))
    result = {
        "name": name, "state": state, "added_mass": added.tolist(),
        "frequencies": (frequencies * noise).tolist(), "frequency_std": FREQUENCY_STD,
    }  # fmt: skip
    if len(seen):
        noise = rng.standard_normal((len(mass), len(seen)))
        shown = shapes[:, seen - 1] / np.abs(shapes[:, seen - 1]).max(axis=1, keepdims=True)
        result |= {
            "measured_floors": seen.tolist(), "mode_shapes": (shown + SHAPE_STD * noise).tolist(),
            "mode_shape_std": SHAPE_STD,
        }  # fmt: skip
    return result


def loaded(rng, floors):
    """Return a measurement file as a dict, and its changes as (story, state)."""
    stories = int(rng.integers(5, 8))
    mass, stiffness = drawn(rng, stories)
    soft = int(rng.integers(stories)) + 1
    load = LOAD * 1e4 * (np.arange(stories) == stories - 1)
    seen = np.unique(np.linspace(stories, 1, floors).round().astype(int)) if floors else np.zeros(0, dtype=int)
    after, none = softer(stiffness, soft), 0 * load
    tests = (("before", "before", stiffness, none), ("after", "after", after, none), ("loaded", "after", after, load))
    tables = [table(rng, name, state, mass, k, added, seen) for name, state, k, added in tests]
    return declared(mass, tables), [(soft, "after")]


def bare(rng):
    """Return a measurement file with frequencies alone and no known mass; two stories lose stiffness in turn."""
    stories = int(rng.integers(3, 6))
    mass, stiffness = drawn(rng, stories)
    first, second = (rng.choice(stories, 2, replace=False) + 1).tolist()
    states = {"before": stiffness, "first": softer(stiffness, first), "second": softer(stiffness, second)}
    nothing, nowhere = np.zeros(stories), np.zeros(0, dtype=int)
    tables = [table(rng, state, state, mass, k, nothing, nowhere) for state, k in states.items()]
    return declared(mass, tables), [(first, "first"), (second, "second")]


def declared(mass, tables):
    """Return a measurement file of these tests."""
    frame = {"total_mass": float(mass.sum()), "story_heights": 3.0, "reference": "before"}
    return {"frame": frame, "configuration": tables}


def trial(file, changed):
    """Count the softer stories that are found (named or rival), and the other findings with 95 % or more."""
    closure = search_for_effects(Experiment.from_dict(file))
    wanted = {f'story change at story {story} of "{state}"' for story, state in changed}
    named = {item.placed.label: item.probability for item in closure.effects}
    rivals = {rival.placed.label for item in closure.effects for rival in item.rivals}
    return len(wanted & (named.keys() | rivals)), sum(p >= SURE for label, p in named.items() if label not in wanted)


def main(frames=20, seed=1):
    print("| sensors | frames | softer stories | found or a rival | something else at 95 % or more |")
    print("|---|---:|---:|---:|---:|")
    kinds = {
        "none": lambda rng: loaded(rng, 0), "at two floors": lambda rng: loaded(rng, 2),
        "none, and no load": bare,
    }  # fmt: skip
    for place, (words, made) in enumerate(kinds.items()):
        rng = np.random.default_rng([seed, 2 * place])
        files = [made(rng) for _ in range(frames)]
        found, false = np.sum([trial(*each) for each in files], axis=0)
        print(f"| {words} | {frames} | {sum(len(each[1]) for each in files)} | {found} | {false} |", flush=True)


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
