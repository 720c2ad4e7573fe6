"""Programs of floors that turn, against frames assembled from columns and point masses (tests/fe/plan_frames.py)."""

import numpy as np
import pytest

import cvxshear
from cvxshear import backends, programs
from cvxshear.fit.turning_floors import HeldProgram
from cvxshear.motions import THREE_MOTIONS, products
from cvxshear.programs.turning import TurningTest
from tests.fe.plan_frames import random_frame


def assert_close(found, expected, each, rtol):
    """Compare entries with the largest of their kind: an eccentricity can be near zero."""
    found, expected = found.reshape(-1, each), expected.reshape(-1, each)
    error = np.max(np.abs(found - expected), axis=0) / np.max(np.abs(expected), axis=0)
    assert np.all(error < rtol), error


def test_added_masses_at_their_places_are_known():
    frame = random_frame(2, 5)
    loads = [np.array([1.0, -2.0, 4e3]), np.array([0.5, 1.5, 3e3])]
    loaded = type(frame)(
        frame.plan, frame.columns, [np.vstack([own, load]) for own, load in zip(frame.weights, loads, strict=True)]
    )
    tested = loaded.experiment(
        added_mass=[load[2] for load in loads], added_mass_position=[load[:2].tolist() for load in loads]
    )
    declared = tested.to_dict()
    declared["frame"]["total_mass"] = frame.floor_mass.sum()
    masses = programs.one_shot_masses(declared).solve("kkt").x
    assert_close(masses, frame.parameters[0], 4, 1e-8)
    assert_close(programs.story_stiffnesses(declared, masses).solve("kkt").x, frame.parameters[1], 6, 1e-8)


def test_the_noise_of_the_rows_is_what_the_deviations_of_the_readings_make():
    """Every reading is moved by its deviation; the rows are bilinear, so that central differences are exact."""
    experiment = random_frame(2, 4).experiment(noise=0.01, seed=4, std=0.01)
    test = TurningTest.of(experiment, experiment.configurations[0], "this test")
    rows = test.stiffness_rows(test.even_masses)
    modes, expected = test.normalized(test.even_masses), np.zeros((12, 12))

    def moved(step):
        drifts = THREE_MOTIONS.relative(modes + step)
        return rows.weights[:, None] * products(drifts, drifts, THREE_MOTIONS.stiffness_basis)[rows.pairs]

    for mode, reading in np.ndindex(rows.std.shape):
        step = np.outer(rows.std[mode, reading] * test.inverse[:, reading], np.arange(len(modes)) == mode)
        change = 0.5 * (moved(step) - moved(-step))
        expected += change.T @ change
    np.testing.assert_allclose(rows.noise, expected, atol=1e-9 * np.max(expected))


def test_even_stories_have_the_first_eigenvalue_as_rayleigh_quotient():
    frame = random_frame(3, 4)
    experiment = frame.experiment()
    test, masses = TurningTest.of(experiment, experiment.configurations[0], "this test"), frame.parameters[0]
    entries = test.even_stiffnesses(masses).reshape(-1, 6)
    even = np.column_stack([np.ones((3, 2)), experiment.radius**2, np.zeros((3, 3))])
    np.testing.assert_allclose(entries, entries[0, 0] * even)
    phi, (first, *_) = test.shapes[:, 0], experiment.configurations[0].frequencies
    quotient = phi @ THREE_MOTIONS.stiffnesses(entries.ravel()) @ phi / (phi @ THREE_MOTIONS.masses(masses) @ phi)
    assert quotient == pytest.approx((2 * np.pi * first) ** 2)


def test_what_no_sensor_sees_does_not_move():
    """Oblique sensors at the reference points see no rotation; a pseudoinverse alone would round its zeros."""
    sensors = [{"floor": at, "position": [0.0, 0.0], "direction": angle} for at in (1, 2, 3) for angle in (20.0, 75.0)]
    experiment = random_frame(3, 1).experiment(sensors=sensors)
    test = TurningTest.of(experiment, experiment.configurations[0], "this test")
    assert test.unseen == ("rotation",)
    assert not np.any(test.shapes[2::3])


def violated(seed=3, noise=0.002):
    """Return a program whose noise makes an inertia too small, so that its matrix inequality becomes active."""
    frame = random_frame(3, seed)
    program = programs.one_shot_masses(frame.experiment(noise=noise, seed=seed, std=noise))
    free = program.kkt().x
    # A floor that is declared lighter by its inertia than the data have it: x_3 of floor 2 at most half of s^2 / m.
    least = np.linalg.eigvalsh(program.lmi[1].at(free))[0]
    raised = program.lmi[1].constant - 1.5 * max(least, 0.0) * np.eye(3)
    tighter = type(program.lmi[1])(program.lmi[1].name, raised, program.lmi[1].slopes)
    return program.replace(lmi=(program.lmi[0], tighter, program.lmi[2]))


@pytest.mark.parametrize("backend", ["clarabel", "scs"])
def test_an_active_matrix_inequality_has_a_dual_matrix(backend):
    """Complementarity, and the gradient of the Lagrangian, computed here from the arrays alone."""
    program = violated()
    solution = program.solve(backend)
    x, (lmi) = solution.x, program.lmi[1]
    value, dual = lmi.at(x), solution.duals[lmi.name]
    scale = np.trace(dual) * np.trace(value)
    assert np.linalg.eigvalsh(value)[0] == pytest.approx(0.0, abs=1e-6 * np.trace(value))
    assert np.linalg.eigvalsh(dual)[0] >= -1e-12 * np.trace(dual)  # rounding of eigenvalues
    assert np.trace(dual) > 0
    assert abs(np.sum(dual * value)) < 1e-5 * scale
    gradient = program.P @ x + program.q + program.A.T @ solution.duals["A"]
    for each in program.lmi:
        gradient = gradient - np.tensordot(each.slopes, solution.duals[each.name], 2)
    size = np.abs(program.P) @ np.abs(x) + np.abs(program.q)
    assert np.max(np.abs(gradient) / size) < 1e-6
    assert [each.name for each in solution.active if each.constraint == "lmi"] == [lmi.name]
    assert solution.certificate.worst < 1e-6
    assert program.objective(x) > program.objective(program.kkt().x)


