"""Test the programs as objects: the printed equations, formulation, conversions, solutions, duals."""

import json

import numpy as np
import pytest
import qpsolvers

import cvxshear
from cvxshear import InputError, UnsuitableError, backends, programs
from cvxshear.priors import Bounds, Nominal, Ratio, Value
from cvxshear.programs import LeastSquares
from cvxshear.programs.constraints import remaining
from cvxshear.programs.formulations import normalized, one_shot_rows
from tests.frames import EXAMPLES, modes_of

SOLVERS = ("clarabel", "osqp", "daqp", "cvxpy-scs", "auto")


@pytest.fixture(scope="module")
def three():
    """Return the paper's three-story frame with 5 % noise on its modes."""
    return cvxshear.load("examples/noisy_three_story.toml")


def every_program(experiment, **more):
    total = experiment.frame.known_total
    masses = np.full(experiment.stories, total / experiment.stories)
    return {
        "mass correction": programs.mass_correction(experiment, masses, **more),
        "one-shot masses": programs.one_shot_masses(experiment, **more),
        "story stiffnesses": programs.story_stiffnesses(experiment, masses, **more),
    }


def test_p_q_and_the_constant_are_the_objective(three):
    rng = np.random.default_rng(0)
    for program in every_program(three).values():
        x = rng.uniform(0.5, 2.0, program.unknowns) * program.solve().x
        R, s = program.weighted
        squares = np.sum((R @ x - s) ** 2)
        assert 0.5 * x @ program.P @ x + program.q @ x + program.constant == pytest.approx(squares, rel=1e-9)
        assert program.objective(x) == pytest.approx(squares, rel=1e-12)


def test_a_program_written_by_hand_has_the_same_solution(three):
    """Compare Eq. 8, row by row in qpsolvers, with the program's own solution and its conversion."""
    test = three.configurations[0]
    masses = np.array([8.0, 7.5, 7.0])
    phi = test.mode_shapes.T / np.sqrt(np.sum(test.mode_shapes.T**2 * masses[:, None], axis=0))
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    R = np.array([phi[:, i] * phi[:, j] for i, j in pairs])
    s = np.array([float(i == j) - phi[:, i] @ (masses * phi[:, j]) for i, j in pairs])
    by_hand = qpsolvers.solve_qp(R.T @ R, -R.T @ s, A=np.ones((1, 3)), b=np.zeros(1), solver="quadprog")
    program = programs.mass_correction(three, masses)
    np.testing.assert_allclose(program.solve("clarabel").x, by_hand, rtol=1e-7)
    converted = qpsolvers.solve_problem(program.to_qpsolvers(), "quadprog")
    np.testing.assert_allclose(converted.x, by_hand, rtol=1e-7)


@pytest.mark.parametrize("name", SOLVERS)
def test_solvers_conversions_and_closed_form_agree(three, name):
    for what, program in every_program(three).items():
        closed = program.kkt()
        solution = program.solve(name)
        np.testing.assert_allclose(solution, closed, rtol=1e-6, err_msg=what)
        np.testing.assert_allclose(solution.duals["A"], closed.duals["A"], rtol=1e-4, atol=1e-6 * abs(closed.objective))
        assert closed.certificate.worst < 1e-12
        assert np.all(np.abs(solution.x - closed.x) <= solution.certificate.errors + 1e-12 * np.abs(closed.x))
        problem, x = program.to_cvxpy()
        problem.solve(solver="CLARABEL")
        np.testing.assert_allclose(x.value, closed.x, rtol=1e-5)
        assert problem.value == pytest.approx(solution.objective, rel=1e-5, abs=1e-9 * program.constant)


def test_the_normal_equations_are_those_of_equation_24(three):
    program = programs.story_stiffnesses(three, [10.0, 7.5, 5.0])
    R, s = program.R, program.s
    np.testing.assert_allclose(program.normal_equations().x, np.linalg.solve(R.T @ R, R.T @ s), rtol=1e-9)


def test_the_closed_form_leaves_inequalities_out(three):
    free = programs.story_stiffnesses(three, [10.0, 7.5, 5.0])
    bounded = programs.story_stiffnesses(three, [10.0, 7.5, 5.0], priors=[Bounds("story_stiffness", upper=1500.0)])
    np.testing.assert_allclose(bounded.kkt().x, free.kkt().x, rtol=1e-9)
    with pytest.raises(UnsuitableError, match="inequality is active"):
        bounded.solve("kkt")


