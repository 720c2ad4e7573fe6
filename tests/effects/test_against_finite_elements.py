"""Compare every effect with a frame of beams and columns that has this effect.

`tests.fe.experiments` names the frames for which a formula is exact. For the other effects, the tests measure how fast
the frame approaches the formula.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from cvxshear.data.base import numbered
from cvxshear.effects import LocatedEffect, open_classes
from cvxshear.effects.masses import LEAST_MASS
from cvxshear.model import frame_modes, modes
from tests.effects.common import (
    ADDED,
    HEIGHTS,
    MASS,
    ROUNDING,
    STIFFNESS,
    assert_same,
    building,
    composed,
    experiment,
    frequency_gap,
    modes_with,
    placed,
    shape_gap,
)
from tests.fe import experiments as fe
from tests.fe.frame import SwayModes, assemble, sway_modes

NUMBERS = (0, 1)
TOP = float(HEIGHTS.sum())
SWAY = float(np.sum(1 / STIFFNESS))
"""Static displacement of the top under 1 N at the top, in m."""


@pytest.mark.parametrize("number", NUMBERS)
def test_shear_frame(number):
    assert_same(modes_with([], number=number), sway_modes(building(number)))


def test_a_shear_frame_of_three_columns_is_the_same():
    three = replace(building(), column_x=(-0.4, 0.1, 0.3), column_share=(0.5, 0.2, 0.3))
    assert_same(modes_with([]), sway_modes(three))


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("gamma", [1.0, 1.07, 1.2])
def test_gravity(gamma, number):
    """The formula is exact: rigid props fall by d^2 / 2h, and a clamped cubic's geometric stiffness integrates to 6 P /
    5 h."""
    frame = fe.with_gravity(building(number), gamma)
    assert_same(modes_with([placed("gravity")], gamma, number=number), sway_modes(frame))


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


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("eta", [1e-3, 0.1, 1.0, 50.0])
def test_joint_rotation(eta, number):
    """The formula is exact for Bernoulli members and two equal columns whose joints turn alike."""
    frame = fe.with_turning_joints(building(number), eta)
    assert_same(modes_with([placed("joint_rotation")], eta, number=number), sway_modes(frame))


@pytest.mark.parametrize("size", [0.05, 0.3, 0.8])
def test_beams_of_each_floor_by_themselves(size):
    """The formula is exact for the same portals if the beams of each floor are 1 + b times more flexible."""
    eta, b = 0.4, size * np.array([1.0, -0.5, 0.3, -0.9])
    frame = fe.with_turning_joints(building(), eta)
    frame = replace(frame, beam_bending=frame.beam_bending / (1.0 + b))
    (other_beams,) = (each for each in open_classes() if each.name == "other_beams")
    effects = [LocatedEffect(other_beams.bound(experiment())), placed("joint_rotation")]
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
    assert frequency_gap(modes_with([]), found) > 0.1
    assert frequency_gap(modes_with([placed("joint_rotation")], eta), found) < 0.02


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("part", [0.01, 0.1, 1.0])
def test_axial_columns(part, number):
    """The formula is exact for floors that stay rigid and tilt. EI combines the columns' EA b^2 / 2 and their own
    bending."""
    inverse_EI = 3 * part * SWAY / TOP**3
    frame = fe.with_long_columns(building(number), inverse_EI)
    assert_same(modes_with([placed("axial_columns")], inverse_EI, number=number), sway_modes(frame))


def test_axial_columns_by_their_axial_stiffness_alone():
    """With EI = EA b^2 / 2 alone, the error falls with the square of the columns' share of all bending.

    The columns' own bending is this share of the frame's bending. Its part of the flexibility falls in proportion to
    the share.
    """
    columns = float(np.mean(STIFFNESS * HEIGHTS**3)) / 12
    gaps = []
    for ratio in (1000.0, 10000.0):
        EI = ratio * columns
        frame = replace(building(), column_axial=np.full(4, 2 * EI / fe.bay(building()) ** 2))
        gaps.append(frequency_gap(modes_with([placed("axial_columns")], 1 / EI), sway_modes(frame)))
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


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("part", [0.01, 0.1, 1.0])
def test_base_rocking(part, number):
    """The formula is exact for inextensible columns on a rigid base that turns."""
    inverse = part * SWAY / TOP**2
    frame = fe.with_rocking_base(building(number), inverse)
    assert_same(modes_with([placed("base_rocking")], inverse, number=number), sway_modes(frame))


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("floor", [2, 3, 4])
def test_ground_spring(floor, number):
    frame = fe.with_ground_spring(building(number), 2100.0, floor)
    assert_same(modes_with([placed("ground_spring", floor=floor)], 2100.0, number=number), sway_modes(frame))


@pytest.mark.parametrize("floor", [1, 2, 3, 4])
@pytest.mark.parametrize("mass", [1.3, -0.8])
def test_added_mass(floor, mass):
    there = placed("added_mass", floor=floor, state="loaded")
    assert_same(modes_with([there], mass, number=1), sway_modes(fe.with_mass(building(1), mass, floor)))
    assert_same(modes_with([there], mass, number=0), sway_modes(building(0)))


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("mu", [0.2, 1.5])
def test_mass_coupling(mu, number):
    """The formula is exact for one cubic per column. The floor masses include the columns' own weight, so the test
    subtracts it."""
    frame = fe.with_heavy_columns(building(number), mu)
    assert_same(modes_with([placed("mass_coupling")], mu, number=number), sway_modes(frame))


def test_mass_coupling_of_columns_that_vibrate_themselves():
    """Columns with four elements vibrate by themselves. The error is of order mu^2: 5e-5 for a tenth of a floor."""
    gaps = []
    for mu in (1.0, 0.5):
        frame = replace(fe.with_heavy_columns(building(), mu), pieces=4)
        gaps.append(frequency_gap(modes_with([placed("mass_coupling")], mu), sway_modes(frame)))
    assert gaps[0] < 6e-5
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.1)
    assert frequency_gap(modes_with([]), sway_modes(replace(building(), column_mass=1.0))) > 100 * gaps[0]


@pytest.mark.parametrize("floor", [1, 2, 3, 4])
@pytest.mark.parametrize("number", NUMBERS)
def test_sensor_gain(floor, number):
    true = sway_modes(building(number))
    seen = true.shapes.copy()
    seen[floor - 1] *= 1.15
    model = modes_with([placed("sensor_gain", floor=floor)], 0.15, number=number)
    assert_same(model, SwayModes(true.frequencies, seen))
    assert shape_gap(model, true) > 0.01


@pytest.mark.parametrize("story", [1, 2, 3, 4])
@pytest.mark.parametrize("change", [-0.2, 0.4])
def test_story_change(story, change):
    there = placed("story_change", story=story, state="loaded")
    assert_same(modes_with([there], change, number=1), sway_modes(fe.with_story_change(building(1), change, story)))
    assert_same(modes_with([there], change, number=0), sway_modes(building(0)))


def test_changed_story_between_joints_that_turn():
    """The beams stay the same when the columns change in one configuration."""
    effects = [placed("joint_rotation"), placed("story_change", story=2, state="loaded")]
    frame = fe.with_story_change(fe.with_turning_joints(building(1), 0.5), -0.3, 2)
    assert_same(modes_with(effects, 0.5, -0.3, number=1), sway_modes(frame))


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("floors", [(1, 3), (2, 4), (1, 4)])
@pytest.mark.parametrize("s", [200.0, 4000.0, 20000.0])
def test_spring(s, floors, number):
    """The formula is exact for a diagonal over two or three stories whose columns do not stretch."""
    tie = placed("spring", floor=floors[0], to=floors[1])
    assert_same(modes_with([tie], s, number=number), sway_modes(fe.with_tie(building(number), s, floors)))


@pytest.mark.parametrize("e", [-0.02, -0.2, 0.3])
def test_state_stiffness(e):
    there = placed("state_stiffness", state="loaded")
    assert_same(modes_with([there], e, number=1), sway_modes(fe.with_softer_state(building(1), e)))
    assert_same(modes_with([there], e, number=0), sway_modes(building(0)))


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


@pytest.mark.parametrize("e", [-0.05, 0.02, 0.3])
def test_state_mass(e):
    there = placed("state_mass", state="loaded")
    frame = replace(building(1), floor_mass=building(1).floor_mass + e * building(0).floor_mass)
    assert_same(modes_with([there], e, number=1), sway_modes(frame))
    assert_same(modes_with([there], e, number=0), sway_modes(building(0)))


@pytest.mark.parametrize("number", [0, 1])
def test_floor_mass_is_there_in_every_state(number):
    frame = building(number)
    heavier = replace(frame, floor_mass=frame.floor_mass + 1.7 * (np.arange(frame.stories) == 2))
    assert_same(modes_with([placed("floor_mass", floor=3)], 1.7, number=number), sway_modes(heavier))


@pytest.mark.parametrize("e", [-0.1, 0.02, 0.3])
def test_load_scale(e):
    added = building(1).floor_mass - building(0).floor_mass
    frame = replace(building(1), floor_mass=building(0).floor_mass + (1.0 + e) * added)
    assert_same(modes_with([placed("load_scale")], e, number=1), sway_modes(frame))
    assert_same(modes_with([placed("load_scale")], e, number=0), sway_modes(building(0)))


@pytest.mark.parametrize("floor", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("rho", [0.02, 0.5, 20.0])
def test_joint_release(rho, floor):
    """The formula is exact for springs under the feet, or between the continuous columns and the beams of one floor."""
    there = placed("joint_release", floor=floor, state="loaded")
    assert_same(modes_with([there], rho, 0.0, number=1), sway_modes(fe.with_loose_joints(building(1), rho, floor)))
    assert_same(modes_with([there], rho, 0.0, number=0), sway_modes(building(0)))


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


@pytest.mark.parametrize("floor", [0, 2, 4])
def test_loose_joints_of_beams_that_bend(floor):
    """The connection turns in addition to the beam: their flexibilities add up."""
    effects = [placed("joint_rotation"), placed("joint_release", floor=floor, state="loaded")]
    frame = fe.with_loose_joints(fe.with_turning_joints(building(1), 0.4), 0.7, floor)
    assert_same(modes_with(effects, 0.4, 0.7, 0.0, number=1), sway_modes(frame))


@pytest.mark.parametrize("rho", [0.05, 0.5, 20.0])
def test_soft_feet(rho):
    """The formula is exact for springs under the feet of columns whose joints turn, in every test."""
    effects = [placed("joint_rotation"), placed("soft_feet")]
    for number in (0, 1):
        frame = fe.with_loose_joints(fe.with_turning_joints(building(number), 0.4), rho, 0)
        assert_same(modes_with(effects, 0.4, rho, number=number), sway_modes(frame))


def test_a_hinge_at_both_ends_of_a_story():
    """Each hinge at the columns' ends takes three quarters of the remaining stiffness of a story; hinges at all ends
    leave zero."""
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
    """The formula is exact for crossing diagonals and columns whose joints turn. Without joint rotation, braces and
    columns have the same effect."""
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


@pytest.mark.parametrize("beta", [0.3, 0.8])
def test_chord_drift_of_a_braced_frame(beta):
    """Diagonals pull at the ends of columns. Chord drift adds to the sway of braces and columns alike."""
    inverse_EI = 0.9 * SWAY / TOP**3
    braced = fe.with_long_columns(fe.with_braces(building(), beta), inverse_EI)
    model = modes_with([placed("axial_columns"), placed("bracing")], inverse_EI, beta)
    assert_same(model, sway_modes(braced))


@pytest.mark.parametrize("floor", [1, 3])
@pytest.mark.parametrize("g", [-0.2, 0.02, 0.15])
def test_sensor_gain_in_one_state(floor, g):
    there = placed("sensor_gain", floor=floor, state="loaded")
    seen = sway_modes(building(1))
    seen.shapes[floor - 1] *= 1.0 + g
    assert_same(modes_with([there], g, number=1), seen)
    assert_same(modes_with([there], g, number=0), sway_modes(building(0)))


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("floor", [1, 3, 4])
@pytest.mark.parametrize(("mass", "tuning"), [(0.05, 0.6), (0.4, 0.98), (2.0, 1.0), (3.0, 2.3)])
def test_attached_mass(mass, tuning, floor, number):
    """Compare all five modes of four floors and a mass on a spring: below the first mode, tuned to it, or between two
    modes."""
    frequency = tuning * sway_modes(building(0)).frequencies[0]
    there = placed("attached_mass", floor=floor)
    # The model adds this mass to the parameter, so that modes exist if the parameter is zero.
    more = LEAST_MASS * MASS.mean()
    model = modes_with([there], mass - more, frequency, number=number)
    frame = replace(building(number), attached=((floor, mass, mass * (2 * np.pi * frequency) ** 2),))
    assembled = assemble(frame)
    eigenvalues, shapes = assembled.modes()
    floors = shapes[[assembled.coordinates["sway", i] for i in range(1, 5)]]
    assert len(model.frequencies) == 5
    assert_same(model, SwayModes(np.sqrt(eigenvalues) / (2 * np.pi), floors), within=1e-9)


@pytest.mark.parametrize("tuning", [0.7, 1.4, 6.0])
def test_loads_that_are_not_fast_to_their_floors(tuning):
    """Compare all six modes of four floors and two loads on rubber: 3 kg on floor 1 and 5 kg on floor 4."""
    frequency = tuning * sway_modes(building(1)).frequencies[-1]
    model = modes_with([placed("load_mounting")], frequency, number=1)
    loads = {floor: float(load) for floor, load in enumerate(ADDED[1], 1) if load}
    frame = replace(
        building(0), attached=tuple((floor, load, load * (2 * np.pi * frequency) ** 2) for floor, load in loads.items())
    )
    assembled = assemble(frame)
    eigenvalues, shapes = assembled.modes()
    floors = shapes[[assembled.coordinates["sway", i] for i in range(1, 5)]]
    assert len(model.frequencies) == 6
    assert_same(model, SwayModes(np.sqrt(eigenvalues) / (2 * np.pi), floors), within=1e-9)


def test_loads_on_stiff_mountings_are_fast():
    """A load whose mounting has a thousand times the highest frequency acts as a fixed mass, to a part in a million."""
    fe = sway_modes(building(1))
    model = modes_with([placed("load_mounting")], 1000 * fe.frequencies[-1], number=1)
    np.testing.assert_allclose(model.frequencies[:4], fe.frequencies, rtol=1e-6)


def test_a_neighbor_on_the_ground_is_an_attached_mass_and_a_spring_to_the_ground():
    """A neighbor (mass m, ground spring k, tie t) equals a ground spring t k / (t + k) and a mass m (t / (t + k))^2 on
    a spring t^2 / (t + k)."""
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


def test_modes_are_numbered_without_the_attached_mass():
    """The attached mass's own mode is not numbered. If two modes share its motion, the number of the unmeasured one is
    left out."""
    plain = sway_modes(building(0)).frequencies
    for tuning, own in ((0.5, 0), (1.7, 1), (5.0, 4)):
        there = placed("attached_mass", floor=4)
        state = composed([there], 0.02, tuning * plain[0])
        found = modes(state.system.M, state.system.K)
        test = replace_frequencies(plain)
        np.testing.assert_array_equal(numbered(test, found, state.system.M), np.delete(np.arange(5), own))
        assert frame_modes(found, state.system.M, 4).tolist() == [mode for mode in range(5) if mode != own]
    state = composed([placed("attached_mass", floor=4)], 1.0, plain[0])
    found = modes(state.system.M, state.system.K)
    f = found.frequencies
    assert f[0] < plain[0] < f[1]
    for seen in ([0, 2, 3, 4], [1, 2, 3, 4], [0, 1, 2, 3]):
        assert numbered(replace_frequencies(f[seen]), found, state.system.M).tolist() == seen


def replace_frequencies(measured):
    """Return a test of the frame with these measured frequencies."""
    return replace(
        experiment().configurations[0],
        frequencies=np.array(measured),
        modes=np.arange(1, len(measured) + 1),
        mode_shapes=np.full((len(measured), 4), np.nan),
    )


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("slenderness", [0.5, 2.5, 8.0])
def test_wall(slenderness, number):
    """The formula is exact for a Bernoulli beam beside the frame, from a wall with some columns to a frame with a
    slender wall."""
    w = slenderness**-2
    assert_same(modes_with([placed("wall")], w, number=number), sway_modes(fe.with_wall(building(number), w)))
    low = building(number).stories - 1
    assert_same(
        modes_with([placed("wall", floor=low)], w, number=number), sway_modes(fe.with_wall(building(number), w, low))
    )


@pytest.mark.parametrize("slenderness", [0.5, 2.5, 8.0])
def test_a_wall_beside_joints_that_turn_under_weight_with_a_changed_story(slenderness):
    """The wall keeps its stiffness if a story changes, and softens with the frame in a softer state."""
    effects = [
        placed("joint_rotation"),
        placed("wall"),
        placed("story_change", story=2, state="loaded"),
        placed("state_stiffness", state="loaded"),
    ]
    w = slenderness**-2
    frame = fe.with_softer_state(fe.with_wall(fe.with_turning_joints(building(1), 0.6), w), -0.1)
    frame = fe.with_story_change(frame, -0.3, 2)
    assert_same(modes_with(effects, 0.6, w, -0.3, -0.1, number=1), sway_modes(frame))
    straight = [placed("wall"), placed("gravity"), effects[2]]
    frame = fe.with_gravity(fe.with_story_change(fe.with_wall(building(1), w), -0.3, 2), 1.1)
    assert_same(modes_with(straight, w, 1.1, -0.3, number=1), sway_modes(frame))


def test_many_effects_at_once():
    """The formulas are exact together: a rocking frame with flexible beams, weight on props, a spring, a load and
    damage."""
    effects = [
        placed("joint_rotation"),
        placed("base_rocking"),
        placed("ground_spring", floor=3),
        placed("added_mass", floor=2, state="loaded"),
        placed("story_change", story=1, state="loaded"),
        placed("gravity"),
        placed("sensor_gain", floor=4),
    ]
    rocking = 0.2 * SWAY / TOP**2
    frame = fe.with_story_change(fe.with_turning_joints(fe.with_rocking_base(building(1), rocking), 0.3), 0.2, 1)
    frame = fe.with_gravity(fe.with_mass(fe.with_ground_spring(frame, 1500.0, 3), 1.1, 2), 1.0)
    found = sway_modes(frame)
    found.shapes[3] *= 0.9
    assert_same(modes_with(effects, 0.3, rocking, 1500.0, 1.1, 0.2, 1.0, -0.1, number=1), found)


def test_chord_drift_on_a_rocking_base():
    effects = [placed("axial_columns"), placed("base_rocking")]
    bending, rocking = 0.3 * SWAY / TOP**3, 0.2 * SWAY / TOP**2
    frame = fe.with_rocking_base(fe.with_long_columns(building(), bending), rocking)
    assert_same(modes_with(effects, bending, rocking), sway_modes(frame))


@pytest.mark.parametrize("gamma", [1.0, 1.2])
def test_weight_of_heavy_columns(gamma):
    """Floors and columns weigh the same, whatever the distribution of the column mass over its length."""
    frame = fe.with_gravity(fe.with_heavy_columns(building(1), 1.5), gamma)
    assert_same(modes_with([placed("gravity"), placed("mass_coupling")], gamma, 1.5, number=1), sway_modes(frame))


def test_total_mass_and_sway_stiffness_by_statics():
    """A rigid translation of all floors deforms story 1 only; its mass is the sum of all floor masses."""
    state = composed([])
    together = np.ones(4)
    assert together @ state.system.K @ together == pytest.approx(STIFFNESS[0], rel=ROUNDING)
    assert together @ state.system.M @ together == pytest.approx(MASS.sum(), rel=ROUNDING)
