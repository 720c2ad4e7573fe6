"""Make damped frames; integrate their motion independently of the package by a dense pencil and an ODE solver."""

import itertools

import numpy as np
from scipy import integrate, linalg

from tests.frames import chain, modes_of


def damped_frame(stories, seed=0, *, ratio=0.08):
    """Return masses, stiffnesses and coupling story dashpots; `ratio` is near the highest mode's damping ratio."""
    rng = np.random.default_rng(seed)
    mass = rng.uniform(5.0, 10.0, stories)
    stiffness = rng.uniform(2e4, 3e4, stories)
    last = 2 * np.pi * modes_of(mass, stiffness)[0][-1]
    return mass, stiffness, 2 * ratio / last * stiffness * rng.uniform(0.6, 1.4, stories)


def state_space(M, C, K):
    """Return A, B, C, D for inputs of base acceleration and floor forces, and outputs of total accelerations."""
    n = len(M)
    inverse, none = np.linalg.inv(M), np.zeros((n, n))
    rows = -inverse @ np.hstack([K, C])
    A = np.block([[none, np.eye(n)], [rows]])
    B = np.block([[np.zeros((n, 1)), none], [-np.ones((n, 1)), inverse]])
    return A, B, rows, np.hstack([np.zeros((n, 1)), inverse])


def matrices(mass, stiffness, dashpots):
    M, K = chain(mass, stiffness)
    return M, chain(mass, dashpots)[1], K


def pole_ratios(M, C, K):
    """Return damping ratios of the complex modes of s2 M + s C + K by the companion pencil, in order of frequency."""
    n = len(M)
    zero, one = np.zeros((n, n)), np.eye(n)
    values = linalg.eigvals(np.block([[zero, one], [-K, -C]]), np.block([[one, zero], [zero, M]]))
    values = values[values.imag > 0]
    values = values[np.argsort(np.abs(values))]
    return -values.real / np.abs(values)


def integrated(M, C, K, excitation, step, floor=0):
    """Return total accelerations and relative displacements (samples by floors) by Runge-Kutta for each sample."""
    n = len(M)
    inverse = linalg.inv(M)
    load = -np.ones(n) if floor == 0 else inverse[:, floor - 1]

    def slope(t, x, here, rise):
        return np.concatenate([x[n:], load * (here + rise * t) - inverse @ (K @ x[:n] + C @ x[n:])])

    states = [np.zeros(2 * n)]
    for here, after in itertools.pairwise(excitation):
        solved = integrate.solve_ivp(
            slope, (0, step), states[-1], "DOP853", args=(here, (after - here) / step), rtol=1e-12, atol=1e-15
        )
        states.append(solved.y[:, -1])
    states = np.array(states)
    rest = -(states[:, :n] @ K + states[:, n:] @ C) @ inverse
    total = rest if floor == 0 else rest + np.outer(excitation, load)
    return total, states[:, :n]


def shaking(samples=400, step=0.01, seed=4):
    """Return a base acceleration with a corner at each sample, like a record, m/s2."""
    rng = np.random.default_rng(seed)
    envelope = np.sin(np.pi * np.arange(samples) / samples)
    return envelope * np.convolve(rng.standard_normal(samples + 4), np.ones(5) / 5, mode="valid")


def driven(system, excitation):
    """Return the excitation's change of the state in each step, shape (samples, n); the last row is unused."""
    lines = excitation[:, 0]
    return np.outer(lines, system.before) + np.outer(np.roll(lines, -1), system.after)


def straight(excitation):
    """Return an excitation that is linear between its samples, as input of `Dynamics`, shape (samples, 2)."""
    return np.column_stack([excitation, excitation])


def declared(
    mass, stiffness, ratios, *, frequency_std=0.002, shape_std=0.01, ratio_std=0.1, rng=None, modes=None, **more
):
    """Return the dict of a measurement file of all floors: exact, or with noise of the declared deviations."""
    n = len(mass)
    chosen = np.arange(n) if modes is None else np.asarray(modes) - 1
    frequencies, shapes = modes_of(mass, stiffness)
    frequencies, shapes, ratios = frequencies[chosen], shapes[chosen], np.asarray(ratios)[chosen]
    if rng is not None:
        frequencies = frequencies * np.exp(frequency_std * rng.standard_normal(len(chosen)))
        shapes = shapes + shape_std * rng.standard_normal(shapes.shape)
        ratios = ratios * np.exp(ratio_std * rng.standard_normal(len(chosen)))
    configuration = {
        "frequencies": frequencies.tolist(),
        "mode_shapes": shapes.tolist(),
        "modes": (chosen + 1).tolist(),
        "frequency_std": frequency_std,
        "mode_shape_std": shape_std,
        "damping_ratios": ratios.tolist(),
        "damping_ratio_std": ratio_std,
    }
    frame = {"stories": n, "total_mass": float(np.sum(mass)), "story_heights": 3.0}
    return {"frame": frame, "configuration": [configuration], **more}


def damped_measurement(stories, **options):
    """Return the dict of a measurement file of `damped_frame`, with the exact damping ratios."""
    mass, stiffness, dashpots = damped_frame(stories)
    return declared(mass, stiffness, pole_ratios(*matrices(mass, stiffness, dashpots)), **options)


def sampled(frame, function, samples, rng):
    """Evaluate a function at random frames, shape (samples, ...), to check linearized standard deviations."""
    return np.array([function(frame.at(rng.standard_normal(frame.size))) for _ in range(samples)])
