"""How often the loop names the right effect, on random frames made by the independent finite-element model.

python -m tests.confusion --frames 10 --seed 1 prints the table, with that many frames for each effect (and none)
and each number of configurations.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from cvxshear import Experiment, close_loop
from tests.fe.experiments import simulated

EFFECTS = (
    None, "gravity", "joint_rotation", "axial_columns", "base_rocking", "ground_spring", "added_mass",
    "mass_coupling", "sensor_gain", "story_change",
)  # fmt: skip

HIDDEN = ("gravity", "added_mass", "story_change")
"""Effects that one configuration alone cannot tell from the masses and stiffnesses themselves."""

HEAVIEST = 6.0
"""kg, the heaviest counterweight on a floor in the second and third test; floors weigh about 10 kg."""

OUTCOMES = ("first", "rival", "wrong", "missed", "nothing")


@dataclass(frozen=True)
class Trial:
    """One random frame: what is in it, how many configurations are tested, and whether their mass is spread out."""

    effect: str | None
    configurations: int
    seed: int
    spread: bool = True


def place(item):
    return item["name"], item["floor"], item["story"], item["configuration"]


def outcome(trial):
    """What the loop made of one frame, and whether the frame itself was found within four standard deviations.

    first: the right effect alone, or "nothing" where there was none to find; rival: the right one among the
    rivals; wrong: something else; missed: nothing, where there was something.
    """
    rng = np.random.default_rng(trial.seed)
    stories = int(rng.integers(3, 9))
    added = np.round(rng.uniform(0.0, HEAVIEST, (trial.configurations, stories)) * 2) / 2
    added[0] = 0.0
    # The simulation's own default is one counterweight on one floor a test.
    counterweights = added.tolist() if trial.spread else None
    declared, truth = simulated(
        trial.effect, stories=stories, configurations=trial.configurations, rng=rng, added_mass=counterweights
    )
    result = close_loop(Experiment.from_dict(declared)).to_dict()
    found = result["effects"]
    wanted = (truth["effect"], truth["floor"], truth["story"], truth["configuration"])
    if not visible(trial):
        return ("nothing" if not found else "wrong"), result, truth
    if not found:
        return "missed", result, truth
    if len(found) == 1 and place(found[0]) == wanted:
        return "first", result, truth
    named = [place(item) for effect in found for item in (effect, *effect["rivals"])]
    return ("rival" if wanted in named else "wrong"), result, truth


def deviation(result, truth):
    """Largest error of a mass or stiffness in its stated standard deviations."""
    frame = result["frame"]
    values = np.array(frame["floor_mass"] + frame["story_stiffness"], dtype=float)
    std = np.array(frame["floor_mass_std"] + frame["story_stiffness_std"], dtype=float)
    exact = np.concatenate([truth["floor_mass"], truth["story_stiffness"]])
    return float(np.nanmax(np.abs(values - exact) / std))


def _run(trial):
    word, result, truth = outcome(trial)
    return trial, word, result["verdict"], deviation(result, truth), [place(item) for item in result["effects"]]


def trials(frames, seed, effects=EFFECTS, configurations=(1, 3), *, spread=True):
    """So many frames for each effect and number of configurations, each with a seed of its own."""
    return [
        Trial(effect, count, seed * 1_000_000 + 10_000 * EFFECTS.index(effect) + 1000 * count + i, spread)
        for count in configurations
        for effect in effects
        for i in range(frames)
    ]


def visible(trial):
    """Whether these tests can show the effect at all."""
    return trial.effect is not None and not (trial.configurations == 1 and trial.effect in HIDDEN)


def print_table(results, effects, configurations):
    print("| configurations | effect | frames | " + " | ".join(OUTCOMES) + " | ambiguous | right, frame within 4 std |")
    print("|" + "---|" * (5 + len(OUTCOMES)))
    for count in configurations:
        for effect in effects:
            mine = [item for item in results if item[0].effect == effect and item[0].configurations == count]
            words = Counter(item[1] for item in mine)
            ambiguous = sum(item[2] == "ambiguous" for item in mine)
            hidden = count == 1 and effect in HIDDEN
            near = "–" if hidden else sum(item[3] < 4 for item in mine if item[1] in ("first", "nothing"))
            cells = [str(words[word]) for word in OUTCOMES]
            print(f"| {count} | {effect or 'none'} | {len(mine)} | {' | '.join(cells)} | {ambiguous} | {near} |")


def print_totals(results):
    several = [word for trial, word, *_ in results if visible(trial) and trial.configurations > 1]
    one = [word for trial, word, *_ in results if visible(trial) and trial.configurations == 1]
    pure = [word for trial, word, *_ in results if not visible(trial)]
    for title, words, right in (
        ("several configurations, the right effect first", several, ("first",)),
        ("one configuration, the right effect first or among the rivals", one, ("first", "rival")),
        ("nothing to be found, and nothing added", pure, ("nothing",)),
    ):
        if words:
            count = sum(word in right for word in words)
            print(f"\n{title}: {count} of {len(words)}, {100 * count / len(words):.1f} %")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--effects", nargs="*", default=None)
    parser.add_argument("--configurations", type=int, nargs="*", default=[1, 3])
    parser.add_argument("--one-floor", action="store_true", help="one counterweight on one floor in each further test")
    parser.add_argument("--failures", action="store_true", help="list every frame whose effect was not named")
    options = parser.parse_args()
    effects = EFFECTS if options.effects is None else [None if name == "none" else name for name in options.effects]
    with ProcessPoolExecutor(options.jobs) as pool:
        results = list(
            pool.map(
                _run,
                trials(options.frames, options.seed, effects, options.configurations, spread=not options.one_floor),
                chunksize=2,
            )
        )
    print_table(results, effects, options.configurations)
    print_totals(results)
    if options.failures:
        for trial, word, verdict, far, found in results:
            if word in ("wrong", "missed") or far > 4:
                print(word, trial, verdict, f"{far:.1f}", found)


if __name__ == "__main__":
    main()
