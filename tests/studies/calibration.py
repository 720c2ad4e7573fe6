"""Count how often the loop is right, and test its probabilities, on random frames of the independent finite-element
model.

python -m tests.studies calibration prints every table of docs/calibration.md: the right set by effect and number of
configurations, including pairs of effects; false additions for declared noise and four undeclared ones; reliability of
the probabilities; coverage of the averaged masses and stiffnesses. `python -m tests.studies calibration drawn` prints
the tables for frames drawn from the stated priors and for small effects (`drawn.py`).
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import stats

from cvxshear import Experiment
from cvxshear.loop.close import search_for_effects
from tests.fe.experiments import simulated
from tests.studies import drawn

EFFECTS = (
    None, "gravity", "joint_rotation", "axial_columns", "base_rocking", "ground_spring", "added_mass",
    "mass_coupling", "sensor_gain", "story_change", "wall",
)  # fmt: skip

HIDDEN = ("gravity", "added_mass", "story_change")
"""Effects that one configuration cannot distinguish from changed masses and stiffnesses."""

PAIRS = (
    ("gravity", "joint_rotation"), ("gravity", "sensor_gain"), ("joint_rotation", "added_mass"),
    ("base_rocking", "sensor_gain"), ("ground_spring", "story_change"), ("sensor_gain", "added_mass"),
)  # fmt: skip

HEAVIEST = 6.0
"""Heaviest counterweight on a floor in the second and third test, kg; floors weigh about 10 kg."""

NOISES = {
    "declared": None,
    "0.2 % and 1 %": (0.002, 0.01),
    "1 % and 1 %": (0.01, 0.01),
    "0.2 % and 0.2 %": (0.002, 0.002),
    "0.05 % and 2 %": (0.0005, 0.02),
}
"""True noise of frequencies and of shapes for files that do not declare it."""

BINS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)


@dataclass(frozen=True)
class Trial:
    """One random frame: its effects, its number of configurations, its undeclared noise if any, and its maximum number
    of stories."""

    effects: tuple[str, ...]
    configurations: int
    seed: int
    noise: tuple[float, float] | None = None
    tallest: int = 8


@dataclass(frozen=True)
class Outcome:
    """The loop's result for one frame."""

    trial: Trial
    verdict: str
    wanted: frozenset[tuple]
    found: frozenset[tuple]
    rivals: frozenset[tuple]
    odds: tuple[tuple[float, bool], ...]
    covered: tuple[bool, ...]

    @property
    def word(self) -> str:
        """Classify the answer: exact, extra (additional effects), missed (effects missing), rival (the right set is a
        rival), or wrong."""
        if self.found == self.wanted:
            return "exact"
        if self.found > self.wanted:
            return "extra"
        if self.wanted <= self.found | self.rivals:
            return "rival"
        return "missed" if self.found < self.wanted else "wrong"


WORDS = ("exact", "extra", "rival", "missed", "wrong")


def visible(effects, configurations):
    """Return the effects that these tests can reveal."""
    return tuple(name for name in effects if not (configurations == 1 and name in HIDDEN))


def experiment_of(trial):
    """Return the measurement and the truth."""
    rng = np.random.default_rng(trial.seed)
    stories = int(rng.integers(3, trial.tallest + 1))
    added = np.round(rng.uniform(0.0, HEAVIEST, (trial.configurations, stories)) * 2) / 2
    added[0] = 0.0
    what = (trial.effects or (None,))[0] if len(trial.effects) < 2 else trial.effects
    declared, truth = simulated(
        what, stories=stories, configurations=trial.configurations, rng=rng, added_mass=added.tolist()
    )
    if trial.noise is not None:
        _renoised(declared, truth, trial.noise, rng)
    return declared, truth


