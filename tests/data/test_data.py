"""Test kinds of data: residuals and derivatives by differences, a static test as the only scale, a custom kind."""

import re
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from cvxshear import Experiment, close_loop, identify
from cvxshear.data import Datum, ErrorFigure, Frequencies, Model, NoiseKind, Residual, Shapes, Static, data_of, register
from cvxshear.data import base as registry_module
from cvxshear.data.base import largest, numbered
from cvxshear.data.kinds import mac, scaled
from cvxshear.effects import compose
from cvxshear.fit.misfit import Misfit
from cvxshear.measurement.configuration import Configuration
from cvxshear.model import modes
from cvxshear.report import terminal
from cvxshear.report.html import render
from cvxshear.util.errors import InputError
from tests.effects.common import ADDED, HEIGHTS, MASS, STIFFNESS, theta
from tests.effects.test_derivatives import CASES, flat
from tests.frames import chain, configuration, experiment, modes_of

EFFECTS = [effect for effect, _ in CASES.values()]
OWN, OWN_SCALES = flat(list(CASES.values()))
AT = theta(*OWN)
STEPS = 1e-5 * np.concatenate([MASS, STIFFNESS, OWN_SCALES])
FORCE = np.array([0.0, 30.0, 0.0, 120.0])


def measured_twice(*, mass_normalized=False):
    """Return two configurations, one with a sensor missing and entries not measured, and a pull test of one state."""
    rng = np.random.default_rng(5)
    plain = configuration(MASS, STIFFNESS, ADDED[0], rng=rng, shape_noise=0.02, frequency_noise=0.01)
    loaded = configuration(
        MASS, STIFFNESS, ADDED[1], rng=rng, shape_noise=0.02, frequency_noise=0.01,
        modes=[1, 2, 4], measured_floors=[1, 3, 4], mass_normalized=mass_normalized,
    )  # fmt: skip
    loaded["mode_shapes"][1][0] = float("nan")
    if mass_normalized:
        loaded["mode_shapes"] = (0.2 * np.array(loaded["mode_shapes"])).tolist()
    _, K = chain(MASS, STIFFNESS)
    u = np.linalg.solve(K, FORCE) * (1 + 0.02 * rng.standard_normal(4))
    u[1] = np.nan
    declared = experiment(
        MASS, STIFFNESS, {**plain, "name": "plain"}, {**loaded, "name": "loaded"},
        frame={"total_mass": float(MASS.sum()), "story_heights": HEIGHTS.tolist()},
    )  # fmt: skip
    declared["static"] = [
        {"name": "pull", "state": "loaded", "force": FORCE.tolist(), "displacement": u.tolist(),
         "displacement_std": 0.01, "added_mass": [0.0, 0.0, 2.0, 0.0]}
    ]  # fmt: skip
    return Experiment.from_dict(declared)


def residual(datum, at, *, derivatives=True, of=None):
    of = measured_twice() if of is None else of
    return datum.residual(Model(compose(of, datum.tested, EFFECTS, at), slice(None), derivatives))


def quotients(value):
    """Return central differences of a function of all parameters, a row for each, times its step's scale."""
    rows = []
    for p, step in enumerate(STEPS):
        ahead, behind = AT.copy(), AT.copy()
        ahead[p] += step
        behind[p] -= step
        rows.append((value(ahead) - value(behind)) / 2)
    return np.array(rows)


def assert_close(analytic, differences):
    np.testing.assert_allclose(analytic, differences, rtol=0, atol=2e-6 * np.max(np.abs(differences)))


@pytest.mark.parametrize("kind", [Frequencies, Static])
def test_derivatives_of_frequencies_and_displacements(kind):
    of = measured_twice()
    for datum in kind.of(of):
        found = residual(datum, AT, of=of)
        assert len(found.r) == datum.count
        differences = quotients(lambda at, datum=datum: residual(datum, at, of=of).r)
        assert_close(found.J.T * STEPS[:, None], differences)


def test_derivatives_of_shapes_but_for_their_free_scales():
    """Kaufman's derivative is the exact one without the direction of each mode, which its free scale follows."""
    of = measured_twice()
    for datum in Shapes.of(of):
        found = residual(datum, AT, of=of)
        differences = quotients(lambda at, datum=datum: residual(datum, at, of=of).r)
        model = Model(compose(of, datum.tested, EFFECTS, AT), slice(None), True)
        direction = datum.tested.entry_weights * datum.seen(model)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        rows = differences.reshape(len(AT), *direction.shape)
        projected = rows - direction * np.sum(rows * direction, axis=2, keepdims=True)
        assert_close(found.J.T * STEPS[:, None], projected.reshape(len(AT), -1))
        squares = quotients(lambda at, datum=datum: np.sum(residual(datum, at, of=of).r ** 2))
        assert_close(2 * found.J.T @ found.r * STEPS, squares)


