"""Each starting point of a fit has its intended property."""

import numpy as np
import pytest
from scipy import linalg

from cvxshear import Experiment
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.start import filled, nearest_first, smooth_frames, solved_story_equations, starts, uniform
from cvxshear.model import modes
from cvxshear.priors import Constraints
from cvxshear.programs.constraints import NamedConstraints
from tests.frames import chain, configuration, experiment, modes_of

MASS, STIFFNESS = np.array([12.0, 9.0, 7.0, 4.0]), np.array([9e3, 8e3, 5e3, 3e3])
ADDED = np.array([0.0, 3.0, 0.0, 2.0])


def measured(*tables, mass=MASS, stiffness=STIFFNESS, **keys):
    return Experiment.from_dict(experiment(mass, stiffness, *tables, **keys))


def two_tests(**keys):
    return [configuration(MASS, STIFFNESS, added, **keys) for added in (None, ADDED)]


def mean_log_ratio(of, theta):
    """Return the mean over the tests of the mean log(measured / modeled) of the eigenvalues."""
    found = []
    for each in of.configurations:
        M, K = chain(theta[: of.stories] + each.added_mass, theta[of.stories :])
        eigenvalues = linalg.eigh(K, M, eigvals_only=True)[each.modes - 1]
        found.append(np.mean(np.log((2 * np.pi * each.frequencies) ** 2 / eigenvalues)))
    return np.mean(found)


@pytest.mark.parametrize("taper", [0.0, 0.6])
@pytest.mark.parametrize(
    ("frame", "prior", "mass"),
    [
        ({"total_mass": 32.0}, [], [8.0] * 4),
        ({"floor_masses": MASS.tolist()}, [], MASS),
        # No mass is declared: use the largest total of added mass in a test.
        ({}, [], [1.25] * 4),
        ({}, [{"kind": "nominal", "quantity": "floor_mass", "values": MASS.tolist(), "std": 0.1}], MASS),
        ({}, [{"kind": "value", "quantity": "floor_mass", "at": 2, "value": 9.0, "std": 0.1}], [9.0] * 4),
        ({}, [{"kind": "value", "quantity": "story_stiffness", "at": 2, "value": 9.0, "std": 0.1}], [1.25] * 4),
    ],
)
def test_a_uniform_frame_has_the_known_masses_and_the_mean_frequency(frame, prior, mass, taper):
    of = measured(*two_tests(modes=[1, 3]), frame=frame, prior=prior)
    found = uniform(of, taper)
    np.testing.assert_allclose(found[:4], mass)
    np.testing.assert_allclose(found[4:] / found[4], 1 - taper * np.arange(4) / 3)
    assert mean_log_ratio(of, found) == pytest.approx(0.0, abs=1e-9)


def test_scaled_shapes_tell_the_mass_of_a_uniform_frame():
    """For a single floor phi' M phi = 1 gives m = 1 / phi^2; for four floors each largest entry is taken as one."""
    table = configuration(MASS, STIFFNESS, modes=[1, 2])
    table |= {"mass_normalized": True, "mode_shapes": [[0.1, 0.2, 0.3, 0.4], [0.3, 0.2, np.nan, -0.2]]}
    found = uniform(measured(table, frame={}))
    np.testing.assert_allclose(found[:4], 1 / np.mean([0.4**2, 0.3**2]))


def test_the_taper_is_the_one_that_suits_the_frequencies():
    stiffness = 1e4 * (1 - 0.6 * np.arange(4) / 3)
    of = measured(configuration(np.full(4, 5.0), stiffness), mass=np.full(4, 5.0))
    np.testing.assert_allclose(starts(of)[-1], [*[5.0] * 4, *stiffness], rtol=1e-9)


