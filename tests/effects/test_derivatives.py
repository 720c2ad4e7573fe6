"""Compare derivatives by every parameter with central differences, for each effect alone and for all together."""

import numpy as np
import pytest

from cvxshear.effects import LocatedEffect, catalogue, compose, open_classes
from tests.effects.common import HEIGHTS, MASS, NAMES, STIFFNESS, experiment, placed, theta

TOP = float(HEIGHTS.sum())
SWAY = float(np.sum(1 / STIFFNESS))
CASES = {
    "gravity": (placed("gravity"), 1.13),
    "joint_rotation": (placed("joint_rotation"), 0.4),
    "axial_columns": (placed("axial_columns"), 0.5 * SWAY / TOP**3),
    "base_rocking": (placed("base_rocking"), 0.2 * SWAY / TOP**2),
    "ground_spring": (placed("ground_spring", floor=3), 2500.0),
    "added_mass": (placed("added_mass", floor=2, state="loaded"), 1.4),
    "mass_coupling": (placed("mass_coupling"), 1.1),
    "sensor_gain": (placed("sensor_gain", floor=3), 0.2),
    "story_change": (placed("story_change", story=2, state="loaded"), -0.3),
    "spring": (placed("spring", floor=1, to=3), 1800.0),
    "state_stiffness": (placed("state_stiffness", state="loaded"), -0.12),
    "state_mass": (placed("state_mass", state="loaded"), 0.15),
    "load_scale": (placed("load_scale"), -0.1),
    "floor_mass": (placed("floor_mass", floor=3), 1.2),
    "soft_feet": (placed("soft_feet"), 0.6),
    "joint_release": (placed("joint_release", floor=2, state="loaded"), (0.6, 0.1)),
    "bracing": (placed("bracing"), 0.2),
    "wall": (placed("wall"), 0.15),
}
SCALES = {"axial_columns": SWAY / TOP**3, "base_rocking": SWAY / TOP**2, "ground_spring": 2500.0, "spring": 2500.0}
"""Scale of a parameter, a small change, where it is not one. The step is a fraction of it."""
STEP = 1e-4
"""Step of the central differences, relative to the scale. Their error is about 1e-8 of the matrices' curvature plus
1e-12 from rounding."""
CLOSE = 1e-6

SECOND_PLACES = [
    (placed("ground_spring", floor=2), 900.0),
    (placed("sensor_gain", floor=3), -0.1),
    (placed("story_change", story=4, state="plain"), 0.25),
    (placed("story_change", story=2, state="loaded"), 0.15),
    (placed("added_mass", floor=4, state="loaded"), -0.5),
    (placed("sensor_gain", floor=3, state="loaded"), 0.1),
    (placed("joint_release", floor=0, state="loaded"), (0.3, 0.2)),
]


def flat(cases):
    """Return the parameter values of several effects, and their scales."""
    values = [np.atleast_1d(value) for _, value in cases]
    names = [there.effect.name for there, _ in cases]
    scales = [np.full(len(each), SCALES.get(name, 1.0)) for name, each in zip(names, values, strict=True)]
    return np.concatenate(values), np.concatenate(scales)


def quantities(effects, values, number):
    tested = experiment()
    state = compose(tested, tested.configurations[number], effects, values)
    system = state.system
    seen = state.observation
    d_seen = np.array([seen.slopes.get(p, np.zeros_like(seen.matrix)) for p in range(len(values))])
    return (system.M, system.K, seen.matrix), (system.dM, system.dK, d_seen)


def assert_derivatives(effects, own, number, scales):
    """Assert that each derivative times its scale equals the difference quotient, relative to the matrix's size."""
    at = theta(*own)
    steps = STEP * np.concatenate([MASS, STIFFNESS, scales])
    plain, derivatives = quantities(effects, at, number)
    assert [len(each) for each in derivatives] == [len(at)] * 3
    for p, step in enumerate(steps):
        ahead, behind = at.copy(), at.copy()
        ahead[p] += step
        behind[p] -= step
        further, _ = quantities(effects, ahead, number)
        before, _ = quantities(effects, behind, number)
        for value, derivative, up, down in zip(plain, derivatives, further, before, strict=True):
            quotient = (up - down) / (2 * STEP)
            atol = CLOSE * np.max(np.abs(value))
            np.testing.assert_allclose(derivative[p] * step / STEP, quotient, rtol=0, atol=atol, err_msg=f"by {p}")


ALL = list(CASES.values())
(OTHER_BEAMS,) = (LocatedEffect(each.bound(experiment())) for each in open_classes() if each.name == "other_beams")
BEAMS = (OTHER_BEAMS, (0.3, -0.2, 0.6, -0.7))
ATTACHED = [(placed("attached_mass", floor=3), size) for size in ((0.0, 2.0), (0.7, 3.1), (0.7, 12.0))]
MOUNTED = [(placed("load_mounting"), frequency) for frequency in (3.1, 25.0)]
SETS = [
    *([case] for case in ALL),
    ALL,
    # Two gains at one floor, or two changes of one story, multiply. Their derivatives need the product rule.
    [*ALL, *SECOND_PLACES],
    # An attached mass has two parameters and its own motion; a load on a mounting has a motion too.
    *([case] for case in (*ATTACHED, *MOUNTED)),
    *([*ALL, case, (placed("attached_mass", floor=1), (0.3, 5.0))] for case in ATTACHED),
    *([*ALL, case] for case in MOUNTED),
    # Beams of each floor by themselves change a matrix only together with joint rotation.
    [CASES["joint_rotation"], BEAMS],
    [*ALL, BEAMS],
    # A search tries a change from null; without braces it is one of the columns, which the joints feel.
    [CASES["joint_rotation"], (placed("story_change", story=2, state="loaded"), 0.0)],
    # Bounded fits end at the null value. The formulas hold on both sides of it.
    *([(there, tuple(item.null for item in there.effect.parameters))] for there, _ in ALL),
]


@pytest.mark.parametrize("number", range(len(NAMES)))
@pytest.mark.parametrize("cases", SETS, ids=lambda cases: cases[-1][0].label if len(cases) < 3 else str(len(cases)))
def test_derivatives_are_difference_quotients(cases, number):
    own, scales = flat(cases)
    assert_derivatives([effect for effect, _ in cases], own, number, scales)


def test_every_effect_of_the_catalogue_is_tested():
    """Every effect is tested, except statements about masses and priors, which change no matrix.
    `tests/loop/test_open_classes.py` tests the forces, and `test_turning.py` the centers of floors that turn."""
    elsewhere = {
        "attached_mass", "load_mounting", "total_mass", "wrong_prior", "wrong_exact_prior", "shape_scale",
        "force_scale", "eccentric_mass", "eccentric_stiffness", "turned_axes",
    }  # fmt: skip
    assert {effect.name for effect in catalogue()} == {*CASES, *elsewhere}
