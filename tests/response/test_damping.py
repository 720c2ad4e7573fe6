"""Test the damping of identified frames: exact modes, deviations against samples, undetermined dashpots."""

import dataclasses

import numpy as np
import pytest

import cvxshear
from cvxshear import backends
from cvxshear.fit.efficient import efficient
from cvxshear.model import modes
from cvxshear.response import Fitted, damping_of
from cvxshear.response.damping import Ratios, story_dashpots
from cvxshear.response.uncertain import UncertainFrame, parts_of, propagated
from cvxshear.util.errors import InputError, UnsuitableError
from tests.frames import modes_of
from tests.response.common import damped_frame, declared, matrices, pole_ratios, sampled


def estimated(declaration):
    experiment = cvxshear.Experiment.from_dict(declaration)
    return experiment, efficient(experiment, backends.get("auto"))


@pytest.mark.parametrize("backend", backends.available())
@pytest.mark.parametrize("stories", [3, 8, 20])
def test_dashpots_are_recovered_from_exact_modes(stories, backend):
    mass, stiffness, dashpots = damped_frame(stories)
    M, C, K = matrices(mass, stiffness, dashpots)
    exact = Ratios(pole_ratios(M, C, K), np.full(stories, 1e-6), np.ones(stories, dtype=bool), None)
    found = story_dashpots(modes(M, K), stiffness, exact, backends.get(backend))
    np.testing.assert_allclose(found.values, dashpots, rtol=1e-8)
    assert found.open == ()


def test_dashpots_in_proportion_are_recovered_whatever_the_deviations():
    """Proportional dashpots couple no modes, so the assumed rows are met exactly, like the measured rows."""
    mass, stiffness, _ = damped_frame(6)
    experiment, estimate = estimated(declared(mass, stiffness, 1e-3 * np.pi * modes_of(mass, stiffness)[0]))
    found = damping_of(experiment, estimate, kind="story")
    np.testing.assert_allclose(found.story_dashpot, 1e-3 * stiffness, rtol=1e-7)


@pytest.mark.parametrize("modes", [[1, 2], [1, 2, 3, 4, 5]])
def test_rayleigh_factors_are_recovered(modes):
    """Two ratios are enough."""
    mass, stiffness, _ = damped_frame(5)
    omega = 2 * np.pi * modes_of(mass, stiffness)[0]
    experiment, estimate = estimated(declared(mass, stiffness, 0.4 / (2 * omega) + 3e-4 * omega / 2, modes=modes))
    found = damping_of(experiment, estimate, kind="rayleigh")
    np.testing.assert_allclose(found.rayleigh, [0.4, 3e-4], rtol=1e-7)
    assert np.all(found.rayleigh_std > 0)
    assert found.story_dashpot is None


def test_modal_damping_is_what_was_measured():
    mass, stiffness, _ = damped_frame(4)
    ratios = [0.01, 0.03, 0.02, 0.015]
    experiment, estimate = estimated(declared(mass, stiffness, ratios))
    found = damping_of(experiment, estimate)
    assert found.kind == "modal"
    np.testing.assert_allclose(found.ratios, ratios, rtol=1e-9)
    np.testing.assert_allclose(found.ratios_std, 0.1 * np.array(ratios), rtol=0.01)
    assert found.to_dict()["story_dashpot"] is None
    assert found.remarks == ()


@pytest.mark.parametrize("kind", ["story", "rayleigh"])
def test_deviations_are_those_of_samples(kind):
    mass, stiffness, dashpots = damped_frame(3)
    ratios = pole_ratios(*matrices(mass, stiffness, dashpots)) if kind == "story" else [0.03, 0.02, 0.025]
    experiment, estimate = estimated(declared(mass, stiffness, ratios, ratio_std=0.01, shape_std=0.002))
    solver = backends.get("auto")
    frame = UncertainFrame.of(Fitted.of(estimate), experiment.configurations[0], kind, solver)

    def numbers(damped):
        return damped.dashpots.values if kind == "story" else damped.rayleigh

    std = propagated(frame, parts_of)
    drawn = sampled(frame, numbers, 150, np.random.default_rng(3)).std(axis=0)
    # With 150 samples, the sampled deviation itself is known to 6 %.
    np.testing.assert_allclose(std["dashpots" if kind == "story" else kind], drawn, rtol=0.18)


