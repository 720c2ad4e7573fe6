"""Identify badly conditioned frames by the efficient method on every backend, and compare the answers.

`python -m tests.studies hard_frames 100 1` draws 100 frames of 2 to 5 stories, with seed 1 and stiffness ratios of up
to 1e6. Half of the frames also have unequal masses; some have a soft prior of down to 1e-12. The table has the
answers of each backend. Two answers are equal if all masses and stiffnesses agree within `EQUAL` standard deviations
or within rounding.
"""

import sys
from collections import Counter

import numpy as np

from cvxshear import CvxshearError, Experiment, backends, identify
from tests.studies.hard_programs import frame_modes
from tests.studies.timing import table

EQUAL = 0.3
"""Largest difference of equal answers, in standard deviations: fits stop at a chi-square step of 0.1, its square."""

ROUNDING = 1e-6
"""Relative difference due to rounding: the tolerance of the solved steps."""


def drawn(rng):
    """Return the dict of a measurement file of a badly conditioned frame, tested twice, and its true values."""
    n = int(rng.integers(2, 6))
    stiffness = 1e4 * 10.0 ** (rng.uniform(0, 6) * rng.permutation(np.linspace(0, 1, n)))
    mass = 10.0 * 10.0 ** (rng.choice([0.0, rng.uniform(0, 4)]) * rng.uniform(0, 1, n))
    noise = rng.choice([0.01, 1.0])
    tables = []
    for number, added in enumerate((np.zeros(n), mass * (np.arange(n) == rng.integers(n)) * 0.5)):
        eigenvalues, shapes = frame_modes(mass + added, stiffness)
        frequencies = np.sqrt(np.abs(eigenvalues)) / (2 * np.pi)
        tables.append(
            {
                "name": f"test {number + 1}",
                "added_mass": added.tolist(),
                "frequencies": (frequencies * (1 + noise * 1e-3 * rng.standard_normal(n))).tolist(),
                "mode_shapes": (shapes.T + noise * 1e-2 * rng.standard_normal((n, n))).tolist(),
                "frequency_std": noise * 1e-3,
                "mode_shape_std": noise * 1e-2,
            }
        )
    declared = {"frame": {"stories": n, "total_mass": float(mass.sum())}, "configuration": tables}
    if rng.random() < 0.25:
        std = 10.0 ** rng.uniform(-12, -4)
        prior = {"kind": "value", "quantity": "story_stiffness", "at": 1, "value": float(stiffness[0]), "std": std}
        declared["prior"] = [prior]
    return declared, (mass, stiffness)


def answered(declared, backend):
    """Return a backend's result for a measurement, or the reason of its refusal."""
    try:
        return identify(Experiment.from_dict(declared), method="efficient", backend=backend)
    except CvxshearError as error:
        return error


def apart(a, b):
    """Return the largest difference of two frames in standard deviations. Rounding is ignored.

    Returns
    -------
    difference : float
        Infinite if only one of the frames determines a value.
    """
    worst = 0.0
    for key in ("floor_mass", "story_stiffness"):
        x, y = getattr(a.frame, key), getattr(b.frame, key)
        if np.any(np.isnan(x) != np.isnan(y)):
            return np.inf
        off = np.maximum(np.abs(x - y) - ROUNDING * np.maximum(np.abs(x), np.abs(y)), 0.0)
        std = np.fmin(getattr(a.frame, key + "_std"), getattr(b.frame, key + "_std"))
        with np.errstate(divide="ignore", invalid="ignore"):
            worst = max(worst, float(np.nanmax(np.where(off == 0, 0.0, off / std), initial=0.0)))
    return worst


def study(frames, seed, names):
    """Count answers by backend, pairs that differ, and messages of refusals."""
    counts = {name: Counter() for name in names}
    differing, refusals, largest = [], Counter(), 0.0
    for number in range(frames):
        declared, _ = drawn(np.random.default_rng([seed, number]))
        results = {name: answered(declared, name) for name in names}
        given = {name: each for name, each in results.items() if not isinstance(each, CvxshearError)}
        for name, each in results.items():
            refused = name not in given
            stds = [] if refused else [*each.frame.floor_mass_std, *each.frame.story_stiffness_std]
            counts[name]["refused" if refused else "undetermined" if np.any(np.isnan(stds)) else "answered"] += 1
            if refused:
                refusals[str(each).split(": ", 1)[-1][:70]] += 1
        first = next(iter(given), None)
        for name in list(given)[1:]:
            difference = apart(given[first], given[name])
            largest = max(largest, difference)
            if difference > EQUAL:
                counts[name]["differs"] += 1
                reasons = [given[each].parts[0].reason for each in (first, name)]
                differing.append((number, first, name, difference, *reasons))
    return counts, differing, refusals, largest


def main(frames=100, seed=1):
    names = backends.available()
    print(f"{frames} frames, seed {seed}")
    counts, differing, refusals, largest = study(frames, seed, names)
    columns = ("answered", "undetermined", "refused", "differs")
    rows = [[name, *(each[key] for key in columns)] for name, each in counts.items()]
    table("Hard frames", ["backend", *columns], rows)
    print(f"\nlargest difference of two answers: {largest:.1e} standard deviations")
    for line in differing:
        print("  frame {}: {} and {} differ by {:.2g} standard deviations ({}; {})".format(*line))
    for words, count in refusals.most_common():
        print(f"  {count} refused: {words}")


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