def test_the_price_of_a_matrix_inequality_is_the_change_of_the_objective():
    program = violated()
    solution = program.solve("clarabel")
    price = next(each.dual for each in solution.active if each.constraint == "lmi")
    step = 1e-3 * np.trace(program.lmi[1].at(solution.x))
    lmi = program.lmi[1]
    objectives = []
    for sign in (-1, 1):
        moved = type(lmi)(lmi.name, lmi.constant + sign * step * np.eye(3), lmi.slopes)
        objectives.append(program.replace(lmi=(program.lmi[0], moved, program.lmi[2])).solve("clarabel").objective)
    assert (objectives[1] - objectives[0]) / (2 * step) == pytest.approx(-price, rel=1e-2)


def test_a_matrix_at_its_limit_stays_singular_to_first_order_under_noise():
    program, experiment = violated(), random_frame(3, 3).experiment(noise=0.002, seed=3, std=0.002)
    test = TurningTest.of(experiment, experiment.configurations[0], "this test")
    unit = test.even_masses[0] * experiment.units(1.0, 1.0)[experiment.of_floors]
    held = HeldProgram.of(program, test.mass_rows(), test.even_masses, unit, backends.get("clarabel"))
    least = []
    for lmi in program.lmi:
        v = np.linalg.eigh(lmi.at(held.solution.x))[1][:, 0]
        least.append(np.linalg.norm(np.tensordot(lmi.slopes, np.outer(v, v), 2) @ held.response))
    assert least[1] < 1e-6 * min(least[0], least[2])


@pytest.mark.parametrize("seed", range(3))
def test_backends_agree_within_their_certificates(seed):
    for program in (violated(seed), programs.one_shot_masses(random_frame(2, seed).experiment(noise=0.002, std=0.002))):
        solutions = [program.solve(name) for name in ("clarabel", "scs", "auto")]
        for other in solutions[1:]:
            apart = np.abs(other.x - solutions[0].x)
            assert np.all(apart <= other.errors + solutions[0].errors)


def test_other_solvers_name_those_that_take_matrix_inequalities():
    with pytest.raises(cvxshear.UnsuitableError, match="clarabel and scs do"):
        violated().solve("daqp")
    with pytest.raises(cvxshear.UnsuitableError, match="to_cvxpy"):
        violated().to_qpsolvers()


def test_the_problem_of_cvxpy_is_the_same():
    program = violated()
    problem, x = program.to_cvxpy()
    problem.solve(solver="CLARABEL")
    solution = program.solve("clarabel")
    assert problem.value == pytest.approx(solution.objective, rel=1e-4)
    assert np.max(np.abs(x.value - solution.x) / np.max(np.abs(solution.x))) < 1e-4


def test_a_plan_bounds_the_mass_centers_and_gives_soft_rows():
    """With no modes to speak of, floors are uniform rectangles; the corner of the plan is the farthest mass center."""
    frame = random_frame(2, 1)
    program = programs.one_shot_masses(frame.experiment(plan=True))
    half = np.array(frame.plan) / 2
    floor = np.concatenate([[1e3], 1e3 * half * 0.999, [1e9]])
    assert np.all(program.G @ np.concatenate([floor, floor * [1, -1, -1, 1]]) <= program.h)
    assert np.any(program.G @ np.concatenate([floor, floor * [1, 1.01, 1, 1]]) > program.h)
    uniform = np.array([1e3, 0.0, 0.0, 1e3 * np.sum(np.square(frame.plan)) / 12])
    R, s = program.weighted
    np.testing.assert_allclose((R @ np.concatenate([uniform, uniform]) - s)[-2:], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"sensors": "one"}, "do not tell its motions .x, y and rotation. apart"),
        ({"total_mass": None}, "it needs frame: total_mass or floor_masses"),
        ({"reading": float("nan")}, "mode 2 has none of sensor 4"),
    ],
)
def test_what_is_missing_is_named(change, said):
    declared = random_frame(2, 1).experiment().to_dict()
    configuration = declared["configuration"][0]
    if "sensors" in change:
        configuration["sensors"] = configuration["sensors"][:-1]
        configuration["mode_shapes"] = [row[:-1] for row in configuration["mode_shapes"]]
        configuration["mode_shape_std"] = 1e-6
    if "total_mass" in change:
        del declared["frame"]["total_mass"]
        configuration["mass_normalized"] = True
    if "reading" in change:
        configuration["mode_shapes"][1][3] = change["reading"]
    with pytest.raises(cvxshear.UnsuitableError, match=said):
        programs.one_shot_masses(declared)
    frame = random_frame(2, 1).experiment()
    with pytest.raises(cvxshear.UnsuitableError, match="turn"):
        programs.mass_correction(frame)
    with pytest.raises(cvxshear.InfeasibleError, match="total_mass"):
        programs.one_shot_masses(frame, priors=[cvxshear.priors.Bounds("floor_mass", upper=1.0)])
    with pytest.raises(cvxshear.InputError, match="mass matrix of floor 1 must be positive"):
        programs.story_stiffnesses(frame, -np.ones(8))
    with pytest.raises(cvxshear.UnsuitableError, match="it needs two modes"):
        cvxshear.identify(random_frame(2, 1).experiment(1))