def test_derivatives_of_mass_normalized_shapes():
    of = measured_twice(mass_normalized=True)
    datum = Shapes.of(of)[1]
    found = residual(datum, AT, of=of)
    assert_close(found.J.T * STEPS[:, None], quotients(lambda at: residual(datum, at, of=of).r))


def test_counts_and_labels():
    of = measured_twice()
    assert [datum.label for datum in data_of(of)] == [
        'frequencies of "plain"', 'mode shapes of "plain"', 'frequencies of "loaded"', 'mode shapes of "loaded"',
        'displacements of "pull"',
    ]  # fmt: skip
    # Number of entries, minus one per mode with a free scale.
    assert [datum.count for datum in data_of(of)] == [4, 16 - 4, 3, 8 - 3, 3]
    assert Shapes.of(measured_twice(mass_normalized=True))[1].count == 8


@pytest.mark.parametrize("mass_normalized", [False, True])
def test_what_is_described_part_by_part_and_by_floor_is_the_whole_residual(mass_normalized):
    """Sums of squares over the parts, and over the floors for data at floors, equal the whole residual's."""
    of = measured_twice(mass_normalized=mass_normalized)
    for datum in data_of(of):
        model = Model(compose(of, datum.tested, EFFECTS, AT), slice(None), False)
        r = datum.residual(model).r
        if isinstance(datum, Shapes):
            off = datum.tested.entry_weights * (datum.tested.known_shapes - datum.seen(model))
            assert np.sum(off**2) == pytest.approx(r @ r, rel=1e-12)
        parts = datum.describe(model)
        assert sum(part.entries * part.deviations**2 for part in parts) == pytest.approx(r @ r, rel=1e-12)
        by_floor = datum.by_floor(model)
        if by_floor:
            assert sum(z @ z for z in by_floor.values()) == pytest.approx(r @ r, rel=1e-12)
            assert all(np.all(z != 0) for z in by_floor.values())


def test_errors_of_shapes_are_those_of_the_textbook():
    """MAC = (a'b)^2 / (a'a b'b) over the measured floors; b is scaled to a's largest entry of one."""
    of = measured_twice()
    datum = Shapes.of(of)[1]
    model = Model(compose(of, datum.tested, EFFECTS, AT), slice(None), False)
    found = datum.errors(model)
    for row, (measured, modelled) in enumerate(zip(datum.tested.mode_shapes, datum.seen(model), strict=True)):
        known = np.isfinite(measured)
        a, b = measured[known] / np.max(np.abs(measured[known])), modelled[known]
        assert found["mac"][row] == pytest.approx((a @ b) ** 2 / (a @ a) / (b @ b), rel=1e-12)
        share = (a @ b) / (b @ b)
        assert found["shape_error"][row] == pytest.approx(np.max(np.abs(share * b - a)), rel=1e-9)


def test_the_criterion_of_complex_shapes_is_that_of_the_definition():
    assert mac(np.array([1.0, 1.0j]), np.array([1.0, 1.0])) == pytest.approx(2.0 / (2.0 * 2.0))


def test_displacements_are_those_of_equilibrium():
    """Compare with the shear frame: each drift is the force above divided by the story stiffness."""
    of = measured_twice()
    (datum,) = Static.of(of)
    at = theta()
    model = Model(compose(of, datum.tested, [], at), slice(None), False)
    drifts = np.cumsum(FORCE[::-1])[::-1] / STIFFNESS
    known = np.isfinite(datum.tested.displacement)
    u = np.cumsum(drifts)[known]
    expected = (u - datum.tested.displacement[known]) / (0.01 * np.nanmax(np.abs(datum.tested.displacement)))
    np.testing.assert_allclose(datum.residual(model).r, expected, rtol=1e-9)
    assert [part.place for part in datum.describe(model)] == ["floor 1", "floor 3", "floor 4"]


def pulled(rng=None, noise=0.0):
    """Return a test without declared mass and a pull at the top, which alone relates newtons to kilograms."""
    keys = {"rng": rng, "shape_noise": 0.01, "frequency_noise": 0.001} if noise else {}
    declared = experiment(MASS, STIFFNESS, configuration(MASS, STIFFNESS, **keys), frame={})
    u = np.linalg.solve(chain(MASS, STIFFNESS)[1], FORCE)
    if noise:
        u = u + noise * u.max() * rng.standard_normal(4)
    declared["static"] = [{"force": FORCE.tolist(), "displacement": u.tolist(), "displacement_std": noise or 0.01}]
    return Experiment.from_dict(declared)


