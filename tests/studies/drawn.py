"""Draw frames from the loop's own priors: simulation-based calibration (Talts et al. 2018).

If causes, sizes and noise come from the stated priors, a probability of 90 % must be right nine times in ten. The rank
of each parameter, the posterior probability below the truth, must be uniform between 0 and 1. The frames are
finite-element ones (`tests/fe`), so the draw contains the cause and not the catalogue's formula. `python -m
tests.studies calibration drawn` prints the tables.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import stats

from cvxshear import Experiment
from cvxshear.effects import Scale, catalogue
from cvxshear.loop.close import search_for_effects
from tests.fe.experiments import FREQUENCY_STD, HEIGHT, MODE_SHAPE_STD, placed_at_random, simulated_as_drawn

KINDS = ("prior", "small")
"""Kinds of frames: everything drawn from the stated priors, or frames in gravity with one additional small effect."""

LEFT_OUT = {
    "attached_mass", "load_mounting", "wrong_prior", "wrong_exact_prior", "total_mass", "floor_mass", "shape_scale",
    "force_scale",
}  # fmt: skip
"""Causes drawn in a special way: an own motion, a prior that no frame here has, a declaration."""

DEFAULTS = (0.002, 0.01)
"""Standard deviations that replace undeclared noise of frequencies and of shapes."""

NOISE_WIDTH = 0.7
"""Stated standard deviation of the logarithm of the factor on these deviations."""

MASS_SPREAD, STIFFNESS_SPREAD = 0.4, 0.7
"""Standard deviations of the logarithms of floor masses and story stiffnesses. The stiffest of five stories is
typically five times stiffer than the softest."""

MOST_DRAWS = 200
"""Maximum number of draws to obtain a stable frame."""

EDGES = (0.0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
"""Limits of the bins in the table of probabilities."""

RANKS = 5
"""Number of bins in a histogram of ranks."""

SMALL = 0.3
"""Size of a small effect, relative to the stated size."""

Place = tuple[str, int | None, int | None, int | None, str | None]


@dataclass(frozen=True)
class Drawn:
    """Settings to draw one frame.

    Parameters
    ----------
    kind : str
        "prior": causes by their stated probabilities, sizes and noise from the stated priors. "small": every frame
        stands in gravity and has one additional effect of 0.3 times its stated size. Both kinds lack some floors and
        modes.
    seed : int
    """

    kind: str
    seed: int


@dataclass(frozen=True)
class Made:
    """Result of the loop for one frame.

    Parameters
    ----------
    drawn : Drawn
    verdict : str
    there : frozenset of place
    probabilities : tuple of (float, float, bool)
        Of each effect at each place, after and before, and whether it is present.
    false : int
        Number of absent effects named with 95 % or more, without twins of present effects.
    missed : int
        Number of present effects that are neither named nor rivals of named ones.
    frame_ranks : tuple of float
        Ranks of the averaged masses and stiffnesses.
    effect_ranks : tuple of (str, float)
        Names and ranks of the sizes of correctly named effects.
    named : tuple
    """

    drawn: Drawn
    verdict: str
    there: frozenset[Place]
    probabilities: tuple[tuple[float, float, bool], ...]
    false: int
    missed: int
    frame_ranks: tuple[float, ...]
    effect_ranks: tuple[tuple[str, float], ...]
    named: tuple[tuple[Place, float], ...]


def size_from_prior(effect, scale, rng):
    """Draw a size from Student's t about the null value within the bounds, or uniformly on the interval."""
    (item, *_), (size, *_) = effect.parameters, effect.expected_sizes(scale)
    while True:
        even = np.isinf(size)
        value = rng.uniform(item.lower, item.upper) if even else item.null + size * rng.standard_t(effect.tail)
        if item.lower < value < item.upper:
            return float(value)


