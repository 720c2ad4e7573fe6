"""What the catalogue says of its effects: where they sit, what they need, when they vanish, in which order they act."""

import dataclasses
import math
import re

import numpy as np
import pytest

from cvxshear.effects import Effect, Parameter, Place, Placed, Scale, catalogue, compose, named, register
from cvxshear.effects import registry as registry_module
from cvxshear.effects.state import STAGES
from cvxshear.measurement.experiment import Experiment, Frame
from cvxshear.util.errors import InputError
from tests.effects.common import ADDED, HEIGHTS, MASS, NAMES, STIFFNESS, composed, experiment, placed, theta
from tests.effects.test_derivatives import CASES

ACTING = [
    "gravity",
    "joint_rotation",
    "axial_columns",
    "base_rocking",
    "ground_spring",
    "added_mass",
    "mass_coupling",
    "sensor_gain",
    "story_change",
]
TEN = [*ACTING, "total_mass"]
"""The last changes what the masses must add up to, and no matrix."""
UNITS = {
    "gravity": [("gamma", "")],
    "joint_rotation": [("eta", "")],
    "axial_columns": [("inverse_EI", "1/(N m2)")],
    "base_rocking": [("inverse_k_theta", "rad/(N m)")],
    "ground_spring": [("s", "N/m")],
    "added_mass": [("mass", "kg")],
    "mass_coupling": [("mu", "kg")],
    "sensor_gain": [("g", "")],
    "story_change": [("change", "")],
    "total_mass": [("e", "")],
}
NEVER_NEGATIVE = ["joint_rotation", "axial_columns", "base_rocking", "ground_spring", "mass_coupling"]
FOUR = [1, 2, 3, 4]


def shear_stiffness(k):
    """Assembled story by story."""
    K = np.zeros((len(k), len(k)))
    for story, value in enumerate(k):
        K[story, story] += value
        if story:
            K[story - 1, story - 1] += value
            K[story - 1, story] -= value
            K[story, story - 1] -= value
    return K


def one(name):
    (effect,) = named([name])
    return effect


def test_ten_effects_in_their_order():
    assert [effect.name for effect in catalogue()] == TEN


@pytest.mark.parametrize("name", TEN)
def test_parameters(name):
    effect = one(name)
    assert [(each.name, each.unit) for each in effect.parameters] == UNITS[name]
    (parameter,) = effect.parameters
    assert parameter.null == 0.0
    assert parameter.lower <= parameter.start <= parameter.upper
    if name != "gravity":
        assert parameter.lower <= parameter.null <= parameter.upper
    assert effect.stage in STAGES
    assert all((effect.summary, effect.formula, effect.source))


def test_gravity_is_bounded_by_props_and_clamped_columns():
    (gamma,) = one("gravity").parameters
    assert (gamma.lower, gamma.upper) == (1.0, 6 / 5)


@pytest.mark.parametrize("name", NEVER_NEGATIVE)
def test_what_cannot_be_negative(name):
    assert one(name).parameters[0].lower == 0.0


@pytest.mark.parametrize("name", ["added_mass", "sensor_gain", "story_change"])
def test_what_may_have_either_sign(name):
    (parameter,) = one(name).parameters
    assert parameter.lower < 0 < parameter.upper


@pytest.mark.parametrize("name", ["sensor_gain", "story_change"])
def test_what_cannot_turn_the_sign_of_what_it_multiplies(name):
    assert one(name).parameters[0].lower > -1


@pytest.mark.parametrize("number", range(len(NAMES)))
@pytest.mark.parametrize("name", ACTING)
def test_null_value_leaves_the_shear_frame(name, number):
    effect, _ = CASES[name]
    state = composed([effect], effect.effect.parameters[0].null, number=number)
    np.testing.assert_allclose(state.system.M, np.diag(MASS + ADDED[number]), rtol=1e-14, atol=0)
    np.testing.assert_allclose(state.system.K, shear_stiffness(STIFFNESS), rtol=0, atol=1e-14 * STIFFNESS.max() * 10)
    np.testing.assert_array_equal(state.gain, np.ones(4))