def test_design_values_come_first_at_the_right_total_and_frequency():
    masses = {"kind": "nominal", "quantity": "floor_mass", "values": MASS.tolist(), "std": 0.1}
    stories = {"kind": "nominal", "quantity": "story_stiffness", "values": [3.0, 2.0, 2.0, 1.0], "std": 0.1}
    of = measured(*two_tests(), frame={"total_mass": 64.0}, prior=[masses, stories])
    first = starts(of)[0]
    np.testing.assert_allclose(first[:4], 2 * MASS)
    np.testing.assert_allclose(first[4:] / first[7], [3.0, 2.0, 2.0, 1.0])
    assert mean_log_ratio(of, first) == pytest.approx(0.0, abs=1e-9)
    assert len(starts(of)) == len(starts(measured(*two_tests()))) + 1


@pytest.mark.parametrize("keys", [{}, {"modes": [1, 2, 4]}, {"measured_floors": [1, 3, 4]}, {"modes": [2, 4]}])
def test_the_story_equations_lead_to_the_frame_of_exact_modes(keys):
    """If entries are missing, the last pass is nearer than a frame of equal stories."""
    of, truth = measured(*two_tests(**keys)), np.concatenate([MASS, STIFFNESS])
    found = starts(of)[0]
    off, of_uniform = (np.max(np.abs(np.log(each / truth))) for each in (found, uniform(of)))
    assert off < (1e-4 if "measured_floors" not in keys else 0.5 * of_uniform)


@pytest.mark.parametrize("weighed", [False, True])
def test_story_equations_weigh_each_by_what_its_errors_amount_to(weighed):
    """Entries have errors of one size e. An equation has the error e lambda (sum m_l^2)^(1/2), plus e sqrt(2) k."""
    rng = np.random.default_rng(4)
    frequencies, shapes = modes_of(MASS + ADDED, STIFFNESS)
    shapes, lam = shapes + 0.02 * rng.standard_normal((4, 4)), (2 * np.pi * frequencies) ** 2
    theta = np.concatenate([1.1 * MASS, 0.9 * STIFFNESS])
    rows, sides = [], []
    for phi, value in zip(shapes, lam, strict=True):
        for i in range(4):
            above = np.arange(4) >= i
            size = value * np.sqrt(np.sum((theta[:4] + ADDED)[above] ** 2)) + weighed * np.sqrt(2) * theta[4 + i]
            row = np.concatenate([-value * phi * above, (phi[i] - (phi[i - 1] if i else 0.0)) * (np.arange(4) == i)])
            rows.append(row / size / np.linalg.norm(phi))
            sides.append(value * np.sum((phi * ADDED)[above]) / size / np.linalg.norm(phi))
    start = np.concatenate([np.full(4, 8.0), np.zeros(4)])
    within = linalg.block_diag(linalg.null_space([[1.0] * 4]), np.eye(4))
    change = np.linalg.lstsq(np.array(rows) @ within, np.array(sides) - np.array(rows) @ start, rcond=None)[0]
    exact = [NamedConstraints("total", Constraints(A=np.array([[1.0] * 4 + [0.0] * 4]), b=np.array([32.0])))]
    found = solved_story_equations(shapes, lam, np.tile(ADDED, (4, 1)), theta, exact, weighed=weighed)
    np.testing.assert_allclose(found, start + within @ change, rtol=1e-4)


def test_a_start_is_positive_and_keeps_what_is_exact():
    frequencies, shapes = modes_of(MASS, STIFFNESS)
    lam, theta = (2 * np.pi * frequencies) ** 2, np.concatenate([MASS, STIFFNESS])
    A = np.array([[1.0] + [0.0] * 7, [1.0] * 4 + [0.0] * 4])
    exact = NamedConstraints("a floor, and all", Constraints(A=A, b=np.array([-3.0, 32.0])))
    found = solved_story_equations(shapes, lam, np.zeros((4, 4)), theta, [exact], weighed=True)
    assert np.all(found > 0)
    assert found[1:4].sum() == pytest.approx(35.0)
    assert found[0] == pytest.approx(0.05 * 32.0 / 4)


