"""Compare covariances, undetermined directions and priors with closed forms."""

import numpy as np
import pytest
from scipy import linalg, stats

from cvxshear import Experiment
from cvxshear.effects import LocatedEffect, Place, Scale, open_classes
from cvxshear.fit.domain import Domain, EffectPrior, uncertainty
from cvxshear.fit.gaussian import tailed
from cvxshear.priors import Constraints
from cvxshear.programs.constraints import NamedConstraints
from tests.effects.common import placed as put
from tests.frames import experiment

NAMES = ("a", "b", "c", "d")
THETA = np.array([2.0, -1.0, 0.5, 3.0])


def domain(interval_std=(np.inf,) * 4, **said):
    said = {key: np.array(value) for key, value in said.items()}
    return Domain((NamedConstraints("said", Constraints(**said)),), np.ones(4), np.array(interval_std))


def drawn():
    return np.random.default_rng(6).standard_normal((9, 4)) * [1.0, 20.0, 0.3, 5.0]


def covariance(J, held=None):
    """Return Z (Z' J'J Z)^-1 Z', with Z a basis of the null space of the held rows."""
    Z = np.eye(4) if held is None else linalg.null_space(np.array(held))
    return Z @ np.linalg.inv(Z.T @ J.T @ J @ Z) @ Z.T


@pytest.mark.parametrize(
    ("said", "held", "free", "active"),
    [
        ({}, None, 4, ()),
        ({"A": [[1.0, 1.0, 0.0, 0.0]], "b": [1.0]}, [[1.0, 1.0, 0.0, 0.0]], 3, ()),
        ({"lower": [2.0, -9.0, -9.0, -9.0]}, [[1.0, 0.0, 0.0, 0.0]], 4, ("a",)),
        ({"lower": [1.9, -9.0, -9.0, -9.0]}, None, 4, ()),
        ({"G": [[0.0, 1.0, 0.0, 1.0]], "h": [2.0], "A": [[1.0, 1.0, 0.0, 0.0]], "b": [1.0]},
         [[0.0, 1.0, 0.0, 1.0], [1.0, 1.0, 0.0, 0.0]], 3, ("b", "d")),
    ],
)  # fmt: skip
def test_a_covariance_is_that_within_the_constraints_that_are_active(said, held, free, active):
    J = drawn()
    found = uncertainty(J, THETA, domain(**said), NAMES)
    expected = covariance(J, held)
    np.testing.assert_allclose(found.covariance(), expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.std() ** 2, np.diag(expected), rtol=1e-6, atol=1e-9)
    spread = np.sqrt(np.diag(expected))
    known = np.outer(spread > 1e-9, spread > 1e-9)
    with np.errstate(invalid="ignore", divide="ignore"):
        np.testing.assert_allclose(
            found.correlation()[known], (expected / np.outer(spread, spread))[known], rtol=1e-6, atol=1e-9
        )
    root = found.root_of(J)
    np.testing.assert_allclose((J @ root).T @ (J @ root), np.eye(root.shape[1]), atol=1e-9)
    assert (found.free, found.active, found.null_directions) == (free, active, ())
    assert found.determined.all()


def test_an_interval_counts_as_knowledge_and_its_end_is_not_held():
    """At the end of an interval the covariance has the information 1 / std^2; other active bounds hold."""
    J = drawn()
    said = {"lower": [2.0, -9.0, -9.0, -9.0], "upper": [2.6, 9.0, 9.0, 3.0]}
    found = uncertainty(J, THETA, domain([0.17, np.inf, np.inf, np.inf], **said), NAMES)
    with_interval = np.concatenate([J, [[1 / 0.17, 0.0, 0.0, 0.0]]])
    np.testing.assert_allclose(found.covariance(), covariance(with_interval, [[0.0, 0.0, 0.0, 1.0]]), atol=1e-9)
    np.testing.assert_allclose(
        found.root_of(J) @ found.root_of(J).T, covariance(J, [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]), atol=1e-9
    )
    other = 3.0 * drawn()[::-1]
    np.testing.assert_allclose(
        found.root_of(other) @ found.root_of(other).T,
        covariance(other, [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]),
        atol=1e-9,
    )
    assert found.active == ("a", "d")