def test_a_static_test_alone_gives_the_masses_in_kilograms():
    exact = identify(pulled()).frame
    np.testing.assert_allclose(exact.floor_mass, MASS, rtol=1e-7)
    np.testing.assert_allclose(exact.story_stiffness, STIFFNESS, rtol=1e-7)


def test_a_static_test_s_noise_is_in_the_standard_deviations():
    z = []
    for seed in range(6):
        found = identify(pulled(np.random.default_rng(seed), 0.01)).frame
        z += [*(found.floor_mass - MASS) / found.floor_mass_std]
        z += [*(found.story_stiffness - STIFFNESS) / found.story_stiffness_std]
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.7
    result = close_loop(pulled(np.random.default_rng(1), 0.01))
    assert result.verdict == "adequate"
    assert result.after.estimate.quality.max_displacement_error < 0.05
    assert '"static test 1"' in str(result)  # a state of its own


@dataclass(frozen=True, eq=False)
class Weighed(Datum):
    """The weight of the whole frame on load cells, N, in a state that carries no added mass."""

    noise: ClassVar[NoiseKind] = NoiseKind(
        "weight", "weights", 5.0, 50.0, "load cells of 10 kN", unit="N",
        figures=(ErrorFigure("max_weight_error", "largest error of a weight", "weight_error", largest),),
    )  # fmt: skip
    weight: ClassVar[float] = 0.0
    std: ClassVar[float] = 0.01
    tested: object

    @classmethod
    def of(cls, experiment):
        return [cls(experiment.configurations[0])]

    label = "weight on load cells"
    declared = True
    count = 1

    def residual(self, model):
        unit = 9.81 / (self.std * self.weight)
        system = model.wanted
        r = np.array([unit * system.M.sum() - 1.0 / self.std])
        return Residual(r, unit * system.dM.sum(axis=(1, 2))[None] if model.derivatives else np.zeros((0, 0)))

    def errors(self, model):
        return {"weight_error": np.array([9.81 * model.state.system.M.sum() / self.weight - 1.0])}


@pytest.fixture
def weighed(monkeypatch):
    """Register the kind of datum above for one test."""
    monkeypatch.setattr(registry_module, "REGISTERED", dict(registry_module.REGISTERED))
    monkeypatch.setattr(Weighed, "weight", 9.81 * 1.1 * MASS.sum())
    register(Weighed)


@pytest.mark.usefixtures("weighed")
def test_a_kind_of_datum_of_ones_own_takes_part_in_identify_and_close_loop():
    """The total is then the mean of the declared and the weighed value, weighted by their precisions."""
    declared = experiment(
        MASS, STIFFNESS, configuration(MASS, STIFFNESS), frame={"total_mass": float(MASS.sum()), "total_mass_std": 0.02}
    )
    of = Experiment.from_dict(declared)
    said, cells = 1 / 0.02**2, 1 / (0.01 * 1.1) ** 2
    expected = (said + 1.1 * cells) / (said + cells)
    found = identify(of)
    assert found.frame.floor_mass.sum() / MASS.sum() == pytest.approx(expected, rel=1e-6)
    result = close_loop(of, effects=["sensor_gain"])
    assert result.frame.floor_mass.sum() / MASS.sum() == pytest.approx(expected, rel=1e-3)
    assert "weight on load cells" in [part.place for part in Weighed(of.configurations[0]).describe(model_of(of))]
    # Four frequencies, shapes of 12 free entries, the total, the weight; 4 masses and 4 stiffnesses.
    assert found.fit.dof == 4 + 12 + 1 + 1 - 8


@pytest.mark.usefixtures("weighed")
def test_a_kind_of_datum_of_ones_own_is_found_in_terminal_report_and_json(monkeypatch):
    """The output has its noise, its figure and its error in percent: the frame weighs 10 % less than the cells show."""
    monkeypatch.setattr(Weighed, "std", 100.0)
    result = close_loop(Experiment.from_dict(experiment(MASS, STIFFNESS, configuration(MASS, STIFFNESS))), ["gravity"])
    assert result.to_dict()["noise"]["weight"] is None
    assert result.to_dict()["after"]["max_weight_error"] == pytest.approx(1 - 1 / 1.1, rel=1e-3)
    page = render(result, "cvxshear")
    for said in (terminal.text(result, width=120), page):
        assert "noise of weights" in said
        assert "largest error of a weight" in said
        assert "9.09 %" in said
        assert "weight on load cells" in said
    monkeypatch.setattr(Weighed, "declared", False)
    estimated = terminal.text(close_loop(result.experiment, ["gravity"]), width=120)
    assert re.search(r"noise of weights +[\d.]+ ± [\d.]+ N \(estimated", estimated)


