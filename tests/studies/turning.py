"""Accuracy of the efficient method on frames whose floors turn: errors over the Cramer-Rao bound, and intervals.

    python -m tests.studies turning [TESTS [FRAMES]]

Random frames (`tests/fe/plan_frames.py`) of two to eight stories are measured in their lowest modes. The bound is
computed here from difference quotients of an eigenvalue problem that is assembled entry by entry.
"""

import sys

import numpy as np
from scipy import linalg

import cvxshear
from tests.fe.plan_frames import random_frame

#: Fewest modes that determine 2 to 8 floors, and three more.
MODES = {2: 6, 3: 9, 4: 10, 5: 12, 6: 12, 7: 13, 8: 15}

NAMES = ("mass", "center", "inertia", "stiffness")


def true_values(frame):
    """Return mass, center of mass and inertia of every floor, and the six entries of every story, shape (N, 10)."""
    stories = np.array([frame.story(story) for story in range(frame.stories)])
    entries = stories[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.column_stack([frame.floor_mass, frame.mass_center, frame.inertia, entries])


def identified_values(found):
    """Return the same of an identified frame."""
    entries = found.story_stiffness[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.column_stack([found.floor_mass, found.mass_center, found.inertia, entries])


def identified_deviations(found):
    """Return its standard deviations."""
    entries = found.story_stiffness_std[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.column_stack([found.floor_mass_std, found.mass_center_std, found.inertia_std, entries])


def readings(values, rows, modes):
    """Return logarithms of frequencies and unscaled readings of the lowest modes of a frame with these values."""
    n = len(values)
    M, K = np.zeros((3 * n, 3 * n)), np.zeros((3 * n, 3 * n))
    for floor, (m, x, y, J, xx, yy, rr, xy, xr, yr) in enumerate(values):
        at, below = slice(3 * floor, 3 * floor + 3), slice(3 * floor - 3, 3 * floor)
        M[at, at] = [[m, 0.0, -m * y], [0.0, m, m * x], [-m * y, m * x, J + m * (x**2 + y**2)]]
        story = np.array([[xx, xy, xr], [xy, yy, yr], [xr, yr, rr]])
        K[at, at] += story
        if floor:
            K[below, below] += story
            K[at, below] -= story
            K[below, at] -= story
    squares, vectors = linalg.eigh(K, M)
    return 0.5 * np.log(squares[:modes]), (rows @ vectors[:, :modes]).T


def bound(frame, modes, std):
    """Compute the Cramer-Rao bound of every value at the true frame with a known total mass, shape (N, 10).

    Entries have the deviation `std` of the largest of their mode, frequencies a fifth of that.
    """
    true = true_values(frame)
    rows = []
    for sensor in frame.sensors():
        angle, place = np.deg2rad(sensor["direction"]), frame.place(sensor["floor"] - 1, *sensor["position"])
        rows.append(np.cos(angle) * place[0] + np.sin(angle) * place[1])
    rows = np.array(rows)
    _, shapes = readings(true, rows, modes)
    size = np.abs(true)
    size[:, 1:3] = max(frame.plan)
    size[:, 7:] = np.max(size[:, 4:7], axis=1, keepdims=True) * [1e-2, 1e-1, 1e-1]
    slopes = []
    for place in range(true.size):
        ends = []
        for sign in (1.0, -1.0):
            moved = true.copy().ravel()
            moved[place] += sign * 1e-6 * size.ravel()[place]
            logs, found = readings(moved.reshape(true.shape), rows, modes)
            # The free scale of each mode: nearest to the true shape.
            found *= (np.sum(found * shapes, axis=1) / np.sum(found**2, axis=1))[:, None]
            unit = found / np.max(np.abs(shapes), axis=1, keepdims=True)
            ends.append(np.concatenate([logs / (0.2 * std), unit.ravel() / std]))
        slopes.append((ends[0] - ends[1]) / 2e-6)
    J = np.array(slopes).T
    total = np.zeros((len(true), 10))
    total[:, 0] = size[:, 0]
    free = linalg.null_space(total.reshape(1, -1))
    covariance = free @ np.linalg.inv((J @ free).T @ (J @ free)) @ free.T
    return np.sqrt(np.diag(covariance)).reshape(true.shape) * size


def one_frame(frame, std, seeds):
    """Return errors over the bound, and errors over their own deviations, both of shape (tests, N, 10)."""
    modes = MODES[frame.stories]
    limit, true = bound(frame, modes, std), true_values(frame)
    of_bound, of_own = [], []
    for seed in seeds:
        found = cvxshear.identify(frame.experiment(modes, std, seed, std=std)).frame
        error = identified_values(found) - true
        of_bound.append(error / limit)
        of_own.append(error / identified_deviations(found))
    return np.array(of_bound), np.array(of_own)


def main(arguments):
    """Print a table: a row a noise, errors over the bound by kind of value, and intervals of 95 % that hold."""
    tests, frames = map(int, (arguments + ["20", "14"][len(arguments) :])[:2])
    print(f"| noise | {' | '.join(NAMES)} | 95 % intervals that hold |")
    print("|---|---|---|---|---|---|")
    for std in (0.002, 0.01):
        found = [one_frame(random_frame(2 + seed % 7, 100 + seed), std, range(tests)) for seed in range(frames)]
        columns = (slice(0, 1), slice(1, 3), slice(3, 4), slice(4, 10))
        squares = [np.concatenate([each[0][:, :, own].ravel() ** 2 for each in found]) for own in columns]
        held = np.concatenate([np.abs(each[1]).ravel() < 1.96 for each in found])
        ratios = " | ".join(f"{np.sqrt(np.mean(each)):.2f}" for each in squares)
        print(f"| {100 * std:g} % | {ratios} | {100 * np.mean(held):.1f} % |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
