"""1,000 samples of a 20-story frame under a minute of base motion, beside one, and beside one by usual means."""

import time
from functools import partial

import numpy as np
from scipy import signal

from cvxshear.records.motion import Drive
from cvxshear.response import DampedModel, response
from cvxshear.response.batch import batch_peaks
from cvxshear.response.family import Family
from cvxshear.response.handover import state_space
from cvxshear.response.instants import possible_instants
from tests.benchmarks.timing import fastest, shown, table
from tests.response.common import family

STORIES, SAMPLES, RATE, SECONDS = 20, 1000, 100.0, 60.0


def earthquake(seed=6):
    """Filtered noise that rises within some seconds and decays over the rest of the minute."""
    time = np.arange(0, SECONDS, 1 / RATE)
    noise = np.convolve(np.random.default_rng(seed).standard_normal(len(time)), np.ones(6) / 6, mode="same")
    return noise * (time / 4) ** 2 * np.exp(2 - time / 2)


def unrest(seed=6):
    """The same noise at one strength all along, so that a peak can be anywhere."""
    count = int(SECONDS * RATE)
    return np.convolve(np.random.default_rng(seed).standard_normal(count), np.ones(6) / 6, mode="same")


def newmark(M, C, K, excitation, step):
    """Average acceleration, one solve a step with a factor made once."""
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
    A, B, rows, D = state_space(DampedModel(M, C, K, np.ones(len(M)))).values()
    time = step * np.arange(len(excitation))
    _, found, _ = signal.lsim((A, B[:, :1], rows, D[:, :1]), excitation, time)
    return np.abs(found).max(axis=0)


def one(M, C, K, excitation, step):
    found = response(DampedModel(M, C, K, np.ones(len(M))), Drive(excitation), step)
    return np.concatenate([np.abs(found.acceleration).max(axis=0), np.abs(found.drift).max(axis=0)])


def main():
    best = partial(fastest, clock=time.process_time)
    M, C, K = family(SAMPLES, STORIES, 0.004, seed=7, ratio=0.02, ratio_spread=0.1)
    excitation, step = earthquake(), 1 / RATE
    # The batch first: it leaves memory at hand that the single run would otherwise wait for longer than it computes.
    many, found = best(lambda: batch_peaks(M, C, K, Drive(excitation), step), 9)
    alone, single = best(lambda: one(M[0], C[0], K[0], excitation, step), 50)
    steady, _ = best(lambda: batch_peaks(M, C, K, Drive(unrest()), step), 5)
    modal, of_modes = best(lambda: Family.of(M, C, K))
    timing, _ = best(lambda: possible_instants(of_modes, excitation, step))
    looped, each = best(lambda: np.array([one(*abc, excitation, step) for abc in zip(M, C, K, strict=True)]), 1)
    lsim, of_lsim = best(lambda: by_lsim(M[0], C[0], K[0], excitation, step), 3)
    stepped, of_newmark = best(lambda: newmark(M[0], C[0], K[0], excitation, step), 3)
    error = np.max(np.abs(np.hstack(found) / each - 1))
    n = STORIES
    table(
        f"{SAMPLES} samples of {STORIES} stories, {SECONDS:.0f} s at {RATE:.0f} Hz, processor time",
        ["how", "time", "over one of ours", "largest difference"],
        [
            ["one, exact", shown(alone), "1", ""],
            [f"{SAMPLES}, batch", shown(many), f"{many / alone:.0f}", f"{error:.0e}"],
            ["its modes", shown(modal), f"{modal / alone:.0f}", ""],
            ["its samples that can hold a peak", shown(timing), f"{timing / alone:.0f}", ""],
            [f"{SAMPLES}, batch, steady noise", shown(steady), f"{steady / alone:.0f}", ""],
            [f"{SAMPLES}, one after the other", shown(looped), f"{looped / alone:.0f}", ""],
            ["one, scipy.signal.lsim", shown(lsim), f"{lsim / alone:.1f}", f"{_off(of_lsim, single[:n]):.0e}"],
            ["one, Newmark loop", shown(stepped), f"{stepped / alone:.1f}", f"{_off(of_newmark, single[:n]):.0e}"],
        ],
    )
    print(f"\nThe batch takes {many / lsim:.1f} times one by lsim, {many / stepped:.1f} times one by Newmark.")


def _off(found, exact):
    return np.max(np.abs(found / exact - 1))


if __name__ == "__main__":
    main()
