"""Test the next test: its distances from the explicit formula and numerical derivatives, its sensors and its words."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from cvxshear import Experiment, backends, close_loop
from cvxshear.effects import Gravity, LocatedEffect
from cvxshear.fit.domain import EffectPrior
from cvxshear.fit.efficient import efficient, fitted_with
from cvxshear.fit.gaussian import separation
from cvxshear.fit.misfit import Misfit
from cvxshear.loop.hypotheses import chosen, hypotheses
from cvxshear.loop.next_test import disagreement, imagined
from tests.fe.experiments import simulated
from tests.frames import configuration, experiment, modes_of

MASS, STIFFNESS = [10.0, 10.0, 9.0, 8.0], [24e3, 20e3, 16e3, 10e3]
NOISE, SEED = 3.0, 2


@pytest.mark.parametrize("columns", [3, 40])
def test_the_separation_is_the_formula(columns):
    rng = np.random.default_rng(columns)
    d, S = rng.standard_normal((12, 2)), 5 * rng.standard_normal((12, columns))
    slow = d.T @ np.linalg.inv(np.eye(12) + S @ S.T) @ d
    np.testing.assert_allclose(separation(d, S), slow, rtol=1e-8)


def fits(**keys):
    tested = configuration(MASS, STIFFNESS, **keys)
    declared = experiment(MASS, STIFFNESS, tested, frame={"total_mass": 37.0, "story_heights": 0.4})
    declared["prior"] = [{"kind": "nominal", "quantity": "story_stiffness", "values": STIFFNESS, "std": 0.05}]
    of = Experiment.from_dict(declared)
    return [efficient(of, backends.get("auto"), effects) for effects in ((), (LocatedEffect(Gravity()),))]


def predictions(theta, added, floors, modes, gravity):
    """Return logarithms of frequencies, and shapes at some floors with a first entry of 1."""
    mass, stiffness = theta[:4] + added, theta[4:8].copy()
    if gravity:
        above = np.cumsum(mass[::-1])[::-1]
        stiffness -= theta[8] * 9.81 * above / 0.4
    frequencies, shapes = modes_of(mass, stiffness)
    shapes = shapes[:modes][:, floors]
    return np.log(frequencies[:modes]), shapes


@pytest.mark.parametrize("floors", [[0, 3], [0, 1, 3], [0, 1, 2, 3]])
def test_the_distance_is_that_of_numerical_derivatives_with_the_scale_a_parameter(floors):
    """Two fits with floors 1 and 4 measured are compared, also at floors without a sensor."""
    plain, heavy = fits(measured_floors=[1, 4], modes=[1, 2], frequency_std=0.002, mode_shape_std=0.02)
    first = plain.experiment.configurations[0]
    added = np.array([0.0, 6.0, 0.0, 0.0])
    test = imagined(plain, first, added)
    found = disagreement(plain, heavy, test, first).at(np.array(floors))

    def said(estimate, theta, scale):
        frequency, shapes = predictions(theta, added, np.arange(4), 2, len(theta) > 8)
        # Scale to the first model's shapes. The unit of noise is the largest entry at the first sensors.
        own = predictions(plain.theta, added, np.arange(4), 2, False)[1]
        shapes = shapes * (np.sum(own * shapes, axis=1) / np.sum(shapes**2, axis=1))[:, None]
        unit = 0.02 * np.abs(own[:, [0, 3]]).max(axis=1, keepdims=True)
        return np.concatenate([frequency / 0.002, ((shapes + scale[:, None] * own) / unit)[:, floors].ravel()])

    columns = []
    for estimate in (plain, heavy):
        theta, covariance = estimate.theta, estimate.uncertainty.covariance()
        steps = np.diag(1e-6 * np.maximum(np.abs(theta), 1e-3))
        J = np.array(
            [
                (said(estimate, theta + h, np.zeros(2)) - said(estimate, theta - h, np.zeros(2))) / (2 * h.sum())
                for h in steps
            ]
        ).T
        columns.append(J @ covariance @ J.T)
    base = said(plain, plain.theta, np.zeros(2))
    free = 1e4 * np.array([said(plain, plain.theta, unit) - base for unit in np.eye(2)]).T
    spread = np.eye(len(base)) + columns[0] + columns[1] + free @ free.T
    d = said(heavy, heavy.theta, np.zeros(2)) - base
    assert found == pytest.approx(np.sqrt(d @ np.linalg.solve(spread, d)), rel=2e-3)


def test_more_sensors_never_tell_less():
    plain, heavy = fits(measured_floors=[1, 4], modes=[1, 2])
    first = plain.experiment.configurations[0]
    said = disagreement(plain, heavy, imagined(plain, first, np.array([0.0, 0.0, 5.0, 0.0])), first)
    apart = [said.at(np.array(floors)) for floors in ([3], [0, 3], [0, 2, 3], [0, 1, 2, 3])]
    assert apart == sorted(apart)
    assert apart[-1] > apart[0]


def test_an_entry_that_no_sensor_showed_is_not_counted_on():
    plain, heavy = fits()
    first = plain.experiment.configurations[0]
    shapes = first.mode_shapes.copy()
    shapes[:, 2] = np.nan
    blind = dataclasses.replace(first, mode_shapes=shapes)
    masses = np.array([0.0, 0.0, 5.0, 0.0])
    test = imagined(plain, blind, masses)
    without = disagreement(plain, heavy, test, blind)
    assert without.at(np.arange(4)) == without.at(np.array([0, 1, 3]))
    nothing = dataclasses.replace(first, mode_shapes=np.full_like(shapes, np.nan))
    frequencies_alone = disagreement(plain, heavy, imagined(plain, nothing, masses), nothing)
    assert frequencies_alone.at(np.arange(4)) == frequencies_alone.at(np.array([0]))


def test_every_effect_says_something_of_a_test_with_more_sensors_and_no_priors():
    """The fits have three instrumented floors and a soft prior; the planned test has four floors and no prior.

    An effect that changes neither masses nor stiffnesses nor sensors predicts the shear model's values.
    """
    keys = {"measured_floors": [1, 3, 4], "frequency_std": 0.002, "mode_shape_std": 0.02}
    tests = [
        {**configuration(MASS, STIFFNESS, added, **keys), "name": name, "state": name}
        for name, added in (("before", None), ("after", [0.0, 2.0, 0.0, 0.0]))
    ]
    declared = experiment(MASS, STIFFNESS, *tests, frame={"total_mass": 37.0, "story_heights": 0.4})
    declared["prior"] = [{"kind": "nominal", "quantity": "story_stiffness", "values": STIFFNESS, "std": 0.05}]
    of = Experiment.from_dict(declared)
    start = efficient(of, backends.get("auto"))
    expectation = EffectPrior(start.scale)
    plain, *others = (
        fitted_with(
            Misfit(of, effects, expectation=expectation),
            np.concatenate([start.theta, *(np.array(placed.start) for placed in effects)]),
            backends.get("auto"),
        )
        for effects in [(), *((item.placed,) for item in hypotheses(of, chosen(None), ()))]
    )
    first = of.configurations[0]
    test = imagined(plain, first, np.array([0.0, 6.0, 0.0, 0.0]))
    apart = {}
    for other in others:
        (placed,) = other.effects
        apart[placed.effect.name] = disagreement(plain, other, test, first).at(np.arange(4))
    assert {"other_gains", "other_stiffness", "attached_mass"} <= set(apart)
    assert np.all(np.isfinite(list(apart.values())))
    assert apart["other_shapes"] == pytest.approx(0.0, abs=1e-6)
    # If the prior is exact, the fit may move by the rounding difference between the prior and exact data.
    assert apart["wrong_prior"] == pytest.approx(0.0, abs=1e-3)


def measured(rng, **keys):
    """Return a five-story frame whose joints turn, with three times the usual noise, declared correctly."""
    declared, _ = simulated("joint_rotation", stories=5, rng=rng, noise=NOISE, **keys)
    for each in declared["configuration"]:
        each["frequency_std"] = (NOISE * np.asarray(each["frequency_std"])).tolist()
        each["mode_shape_std"] = (NOISE * np.asarray(each["mode_shape_std"])).tolist()
    return declared


def kept(table, floors):
    """Return a configuration measured at these floors alone."""
    shapes = np.asarray(table["mode_shapes"])[:, np.array(floors) - 1]
    return {**table, "measured_floors": list(floors), "mode_shapes": shapes.tolist()}


@pytest.fixture(scope="module")
def first():
    return measured(np.random.default_rng(SEED), configurations=1, measured_floors=[1, 5])


@pytest.fixture(scope="module")
def before(first):
    return close_loop(Experiment.from_dict(first), effects=["joint_rotation", "axial_columns"])


def test_two_sensors_in_much_noise_want_a_third(before):
    proposed = before.next_test
    assert before.verdict == "ambiguous"
    assert set(proposed.measured_floors) > {1, 5}
    assert len(proposed.measured_floors) == 3
    assert proposed.standard_deviations > 3


def test_carrying_it_out_makes_the_verdict_surer(first, before):
    proposed = before.next_test
    added = np.zeros((2, 5))
    added[1, proposed.floor - 1] = proposed.added_mass
    second = measured(np.random.default_rng(SEED), configurations=2, added_mass=added.tolist())["configuration"][1]
    both = {**first, "configuration": [*first["configuration"], kept(second, proposed.measured_floors)]}
    after = close_loop(Experiment.from_dict(both), effects=["joint_rotation", "axial_columns"])
    was, now = ({item.placed.effect.name: item.probability for item in each.candidates} for each in (before, after))
    assert after.verdict == "explained"
    assert was["joint_rotation"] < 0.8
    assert now["joint_rotation"] > 0.99


def test_it_is_said_in_words_and_in_the_documented_json(before):
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((Path(__file__).parents[2] / "docs/schema/loop.json").read_text(encoding="utf-8"))
    said = json.loads(json.dumps(before.to_dict()))
    jsonschema.Draft202012Validator(schema).validate(said)
    (third,) = set(before.next_test.measured_floors) - {1, 5}
    assert said["next_test"]["measured_floors"] == sorted([1, third, 5])
    assert f"measure again, with a sensor at floor {third} too" in " ".join(str(before).split())
