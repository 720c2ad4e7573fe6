"""Effects of floors that turn, against frames assembled from columns and point masses, and their derivatives."""

import numpy as np
import pytest

import cvxshear
from cvxshear.effects import LocatedEffect, Place, compose, named, open_classes
from cvxshear.effects.stories import SIDES
from tests.fe.plan_frames import PlanFrame

STORIES = 3
HEIGHTS = [4.0, 3.0, 3.5]
HALF = (5.0, 3.0)
"""Half the plan, m."""
EDGES = [(x, y) for x in (-HALF[0], HALF[0]) for y in (-HALF[1], HALF[1])]


def symmetric_frame(*, seed=3):
    """Build a frame with a column and a weight at each corner of the plan."""
    rng = np.random.default_rng(seed)
    kx, ky, mass = rng.uniform(2e6, 6e6, STORIES), rng.uniform(2e6, 6e6, STORIES), rng.uniform(2e3, 4e3, STORIES)
    columns = [np.array([[*at, along, across, 0.0] for at in EDGES]) for along, across in zip(kx, ky, strict=True)]
    weights = [np.array([[*at, each] for at in EDGES]) for each in mass]
    return PlanFrame((2 * HALF[0], 2 * HALF[1]), columns, weights)


def experiment_of(frame):
    """Test the frame in two states; the second one may change."""
    declared = frame.experiment(6).to_dict()
    declared["frame"] |= {"plan": list(frame.plan), "story_heights": HEIGHTS, "reference": "test"}
    declared["configuration"].append(declared["configuration"][0] | {"name": "after"})
    return cvxshear.Experiment(**vars(cvxshear.Experiment.from_dict(declared)) | {"symmetric": True})


def parameters_of(frame):
    """Return masses and inertias, then stiffnesses in x, y and rotation about the centers."""
    floors = np.column_stack([frame.floor_mass, frame.inertia]).ravel()
    return np.concatenate([floors, np.concatenate([np.diag(frame.story(story)) for story in range(STORIES)])])


def effect(name, experiment, **place):
    """Place an effect, in "after" unless it concerns the whole frame."""
    kind = next(each for each in (*named(["gravity"]), *open_classes()) if each.name == name) if name in OPEN else (
        named([name])[0]
    )  # fmt: skip
    if "state" in kind.sits_at:
        place["state"] = "after"
    kind = kind.bound(experiment)
    return LocatedEffect(kind.bound_at(experiment, Place(**place)), Place(**place))


OPEN = {each.name for each in open_classes()}


def composed(frame, name, values, **place):
    experiment = experiment_of(frame)
    placed = effect(name, experiment, **place)
    theta = np.concatenate([parameters_of(frame), values])
    return compose(experiment, experiment.configurations[1], [placed], theta)


def close(found, expected):
    sizes = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / sizes, expected / sizes, atol=1e-12)


@pytest.mark.parametrize(("part", "axis"), [("in x", 0), ("in y", 1)])
@pytest.mark.parametrize("level", [None, 2])
def test_an_eccentric_mass_or_stiffness_is_that_of_shifted_weights_or_columns(part, axis, level):
    frame, shifted = symmetric_frame(), symmetric_frame()
    levels = range(STORIES) if level is None else [level - 1]
    for each in (*(shifted.weights[at] for at in levels), *(shifted.columns[at] for at in levels)):
        each[:, axis] += 0.4
    M, K = shifted.matrices
    close(composed(frame, "eccentric_mass", [0.4], floor=level, part=part).system.M, M)
    close(composed(frame, "eccentric_stiffness", [0.4], story=level, part=part).system.K, K)


@pytest.mark.parametrize("part", SIDES)
def test_a_change_of_a_side_is_that_of_its_members(part):
    """Braces along an edge, a tenth of the story's stiffness together, are gone."""
    frame, damaged = symmetric_frame(), symmetric_frame()
    axis, signs = SIDES[part]
    edge = HALF[1 - axis]
    lost = 0.1 * frame.story(1)[axis, axis] / len(signs)
    for sign in signs:
        at = (0.0, sign * edge) if axis == 0 else (sign * edge, 0.0)
        gone = [-lost, 0.0] if axis == 0 else [0.0, -lost]
        damaged.columns[1] = np.vstack([damaged.columns[1], [*at, *gone, 0.0]])
    close(composed(frame, "story_change", [-0.1], story=2, part=part).system.K, damaged.matrices[1])


def test_turned_axes_are_those_of_an_oblique_wall():
    """A wall amid the plan at 45 degrees adds half of its stiffness to x, y and between them."""
    frame, oblique = symmetric_frame(), symmetric_frame()
    own, wall = frame.story(1), 6e5
    oblique.columns[1] = np.vstack([oblique.columns[1], [0.0, 0.0, wall, 0.0, np.pi / 4]])
    added = np.array([[0.0, 0.0, 0.5 * wall, 0.5 * wall, 0.0]])
    frame.columns[1] = np.vstack([frame.columns[1], added])
    mean = 0.5 * (own[0, 0] + own[1, 1] + wall)
    close(composed(frame, "turned_axes", [0.5 * wall / mean], story=2).system.K, oblique.matrices[1])


