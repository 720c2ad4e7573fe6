"""Plans held against exhaustive search, other ways of placing sensors, and simulated tests.

`python -m cvxshear.planning.study` prints the figures in docs/theory/planning.md; with the name of a part, that part.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from cvxshear.files.toml import parse, read_text
from cvxshear.model.shear import mass_matrix, modes, stiffness_matrix
from cvxshear.planning.candidates import Candidates
from cvxshear.planning.choice import choose, exhaustive, values_of
from cvxshear.planning.criteria import CRITERIA
from cvxshear.planning.design import Design
from cvxshear.planning.model import TestModel
from cvxshear.planning.noise import Declared
from cvxshear.planning.others import effective_independence, equally_spaced, qr_pivots
from cvxshear.planning.planner import GOALS, plan
from cvxshear.planning.simulation import right_verdicts, scatter
from cvxshear.util.typing import Floats

NOISE = Declared(frequency_std=0.002, mode_shape_std=0.02)
MODES = 3
WORSE = 1e-9
OTHERS = ("QR pivoting (PySensors)", "effective independence", "equally spaced")


def random_frame(
    rng: np.random.Generator, stories: int, *, mass_std: float = 0.02, stiffness_std: float = 0.1
) -> Design:
    """A frame whose stories soften upwards by half, its values scattered by a quarter.

    Parameters
    ----------
    rng : Generator
    stories : int
    mass_std, stiffness_std : float, optional
        How sure the design values are, relative.
    """
    height = np.arange(stories) / stories
    mass = 20e3 * rng.uniform(0.75, 1.25, stories)
    stiffness = 1e8 * (1 - height / 2) * rng.uniform(0.75, 1.25, stories)
    return Design.of_file(
        {"prior": [_nominal("floor_mass", mass, mass_std), _nominal("story_stiffness", stiffness, stiffness_std)]},
        f"{stories} stories",
    )


def _nominal(quantity: str, values: Floats, std: float) -> dict[str, object]:
    return {"kind": "nominal", "quantity": quantity, "values": values.tolist(), "std": std}


def floors_of(design: Design, number: int, count: int = MODES, noise: Declared = NOISE) -> tuple[Candidates, Floats]:
    """The floors of a bare frame as candidates, and its mode shapes, all of them, one column a mode.

    Parameters
    ----------
    design : Design
    number : int
        Of sensors.
    count : int, optional
        Of modes.
    noise : Declared, optional
    """
    model = TestModel(design, (), GOALS["all"], np.arange(count), noise)
    found = modes(mass_matrix(design.floor_mass), stiffness_matrix(design.story_stiffness))
    return model.sensors([model.expected(np.zeros(design.stories))], number), found.shapes.T


def choices_of_others(shapes: Floats, number: int, count: int = MODES) -> list[list[int]]:
    """The floors that `OTHERS` choose, zero-based; QR pivoting gets as many modes as it places sensors."""
    return [
        qr_pivots(shapes[:, : max(count, number)], number),
        effective_independence(shapes[:, :count], number),
        equally_spaced(len(shapes), number),
    ]


def beside_others(frames: int = 100, seed: int = 16, tallest: int = 20) -> dict[str, Floats]:
    """For each criterion, what the others' choices give over what the plan's gives, shape (frames, 3).

    Parameters
    ----------
    frames, seed : int, optional
    tallest : int, optional
        Stories at most; six at least.
    """
    rng = np.random.default_rng(seed)
    ratios: dict[str, list[Floats]] = {name: [] for name in CRITERIA}
    for _ in range(frames):
        stories = int(rng.integers(6, tallest + 1))
        number = int(rng.integers(3, max(4, stories // 2) + 1))
        of, shapes = floors_of(random_frame(rng, stories), number)
        theirs = choices_of_others(shapes, number)
        for name, by in CRITERIA.items():
            own = choose(of, number, by, enumerate_up_to=0, widths=())
            ratios[name].append(values_of(of, theirs, by) / own.value)
    return {name: np.array(rows) for name, rows in ratios.items()}


def _others() -> None:
    print("100 random frames of 6 to 20 stories, 3 modes: standard deviation of the others over the plan's")
    for name, ratio in beside_others().items():
        for other, column in zip(OTHERS, ratio.T, strict=True):
            print(
                f"  {name:5} {other:24} mean {column.mean():.3f}, largest {column.max():.3f}; "
                f"plan worse in {int(np.sum(column < 1 - WORSE))} of {len(column)}"
            )


def gaps(
    frames: int = 60, seed: int = 16, shortest: int = 3, tallest: int = 40
) -> Iterator[tuple[str, float, float, float, float]]:
    """Random frames, how sure their design values are, sensors, modes and noise: what the bounds leave open.

    Parameters
    ----------
    frames, seed : int, optional
    shortest, tallest : int, optional
        Stories.

    Yields
    ------
    criterion : str
    noise : float
        Standard deviation of a shape's entry.
    before, after : float
        Gap with the convex program's bound alone, and as the plan has it.
    seconds : float
        Of the processor.
    """
    rng = np.random.default_rng(seed)
    for _ in range(frames):
        stories = int(rng.integers(shortest, tallest + 1))
        std = float(np.exp(rng.uniform(np.log(0.05), 0.0)))
        design = random_frame(rng, stories, mass_std=std * float(rng.choice([0.2, 1.0])), stiffness_std=std)
        count, number = min(stories, int(rng.integers(2, 6))), int(rng.integers(1, stories + 1))
        noise = float(rng.choice([0.002, 0.005, 0.01, 0.02]))
        of, _ = floors_of(design, number, count, Declared(0.002, noise))
        for name, by in CRITERIA.items():
            begun = time.process_time()
            found = choose(of, number, by)
            yield name, noise, found.value / found.program - 1, found.gap, time.process_time() - begun


def _gap() -> None:
    print("60 random frames of 3 to 40 stories, design values to 5 to 100 %, 2 to 5 modes, 1 sensor to all floors")
    rows = list(gaps())
    for name in CRITERIA:
        for low, high in ((0.0, 0.008), (0.008, 1.0)):
            some = [row[1:] for row in rows if row[0] == name and low < row[1] <= high]
            noise, before, after, seconds = np.array(some).T
            print(
                f"  {name:5} shapes to {100 * noise.min():g} to {100 * noise.max():g} %, {len(noise)} frames: program "
                f"alone {np.sum(before > 0.05)} above 5 %, largest {100 * before.max():.1f} %; with windows "
                f"{np.sum(after > 0.05)} above 5 %, largest {100 * after.max():.1f} %; "
                f"{seconds.max():.1f} s of the processor at most"
            )


def _exhaustive() -> None:
    rng = np.random.default_rng(16)
    print("18 choose 6, five frames: exchange over the best of all 18564, and the bound below it")
    for _ in range(5):
        of, _ = floors_of(random_frame(rng, 18), 6)
        for name, by in CRITERIA.items():
            found, (best, _) = choose(of, 6, by, enumerate_up_to=0), exhaustive(of, 6, by)
            print(f"  {name:5} {found.value / best:.4f}, bound {100 * (1 - found.bound / best):.1f} % below")


def _simulate() -> None:
    design = random_frame(np.random.default_rng(16), 6)
    for tests, limit in ((1, None), (2, 5e3)):
        planned = plan(design, 4, tests, modes=MODES, noise=Declared(0.002, 0.01), added_mass=limit)
        seen = scatter(planned, 500, seed=1)
        ratio = seen.observed / seen.expected
        print(
            f"500 simulated tests ({tests} each): observed over planned standard deviations {seen.ratio:.3f} (rms), "
            f"{np.nanmin(ratio):.3f} to {np.nanmax(ratio):.3f}"
        )
    told = plan(_three_stories(), goal="joint_rotation=0.05,ground_spring@3=10", modes=3, noise=Declared(0.001, 0.005))
    seen_right = right_verdicts(told, 200, seed=1)
    for each in told.apart[1:]:
        print(f"right verdict for {each.label}: planned {each.probability:.2f}, of 200 {seen_right[each.label]:.2f}")


def _three_stories() -> Design:
    """The paper's frame of section 5, its design values good to 2 and 5 %."""
    mass, stiffness = np.array([10.0, 7.5, 5.0]), np.array([1800.0, 1200.0, 600.0])
    return Design.of_file(
        {
            "frame": {"story_heights": 1.0},
            "prior": [_nominal("floor_mass", mass, 0.02), _nominal("story_stiffness", stiffness, 0.05)],
        },
        "three stories",
    )


