"""Provide designs for the planning tests, and an independent computation of their information."""

from itertools import combinations

import numpy as np

from cvxshear.planning.design import Design
from cvxshear.planning.expected_tests import Declared, TestModel
from tests.frames import modes_of

NOISE = Declared(frequency_std=0.002, mode_shape_std=0.02)


def design(mass, stiffness, *, mass_std=0.02, stiffness_std=0.1, frame=None):
    priors = [
        {"kind": "nominal", "quantity": "floor_mass", "values": list(mass), "std": mass_std},
        {"kind": "nominal", "quantity": "story_stiffness", "values": list(stiffness), "std": stiffness_std},
    ]
    return Design.of_file({"frame": frame or {}, "prior": priors}, "test")


def tapered(stories, **keys):
    """Return a frame with stories that soften upwards and unequal floors."""
    rng = np.random.default_rng(stories)
    mass = 2e4 * rng.uniform(0.8, 1.2, stories)
    stiffness = 1e8 * np.linspace(1.5, 0.8, stories) * rng.uniform(0.8, 1.2, stories)
    return design(mass, stiffness, **keys)


def frame_model(of, modes=3, noise=NOISE, quantities=("floor_mass", "story_stiffness")):
    return TestModel(of, quantities, np.arange(modes), noise)


def information_of(of, chosen):
    """Return the information of the chosen candidates."""
    return of.information(np.isin(np.arange(of.count), chosen).astype(float))


def exhaustive(of, number, by):
    """Return the best value of all choices of `number` candidates, evaluated one by one, and the best choice."""
    every = [list(each) for each in combinations(range(of.count), number)]
    values = [float(by.value(of, information_of(of, each))) for each in every]
    return min(values), every[int(np.argmin(values))]


def log_data(sizes, added, floors, modes):
    """Return log frequencies and shapes at some floors, each with unit modal mass, without the free scales."""
    n = len(sizes) // 2
    frequencies, shapes = modes_of(sizes[:n] + added, sizes[n:])
    return np.log(frequencies[:modes]), shapes[:modes][:, floors]


def slow_covariance(of, added, floors, modes, noise, *, mass_std, stiffness_std):
    """Return the covariance of relative masses and stiffnesses by central differences; each shape has a free scale."""
    n, sizes = of.stories, of.sizes
    rows = [np.diag(1.0 / np.concatenate([np.full(n, mass_std), np.full(n, stiffness_std)]))]
    scales = np.zeros((2 * n, len(added) * modes))
    blocks = [np.hstack([rows[0], scales])]
    for t, masses in enumerate(added):
        step = 1e-5
        moved = [
            [log_data(sizes * (1 + sign * step * unit), masses, floors, modes) for sign in (1, -1)]
            for unit in np.eye(2 * n)
        ]
        frequency = np.array([(up[0] - down[0]) / (2 * step) for up, down in moved]).T
        shape = np.array([(up[1] - down[1]) / (2 * step) for up, down in moved])
        here = log_data(sizes, masses, np.arange(n), modes)[1][:, floors]
        wide = np.zeros((modes, len(added) * modes))
        blocks.append(np.hstack([frequency / noise.frequency_std, wide]))
        for mode in range(modes):
            column = np.zeros((len(floors), len(added) * modes))
            column[:, t * modes + mode] = here[mode]
            blocks.append(np.hstack([shape[:, mode].T, column]) / noise.mode_shape_std)
    J = np.vstack(blocks)
    return np.linalg.inv(J.T @ J)[: 2 * n, : 2 * n]