@pytest.mark.parametrize("name", ACTING)
def test_any_other_value_does_not(name):
    effect, value = CASES[name]
    state, plain = composed([effect], value, number=1), composed([], number=1)
    apart = [
        np.max(np.abs(changed - unchanged)) / np.max(np.abs(unchanged))
        for changed, unchanged in (
            (state.system.M, plain.system.M),
            (state.system.K, plain.system.K),
            (state.gain, plain.gain),
        )
    ]
    assert max(apart) > 1e-3
    assert sum(part > 0 for part in apart) == 1


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("gravity", [Place()]),
        ("joint_rotation", [Place()]),
        ("axial_columns", [Place()]),
        ("base_rocking", [Place()]),
        ("mass_coupling", [Place()]),
        ("ground_spring", [Place(floor=floor) for floor in FOUR[1:]]),
        ("sensor_gain", [Place(floor=floor) for floor in FOUR]),
        ("added_mass", [Place(floor=floor, state=name) for floor in FOUR for name in NAMES]),
        ("story_change", [Place(story=story, state=name) for story in FOUR for name in NAMES]),
    ],
)
def test_places(name, expected):
    found = one(name).places(experiment())
    assert len(found) == len(expected)
    assert set(found) == set(expected)


def test_no_gain_where_there_is_no_sensor():
    tested = experiment(measured_floors=[1, 3, 4], mode_shapes=[[1.0, 2.0, 3.0]])
    assert [place.floor for place in one("sensor_gain").places(tested)] == [1, 3, 4]


@pytest.mark.parametrize("name", ACTING)
def test_several_states_where_they_are_needed(name):
    lacking = one(name).lacks(experiment(configurations=1))
    assert lacking == ("several states" if name in ("added_mass", "story_change") else "")
    assert one(name).lacks(experiment()) == ""


@pytest.mark.parametrize("name", ACTING)
def test_heights_where_they_are_needed(name):
    """Weight needs them in metres; what needs only their ratios takes them as equal, and says so."""
    assert one(name).lacks(experiment(heights=False)) == ("story_heights" if name == "gravity" else "")
    assert one(name).uses_heights == (name in ("joint_rotation", "axial_columns", "base_rocking"))


@pytest.mark.parametrize("name", sorted(set(ACTING) - {"gravity", "joint_rotation", "axial_columns", "base_rocking"}))
def test_what_needs_no_heights_does_without(name):
    """The same matrices whether or not heights are declared."""
    effect, value = CASES[name]
    both = experiment(), experiment(heights=False)
    states = [compose(tested, tested.configurations[1], [effect], theta(value)) for tested in both]
    np.testing.assert_array_equal(states[0].system.K, states[1].system.K)
    np.testing.assert_array_equal(states[0].system.M, states[1].system.M)


def test_acts_in_its_own_configuration_only():
    there = placed("added_mass", floor=1, state="loaded")
    first, second = experiment().configurations
    assert not there.acts_on(first)
    assert there.acts_on(second)
    assert placed("gravity").acts_on(first)