def test_what_nothing_depends_on_is_open_and_what_is_seen_little_is_not():
    J = drawn() * [1.0, 0.0, 1.0, 1e-9]
    found = uncertainty(J, THETA, domain(), NAMES)
    assert (found.null_directions, found.free) == ((("b",),), 3)
    np.testing.assert_array_equal(found.determined, [True, False, True, True])
    np.testing.assert_array_equal(np.isnan(found.std()), [False, True, False, False])
    known = J[:, [0, 2, 3]]
    np.testing.assert_allclose(
        found.covariance()[np.ix_([0, 2, 3], [0, 2, 3])], np.linalg.inv(known.T @ known), rtol=1e-6
    )


@pytest.mark.parametrize(("share", "names"), [(0.5, {"a", "b", "c"}), (0.1, {"b", "c"})])
def test_a_direction_that_is_open_is_named_by_those_with_a_share_in_it(share, names):
    """Shares are in units of each column's length; list shares above a tenth of the largest, the largest first."""
    J = drawn()
    unit = J / np.linalg.norm(J, axis=0)
    J[:, 2] = 7.0 * (share * unit[:, 0] + 2.0 * unit[:, 1])
    sizes = {"a": share, "b": 2.0, "c": np.linalg.norm(share * unit[:, 0] + 2.0 * unit[:, 1])}
    found = uncertainty(J, THETA, domain(), NAMES)
    assert found.null_directions == (tuple(sorted(names, key=lambda name: -sizes[name])),)
    np.testing.assert_array_equal(found.determined, [False, False, False, True])
    assert found.free == 3


@pytest.mark.parametrize("tail", [1.0, 4.0, np.inf])
def test_the_residual_of_students_distribution_is_its_log_density(tail):
    z = np.array([-30.0, -2.0, -1e-3, -1e-8, 0.0, 1e-8, 0.5, 3.0, 200.0])
    r, slope = tailed(z, tail)
    density = stats.norm if np.isinf(tail) else stats.t(tail)
    np.testing.assert_allclose(r**2 / 2, density.logpdf(0.0) - density.logpdf(z), atol=1e-9)
    np.testing.assert_array_equal(np.sign(r), np.sign(z))
    h = 1e-5 * np.maximum(np.abs(z), 1.0)
    np.testing.assert_allclose(slope, (tailed(z + h, tail)[0] - tailed(z - h, tail)[0]) / (2 * h), rtol=1e-6)


def test_what_is_expected_of_a_frame_and_its_effects_is_the_density_that_is_documented():
    """Logs: deviation 1 for masses, 2 for stiffnesses about their mean; effects: Student's t; a common size: normal."""
    scale = Scale(10.0, 5e3, np.full(2, 3.0))
    gain, mass = put("sensor_gain", floor=1), put("added_mass", floor=2, state="x")
    (other_gains,) = (each for each in open_classes() if each.name == "other_gains")
    tested = Experiment.from_dict(experiment(np.array([10.0, 10.0]), np.array([5e3, 5e3])))
    open_class = LocatedEffect(other_gains.bound(tested), Place())
    effects = [gain, mass, open_class]
    theta = np.array([8.0, 13.0, 4e3, 9e3, 0.12, 0.7, 0.01, -0.02])
    sizes = {mass: np.array([0.5])}
    expectation = EffectPrior(scale, sizes)
    label = open_class.label
    (r, J), keys, (frame_r, frame_J) = expectation.residuals(theta, effects, {label: 3.0, gain.label: 9.0})
    apart = np.log(9 / 4) / 2
    np.testing.assert_allclose(frame_r, [np.log(0.8), np.log(1.3), -apart / 2, apart / 2])
    assert keys == ["", "", label, label]
    width = expectation.of(open_class)
    np.testing.assert_array_equal(width, open_class.effect.expected_sizes(scale))
    t = stats.t(gain.effect.tail)
    expected = [
        np.sqrt(2 * (t.logpdf(0) - t.logpdf(0.12 / gain.effect.expected_sizes(scale)[0]))),
        np.sqrt(2 * (t.logpdf(0) - t.logpdf(0.7 / 0.5))),
        *(theta[6:] / (3 * width)),
    ]
    np.testing.assert_allclose(r, expected, rtol=1e-9)
    h = 1e-6 * np.abs(theta)
    for at in range(8):
        ends = [expectation.residuals(theta + s * h * np.eye(8)[at], effects, {label: 3.0}) for s in (1, -1)]
        for found, place in ((J, 0), (frame_J, 2)):
            quotient = (ends[0][place][0] - ends[1][place][0]) / (2 * h[at])
            np.testing.assert_allclose(found[:, at], quotient, rtol=1e-6, atol=1e-9)
    assert [len(part[0]) for part in EffectPrior().residuals(theta, effects, {})[::2]] == [0, 0]