def _renoised(declared, truth, noise, rng):
    """Return exact values with another, undeclared noise."""
    for each, frequencies, shapes in zip(
        declared["configuration"], truth["frequencies"], truth["mode_shapes"], strict=True
    ):
        scaled = shapes / np.max(np.abs(shapes), axis=1, keepdims=True)
        each["frequencies"] = (frequencies * np.exp(noise[0] * rng.standard_normal(len(frequencies)))).tolist()
        each["mode_shapes"] = (scaled + noise[1] * rng.standard_normal(scaled.shape)).tolist()
        del each["frequency_std"], each["mode_shape_std"]


def place(item):
    return item["name"], item["floor"], item["to"], item["story"], item["configuration"]


def outcome(trial, close=search_for_effects):
    """Run the loop on a frame and return the outcome."""
    declared, truth = experiment_of(trial)
    result = close(Experiment.from_dict(declared)).to_dict()
    shown = visible(trial.effects, trial.configurations)
    wanted = frozenset(item for item in truth["effects"] if item[0] in shown)
    found = frozenset(place(item) for item in result["effects"])
    rivals = frozenset(place(rival) for item in result["effects"] for rival in item["rivals"])
    there = frozenset(truth["effects"])
    odds = tuple(
        (item["probability"], place(item) in there)
        for item in result["candidates"]
        if item["probability"] >= BINS[0] and item["probability"] > 2.0 * item["prior_probability"]
    )
    averaged = result["averaged"]
    values = np.array(averaged["floor_mass"] + averaged["story_stiffness"], dtype=float)
    std = np.array(averaged["floor_mass_std"] + averaged["story_stiffness_std"], dtype=float)
    exact = np.concatenate([truth["floor_mass"], truth["story_stiffness"]])
    covered = tuple(bool(x) for x in np.abs(values - exact) <= stats.norm.isf(0.025) * std)
    return Outcome(trial, result["verdict"], wanted, found, rivals, odds, covered)


def trials(frames, seed, *, effects=EFFECTS, configurations=(1, 3)):
    """Return this number of frames for each effect and number of configurations, each with its own seed."""
    return [
        Trial((effect,) if effect else (), count, _seed(seed, EFFECTS.index(effect), count, i))
        for count in configurations
        for effect in effects
        for i in range(frames)
    ]


def pairs(frames, seed):
    """Return this number of frames for each pair of effects, in three configurations."""
    return [Trial(pair, 3, _seed(seed, 20 + at, 3, i)) for at, pair in enumerate(PAIRS) for i in range(frames)]


def nothing(frames, seed, *, names=tuple(NOISES), configurations=3):
    """Return pure shear frames for each noise, declared or not."""
    return [
        Trial((), configurations, _seed(seed, 40 + list(NOISES).index(name), configurations, i), NOISES[name])
        for name in names
        for i in range(frames)
    ]


def _seed(seed, kind, configurations, i):
    return seed * 10_000_000 + 100_000 * kind + 10_000 * configurations + i


def run(wanted, jobs):
    """Return the outcomes of many trials, computed in several processes."""
    if jobs == 1:
        return [outcome(trial) for trial in wanted]
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(outcome, wanted, chunksize=2))


def by_kind(results):
    """Group the outcomes by configurations and effects."""
    kinds = dict.fromkeys((item.trial.configurations, item.trial.effects) for item in results)
    return {kind: [r for r in results if (r.trial.configurations, r.trial.effects) == kind] for kind in kinds}


def print_right(results):
    print(f"| configurations | effects | frames | {' | '.join(WORDS)} | explained or adequate |")
    print("|" + "---|" * (4 + len(WORDS)))
    for (count, effects), mine in by_kind(results).items():
        words = Counter(item.word for item in mine)
        sure = sum(item.verdict in ("explained", "adequate") for item in mine)
        label = " and ".join(effects) or "none"
        print(f"| {count} | {label} | {len(mine)} | {' | '.join(str(words[word]) for word in WORDS)} | {sure} |")


