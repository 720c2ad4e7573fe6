"""Test identification: the data that each method needs, effects of priors, results."""

import json
import re

import numpy as np
import pytest

import cvxshear
from cvxshear import Experiment, InfeasibleError, InputError, UnsuitableError, backends, identify
from cvxshear.fit.efficient import efficient
from cvxshear.fit.identification import programs_of
from cvxshear.io.toml import write_measurement
from cvxshear.measurement.experiment import opened
from cvxshear.priors import Bounds, Nominal, Ratio, Value
from cvxshear.response import damping_of
from cvxshear.screening import Screening, refuse_mistakes, screen
from tests.frames import EXAMPLES, chain, configuration, experiment

MASS = np.array([10.0, 7.5, 5.0])
STIFFNESS = np.array([1800.0, 1200.0, 600.0])
ADDED = np.array([5.0, 0.0, 8.0])
SEPARATE = ("two-stage", "one-shot", "berman", "qi")


def exact(*configurations, **keys):
    return Experiment.from_dict(experiment(MASS, STIFFNESS, *configurations, **keys))


TAKE_A_PATH = {
    "identify": lambda source: identify(source).to_dict(),
    "close_loop": lambda source: cvxshear.close_loop(source, effects=["gravity"]).to_dict(),
    "compare_backends": lambda source: cvxshear.compare_backends(source, ["kkt"], repeats=1).experiment,
    "programs_of": lambda source: [program.kind for program in programs_of(source)[0]],
    "plan": lambda source: cvxshear.plan(source, sensors=1).to_dict(),
    "screen": screen,
    "refuse_mistakes": refuse_mistakes,
    "check": lambda source: Screening.of(source).to_dict(),
    "damping_of": lambda source: str(damping_of(source, efficient(opened(source), backends.get("auto")))),
}
"""Public functions that take an experiment, with all other arguments fixed."""


@pytest.mark.parametrize("function", TAKE_A_PATH)
def test_every_public_function_takes_a_path(tmp_path, function):
    """A path, a Path and the experiment give one result; a built-in's name is accepted; other values are refused."""
    table = configuration(MASS, STIFFNESS, damping_ratios=[0.01, 0.02, 0.03])
    path = tmp_path / "three.toml"
    write_measurement(path, experiment(MASS, STIFFNESS, table))
    called = TAKE_A_PATH[function]
    assert called(str(path)) == called(path) == called(cvxshear.load(path))
    called("paper")
    with pytest.raises(InputError, match="no such file"):
        called(str(tmp_path / "four.toml"))


@pytest.mark.parametrize("function", [name for name in TAKE_A_PATH if name != "plan"])
def test_what_is_no_experiment_is_refused(function):
    with pytest.raises(InputError, match=r"an Experiment, its dict, the path of its file or the name .*, not 3"):
        TAKE_A_PATH[function](3)


def noisy(seed=3, noise=0.05, prior=(), added=None):
    table = configuration(
        MASS, STIFFNESS, added, rng=np.random.default_rng(seed), shape_noise=noise, mode_shape_std=noise
    )
    return Experiment.from_dict(experiment(MASS, STIFFNESS, table, prior=prior))


@pytest.mark.parametrize("method", ["two-stage", "one-shot", "efficient"])
def test_exact_modes_give_the_exact_frame(method):
    found = identify(exact(), method)
    np.testing.assert_allclose(found.frame.floor_mass, MASS, rtol=2e-6)
    np.testing.assert_allclose(found.frame.story_stiffness, STIFFNESS, rtol=2e-6)
    assert found.converged
    assert found.fit.max_frequency_error < 1e-6


@pytest.mark.parametrize(("start", "iterations"), [([9.5, 7.5, 5.5], 14), ([7.5, 7.5, 7.5], 16)])
def test_two_stage_takes_as_many_iterations_as_the_paper_says(start, iterations):
    found = identify(cvxshear.load(EXAMPLES / "three_story.toml"), "two-stage", initial_mass=start)
    assert found.parts[0].iterations == iterations
    assert found.parts[0].history.shape == (iterations + 1, 3)
    np.testing.assert_array_equal(found.parts[0].history[0], start)
    np.testing.assert_array_equal(found.parts[0].history[-1], found.frame.floor_mass)


