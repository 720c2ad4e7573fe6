"""Count the answers of `check` and the loop to well-formed files with wrong content.

`python -m tests.studies semantic --faults 100 --seed 1` puts one fault into the measurement file of each of 100 random
frames. It prints one row per kind of fault with five counts: refused by `check`; questioned (a warning of `check`,
whatever the loop concludes); left open by the loop (ambiguous, located, unexplained); concluded rightly; concluded
wrongly. A wrong conclusion is `explained` or `adequate` with an effect that is absent, or with a mass or a stiffness in
error by more than `SURE` deviations. Faults that no measurement can reveal are listed with the reason.
"""

from __future__ import annotations

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from cvxshear import CvxshearError, Experiment, InputError
from cvxshear.loop.close import search_for_effects
from cvxshear.screening import screen
from tests.fe.experiments import simulated
from tests.screening.mistakes import MISTAKES, with_mistake

SURE = 6.0
"""Limit of an error in standard deviations; a larger error counts as wrong. By chance one value in a thousand million
exceeds it."""

CONCLUDED = ("adequate", "explained")


def too_sure(declared, rng):
    """Make all standard deviations a hundred times too small."""
    for table in declared["configuration"]:
        table["frequency_std"] /= 100
        table["mode_shape_std"] /= 100


def in_percent(declared, rng):
    """Give the standard deviations in percent, a hundred times too large."""
    for table in declared["configuration"]:
        table["frequency_std"] *= 100
        table["mode_shape_std"] = min(100 * table["mode_shape_std"], 0.99)


def forgotten_mass(declared, rng):
    """Leave out the declaration of an added mass."""
    declared["configuration"][-1]["added_mass"] = [0.0] * declared["frame"]["stories"]


def mass_elsewhere(declared, rng):
    """Declare an added mass at another floor."""
    table = declared["configuration"][-1]
    table["added_mass"] = np.roll(table["added_mass"], int(rng.integers(1, len(table["added_mass"])))).tolist()


def mass_in_grams(declared, rng):
    """Declare added masses in grams."""
    for table in declared["configuration"]:
        table["added_mass"] = [1000.0 * value for value in table["added_mass"]]


def mass_in_pounds(declared, rng):
    """Declare added masses in pounds."""
    for table in declared["configuration"]:
        table["added_mass"] = [value / 0.45359237 for value in table["added_mass"]]


def total_in_pounds(declared, rng):
    """Declare the total mass in pounds."""
    declared["frame"]["total_mass"] /= 0.45359237


def total_with_added(declared, rng):
    """Include the added masses in the declared total mass."""
    declared["frame"]["total_mass"] += float(np.sum(declared["configuration"][-1]["added_mass"]))


def heights_added_up(declared, rng):
    """Give heights of the floors above ground instead of story heights."""
    stories = declared["frame"]["stories"]
    heights = np.broadcast_to(declared["frame"].get("story_heights", 0.39), stories)
    declared["frame"]["story_heights"] = np.cumsum(heights).tolist()


def all_in_rad(declared, rng):
    """Give every frequency in rad/s."""
    for table in declared["configuration"]:
        table["frequencies"] = [2 * np.pi * value for value in table["frequencies"]]


def tests_exchanged(declared, rng):
    """Exchange the modes of two tests."""
    first, second = declared["configuration"][0], declared["configuration"][-1]
    for key in ("frequencies", "mode_shapes"):
        first[key], second[key] = second[key], first[key]


def one_frequency(declared, rng):
    """Exchange two digits of one frequency, which changes it by 3 to 30 %."""
    table = declared["configuration"][int(rng.integers(len(declared["configuration"])))]
    at = int(rng.integers(len(table["frequencies"])))
    table["frequencies"][at] *= 1 + float(rng.choice([-1, 1])) * rng.uniform(0.03, 0.1)
    table["frequencies"].sort()