def test_a_mode_is_filled_in_by_the_nearest_modes_of_the_model():
    """Three entries determine one mode, scaled by least squares; five entries determine two modes."""
    table = configuration(MASS, STIFFNESS, measured_floors=[1, 2, 4])
    table["mode_shapes"][1] = [np.nan] * 3
    of = measured(table)
    (tested,) = of.configurations
    M, K = chain(1.2 * MASS, STIFFNESS)
    model = modes(M, K)
    np.testing.assert_allclose(filled(tested, 1, model), model.shapes[1])
    found, values, own = filled(tested, 2, model), tested.mode_shapes[2], model.shapes[2]
    np.testing.assert_allclose(found[[0, 1, 3]], values)
    assert found[2] == pytest.approx(own[2] * (values @ own[[0, 1, 3]]) / np.sum(own[[0, 1, 3]] ** 2))
    rng = np.random.default_rng(0)
    mass, stiffness = rng.uniform(5, 9, 7), rng.uniform(1e3, 2e3, 7)
    (tested,) = measured(
        configuration(mass, stiffness, measured_floors=[1, 2, 4, 5, 7], rng=rng, shape_noise=0.1), mass=mass
    ).configurations
    model = modes(*chain(mass, stiffness))
    for j, near in ((0, [0, 1]), (3, [3, 2]), (6, [6, 5])):
        floors = [0, 1, 3, 4, 6]
        share = np.linalg.lstsq(model.shapes[near][:, floors].T, tested.mode_shapes[j], rcond=None)[0]
        np.testing.assert_allclose(filled(tested, j, model)[[2, 5]], (share @ model.shapes[near])[[2, 5]])


def test_the_nearest_starting_point_comes_first():
    rng = np.random.default_rng(1)
    of = measured(*two_tests(rng=rng, shape_noise=0.01, frequency_noise=0.001))
    misfit = Misfit(of)
    found = [misfit.evaluate(each).chi2 for each in nearest_first(misfit, np.zeros(0))]
    assert found == sorted(found)
    assert len(found) == 3
    # If the story equations give no values and equal stories are far off, a smooth frame gives a better start.
    alone = measured(configuration(MASS, STIFFNESS, mode_shapes=[[np.nan] * 4] * 4, frequency_std=1e-5))
    misfit = Misfit(alone)
    smooth, *others = (misfit.evaluate(each).chi2 for each in nearest_first(misfit, np.zeros(0)))
    assert smooth < 0.01 * min(others)


@pytest.mark.parametrize(
    ("frame", "columns"), [({"total_mass": 32.0}, 2), ({}, 3), ({"floor_masses": MASS.tolist()}, 0)]
)
def test_smooth_frames_keep_what_is_known_and_have_their_derivatives(frame, columns):
    of = measured(*two_tests(), frame=frame)
    base = np.concatenate([MASS, np.full(4, 6e3)])
    problem = smooth_frames(Misfit(of), base, 2)
    assert problem.mass.shape == (4, columns)
    c, h = np.random.default_rng(0).normal(0.0, 0.2, columns + 3), 1e-6
    if frame:
        assert problem.at(c)[0][:4].sum() == pytest.approx(32.0)
    else:
        np.testing.assert_allclose(
            np.log(problem.at(c)[0] / base), [*(problem.mass @ c[:3]), *(problem.stiffness @ c[3:])]
        )
    found = problem.evaluate(c)
    np.testing.assert_array_equal(problem.evaluate(c, derivatives=False).r, found.r)
    np.testing.assert_allclose(found.r[-len(c) :], 3 * c)
    # The free scales of shapes remove a part of the derivatives; the residual is orthogonal to this part.
    for at, direction in enumerate(np.eye(len(c))):
        ends = [problem.evaluate(c + sign * h * direction).objective for sign in (1, -1)]
        assert 2 * found.r @ found.J[:, at] == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-5)