def drawn_frame(drawn):
    """Return the measurement and the truth."""
    rng = np.random.default_rng([drawn.seed, KINDS.index(drawn.kind)])
    for _ in range(MOST_DRAWS):
        try:
            return _drawn_once(drawn.kind, rng)
        except ValueError:
            # The frame buckles, or a sway mode mixes with another motion. Such a frame is not tested.
            continue
    raise RuntimeError("no frame stands")


def _drawn_once(kind, rng):
    stories, configurations = int(rng.integers(3, 6)), 3
    mass = 11.0 * np.exp(MASS_SPREAD * rng.standard_normal(stories))
    stiffness = 24e3 * np.exp(STIFFNESS_SPREAD * rng.standard_normal(stories))
    added = np.round(rng.uniform(0.0, 6.0, (configurations, stories)) * 2) / 2
    added[0] = 0.0
    scale = Scale(float(mass.mean()), float(stiffness.mean()), np.full(stories, HEIGHT))
    causes = [effect for effect in catalogue() if effect.name not in LEFT_OUT]
    if kind == "prior":
        chosen = [effect for effect in causes if rng.random() < effect.probability]
        names = {"", *(effect.name for effect in chosen)}
        chosen = [effect for effect in chosen if effect.beside in names]
    else:
        others = [effect for effect in causes if effect.name != "gravity" and not effect.beside]
        chosen = [effect for effect in causes if effect.name == "gravity"] + [others[int(rng.integers(len(others)))]]
    there = []
    for effect in chosen:
        if effect.name == "gravity" or kind == "prior":
            size = size_from_prior(effect, scale, rng)
        else:
            (item, *_), (usual, *_) = effect.parameters, effect.expected_sizes(scale)
            usual = usual if np.isfinite(usual) else 0.3
            size = float(SMALL * usual * (1 if item.lower >= 0 or rng.random() < 0.5 else -1))
        there.append((effect.name, size, placed_at_random(effect.name, stories, configurations, rng)))
    declared = kind == "small" or rng.random() < 0.5
    noise = (FREQUENCY_STD, MODE_SHAPE_STD)
    if not declared:
        noise = tuple(float(s * np.exp(NOISE_WIDTH * rng.standard_normal())) for s in DEFAULTS)
    floors, modes = list(range(1, stories + 1)), stories
    if rng.random() < 0.4:
        floors.remove(int(rng.integers(1, stories)))
    if rng.random() < 0.4:
        modes -= 1
    off = kind == "prior" and rng.random() < 0.02
    return simulated_as_drawn(
        there, floor_mass=mass, story_stiffness=stiffness, added_mass=added, rng=rng, noise=noise,
        noise_declared=declared, total_mass_error=float(0.1 * rng.standard_t(4)) if off else 0.0,
        measured_floors=floors, modes=modes,
    )  # fmt: skip


def place(item):
    return item["name"], item["floor"], item["to"], item["story"], item["configuration"]


def made(drawn):
    """Run the loop on a drawn frame and return the result."""
    declared, truth = drawn_frame(drawn)
    result = search_for_effects(Experiment.from_dict(declared)).to_dict()
    there = frozenset(truth["effects"])
    probabilities = tuple(
        (item["probability"], item["prior_probability"], place(item) in there) for item in result["candidates"]
    )
    false, seen, ranks = 0, set(), []
    for item in result["effects"]:
        rivals = {place(rival) for rival in item["rivals"]}
        twins = {place(rival) for rival in item["rivals"] if rival["twin"]}
        seen |= {place(item), *rivals}
        if place(item) in there:
            value, std = (next(iter(item[key].values()), None) for key in ("parameters", "std"))
            if value is not None and std:
                rank = stats.norm.cdf((truth["sizes"][place(item)] - value) / std)
                ranks.append((item["name"], float(rank)))
        elif item["probability"] >= 0.95 and not twins & there and result["verdict"] != "unexplained":
            false += 1
    averaged = result["averaged"]
    values = np.array(averaged["floor_mass"] + averaged["story_stiffness"], dtype=float)
    std = np.array(averaged["floor_mass_std"] + averaged["story_stiffness_std"], dtype=float)
    exact = np.concatenate([truth["floor_mass"], truth["story_stiffness"]])
    frame_ranks = tuple(stats.norm.cdf((exact - values) / std).tolist())
    named = tuple((place(item), item["probability"]) for item in result["effects"])
    return Made(
        drawn, result["verdict"], there, probabilities, false, len(there - seen), frame_ranks, tuple(ranks), named
    )


