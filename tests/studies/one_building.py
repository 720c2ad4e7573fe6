"""Find the modes of one building in earthquakes of different strength: `python -m tests.studies one_building`.

Six stories of a building with sensors on the ground, floor 2 and the roof. Each story is elastic and, in part, a bundle
of dry frictions whose slips have a power law, so that frequency and damping follow the amplitude as in real buildings.
The peaks of the 21 ground motions differ by a factor of 20.

The study prints the table of frequency and damping over amplitude, and how many first modes are within 5 % of that of
the secant stiffnesses: a friction of slip s has the share s / d of its stiffness in a cycle of amplitude d > s, here
the root mean square drift times the square root of two.
"""

from __future__ import annotations

import numpy as np
from rich.console import Console
from scipy import linalg, signal

from cvxshear.records import Channel, Run, TimeRecord, identify_modes
from cvxshear.report import terminal
from cvxshear.report.from_records import amplitude_section
from cvxshear.util.errors import CvxshearError

RATE, STEPS, SECONDS, STORIES = 100.0, 20, 40.0, 6
FLOORS = (2, 6)
FIRST = 4.6
"""Hz, at small amplitudes."""
SLIDERS = np.geomspace(0.02, 2.0, 8)
"""Slip drifts of the sliders, mm, and their share of a story's stiffness."""
SHARE = 0.3
PEAKS = np.geomspace(0.1, 2.0, 21)
"""Peak ground accelerations, m/s2."""
ORDER = (4, 11, 0, 17, 8, 20, 2, 14, 6, 10, 19, 1, 13, 5, 16, 9, 3, 18, 7, 12, 15)


def frame():
    """Return floor masses (kg) and story stiffnesses (N/m) of the building at small amplitudes."""
    mass, stiffness = np.full(STORIES, 2e5), np.linspace(1.0, 0.5, STORIES)
    lowest = linalg.eigh(matrix(stiffness), np.diag(mass), eigvals_only=True)[0]
    return mass, stiffness * (2 * np.pi * FIRST) ** 2 / lowest


def matrix(stiffness):
    across = np.eye(STORIES) - np.eye(STORIES, k=-1)
    return across.T @ np.diag(stiffness) @ across


def ground(peak, seed):
    """Return a ground acceleration of this peak, m/s2: noise through a soil of 3 Hz, under an envelope."""
    rng = np.random.default_rng([8, seed])
    count = int(SECONDS * RATE)
    time = np.arange(count) / RATE
    omega, zeta = 2 * np.pi * rng.uniform(2.0, 4.0), 0.5
    soil = signal.cont2discrete(([2 * zeta * omega, omega**2], [1, 2 * zeta * omega, omega**2]), 1 / RATE, "bilinear")
    envelope = np.minimum(time / 3, 1.0) ** 2 * np.exp(-0.15 * np.maximum(time - rng.uniform(6, 14), 0.0))
    band = signal.butter(4, [0.1, 20.0], "bandpass", fs=RATE, output="sos")
    noise = signal.lfilter(soil[0].ravel(), soil[1], rng.standard_normal(count)) * envelope
    noise = signal.sosfiltfilt(band, noise)
    return peak * noise / np.abs(noise).max()


def moved(base):
    """Return total accelerations of the floors, and displacements (m), shape (samples, floors), by small steps."""
    mass, stiffness = frame()
    modes, shapes = linalg.eigh(matrix(stiffness), np.diag(mass))
    C = (mass[:, None] * shapes) @ np.diag(2 * 0.02 * np.sqrt(modes)) @ (mass[:, None] * shapes).T
    parts = SHARE / len(SLIDERS) * stiffness[:, None]
    slip = 1e-3 * SLIDERS[None, :] * np.ones((STORIES, 1))
    u = np.zeros(STORIES)
    v, spring, step = np.zeros(STORIES), np.zeros((STORIES, len(SLIDERS))), 1.0 / (RATE * STEPS)
    total, moves, before = *np.zeros((2, len(base), STORIES)), np.zeros(STORIES)
    for t in range(len(base) * STEPS):
        sample, part = divmod(t, STEPS)
        later = base[min(sample + 1, len(base) - 1)]
        drift = np.diff(u, prepend=0.0)
        spring = np.clip((drift - before)[:, None] + spring, -slip, slip)
        before = drift
        force = (1 - SHARE) * stiffness * drift + (parts * spring).sum(axis=1)
        acceleration = (np.append(force[1:], 0.0) - force - C @ v) / mass
        if part == 0:
            total[sample], moves[sample] = acceleration, u
        v = v + step * (acceleration - (base[sample] + (later - base[sample]) * part / STEPS))
        u = u + step * v
    return total, moves


def secant(moves):
    """Return the first frequency of the secant stiffnesses at the root mean square drifts, Hz."""
    mass, stiffness = frame()
    amplitude = 1e3 * np.sqrt(2.0) * np.std(np.diff(moves, axis=1, prepend=0.0), axis=0)
    left = np.minimum(SLIDERS / amplitude[:, None], 1.0).mean(axis=1)
    softer = matrix(stiffness * (1.0 - SHARE + SHARE * left))
    return np.sqrt(linalg.eigh(softer, np.diag(mass), eigvals_only=True)[0]) / (2 * np.pi)


def record(peak, seed):
    """Return an earthquake with sensor noise of 0.5 mm/s2, and the first frequency at its amplitude, Hz."""
    base = ground(peak, seed)
    total, moves = moved(base)
    values = np.column_stack([base, total[:, np.array(FLOORS) - 1]])
    values = values + 5e-4 * np.random.default_rng([9, seed]).standard_normal(values.shape)
    channels = [Channel(f"floor {floor}", floor) for floor in FLOORS]
    run = Run(values[:, 1:], values[:, 0])
    made = TimeRecord(channels, 6, name=f"{peak:.2f} m/s2", runs=(run,), sampling_rate=RATE, input="base")
    return made, secant(moves)


def main():
    found, near = [], 0
    for seed, place in enumerate(ORDER):
        made, first = record(PEAKS[place], seed)
        try:
            result = identify_modes(made)
        except CvxshearError as error:
            print(f"{made.name}: {error}")
            continue
        found.append(result)
        near += result.modes[0] == 1 and abs(result.frequencies[0] / first - 1.0) < 0.05
        print(f"{made.name}: mode {result.modes[0]} at {result.frequencies[0]:.3f} Hz, {first:.3f} Hz at its amplitude")
    print(f"a first mode in {len(found)} of {len(ORDER)} records, {near} within 5 %")
    for part in terminal.rendered(amplitude_section(found)):
        Console(width=110).print(part)


if __name__ == "__main__":
    main()
