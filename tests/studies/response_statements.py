"""Count false statements of reconstruction: `python -m tests.studies response_statements [KIND [FRAMES [FIRST]]]`.

The kinds of record:

* sound: five stories, three sensors, no change since the tests;
* soft: one story is 10 % softer;
* damper: one story has had a damper since before the tests;
* late: the clock of one sensor is 2 to 20 ms late;
* gain: one sensor reads 5 % too much;
* yields: a third of one story's stiffness is plastic;
* six: six stories with bending beams that became softer, with sensors on the ground, floor 2 and the roof; floor 2 from
  the other two, beside linear interpolation;
* piece: ten seconds of a sound record, from the strong motion;
* cut: pieces of records of these kinds, cut, scaled and without some sensors at random.

A false statement is a change, damper, gain or mass that is not there, a limit stated with 95 % or more that is wrong,
or a story that "drifted most" but drifted less than another by more than two stated deviations. FIRST is the first
seed.
"""

from __future__ import annotations

import dataclasses
import sys
import traceback
import warnings

import numpy as np
from scipy import signal

import cvxshear
from cvxshear import backends
from cvxshear.fit.efficient import efficient
from cvxshear.measurement.declaration import Limits
from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.response import Fitted, Models, reconstruct
from cvxshear.util.errors import CvxshearError
from tests.fe.frame import sway_modes
from tests.studies import reconstruction as study

KINDS = ("sound", "soft", "damper", "late", "gain", "yields", "six", "piece")
PIECE = slice(300, 1300)
STORIES, SECONDS, SURE, TOO_MUCH = 5, 24.0, 0.95, 0.05
DAMPER = 0.03
"""Damping ratio of the first mode from the damper alone."""
LEVELS = np.array([0.25, 0.5, 0.8, 1.25, 2.0, 4.0])
"""Limits, relative to the median of the true peak drift ratios."""
HEIGHT = 3.5


def damped(frame, story):
    """Return the total accelerations and displacements under a ground motion, as a function, and modal ratios."""
    found, mass, N = sway_modes(frame), frame.floor_mass, frame.stories
    omega, shapes = 2 * np.pi * found.frequencies, found.shapes
    across = shapes[story - 1] - (shapes[story - 2] if story > 1 else 0.0)
    dashpot = 2 * DAMPER * omega[0] / across[0] ** 2
    own = np.outer(across, across) * dashpot
    rates = -np.hstack([np.diag(omega**2), np.diag(2 * study.RECORDED_RATIO * omega) + own])
    A = np.vstack([np.eye(N, 2 * N, N), rates])
    B = np.append(np.zeros(N), -(mass @ shapes))[:, None]
    C = np.vstack([shapes @ rates, shapes @ np.eye(N, 2 * N)])

    def moved(excitation):
        out = signal.lsim((A, B, C, np.zeros((2 * N, 1))), excitation, np.arange(len(excitation)) / study.RATE)[1]
        return out[:, :N], out[:, N:]

    return moved, np.diag(own) / (2 * omega)


def setting(kind, seed):
    """Return the models, the record, true drifts, and the true statements: stories, dampers and sensors (floors)."""
    stories = 6 if kind == "six" else STORIES
    rng = np.random.default_rng([6, seed, KINDS.index(kind)])
    case = {"soft": "soft", "yields": "yields", "six": "beams"}.get(kind, "sound")
    sound, there, soft = study.building(stories, case, seed)
    excitation = study.ground(seed, int(SECONDS * study.RATE))
    if kind == "six":
        there = dataclasses.replace(there, story_stiffness=there.story_stiffness * rng.uniform(0.75, 1.0))
    table = study.measurement(sound, seed)
    damper = int(rng.integers(1, stories + 1)) if kind == "damper" else 0
    if damper:
        moved, ratios = damped(there, damper)
        total, displacement = moved(excitation)
        (test,) = table["configuration"]
        test["damping_ratios"] = np.minimum(np.array(test["damping_ratios"]) + ratios[: len(test["frequencies"])], 0.6)
        test["damping_ratios"] = test["damping_ratios"].tolist()
    elif kind == "yields":
        total, displacement = study.shaken_while_it_yields(there, soft, excitation)
    else:
        total, displacement = study.shaken(there, excitation)
    floors = np.array([2, 6]) if kind == "six" else np.array([1, 3, 5])
    seen = total[:, floors - 1]
    seen = seen + rng.uniform(0.005, 0.03) * seen.std(axis=0) * rng.standard_normal(seen.shape)
    wrong = int(rng.integers(len(floors)))
    if kind == "late":
        turn = np.exp(-2j * np.pi * np.fft.rfftfreq(len(seen), 1 / study.RATE) * rng.uniform(0.002, 0.02))
        seen[:, wrong] = np.fft.irfft(np.fft.rfft(seen[:, wrong]) * turn, len(seen))
    if kind == "gain":
        seen[:, wrong] *= 1.0 + TOO_MUCH
    if kind == "piece":
        excitation, seen, displacement = excitation[PIECE], seen[PIECE], displacement[PIECE]
    drift = np.diff(displacement, axis=1, prepend=0.0)
    median = float(np.median(study.largest(drift))) / HEIGHT
    limits = Limits(LEVELS * median, tuple(f"limit {place}" for place in range(len(LEVELS))))
    experiment = dataclasses.replace(cvxshear.Experiment.from_dict(table), limits=limits)
    models = Models(None, Fitted.of(efficient(experiment, backends.get("auto"))))
    record = DrivenRecord((DrivenRun(excitation, 0, seen),), study.RATE, floors=floors)
    right = {soft} if kind == "soft" else set(), {damper} - {0}, {int(floors[wrong])} if kind == "gain" else set()
    return models, record, drift, right


