"""Reconstruct drifts of floors without sensors: `python -m tests.studies reconstruction [TRIALS [JOBS [FINER]]]`.

The frames are independent of the package: finite-element frames (tests/fe) with damped sway modes, driven by filtered
noise with an envelope through scipy's `lsim`. Each sound frame is tested first (noisy modes). In the record, one story
is 10 % softer; or the frame is the same; or its beams bend but the model is a plain shear frame; or a third of one
story's stiffness yields at half of its elastic peak drift. A third of the floors carry sensors with noise of 1 to 5 %
of their rms. The study compares the peak drifts by prediction, by smoothing with the identified frame, and by
reconstruction. The table also has the share of true peaks and of true drifts over time within 1.96 stated deviations.
With FINER = 8, the ground moves like the band-limited motion through its samples, in steps eight times finer; without
FINER, linearly between the samples. The study skips refits without single sensors: they can only widen the bands.
"""

from __future__ import annotations

import sys
import warnings
from functools import partial

import numpy as np
from scipy import signal

import cvxshear
from cvxshear import backends
from cvxshear.fit.efficient import efficient
from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.response import Fitted, Models, reconstruct
from cvxshear.util.parallel import each
from tests.fe.frame import Building, sway_modes

STORIES = (3, 8, 20)
CASES = ("soft", "sound", "beams", "yields")
RATE = 100.0
SECONDS = 40.0
RATIO = 0.02
RECORDED_RATIO = 0.03
"""Damping ratio of every mode in the modal test, and in the record: damping grows with the amplitude."""
YIELDING, YIELDS_AT = 0.3, 0.5
"""Elastic-plastic part of a story's stiffness, and its yield drift relative to the elastic peak."""
STEPS = 20
"""Steps per sample for the frame that yields."""
FINER_PEAKS = 16
"""Points per sample in the search for the true peaks."""
NORMAL_95 = 1.959964


def sensors(stories):
    """Return the sensor floors: a third of the floors, with the top."""
    return np.unique(np.linspace(stories, 1, max(2, round(stories / 3))).round().astype(int))


def building(stories, case, seed):
    """Return the sound frame, the frame in the record, and the softer story (from 1; 0 without a softer story)."""
    rng = np.random.default_rng([1, seed, stories])
    mass = 2e5 * np.exp(0.1 * rng.standard_normal(stories))
    shape = np.linspace(1.0, 0.4, stories) * np.exp(0.1 * rng.standard_normal(stories))
    heights = np.full(stories, 3.5)
    # Typical of buildings: a frequency of about ten stories per second.
    stiffness = shape * 2e5 * (2 * np.pi * 10 / stories) ** 2 * (stories * 0.6) ** 2
    bending = None
    if case == "beams":
        bending = 0.6 * stiffness * heights**3 / 12 * 20
    soft = int(rng.integers(1, stories + 1)) if case in ("soft", "yields") else 0
    softer = stiffness.copy()
    if case == "soft":
        softer[soft - 1] *= 0.9
    made = [Building(heights, k, mass, column_x=(0.0, 6.0), beam_bending=bending) for k in (stiffness, softer)]
    return made[0], made[1], soft


def ground(seed, samples):
    """Return a base acceleration, m/s2: noise through a soil of 2 Hz, strong for ten seconds, without drift."""
    rng = np.random.default_rng([2, seed])
    time = np.arange(samples) / RATE
    omega, zeta = 2 * np.pi * 2.0, 0.5
    soil = signal.cont2discrete(([2 * zeta * omega, omega**2], [1, 2 * zeta * omega, omega**2]), 1 / RATE, "bilinear")
    envelope = np.minimum(time / 3, 1.0) ** 2 * np.exp(-0.15 * np.maximum(time - 12, 0.0))
    noise = signal.lfilter(soil[0].ravel(), soil[1], rng.standard_normal(samples)) * envelope
    high = signal.butter(2, 0.1, "highpass", fs=RATE, output="sos")
    shaken = signal.detrend(signal.sosfiltfilt(high, noise))
    return 2.0 * shaken / np.abs(shaken).max()