def _paper() -> None:
    print("the paper's frame, frequencies to 0.2 %, shapes to 1 %: gravity from none, standard deviations")
    rows = [("the paper's three structures", plan("paper", tests="declared", goal="gravity"))]
    for mass in (5.0, 10.0, 20.0, 41.0):
        for tests in (1, 2):
            planned = plan("paper", tests=tests, goal="gravity", fresh=True, added_mass=mass)
            rows.append((f"{tests} test{'s' * (tests > 1)}, up to {mass:g} kg a floor", planned))
    for std in (0.02, 0.05):
        planned = plan(paper_design(std), tests=1, goal="gravity", added_mass=41.0)
        rows.append((f"1 test, up to 41 kg a floor, design stiffness to {100 * std:g} %", planned))
    for name, planned in rows:
        found = planned.apart[1]
        masses = "; ".join(str(test.tolist()) for test in planned.tests)
        print(f"  {name}: {found.distance:.1f}, right verdict {100 * found.probability:.0f} %, kg {masses}")


def paper_design(stiffness_std: float) -> Design:
    """The paper's frame of section 6 before any test: story stiffness 26.67 kN/m from its columns' dimensions."""
    return Design.of_file(
        {
            "frame": {"story_heights": 0.39, "total_mass": 31.33},
            "prior": [_nominal("story_stiffness", np.full(2, 26.67e3), stiffness_std)],
        },
        "paper, as designed",
    )


