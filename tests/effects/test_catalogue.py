"""Test the catalogue's facts about each effect: its places, its required data, its null value and its order."""

import dataclasses
import re

import numpy as np
import pytest

from cvxshear.effects import LocatedEffect, Parameter, Place, Scale, catalogue, compose, named, open_classes, register
from cvxshear.loop.hypotheses import hypotheses
from cvxshear.measurement.experiment import Experiment, Frame
from cvxshear.priors import Nominal, Ratio
from cvxshear.util.errors import InputError, NoModesError
from tests.effects.common import HEIGHTS, MASS, NAMES, STIFFNESS, Cable, composed, experiment, modes_with, placed, theta
from tests.effects.test_derivatives import CASES
from tests.frames import ROOT, chain, configuration
from tests.frames import experiment as declared

ACTING = sorted(set(CASES) - {"bracing", "floor_mass"})
ALL = {effect.name for effect in catalogue()}
NEVER_NEGATIVE = [
    "joint_rotation", "axial_columns", "base_rocking", "ground_spring", "mass_coupling", "spring", "joint_release",
    "soft_feet", "bracing", "wall",
]  # fmt: skip
EITHER_SIGN = [
    "added_mass", "sensor_gain", "story_change", "state_stiffness", "state_mass", "load_scale", "floor_mass",
    "shape_scale", "force_scale",
]  # fmt: skip
SEVERAL_STATES = ["added_mass", "story_change", "state_stiffness", "state_mass", "joint_release"]
FRAME_WIDE = ["joint_rotation", "axial_columns", "base_rocking", "soft_feet"]
RATIOS_OF_HEIGHTS = [*FRAME_WIDE, "joint_release", "wall"]
FOUR = [1, 2, 3, 4]


def one(name):
    (effect,) = named([name])
    return effect


@pytest.mark.parametrize("name", [*NEVER_NEGATIVE, *EITHER_SIGN])
def test_which_signs_are_possible(name):
    parameter = one(name).parameters[0]
    assert parameter.lower == 0.0 if name in NEVER_NEGATIVE else parameter.lower < 0 < parameter.upper


@pytest.mark.parametrize("name", sorted({*EITHER_SIGN, "total_mass"} - {"added_mass", "floor_mass"}))
def test_a_factor_may_be_as_small_as_it_may_be_large(name):
    (parameter,) = one(name).parameters
    assert (1 + parameter.lower) * (1 + parameter.upper) == pytest.approx(1.0)


@pytest.mark.parametrize("name", sorted({*ACTING, "bracing"} - {"gravity"}))
def test_a_frame_has_modes_at_the_ends_of_what_an_effect_may_be(name):
    """The frame has modes at the bounds of each parameter that a fit may reach."""
    (there, _) = CASES[name]
    for end in ("lower", "upper"):
        values = tuple(getattr(item, end) for item in there.effect.parameters)
        if np.all(np.isfinite(values)):
            assert modes_with([there], values, number=1).eigenvalues[0] > 0


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
        *((name, [Place()]) for name in (*FRAME_WIDE, "bracing", "gravity", "load_scale", "mass_coupling")),
        ("ground_spring", [Place(floor=floor) for floor in FOUR[1:]]),
        ("sensor_gain", [Place(floor=floor, state=name) for floor in FOUR for name in (None, *NAMES)]),
        ("added_mass", [Place(floor=floor, state=name) for floor in FOUR for name in NAMES]),
        ("story_change", [Place(story=story, state=name) for story in FOUR for name in NAMES]),
        ("spring", [Place(floor=1, to=3), Place(floor=1, to=4), Place(floor=2, to=4)]),
        ("state_stiffness", [Place(state=name) for name in NAMES]),
        ("state_mass", [Place(state=name) for name in NAMES]),
        ("floor_mass", [Place(floor=floor) for floor in FOUR]),
        ("joint_release", [Place(floor=floor, state=name) for floor in range(5) for name in NAMES]),
    ],
)
def test_places(name, expected):
    found = one(name).places(experiment())
    assert len(found) == len(expected)
    assert set(found) == set(expected)


def test_no_gain_where_there_is_no_sensor():
    tested = experiment(measured_floors=[1, 3, 4], mode_shapes=[[1.0, 2.0, 3.0]])
    assert {place.floor for place in one("sensor_gain").places(tested)} == {1, 3, 4}


