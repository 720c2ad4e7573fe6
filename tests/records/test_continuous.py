"""Test projections, residues and covariances of continuous records against explicit recursions and sums."""

import numpy as np
import pytest
from scipy import linalg

from cvxshear.records import continuous
from cvxshear.records.continuous import CovarianceSource, SubspaceSource, Triangles


@pytest.mark.parametrize(("stories", "outputs", "rows"), [(3, 3, 30), (14, 2, 42), (8, 1, 48)])
def test_rows_hold_samples_enough_for_each_state(stories, outputs, rows):
    assert continuous.rows_for(stories, outputs) == rows


def test_triangles_add_up_without_one_block_or_several():
    rng = np.random.default_rng(0)
    blocks = [rng.standard_normal((count, 5)) for count in (9, 3, 12, 7)]
    triangles = Triangles([np.linalg.qr(np.vstack([block, np.zeros((5, 5))]), mode="r") for block in blocks])
    for gone in ([], [0], [2], [3], [0, 2], [1, 3]):
        keep = np.isin(np.arange(4), gone, invert=True)
        found = triangles.together(keep if gone else None)
        products = sum(block.T @ block for block, kept in zip(blocks, keep, strict=True) if kept)
        np.testing.assert_allclose(found.T @ found, products)
        np.testing.assert_allclose(np.tril(found, -1), 0.0, atol=1e-12)


POLES = np.array([-1.5 + 25j, -3.0 + 60j])
"""Eigenvalues of a system of two outputs and one input, 1/s."""


def driven(samples=260, seed=2):
    """Return input and output of this system at 50 Hz, starting at rest, and the amplitudes of its impulse response."""
    rng = np.random.default_rng(seed)
    amplitudes = rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2))
    u = rng.standard_normal((samples, 1))
    powers = np.exp(np.outer(np.arange(samples), POLES) / 50.0)
    response = 2 * np.real(powers @ amplitudes)
    response[:5] += rng.standard_normal((5, 2))
    y = np.array([sum(response[k] * u[at - k] for k in range(at + 1)) for at in range(samples)])
    return u, y, amplitudes


def test_residues_of_exact_data_are_those_of_the_system():
    """The second block begins in motion."""
    u, y, amplitudes = driven()
    source = SubspaceSource([(u[:140], y[:140]), (u[120:], y[120:])], 50.0, floor=2, rows=5)
    for keep in (None, np.array([True, False]), np.array([False, True])):
        found, floors = source.residues(POLES, keep)
        np.testing.assert_allclose(found[:, :, 0], amplitudes, atol=1e-8)
        np.testing.assert_array_equal(floors, [2])
    np.testing.assert_allclose(source.energies, [np.mean(y[:140] ** 2), np.mean(y[120:] ** 2)])


def test_the_factor_of_a_subspace_is_the_future_as_the_past_explains_it():
    """Remove the future inputs from past and future outputs; project the remaining future on the remaining past."""
    u, y, _ = driven()
    y = y + 0.3 * np.random.default_rng(4).standard_normal(y.shape)
    pieces = [(u[:140], y[:140]), (u[120:], y[120:])]

    def windows(which, start):
        """Return rows of four samples; the rows begin at each time from `start`."""
        found = [np.lib.stride_tricks.sliding_window_view(piece[which][start : len(piece[0]) - 4 + start], 4, axis=0)
                 for piece in pieces]  # fmt: skip
        return np.vstack([each.swapaxes(1, 2).reshape(len(each), -1) for each in found])

    future_inputs, future, past = windows(0, 4), windows(1, 4), np.hstack([windows(0, 0), windows(1, 0)])

    def less(values, basis):
        return values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]

    explained = less(future, future_inputs) - less(less(future, future_inputs), less(past, future_inputs))
    factor = SubspaceSource(pieces, 50.0, rows=4).factor()
    np.testing.assert_allclose(factor @ factor.T, explained.T @ explained, atol=1e-8)
    # The covariance of the future, with 1e-4 of its largest variance added, gives the weight that orders the columns.
    left = less(future, future_inputs)
    lift = 1e-4 * np.diag(left.T @ left).max() * np.eye(left.shape[1])
    sizes = np.linalg.norm(np.linalg.solve(np.linalg.cholesky(left.T @ left + lift), factor), axis=0)
    assert np.all(np.diff(sizes) <= 0)


def test_covariances_of_an_ambient_record_are_means_of_products():
    rng = np.random.default_rng(5)
    pieces = [rng.standard_normal((count, 2)).cumsum(axis=0) for count in (60, 90)]
    source = CovarianceSource(pieces, 10.0, rows=4, columns=3)
    counts = [len(piece) - 7 for piece in pieces]

    def at(lag, chosen):
        total = sum(np.outer(pieces[k][t + lag], pieces[k][t]) for k in chosen for t in range(counts[k]))
        return total / sum(counts[k] for k in chosen)

    for keep, chosen in ((None, (0, 1)), (np.array([False, True]), (1,))):
        found = source.markov(keep)
        assert len(found) == 8
        np.testing.assert_allclose(found, [at(lag, chosen) for lag in range(8)])
    np.testing.assert_allclose(source.energies, [np.mean(piece**2) for piece in pieces])
    R = source.markov()
    hankel = np.block([[R[1 + i + j] for j in range(3)] for i in range(4)])
    data = source.data()
    np.testing.assert_allclose(data @ data.T, hankel @ hankel.T)
    past = np.block([[R[i - j].T if i >= j else R[j - i] for j in range(3)] for i in range(3)])
    lift = 1e-8 * past.diagonal().max() - min(0.0, linalg.eigvalsh(past)[0])
    factor = source.factor()
    weighted = hankel @ np.linalg.solve(past + lift * np.eye(6), hankel.T)
    np.testing.assert_allclose(factor @ factor.T, weighted, rtol=1e-6, atol=1e-6 * np.abs(weighted).max())
    future = np.block([[R[i - j] if i >= j else R[j - i].T for j in range(4)] for i in range(4)])
    lift = 1e-8 * future.diagonal().max() - min(0.0, linalg.eigvalsh(future)[0])
    # The weight of the future determines the order of the columns and is then removed.
    inverse = np.linalg.inv(np.linalg.cholesky(future + lift * np.eye(8)))
    sizes = np.linalg.norm(inverse @ factor, axis=0)
    alike = (inverse @ factor).T @ (inverse @ factor) / np.outer(sizes, sizes)
    np.testing.assert_allclose(alike, np.eye(6), atol=1e-6)
    assert np.all(np.diff(sizes) <= 0)