@pytest.mark.parametrize("number", range(len(NAMES)))
def test_the_order_in_which_effects_are_named_does_not_matter(number):
    values = [value for _, value in CASES.values()]
    effects = [effect for effect, _ in CASES.values()]
    reference = composed(effects, *values, number=number)
    rng = np.random.default_rng(7)
    for order in [range(len(effects))[::-1], *(rng.permutation(len(effects)) for _ in range(20))]:
        state = composed([effects[i] for i in order], *(values[i] for i in order), number=number)
        np.testing.assert_allclose(state.system.K, reference.system.K, rtol=0, atol=1e-10)
        np.testing.assert_allclose(state.system.M, reference.system.M, rtol=0, atol=1e-13)
        np.testing.assert_allclose(state.gain, reference.gain, rtol=1e-15)
        own = 8 + np.array(order)
        np.testing.assert_allclose(state.system.dK[8:], reference.system.dK[own], rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(state.system.dK[:8], reference.system.dK[:8], rtol=1e-9, atol=1e-10)


def test_flexibilities_add_up():
    """In series: those of frame, chord and base are summed."""
    (bending, p), (rocking, q) = CASES["axial_columns"], CASES["base_rocking"]
    z = np.cumsum(HEIGHTS)
    # A cantilever's sway, int (a - s)(b - s) ds / EI, less what the moments' slope within each story adds, h^3 / 12:
    # that is the columns' own bending, which the story stiffnesses have.
    bent = [[min(a, b) ** 2 * max(a, b) / 2 - min(a, b) ** 3 / 6 for a in z] for b in z]
    within = [[np.sum(HEIGHTS[: min(a, b) + 1] ** 3) / 12 for a in range(4)] for b in range(4)]
    chord = np.array(bent) - np.array(within)
    expected = np.linalg.inv(shear_stiffness(STIFFNESS)) + p * chord + q * np.outer(z, z)
    state = composed([bending, rocking], p, q)
    np.testing.assert_allclose(np.linalg.inv(state.system.K), expected, rtol=1e-11)


def test_gravity_weighs_what_is_declared_and_what_is_not():
    """P_i counts floors, declared added mass and the mass that the declaration misses, floor i's own included."""
    effects = [placed("gravity"), placed("added_mass", floor=3, state="loaded")]
    state = composed(effects, 1.0, 2.0, number=1)
    mass = MASS + ADDED[1] + np.array([0.0, 0.0, 2.0, 0.0])
    load = [9.81 * mass[i:].sum() for i in range(4)]
    np.testing.assert_allclose(state.system.K, shear_stiffness(STIFFNESS - np.array(load) / HEIGHTS), rtol=1e-12)


class Damper(Effect):
    """A tuned mass that is locked to the top floor: two parameters, at no place."""

    name = "locked_damper"
    summary = "A damper on the roof is locked."
    formula = "M + mass e e', K + s e e' at the top"
    source = "none"
    stage = "spring"
    parameters = (Parameter("mass", "kg", lower=0.0), Parameter("s", "N/m"))

    def apply(self, state, place, values, own):
        system = state.system
        M, K, dM, dK = system.M.copy(), system.K.copy(), system.dM.copy(), system.dK.copy()
        M[-1, -1] += values[0]
        K[-1, -1] += values[1]
        dM[own.start, -1, -1] += 1.0
        dK[own.start + 1, -1, -1] += 1.0
        return state.with_mass(M, dM).with_stiffness(K, dK)


@pytest.fixture
def own_catalogue(monkeypatch):
    """A catalogue to add to, forgotten after the test."""
    monkeypatch.setattr(registry_module, "_catalogue", dict(registry_module._catalogue))


@pytest.mark.usefixtures("own_catalogue")
def test_an_effect_of_ones_own():
    register(Damper())
    assert [effect.name for effect in catalogue()] == [*TEN, "locked_damper"]
    (effect,) = named(["locked_damper"])
    assert effect.places(experiment()) == [Place()]
    assert effect.lacks(experiment(configurations=1, heights=False)) == ""
    spring = placed("ground_spring", floor=4)
    state = composed([spring, Placed(effect, Place())], 100.0, 2.0, 300.0)
    assert state.system.M[-1, -1] == pytest.approx(MASS[-1] + 2.0)
    assert state.system.K[-1, -1] == pytest.approx(STIFFNESS[-1] + 400.0)
    assert [state.system.dK[p, -1, -1] for p in (8, 9, 10)] == [1.0, 0.0, 1.0]
    assert [state.system.dM[p, -1, -1] for p in (8, 9, 10)] == [0.0, 1.0, 0.0]


@pytest.mark.usefixtures("own_catalogue")
def test_an_effect_of_the_same_name_takes_the_place_of_the_old():
    class Heavier(type(one("ground_spring"))):
        summary = "another"

    register(Heavier())
    assert len(catalogue()) == len(TEN)
    assert one("ground_spring").summary == "another"


def test_registered_effects_do_not_outlive_their_test():
    assert [effect.name for effect in catalogue()] == TEN


def test_a_name_that_is_not_there():
    with pytest.raises(InputError, match="base_rocking") as caught:
        named(["gravity", "rocking_base"])
    assert "rocking_base" in str(caught.value)


def test_labels():
    assert placed("gravity").label == "gravity"
    assert placed("ground_spring", floor=4).label == "ground spring at floor 4"
    assert placed("story_change", story=2, state="loaded").label == 'story change at story 2 of "loaded"'
    assert Place(floor=2).to_dict() == {"floor": 2, "to": None, "story": None, "configuration": None}
    assert Place(floor=2, to=6).label("spring") == "spring between floors 2 and 6"
    assert Place(floor=0, state="after").label("joint release") == 'joint release at the base of "after"'


def test_bounds_are_numbers():
    for effect in catalogue():
        for parameter in effect.parameters:
            assert math.isfinite(parameter.start)
            assert not math.isnan(parameter.lower)
            assert not math.isnan(parameter.upper)


def test_undeclared_heights_are_ones_and_change_the_unit():
    """A frame of equal stories is the same with heights in metres and counted in stories, its parameter h^3 larger."""
    tall = Experiment.from_dict(
        {**experiment().to_dict(), "frame": {**experiment().frame.to_dict(), "story_heights": [0.4] * 4}}
    )
    bending, value = placed("axial_columns"), 2e-4
    metric = compose(tall, tall.configurations[0], [bending], theta(value))
    unknown = experiment(heights=False)
    counted = compose(unknown, unknown.configurations[0], [bending], theta(value * 0.4**3))
    np.testing.assert_allclose(metric.system.K, counted.system.K, rtol=1e-12)
    assert bending.units(tall) == ("1/(N m2)",)
    assert bending.units(unknown) == ("m/N",)


def test_total_mass_is_looked_for_where_it_is_declared_exact_and_could_be_told():
    effect = one("total_mass")
    assert effect.lacks(experiment()) == ""
    assert "what else tells the scale" in effect.lacks(experiment(configurations=1))
    frame = experiment().frame
    for other in ({"total_mass": 40.5, "total_mass_std": 0.02}, {"floor_masses": MASS}, {}):
        of = dataclasses.replace(experiment(), frame=Frame(stories=4, **other))
        assert effect.lacks(of) == "an exact total_mass"
    A, b = effect.limits(dataclasses.replace(experiment(), frame=frame), Place()).A, frame.total_mass
    found = np.concatenate([MASS * 1.07, STIFFNESS, [0.07]])
    np.testing.assert_allclose(A @ found, b, rtol=1e-14)


def test_an_effect_brings_its_own_size_and_probability():
    gain = one("sensor_gain")
    scale = Scale(10.0, 2e4, HEIGHTS)
    other = gain.expecting(size=0.02, probability=0.3)
    assert (gain.probability, gain.expected_sizes(scale)[0]) == (0.1, 0.05)
    assert (other.probability, other.expected_sizes(scale)[0]) == (0.3, 0.02)
    with pytest.raises(InputError, match=r"must lie between 0 and 1, not 1\.5"):
        gain.expecting(probability=1.5)


def test_the_size_of_an_effect_in_words():
    scale = Scale(10.0, 2e4, HEIGHTS)
    said = {
        "added_mass": one("added_mass").phrase(
            Place(floor=3, state="after"), np.array([3.01]), np.array([0.03]), scale, ["kg"]
        ),
        "story_change": one("story_change").phrase(
            Place(story=2, state="after"), np.array([-0.15]), np.array([0.01]), scale, [""]
        ),
        "sensor_gain": one("sensor_gain").phrase(Place(floor=4), np.array([0.1]), np.array([0.005]), scale, [""]),
        "damper": Damper().phrase(Place(), np.array([2.0, 3e4]), np.array([0.1, 1e3]), scale, ["kg", "N/m"]),
    }
    assert said["added_mass"].startswith("an undeclared mass of 3.01")
    assert said["added_mass"].endswith('kg on floor 3 of "after"')
    assert "a loss of 15" in said["story_change"]
    assert re.fullmatch(r'a loss of .* of the stiffness of story \d in "after"', said["story_change"])
    assert "floor 4 that reads 10" in said["sensor_gain"]
    assert said["sensor_gain"].endswith("% too much")
    assert "mass = 2" in said["damper"]
    assert "s = 3" in said["damper"]
    assert "N/m" in said["damper"]