def test_a_gain_in_one_state_where_other_states_tell():
    """If only one state has shapes, a gain in this state is the same as a gain in every test."""
    declared = experiment().to_dict()
    declared["configuration"][0] = {"name": "plain", "frequencies": [2.0]}
    places = one("sensor_gain").places(Experiment.from_dict(declared))
    assert places == [Place(floor=floor) for floor in FOUR]


LACKING = {
    "gravity": "story_heights",
    **dict.fromkeys([*SEVERAL_STATES, "other_changes", "other_loads"], "several states"),
    "total_mass": "what else tells the scale of the masses, such as a second test with other added mass",
    **dict.fromkeys(["load_scale", "load_mounting"], "added_mass"),
    "floor_mass": "floor_masses",
    "shape_scale": "mass-normalized shapes",
    "force_scale": "a static test",
    "wrong_prior": "a prior with a standard deviation",
    "wrong_exact_prior": "a prior that is an exact equation",
    "other_shapes": "shapes of a declared accuracy",
    "other_frequencies": "frequencies that are said to be better than 0.2 %",
}
"""What effects and classes lack in one test with frequencies, shapes and a total mass; the others lack nothing."""


def test_what_is_looked_for_only_where_it_could_be_told():
    alone = experiment(configurations=1, heights=False)
    found = {effect.name: effect.lacks(alone) for effect in (*catalogue(), *open_classes())}
    assert found == dict.fromkeys(found, "") | LACKING
    unknown = dataclasses.replace(experiment(), frame=Frame(stories=4))
    assert one("load_scale").lacks(unknown) == "total_mass or floor_masses"
    low = Experiment.from_dict(
        {"frame": {"stories": 2, "total_mass": 4.0}, "configuration": [{"name": "one", "frequencies": [1.0]}]}
    )
    assert one("spring").lacks(low) == "three to 40 stories"
    assert one("spring").places(low) == []


@pytest.mark.parametrize("name", ACTING)
def test_what_an_effect_needs(name):
    """Gravity needs heights in meters. Effects that need only height ratios assume equal heights and state this."""
    assert one(name).lacks(experiment()) == ""
    assert one(name).lacks(experiment(heights=False)) == ("story_heights" if name == "gravity" else "")
    assert one(name).uses_heights == (name in RATIOS_OF_HEIGHTS)


