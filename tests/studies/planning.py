"""Compare plans with exhaustive search, other sensor placements and simulated tests.

`python -m tests.studies planning` prints the figures in docs/theory/planning.md;
`python -m tests.studies planning gap` prints a part of them.
"""

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np

from cvxshear import backends
from cvxshear.fit.efficient import fitted
from cvxshear.fit.misfit import Misfit
from cvxshear.io.toml import parse, read_text
from cvxshear.model import mass_matrix, modes, stiffness_matrix
from cvxshear.planning import Declared, Design, plan, predicted
from cvxshear.planning.choice import CRITERIA, choose, equally_spaced, values_of
from cvxshear.planning.expected_tests import TestModel
from cvxshear.planning.planner import GOALS
from cvxshear.priors import Value

NOISE = Declared(frequency_std=0.002, mode_shape_std=0.02)
MODES = 3
WORSE = 1e-9
OTHERS = ("QR pivoting (PySensors)", "effective independence", "equally spaced")


def random_frame(rng, stories, *, mass_std=0.02, stiffness_std=0.1):
    """Return a frame with stories that soften upwards by half and values that scatter by a quarter."""
    height = np.arange(stories) / stories
    mass = 20e3 * rng.uniform(0.75, 1.25, stories)
    stiffness = 1e8 * (1 - height / 2) * rng.uniform(0.75, 1.25, stories)
    return design_of(mass, stiffness, mass_std, stiffness_std, name=f"{stories} stories")


def design_of(mass, stiffness, mass_std, stiffness_std, frame=None, name="design"):
    """Return a frame with design values of these relative deviations."""
    priors = [
        {"kind": "nominal", "quantity": quantity, "values": list(values), "std": std}
        for quantity, values, std in (("floor_mass", mass, mass_std), ("story_stiffness", stiffness, stiffness_std))
        if values is not None
    ]
    return Design.of_file({"frame": frame or {}, "prior": priors}, name)


def floors_of(design, number, count=MODES, noise=NOISE):
    """Return the floors of a bare frame as sensor candidates, and its mode shapes, one column per mode."""
    model = TestModel(design, GOALS["all"], np.arange(count), noise)
    found = modes(mass_matrix(design.floor_mass), stiffness_matrix(design.story_stiffness))
    return model.sensors([model.expected(np.zeros(design.stories))], number), found.shapes.T


def effective_independence(shapes, number):
    """Choose floors that keep the modes independent (Kammer 1991): repeatedly remove the least useful floor.

    The use of a floor is its diagonal entry of the projector on the remaining shapes, Phi (Phi'Phi)^-1 Phi'. With fewer
    floors than modes, the later modes are omitted.
    """
    shapes = shapes[:, : min(number, shapes.shape[1])]
    left = list(range(len(shapes)))
    while len(left) > number:
        basis, _ = np.linalg.qr(shapes[left])
        del left[int(np.argmin(np.sum(basis**2, axis=1)))]
    return left


def qr_pivots(shapes, number):
    """Return the pivot floors of a QR factorization of the shapes, like PySensors."""
    from pysensors.optimizers import QR  # noqa: PLC0415 - slow, and needed for the comparison alone

    return sorted(int(floor) for floor in QR().fit(shapes).get_sensors()[:number])


def choices_of_others(shapes, number, count=MODES):
    """Return the floors chosen by `OTHERS`, zero-based; QR pivoting gets one mode per sensor."""
    return [
        qr_pivots(shapes[:, : max(count, number)], number),
        effective_independence(shapes[:, :count], number),
        equally_spaced(len(shapes), number),
    ]


