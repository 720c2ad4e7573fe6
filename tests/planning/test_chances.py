"""Test probabilities of the right verdict against integrals and limits."""

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from cvxshear.effects import Gravity, GroundSpring, JointRotation, LocatedEffect, Place, Scale, SensorGain
from cvxshear.fit.gaussian import log_evidence_of_one
from cvxshear.measurement.experiment import Frame
from cvxshear.planning.results import NONE, chances
from cvxshear.planning.tested_model import Target, target
from cvxshear.util.errors import InputError

ROTATION = Target(LocatedEffect(JointRotation()), 0.05)
SPRING = Target(LocatedEffect(GroundSpring(), Place(floor=3)), 10.0)
GRAVITY = Target(LocatedEffect(Gravity()), 1.1)
FRAME = Frame(stories=3, story_heights=np.full(3, 0.4))
SCALE = Scale(10.0, 2000.0, np.full(3, 0.4))


@pytest.mark.parametrize(("of", "y"), [(ROTATION, 3.0), (ROTATION, -2.0), (SPRING, 9.0), (GRAVITY, 12.0)])
def test_the_evidence_is_the_integral_over_the_effects_values(of, y):
    own = 11.0

    def likely(x):
        density = np.exp(-(((x - of.mean) / of.std) ** 2) / 2) / (of.std * np.sqrt(2 * np.pi))
        return density * (2.0 if of.side else 1.0) * np.exp(y * x - own * x**2 / 2)

    low = 0.0 if of.side else of.mean - 12 * of.std
    integral = quad(likely, low, of.mean + 12 * of.std, limit=200)[0]
    assert log_evidence_of_one(own, np.array(y), of.mean, of.std, of.side) == pytest.approx(np.log(integral), abs=1e-8)


def test_a_sure_test_gives_the_right_verdict_and_an_empty_one_none():
    sure = chances([ROTATION, SPRING], np.diag([1e3, 1e3])[None])
    assert [each.label for each in sure] == [NONE, "joint rotation", "ground spring at floor 3"]
    assert min(each.probability for each in sure) > 0.9
    empty = chances([ROTATION, SPRING], np.diag([0.02, 0.02])[None])
    assert max(each.probability for each in empty[1:]) < 0.01


def test_an_effect_that_mimics_another_is_its_nearest_rival():
    information = np.array([[25.0, 24.0], [24.0, 25.0]])
    found = chances([ROTATION, SPRING], information[None])
    assert found[1].nearest == "ground spring at floor 3"
    assert found[1].nearest_distance == pytest.approx(np.sqrt(25 - 24**2 / 25))
    assert found[1].distance == pytest.approx(5.0)


def test_an_effect_that_could_only_be_mimicked_the_wrong_way_round_is_told_from_none_alone():
    information = np.array([[25.0, -24.0], [-24.0, 25.0]])
    found = chances([ROTATION, SPRING], information[None])
    assert found[1].nearest_distance == pytest.approx(5.0)


def test_effects_are_named_with_place_and_size():
    found = target("ground_spring@3=200", FRAME, SCALE)
    assert (found.placed.label, found.size) == ("ground spring at floor 3", 200.0)
    assert target("gravity", FRAME, SCALE).size == pytest.approx(1.1)
    assert target("joint_rotation", FRAME, SCALE).size == pytest.approx(0.5)
    assert target("ground_spring@2", FRAME, SCALE).size == pytest.approx(0.1 * SCALE.story_stiffness)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gravitty", "did you mean 'gravity'"),
        ("gravity@2", "has no place of its own"),
        ("ground_spring", "write which, such as ground_spring@2"),
        ("ground_spring@9=3", "must lie between 2 and 3"),
        ("ground_spring@2=stiff", "must be a number"),
        ("ground_spring@2=-3", "must be greater than 0"),
        ("story_change@1=0.1", "sits in a single state"),
    ],
)
def test_a_wrong_effect_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        target(text, FRAME, SCALE)


def test_an_effect_that_needs_heights_says_so():
    with pytest.raises(InputError, match="needs frame: story_heights"):
        target("gravity", Frame(stories=3), SCALE)


def test_over_several_frames_the_probability_of_the_right_verdict_is_their_mean():
    few, many = (np.diag([own, own]) for own in (4.0, 25.0))
    both = chances([ROTATION, SPRING], np.array([few, many]))
    alone = [chances([ROTATION, SPRING], each[None]) for each in (few, many)]
    for place, found in enumerate(both):
        assert found.probability == pytest.approx(np.mean([each[place].probability for each in alone]))
    assert both[1].distance == pytest.approx(3.5)


def test_physics_lets_joints_and_springs_be_on_one_side_and_gravity_near_its_value():
    """Gravity's coefficient lies between 1 and 1.2, around 1.1: mean and spread are in sizes, without a sign limit."""
    item = Gravity().parameters[0]
    assert (GRAVITY.mean, GRAVITY.side) == (1.0, 0)
    assert pytest.approx((item.upper - item.lower) / np.sqrt(12) / 1.1) == GRAVITY.std
    for one_sided in (ROTATION, SPRING):
        assert (one_sided.mean, one_sided.std, one_sided.side) == (0.0, 1.0, 1)


def test_the_probability_of_a_right_verdict_is_that_of_a_normal_number():
    """For an effect of unit size and either sign with information g, the evidence is y^2 / 2 (1 + g) - log(1 + g) / 2.

    Odds of 19 or more name the effect; odds below 1 name no effect.
    """
    g = 25.0
    gain = Target(LocatedEffect(SensorGain(), Place(floor=3)), 0.05)

    def beyond(log_odds):
        return np.sqrt(2 * (1 + g) / g * (log_odds + 0.5 * np.log(1 + g)))

    none, there = (each.probability for each in chances([gain], np.array([[[g]]])))
    limit = [beyond(each) for each in (0.0, np.log(19.0))]
    normal = stats.norm
    assert none == pytest.approx(1 - 2 * normal.sf(limit[0]), abs=0.006)
    assert there == pytest.approx(normal.sf(limit[1] - np.sqrt(g)) + normal.cdf(-limit[1] - np.sqrt(g)), abs=0.006)