def false_statements(found, drift, right):
    """List the false statements of a reconstruction."""
    stories, dampers, gains = right
    said = [f"story {story} changed" for story in set(found.changed) - stories]
    said += [f"damper in story {story}" for story in set(found.dampers) - dampers]
    named = [name for name, _, _ in found.gains_off]
    said += [f"gain of {name}" for name in named if not any(name.endswith(f"floor {floor}") for floor in gains)]
    said += ["masses changed"] * found.masses_changed
    true = study.largest(drift)
    if found.passed is not None:
        passed = true / HEIGHT > found.limits.story_drift[:, None]
        with np.errstate(invalid="ignore"):
            false = (found.passed >= SURE) & ~passed | (found.passed <= 1 - SURE) & passed
        said += [f"limit {row} in story {story + 1}" for row, story in np.argwhere(false)]
    if not found.fallback:
        peaks, std = found.peaks.values["story_drift"], found.peaks.std["story_drift"]
        most, truly = int(np.argmax(peaks)), int(np.argmax(true))
        if true[truly] - true[most] > 2 * np.hypot(std[most], std[truly]):
            said.append(f"story {most + 1} drifted most")
    return said


def named_rightly(found, right):
    """Return the numbers of true changes, and of those that are named."""
    stories, dampers, gains = right
    named = len(stories & set(found.changed)) + len(dampers & set(found.dampers))
    named += sum(any(name.endswith(f"floor {floor}") for name, _, _ in found.gains_off) for floor in gains)
    return named, sum(map(len, right))


def beside_interpolation(found):
    """Return the error of floor 2 from its neighbors over that of linear interpolation (floors of equal heights)."""
    check = next(each for each in found.checks if each.floor == 2)
    (run,) = found.runs
    measured, roof = run.measured.T
    floors = found.recording.floors
    share = 2 / floors[1]
    off = (1 - share) * run.excitation + share * roof - measured
    return check.error / np.sqrt(np.mean(off**2)), check.stated / check.measured


def trial(kind, seed):
    models, record, drift, right = setting(kind, seed)
    found = reconstruct(models, record, leave_out=kind == "six")
    said = false_statements(found, drift, right)
    errors, deviations, _ = study.against(found, drift)
    told = {
        "false": said, "right": named_rightly(found, right), "fallback": found.fallback.partition(" (")[0],
        "provisional": found.provisional, "off": float(np.sqrt(np.mean(errors**2))),
        "within": float(np.mean(np.abs(deviations) <= study.NORMAL_95)), "remarks": found.recording.remarks,
    }  # fmt: skip
    if kind == "six":
        told["floor 2"] = beside_interpolation(found)
    return told


def cut(seed):
    """Reconstruct a piece of a record, and return how it ended."""
    rng = np.random.default_rng([7, seed])
    models, record, _, _ = setting(KINDS[:-1][seed % (len(KINDS) - 1)], seed)
    (run,) = record.runs
    seconds = np.exp(rng.uniform(np.log(0.3), np.log(20.0)))
    first = int(rng.uniform(0, SECONDS - seconds) * study.RATE)
    part = slice(first, first + max(8, int(seconds * study.RATE)))
    scale = 10.0 ** rng.uniform(-4, 4)
    kept = rng.random(len(record.floors)) < 0.7
    kept[rng.integers(len(kept))] = True
    floors, seen = record.floors[kept], scale * run.responses[part][:, kept]
    piece = DrivenRun(scale * rng.choice([1.0, 1.0, 0.3, -1.0]) * run.excitation[part], 0, seen)
    try:
        found = reconstruct(models, DrivenRecord((piece,), study.RATE, floors=floors))
        how = found.fallback.partition(" (")[0] or "fitted"
        assert np.all(np.isfinite(found.peaks.values["story_drift"]))
        assert np.all(np.isfinite(found.peaks.std["story_drift"]))
    except CvxshearError as error:
        how = f"refused: {error}"
    except Exception:
        how = f"TRACEBACK: {traceback.format_exc().splitlines()[-1]}"
    return f"{len(seen)} samples, {kept.sum()} sensors, times {scale:.1e}: {how}"


def main(kind="", frames=10, first=100):
    if kind == "cut":
        for seed in range(first, first + frames):
            print(seed, cut(seed), flush=True)
        return
    for each in [kind] if kind else KINDS:
        found = []
        for seed in range(first, first + frames):
            found.append(trial(each, seed))
            print(each, seed, found[-1], file=sys.stderr, flush=True)
        false = sum(bool(one["false"]) for one in found)
        named, there = np.sum([one["right"] for one in found], axis=0)
        fallen = sum(bool(one["fallback"]) for one in found)
        print(
            f"{each}: {false} of {frames} records with a false statement; {named} of {there} changes named; "
            f"{fallen} fall back; peaks off by {100 * np.mean([one['off'] for one in found]):.1f} %, "
            f"{100 * np.mean([one['within'] for one in found]):.0f} % within", flush=True,
        )  # fmt: skip
        if each == "six":
            ratios = [f"{one['floor 2'][0]:.2f}" for one in found]
            print(f"floor 2 over interpolation: {', '.join(ratios)}")


if __name__ == "__main__":
    warnings.simplefilter("error")
    main(*sys.argv[1:2], *(int(word) for word in sys.argv[2:]))
