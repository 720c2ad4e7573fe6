"""Random samples have the declared noise; the Cramer-Rao bound is compared with one from central differences."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from cvxshear import InputError, identify
from cvxshear.paper import paper_setups
from cvxshear.paper.setups import Setup, bound, six_story, three_story
from cvxshear.report.studied import in_percent

MASS, STIFFNESS = np.array([10.0, 7.5, 5.0]), np.array([1800.0, 1200.0, 600.0])


def test_the_exact_modes_are_those_of_the_paper():
    frequencies, shapes = three_story(0.01).exact()
    np.testing.assert_allclose(frequencies, [1.0336, 2.2099, 3.2812], atol=5e-5)
    np.testing.assert_allclose(np.max(np.abs(shapes), axis=1), 1.0)
    np.testing.assert_allclose((shapes * MASS) @ shapes.T * (1 - np.eye(3)), 0.0, atol=1e-12)


def test_multiplicative_noise_goes_with_the_entry_and_the_frequencies_stay_exact():
    setup = three_story(0.04)
    exact_frequencies, exact = setup.exact()
    frequencies, shapes = setup.draw(np.random.default_rng(5), 4000)
    assert np.all(frequencies == exact_frequencies)
    # The standard deviation of 4000 samples scatters by 1.1 %.
    np.testing.assert_allclose((shapes / exact).std(axis=0), 0.04, rtol=0.05)


def test_additive_noise_goes_with_the_largest_entry():
    setup = six_story(0.02)
    exact_frequencies, exact = setup.exact()
    frequencies, shapes = setup.draw(np.random.default_rng(6), 4000)
    np.testing.assert_allclose((shapes - exact).std(axis=0), 0.02, rtol=0.05)
    np.testing.assert_allclose((frequencies / exact_frequencies).std(axis=0), 1e-3, rtol=0.05)
    assert exact.shape == (4, 5)


def test_an_experiment_declares_noise_total_floors_and_modes():
    setup = six_story()
    experiment = setup.experiment(*setup.exact())
    configuration = experiment.configurations[0]
    assert experiment.frame.total_mass == pytest.approx(52.0)
    assert configuration.modes.tolist() == [1, 2, 3, 4]
    assert configuration.measured_floors.tolist() == [1, 2, 4, 5, 6]
    assert experiment.noise_declared
    assert np.all(configuration.mode_shape_std == 0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"floor_mass": [10.0, -7.5, 5.0]}, "floor_mass"),
        ({"story_stiffness": [1800.0, 1200.0]}, "story_stiffness"),
        ({"mode_shape_std": 0.0}, "mode_shape_std"),
        ({"mode_shape_noise": "multiplied"}, "mode_shape_noise"),
        ({"modes": [1, 4]}, "modes"),
        ({"measured_floors": [2, 1]}, "measured_floors"),
    ],
)
def test_a_setup_that_is_none_is_refused(change, message):
    given = {"floor_mass": MASS, "story_stiffness": STIFFNESS, "mode_shape_std": 0.01, **change}
    with pytest.raises(InputError, match=message):
        Setup(**given)


STEP = 1e-5
"""Relative step of the central differences; their error is of order step^2."""


def modal_data(setup, theta):
    """Return logarithms of the measured frequencies, shape (m,), and shapes of unit modal mass, shape (m, n)."""
    n = setup.stories
    root = np.sqrt(theta[:n])
    drift = np.eye(n) - np.eye(n, k=-1)
    eigenvalues, vectors = np.linalg.eigh((drift.T * theta[n:]) @ drift / np.outer(root, root))
    shapes = vectors / root[:, None]
    # The largest entry of a mode has one sign over a step of the differences.
    shapes = shapes * np.sign(shapes[np.argmax(np.abs(shapes), axis=0), np.arange(n)])
    which = setup.modes - 1
    return 0.5 * np.log(eigenvalues[which]), shapes[np.ix_(setup.measured_floors - 1, which)].T


def by_differences(setup):
    """Return the smallest standard deviations of an unbiased estimator, shape (2N,)."""

    def stacked(theta):
        frequencies, shapes = modal_data(setup, theta)
        return np.concatenate([frequencies, shapes.ravel()])

    truth = setup.truth
    frequencies, shapes = modal_data(setup, truth)
    spread = np.abs(shapes)
    if setup.mode_shape_noise == "additive":
        spread = np.max(spread, axis=1, keepdims=True)
    std = np.concatenate([
        np.full(len(frequencies), setup.frequency_std),
        np.broadcast_to(setup.mode_shape_std * spread, shapes.shape).ravel(),
    ])  # fmt: skip
    slopes = [(stacked(truth + STEP * row) - stacked(truth - STEP * row)) / (2 * STEP) for row in np.diag(truth)]
    scales = linalg.block_diag(*shapes.reshape(len(shapes), -1, 1))
    J = np.hstack([np.array(slopes).T, np.vstack([np.zeros((len(frequencies), len(shapes))), scales])])
    total = np.concatenate([setup.floor_mass, np.zeros(J.shape[1] - setup.stories)])
    Z = linalg.null_space(total[None])
    root = np.linalg.inv(np.linalg.qr((J / std[:, None]) @ Z, mode="r"))
    return truth * np.linalg.norm((Z @ root)[: len(truth)], axis=1)


@pytest.mark.parametrize("setup", [three_story(0.03), six_story()], ids=["three stories", "six stories"])
def test_it_is_that_of_difference_quotients_with_the_scales_as_parameters(setup):
    np.testing.assert_allclose(bound(setup), by_differences(setup), rtol=1e-7)


def test_the_papers_frame_at_five_percent():
    setup = three_story(0.05)
    percent = 100 * bound(setup) / setup.truth
    np.testing.assert_allclose(percent, [1.29, 2.72, 1.79, 2.20, 1.39, 0.79], atol=0.005)


def test_one_story_by_hand():
    """The total is the mass, so k = m (2 pi f)^2 has twice the frequency's relative standard deviation."""
    setup = Setup(np.array([3.0]), np.array([500.0]), 0.01, frequency_std=2e-3, exact_frequencies=False)
    np.testing.assert_allclose(bound(setup), [0.0, 500.0 * 2 * 2e-3], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("setup", [three_story(0.03), six_story()], ids=["three stories", "six stories"])
def test_at_exact_data_the_efficient_method_states_the_bound(setup):
    frame = identify(setup.experiment(*setup.exact())).frame
    stated = np.concatenate([frame.floor_mass_std, frame.story_stiffness_std])
    np.testing.assert_allclose(by_differences(setup), stated, rtol=1e-4)


DOCUMENTED = (Path(__file__).parents[2] / "docs" / "noise-study.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "setup", [*paper_setups(), six_story()], ids=lambda each: f"{each.stories}-{each.mode_shape_std}"
)
def test_the_bounds(setup):
    assert f"Cramér-Rao bound, % | {' | '.join(in_percent(bound(setup) / setup.truth))} |" in DOCUMENTED


@pytest.mark.parametrize("floor", range(1, 7))
def test_the_bound_by_the_floor_without_a_sensor(floor):
    setup = replace(six_story(), measured_floors=np.delete(np.arange(1, 7), floor - 1))
    largest = np.max(bound(setup) / setup.truth)
    assert re.search(rf"^\| {floor} \| {100 * largest:.1f} \|", DOCUMENTED, re.MULTILINE)


def test_the_measured_efficiency_and_coverage():
    """Read six tables. In each, the efficient method's lines follow its name."""
    efficient = [part.split("\n\n")[0] for part in DOCUMENTED.split("| efficient | bias, %")[1:]]
    assert len(efficient) == 6
    for table in efficient:
        ratios, held = (
            np.array(line.split("|")[3:-1], dtype=float)
            for line in table.splitlines()
            if line.startswith(("|  | error / bound", "|  | truth in the 95 %"))
        )
        assert np.max(ratios) <= 1.10
        assert np.all((held >= 93) & (held <= 97))
