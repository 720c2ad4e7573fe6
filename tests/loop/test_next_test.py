"""Test the next test: its distances from the explicit formula and numerical derivatives, and its words."""

import json
from pathlib import Path

import numpy as np
import pytest

from cvxshear import Experiment, backends, close_loop
from cvxshear.fit.domain import EffectPrior
from cvxshear.fit.efficient import efficient, fitted_with
from cvxshear.fit.gaussian import separation
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.next_test import distance, imagined
from cvxshear.loop.hypotheses import chosen, hypotheses
from tests.fe.experiments import simulated
from tests.frames import configuration, experiment

MASS, STIFFNESS = [10.0, 10.0, 9.0, 8.0], [24e3, 20e3, 16e3, 10e3]
NOISE, SEED = 3.0, 2


@pytest.mark.parametrize("columns", [3, 40])
def test_the_separation_is_the_formula(columns):
    rng = np.random.default_rng(columns)
    d, S = rng.standard_normal((12, 2)), 5 * rng.standard_normal((12, columns))
    slow = d.T @ np.linalg.inv(np.eye(12) + S @ S.T) @ d
    np.testing.assert_allclose(separation(d, S), slow, rtol=1e-8)


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
        for effects in [(), *((item.placed,) for item in hypotheses(of, chosen(None, of), ()))]
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
