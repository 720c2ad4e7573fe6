"""Test probabilities of sets and effects for given scores."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from cvxshear.fit.results import IdentifiedFrame
from cvxshear.loop.fitter import ModelClass
from cvxshear.loop.hypotheses import Hypothesis
from cvxshear.loop.posterior import Posterior, from_the_first_state
from tests.effects.common import placed as put

A, B, C, D = (put("sensor_gain", floor=floor) for floor in (1, 2, 3, 4))
MASS = put("added_mass", floor=1, state="after")
PRIOR = 0.02


def model(effects, probability, *, mass=10.0, std=0.5, chi2=20.0, dof=20, log_prior=0.0):
    """Return a set whose score is the logarithm of a probability."""
    frame = IdentifiedFrame(np.full(2, mass), np.full(2, 1e3 * mass), np.full(2, std), np.full(2, 1e3 * std))
    estimate = SimpleNamespace(expected_frame=frame, chi2=chi2, dof=dof)
    return ModelClass(frozenset(effects), estimate, float(np.log(probability)) - log_prior - 300.0, log_prior)


def posterior(*models, prior=PRIOR, priors=()):
    known = {A: prior, B: prior, C: prior, D: prior, MASS: prior, **dict(priors)}
    return Posterior(models, [Hypothesis(placed, probability) for placed, probability in known.items()])


def test_probabilities_are_those_of_the_scores():
    """Scores far below the range of an exponential. Sets add up to one; an effect has the sum over its sets."""
    of = posterior(model([], 0.1), model([A], 0.6, log_prior=-3.0), model([A, B], 0.2), model([C], 0.1))
    np.testing.assert_allclose(of.probabilities, [0.6, 0.2, 0.1, 0.1], rtol=1e-9)
    assert of.best.effects == {A}
    assert of.of_effects[A] == pytest.approx(0.8)
    assert of.of_effects[B] == pytest.approx(0.2)
    assert of.of_effects[D] == 0.0
    assert of.of_effects[C] == pytest.approx(0.1)
    assert of.verdict_set() == {A}


def test_sets_that_differ_in_which_state_is_the_frame_have_their_probability_together():
    of = SimpleNamespace(frame=SimpleNamespace(reference=None), states=("before", "after"))
    softer, stiffer = (put("story_change", story=1, state=state) for state in ("after", "before"))
    models = [model([softer], 0.5), model([stiffer], 0.3), model([], 0.2)]
    united = from_the_first_state(models, [Hypothesis(each, PRIOR) for each in (softer, stiffer)], of)
    assert [each.effects for each in united] == [{softer}, set()]
    np.testing.assert_allclose(np.exp([each.score + 300.0 for each in united]), [0.8, 0.2])


def test_many_kinds_of_causes_are_weighed_against_one_unknown_cause():
    """Three kinds of effects in one state have the probability P / (P + u), u = 1e-4 for three kinds.

    The other state has a single effect. Effects, sets and the average agree.
    """
    load, change = put("state_mass", state="after"), put("story_change", story=1, state="after")
    other = put("added_mass", floor=2, state="before")
    known = dict.fromkeys((load, change, other), PRIOR)
    many = [load, MASS, change, other]
    of = posterior(model(many, 0.9, mass=10.0, std=0.1), model([A], 0.1, mass=12.0, std=0.1), priors=known)
    factor = (P := PRIOR**3) / (P + 1e-4)
    assert of.of_effects[change] == of.of_effects[MASS] == of.of_effects[load] == pytest.approx(0.9 * factor)
    assert of.of_effects[other] == pytest.approx(0.9)
    np.testing.assert_allclose(of.of_sets, [0.9 * factor, 0.1])
    mean = np.average([10.0, 12.0], weights=[0.9 * factor, 0.1])
    np.testing.assert_allclose(of.averaged().floor_mass, mean)
    fewer = posterior(model([MASS, change, other], 0.9), model([A], 0.1), priors=known)
    assert fewer.of_effects[MASS] == pytest.approx(0.9)


def test_a_cause_in_one_state_counts_with_those_of_the_frame():
    """Two kinds in the frame are few; with a third one in a state, the cause in this state is weighed."""
    spring, other = put("ground_spring", floor=2), put("added_mass", floor=2, state="before")
    of = posterior(model([spring, A, other], 0.9), model([B], 0.1), priors={spring: PRIOR, other: PRIOR})
    P = PRIOR * (1 - (1 - PRIOR) ** 4) * PRIOR
    assert of.of_effects[other] == pytest.approx(0.9 * P / (P + 1e-4))
    assert of.of_effects[spring] == pytest.approx(0.9)


def test_the_deviation_of_an_effect_holds_the_scatter_between_its_sets():
    """A is in two sets, 0.12 +- 0.003 and 0.10 +- 0.004 at 3 to 1: the mean square about the first, over these."""

    def fitted(value, std):
        return SimpleNamespace(
            theta=np.array([value]), std=np.array([std]), own=lambda placed: slice(0, 1), chi2=1.0, dof=1,
            expected_frame=None,
        )  # fmt: skip

    near, far = fitted(0.12, 0.003), fitted(0.10, 0.004)
    models = [
        ModelClass(frozenset(effects), estimate, float(np.log(probability)), 0.0)
        for effects, estimate, probability in (([A], near, 0.6), ([A, B], far, 0.2), ([C], fitted(9.0, 1.0), 0.2))
    ]
    (found,) = posterior(*models).deviations_about(near, A)
    assert found == pytest.approx(np.sqrt(0.75 * 0.003**2 + 0.25 * (0.004**2 + 0.02**2)))


def test_sets_without_evidence_take_no_part():
    failed = dataclasses.replace(model([B], 0.5), log_evidence=-np.inf)
    of = posterior(model([A], 0.75), model([], 0.25), failed)
    assert len(of.models) == 2
    assert of.of_effects[A] == pytest.approx(0.75)


def test_the_median_model_may_be_none_that_is_best():
    """B is in no set with A, but its total probability exceeds one half."""
    of = posterior(model([A], 0.4, chi2=20.0), model([B], 0.3, chi2=25.0), model([B, C], 0.3, chi2=24.0))
    assert of.best.effects == {A}
    assert of.verdict_set() == {B}


def test_a_twin_is_added_in_place_of_what_it_is_a_twin_of_never_besides_it():
    of = posterior(model([A], 0.4), model([B], 0.3), model([B, C], 0.3)).with_twins({A: [B], B: [A]})
    assert [item.placed for item in of.rivals(A) if item.twin] == [B]
    # 0.3 + 0.3 for B, 0.4 for A: only B, the more probable one, is chosen.
    assert of.verdict_set() == {B}


def test_what_the_data_cannot_tell_keeps_its_odds_and_is_not_added():
    of = posterior(model([A], 0.55), model([], 0.45), priors=[(A, 0.5)])
    assert of.verdict_set() == set()
    assert of.untold() == [A]
    told = posterior(model([A], 0.8), model([], 0.2), priors=[(A, 0.5)])
    assert told.verdict_set() == {A}
    assert told.untold() == []


def test_rivals_replace_an_effect_and_are_summed_over_sets():
    of = posterior(
        model([A], 0.5, chi2=20.0), model([B], 0.2, chi2=24.0), model([B, D], 0.1), model([C], 0.02), model([], 0.18)
    )
    rivals = of.rivals(A)
    assert [item.placed for item in rivals] == [B]
    assert rivals[0].probability == pytest.approx(0.3)
    assert not rivals[0].twin


def test_of_two_replaced_effects_each_has_its_rival_by_state_or_kind():
    other = put("added_mass", floor=2, state="after")
    of = posterior(model([A, MASS], 0.6), model([B, other], 0.4), priors=[(other, PRIOR)])
    assert [item.placed for item in of.rivals(A)] == [B]
    assert [item.placed for item in of.rivals(MASS)] == [other]


def test_twins_share_what_either_would_have_alone():
    """Each twin alone has a probability below one half; the probability of either one is above."""
    of = posterior(model([A], 0.45, chi2=20.0), model([B], 0.45, chi2=20.0), model([], 0.1, chi2=60.0, dof=21))
    of = of.with_twins({A: [B], B: [A]})
    (best,) = of.best.effects
    (twin,) = of.rivals(best)
    assert {best, twin.placed} == {A, B}
    assert twin.twin
    assert of.verdict_set() == {best}


def test_a_twin_is_a_rival_however_improbable_it_was():
    of = posterior(model([A], 0.9), model([B], 0.001), model([], 0.099)).with_twins({A: [B]})
    assert [(item.placed, item.twin) for item in of.rivals(A)] == [(B, True)]
    assert of.rivals(A)[0].probability == pytest.approx(0.001)


def test_an_effect_with_a_rival_is_added_where_one_of_the_two_is_surely_there():
    """Two places have 0.46 and 0.44: an effect is present, and the rivals show its possible places."""
    of = posterior(model([A], 0.46, chi2=20.0), model([B], 0.44, chi2=22.0), model([], 0.1, chi2=60.0, dof=21))
    assert not of.rivals(A)[0].twin
    assert of.verdict_set() == {A}
    weak = posterior(model([A], 0.3, chi2=20.0), model([B], 0.1, chi2=22.0), model([], 0.6, chi2=30.0, dof=21))
    assert weak.verdict_set() == set()


def test_the_averaged_frame_is_a_mixture():
    """Mean 0.75 10 + 0.25 14 = 11; variance 0.75 (0.25 + 1) + 0.25 (1 + 9) = 3.4375."""
    of = posterior(model([A], 0.75, mass=10.0, std=0.5), model([B], 0.25, mass=14.0, std=1.0))
    found = of.averaged()
    np.testing.assert_allclose(found.floor_mass, 11.0)
    np.testing.assert_allclose(found.floor_mass_std, np.sqrt(3.4375))
    np.testing.assert_allclose(found.story_stiffness, 11e3)
    np.testing.assert_allclose(found.story_stiffness_std, 1e3 * np.sqrt(3.4375))


def test_averaged_mixture_leaves_undetermined_what_no_set_determines():
    nan = model([], 1.0, mass=float("nan"), std=float("nan"))
    assert np.isnan(posterior(nan).averaged().floor_mass).all()
