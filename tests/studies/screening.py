"""Count how often `check` names a mistake correctly, and how often it reports one in a sound file.

python -m tests.studies screening --frames 200 --seed 1 makes 200 frames with each mistake, and five times this number
without one, by the independent finite-element model, and prints the shares. Files with mistakes in masses declare every
floor's mass. Most of these mistakes cause a warning, not a refusal, so they have a separate table.
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


LEAST_MOVED = 0.2
"""Smallest relative error of a wrong floor mass."""


def one_floor_mass(declared, rng):
    """Make one floor's mass a fifth to a half too large or too small."""
    masses = declared["frame"]["floor_masses"]
    place = int(rng.integers(len(masses)))
    masses[place] *= 1.0 + float(rng.uniform(LEAST_MOVED, 0.5)) * float(rng.choice([-1.0, 1.0]))
    return f"floor {place + 1} weighs "


def masses_from_top(declared, rng):
    """List the masses from the top down. Nearly equal masses are skipped: their order has no effect."""
    masses = declared["frame"]["floor_masses"]
    masses.reverse()
    return "" if np.max(np.abs(np.subtract(masses[::-1], masses)) / masses) > LEAST_MOVED else None


def load_elsewhere(declared, rng):
    """Declare the last test's added mass on another floor. The tests have no other difference."""
    for table in declared["configuration"]:
        table["state"] = "as built"
    table = declared["configuration"][-1]
    (place,) = np.flatnonzero(table["added_mass"])
    table["added_mass"] = np.roll(table["added_mass"], int(rng.integers(1, len(table["added_mass"])))).tolist()
    return f"lay on floor {place + 1} and not on"


OF_MASSES = {"floor_mass": one_floor_mass, "masses_from_top": masses_from_top, "added_mass": load_elsewhere}


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
    configurations = int(rng.integers(2 if trial.mistake in ("frequency_unit", *OF_MASSES) else 1, 4))
    declared, truth = simulated(
        trial.effect, stories=stories, configurations=configurations, rng=rng, measured_floors=floors, modes=modes
    )
    if trial.mistake in OF_MASSES:
        del declared["frame"]["total_mass"]
        declared["frame"]["floor_masses"] = truth["floor_mass"].tolist()
    return declared, rng


def outcome(trial):
    """Return the result of the screening: right (alone, or with others), wrong, or silent; flagged for a sound
    frame."""
    declared, rng = tested(trial)
    if trial.mistake is None:
        found = list(screen(Experiment.from_dict(declared)))
        return ("flagged" if any(item.refuses for item in found) else "warned" if found else "silent"), found
    if trial.mistake in OF_MASSES:
        return outcome_of_masses(trial, declared, rng)
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


def outcome_of_masses(trial, declared, rng):
    """Return the result for wrong masses: named alone, named with others, another named, silent, or "like" if no mass
    is wrong."""
    before = screen(Experiment.from_dict(declared))
    if before:
        return "doubted", before
    word = OF_MASSES[trial.mistake](declared, rng)
    found = screen(Experiment.from_dict(declared))
    if word is None:
        return "like", found
    named = [item for item in found if trial.mistake in (item.name, *item.rivals) and word in item.found]
    return ("alone" if len(found) == 1 else "among") if named else "wrong" if found else "silent", found


def trials(frames, seed):
    """Return this number of frames with each mistake, and `CLEAN` times this number without.

    Effects alternate. Files with all floors and modes alternate with incomplete files.
    """
    found = []
    for place, mistake in enumerate((None, *MISTAKES, *OF_MASSES)):
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
    print("\n| wrong masses | frames | named alone | with others | another named | silent | doubted before |")
    print("|---|---|---|---|---|---|---|")
    for mistake in OF_MASSES:
        words = Counter(word for trial, (word, _) in results if trial.mistake == mistake)
        cells = " | ".join(str(words[word]) for word in ("alone", "among", "wrong", "silent", "doubted"))
        print(f"| {mistake} | {words.total() - words['like']} | {cells} |")
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
