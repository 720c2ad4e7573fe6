"""Count the findings for records with one fault: right, refused, missed, or another channel accused.

Random shear frames of 4 to 8 stories have sensors at all floors except one or two. The records are base motion, a
shaker, ambient vibration and free decay, with 1 to 3 % of noise on every sensor.
`python -m tests.studies record_faults` prints the table in docs/modal.md.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import functools
from dataclasses import dataclass

import numpy as np

from cvxshear.records import ModalResult, identify_modes, prepare
from cvxshear.records.record import Run, TimeRecord
from cvxshear.records.simulate import KnownFrame, ambient_record, base_record, shaker_record
from cvxshear.util.errors import CvxshearError

NAMED_BY = {
    "reversed": ("sign",),
    "exchanged": ("swapped channels",),
    "delay": ("clock offset",),
    "drift": ("clock drift",),
    "dead": ("dead channel",),
    "in g": ("unit",),
    "stuck": ("stuck channel", "dead channel"),
    "saturated": ("clipped channel",),
    "spikes": ("spikes",),
    "without samples": ("lost samples",),
    "low-pass": ("low-pass",),
    "resonance": ("resonance", "low-pass"),
    "gain step": ("gain step",),
    "dropout": ("stuck channel", "dead channel", "spikes"),
}
"""Kinds of finding that name each fault."""

ACCUSING = {kind for kinds in NAMED_BY.values() for kind in kinds} | {"drift"}
INPUTS = ("base", "force", "none", "free_decay")


@dataclass(frozen=True)
class Case:
    """Record and its fault.

    Parameters
    ----------
    record : TimeRecord
    fault : str
        "sound", or a key of `NAMED_BY`.
    channels : tuple of str
        Faulty channels.
    size : float
        s for a delay, ppm for a drift, Hz for a low-pass or a resonance, a factor for a step of the gain, else 0.
    """

    record: TimeRecord
    fault: str
    channels: tuple[str, ...] = ()
    size: float = 0.0


def random_frame(random: np.random.Generator) -> KnownFrame:
    """Return a tapered frame of 4 to 8 stories: lowest mode at 1 to 2.5 Hz, damping 0.5 to 2 %."""
    stories = int(random.integers(4, 9))
    masses = 1000.0 * random.uniform(0.7, 1.3, stories)
    stiffnesses = np.linspace(1.0, random.uniform(0.4, 1.0), stories) * random.uniform(0.75, 1.3, stories)
    frame = KnownFrame(masses, stiffnesses, random.uniform(0.005, 0.02))
    factor = (random.uniform(1.0, 2.5) / frame.modes()[0][0]) ** 2
    return dataclasses.replace(frame, stiffnesses=stiffnesses * factor)


@functools.lru_cache(maxsize=16)
def sound_record(seed: int, kind: str) -> TimeRecord:
    """Return a sound record of a random frame, with sensors at all floors except one or two."""
    random = np.random.default_rng([seed, INPUTS.index(kind)])
    frame = random_frame(random)
    stories = len(frame.masses)
    rate = float(np.ceil(2.6 * frame.modes()[0][-1]))
    noise = random.uniform(0.01, 0.03)
    if kind == "base":
        record = base_record(frame, seed, noise=noise, duration=300.0, sampling_rate=rate)
    elif kind == "force":
        floor = int(random.integers(2, stories + 1))
        record = shaker_record(frame, seed, noise=noise, floor=floor, duration=300.0, sampling_rate=rate)
    elif kind == "none":
        record = ambient_record(frame, seed, noise=noise, duration=900.0, sampling_rate=rate)
    else:
        record = decay_record(frame, random, noise, rate)
    absent = random.choice(np.arange(stories - 1 if stories > 4 else stories), min(2, stories - 3), replace=False)
    absent = absent[: int(random.integers(1, len(absent) + 1))]
    return prepare.only(record, np.setdiff1d(np.arange(stories), absent).tolist())


def decay_record(frame: KnownFrame, random: np.random.Generator, noise: float, rate: float) -> TimeRecord:
    """Return three closed-form releases from a random pull at the floors, each after 3 s of rest."""
    frequencies, shapes = frame.modes()
    omega = 2 * np.pi * frequencies
    quiet = int(3 * rate)
    time = np.arange(int(60 * rate)) / rate
    flexibility = np.linalg.inv(frame.stiffness)
    runs = []
    for release in range(3):
        pull = flexibility @ random.normal(size=len(frame.masses))
        start = shapes @ (frame.masses * pull)
        damped = omega * np.sqrt(1 - frame.damping**2)
        # Acceleration of x = x0 exp(-z w t) (cos wd t + z w / wd sin wd t): -w^2 x0 exp(...) (cos - z w / wd sin).
        each = np.exp(-frame.damping * np.outer(time, omega)) * (
            np.cos(np.outer(time, damped)) - frame.damping * omega / damped * np.sin(np.outer(time, damped))
        )
        moved = np.vstack([np.zeros((quiet, len(omega))), -(each * omega**2 * start) @ shapes])
        moved += noise * moved[quiet : quiet + int(rate)].std(axis=0) * random.standard_normal(moved.shape)
        runs.append(Run(moved, name=f"release {release + 1}"))
    base = base_record(frame, 0, noise=0.0, duration=20.0, sampling_rate=rate)
    return dataclasses.replace(base, runs=tuple(runs), input="free_decay", name="simulated free_decay")


def case_of(seed: int, kind: str, fault: str) -> Case:
    """Return a sound record with one fault added."""
    record = sound_record(seed, kind)
    # The number of each fault stays as faults are added.
    numbered = [*sorted(set(NAMED_BY) - {"resonance"} | {"sound"}), "resonance"]
    random = np.random.default_rng([seed, 7, numbered.index(fault)])
    if fault == "sound":
        return Case(record, fault)
    place = int(random.integers(len(record.channels)))
    names = (record.channels[place].name,)
    if fault == "exchanged":
        other = int(random.choice([c for c in range(len(record.channels)) if c != place]))
        order = np.arange(len(record.channels))
        order[[place, other]] = other, place
        return Case(_mapped(record, lambda values, _: values[:, order]), fault, (*names, record.channels[other].name))
    size = 0.0
    if fault == "delay":
        size = float(np.exp(random.uniform(np.log(1e-3), np.log(2.0)))) * random.choice([-1.0, 1.0])
    elif fault == "drift":
        size = float(np.exp(random.uniform(np.log(30.0), np.log(500.0)))) * random.choice([-1.0, 1.0])
    elif fault == "low-pass":
        # From an eighth of the highest frequency to twice that.
        size = record.sampling_rate * float(np.exp(random.uniform(np.log(0.05), np.log(0.8))))
    elif fault == "resonance":
        size = record.sampling_rate * float(np.exp(random.uniform(np.log(0.08), np.log(0.4))))
    elif fault == "gain step":
        size = float(random.uniform(1.1, 1.5)) ** random.choice([-1.0, 1.0])
    started, instant = [0], random.uniform(0.2, 0.8) * record.duration
    damped = random.uniform(0.1, 0.4) if fault == "resonance" else 0.0

    def change(values: np.ndarray, levels: np.ndarray) -> np.ndarray:
        column, rate = values[:, place].copy(), record.sampling_rate
        level, time = levels[place], (started[0] + np.arange(len(values))) / rate
        started[0] += len(values)
        if fault == "reversed":
            column = -column
        elif fault in ("delay", "drift"):
            late = size if fault == "delay" else 1e-6 * size * time
            column = _late(column, late, rate)
        elif fault == "dead":
            hum = level * np.exp(random.uniform(np.log(1e-3), np.log(3.0)))
            mains = abs((50.0 + rate / 2) % rate - rate / 2)
            phase = random.uniform(0, 2 * np.pi)
            column = hum * (np.sqrt(2) * np.sin(2 * np.pi * mains * time + phase) + 0.2 * random.normal(size=len(time)))
        elif fault == "in g":
            column = column / 9.80665
        elif fault == "stuck":
            first = int(random.uniform(0.1, 0.7) * len(column))
            last = first + int(random.uniform(0.05, 0.3) * len(column))
            column[first:last] = column[first]
        elif fault == "saturated":
            limit = random.uniform(1.0, 2.0) * column.std()
            column = np.clip(column, -limit, limit)
        elif fault == "without samples":
            first, lost = int(random.uniform(0.2, 0.8) * len(column)), int(np.exp(random.uniform(0.0, np.log(100.0))))
            column[first:-lost] = column[first + lost :]
        elif fault in ("low-pass", "resonance"):
            spectrum = np.fft.rfft(column, 2 * len(column))
            lines = np.fft.rfftfreq(2 * len(column), 1.0 / rate) / size
            divisor = 1.0 + 1j * lines if fault == "low-pass" else 1.0 - lines**2 + 2j * damped * lines
            column = np.fft.irfft(spectrum / divisor)[: len(column)]
        elif fault == "gain step":
            column = np.where(time > instant, size, 1.0) * column
        elif fault == "dropout":
            for first in random.choice(len(column), int(random.integers(1, 6)), replace=False):
                column[first : first + int(random.uniform(0.2, 1.0) * rate)] = 0.0
        elif fault == "spikes":
            hit = random.choice(len(column), 12, replace=False)
            column[hit] += random.uniform(8, 40, 12) * random.choice([-1, 1], 12) * level
        return np.column_stack([values[:, :place], column, values[:, place + 1 :]])

    return Case(_mapped(record, change), fault, names, size)


def _late(column: np.ndarray, late: np.ndarray | float, rate: float) -> np.ndarray:
    """Delay a column by seconds that can vary between samples, with a windowed sinc of 48 terms."""
    place = np.arange(len(column)) - late * rate
    whole = np.floor(place).astype(int)
    offset = np.arange(-23, 25)
    distance = (place - whole)[:, None] - offset[None, :]
    weight = np.sinc(distance) * np.cos(np.pi * distance / 50) ** 2
    return np.sum(column[np.clip(whole[:, None] + offset, 0, len(column) - 1)] * weight, axis=1)


def _mapped(record: TimeRecord, change) -> TimeRecord:
    levels = np.sqrt(np.mean([run.responses.var(axis=0) for run in record.runs], axis=0))
    runs = tuple(dataclasses.replace(run, responses=change(run.responses, levels)) for run in record.runs)
    return dataclasses.replace(record, runs=runs)


def harmless(found: ModalResult, sound: ModalResult) -> bool:
    """Whether a result has the modes of the sound record, all within three of the deviations that its file states."""
    if not (np.array_equal(found.floors, sound.floors) and np.array_equal(found.modes, sound.modes)):
        return False
    shapes = [each.mode_shapes / np.abs(each.mode_shapes).max(axis=1, keepdims=True) for each in (found, sound)]
    shapes = [each * np.sign(np.sum(each * shapes[1], axis=1, keepdims=True)) for each in shapes]
    off = np.abs(shapes[0] - shapes[1]) / found.written_entry_std
    moved = np.abs(np.log(found.frequencies / sound.frequencies)) / found.written_frequency_std
    return bool(max(off.max(), moved.max()) < 3.0)


def judged(case: Case, sound: TimeRecord | None = None) -> tuple[str, str]:
    """Return the outcome and its reason.

    The outcome is "named", "refused", "missed", "accused", "lost" where no modes are found, or "harmless" where the
    fault is missed and the modes are those of the sound record.
    """
    try:
        result = identify_modes(case.record)
        findings = result.findings
    except CvxshearError as error:
        named = any(f'"{name}"' in str(error) for name in case.channels)
        return ("refused" if named else "lost"), str(error)
    said = [finding for finding in findings if finding.kind in ACCUSING]
    if case.fault == "sound":
        return ("accused" if said else "named"), "; ".join(f"{item.kind}: {item.message}" for item in said)
    right = [item for item in said if item.kind in NAMED_BY[case.fault] and _names(item.numbers) & set(case.channels)]
    wrong = [item for item in said if not _names(item.numbers) & set(case.channels)]
    outcome = "accused" if wrong else "named" if right else "missed"
    if outcome == "named" and case.fault == "delay":
        late, std, step = right[0].numbers["seconds"], right[0].numbers["std"], 1.0 / case.record.sampling_rate
        if abs(late - case.size) > max(0.1 * step, std / 5):
            return "named, off", f"{late:.5f} s (std {std:.5f}) for {case.size:.5f} s, a sample is {step:.4f} s"
    if outcome == "missed" and case.fault == "delay" and abs(case.size) < 0.1 / case.record.sampling_rate:
        return "below a tenth of a sample", ""
    if outcome == "missed" and sound is not None and harmless(result, identify_modes(sound)):
        outcome = "harmless"
    return outcome, "; ".join(f"{item.kind}: {item.message}" for item in said)


def _names(numbers: dict) -> set[str]:
    return {numbers["channel"]} if "channel" in numbers else set(numbers.get("channels", ()))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--inputs", nargs="*", default=list(INPUTS), choices=INPUTS)
    parser.add_argument("--faults", nargs="*", default=["sound", *NAMED_BY])
    parser.add_argument("--segment", type=float, default=prepare.SEGMENT, help="length of the segments, s")
    parser.add_argument("--details", action="store_true")
    chosen = parser.parse_args()
    prepare.SEGMENT = chosen.segment
    for fault in chosen.faults:
        for kind in chosen.inputs:
            counts: collections.Counter[str] = collections.Counter()
            for seed in range(chosen.first, chosen.first + chosen.seeds):
                case = case_of(seed, kind, fault)
                outcome, why = judged(case, sound_record(seed, kind))
                counts[outcome] += 1
                if chosen.details and outcome not in ("named", "refused", "harmless"):
                    print(f"  {fault} {kind} seed {seed} {case.channels} {case.size:.4g}: {outcome}: {why[:300]}")
            print(f"{fault:10} {kind:10}", dict(counts), flush=True)


if __name__ == "__main__":
    main()
