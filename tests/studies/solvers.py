"""Time every backend on programs of growing frames; processor time."""

import time
from functools import partial

import numpy as np

from cvxshear import CvxshearError, backends
from cvxshear.programs.formulations import mass_rows, normalized, stiffness_rows
from tests.studies.scaling import exact_experiment
from tests.studies.timing import fastest as fastest_by_clock
from tests.studies.timing import table

fastest = partial(fastest_by_clock, clock=time.process_time)

SIZES = (3, 10, 30, 100)
NOISE = 0.01
BOUNDED = ("bounded mass", "bounded stiffness")


def main():
    rows = []
    for kind in ("mass", "stiffness", *BOUNDED):
        columns = [_times(program(kind, stories)) for stories in SIZES]
        rows += [[kind, name, *(_relative(column, name) for column in columns)] for name in backends.available()]
        best = [min((one for one in column if one != "kkt"), key=column.get) for column in columns]
        rows.append([kind, "**fastest but the closed form**", *best])
    table("A backend's time over the closed form's", ["program", "backend", *(f"{n} stories" for n in SIZES)], rows)


def program(kind, stories):
    """Return a program of a frame with noisy modes; bounded kinds limit the largest unknown to 0.9 of its value."""
    of, mass, _ = exact_experiment(stories)
    rng = np.random.default_rng(1)
    shapes = of.configurations[0].mode_shapes.T * (1 + NOISE * rng.standard_normal((stories, stories)))
    start = np.full(stories, mass.mean())
    if kind.endswith("mass"):
        made = mass_rows(normalized(shapes, start), start, mass.sum())
    else:
        made = stiffness_rows(normalized(shapes, mass), (2 * np.pi * of.configurations[0].frequencies) ** 2)
    if not kind.startswith("bounded"):
        return made
    free = backends.get("kkt").solve(made).x
    upper = np.full(stories, np.inf)
    upper[np.argmax(free)] = 0.9 * free.max()
    return made.replace(lower=np.full(stories, -10 * np.abs(free).max()), upper=upper)


def _times(of):
    times = {"kkt": fastest(lambda: backends.get("kkt").solve(of.replace(lower=None, upper=None)))[0]}
    for name in backends.available():
        if name != "kkt":
            try:
                times[name] = fastest(lambda name=name: backends.get(name).solve(of), 3)[0]
            except CvxshearError:
                times[name] = float("inf")
    return times


def _relative(times, name):
    return f"{times[name] / times['kkt']:.1f}" if np.isfinite(times[name]) else "not solved"
