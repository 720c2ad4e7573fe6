"""Count how often the loop finds an overlooked mode, and how often it renumbers correct modes.

python -m tests.studies numbering --frames 60 --seed 1 tests 60 random frames of the independent finite-element model at
some of their floors, in one to three configurations, with one effect of the catalogue or without. Each is tested three
times: with all modes, with one lost in every configuration, and with one lost in the first.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from cvxshear import Experiment
from cvxshear.loop.close import search_for_effects
from tests.fe.experiments import simulated

EFFECTS = (None, "gravity", "joint_rotation", "sensor_gain", "ground_spring")
LOST = ("none", "in every configuration", "in the first of several")


@dataclass(frozen=True)
class Trial:
    """One random frame, and the configurations in which one of its modes was overlooked."""

    lost: str
    effect: str | None
    seed: int


def tested(trial):
    """Return the measurement, and the true numbers of modes whose numbers seem different."""
    rng = np.random.default_rng(trial.seed)
    stories = int(rng.integers(5, 10))
    several = trial.lost == LOST[2] or trial.effect == "gravity"
    configurations = int(rng.integers(2 if several else 1, 4))
    floors = sorted((rng.choice(stories, int(rng.integers(3, stories)), replace=False) + 1).tolist())
    modes = int(rng.integers(4, min(stories, 7)))
    declared, truth = simulated(
        trial.effect, stories=stories, configurations=configurations, rng=rng, measured_floors=floors, modes=modes
    )
    overlooked = int(rng.integers(2, modes))
    right = {}
    if trial.lost != LOST[0]:
        for each in declared["configuration"][: None if trial.lost == LOST[1] else 1]:
            kept = [mode for mode in range(1, modes + 1) if mode != overlooked]
            for key in ("frequencies", "mode_shapes", "frequency_std", "mode_shape_std"):
                if isinstance(each.get(key), list):
                    each[key] = [each[key][mode - 1] for mode in kept]
            right[each["name"]] = tuple(kept)
    return declared, truth, right


def outcome(trial):
    """Return the result for the numbers, and for the effects if the numbers are right."""
    declared, truth, right = tested(trial)
    closure = search_for_effects(Experiment.from_dict(declared))
    first = closure.numberings[0]
    if dict(first.changes) != right:
        words = [dict(each.changes) for each in closure.numberings[1:] if each.probability > 0.05]
        return "doubted" if right in words else "wrong", None
    wanted = {item[0] for item in truth["effects"]}
    found = [item.placed.effect.name for item in closure.effects]
    rivals = {rival.placed.effect.name for item in closure.effects for rival in item.rivals}
    return "right", set(found) == wanted or wanted <= {*found, *rivals}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--failures", action="store_true", help="list every frame whose modes were numbered wrongly")
    options = parser.parse_args()
    trials = [
        Trial(lost, EFFECTS[i % len(EFFECTS)], options.seed * 1_000_000 + 10_000 * place + i)
        for place, lost in enumerate(LOST)
        for i in range(options.frames)
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        results = list(zip(trials, pool.map(outcome, trials), strict=True))
    print("| a mode lost | frames | numbers right | right ones among the others | wrong | effect first or a rival |")
    print("|---|---|---|---|---|---|")
    for lost in LOST:
        of = [result for trial, result in results if trial.lost == lost]
        words = Counter(word for word, _ in of)
        named = sum(bool(effect) for word, effect in of if word == "right")
        print(f"| {lost} | {len(of)} | {words['right']} | {words['doubted']} | {words['wrong']} | {named} |")
    if options.failures:
        for trial, (word, effect) in results:
            if word != "right" or not effect:
                print(word, effect, trial)


if __name__ == "__main__":
    main()
