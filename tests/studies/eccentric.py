"""Look for what a symmetric frame lacks: ``python -m tests.studies eccentric [--frames 10] [--seed 1]``.

Frames of nine columns and nine weights a floor (tests/fe/plan_frames.py) are symmetric but for one thing: weights or
columns of one floor, or of all, are moved by 0.1 to 0.3 radii of gyration in x or y. Others lack nothing, or every
column and weight has a size of its own. Then the asymmetric benchmark (tests/fe/space_frames.py), tested before and
after each pattern of damage. Shapes have noise of 1 % of their largest entry, frequencies of 0.2 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import cvxshear
from cvxshear.loop import LoopResult
from tests.fe.plan_frames import PlanFrame, random_frame
from tests.fe.space_frames import SIDE, iasc_asce
from tests.studies.asymmetric import TOTAL_MASS

NOISE = 0.01
SURE = 0.95


@dataclass(frozen=True)
class Moved:
    """What was moved in a frame that is symmetric otherwise."""

    name: str
    level: int | None
    part: str
    distance: float

    def __str__(self) -> str:
        where = "all" if self.level is None else str(self.level)
        return f"{self.name} {where} {self.part} {self.distance:+.3f} m"

    def found(self, result: LoopResult) -> bool:
        """Whether it is named at its place with 95 %, its distance within three deviations."""
        for item in result.effects:
            place = item.placed.place
            here = item.placed.effect.name == self.name and (place.floor or place.story) == self.level
            if here and place.part == self.part and item.probability >= SURE:
                return abs(item.parameters["e"] - self.distance) < 3.0 * (item.std["e"] or 0.0)
        return False


def drawn(seed: int) -> tuple[PlanFrame, Moved]:
    """Draw a frame of two to five stories and what is moved in it."""
    rng = np.random.default_rng([seed, 41])
    frame = random_frame(int(rng.integers(2, 6)), seed, symmetric=True)
    radius = float(np.hypot(*frame.plan) / np.sqrt(12.0))
    name = str(rng.choice(["eccentric_mass", "eccentric_stiffness"]))
    level = None if rng.random() < 0.3 else int(rng.integers(1, frame.stories + 1))
    axis, distance = int(rng.integers(2)), float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.3) * radius)
    members = frame.weights if name == "eccentric_mass" else frame.columns
    for each in members if level is None else [members[level - 1]]:
        each[:, axis] += distance
    return frame, Moved(name, level, ("in x", "in y")[axis], distance)


def tested(frame: PlanFrame, seed: int) -> cvxshear.Experiment:
    """Measure nine modes, or all, with three sensors a floor."""
    return frame.experiment(min(9, 3 * frame.stories), NOISE, seed, std=NOISE)


def named(result: LoopResult) -> str:
    """Write the verdict and what was named, with its probability."""
    said = [f"{item.size} ({100 * item.probability:.1f} %)" for item in result.effects]
    return f"{result.verdict}: {'; '.join(said) or 'nothing'}"


def sure(result: LoopResult) -> list[str]:
    """List the names of causes with 95 % or more; an open class is no cause."""
    return [
        item.placed.effect.name
        for item in result.effects
        if item.probability >= SURE and item.placed.effect.kind == "cause"
    ]


def damaged(pattern: int, *, rigid: bool, seed: int = 0) -> LoopResult:
    """Close the loop on the benchmark before and after a pattern, case 4 (`rigid`) or 5."""
    states = [
        iasc_asce(number, rigid=rigid)
        .experiment((2 * SIDE, 2 * SIDE), NOISE, [seed, number], total_mass=TOTAL_MASS)
        .to_dict()
        for number in (0, pattern)
    ]
    tests = [each["configuration"][0] | {"name": name} for each, name in zip(states, ("before", "after"), strict=True)]
    frame = states[0]["frame"] | {"reference": "before", "plan": [2 * SIDE, 2 * SIDE], "plan_std": 0.2}
    return cvxshear.close_loop({"frame": frame, "configuration": tests})


def lines(frames: int, seed: int) -> Iterator[str]:
    """Yield a line for each frame, and the counts."""
    right = false = 0
    for number in range(seed, seed + frames):
        frame, moved = drawn(number)
        result = cvxshear.close_loop(tested(frame, number))
        right += moved.found(result)
        false += len(sure(result)) > moved.found(result)
        yield f"{frame.stories} stories, {moved} | {named(result)}"
    yield f"found at its place with its size: {right} of {frames}; with a false cause: {false}"
    for kind, symmetric in (("symmetric", True), ("every column and weight of its own", False)):
        false = 0
        for number in range(seed, seed + frames):
            frame = random_frame(2 + number % 4, number, symmetric=symmetric)
            result = cvxshear.close_loop(tested(frame, number))
            false += bool(sure(result))
            yield f"{frame.stories} stories, {kind} | {named(result)}"
        yield f"{kind}: a cause with 95 % in {false} of {frames}"


def main() -> None:
    """Print the drawn frames, then both cases of the benchmark."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for line in lines(options.frames, options.seed):
        print(line, flush=True)
    for rigid in (True, False):
        for pattern in range(1, 7):
            print(f"case {4 if rigid else 5}, pattern {pattern} | {named(damaged(pattern, rigid=rigid))}", flush=True)


if __name__ == "__main__":
    main()