def beside_others(frames=100, seed=16, tallest=20):
    """Return the ratio of the others' criterion value to the plan's, for each criterion, shape (frames, 3)."""
    rng = np.random.default_rng(seed)
    ratios = {name: [] for name in CRITERIA}
    for _ in range(frames):
        stories = int(rng.integers(6, tallest + 1))
        number = int(rng.integers(3, max(4, stories // 2) + 1))
        problem, shapes = floors_of(random_frame(rng, stories), number)
        theirs = choices_of_others(shapes, number)
        for name, by in CRITERIA.items():
            own = choose(problem, number, by, enumerate_up_to=0)
            ratios[name].append(values_of(problem, theirs, by) / own.value)
    return {name: np.array(rows) for name, rows in ratios.items()}


def _others():
    print("100 random frames of 6 to 20 stories, 3 modes: standard deviation of the others over the plan's")
    for name, ratio in beside_others().items():
        for other, column in zip(OTHERS, ratio.T, strict=True):
            print(
                f"  {name:5} {other:24} mean {column.mean():.3f}, largest {column.max():.3f}; "
                f"plan worse in {int(np.sum(column < 1 - WORSE))} of {len(column)}"
            )


def gaps(frames=20, seed=16, shortest=3, tallest=40):
    """Yield the gaps on random frames: criterion, noise of the shapes, gap, seconds."""
    rng = np.random.default_rng(seed)
    for _ in range(frames):
        stories = int(rng.integers(shortest, tallest + 1))
        std = float(np.exp(rng.uniform(np.log(0.05), 0.0)))
        design = random_frame(rng, stories, mass_std=std * float(rng.choice([0.2, 1.0])), stiffness_std=std)
        count, number = min(stories, int(rng.integers(2, 6))), int(rng.integers(1, stories + 1))
        noise = float(rng.choice([0.002, 0.005, 0.01, 0.02]))
        problem, _ = floors_of(design, number, count, Declared(0.002, noise))
        for name, by in CRITERIA.items():
            begun = time.process_time()
            found = choose(problem, number, by)
            seconds = time.process_time() - begun
            yield name, noise, found.gap, seconds


def _gap():
    print("20 random frames of 3 to 40 stories, design values to 5 to 100 %, 2 to 5 modes, 1 sensor to all floors")
    rows = list(gaps())
    for name in CRITERIA:
        for low, high in ((0.0, 0.008), (0.008, 1.0)):
            some = [row[1:] for row in rows if row[0] == name and low < row[1] <= high]
            noise, gap, seconds = np.array(some).T
            print(
                f"  {name:5} shapes to {100 * noise.min():g} to {100 * noise.max():g} %, {len(noise)} frames: "
                f"{np.sum(gap > 0.05)} gaps above 5 %, largest {100 * gap.max():.1f} %; "
                f"{seconds.max():.1f} s of the processor at most"
            )


def _exhaustive():
    rng = np.random.default_rng(16)
    print("18 choose 6, five frames: exchange over the best of all 18564, and the bound below it")
    for _ in range(5):
        problem, _ = floors_of(random_frame(rng, 18), 6)
        for name, by in CRITERIA.items():
            found, best = choose(problem, 6, by, enumerate_up_to=0), choose(problem, 6, by, enumerate_up_to=10**9).value
            print(f"  {name:5} {found.value / best:.4f}, bound {100 * (1 - found.bound / best):.1f} % below")


def scatter(planned, samples, seed):
    """Return root mean square errors of masses and stiffnesses in simulated tests over planned deviations, (2N,).

    Design values are drawn too, around the true frame. The ratio of an exactly known value is nan.
    """
    rng, solver = np.random.default_rng(seed), backends.get("auto")
    sizes = planned.model.design.sizes
    exact, errors = predicted(planned), []
    for _ in range(samples):
        test = _noisy_tests(exact, planned.names, rng)
        test = dataclasses.replace(test, priors=tuple(redrawn(each, rng) for each in test.priors))
        errors.append((fitted(Misfit(test, ()), sizes, solver).theta - sizes) / sizes)
    expected = np.concatenate([planned.chosen.floor_mass_std, planned.chosen.story_stiffness_std]) / sizes
    observed = np.sqrt(np.mean(np.square(errors), axis=0))
    return np.where(expected > 1e-9, observed / expected, np.nan)


def redrawn(prior, rng):
    """Return another draw of a prior with the same deviation; an exact prior stays."""
    if prior.std is None:
        return prior
    if isinstance(prior, Value):
        return dataclasses.replace(prior, value=prior.value * (1 + prior.std * rng.standard_normal()))
    return dataclasses.replace(prior, values=prior.values * (1 + prior.std * rng.standard_normal(len(prior.values))))


def _noisy_tests(exact, names, rng):
    return dataclasses.replace(
        exact, configurations=tuple(_noisy(each, rng) if each.name in names else each for each in exact.configurations)
    )


def _noisy(test, rng):
    frequencies = test.frequencies * np.exp(test.log_frequency_std * rng.standard_normal(len(test.frequencies)))
    shapes = test.mode_shapes + test.entry_std * rng.standard_normal(test.mode_shapes.shape)
    return dataclasses.replace(test, frequencies=np.sort(frequencies), mode_shapes=shapes)


def _simulate():
    design = random_frame(np.random.default_rng(16), 6)
    for tests, limit in ((1, None), (2, 5e3)):
        planned = plan(design, 4, tests, modes=MODES, noise=Declared(0.002, 0.01), added_mass=limit)
        ratio = scatter(planned, 500, seed=1)
        print(
            f"500 simulated tests ({tests} each): observed over planned standard deviations "
            f"{np.sqrt(np.nanmean(ratio**2)):.3f} (rms), {np.nanmin(ratio):.3f} to {np.nanmax(ratio):.3f}"
        )


def _e_defense(file):
    if file is None:
        print("the E-Defense frame: name its measurement file with --e-defense")
        return
    declared = parse(read_text(file), file)
    measured = [floor - 1 for floor in declared["configuration"][0]["measured_floors"]]
    design = Design.of_file({key: declared[key] for key in ("frame", "prior")}, file.stem)
    number = len(measured)
    problem, shapes = floors_of(design, number)
    print(f"E-Defense, {design.stories} stories, {MODES} modes, {number} floors, design values: standard deviations")
    for name in CRITERIA:
        by = CRITERIA[name]
        found = choose(problem, number, by)
        theirs = values_of(problem, [measured, *choices_of_others(shapes, number)], by)
        print(
            f"  {name:5} plan {100 * found.value:.2f} % (floors {', '.join(str(j + 1) for j in found.chosen)}); "
            f"as instrumented {100 * theirs[0]:.2f} %; "
            + "; ".join(f"{other} {100 * value:.2f} %" for other, value in zip(OTHERS, theirs[1:], strict=True))
        )


PARTS = {"exhaustive": _exhaustive, "gap": _gap, "others": _others, "simulate": _simulate}


def main(arguments=()):
    """Print the study."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies planning", description=__doc__)
    parser.add_argument("parts", nargs="*", help=", ".join([*PARTS, "e-defense"]))
    parser.add_argument("--e-defense", type=Path, help="measurement file of the E-Defense frame", metavar="TOML")
    chosen = parser.parse_args(arguments)
    for name in chosen.parts or [*PARTS, "e-defense"]:
        if name == "e-defense":
            _e_defense(chosen.e_defense)
        else:
            PARTS[name]()


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
