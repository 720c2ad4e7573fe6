"""Examine files with one frequency that is 3 to 20 % wrong, by `check` and by the loop.

Random finite-element frames have 3 to 7 stories without an effect, tested two or three times under known loads.
`python -m tests.studies wrong_frequency --frames 12 --seed 1` counts outcomes for files with shapes and for files
of frequencies alone: the wrong one is named alone, with others, another one is named, or none. `--loop` prints the
loop's conclusions for missed files and counts effects with 95 % or more; the true number of effects is zero.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from cvxshear import CvxshearError, Experiment
from cvxshear.loop.close import search_for_effects
from cvxshear.screening import screen
from tests.fe.experiments import simulated

SURE = 0.95


def file_of(number: int, seed: int, *, shapes: bool) -> tuple[dict, str]:
    """Return the dict of a file with a wrong frequency, and the words that name this frequency."""
    rng = np.random.default_rng([seed, number])
    declared, _ = simulated(None, stories=int(rng.integers(3, 8)), configurations=int(rng.integers(2, 4)), rng=rng)
    table = declared["configuration"][int(rng.integers(len(declared["configuration"])))]
    right = np.array(table["frequencies"])
    while True:
        at = int(rng.integers(len(right)))
        wrong = right * np.where(np.arange(len(right)) == at, 1 + rng.choice([-1, 1]) * rng.uniform(0.03, 0.2), 1.0)
        if np.all(np.diff(wrong) > 0):
            break
    table["frequencies"] = wrong.tolist()
    if not shapes:
        for each in declared["configuration"]:
            del each["mode_shapes"], each["mode_shape_std"]
            each.pop("measured_floors", None)
    return declared, f'mode {at + 1} of "{table["name"]}"'


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--loop", action="store_true")
    given = parser.parse_args()
    for shapes in (True, False):
        counts: Counter[str] = Counter()
        for number in range(given.frames):
            declared, name = file_of(number, given.seed, shapes=shapes)
            experiment = Experiment.from_dict(declared)
            found = [item for item in screen(experiment) if item.refuses or item.name == "frequency"]
            said = " ".join(item.change for item in found)
            alone = name in said and not said.startswith("One of")
            what = "alone" if alone else "among others" if name in said else "another" if found else "passed over"
            counts[what if not found or found[0].refuses else f"{what}, a doubt beside a mass on a spring"] += 1
            if what == "passed over" and given.loop:
                counts[concluded(number, experiment)] += 1
        print("with shapes" if shapes else "frequencies alone", dict(counts), flush=True)


def concluded(number: int, experiment: Experiment) -> str:
    """Return the loop's conclusion for a file in a few words; a sure effect is wrong."""
    try:
        result = search_for_effects(experiment)
    except CvxshearError as error:
        print(f"  {number}: {error}"[:200])
        return "no answer"
    said = ", ".join(f"{each.placed.label} ({each.probability:.3f})" for each in result.effects)
    print(f"  {number}: {result.verdict}: {said}", flush=True)
    sure = any(each.probability >= SURE for each in result.effects)
    return f"{result.verdict}, sure of {'an effect' if sure else 'none'}"


if __name__ == "__main__":
    main()