def test_two_stage_keeps_the_total_in_every_iteration():
    history = identify(noisy(), "two-stage").parts[0].history
    np.testing.assert_allclose(history.sum(axis=1), 22.5, rtol=1e-12)


def test_added_mass_is_taken_off_again():
    found = identify(exact(configuration(MASS, STIFFNESS, ADDED)), "two-stage")
    np.testing.assert_allclose(found.frame.floor_mass, MASS, rtol=1e-5)


def test_several_configurations_are_identified_each_by_itself():
    found = identify(exact(configuration(MASS, STIFFNESS), configuration(MASS, STIFFNESS, [4, 0, 0])), "one-shot")
    assert [part.name for part in found.parts] == ["test 1", "test 2"]
    for attribute in ("frame", "fit"):
        said = rf"one-shot identified 2 configurations, .* use parts\[0\].{attribute}"
        with pytest.raises(UnsuitableError, match=said):
            getattr(found, attribute)
    result = found.to_dict()
    assert result["frame"] is None
    assert result["configurations"][1]["frame"]["floor_mass"] == pytest.approx(MASS)


def test_one_configuration_stands_at_the_top_and_in_the_list():
    result = identify(exact(), "two-stage").to_dict()
    assert result["frame"] == result["configurations"][0]["frame"]
    assert result["history"] == result["configurations"][0]["history"]
    json.dumps(result, allow_nan=False)