def test_what_few_modes_leave_open_is_named():
    mass, stiffness, dashpots = damped_frame(4)
    ratios = pole_ratios(*matrices(mass, stiffness, dashpots))
    experiment, estimate = estimated(declared(mass, stiffness, ratios, modes=[1, 2, 3]))
    found = damping_of(experiment, estimate, kind="story")
    assert sum(remark.startswith("the measured damping ratios leave open") for remark in found.remarks) == 1
    assert any("no damping ratio was measured of mode 4" in remark for remark in found.remarks)
    assert np.isnan(found.story_dashpot_std).any()
    np.testing.assert_allclose(found.ratios[:3], ratios[:3], rtol=0.02)


def test_the_kind_is_declared():
    mass, stiffness, _ = damped_frame(3)
    table = declared(mass, stiffness, [0.01, 0.01, 0.01], damping={"kind": "story"})
    experiment = cvxshear.Experiment.from_dict(table)
    assert experiment.damping.kind == "story"
    assert cvxshear.Experiment.from_dict(experiment.to_dict()).damping.kind == "story"
    with pytest.raises(InputError, match="damping: kind must be one of modal, story, rayleigh, not 'modl'; did you"):
        cvxshear.Experiment.from_dict({**table, "damping": {"kind": "modl"}})
    with pytest.raises(InputError, match="damping: unknown key 'knd'"):
        cvxshear.Experiment.from_dict({**table, "damping": {"knd": "modal"}})


def test_without_ratios_there_is_no_damping():
    mass, stiffness, _ = damped_frame(3)
    experiment, estimate = estimated(declared(mass, stiffness, [0.01] * 3))
    bare = dataclasses.replace(
        experiment, configurations=[dataclasses.replace(experiment.configurations[0], damping_ratios=None)]
    )
    assert damping_of(bare, dataclasses.replace(estimate, misfit=type(estimate.misfit)(bare))) is None
    fitted = dataclasses.replace(Fitted.of(estimate), experiment=bare)
    with pytest.raises(InputError, match="nothing tells how the frame is damped: give damping_ratios"):
        UncertainFrame.of(fitted, bare.configurations[0], None, backends.get("auto"))


def test_rayleigh_needs_two_modes():
    mass, stiffness, _ = damped_frame(3)
    experiment, estimate = estimated(declared(mass, stiffness, [0.01] * 3, modes=[1]))
    with pytest.raises(UnsuitableError, match="two factors, and one mode's damping ratio was measured"):
        damping_of(experiment, estimate, kind="rayleigh")


def test_defaults_of_deviations_are_told():
    mass, stiffness, _ = damped_frame(3)
    table = declared(mass, stiffness, [0.01] * 3)
    del table["configuration"][0]["damping_ratio_std"]
    experiment, estimate = estimated(table)
    found = damping_of(experiment, estimate)
    assert any("damping_ratio_std" in remark for remark in found.remarks)
    np.testing.assert_allclose(found.ratios_std, 0.2 * 0.01, rtol=0.02)


def test_ratios_of_some_modes():
    mass, stiffness, _ = damped_frame(3)
    table = declared(mass, stiffness, [0.05, 0.01, 0.05])
    table["configuration"][0]["damping_ratios"] = [0.05, float("nan"), 0.3]
    experiment = cvxshear.Experiment.from_dict(table)
    estimate = efficient(experiment, backends.get("auto"))
    found = damping_of(experiment, estimate)
    np.testing.assert_array_equal(np.isnan(found.measured), [False, True, False])
    assert found.ratios[1] == pytest.approx(0.175)
    assert any("are the ratios in percent" in remark for remark in found.remarks)
    table["configuration"][0]["damping_ratios"] = [float("nan")] * 3
    with pytest.raises(InputError, match="must have a number for one mode at least"):
        cvxshear.Experiment.from_dict(table)