def one_entry(declared, rng):
    """Shift the decimal point of one entry of a shape."""
    table = declared["configuration"][int(rng.integers(len(declared["configuration"])))]
    shapes = table["mode_shapes"]
    row, column = int(rng.integers(len(shapes))), int(rng.integers(len(shapes[0])))
    shapes[row][column] *= float(rng.choice([0.1, 10.0]))


MASS = ("added_mass", "state_mass")
FAULTS = {
    too_sure: (), in_percent: (), forgotten_mass: MASS, mass_elsewhere: MASS, mass_in_grams: MASS,
    mass_in_pounds: (*MASS, "total_mass"), total_in_pounds: ("total_mass",), total_with_added: ("total_mass",),
    heights_added_up: (), all_in_rad: (), tests_exchanged: MASS, one_frequency: (), one_entry: (),
}  # fmt: skip
"""Faults that `tests.screening.mistakes` does not have, each with the effects that are a right answer to it."""

UNTOLD = {
    "all_in_rad": "a frame (2 pi)^2 times as stiff has these modes; masses are right, every stiffness is wrong by that"
}
"""Faults that no measurement can reveal, with the reason."""


def with_fault(number, seed):
    """Return the name of a fault, the dict of a file with this fault, the truth, and the right answers."""
    rng = np.random.default_rng([seed, number])
    kinds = [*FAULTS, *MISTAKES]
    kind = kinds[number % len(kinds)]
    stories, configurations = int(rng.integers(3, 6)), int(rng.integers(2, 4))
    declared, truth = simulated(None, stories=stories, configurations=configurations, rng=rng)
    if isinstance(kind, str):
        return kind, with_mistake(kind, declared, rng)[0], truth, ()
    kind(declared, rng)
    return kind.__name__, declared, truth, FAULTS[kind]


def outcome(task):
    """Return the name of the fault, the outcome for its file, and the answer in words."""
    name, declared, truth, right = with_fault(*task)
    try:
        experiment = Experiment.from_dict(declared)
        findings = screen(experiment)
        if any(item.refuses for item in findings):
            return name, "refused", ""
        result = search_for_effects(experiment)
    except InputError as error:
        return name, "refused", str(error)[:100]
    except CvxshearError as error:
        return name, "no answer", str(error)[:100]
    if result.verdict not in CONCLUDED:
        return name, "asked" if findings else "open", result.verdict
    wrong = [each.placed.label for each in result.effects if each.placed.effect.name not in right]
    frame = result.frame
    for key in ("floor_mass", "story_stiffness"):
        off = np.abs(getattr(frame, key) - truth[key]) / getattr(frame, key + "_std")
        if np.nanmax(off) > SURE:
            wrong.append(f"{key} {np.nanmax(off):.0f} deviations off")
    said = f"{result.verdict}: {', '.join(wrong) or 'right'}; asked: {', '.join(item.name for item in findings)}"
    if not wrong:
        return name, "right", said
    return name, "asked" if findings else "untold" if name in UNTOLD else "WRONG", said


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.studies semantic", description=__doc__)
    parser.add_argument("--faults", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    tasks = [(number, given.seed) for number in range(given.faults)]
    counts, words = {}, ("refused", "asked", "open", "right", "untold", "no answer", "WRONG")
    with ProcessPoolExecutor(given.jobs) as pool:
        for task, (name, what, said) in zip(tasks, pool.map(outcome, tasks), strict=True):
            counts.setdefault(name, Counter())[what] += 1
            if what in ("WRONG", "no answer", "untold"):
                print(f"{what}: {name} (number {task[0]}): {said}", flush=True)
    print("\n| fault | " + " | ".join(words) + " |\n" + "|---" * (len(words) + 1) + "|")
    for name, own in counts.items():
        print(f"| {name} | " + " | ".join(str(own[word]) for word in words) + " |")
    total = sum(counts.values(), Counter())
    print("| all | " + " | ".join(str(total[word]) for word in words) + " |")
    for name, why in UNTOLD.items():
        print(f"no datum tells: {name}: {why}")


if __name__ == "__main__":
    main()