def test_duals_are_the_derivatives_of_the_objective(three):
    """Change each right side and bound slightly, and solve the program again."""
    masses = [10.0, 7.5, 5.0]
    prior = [Bounds("story_stiffness", upper=[1700.0, 1e9, 1e9], lower=[0.0, 0.0, 640.0])]
    program = programs.story_stiffnesses(three, masses, priors=[*prior, Ratio("story_stiffness", 2, 3, 1.9)])
    solution = program.solve("quadprog")
    assert {each.constraint for each in solution.active} == {"A", "lower", "upper"}
    x, duals = solution.x, solution.duals
    stationary = program.P @ x + program.q + program.A.T @ duals["A"] + duals["lower"] + duals["upper"]
    np.testing.assert_allclose(stationary, 0.0, atol=1e-6 * np.abs(program.q).max())
    step = 1e-3
    for each in solution.active:
        side = {"A": "b"}.get(each.constraint, each.constraint)
        ends = []
        for sign in (1.0, -1.0):
            moved = getattr(program, side).copy()
            moved[each.index] += sign * step
            ends.append(program.replace(**{side: moved}).solve("quadprog").objective)
        assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(-each.dual, rel=1e-4)
    assert np.all(duals["upper"] >= -1e-9)
    assert np.all(duals["lower"] <= 1e-9)


def test_an_active_constraint_names_its_unknown_and_its_source(three):
    program = programs.story_stiffnesses(three, [10.0, 7.5, 5.0], priors=[Bounds("story_stiffness", upper=1500.0)])
    (held,) = [each for each in program.solve().active if each.constraint == "upper"]
    assert held.name == "story_stiffness 1"
    assert "story_stiffness at most 1500 N/m" in held.source
    (total,) = programs.one_shot_masses(three).solve().active
    assert (total.constraint, total.source) == ("A", "total_mass = 22.5 kg")


def test_priors_become_rows_and_constraints(three):
    soft = programs.one_shot_masses(three, priors=[Value("floor_mass", 1, 9.0, std=0.01)])
    plain = programs.one_shot_masses(three)
    assert len(soft.R) == len(plain.R) + 1
    assert abs(soft.solve().x[0] - 9.0) < abs(plain.solve().x[0] - 9.0)
    hard = programs.one_shot_masses(three, priors=[Value("floor_mass", 1, 9.0)])
    assert hard.solve().x[0] == pytest.approx(9.0, rel=1e-9)


def test_the_methods_solve_these_programs(three):
    """Iterate the mass correction by hand; it gives the masses of `identify`. The same holds for the other two
    programs."""
    masses = np.full(3, 7.5)
    for _ in range(40):
        masses = masses + programs.mass_correction(three, masses).solve().x
    found = cvxshear.identify(three, "two-stage", tolerance=1e-12, keep_programs=True)
    np.testing.assert_allclose(masses, found.frame.floor_mass, rtol=1e-8)
    stiffness = programs.story_stiffnesses(three, masses).solve().x
    np.testing.assert_allclose(stiffness, found.frame.story_stiffness, rtol=1e-8)
    one_shot = cvxshear.identify(three, "one-shot").frame.floor_mass
    np.testing.assert_allclose(programs.one_shot_masses(three).solve().x, one_shot, rtol=1e-9)


def test_a_soft_prior_that_is_not_linear_is_linearized_where_the_caller_says(three):
    prior = [Nominal("story_stiffness", [3.0, 2.0, 1.0], std=0.01, free_scale=True)]
    found = cvxshear.identify(three, "one-shot", priors=prior).frame
    at = np.array([1800.0, 1200.0, 600.0])
    for _ in range(30):
        at = programs.story_stiffnesses(three, found.floor_mass, priors=prior, at=at).solve().x
    np.testing.assert_allclose(at, found.story_stiffness, rtol=1e-7)


