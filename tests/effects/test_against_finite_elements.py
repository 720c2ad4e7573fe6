"""Compare every effect with a frame of beams and columns that has this effect.

`tests.fe.experiments` names the frames for which a formula is exact. For the other effects, the tests measure how fast
the frame approaches the formula.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from cvxshear.effects import LocatedEffect, open_classes
from cvxshear.effects.masses import LEAST_MASS
from cvxshear.model import modes
from tests.effects import common
from tests.effects.common import MASS, NAMES, STIFFNESS, assert_same, building, composed, modes_with, placed
from tests.fe import experiments as fe
from tests.fe.frame import SwayModes, assemble, sway_modes

NUMBERS, FLOORS = (0, 1), (1, 2, 3, 4)
TOP = float(common.HEIGHTS.sum())
SWAY = float(np.sum(1 / STIFFNESS))
"""Static displacement of the top under 1 N at the top, in m."""

LOADED = {"state": "loaded"}


def each_size(name, sizes, **place):
    return [([placed(name, **place)], (size,)) for size in sizes]


EXACT = [
    ([], ()),
    # Rigid props fall by d^2 / 2h, and a clamped cubic's geometric stiffness integrates to 6 P / 5 h.
    *each_size("gravity", (1.0, 1.07, 1.2)),
    # Bernoulli members and two equal columns whose joints turn alike.
    *each_size("joint_rotation", (1e-3, 0.1, 1.0, 50.0)),
    # Floors that stay rigid and tilt: EI combines the columns' EA b^2 / 2 and their own bending.
    *each_size("axial_columns", 3 * SWAY / TOP**3 * np.array([0.01, 0.1, 1.0])),
    # Inextensible columns on a rigid base that turns.
    *each_size("base_rocking", SWAY / TOP**2 * np.array([0.01, 0.1, 1.0])),
    *(case for floor in (2, 3, 4) for case in each_size("ground_spring", (2100.0,), floor=floor)),
    *(case for floor in FLOORS for case in each_size("added_mass", (1.3, -0.8), floor=floor, **LOADED)),
    # One cubic per column. The floor masses include the columns' own weight, so the frame subtracts it.
    *each_size("mass_coupling", (0.2, 1.5)),
    *(case for floor in FLOORS for case in each_size("sensor_gain", (0.15,), floor=floor)),
    *(case for floor in (1, 3) for case in each_size("sensor_gain", (-0.2, 0.02, 0.15), floor=floor, **LOADED)),
    *(case for story in FLOORS for case in each_size("story_change", (-0.2, 0.4), story=story, **LOADED)),
    # A diagonal over two or three stories whose columns do not stretch.
    *each_size("spring", (200.0, 4000.0, 20000.0), floor=1, to=3),
    *each_size("spring", (200.0, 4000.0, 20000.0), floor=2, to=4),
    *each_size("spring", (200.0, 4000.0, 20000.0), floor=1, to=4),
    *each_size("state_stiffness", (-0.02, -0.2, 0.3), **LOADED),
    *each_size("state_mass", (-0.05, 0.02, 0.3), **LOADED),
    *each_size("floor_mass", (1.7,), floor=3),
    *each_size("load_scale", (-0.1, 0.02, 0.3)),
    # Springs under the feet, or between the continuous columns and the beams of one floor.
    *(
        case
        for floor in (0, *FLOORS)
        for case in each_size("joint_release", ((0.02, 0.0), (0.5, 0.0), (20.0, 0.0)), floor=floor, **LOADED)
    ),
    # Springs under the feet of columns whose joints turn, in every test.
    *(([placed("joint_rotation"), placed("soft_feet")], (0.4, rho)) for rho in (0.05, 0.5, 20.0)),
    # A Bernoulli beam beside the frame, from a wall with some columns to a frame with a slender wall.
    *each_size("wall", np.array([0.5, 2.5, 8.0]) ** -2),
    *each_size("wall", np.array([0.5, 2.5, 8.0]) ** -2, floor=3),
    # The beams stay the same when the columns change in one configuration.
    ([placed("joint_rotation"), placed("story_change", story=2, **LOADED)], (0.5, -0.3)),
    # The connection turns in addition to the beam: their flexibilities add up.
    *(
        ([placed("joint_rotation"), placed("joint_release", floor=floor, **LOADED)], (0.4, (0.7, 0.0)))
        for floor in (0, 2, 4)
    ),
    # Diagonals pull at the ends of columns. Chord drift adds to the sway of braces and columns alike.
    *(([placed("bracing"), placed("axial_columns")], (beta, 0.9 * SWAY / TOP**3)) for beta in (0.3, 0.8)),
    # The wall keeps its stiffness if a story changes, and softens with the frame in a softer state.
    *(
        (
            [
                placed("joint_rotation"), placed("wall"), placed("state_stiffness", **LOADED),
                placed("story_change", story=2, **LOADED),
            ],
            (0.6, slenderness**-2, -0.1, -0.3),
        )
        for slenderness in (0.5, 2.5, 8.0)
    ),
    *(
        ([placed("wall"), placed("story_change", story=2, **LOADED), placed("gravity")], (slenderness**-2, -0.3, 1.1))
        for slenderness in (0.5, 2.5, 8.0)
    ),
    ([placed("axial_columns"), placed("base_rocking")], (0.3 * SWAY / TOP**3, 0.2 * SWAY / TOP**2)),
    # Floors and columns weigh the same, whatever the distribution of the column mass over its length.
    *(([placed("gravity"), placed("mass_coupling")], (gamma, 1.5)) for gamma in (1.0, 1.2)),
    # A rocking frame with flexible beams, weight on props, a spring, a load, damage and a wrong sensor.
    (
        [
            placed("base_rocking"), placed("joint_rotation"), placed("story_change", story=1, **LOADED),
            placed("ground_spring", floor=3), placed("added_mass", floor=2, **LOADED), placed("gravity"),
            placed("sensor_gain", floor=4),
        ],
        (0.2 * SWAY / TOP**2, 0.3, 0.2, 1500.0, 1.1, 1.0, -0.1),
    ),
]  # fmt: skip
"""Effects and sizes for which the formulas are exact, in the order in which the frame takes the changes."""


def of_case(value):
    return "-".join(each.label for each in value) if isinstance(value, list) else str(value)


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize(("effects", "sizes"), EXACT, ids=of_case)
def test_a_frame_with_these_effects_has_the_modes_of_the_formulas(effects, sizes, number):
    """An effect of the loaded state leaves the other one as it is."""
    there = [
        (each.effect.name, np.atleast_1d(size)[0], vars(each.place))
        for each, size in zip(effects, sizes, strict=True)
        if each.place.state in (None, NAMES[number])
    ]
    expected = fe.seen_by_sensors(building(), common.ADDED[number], there)
    assert_same(modes_with(effects, *sizes, number=number), expected)


def test_a_shear_frame_of_three_columns_is_the_same():
    three = replace(building(), column_x=(-0.4, 0.1, 0.3), column_share=(0.5, 0.2, 0.3))
    assert_same(modes_with([]), sway_modes(three))


def test_gravity_of_columns_that_may_take_any_shape():
    """The formula 6/5 is the first term in P; the error falls with P^2.

    Four elements per column find a deflection of order P h^2 / EI, which a single cubic cannot represent.
    """
    gaps = []
    for share in (1.0, 0.5):
        clamped = replace(building(), gravity=share * fe.GRAVITY)
        free = replace(clamped, pieces=4)
        gaps.append(np.max(np.abs(sway_modes(free).frequencies / sway_modes(clamped).frequencies - 1)))
    assert gaps[0] < 1e-5
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.05)


@pytest.mark.parametrize("eta", [0.05, 0.3, 1.0])
def test_gravity_lies_between_its_bounds_where_joints_turn(eta):
    """A column between rotating joints is straighter than a clamped column, but less straight than a prop."""
    frame = replace(fe.with_turning_joints(building(), eta), gravity=fe.GRAVITY)
    both = [placed("joint_rotation"), placed("gravity")]
    found = sway_modes(frame).frequencies
    assert np.all(found < modes_with(both, eta, 1.0).frequencies)
    assert np.all(found > modes_with(both, eta, 1.2).frequencies)


@pytest.mark.parametrize("size", [0.05, 0.3, 0.8])
def test_beams_of_each_floor_by_themselves(size):
    """The formula is exact for the same portals if the beams of each floor are 1 + b times more flexible."""
    eta, b = 0.4, size * np.array([1.0, -0.5, 0.3, -0.9])
    frame = fe.with_turning_joints(building(), eta)
    frame = replace(frame, beam_bending=frame.beam_bending / (1.0 + b))
    (other_beams,) = (each for each in open_classes() if each.name == "other_beams")
    effects = [LocatedEffect(other_beams.bound(common.experiment())), placed("joint_rotation")]
    assert_same(modes_with(effects, tuple(b), eta), sway_modes(frame))


def test_joint_rotation_of_two_bays():
    """The formula is exact if the inner column is two outer columns: two portals side by side."""
    one_bay = fe.with_turning_joints(building(), 0.4)
    two_bays = replace(
        one_bay, column_x=(-0.5, 0.0, 0.5), column_share=(0.25, 0.5, 0.25), beam_bending=0.5 * one_bay.beam_bending
    )
    assert_same(modes_with([placed("joint_rotation")], 0.4), sway_modes(two_bays))


def test_joint_rotation_of_equal_columns_in_two_bays():
    """Two beams hold the inner joint, so it turns less than the outer joints and the formula is no longer exact.

    With the same r = 24 EI / L in all beams, the formula is within 2 % of the frame; rigid beams are 13 % away.
    """
    eta = 0.3
    one_bay = fe.with_turning_joints(building(), eta)
    equal = replace(one_bay, column_x=(-0.5, 0.0, 0.5), beam_bending=0.5 * one_bay.beam_bending)
    found = sway_modes(equal)
    assert common.frequency_gap(modes_with([]), found) > 0.1
    assert common.frequency_gap(modes_with([placed("joint_rotation")], eta), found) < 0.02


def test_axial_columns_by_their_axial_stiffness_alone():
    """With EI = EA b^2 / 2 alone, the error falls with the square of the columns' share of all bending.

    The columns' own bending is this share of the frame's bending. Its part of the flexibility falls in proportion to
    the share.
    """
    columns = float(np.mean(STIFFNESS * common.HEIGHTS**3)) / 12
    gaps = []
    for ratio in (1000.0, 10000.0):
        EI = ratio * columns
        frame = replace(building(), column_axial=np.full(4, 2 * EI / fe.bay(building()) ** 2))
        gaps.append(common.frequency_gap(modes_with([placed("axial_columns")], 1 / EI), sway_modes(frame)))
    assert gaps[0] < 1e-4
    assert gaps[0] / gaps[1] == pytest.approx(100.0, rel=0.1)


def test_axial_columns_of_floors_that_move_up_and_down():
    """The floor masses at the joints add rotary inertia, which the formula leaves out.

    A floor turns by about u / H. Its joints are b / 2 from the center, so they add about (b / 2H)^2 of its mass times
    the chord drift's share of the sway: under 0.2 % here for the first mode, more for the higher modes.
    """
    inverse_EI = 0.3 * SWAY / TOP**3
    frame = replace(fe.with_long_columns(building(), inverse_EI), vertical_inertia=True)
    model, found = modes_with([placed("axial_columns")], inverse_EI), sway_modes(frame)
    assert model.frequencies[0] == pytest.approx(found.frequencies[0], rel=2e-3)
    assert model.frequencies[0] > found.frequencies[0]


def test_mass_coupling_of_columns_that_vibrate_themselves():
    """Columns with four elements vibrate by themselves. The error is of order mu^2: 5e-5 for a tenth of a floor."""
    gaps = []
    for mu in (1.0, 0.5):
        frame = replace(fe.with_heavy_columns(building(), mu), pieces=4)
        gaps.append(common.frequency_gap(modes_with([placed("mass_coupling")], mu), sway_modes(frame)))
    assert gaps[0] < 6e-5
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.1)
    assert common.frequency_gap(modes_with([]), sway_modes(replace(building(), column_mass=1.0))) > 100 * gaps[0]


def test_a_softer_state_of_a_braced_frame_whose_joints_turn():
    """Braces, columns and beams change together with the material. A story that lost some braces has fewer of them."""
    effects = [
        placed("joint_rotation"),
        placed("bracing"),
        placed("state_stiffness", state="loaded"),
        placed("story_change", story=3, state="loaded"),
    ]
    frame = fe.with_softer_state(fe.with_turning_joints(building(1), 0.5), -0.2)
    frame = fe.with_braces(replace(frame, beam_bending=0.6 * frame.beam_bending), 0.4)
    braces = frame.brace_axial.copy()
    braces[2] *= (0.4 - 0.1) / 0.4
    model = modes_with(effects, 0.5, 0.4, -0.2, -0.1, number=1)
    assert_same(model, sway_modes(replace(frame, brace_axial=braces)))


@pytest.mark.parametrize("floor", [0, 1, 4])
@pytest.mark.parametrize("longer", [0.002, 0.05, 0.4])
def test_a_clamp_that_grips_less(longer, floor):
    """The formula is exact if a weaker clamp makes the columns on both sides of its floor longer."""
    there = placed("joint_release", floor=floor, state="loaded")
    frame = building(1)
    stretched = np.isin(np.arange(1, 5), [floor, floor + 1])
    frame = replace(frame, heights=frame.heights * np.where(stretched, 1.0 + longer, 1.0))
    # The story stiffness belongs to columns of their own length.
    frame = replace(frame, story_stiffness=frame.story_stiffness / np.where(stretched, (1.0 + longer) ** 3, 1.0))
    assert_same(modes_with([there], 0.0, 1.0 - (1.0 + longer) ** -3, number=1), sway_modes(frame))


def test_a_hinge_at_both_ends_of_a_story():
    """A hinge at the columns' ends takes three quarters of a story's remaining stiffness; a second one the rest."""
    base = placed("joint_release", floor=0, state="loaded")
    k = composed([base], 1e9, 0.0, number=1).system.K.sum()
    assert k == pytest.approx(STIFFNESS[0] / 4, rel=1e-6)


@pytest.mark.parametrize("soil", [0.5, 3.0, 30.0])
def test_a_base_on_soft_ground_is_a_mass_attached_to_floor_1(soil):
    """The formula is exact: a chain with one additional mass below story 1, measured at the floors alone."""
    base, below = 5.0, soil * STIFFNESS[0]
    chain = np.concatenate([[below], STIFFNESS])
    T = np.eye(5) - np.eye(5, k=-1)
    squares, vectors = eigh(T.T @ np.diag(chain) @ T, np.diag([base, *MASS]))
    part = STIFFNESS[0] / (STIFFNESS[0] + below)
    series = STIFFNESS * np.where(np.arange(4) == 0, below / (STIFFNESS[0] + below), 1.0)
    frequency = np.sqrt((STIFFNESS[0] + below) / base) / (2 * np.pi)
    state = composed([placed("attached_mass", floor=1)], (base * part**2, frequency), stiffness=series)
    found, motions = eigh(state.system.K, state.system.M)
    # The attached mass in the model exceeds its parameter by a millionth of a floor mass.
    np.testing.assert_allclose(found, squares, rtol=1e-4)
    seen, shown = motions[:4], vectors[1:]
    np.testing.assert_allclose(
        seen / seen[np.abs(seen).argmax(axis=0), range(5)],
        shown / shown[np.abs(seen).argmax(axis=0), range(5)],
        atol=1e-4,
    )


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("beta", [0.05, 0.4, 0.9])
def test_bracing(beta, number):
    """Exact for crossing diagonals and columns whose joints turn. Without joint rotation, braces act like columns."""
    frame = fe.with_braces(fe.with_turning_joints(building(number), 0.5), beta)
    # The beams are the same as in the unbraced frame. Relative to the remaining columns, they are 1 / (1 - beta) times
    # stiffer.
    effects = [placed("joint_rotation"), placed("bracing")]
    assert_same(modes_with(effects, 0.5 * (1.0 - beta), beta, number=number), sway_modes(frame))
    assert_same(modes_with([placed("bracing")], beta), sway_modes(fe.with_braces(building(), beta)))


@pytest.mark.parametrize("change", [-0.6, -0.1, 0.1, 0.6])
def test_a_braced_story_that_changes(change):
    """The braces of a story change first, until they are lost or doubled; then its columns change."""
    effects = [placed("joint_rotation"), placed("bracing"), placed("story_change", story=2, state="loaded")]
    beta, columns = 0.3, STIFFNESS.copy()
    frame = fe.with_braces(fe.with_turning_joints(building(1), 0.5), beta)
    braces, columns = frame.brace_axial.copy(), frame.story_stiffness.copy()
    of_braces = np.clip(change, -beta, beta)
    braces[1] *= 1.0 + of_braces / beta
    columns[1] *= 1.0 + (change - of_braces) / (1.0 - beta)
    frame = replace(frame, brace_axial=braces, story_stiffness=columns)
    model = modes_with(effects, 0.5 * (1.0 - beta), beta, change, number=1)
    assert_same(model, sway_modes(frame), within=1e-10)


def every_mode(frame):
    """Return all modes of a frame with attached masses, as its floors move."""
    assembled = assemble(frame)
    eigenvalues, shapes = assembled.modes()
    floors = shapes[[assembled.coordinates["sway", floor] for floor in FLOORS]]
    return SwayModes(np.sqrt(eigenvalues) / (2 * np.pi), floors)


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("floor", [1, 3, 4])
@pytest.mark.parametrize(("mass", "tuning"), [(0.05, 0.6), (0.4, 0.98), (2.0, 1.0), (3.0, 2.3)])
def test_attached_mass(mass, tuning, floor, number):
    """All five modes of four floors and a mass on a spring: below the first mode, tuned to it, or between two modes."""
    frequency = tuning * sway_modes(building(0)).frequencies[0]
    there = placed("attached_mass", floor=floor)
    # The model adds this mass to the parameter, so that modes exist if the parameter is zero.
    more = LEAST_MASS * MASS.mean()
    model = modes_with([there], mass - more, frequency, number=number)
    frame = replace(building(number), attached=((floor, mass, mass * (2 * np.pi * frequency) ** 2),))
    assert len(model.frequencies) == 5
    assert_same(model, every_mode(frame), within=1e-9)


@pytest.mark.parametrize("tuning", [0.7, 1.4, 6.0])
def test_loads_that_are_not_fast_to_their_floors(tuning):
    """Compare all six modes of four floors and two loads on rubber: 3 kg on floor 1 and 5 kg on floor 4."""
    frequency = tuning * sway_modes(building(1)).frequencies[-1]
    model = modes_with([placed("load_mounting")], frequency, number=1)
    loads = {floor: float(load) for floor, load in enumerate(common.ADDED[1], 1) if load}
    frame = replace(
        building(0), attached=tuple((floor, load, load * (2 * np.pi * frequency) ** 2) for floor, load in loads.items())
    )
    assert len(model.frequencies) == 6
    assert_same(model, every_mode(frame), within=1e-9)


def test_loads_on_stiff_mountings_are_fast():
    """A load whose mounting has a thousand times the highest frequency acts as a fixed mass, to a part in a million."""
    fe = sway_modes(building(1))
    model = modes_with([placed("load_mounting")], 1000 * fe.frequencies[-1], number=1)
    np.testing.assert_allclose(model.frequencies[:4], fe.frequencies, rtol=1e-6)


def test_a_neighbor_on_the_ground_is_an_attached_mass_and_a_spring_to_the_ground():
    """Mass m, ground spring k, tie t: a ground spring t k / (t + k) and m (t / (t + k))^2 on a spring t^2 / (t + k)."""
    floor, mass, ground, tie = 3, 1.3, 900.0, 400.0
    M, K = np.diag([*MASS, mass]), np.zeros((5, 5))
    K[:4, :4] = composed([]).system.K
    K[4, 4] = ground + tie
    K[2, 2] += tie
    K[2, 4] = K[4, 2] = -tie
    values, vectors = eigh(K, M)
    part = tie / (tie + ground)
    state = composed(
        [placed("ground_spring", floor=floor), placed("attached_mass", floor=floor)],
        part * ground, part**2 * mass - LEAST_MASS * MASS.mean(), np.sqrt((tie + ground) / mass) / (2 * np.pi),
    )  # fmt: skip
    found = modes(state.system.M, state.system.K)
    np.testing.assert_allclose(found.eigenvalues, values, rtol=1e-9)
    np.testing.assert_allclose(np.abs(found.shapes[:, :4]), np.abs(vectors.T[:, :4]), atol=1e-9)
