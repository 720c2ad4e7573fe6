"""Time a 20-story frame under base motion: its response beside common methods, reconstruction from four sensors."""

import resource
import time
from functools import partial

import numpy as np
from scipy import signal

from cvxshear import Experiment, backends
from cvxshear.fit.efficient import efficient
from cvxshear.model import modes
from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.response import DampedModel, Fitted, Models, reconstruct, response
from cvxshear.response.uncertain import modal_matrix
from tests.response.common import damped_frame, declared, matrices, state_space
from tests.studies.timing import fastest, shown, table

STORIES, RATE, SECONDS = 20, 100.0, 60.0
RECORD_RATE, RECORD_SECONDS, SENSORS, NOISE, RATIO = 200.0, 300.0, np.array([5, 10, 15, 20]), 0.02, 0.03
"""Settings of the reconstructed record: rate, duration, sensors, noise over rms, and damping ratio of all modes."""


def earthquake(seconds=SECONDS, rate=RATE, seed=6):
    """Return filtered noise that rises within seconds and decays over a minute."""
    time = np.arange(0, seconds, 1 / rate)
    noise = np.convolve(np.random.default_rng(seed).standard_normal(len(time)), np.ones(6) / 6, mode="same")
    return noise * (time / 4) ** 2 * np.exp(2 - time / 2)


def newmark(M, C, K, excitation, step):
    """Integrate by average acceleration, with one solve per step and a single factorization."""
    n = len(M)
    inverse = np.linalg.inv(M + step / 2 * C + step**2 / 4 * K)
    load = -M.sum(axis=1)
    u, v, a = np.zeros(n), np.zeros(n), load / np.diag(M) * excitation[0]
    peak = np.abs(a + excitation[0])
    for p in excitation[1:]:
        u, v = u + step * v + step**2 / 4 * a, v + step / 2 * a
        a = inverse @ (load * p - C @ v - K @ u)
        u, v = u + step**2 / 4 * a, v + step / 2 * a
        peak = np.maximum(peak, np.abs(a + p))
    return peak


def by_lsim(M, C, K, excitation, step):
    A, B, rows, D = state_space(M, C, K)
    time = step * np.arange(len(excitation))
    _, found, _ = signal.lsim((A, B[:, :1], rows, D[:, :1]), excitation, time)
    return np.abs(found).max(axis=0)


def one(M, C, K, excitation, step):
    found = response(DampedModel(M, C, K, np.ones(len(M))), DrivenRun(excitation), step)
    return np.concatenate([np.abs(found.acceleration).max(axis=0), np.abs(found.drift).max(axis=0)])


def main():
    best = partial(fastest, clock=time.process_time)
    M, C, K = matrices(*damped_frame(STORIES, ratio=0.05))
    excitation, step = earthquake(), 1 / RATE
    alone, single = best(lambda: one(M, C, K, excitation, step), 50)
    lsim, of_lsim = best(lambda: by_lsim(M, C, K, excitation, step), 3)
    stepped, of_newmark = best(lambda: newmark(M, C, K, excitation, step), 3)
    n = STORIES
    table(
        f"{STORIES} stories, {SECONDS:.0f} s at {RATE:.0f} Hz, processor time",
        ["how", "time", "over one of ours", "largest difference"],
        [
            ["exact, by a matrix exponential", shown(alone), "1", ""],
            ["scipy.signal.lsim", shown(lsim), f"{lsim / alone:.1f}", f"{_off(of_lsim, single[:n]):.0e}"],
            ["Newmark loop", shown(stepped), f"{stepped / alone:.1f}", f"{_off(of_newmark, single[:n]):.0e}"],
        ],
    )
    reconstruction()


def reconstruction():
    """Print the time of a reconstruction over the time of one simulation of the record, and the peak memory."""
    mass, stiffness, dashpots = damped_frame(STORIES)
    M, _, K = matrices(mass, stiffness, dashpots)
    ratios = np.full(STORIES, RATIO)
    C = modal_matrix(M, modes(M, K), ratios)
    rng, excitation = np.random.default_rng(1), earthquake(RECORD_SECONDS, RECORD_RATE)
    experiment = Experiment.from_dict(declared(mass, stiffness, ratios, rng=rng))
    models = Models(None, Fitted.of(efficient(experiment, backends.get("auto"))))
    lsim, _ = fastest(lambda: by_lsim(M, C, K, excitation, 1 / RECORD_RATE), 1, time.process_time)
    seen = response(DampedModel(M, C, K, np.ones(STORIES)), DrivenRun(excitation), 1 / RECORD_RATE).acceleration
    seen = seen[:, SENSORS - 1]
    seen = seen + NOISE * seen.std(axis=0) * rng.standard_normal(seen.shape)
    motion = DrivenRecord((DrivenRun(excitation, 0, seen),), RECORD_RATE, floors=SENSORS)
    began = time.process_time()
    reconstruct(models, motion)
    taken = time.process_time() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    table(
        f"Reconstruction: {STORIES} stories, {len(SENSORS)} sensors, {RECORD_SECONDS:.0f} s at {RECORD_RATE:.0f} Hz",
        ["processor time", "over scipy.signal.lsim of the same frame and record", "largest memory of the process"],
        [[shown(taken), f"{taken / lsim:.0f}", f"{peak:.0f} MB"]],
    )


def _off(found, exact):
    return np.max(np.abs(found / exact - 1))


if __name__ == "__main__":
    main()