@pytest.mark.parametrize(
    ("noise", "said"),
    [
        ("displacement", "declare a NoiseKind"),
        (NoiseKind("mode_shape", "shapes", 0.1, 0.2, "mine"), "'mode_shape' is that of the noise of Shapes"),
    ],
)
def test_a_kind_whose_noise_cannot_take_part_is_refused(noise, said):
    with pytest.raises(InputError, match=said):
        register(type("Faulty", (Weighed,), {"noise": noise}))
    with pytest.raises(InputError, match=r"errors\(\) must return 'weight_error'"):
        register(type("Faulty", (Weighed,), {"errors": Datum.errors}))
    with pytest.raises(InputError, match="must be positive"):
        NoiseKind("wrong", "wrong", 0.2, 0.1, "")


def model_of(of):
    return Misfit(of).evaluate(theta()).models[0]


def test_modes_that_changed_places_are_paired_by_their_shapes():
    of = measured_twice()
    _, shapes = modes_of(MASS, STIFFNESS)
    swapped = experiment(
        MASS, STIFFNESS,
        {**configuration(MASS, STIFFNESS), "mode_shapes": shapes[[0, 1, 3, 2]].tolist()},
        frame={"total_mass": float(MASS.sum())},
    )  # fmt: skip
    (model,) = Misfit(Experiment.from_dict(swapped)).evaluate(theta()).models
    np.testing.assert_array_equal(model.paired, [0, 1, 3, 2])
    np.testing.assert_array_equal(Misfit(of).evaluate(theta()).models[0].paired, [0, 1, 2, 3])


def frame_with_masses(*attached):
    """Return modes and mass matrix of the frame of two floors with attached masses (floor, kg, Hz)."""
    n = 2 + len(attached)
    M, K = np.zeros((n, n)), np.zeros((n, n))
    M[:2, :2], K[:2, :2] = chain([10.0, 8.0], [9e3, 7e3])
    for own, (floor, mass, frequency) in enumerate(attached, 2):
        M[own, own] = mass
        at = np.ix_((floor, own), (floor, own))
        K[at] += mass * (2 * np.pi * frequency) ** 2 * np.array([[1, -1], [-1, 1]])
    return modes(M, K), M


def measured_modes(frequencies, which=(1, 2)):
    return Configuration(np.array(frequencies), modes=np.array(which), added_mass=np.zeros(2))


def test_numbers_of_modes_count_those_of_the_frame_without_an_attached_mass_s_own():
    plain, M = frame_with_masses()
    np.testing.assert_array_equal(numbered(measured_modes(plain.frequencies), plain, M), [0, 1])
    low, high = plain.frequencies
    # Far from every mode of the frame, the mass has its own mode, whatever the measured frequencies.
    for frequency, own in ((0.1 * low, 0), (0.5 * (low + high), 1), (10 * high, 2)):
        found, M = frame_with_masses((1, 0.01, frequency))
        rest = np.delete(np.arange(3), own)
        for measured in (found.frequencies[:2], found.frequencies[1:], found.frequencies[[0, 2]]):
            np.testing.assert_array_equal(numbered(measured_modes(measured), found, M), rest)
        np.testing.assert_array_equal(numbered(measured_modes([3.0], [2]), found, M), rest[1:])
    # Tuned to the first mode, the mass splits it into two modes. The measured one counts.
    found, M = frame_with_masses((1, 0.05, low))
    for measured in ([0, 2], [1, 2]):
        np.testing.assert_array_equal(numbered(measured_modes(found.frequencies[measured]), found, M), measured)
    # For several masses, the modes with most of their energy are left out.
    found, M = frame_with_masses((0, 0.01, 0.1 * low), (1, 0.01, 0.5 * (low + high)))
    np.testing.assert_array_equal(numbered(measured_modes(plain.frequencies), found, M), [1, 3])


def test_a_scale_is_that_of_weighted_least_squares():
    rng = np.random.default_rng(3)
    measured, modelled, weights = rng.standard_normal((3, 2, 5))
    weights[1] = 0.0
    scale, unit = scaled(measured, modelled, np.abs(weights))
    column, side = np.abs(weights[0]) * modelled[0], np.abs(weights[0]) * measured[0]
    assert scale[0] == pytest.approx(np.linalg.lstsq(column[:, None], side, rcond=None)[0][0])
    np.testing.assert_allclose(unit[0], column / np.linalg.norm(column))
    assert scale[1] == 0.0
    assert not unit[1].any()