def shaken(frame, excitation, finer=1):
    """Return total accelerations and displacements relative to the ground, samples by floors, by modal superposition.

    The ground moves linearly between its samples, or between samples `finer` times closer of the band-limited motion
    through them.
    """
    if finer > 1:
        return tuple(each[::finer] for each in shaken(frame, signal.resample_poly(excitation, finer, 1), 1 / finer))
    found = sway_modes(frame)
    time = np.arange(len(excitation)) / RATE * finer
    total, moved = np.zeros((2, len(excitation), frame.stories))
    for frequency, shape in zip(found.frequencies, found.shapes.T, strict=True):
        omega = 2 * np.pi * frequency
        mode = signal.StateSpace(
            [[0, 1], [-(omega**2), -2 * RECORDED_RATIO * omega]],
            [[0], [-(shape @ frame.floor_mass)]],
            [[1, 0], [-(omega**2), -2 * RECORDED_RATIO * omega]],
            [[0], [0]],
        )
        _, out, _ = signal.lsim(mode, excitation, time)
        moved += np.outer(out[:, 0], shape)
        total += np.outer(out[:, 1], shape)
    return total, moved


def shaken_while_it_yields(frame, story, excitation):
    """Return the same for a linear ground motion with a plastic part in one story, by Euler's symplectic method."""
    _, elastic = shaken(frame, excitation)
    found, step = sway_modes(frame), 1 / RATE / STEPS
    omega, mass = 2 * np.pi * found.frequencies, frame.floor_mass
    rows = (mass[:, None] * found.shapes).T
    K, C = (rows.T * omega**2) @ rows, (rows.T * 2 * RECORDED_RATIO * omega) @ rows
    across = np.eye(frame.stories)[story - 1] - (np.eye(frame.stories)[story - 2] if story > 1 else 0.0)
    part = YIELDING * frame.story_stiffness[story - 1] * across
    largest = YIELDS_AT * np.abs(elastic @ across).max()
    samples = np.arange(len(excitation) * STEPS) / STEPS
    ground = np.interp(samples, np.arange(len(excitation)), excitation)
    u, v, slip = np.zeros(frame.stories), np.zeros(frame.stories), 0.0
    total, moved = np.zeros((2, len(excitation), frame.stories))
    for t, base in enumerate(ground):
        drift = across @ u
        slip = drift - min(max(drift - slip, -largest), largest)
        acceleration = (part * slip - K @ u - C @ v) / mass
        if t % STEPS == 0:
            total[t // STEPS], moved[t // STEPS] = acceleration, u
        v = v + step * (acceleration - base)
        u = u + step * v
    return total, moved


def measurement(frame, seed):
    """Return a test of the sound frame: noisy modes, damping of the first three."""
    rng = np.random.default_rng([3, seed, frame.stories])
    found = sway_modes(frame)
    count = min(frame.stories, 8)
    shapes = found.shapes.T[:count]
    largest = np.abs(shapes).max(axis=1, keepdims=True)
    # Design values err by independent errors of the stated deviation.
    off = np.exp(np.random.default_rng([5, seed, frame.stories]).standard_normal((2, frame.stories)) * [[0.05], [0.2]])
    mass, stiffness = (off * [frame.floor_mass, frame.story_stiffness]).tolist()
    return {
        "frame": {
            "stories": frame.stories, "story_heights": 3.5, "total_mass": float(frame.floor_mass.sum()),
        },
        "prior": [
            {"kind": "nominal", "quantity": "floor_mass", "values": mass, "std": 0.05},
            {"kind": "nominal", "quantity": "story_stiffness", "values": stiffness, "std": 0.2},
        ],
        "configuration": [{
            "frequencies": (found.frequencies[:count] * np.exp(0.002 * rng.standard_normal(count))).tolist(),
            "mode_shapes": (shapes + 0.01 * largest * rng.standard_normal(shapes.shape)).tolist(),
            "frequency_std": 0.002, "mode_shape_std": 0.01,
            "damping_ratios": (RATIO * np.exp(0.1 * rng.standard_normal(count))).tolist(), "damping_ratio_std": 0.1,
        }],
    }  # fmt: skip


def setting(stories, case, seed, finer=1, seconds=SECONDS):
    """Return the model, the record, the true drifts, and the softer story."""
    sound, there, soft = building(stories, case, seed)
    excitation = ground(seed, int(seconds * RATE))
    total, moved = (
        shaken_while_it_yields(there, soft, excitation) if case == "yields" else shaken(there, excitation, finer)
    )
    floors = sensors(stories)
    rng = np.random.default_rng([4, seed, stories])
    noise = rng.uniform(0.01, 0.05)
    seen = total[:, floors - 1]
    seen = seen + noise * seen.std(axis=0) * rng.standard_normal(seen.shape)
    experiment = cvxshear.Experiment.from_dict(measurement(sound, seed))
    models = Models(None, Fitted.of(efficient(experiment, backends.get("auto"))))
    record = DrivenRecord((DrivenRun(excitation, 0, seen),), RATE, floors=floors)
    return models, record, np.diff(moved, axis=1, prepend=0.0), soft


def largest(drift):
    """Return the peaks of the band-limited motion through the samples, shape (N,)."""
    return np.abs(signal.resample_poly(drift, FINER_PEAKS, 1, padtype="line")).max(axis=0)


def against(found, drift):
    """Return peak drift errors, these errors in stated deviations, and the share of each drift within its band."""
    true, peaks = largest(drift), found.peaks
    off = peaks.values["story_drift"] - true
    within = np.abs(found.runs[0].response.drift - drift) <= NORMAL_95 * found.runs[0].std["story_drift"]
    return off / true, off / peaks.std["story_drift"], np.mean(within, axis=0)


def trial(seed, stories, case, finer=1):
    """Return errors of the peak drifts by three methods, the same in standard deviations, and the named changes."""
    models, motion, drift, soft = setting(stories, case, seed, finer)
    alone = reconstruct(models, motion, fit=False, leave_out=False)
    found = reconstruct(models, motion, leave_out=False)
    predicted = found.predicted_peaks.values["story_drift"] / largest(drift) - 1
    errors, peaks, over_time = zip(against(alone, drift), against(found, drift), strict=True)
    return [predicted, *errors], peaks, over_time, found.changed, soft


def main(trials=10, jobs=1, finer=1):
    print(
        "| stories | case | peak drift off by (rms; soft story): prediction | smoothing | reconstruction "
        "| peaks within 95 %: smoothing | reconstruction | drift over time within: reconstruction "
        "| soft story named (others) |\n|---:|---|---:|---:|---:|---:|---:|---:|---|"
    )
    for stories in STORIES:
        for case in CASES:
            found = each(partial(trial, stories=stories, case=case, finer=finer), range(trials), jobs=jobs)
            cells = []
            for way in range(3):
                off = np.sqrt(np.mean([item[0][way] ** 2 for item in found]))
                own = np.sqrt(np.mean([item[0][way][item[4] - 1] ** 2 for item in found]))
                cells.append(f"{100 * off:.1f} %" + (f" ({100 * own:.1f})" if case in ("soft", "yields") else ""))
            within = [np.mean([np.abs(item[1][way]) <= NORMAL_95 for item in found]) for way in range(2)]
            cells += [f"{100 * share:.0f} %" for share in within]
            cells.append(f"{100 * np.mean([item[2][1] for item in found]):.0f} %")
            named = sum(item[4] in item[3] for item in found)
            wrong = sum(len(set(item[3]) - {item[4]}) for item in found)
            cells.append((f"{named} of {trials} " if case in ("soft", "yields") else "") + f"({wrong})")
            print(f"| {stories} | {case} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("error")
    main(*(int(word) for word in sys.argv[1:]))
