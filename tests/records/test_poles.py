"""Test stable poles, their energy, average and residues, and modes, against closed forms."""

import numpy as np
import pytest

from cvxshear.records.picking import PoleCandidate, Sweep, strongest
from cvxshear.records.pole_sweep import Criteria, Impulse, Poles, center, clusters, energies, stable_poles, undivided


def candidate(frequency, shape, energy=0.1, place=None, **more):
    shape = np.asarray(shape, dtype=complex)
    place = round(1000 * frequency) if place is None else place
    members = (place, 0), (place + 1, 0)
    return PoleCandidate(members, 2 * np.pi * frequency * np.exp(1.59j), shape, 1.0, energy, **more)


def poles(order, *modes):
    values = [2 * np.pi * f * (-z + 1j * np.sqrt(1 - z**2)) for f, z, _ in modes]
    return Poles(order, np.array(values), np.array([shape for *_, shape in modes], dtype=complex))


def test_stable_poles_and_their_clusters():
    """The limits between successive orders are 1 % of frequency, half of the damping or 0.01, and MAC 0.95."""
    up, turned, off = [1.0, 1.0], [1.0, 0.7], [1.0, 0.5]
    sweep = [
        poles(2, (5.0, 0.02, up), (9.0, 0.004, up), (20.0, 0.01, up), (49.5, 0.01, up), (30.0, 0.11, up)),
        poles(4, (5.049, 0.029, turned), (9.0, 0.0088, up), (20.0, 0.01, off), (49.5, 0.01, up), (30.0, 0.11, up)),
        poles(6, (5.098, 0.029, turned), (9.0, 0.0142, up), (20.3, 0.01, off), (5.02, 0.028, turned), (30.0, -0.1, up)),
    ]
    stable = stable_poles(sweep, 100.0, Criteria())
    assert stable == [[], [0, 1], [0, 3]]
    assert clusters(sweep, stable, Criteria()) == [[(1, 0), (2, 3)], [(1, 1)], [(2, 0)]]
    # The third order has a second pole with the same shape nearby; the second order has no such pole.
    assert undivided([(1, 0), (2, 3)], sweep, Criteria()) == [(1, 0)]
    assert undivided([(2, 3)], sweep, Criteria()) == [(2, 3)]
    # An exponential window adds 0.4 /s of decay: a damping ratio of 0.013 at 5 Hz; at 9 Hz, more than the pole has.
    assert stable_poles(sweep[:2], 100.0, Criteria(highest_damping=0.02), shift=0.4) == [[], [0]]
    assert stable_poles(sweep[:2], 100.0, Criteria(highest_damping=0.008))[1] == []


def test_the_energy_of_a_mode():
    """The overlap of two modes is negligible, so each has its own sum of squares. The third mode is not listed."""
    rate, time = 50.0, np.arange(400) / 50.0
    values = 2 * np.pi * np.array([3.0, 11.0, 20.0]) * np.exp(1.6j)
    shapes = np.array([[1.0, 2.0], [1.0, -1.0], [0.5, 1.0]])
    sizes = 3.0, 1.0, 2.0
    parts = [size * np.real(np.exp(value * time)[:, None] * shape) for size, value, shape in zip(sizes, values, shapes,
             strict=True)]  # fmt: skip
    factor = np.sum(parts, axis=0).reshape(-1, 1)
    found = energies(factor, list(zip(values[:2], shapes[:2] + 0j, strict=True)), rate)
    np.testing.assert_allclose(found, [np.sum(part**2) / np.sum(factor**2) for part in parts[:2]], rtol=0.1)
    assert energies(factor, [], rate).shape == (0,)


def test_the_center_of_a_cluster():
    shape = np.array([1.0 + 0.1j, -0.5j])
    value, middle = center(np.array([1 + 4j, 2 + 3j, 9 + 8j]), np.array([shape, 3j * shape, -2.0 * shape]))
    assert value == 2 + 4j
    np.testing.assert_allclose(middle, 2.0 * shape)


def test_the_strongest_resonances():
    given = (1.0, 9e-4), (2.0, 0.3), (2.15, 1.0), (2.45, 0.2), (3.0, 0.5), (4.0, 0.0011)
    items = [candidate(at, [1.0, k], energy, physical=at != 3.0) for k, (at, energy) in enumerate(given)]
    sweep = Sweep([], [], tuple(items), (), None)
    frequencies, shapes = strongest(sweep, 2)
    np.testing.assert_allclose(frequencies, [2.0, 2.15])
    np.testing.assert_allclose(np.abs(shapes[:, 1] / shapes[:, 0]), [1.0, 2.0])
    assert strongest(sweep, 9)[0][-1] == pytest.approx(4.0)
    assert len(strongest(Sweep([], [], (items[4],), (), None), 2)[0]) == 0


def test_residues_are_the_amplitudes_of_decays():
    values = np.array([-0.5 + 20j, -1.0 + 55j])
    amplitudes = np.random.default_rng(3).standard_normal((2, 3, 2)) + 1j
    k = np.arange(5, 80)
    sequence = np.zeros((80, 3, 2))
    for value, size in zip(values, amplitudes, strict=True):
        sequence[5:] += 2 * np.real(np.exp(value * k / 50.0)[:, None, None] * size)
    impulse = Impulse(sequence, 5, np.array([1, 2]))
    np.testing.assert_allclose(impulse.amplitudes(values, 50.0), amplitudes)
