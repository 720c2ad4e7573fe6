"""Test the next test: its distances from the explicit formula and numerical derivatives, and its words."""

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
from cvxshear.loop.next_test import distance, imagined
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


def test_the_distance_is_that_of_numerical_derivatives_with_the_scale_a_parameter():
    """Two fits with floors 1 and 4 measured are compared."""
    floors = [0, 3]
    plain, heavy = fits(measured_floors=[1, 4], modes=[1, 2], frequency_std=0.002, mode_shape_std=0.02)
    first = plain.experiment.configurations[0]
    added = np.array([0.0, 6.0, 0.0, 0.0])
    test = imagined(plain, first, added)
    found = distance(plain, heavy, test, first)

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


def test_every_effect_says_something_of_a_test_without_priors():
    """The fits have three instrumented floors and a soft prior; the planned test has no prior.

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
        apart[placed.effect.name] = distance(plain, other, test, first)
    assert {"other_gains", "other_stiffness", "attached_mass"} <= set(apart)
    assert np.all(np.isfinite(list(apart.values())))
    assert apart["other_shapes"] == pytest.approx(0.0, abs=1e-6)
    # If the prior is exact, the fit may move by the rounding difference between the prior and exact data.
    assert apart["wrong_prior"] == pytest.approx(0.0, abs=1e-3)


def test_it_is_said_in_words_and_in_the_documented_json():
    """In three times the usual noise, two sensors do not distinguish joints that turn from columns that stretch."""
    jsonschema = pytest.importorskip("jsonschema")
    declared, _ = simulated(
        "joint_rotation", stories=5, rng=np.random.default_rng(SEED), noise=NOISE, configurations=1,
        measured_floors=[1, 5],
    )  # fmt: skip
    for each in declared["configuration"]:
        each["frequency_std"] = (NOISE * np.asarray(each["frequency_std"])).tolist()
        each["mode_shape_std"] = (NOISE * np.asarray(each["mode_shape_std"])).tolist()
    result = close_loop(Experiment.from_dict(declared), effects=["joint_rotation", "axial_columns"])
    schema = json.loads((Path(__file__).parents[2] / "docs/schema/loop.json").read_text(encoding="utf-8"))
    said = json.loads(json.dumps(result.to_dict()))
    jsonschema.Draft202012Validator(schema).validate(said)
    assert result.verdict == "ambiguous"
    assert result.next_test.standard_deviations > 1
    assert f"more on floor {said['next_test']['floor']} of" in " ".join(str(result).split())
