"""Frequencies alone cannot tell a chain from its dual: stories 1 / m from the top down, floors 1 / k likewise."""

import numpy as np
import pytest
from scipy import linalg

from cvxshear.effects import LocatedEffect, Place, catalogue, compose, named
from cvxshear.loop.hypotheses import dual_fits_as_well, dual_frame
from cvxshear.measurement.experiment import Experiment

STORIES = 4
CHANGE = -0.2
"""Relative change of a stiffness. The dual's mass changes by 0.2 / 0.8, a quarter."""


def bare(name="after"):
    """Return two states without any added mass."""
    tests = [{"name": state, "frequencies": [1.0]} for state in ("before", name)]
    return Experiment.from_dict({"frame": {"stories": STORIES, "total_mass": 4.0}, "configuration": tests})


def eigenvalues(mass, stiffness, placed=None, *own):
    tested = bare()
    effects = [] if placed is None else [placed]
    state = compose(tested, tested.configurations[1], effects, np.concatenate([mass, stiffness, own]))
    return linalg.eigh(state.system.K, state.system.M, eigvals_only=True)


WITH_DUAL = [
    (effect, place) for effect in catalogue() for place in effect.places(bare()) if effect.dual(place, STORIES)
]


@pytest.mark.parametrize(("effect", "place"), WITH_DUAL, ids=lambda item: getattr(item, "name", None))
def test_the_dual_has_the_same_frequencies(effect, place):
    rng = np.random.default_rng(3)
    mass, stiffness = rng.uniform(0.5, 2.0, STORIES), rng.uniform(0.5, 2.0, STORIES)
    dual_mass, dual_stiffness = 1 / stiffness[::-1], 1 / mass[::-1]
    np.testing.assert_allclose(eigenvalues(dual_mass, dual_stiffness), eigenvalues(mass, stiffness), rtol=1e-12)
    dual = dual_frame(np.concatenate([mass, stiffness]))
    np.testing.assert_allclose(dual / dual[0], np.concatenate([dual_mass, dual_stiffness]) / dual_mass[0])
    assert dual[:STORIES].sum() == pytest.approx(mass.sum())
    name, there = effect.dual(place, STORIES)
    (other,) = named([name])
    assert other.dual(there, STORIES) == (effect.name, place)
    # A factor f on a stiffness is a factor 1 / f on a mass of the dual, and conversely.
    inverse = 1.0 / (1.0 + CHANGE) - 1.0

    def own(placed, floors, change):
        kilograms = placed.effect.parameters[0].unit == "kg"
        return change * floors[placed.place.floor - 1] if kilograms else change

    here, mirrored = LocatedEffect(effect, place), LocatedEffect(other, there)
    np.testing.assert_allclose(
        eigenvalues(dual_mass, dual_stiffness, mirrored, own(mirrored, dual_mass, inverse)),
        eigenvalues(mass, stiffness, here, own(here, mass, CHANGE)),
        rtol=1e-12,
    )


def test_what_has_no_dual():
    for name in ("gravity", "ground_spring", "sensor_gain", "joint_rotation"):
        (effect,) = named([name])
        assert effect.dual(Place(floor=2), STORIES) is None


@pytest.mark.parametrize(
    ("more", "as_well"),
    [({}, True), ({"added_mass": [0.0, 0.0, 1.0, 0.0]}, False), ({"mode_shapes": [[0.3, 0.6, 0.8, 1.0]]}, False)],
)
def test_shapes_or_a_load_tell_a_frame_from_its_dual(more, as_well):
    table = {"name": "before", "frequencies": [1.0], **more}
    tested = Experiment.from_dict({"frame": {"stories": STORIES, "total_mass": 4.0}, "configuration": [table]})
    assert dual_fits_as_well(tested) is as_well