def _e_defense(file: Path | None) -> None:
    if file is None:
        print("the E-Defense frame: name its measurement file with --e-defense")
        return
    declared = parse(read_text(file), file)
    measured = [floor - 1 for floor in declared["configuration"][0]["measured_floors"]]  # type: ignore[index]
    design = Design.of_file({key: declared[key] for key in ("frame", "prior")}, file.stem)
    number = len(measured)
    of, shapes = floors_of(design, number)
    print(f"E-Defense, {design.stories} stories, {MODES} modes, {number} floors, design values: standard deviations")
    for name, by in CRITERIA.items():
        found = choose(of, number, by)
        theirs = values_of(of, [measured, *choices_of_others(shapes, number)], by)
        print(
            f"  {name:5} plan {100 * found.value:.2f} % (floors {', '.join(str(j + 1) for j in found.chosen)}); "
            f"as instrumented {100 * theirs[0]:.2f} %; "
            + "; ".join(f"{other} {100 * value:.2f} %" for other, value in zip(OTHERS, theirs[1:], strict=True))
        )


def main() -> None:
    """Print the study."""
    parts: dict[str, Callable[[], None]] = {
        "exhaustive": _exhaustive, "gap": _gap, "others": _others, "simulate": _simulate, "paper": _paper,
    }  # fmt: skip
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*parts, "e-defense"], default=[*parts, "e-defense"])
    parser.add_argument("--e-defense", type=Path, help="measurement file of the E-Defense frame", metavar="TOML")
    chosen = parser.parse_args()
    for name in chosen.parts:
        if name == "e-defense":
            _e_defense(chosen.e_defense)
        else:
            parts[name]()


if __name__ == "__main__":
    main()