@pytest.mark.parametrize("number", range(len(NAMES)))
def test_the_order_in_which_effects_are_named_does_not_matter(number):
    values = [value for _, value in CASES.values()]
    effects = [effect for effect, _ in CASES.values()]
    reference = composed(effects, *values, number=number)
    starts = np.cumsum([0, *(len(effect.effect.parameters) for effect in effects)])
    rng = np.random.default_rng(7)
    for order in [range(len(effects))[::-1], *(rng.permutation(len(effects)) for _ in range(20))]:
        state = composed([effects[i] for i in order], *(values[i] for i in order), number=number)
        np.testing.assert_allclose(state.system.K, reference.system.K, rtol=0, atol=1e-14 * reference.system.K.max())
        np.testing.assert_allclose(state.system.M, reference.system.M, rtol=0, atol=1e-14 * reference.system.M.max())
        np.testing.assert_allclose(state.gain, reference.gain, rtol=1e-15)
        own = np.concatenate([np.arange(8, 8 + starts[-1])[starts[i] : starts[i + 1]] for i in order])
        np.testing.assert_allclose(state.system.dK[8:], reference.system.dK[own], rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(state.system.dK[:8], reference.system.dK[:8], rtol=1e-9, atol=1e-10)


def test_a_flexibility_that_leaves_no_stiffness_is_no_model():
    """A trial point far off may give a singular matrix. The search rejects it like a frame that buckles."""
    plain = composed([placed("ground_spring", floor=4)], 0.0)
    with pytest.raises(NoModesError, match="singular with the flexibility"):
        plain.with_stiffness(np.eye(4), np.zeros((9, 4, 4))).with_flexibility(-1.0, np.eye(4), slice(8, 9))


@pytest.fixture
def own_catalogue(monkeypatch):
    """Provide a catalogue to which a test can add effects; restore the original afterwards."""
    monkeypatch.setattr("cvxshear.effects._catalogue", {effect.name: effect for effect in catalogue()})


@pytest.mark.usefixtures("own_catalogue")
def test_an_effect_of_ones_own():
    register(Cable())
    assert {effect.name for effect in catalogue()} == ALL | {"cable"}
    assert catalogue()[-1].name == "cable"
    (effect,) = named(["cable"])
    assert effect.places(experiment()) == [Place()]
    assert effect.lacks(experiment(configurations=1, heights=False)) == ""
    spring = placed("ground_spring", floor=4)
    state = composed([spring, LocatedEffect(effect, Place())], 100.0, (300.0, 2.0))
    assert state.system.M[-1, -1] == pytest.approx(MASS[-1] + 2.0)
    assert state.system.K[-1, -1] == pytest.approx(STIFFNESS[-1] + 400.0)
    assert [state.system.dK[p, -1, -1] for p in (8, 9, 10)] == [1.0, 1.0, 0.0]
    assert [state.system.dM[p, -1, -1] for p in (8, 9, 10)] == [0.0, 0.0, 1.0]


@pytest.mark.usefixtures("own_catalogue")
def test_an_effect_of_the_same_name_takes_the_place_of_the_old():
    class Heavier(type(one("ground_spring"))):
        summary = "another"

    register(Heavier())
    assert len(catalogue()) == len(ALL)
    assert one("ground_spring").summary == "another"


def test_a_name_that_is_not_there():
    with pytest.raises(InputError, match="base_rocking") as caught:
        named(["gravity", "rocking_base"])
    assert "rocking_base" in str(caught.value)


def test_labels():
    assert placed("gravity").label == "gravity"
    assert placed("ground_spring", floor=4).label == "ground spring at floor 4"
    assert placed("story_change", story=2, state="loaded").label == 'story change at story 2 of "loaded"'
    assert Place(floor=2).to_dict() == {
        "floor": 2, "to": None, "story": None, "configuration": None, "prior": None,
    }  # fmt: skip
    assert Place(floor=2, to=6).label("spring") == "spring between floors 2 and 6"
    assert Place(floor=0, state="after").label("joint release") == 'joint release at the base of "after"'


def test_undeclared_heights_are_ones_and_change_the_unit():
    """Equal heights in meters or counted in stories give the same frame; the parameter scales with h^3."""
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
    for other in ({"total_mass": 40.5, "total_mass_std": 0.02}, {}):
        of = dataclasses.replace(experiment(), frame=Frame(stories=4, **other))
        assert effect.lacks(of) == "an exact total_mass or floor_masses"
    by_floor = dataclasses.replace(experiment(), frame=Frame(stories=4, floor_masses=MASS))
    assert effect.lacks(by_floor) == ""
    np.testing.assert_allclose(effect.bound(by_floor).corrects(Place(), MASS) @ [0.07], 0.07 * MASS)
    assert effect.bound(by_floor).limits(by_floor, Place()).A is None
    A, b = effect.limits(dataclasses.replace(experiment(), frame=frame), Place()).A, frame.total_mass
    found = np.concatenate([MASS * 1.07, STIFFNESS, [0.07]])
    np.testing.assert_allclose(A @ found, b, rtol=1e-14)


@pytest.mark.parametrize("quantity", ["floor_mass", "story_stiffness"])
def test_a_released_statement_is_off_by_its_parameter(quantity):
    """If the statement x2 = 0.9 x1 is released, x2 = 0.9 x1 + e holds instead."""
    ratio = {"kind": "ratio", "quantity": quantity, "of": 2, "to": 1, "value": 0.9}
    declared = {"frame": {"stories": 2, "total_mass": 8.0}, "configuration": [{"frequencies": [1.0]}], "prior": [ratio]}
    tested = Experiment.from_dict(declared)
    effect = one("wrong_exact_prior")
    (place,) = effect.places(tested)
    rows = effect.bound_at(tested, place).limits(tested, place)
    known = {"floor_mass": np.array([5.0, 3.0]), "story_stiffness": np.array([5.0, 3.0])}
    off = known[quantity][1] - 0.9 * known[quantity][0]
    for e, left in ((off, 0.0), (0.0, off)):
        x = np.concatenate([known["floor_mass"], known["story_stiffness"], [e]])
        np.testing.assert_allclose(np.abs(rows.A @ x - rows.b), abs(left), atol=1e-12)


def test_an_effect_brings_its_own_size_and_probability():
    gain = one("sensor_gain")
    scale = Scale(10.0, 2e4, HEIGHTS)
    other = gain.expecting(size=0.02, probability=0.3)
    assert (gain.probability, gain.expected_sizes(scale)[0]) == (0.1, 0.05)
    assert (other.probability, other.expected_sizes(scale)[0]) == (0.3, 0.02)
    # The size belongs to the first parameter, or to each parameter if all share one size.
    np.testing.assert_array_equal(one("attached_mass").expecting(size=0.5).expected_sizes(scale), [0.5, np.inf])
    gains = next(each for each in open_classes() if each.name == "other_gains")
    gains = gains.having(Parameter(f"g{floor}", "") for floor in FOUR).expecting(size=0.04)
    np.testing.assert_array_equal(gains.expected_sizes(scale), np.full(4, 0.04))
    with pytest.raises(InputError, match=r"must lie between 0 and 1, not 1\.5"):
        gain.expecting(probability=1.5)


@pytest.mark.parametrize("reference", [None, "plain"])
def test_the_probability_of_an_effect_is_that_of_being_anywhere(reference):
    """That an effect is absent everywhere has the product over its places, or those of each state after another."""
    of = experiment(mode_shape_std=0.01)
    of = dataclasses.replace(of, frame=dataclasses.replace(of.frame, reference=reference))
    for effect in (*catalogue(), *open_classes()):
        absent = {}
        for item in hypotheses(of, [effect]):
            state = item.placed.place.state if reference and effect.kind != "open" else None
            absent[state] = absent.get(state, 1.0) * (1 - item.probability)
        assert list(absent.values()) == pytest.approx([1 - effect.probability] * len(absent), rel=1e-9)


def test_probabilities_and_sizes_are_those_whose_reasons_are_documented():
    page, unit = (ROOT / "docs/theory/effects.md").read_text(encoding="utf-8"), Scale(1.0, 1.0, np.ones(5))
    said = re.findall(r"^(\w+) +(\d+)%  (\w+) +(\S+)", page, re.MULTILINE)
    found = [
        (effect.name, f"{100 * effect.probability:.0f}", item.name, f"{size:.3g}" if np.isfinite(size) else "even,")
        for effect in catalogue()
        for item, size in zip(effect.parameters, effect.expected_sizes(unit), strict=True)
    ]
    # The last three are of floors that turn, which have a page of their own.
    assert found[:-3] == said


def test_half_of_all_tanks_are_on_the_roof():
    found = hypotheses(experiment(configurations=1), [one("attached_mass")])
    lower, roof = [item.probability for item in found[:3]], found[3].probability
    assert roof == pytest.approx(1 - np.sqrt(0.98), rel=1e-12)
    assert lower == pytest.approx([1 - 0.98 ** (1 / 6)] * 3, rel=1e-12)


SCALE = Scale(10.0, 2e4, np.full(4, 0.4))
SAID = [
    ("gravity", {}, 1.1, 0.05, "the weight above takes 1.100 ± 0.050 times P/h from every story's stiffness"),
    (
        "soft_feet", {}, 0.6, 0.1,
        "the feet of the columns turn, which takes 12.5 ± 1.7 % of the stiffness that story 1 has between rigid beams "
        "(rho = 0.6)",
    ),
    ("joint_rotation", {}, 0.3, 0.02, "adds 30.0 ± 2.0 % to the sway of a story among equal ones (eta = 0.3)"),
    ("axial_columns", {}, 5e-6, 1e-6,
     "the frame bends as a whole, by columns that stretch and shorten or a wall, which adds 3.4 % to the sway"),
    ("base_rocking", {}, 1e-5, 1e-6, "the base turns, which adds 13 % to the sway of the top"),
    ("ground_spring", {"floor": 3}, 2e4, 1e3, "a spring of 20.0 ± 1.0 kN/m ties floor 3 to the ground"),
    ("spring", {"floor": 2, "to": 4}, 746e3, 55e3, "a spring of 746 ± 55 kN/m ties floors 2 and 4"),
    (
        "added_mass", {"floor": 2, "state": "after"}, 0.78, 0.05,
        'floor 2 carries 0.780 ± 0.050 kg more in "after" than declared',
    ),
    (
        "added_mass", {"floor": 2, "state": "after"}, -0.78, 0.05,
        'floor 2 carries 0.780 ± 0.050 kg less in "after" than declared',
    ),
    ("mass_coupling", {}, 1.2, 0.1, "the columns of a story weigh 1.20 ± 0.10 kg, and their mass moves with both"),
    ("sensor_gain", {"floor": 4}, 0.1, 0.005, "the sensor at floor 4 reads 10.00 ± 0.50 % too much"),
    (
        "sensor_gain", {"floor": 4, "state": "after"}, -0.1, 0.005,
        'the sensor at floor 4 reads 10.00 ± 0.50 % too little in "after"',
    ),
    (
        "story_change", {"story": 3, "state": "after"}, -0.151, 0.004,
        'story 3 lost 15.10 ± 0.40 % of its stiffness in "after"',
    ),
    ("story_change", {"story": 3, "state": "after"}, 0.2, 0.01, 'story 3 is 20.0 ± 1.0 % stiffer in "after"'),
    ("state_stiffness", {"state": "after"}, -0.0909, 0.005, 'all stories of "after" are 9.09 ± 0.50 % softer'),
    ("state_mass", {"state": "after"}, 0.1, 0.005, 'all floors of "after" are 10.00 ± 0.50 % heavier'),
    ("load_scale", {}, -0.1, 0.01, "the added masses are 10.0 ± 1.0 % lighter than declared"),
    ("floor_mass", {"floor": 2}, 300.0, 20.0, "floor 2 is 300 ± 20 kg heavier than declared"),
    ("total_mass", {}, 0.07, 0.01, "the frame is 7.0 ± 1.0 % heavier than its declared total mass"),
    (
        "shape_scale", {}, -0.05, 0.01,
        "all mass-normalized shapes are 5.0 ± 1.0 % too small, as where the force was misread",
    ),
    ("force_scale", {}, 0.2, 0.01, "the forces of the static tests are 20.0 ± 1.0 % larger than declared"),
    ("load_mounting", {}, 25.0, 0.5, "the added masses are not fast to the floors: they swing at 25.00 ± 0.50 Hz"),
    (
        "attached_mass", {"floor": 4, "state": "after"}, (1.5, 6.0), (0.1, 0.2),
        'a mass of 1.50 ± 0.10 kg swings on floor 4 at 6.00 ± 0.20 Hz of its own in "after"',
    ),
    (
        "wall", {}, 0.25, 0.02,
        "a wall or core bends beside the frame, with EI = 0.250 ± 0.020 times H^2 mean(k h) (lambda H = 2)",
    ),
    ("bracing", {}, 0.4, 0.02, "braces make up 40.0 ± 2.0 % of the stiffness of every story"),
    # If one end of two columns is hinged, each has the stiffness 1 - (rho / 4) / (1 + 2 rho / 3).
    (
        "joint_release", {"floor": 2, "state": "after"}, (0.6, 0.0), (0.1, 0.0),
        'the joints of floor 2 are loose in "after", which costs stories 2 and 3 about 10.7 ± 1.3 % of their stiffness',
    ),
    (
        "joint_release", {"floor": 0, "state": "after"}, (0.6, 0.0), (0.1, 0.0),
        'story 1 lost 12.5 ± 1.7 % of its stiffness in "after": the feet of the columns are loose',
    ),
    (
        "joint_release", {"floor": 4, "state": "after"}, (0.0, 0.2), (0.0, 0.01),
        'story 4 lost 20.0 ± 1.0 % of its stiffness in "after": the joints of floor 4 are loose',
    ),
    (
        "story_change", {"story": 1, "part": "in y at x > 0", "state": "after"}, -0.178, 0.004,
        'story 1 lost 17.80 ± 0.40 % of its stiffness in y at x > 0 in "after"',
    ),
    (
        "eccentric_mass", {"floor": 4, "part": "in x"}, -0.048, 0.0013,
        "the mass center of floor 4 is at x = -0.0480 ± 0.0013 m",
    ),
    (
        "turned_axes", {"story": 2}, 0.31, 0.02,
        "the axes of story 2 are not x and y: the stiffness between these is 31.0 ± 2.0 % of their mean",
    ),
    (
        "eccentric_stiffness", {"part": "in y"}, 0.5, 0.02,
        "the center of stiffness of all stories is at y = 0.500 ± 0.020 m",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("name", "place", "value", "std", "expected"), SAID)
def test_an_effect_in_words(name, place, value, std, expected):
    effect = one(name)
    units = [item.unit for item in effect.parameters]
    said = effect.phrase(Place(**place), np.atleast_1d(value), np.atleast_1d(std), SCALE, units)
    assert expected in said
    assert said[0].islower()


def test_every_effect_is_said_in_words():
    assert {item[0] for item in SAID} == ALL - {"wrong_prior", "wrong_exact_prior"}
    exact = named(["wrong_exact_prior"])[0].having([Parameter("e", "N/m")])
    said = exact.phrase(Place(prior="k"), np.array([-2e4]), np.array([1e3]), SCALE, ["N/m"])
    assert said == 'the statement "k", declared as exact, is off by 20.0 ± 1.0 kN/m'


def test_an_attached_mass_is_looked_for_about_the_measured_frequencies():
    """Starts surround the measured frequencies. Zero mass removes the effect, but for a motion without a sensor."""
    tested = experiment()
    (effect,) = named(["attached_mass"])
    mass, frequency = effect.bound(tested).parameters
    assert [(item.name, item.unit) for item in (mass, frequency)] == [("mass", "kg"), ("frequency", "Hz")]
    assert (mass.lower, mass.null) == (0.0, 0.0)
    assert frequency.lower < 2.0 < frequency.upper
    for start in effect.bound(tested).starts:
        for item, value in zip((mass, frequency), start, strict=True):
            assert item.lower < value <= item.upper
    assert len(set(effect.bound(tested).starts)) == len(effect.bound(tested).starts)
    assert effect.places(tested) == [Place(floor=floor, state=state) for state in (None, *NAMES) for floor in FOUR]
    assert effect.places(experiment(configurations=1)) == [Place(floor=floor) for floor in FOUR]
    state = composed([placed("attached_mass", floor=2)], 0.0, 2.0)
    np.testing.assert_allclose(state.system.K[:4, :4], chain(MASS, STIFFNESS)[1], rtol=0, atol=1e-2)
    np.testing.assert_array_equal(state.system.M[:4, :4], np.diag(MASS))
    np.testing.assert_array_equal(state.observation.matrix, np.eye(4, 5))


def test_the_words_of_an_effect_of_ones_own():
    said = Cable().phrase(Place(), np.array([3e4, 2.0]), np.array([1e3, 0.1]), SCALE, ["N/m", "kg"])
    assert said == "cable is there (s = 30.0 ± 1.0 kN/m, m = 2.00 ± 0.10 kg)"


def test_a_loose_joint_costs_what_it_says():
    """A loose joint takes the stated part of the stiffness of a story between fixed neighbors, of equal stories."""
    tested = experiment(heights=False)
    k = np.full(4, 2e4)
    for floor, story in ((0, 1), (2, 2), (2, 3), (4, 4)):
        effect = placed("joint_release", floor=floor, state="loaded")
        state = compose(tested, tested.configurations[1], [effect], theta(0.6, 0.1, stiffness=k))
        drift = np.zeros(4)
        drift[story - 1 :] = 1.0
        lost = 1.0 - drift @ state.system.K @ drift / 2e4
        said = effect.effect.phrase(effect.place, np.array([0.6, 0.1]), np.array([0.1, 0.0]), SCALE, ["", ""])
        assert f"{100 * lost:.1f} " in said


def test_joints_of_a_frame_without_columns_cannot_soften():
    """A fit may pass through a frame with all stiffness in braces: it is rejected without a division by zero."""
    tested = {"frequencies": [1.0, 2.5], "mode_shapes": [[0.6, 1.0], [1.0, -0.6]]}
    of = Experiment.from_dict({"frame": {"total_mass": 2.0}, "configuration": [tested]})
    state = compose(of, of.configurations[0], (), np.array([1.0, 1.0, 40.0, 40.0]))
    with pytest.raises(NoModesError, match="no story has columns"):
        dataclasses.replace(state, column_stiffness=np.zeros(2)).with_softer_joints(slice(1, None), 0.1, 0)


OPEN_ENTRIES = {
    "other_stiffness": ["the ground and floor 2", "the ground and floor 3", "floors 1 and 3"],
    "other_inertia": ["floors 1 and 2", "floors 1 and 3", "floors 2 and 3"],
    "other_beams": ["floor 1", "floor 2", "floor 3"], "other_changes": ["story 1", "story 2", "story 3"],
    "other_loads": ["floor 1", "floor 2", "floor 3"], "other_gains": ["floor 1", "floor 2", "floor 3"],
    "other_shapes": [], "other_frequencies": [],
}  # fmt: skip


CAUSES_OF_ENTRIES = {
    "other_stiffness": [
        ("ground_spring", Place(floor=2)), ("ground_spring", Place(floor=3)), ("spring", Place(floor=1, to=3)),
    ],
    "other_changes": [("story_change", Place(story=story, state="b")) for story in (1, 2, 3)],
    "other_loads": [("added_mass", Place(floor=floor, state="b")) for floor in (1, 2, 3)],
    "other_gains": [("sensor_gain", Place(floor=floor)) for floor in (1, 2, 3)],
}  # fmt: skip


THREE = [10.0, 8.0, 6.0], [2e4, 1.5e4, 1e4]


def three_stories(*tests, **frame):
    return Experiment.from_dict(declared(*THREE, *tests, frame={"total_mass": 24.0, **frame}))


def test_an_entry_of_an_open_class_equals_a_cause_of_the_catalogue():
    of = three_stories(*(configuration(*THREE, name=name) for name in "ab"), story_heights=3.0)
    frame = np.concatenate(THREE)
    known = {effect.name: effect for effect in catalogue()}
    for effect in (each.bound(of) for each in open_classes() if each.suits(of)):
        place = effect.places(of)[-1]
        of_class = LocatedEffect(effect.bound_at(of, place), place)
        assert [item.name for item in of_class.effect.parameters] == OPEN_ENTRIES[effect.name]
        for entry, (name, where) in enumerate(CAUSES_OF_ENTRIES.get(effect.name, ())):
            cause = LocatedEffect(known[name].bound(of).bound_at(of, where), where)
            size = {"N/m": 300.0, "kg": 0.7, "": 0.2}[of_class.effect.parameters[entry].unit]
            values = size * np.eye(len(of_class.effect.parameters))[entry]
            for test in of.configurations:
                one, other = (
                    compose(of, test, [each], np.concatenate([frame, own]), derivatives=False)
                    for each, own in ((of_class, values), (cause, [size]))
                )
                np.testing.assert_allclose(one.system.M, other.system.M)
                np.testing.assert_allclose(one.system.K, other.system.K)
                np.testing.assert_allclose(one.gain, other.gain)


def test_a_wrong_statement_has_an_error_for_each_of_its_rows():
    ratio, design = Ratio("floor_mass", of=2, to=1, value=0.9, std=0.1), Nominal("floor_mass", THREE[0], std=0.1)
    of = three_stories(configuration(*THREE)).with_priors([ratio, design])
    wrong = one("wrong_prior")
    names = [[each.name for each in wrong.bound_at(of, place).parameters] for place in wrong.places(of)]
    assert names == [["e"], ["e1", "e2", "e3"]]
    assert one("wrong_exact_prior").places(of) == []


def test_gains_of_all_sensors_are_those_of_the_floors_with_sensors():
    (gains,) = (effect for effect in open_classes() if effect.name == "other_gains")
    for floors, lacking in (([1, 3], ""), ([3], "shapes at two floors or more")):
        assert gains.lacks(three_stories(configuration(*THREE, measured_floors=floors))) == lacking
    of = three_stories(configuration(*THREE))
    values = np.array([*THREE[0], *THREE[1], 0.1, 0.2, -0.3])
    state = compose(of, of.configurations[0], [LocatedEffect(gains.bound(of), Place())], values)
    np.testing.assert_allclose(state.gain, [1.1, 1.2, 0.7])
    (sensor,) = one("sensor_gain").parameters
    assert {(each.lower, each.upper) for each in gains.bound(of).parameters} == {(sensor.lower, sensor.upper)}


def test_shapes_may_be_inaccurate_in_a_state_at_a_floor_or_all():
    (shapes,) = (effect for effect in open_classes() if effect.name == "other_shapes")
    places = shapes.places(experiment(mode_shape_std=0.01))
    said = [shapes.phrase(place, np.array([3.0]), np.array([0.1]), SCALE, [""]) for place in places]
    where = [' of "plain"', ' of "loaded"', *(f" at floor {floor}" for floor in FOUR), ""]
    assert [each.split(" are less")[0] for each in said] == [f"the shapes{each}" for each in where]


@pytest.mark.parametrize(("std", "looked_for"), [(0.0019, True), (0.002, False)])
def test_frequencies_are_suspects_where_better_than_the_default_was_stated(std, looked_for):
    (effect,) = (each for each in open_classes() if each.name == "other_frequencies")
    of = experiment()
    tests = tuple(dataclasses.replace(each, frequency_std=std) for each in of.configurations)
    lacking = effect.lacks(dataclasses.replace(of, configurations=tests))
    assert lacking == ("" if looked_for else "frequencies that are said to be better than 0.2 %")