@pytest.mark.parametrize("method", ["two-stage", "one-shot", "efficient"])
def test_identify_keeps_what_was_solved(three, method):
    found = cvxshear.identify(three, method, backend="clarabel", keep_programs=True)
    assert len(found.programs) >= 2
    for program, solution in found.programs:
        assert solution.requested == "clarabel"
        assert solution.x.shape == (program.unknowns,)
        np.testing.assert_allclose(program.solve("auto").x, solution.x, atol=1e-5 * np.abs(solution.x).max() + 1e-9)
    assert cvxshear.identify(three, method).programs == ()
    if method == "two-stage":
        assert found.programs[-1].program.title.startswith("story stiffnesses, ")


@pytest.mark.parametrize("method", ["one-shot", "efficient"])
def test_a_bound_that_is_active_has_its_price_in_the_result(three, method):
    """For the efficient method the price is the derivative of chi-square, here by differences of the bound."""

    def identified(upper):
        return cvxshear.identify(three, method, priors=[Bounds("story_stiffness", upper=[upper, 1e9, 1e9])])

    found = identified(1500.0)
    (held,) = found.single.active
    assert (held.constraint, held.name) == ("upper", "story_stiffness 1")
    assert found.to_dict()["active"][0]["dual"] == pytest.approx(held.dual)
    if method == "efficient":
        up, down = identified(1500.5).fit.chi2, identified(1499.5).fit.chi2
        assert up - down == pytest.approx(-held.dual, rel=1e-3)
    assert cvxshear.identify(three, method).single.active == ()


def test_who_answered_and_why(three):
    program = programs.story_stiffnesses(three, [10.0, 7.5, 5.0], priors=[Bounds("story_stiffness", upper=1500.0)])
    as_given = program.solve("clarabel")
    assert (as_given.requested, as_given.backend, as_given.replaced) == ("clarabel", "clarabel", None)
    chosen = program.solve("auto")
    assert chosen.requested == "auto"
    assert chosen.backend in backends.available()
    assert "an inequality is active" in chosen.replaced


class Inexact(backends.Backend):
    """A solver that leaves these errors in its scaled unknowns."""

    name = "inexact"

    def __init__(self, errors):
        self.errors = errors

    def answer(self, problem):
        exact = backends.get("daqp").answer(problem)
        return backends.Answer(exact.z + self.errors, exact.y, exact.w, "solved", 1)


@pytest.mark.parametrize(
    ("errors", "acceptance"), [((0, 1e-12), "as given"), ((0, 1.5e-8), "polished"), ((1e-8, 0), "replaced")]
)
def test_a_closed_form_in_place_of_an_answer_is_named(errors, acceptance):
    """The second unknown is small: an error of 1.5e-8 of the first changes its digits; the first violates its bound."""
    program = LeastSquares(np.eye(2), np.array([1.0, 0.01]), upper=np.array([0.9, np.inf]))
    solution = program.solve(Inexact(np.array(errors)))
    assert solution.acceptance == acceptance
    assert (solution.requested, solution.backend) == ("inexact", "inexact" if acceptance == "as given" else "kkt")
    assert (solution.replaced is None) == (acceptance == "as given")
    np.testing.assert_allclose(solution.x, [0.9, 0.01], rtol=1e-9)


def test_options_reach_the_solver(three):
    program = programs.one_shot_masses(three, priors=[Bounds("floor_mass", upper=[9.0, 99.0, 99.0])])
    with pytest.raises(cvxshear.NoSolutionError, match="osqp"):
        program.solve("osqp", max_iter=1)
    with pytest.raises(InputError, match="kkt takes no options; it was given eps_abs"):
        program.solve("kkt", eps_abs=1e-9)
    own = backends.Qpsolvers("clarabel", max_iter=50)
    assert own.options["max_iter"] == 50
    assert backends.Cvxpy("CLARABEL", max_iter=50).options["max_iter"] == 50
    np.testing.assert_allclose(program.solve(own).x, program.solve().x, rtol=1e-6)


def test_one_of_several_configurations_is_named():
    with pytest.raises(InputError, match=r"3 configurations; name one of them, such as configuration=.Structure 1."):
        programs.one_shot_masses("paper")
    with pytest.raises(InputError, match="configuration"):
        programs.one_shot_masses("paper", configuration="Structure 4")
    assert programs.one_shot_masses("paper", configuration="Structure 2").solve().x.sum() == pytest.approx(31.33)


@pytest.mark.parametrize(
    ("masses", "message"), [([1.0, 2.0], "masses"), ([1.0, 2.0, -3.0], "masses"), ([1.0, np.nan, 2.0], "masses")]
)
def test_masses_that_make_no_sense_are_refused(three, masses, message):
    with pytest.raises(InputError, match=message):
        programs.mass_correction(three, masses)


