"""A custom effect is checked when it is added. Each fault is tested by itself and must be named in one sentence."""

import dataclasses

import numpy as np
import pytest

from cvxshear.effects import Effect, Parameter, catalogue, open_classes, refuse_faulty, refuse_repeated, register
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.errors import InputError
from tests.effects.common import Cable


def changed(state, **arrays):
    """Return the state of a sound cable with other matrices."""
    return dataclasses.replace(state, system=dataclasses.replace(state.system, **arrays))


def after(change):
    """Return an `apply` that spoils the result of the sound one."""

    def apply(self, state, place, values, own):
        return change(Cable.apply(self, state, place, values, own), values, own)

    return apply


def twice(state, values, own):
    dK = state.system.dK.copy()
    dK[own] *= 2.0
    return changed(state, dK=dK)


def by_masses(state, values, own):
    """Depend on a floor mass, but return a derivative that does not."""
    K = state.system.K.copy()
    K[0, 0] += values[0] * state.floor_mass[0]
    dK = state.system.dK.copy()
    dK[own.start, 0, 0] += state.floor_mass[0]
    return changed(state, K=K, dK=dK)


def in_place(self, state, place, values, own):
    state.system.K[-1, -1] += values[0]
    return Cable.apply(self, state, place, np.array([0.0, values[1]]), own)


def greedy(self, state, place, values, own):
    values[0] = 0.0
    return Cable.apply(self, state, place, values, own)


def bent(state, values, own):
    K = state.system.K.copy()
    K[0, -1] += values[0]
    return changed(state, K=K)


def always(state, values, own):
    return changed(state, K=state.system.K * 1.1, dK=state.system.dK * 1.1)


FAULTS = {
    "derivative": ({"apply": after(twice)}, "derivative of K by its own parameters at its place is wrong: .* 100 %"),
    "other derivative": (
        {"apply": after(by_masses)},
        "derivative of K by masses and stiffnesses at its place is wrong",
    ),
    "nan": ({"apply": after(lambda s, *_: changed(s, K=s.system.K * np.nan))}, "K is not finite"),
    "infinite derivative": (
        {"apply": after(lambda s, *_: changed(s, dM=np.full_like(s.system.dM, np.inf)))},
        "dM is not finite",
    ),
    "shape": ({"apply": after(lambda s, *_: changed(s, M=s.system.M[:2, :2]))}, r"M has the shape \(2, 2\)"),
    "rows": ({"apply": after(lambda s, *_: changed(s, dK=s.system.dK[:3]))}, r"dK has the shape \(3, 4, 4\)"),
    "unsymmetric": ({"apply": after(bent)}, "K is not symmetric"),
    "never null": ({"apply": after(always)}, "K is not that of the shear frame at the null values"),
    "in place": ({"apply": in_place}, r"read-only; apply\(\) must change copies"),
    "values in place": ({"apply": greedy}, r"read-only; apply\(\) must change copies"),
    "no state": ({"apply": lambda *_: None}, r"apply\(\) returned a NoneType"),
    "raises": ({"apply": lambda *_: 1 / 0}, "raised ZeroDivisionError: division by zero"),
    "no name": ({"name": " "}, "name of an effect must be a text that is not empty, not ' '"),
    "stage": ({"stage": "elastic"}, "stage must be one of axes, center, bracing, story, .* not 'elastic'"),
    "certain": ({"probability": 1.0}, "the probability of cable must lie between 0 and 1, not 1"),
    "probability": ({"probability": float("nan")}, "the probability of cable must lie between 0 and 1, not nan"),
    "no sizes": ({"sizes": Effect.sizes}, "says nothing of s and its bounds are infinite"),
    "negative size": ({"sizes": lambda *_: np.array([1.0, -1.0])}, "size of m is -1: it must be positive"),
    "nan size": ({"sizes": lambda *_: np.array([np.nan, 1.0])}, "size of s is nan: it must be positive"),
    "one size": ({"sizes": lambda *_: np.ones(1)}, r"sizes\(\) has the shape \(1,\), not \(2,\)"),
    "start": (
        {"parameters": (Parameter("s", "N/m", lower=0.0, start=-1.0), Parameter("m", "kg"))},
        "s: start = -1 is not between 0 and inf",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_first_thing_that_is_wrong_is_said(fault):
    members, said = FAULTS[fault]
    effect = type("Faulty", (Cable,), members)()
    with pytest.raises(InputError, match=said) as caught:
        refuse_faulty(effect)
    assert "cable" in str(caught.value) or fault == "no name"


def complaint(*of):
    """Return the complaint about an effect; the text is empty if there is no complaint."""
    try:
        refuse_faulty(*of)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("stories", [1, 2, 5])
@pytest.mark.parametrize("states", [1, 3])
def test_what_comes_with_the_package_takes_part(stories, states):
    tests = [
        {
            "name": f"test {i}",
            "added_mass": [float(i)] * stories,
            "frequencies": [1.0],
            "mode_shapes": [list(np.arange(1.0, stories + 1))],
        }
        for i in range(states)
    ]
    frame = {"stories": stories, "total_mass": 10.0, "story_heights": 3.0}
    experiment = Experiment.from_dict({"frame": frame, "configuration": tests})
    for effect in (*catalogue(), *open_classes()):
        assert (complaint(effect), complaint(effect, experiment)) == ("", "")


def test_a_class_is_no_effect():
    with pytest.raises(InputError, match="not the class itself: make an instance"):
        refuse_faulty(Cable)
    with pytest.raises(InputError, match="not a str"):
        refuse_faulty("cable")


def test_one_effect_twice():
    with pytest.raises(InputError, match="effect cable is given twice"):
        refuse_repeated([Cable(), *catalogue(), Cable()])
    refuse_repeated([Cable(), *catalogue()])


def test_a_faulty_effect_is_not_registered():
    names = [effect.name for effect in catalogue()]
    with pytest.raises(InputError, match="probability"):
        register(type("Faulty", (Cable,), {"probability": 2.0})())
    assert [effect.name for effect in catalogue()] == names


def test_what_an_experiment_lacks_is_not_tried():
    """An effect is not checked if the experiment lacks data that the effect needs."""
    alone = Experiment.from_dict(
        {"frame": {"total_mass": 1.0, "stories": 1}, "configuration": [{"frequencies": [1.0]}]}
    )
    faulty = type("Faulty", (Cable,), {"needs": ("heights",), "apply": lambda *_: None})()
    assert complaint(faulty, alone) == ""
    assert "returned a NoneType" in complaint(faulty)
