"""Time batches of identifications, parallel processes, and larger problems."""

import time

import numpy as np

from cvxshear import Experiment, identify
from cvxshear.paper.scatter import one_shot_batch, two_stage_batch
from cvxshear.paper.setups import three_story
from cvxshear.util.parallel import each
from tests.frames import configuration, experiment
from tests.studies.timing import fastest, shown, table

SAMPLES = 100_000


def main():
    table(
        f"{SAMPLES:,} samples of the noise study at 5 %",
        ["method", "batch", "a sample", "`identify` one at a time", "ratio"],
        [_batch("two-stage", two_stage_batch), _batch("one-shot", one_shot_batch)],
    )
    table("Efficient method, 200 samples", ["processes", "time", "ratio"], _processes())
    table("Larger problems", ["what", "time", "outcome"], _fits())


def _batch(method, batch):
    setup = three_story(0.05)
    frequencies, shapes = setup.draw(np.random.default_rng(1), SAMPLES)
    began = time.perf_counter()
    batch(shapes, frequencies, 22.5)
    together = time.perf_counter() - began
    alone, _ = fastest(lambda: [identify(setup.experiment(frequencies[i], shapes[i]), method) for i in range(30)], 3)
    ratio = (alone / 30) / (together / SAMPLES)
    return method, shown(together), shown(together / SAMPLES), shown(alone / 30), f"{ratio:.0f}"


def _processes():
    setup = three_story(0.05)
    frequencies, shapes = setup.draw(np.random.default_rng(1), 200)
    samples = [setup.experiment(*pair) for pair in zip(frequencies, shapes, strict=True)]
    each(identify, samples[:4], jobs=2)  # start the processes, which stay
    one, two = (fastest(lambda jobs=jobs: each(identify, samples, jobs=jobs), 2)[0] for jobs in (1, 2))
    return [[1, shown(one), "1"], [2, shown(two), f"{one / two:.1f}"]]


def _fits():
    """Time the fits of a tall frame: the lowest fifth of modes at a quarter of the floors, with and without priors."""
    rng = np.random.default_rng(3)
    n = 100
    mass, stiffness = np.linspace(3e4, 2e4, n), np.linspace(8e8, 3e8, n)
    test = configuration(
        mass, stiffness, rng=rng, shape_noise=0.01, frequency_noise=0.001, modes=list(range(1, 21)),
        measured_floors=list(range(4, n + 1, 4)),
    )  # fmt: skip
    design = [
        {"kind": "nominal", "quantity": name, "values": (true * rng.uniform(1 - s, 1 + s, n)).tolist(), "std": s}
        for name, true, s in (("floor_mass", mass, 0.05), ("story_stiffness", stiffness, 0.1))
    ]
    for prior, said in ((design, "design values within 5 and 10 %"), ([], "no design values")):
        of = Experiment.from_dict(experiment(mass, stiffness, test, prior=prior))
        seconds, found = fastest(lambda of=of: identify(of), 1)
        outcome = f"chi-square {found.fit.chi2:.0f} at {found.fit.dof} degrees of freedom"
        if found.undetermined:
            outcome += f", {len(found.undetermined)} directions undetermined"
        yield f"efficient fit, 100 stories, 20 modes at 25 floors, {said}", shown(seconds), outcome