@pytest.mark.parametrize(
    ("modes", "floors", "lost", "message"),
    [
        ([1, 3], [1, 2, 3], [], "it needs all 3 modes, mode 2 is missing"),
        ([1], [1, 2, 3], [], "it needs all 3 modes, modes 2, 3 are missing"),
        ([1, 2, 3], [1, 3], [], "it needs every floor, floor 2 is unmeasured"),
        ([1, 2, 3], [1, 2, 3], [1, 2], "mode 2 has no value at floor 3"),
    ],
)
def test_incomplete_data_are_refused_with_the_method_that_takes_them(three, modes, floors, lost, message):
    shapes = three.configurations[0].mode_shapes.copy()
    if lost:
        shapes[tuple(lost)] = np.nan
    given = {
        "name": "a", "modes": modes, "measured_floors": floors,
        "frequencies": three.configurations[0].frequencies[np.array(modes) - 1].tolist(),
        "mode_shapes": shapes[np.ix_(np.array(modes) - 1, np.array(floors) - 1)].tolist(),
    }  # fmt: skip
    with pytest.raises(UnsuitableError, match=rf'one_shot_masses cannot use configuration "a": {message}; use method'):
        programs.one_shot_masses({"frame": {"stories": 3, "total_mass": 23.0}, "configuration": [given]})


def test_the_notebook_runs():
    """Its constraint in cvxpy and the same constraint in a row of G have the same solution."""
    cells = json.loads((EXAMPLES / "programs.ipynb").read_text(encoding="utf-8"))["cells"]
    namespace = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), namespace)
    np.testing.assert_allclose(namespace["k"].value, namespace["same"].x, rtol=1e-6)
    assert namespace["same"].duals["G"][0] > 0


MASS = np.array([10.0, 7.5, 5.0])
STIFFNESS = np.array([1800.0, 1200.0, 600.0])


def noisy_shapes(seed=0, noise=0.05):
    _, shapes = modes_of(MASS, STIFFNESS)
    return (shapes * (1 + noise * np.random.default_rng(seed).standard_normal(shapes.shape))).T


def test_one_shot_does_not_depend_on_the_scale_of_noisy_modes():
    phi = noisy_shapes(2)
    a = backends.get("kkt").solve(one_shot_rows(phi, 22.5)).x
    b = backends.get("kkt").solve(one_shot_rows(phi * np.array([3.0, -0.2, 1e3]), 22.5)).x
    np.testing.assert_allclose(a, b, rtol=1e-9)


@pytest.mark.parametrize("mass", [MASS, np.diag(MASS) + 0.3 * np.ones((3, 3))])
def test_normalized_shapes_have_unit_modal_mass(mass):
    phi = normalized(noisy_shapes(4), mass)
    full = np.diag(mass) if mass.ndim == 1 else mass
    np.testing.assert_allclose(np.diag(phi.T @ full @ phi), 1.0, rtol=1e-12)


def test_weights_enter_as_the_diagonal_of_w():
    program = LeastSquares(np.eye(2), np.array([1.0, 2.0]), W=np.array([2.0, 3.0]))
    R, s = program.weighted
    np.testing.assert_array_equal(R, [[2.0, 0.0], [0.0, 3.0]])
    np.testing.assert_array_equal(s, [2.0, 6.0])


def test_bounds_become_rows_in_the_order_that_is_documented():
    program = LeastSquares(
        np.eye(2), np.zeros(2), G=np.array([[1.0, 1.0]]), h=np.array([5.0]),
        lower=np.array([-np.inf, 1.0]), upper=np.array([2.0, np.inf]),
    )  # fmt: skip
    rows, side = program.inequalities
    np.testing.assert_array_equal(rows, [[1, 1], [0, -1], [1, 0]])
    np.testing.assert_array_equal(side, [5, -1, 2])


def test_a_remainder_of_rounding_alone_is_zero():
    rows, origin = np.ones((1, 3)), np.array([0.1, 0.2, 0.3])
    assert remaining(np.array([0.6]), rows, origin)[0] == 0.0
    assert remaining(np.array([0.6 + 1e-9]), rows, origin)[0] == pytest.approx(1e-9, rel=1e-6)