UNKNOWN = configuration(MASS, STIFFNESS)
UNKNOWN["mode_shapes"][1][2] = float("nan")
TWO = [configuration(MASS, STIFFNESS), configuration(MASS, STIFFNESS, [4, 0, 0])]
BOUND = {"kind": "bounds", "quantity": "floor_mass", "lower": 1.0}
CANNOT = 'cannot use configuration "test 1": it needs '
UNSUITABLE = [
    (
        SEPARATE, exact(configuration(MASS, STIFFNESS, modes=[1, 2])), {},
        f"{CANNOT}all 3 modes, mode 3 is missing; use method efficient",
    ),
    (
        SEPARATE, exact(configuration(MASS, STIFFNESS, measured_floors=[2])), {},
        f"{CANNOT}every floor, floors 1, 3 are unmeasured; use method efficient",
    ),
    (["two-stage"], exact(UNKNOWN), {}, "mode 2 has no value at floor 3; use method efficient"),
    (["one-shot"], exact(*TWO, frame={}), {}, "needs frame: total_mass or floor_masses"),
    (["efficient", "one-shot"], exact(), {"initial_mass": [1, 1, 1]}, "takes no initial mass"),
    (["berman", "qi"], exact(prior=[BOUND]), {}, "takes no priors"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("method", "of", "options", "message"), [(method, *rest) for methods, *rest in UNSUITABLE for method in methods]
)
def test_what_a_method_cannot_use_is_refused_by_name(method, of, options, message):
    with pytest.raises(UnsuitableError, match=re.escape(message)) as caught:
        identify(of, method, **options)
    assert f"method {method} " in str(caught.value)


@pytest.mark.parametrize(
    ("method", "options", "message"),
    [
        ("two-stage", {"initial_mass": [1, 1]}, "initial mass must have 3 entries, not 2"),
        ("twostage", {}, "did you mean 'two-stage'"),
    ],
)
def test_wrong_options_are_refused_with_what_is_expected(method, options, message):
    with pytest.raises(InputError, match=message):
        identify(exact(), method, **options)


def test_berman_makes_the_modes_orthonormal():
    of = noisy()
    M = identify(of, "berman").parts[0].mass_matrix
    shapes = of.configurations[0].mode_shapes.T
    start = np.full(3, 7.5)
    P = shapes / np.sqrt(np.sum(shapes * start[:, None] * shapes, axis=0))
    np.testing.assert_allclose(P.T @ M @ P, np.eye(3), atol=1e-10)


def test_berman_refuses_modes_that_hardly_differ():
    table = {
        "frame": {"total_mass": 30.0},
        "configuration": [{"frequencies": [2.0, 5.0], "mode_shapes": [[0.6, 1.0], [0.6 + 1e-5, 1.0]]}],
    }
    with pytest.raises(InputError, match="method berman needs modes that differ from each other"):
        identify(table, "berman")
    table["configuration"][0]["mode_shapes"] = [[0.61, 1.0], [-1.65, 1.0]]
    found = identify(table, "berman")
    assert np.all(found.frame.floor_mass > 0)


@pytest.mark.parametrize("method", ["two-stage", "one-shot", "efficient"])
@pytest.mark.parametrize("backend", ["clarabel", "quadprog", "osqp"])
def test_bounds_hold_and_change_a_noisy_answer(method, backend):
    free = identify(noisy(), method).frame
    limit = 0.97 * free.floor_mass[0]
    prior = Bounds("floor_mass", upper=[limit, 22.5, 22.5])
    held = identify(noisy(), method, backend, priors=[prior]).frame
    assert held.floor_mass[0] == pytest.approx(limit, rel=1e-6)
    assert held.floor_mass.sum() == pytest.approx(22.5, rel=1e-9)


def test_what_a_declared_bound_holds_is_at_a_bound_and_has_no_deviation():
    free = identify(noisy())
    assert free.to_dict()["at_bounds"] == []
    limit = 0.97 * free.frame.floor_mass[0]
    held = identify(noisy(), priors=[Bounds("floor_mass", upper=[limit, 22.5, 22.5])])
    said = held.to_dict()
    assert said["at_bounds"] == ["floor_mass 1"]
    assert said["frame"]["floor_mass"][0] == pytest.approx(limit, rel=1e-6)
    assert said["frame"]["floor_mass_std"][0] is None
    assert min(said["frame"]["floor_mass_std"][1:]) > 0
    assert np.all(held.frame.floor_mass_std[1:] <= free.frame.floor_mass_std[1:])
    assert np.isnan(held.to_dataframe().floor_mass_std_kg[0])
    assert f"{limit:.5g} (at a bound)" in str(held)


def test_the_least_that_counts_as_positive_is_shown_as_a_bound():
    """Modes 1, 2, 4 and 5 of seven are given as the first four. The estimate of floor 5 then has no mass."""
    first, second = [-0.1703, -0.5334, -0.8328, -0.9893], [-0.4341, -0.8413, -0.0426, 0.9879]
    fourth, fifth = [0.9948, -0.8472, 0.7141, -1.0103], [0.7084, -0.723, 0.5075, 0.5539]
    tested = {"frequencies": [1.7435, 4.7482, 9.9342, 11.9182], "frequency_std": 0.001, "mode_shape_std": 0.01}
    tested |= {"measured_floors": [1, 3, 5, 7], "mode_shapes": [first, second, fourth, fifth]}
    declared = {"frame": {"story_heights": 3.2, "total_mass": 133e3}, "configuration": [tested]}
    found = identify(Experiment.from_dict(declared))
    said = found.to_dict()
    assert said["at_bounds"] == ["floor_mass 5"]
    assert said["frame"]["floor_mass"][4] == pytest.approx(1e-3 * 133e3 / 7, rel=1e-9)
    assert said["frame"]["floor_mass_std"][4] is None
    assert "0.019 (at a bound)" in str(found)
    assert "Floor mass 5 is at a bound" in str(found)


@pytest.mark.parametrize("method", ["two-stage", "one-shot", "efficient"])
def test_an_exact_ratio_holds(method):
    prior = Ratio("story_stiffness", of=1, to=3, value=3.0)
    k = identify(noisy(), method, priors=[prior]).frame.story_stiffness
    assert k[0] == pytest.approx(3.0 * k[2], rel=1e-6)


@pytest.mark.parametrize("method", ["two-stage", "one-shot", "efficient"])
def test_a_soft_prior_pulls_the_more_the_surer_it_is(method):
    free = identify(noisy(), method).frame.floor_mass[0]
    target = 1.2 * free
    loose, tight = (
        identify(noisy(), method, priors=[Value("floor_mass", at=1, value=target, std=std)]).frame.floor_mass[0]
        for std in (0.2, 1e-4)
    )
    assert free < loose < tight
    assert tight == pytest.approx(target, rel=1e-2)


@pytest.mark.parametrize("method", ["two-stage", "one-shot", "efficient"])
def test_nominal_values_up_to_a_factor_keep_the_distribution(method):
    prior = Nominal("story_stiffness", values=[3.0, 2.0, 1.0], free_scale=True)
    k = identify(noisy(), method, priors=[prior]).frame.story_stiffness
    np.testing.assert_allclose(k / k[2], [3.0, 2.0, 1.0], rtol=1e-6)


@pytest.mark.parametrize("method", ["two-stage", "one-shot", "efficient"])
def test_known_floor_masses_are_kept(method):
    table = configuration(MASS, STIFFNESS, rng=np.random.default_rng(0), shape_noise=0.02)
    of = Experiment.from_dict(experiment(MASS, STIFFNESS, table, frame={"floor_masses": MASS.tolist()}))
    np.testing.assert_allclose(identify(of, method).frame.floor_mass, MASS, rtol=1e-9)


@pytest.mark.parametrize("prior", [Bounds("floor_mass", upper=5.0), Value("floor_mass", at=1, value=22.5)])
@pytest.mark.parametrize("method", ["two-stage", "one-shot", "efficient"])
def test_priors_that_contradict_the_total_are_named(method, prior):
    with pytest.raises(InfeasibleError, match=f"total_mass = 22.5 kg; prior: {prior.describe()}"):
        identify(exact(), method, priors=[prior])


def test_a_ratio_that_contradicts_a_bound_is_named_without_the_rest():
    priors = [
        Ratio("story_stiffness", of=1, to=2, value=2.0),
        Bounds("story_stiffness", lower=[0, 1000, 0], upper=[1500, 1e9, 1e9]),
        Value("story_stiffness", at=3, value=600.0),
    ]
    with pytest.raises(InfeasibleError) as raised:
        identify(exact(), "two-stage", priors=priors)
    assert "story_stiffness 1 is 2 times story_stiffness 2" in str(raised.value)
    assert "story_stiffness 3" not in str(raised.value)
    assert "positive" not in str(raised.value)
    with pytest.raises(InfeasibleError, match=r"is at least .* N/m; prior: story_stiffness at most 0.001 N/m"):
        identify(exact(), "one-shot", priors=[Bounds("story_stiffness", upper=1e-3)])


def test_predictions_are_the_modes_of_the_identified_frame():
    found = identify(noisy(added=ADDED), "two-stage")
    M, K = chain(found.frame.floor_mass + ADDED, found.frame.story_stiffness)
    prediction = found.parts[0].predictions[0]
    for f, shape in zip(prediction.frequencies, prediction.mode_shapes, strict=True):
        np.testing.assert_allclose(K @ shape, (2 * np.pi * f) ** 2 * M @ shape, atol=1e-6 * np.abs(K).max())
        assert np.max(np.abs(shape)) == pytest.approx(1.0)


def test_fit_figures_are_what_their_names_say():
    of = noisy()
    found = identify(of, "two-stage")
    measured, prediction = of.configurations[0], found.parts[0].predictions[0]
    errors = prediction.frequencies / measured.frequencies - 1
    assert found.fit.max_frequency_error == pytest.approx(np.max(np.abs(errors)))
    assert found.fit.rms_frequency_error == pytest.approx(np.sqrt(np.mean(errors**2)))
    macs, differences = [], []
    for shape, b in zip(measured.mode_shapes, prediction.mode_shapes, strict=True):
        a = shape / shape[np.argmax(np.abs(shape))]
        macs.append(np.dot(a, b) ** 2 / (np.dot(a, a) * np.dot(b, b)))
        differences.append(np.max(np.abs(a - b * np.linalg.lstsq(b[:, None], a, rcond=None)[0])))
    assert found.fit.min_mac == pytest.approx(min(macs))
    assert found.fit.max_shape_error == pytest.approx(max(differences))
