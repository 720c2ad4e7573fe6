"""Count how often `check` names a mistake correctly, and how often it reports one in a sound file.

python -m tests.studies screening --frames 200 --seed 1 makes 200 frames with each mistake, and five times this number
without one, by the independent finite-element model, and prints the shares.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from cvxshear import Experiment
from cvxshear.screening import screen
from tests.fe.experiments import simulated
from tests.screening.mistakes import MISTAKES, WHOLE, with_mistake
from tests.studies.calibration import EFFECTS

CLEAN = 5
"""Number of frames without a mistake, relative to the number with each mistake."""


@dataclass(frozen=True)
class Trial:
    """One random frame: the mistake in its file, its effect, and whether floors and modes are missing."""

    mistake: str | None
    effect: str | None
    incomplete: bool
    seed: int


def tested(trial):
    """Return the dict of a sound measurement file: a random frame with 3 to 8 stories in 1 to 3 configurations."""
    rng = np.random.default_rng(trial.seed)
    stories = int(rng.integers(3, 9))
    floors, modes = None, None
    if trial.incomplete:
        away = int(rng.integers(0, max(stories // 3, 1) + 1))
        floors = sorted((rng.choice(stories, stories - away, replace=False) + 1).tolist())
        modes = stories - int(rng.integers(0 if away else 1, max(stories // 3, 1) + 1))
    # Some mistakes need other configurations for comparison.
    configurations = int(rng.integers(2 if trial.mistake in ("frequency_unit",) else 1, 4))
    declared, _ = simulated(
        trial.effect, stories=stories, configurations=configurations, rng=rng, measured_floors=floors, modes=modes
    )
    return declared, rng


def outcome(trial):
    """Return the result of the screening: right (alone, or with others), wrong, or silent; flagged for a sound
    frame."""
    declared, rng = tested(trial)
    if trial.mistake is None:
        found = list(screen(Experiment.from_dict(declared)))
        return ("flagged" if any(item.refuses for item in found) else "warned" if found else "silent"), found
    declared, where, word = with_mistake(trial.mistake, declared, rng)
    found = [item for item in screen(Experiment.from_dict(declared)) if item.refuses]
    if not found:
        return "silent", found
    if {item.configuration for item in found} != set(where):
        return "wrong", found
    alone = [item.name == trial.mistake and not item.rivals and word in item.change for item in found]
    among = [trial.mistake in (item.name, *item.rivals) and word in item.change for item in found]
    single = [not item.change.startswith("One of") for item in found]
    if all(alone) and all(single):
        return "alone", found
    return ("among" if all(among) else "wrong"), found


def trials(frames, seed):
    """Return this number of frames with each mistake, and `CLEAN` times this number without.

    Effects alternate. Files with all floors and modes alternate with incomplete files.
    """
    found = []
    for place, mistake in enumerate((None, *MISTAKES)):
        for i in range(frames * (CLEAN if mistake is None else 1)):
            effect = EFFECTS[i % len(EFFECTS)]
            # Some mistakes need complete data: only a square matrix can be transposed.
            missing = i // len(EFFECTS) % 2 == 1 and mistake not in WHOLE
            found.append(Trial(mistake, effect, missing, seed * 1_000_000 + 10_000 * place + i))
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--failures", action="store_true", help="list every frame that was judged wrongly")
    options = parser.parse_args()
    planned = trials(options.frames, options.seed)
    with ProcessPoolExecutor(options.jobs) as pool:
        results = list(zip(planned, pool.map(outcome, planned, chunksize=8), strict=True))
    print("| mistake | frames | named alone | named among others | another named | silent | named rightly |")
    print("|---|---|---|---|---|---|---|")
    for mistake in MISTAKES:
        words = Counter(word for trial, (word, _) in results if trial.mistake == mistake)
        total = sum(words.values())
        right = words["alone"] + words["among"]
        cells = " | ".join(str(words[word]) for word in ("alone", "among", "wrong", "silent"))
        print(f"| {mistake} | {total} | {cells} | {100 * right / total:.1f} % |")
    clean = Counter(word for trial, (word, _) in results if trial.mistake is None)
    total = sum(clean.values())
    refused, warned = (f"{clean[word]} ({100 * clean[word] / total:.1f} %)" for word in ("flagged", "warned"))
    print(f"\n{total} frames without a mistake: {refused} refused, {warned} warned of")
    if options.failures:
        for trial, (word, found) in results:
            if word in ("wrong", "flagged", "warned") or (word == "silent" and trial.mistake):
                print(word, trial, *found, sep="\n    ")


if __name__ == "__main__":
    main()