def shares(results):
    """Return two shares: the right set, for several configurations; the right set first or among rivals, for one
    configuration."""
    several = [r for r in results if r.trial.configurations > 1 and r.wanted]
    one = [r for r in results if r.trial.configurations == 1 and r.wanted]
    return {
        "three configurations, exactly the right set": (sum(r.word == "exact" for r in several), len(several)),
        "one configuration, the right effect first or among the rivals": (
            sum(r.wanted <= r.found | r.rivals for r in one), len(one),
        ),
    }  # fmt: skip


def reliability(results):
    """Return for each bin of probabilities the number of effects, the number of real ones, and their mean
    probability."""
    odds = [item for r in results for item in r.odds]
    rows = []
    for low, high in pairwise(BINS):
        mine = [(p, there) for p, there in odds if low <= p < high or (high == 1.0 and p >= low)]
        if mine:
            rows.append((low, high, len(mine), sum(there for _, there in mine), float(np.mean([p for p, _ in mine]))))
    return rows


def limits(count, probability, level=0.95):
    """Return the smallest and the greatest count that chance allows at this level."""
    tail = (1.0 - level) / 2
    return int(stats.binom.ppf(tail, count, probability)), int(stats.binom.isf(tail, count, probability))


def print_reliability(results):
    print("\n| named with a probability of | effects | of them there | expected | within chance |")
    print("|---|---|---|---|---|")
    for low, high, count, there, mean in reliability(results):
        least, most = limits(count, mean)
        within = least <= there <= most
        print(f"| {100 * low:g} to {100 * high:g} % | {count} | {there} | {least} to {most} | {within} |")


def coverage(results):
    """Return the share of averaged masses and stiffnesses whose 95 % interval contains the truth."""
    covered = [item for r in results for item in r.covered]
    return sum(covered), len(covered)


def false_additions(results):
    """Return for each noise the number of frames without effects in which the loop added one."""
    rows = {}
    for name, noise in NOISES.items():
        mine = [r for r in results if not r.trial.effects and r.trial.noise == noise]
        if mine:
            rows[name] = (sum(bool(r.found) for r in mine), len(mine))
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="?", choices=["placed", "drawn"], default="placed")
    parser.add_argument("--frames", type=int, default=20, help="for each effect, or kind that is drawn")
    parser.add_argument("--pairs", type=int, default=15, help="frames for each pair of effects")
    parser.add_argument("--nothing", type=int, default=200, help="pure shear frames for each noise")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--failures", action="store_true", help="list every frame that was not exactly right")
    options = parser.parse_args()
    jobs = options.jobs
    if options.part == "drawn":
        wanted = [drawn.Drawn(kind, 1000 * options.seed + i) for i in range(options.frames) for kind in drawn.KINDS]
        drawn.report(drawn.run(wanted, jobs), failures=options.failures)
        return
    results = run([*trials(options.frames, options.seed), *pairs(options.pairs, options.seed)], jobs)
    print_right(results)
    for title, (count, of) in shares(results).items():
        print(f"\n{title}: {count} of {of}, {100 * count / max(of, 1):.1f} %")
    empty = run(nothing(options.nothing, options.seed), jobs)
    print("\n| noise of frequencies and shapes | frames with nothing to find | something added |\n|---|---|---|")
    for name, (count, of) in false_additions(empty).items():
        shown = name if NOISES[name] is None else f"undeclared, {name}"
        print(f"| {shown} | {of} | {count} ({100 * count / of:.1f} %) |")
    print_reliability([*results, *empty])
    held = [r for r in (*results, *empty) if r.trial.configurations > 1]
    count, of = coverage(held)
    part = f"{count} of {of}, {100 * count / of:.1f} %"
    print(f"\naveraged masses and stiffnesses within 1.96 standard deviations: {part}")
    if options.failures:
        for r in (*results, *empty):
            if r.word != "exact":
                print(r.word, r.trial, r.verdict, sorted(r.found, key=str), sorted(r.rivals, key=str), file=sys.stderr)


if __name__ == "__main__":
    main()
