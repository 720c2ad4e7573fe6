"""Every backend on the programs of frames of growing height, and cvxpy again against cvxpy anew."""

import cvxpy as cp
import numpy as np

from cvxshear import CvxshearError, backends
from cvxshear.backends.cvxpy_backend import Cvxpy
from cvxshear.programs import mass_correction, story_stiffnesses
from cvxshear.programs.mass import normalized
from cvxshear.studies.scaling import exact_experiment
from tests.benchmarks.timing import fastest, shown, table

SIZES = (3, 10, 30, 100)
NOISE = 0.01


def main():
    rows = []
    for kind in ("mass", "bounded mass", "stiffness", "bounded stiffness"):
        columns = [_times(program(kind, stories)) for stories in SIZES]
        rows += [[kind, name, *(_relative(column, name) for column in columns)] for name in backends.available()]
        best = [min((one for one in column if one != "kkt"), key=column.get) for column in columns]
        rows.append([kind, "**fastest but the closed form**", *best])
    table("A backend's time over the closed form's", ["program", "backend", *(f"{n} stories" for n in SIZES)], rows)
    table("cvxpy", ["stories", "built anew", "solved again", "ratio"], [_again(stories) for stories in SIZES])


def program(kind, stories):
    """A program of a frame with noisy modes; the bounded ones hold their largest unknown below what it would be."""
    of, mass, _ = exact_experiment(stories)
    rng = np.random.default_rng(1)
    shapes = of.configurations[0].mode_shapes.T * (1 + NOISE * rng.standard_normal((stories, stories)))
    start = np.full(stories, mass.mean())
    if kind.endswith("mass"):
        made = mass_correction(normalized(shapes, start), start, mass.sum())
    else:
        made = story_stiffnesses(normalized(shapes, mass), (2 * np.pi * of.configurations[0].frequencies) ** 2)
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


def _again(stories):
    of = program("bounded mass", stories)
    backend = Cvxpy("CLARABEL")
    anew, _ = fastest(lambda: built_anew(of), 3)
    again, _ = fastest(lambda: backend.solve(of), 3)
    return stories, shown(anew), shown(again), f"{anew / again:.1f}"


def built_anew(of):
    """What a user would write: the rows as they are, built and compiled for every solve."""
    x = cp.Variable(of.unknowns)
    stated = [] if of.A is None else [of.A @ x == of.b]
    if of.upper is not None:
        places = np.flatnonzero(np.isfinite(of.upper))
        stated += [x[places] <= of.upper[places], x >= of.lower]
    cp.Problem(cp.Minimize(cp.sum_squares(of.R @ x - of.s)), stated).solve(solver="CLARABEL")
    return x.value