def test_an_added_mass_is_a_weight_at_its_place():
    frame, loaded = symmetric_frame(), symmetric_frame()
    loaded.weights[1] = np.vstack([loaded.weights[1], [3.0, -2.0, 700.0]])
    close(composed(frame, "added_mass", [700.0, 3.0, -2.0], floor=2).system.M, loaded.matrices[0])


def test_gravity_softens_every_story_under_each_weight():
    """Every weight above a story pushes the columns under it over by its drift: gamma W / h of its place."""
    frame = symmetric_frame()
    expected = frame.matrices[1]
    for story in range(STORIES):
        for weights in frame.weights[story:]:
            for x, y, mass in weights:
                drift = frame.place(story, x, y) - frame.place(story - 1, x, y)
                expected = expected - 1.1 * 9.81 * mass / HEIGHTS[story] * drift.T @ drift
    close(composed(frame, "gravity", [1.1]).system.K, expected)


def test_one_factor_on_a_state_and_springs_between_floors():
    frame = symmetric_frame()
    M, K = frame.matrices
    close(composed(frame, "state_stiffness", [-0.1]).system.K, 0.9 * K)
    close(composed(frame, "state_mass", [0.2]).system.M, 1.2 * M)
    # Pairs of levels two apart: ground and 2, ground and 3, 1 and 3, in x, y and rotation.
    radius = float(np.hypot(*frame.plan) / np.sqrt(12.0))
    values = np.zeros(9)
    values[[2, 8]] = 5e5, 3e5
    d = np.zeros((2, 9))
    d[0, [0, 6]] = -1.0, 1.0
    d[1, [2, 8]] = -radius, radius
    close(composed(frame, "other_stiffness", values).system.K, K + d.T @ np.diag([5e5, 3e5]) @ d)


def test_the_order_in_which_two_effects_are_named_does_not_matter():
    frame = symmetric_frame()
    of, plain = experiment_of(frame), parameters_of(frame)
    loads = [(effect("added_mass", of, floor=2), [700.0, 3.0, -2.0]), (effect("state_mass", of), [0.2])]
    centers = [(effect("eccentric_stiffness", of, part="in x"), [0.4]), (effect("turned_axes", of), [0.1])]
    for pair in (loads, centers):
        states = []
        for order in (pair, pair[::-1]):
            effects, values = zip(*order, strict=True)
            states.append(compose(of, of.configurations[1], effects, np.concatenate([plain, *values])).system)
        close(states[0].M, states[1].M)
        close(states[0].K, states[1].K)


def test_the_gain_of_one_sensor_scales_its_row():
    frame = symmetric_frame()
    state = composed(frame, "sensor_gain", [0.2], floor=1, part="at (-5, -3) m along 0 degrees")
    plain = state.experiment.configurations[1].sensor_rows
    factor = np.ones(9)
    factor[2] = 1.2
    np.testing.assert_allclose(state.observation.matrix, factor[:, None] * plain, rtol=1e-14)


CASES = {
    "eccentric_mass": ({"floor": 2, "part": "in x"}, [0.3]),
    "eccentric_stiffness": ({"part": "in y"}, [-0.2]),
    "turned_axes": ({"story": 2}, [0.15]),
    "story_change": ({"story": 2, "part": "in y at x < 0"}, [-0.2]),
    "added_mass": ({"floor": 3}, [500.0, 2.0, -1.0]),
    "gravity": ({}, [1.1]),
    "state_stiffness": ({}, [0.1]),
    "state_mass": ({}, [0.1]),
    "other_centers": ({}, np.linspace(-0.5, 0.5, 15)),
    "other_changes": ({}, np.linspace(-0.3, 0.3, 9)),
    "other_stiffness": ({}, np.linspace(-3e5, 5e5, 9)),
}


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_difference_quotients(name):
    """With eccentricities beside it, so that every entry of the matrices takes part."""
    place, values = CASES[name]
    frame = symmetric_frame()
    experiment = experiment_of(frame)
    effects = [
        *(each for each in (effect("eccentric_mass", experiment, part="in y"),) if name != "eccentric_mass"),
        *(each for each in (effect("eccentric_stiffness", experiment, part="in x"),) if name != "eccentric_stiffness"),
        effect(name, experiment, **place),
    ]
    theta = np.concatenate([parameters_of(frame), [0.2, 0.3][: len(effects) - 1], values])
    test = experiment.configurations[1]
    here = compose(experiment, test, effects, theta).system
    for parameter, value in enumerate(theta):
        h = 1e-5 * max(abs(value), 1.0)
        ends = [theta.copy(), theta.copy()]
        for end, sign in zip(ends, (1.0, -1.0), strict=True):
            end[parameter] += sign * h
        up, down = (compose(experiment, test, effects, end).system for end in ends)
        for slopes, matrix in (("dM", "M"), ("dK", "K")):
            quotient = (getattr(up, matrix) - getattr(down, matrix)) / (2 * h)
            size = np.max(np.abs(getattr(here, matrix))) / max(abs(value), 1.0)
            np.testing.assert_allclose(getattr(here, slopes)[parameter] / size, quotient / size, atol=1e-8)