def run(wanted: Sequence[Drawn], jobs: int | None = None) -> list[Made]:
    """Return the loop's results for all frames, computed in several processes."""
    with ProcessPoolExecutor(jobs or os.cpu_count()) as pool:
        return list(pool.map(made, wanted))


def chance(probabilities: Iterable[float], count: int) -> float:
    """Return the probability of a count at least this extreme, twice the smaller tail (Poisson's binomial)."""
    law = np.ones(1)
    for p in probabilities:
        law = np.convolve(law, [1.0 - p, p])
    return float(min(1.0, 2.0 * min(law[: count + 1].sum(), law[count:].sum())))


def print_reliability(results: Sequence[Made]) -> None:
    every = [item for r in results for item in r.probabilities]
    print("\n| probability | effects at places | there | sum of probabilities | chance of such a number |")
    print("|---|---|---|---|---|")
    for low, high in pairwise(EDGES):
        mine = [(p, there) for p, _, there in every if low <= p < high or (high == 1.0 and p >= low)]
        if mine:
            p, count = [each for each, _ in mine], sum(there for _, there in mine)
            cells = f"{100 * low:g} to {100 * high:g} %", len(mine), count, f"{sum(p):.1f}", f"{chance(p, count):.2g}"
            print(f"| {' | '.join(map(str, cells))} |")


def print_ranks(title: str, ranks: Sequence[float]) -> None:
    counts, _ = np.histogram(ranks, RANKS, (0.0, 1.0))
    outside = sum(not 0.025 <= rank <= 0.975 for rank in ranks)
    print(f"| {title} | {' | '.join(map(str, counts))} | {outside} of {len(ranks)} |")


def report(results: Sequence[Made], *, failures: bool = False) -> None:
    """Print every table."""
    print("| frames | number | something false at 95 % | more than three | causes there | missed | verdicts |")
    print("|---|---|---|---|---|---|---|")
    for kind in dict.fromkeys(r.drawn.kind for r in results):
        mine = [r for r in results if r.drawn.kind == kind]
        verdicts = ", ".join(f"{v} {sum(r.verdict == v for r in mine)}" for v in sorted({r.verdict for r in mine}))
        counts = sum(r.false > 0 for r in mine), sum(r.false > 3 for r in mine), sum(len(r.there) for r in mine)
        missed = sum(r.missed for r in mine)
        print(f"| {kind} | {len(mine)} | {' | '.join(map(str, counts))} | {missed} | {verdicts} |")
    prior = [r for r in results if r.drawn.kind == "prior"]
    if prior:
        print_reliability(prior)
    print(f"\n| ranks | {' | '.join(f'{i / RANKS:g} to {(i + 1) / RANKS:g}' for i in range(RANKS))} | outside 95 % |")
    print("|" + "---|" * (RANKS + 2))
    for kind in dict.fromkeys(r.drawn.kind for r in results):
        mine = [r for r in results if r.drawn.kind == kind]
        print_ranks(f"{kind}: masses and stiffnesses", [rank for r in mine for rank in r.frame_ranks])
        named = [item for r in mine for item in r.effect_ranks]
        print_ranks(f"{kind}: gravity's factor", [rank for name, rank in named if name == "gravity"])
        print_ranks(f"{kind}: other effects rightly named", [rank for name, rank in named if name != "gravity"])
    if failures:
        for r in results:
            if r.false or r.missed:
                print(r.drawn, r.verdict, "there", sorted(r.there, key=str), "named", r.named)
