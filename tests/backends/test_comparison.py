"""Test the comparison of backends: sizes of the programs, times, tolerances and time limits."""

import json

import numpy as np
import pytest
import qpsolvers

import cvxshear
from cvxshear import InputError, NoSolutionError, backends
from cvxshear.backends import Backend, BenchmarkProgram
from cvxshear.backends.solvers import THROUGH_CVXPY, THROUGH_QPSOLVERS, Qpsolvers, Solver
from cvxshear.fit.identification import programs_of
from cvxshear.programs import LeastSquares

THREE = "examples/three_story.toml"


@pytest.fixture(scope="module")
def programs():
    return programs_of(cvxshear.load(THREE))[0]


class Noting(Backend):
    """Count the calls, and return the closed form's answer with a small error."""

    name = "noting"

    def __init__(self, off=0.0):
        self.off, self.asked = off, 0

    def answer(self, problem):
        self.asked += 1
        exact = backends.get("kkt").answer(problem)
        return backends.Answer(exact.z + self.off, exact.y, exact.w, "", 7)


def plane(origin=(10.0, 20.0), **more):
    return BenchmarkProgram("plane", LeastSquares(np.eye(2), np.array([1.0, 2.0]), **more), np.array(origin))


def test_each_program_is_solved_once_for_its_answer_and_then_as_often_as_asked():
    backend = Noting()
    result = backends.compare([plane(), plane()], [backend], repeats=4)
    assert backend.asked == 2 * (1 + 4)
    (row,) = result.rows
    assert (row.programs, row.iterations, row.difference, row.failure) == (2, 14, 0.0, "")
    assert row.seconds > 0


def test_the_difference_is_relative_to_the_quantity_that_the_unknown_changes():
    # z is x over |s| = sqrt(5); the largest relative difference is the first unknown's, 11.
    (row,) = backends.compare([plane()], [Noting(1e-8)]).rows
    assert row.difference == pytest.approx(1e-8 * np.sqrt(5) / 11, rel=1e-6)
    assert row.reference == "closed form"
    assert row.error_bound >= 1e-8
    # An unknown that is zero, such as the first moment of a symmetric floor, has the size of its row.
    rows = backends.compare([plane((-1.0, 20.0))], ["kkt", Noting(1e-8), Noting(1e-9)]).rows
    assert [each.difference for each in rows] == pytest.approx([0.0, 1e-6, 1e-7], rel=0.1)


def test_what_is_said_of_a_kind_is_of_its_programs():
    more = {"A": np.ones((1, 2)), "b": np.ones(1), "lower": np.array([0.0, -np.inf]), "upper": np.array([9.0, 9.0])}
    result = backends.compare([plane(), plane(**more)], ["kkt"])
    (kind,) = result.kinds
    assert (kind.programs, kind.unknowns, kind.rows, kind.equalities, kind.inequalities) == (2, 2, 2, 1, 3)
    assert result.to_dict()["kinds"] == [
        {"kind": "plane", "programs": 2, "unknowns": 2, "rows": 2, "equalities": 1, "inequalities": 3}
    ]  # fmt: skip


def test_the_singular_program_has_its_bounds_for_an_answer_and_no_closed_form(programs):
    (singular,) = [each for each in programs if each.kind == "singular stiffness"]
    assert np.linalg.matrix_rank(singular.program.R) == 1 < singular.program.unknowns
    result = backends.compare([singular], ["kkt", "clarabel", "osqp"])
    kkt, clarabel, osqp = result.rows
    assert "do not determine every unknown" in kkt.failure
    found = backends.get("clarabel").solve(singular.program)
    np.testing.assert_allclose(found.x, singular.program.upper, rtol=1e-6)
    for row in (clarabel, osqp):
        assert row.difference < 1e-6
        assert row.reference == "auto"


@pytest.mark.parametrize("name", [name for name in backends.available() if backends.get(name).tolerance])
def test_a_tolerance_reaches_the_solver_and_leaves_the_backend_as_it_was(name, programs):
    backend = backends.get(name)
    before = backend.tolerance
    assert 1e-12 <= before <= 1e-9
    other = backend.with_tolerance(1e-7)
    assert (other.tolerance, backend.tolerance, other.name) == (1e-7, before, name)
    (row,) = backends.compare([programs[0]], [name], tolerance=1e-7).rows
    assert row.tolerance == 1e-7


def test_a_looser_tolerance_shows_in_the_iterations_and_never_in_the_answer():
    """An inexact answer is polished or refused: the residuals are always the minimizer's."""
    rng = np.random.default_rng(1)
    program = LeastSquares(rng.standard_normal((30, 12)), rng.standard_normal(30), lower=np.zeros(12))
    each = BenchmarkProgram("bounded", program, np.ones(12))
    tight, loose, useless = (
        backends.compare([each], ["kkt", "clarabel", "osqp"], tolerance=value).rows[-1] for value in (1e-11, 1e-7, 1e-3)
    )
    assert loose.iterations < tight.iterations
    for row in (tight, loose):
        assert max(row.primal_residual, row.dual_residual, row.duality_gap) < 1e-10
        assert row.difference < 1e-10
    assert "inaccurate solution" in useless.failure


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"repeats": 0}, "repeats = 0 must be at least 1"),
        ({"tolerance": 0.0}, "tolerance = 0 must be greater than 0"),
        ({"names": ["nobody"]}, "no backend named 'nobody'"),
    ],
)
def test_numbers_and_names_that_make_no_sense_are_refused(given, said):
    with pytest.raises(InputError, match=said):
        backends.compare([plane()], **given)


def hard():
    """Return a program that needs several iterations of every solver."""
    rng = np.random.default_rng(0)
    R, s = rng.standard_normal((90, 60)), rng.standard_normal(90)
    free = np.linalg.lstsq(R, s, rcond=None)[0]
    return LeastSquares(R, s, lower=np.full(60, np.quantile(free, 0.3)), upper=np.full(60, np.quantile(free, 0.7)))


@pytest.mark.parametrize("name", ["clarabel", "highs", "osqp", "scs", "cvxpy-clarabel", "cvxpy-osqp", "cvxpy-scs"])
def test_a_solver_stops_at_its_time_limit_and_says_so(name):
    backend = backends.get(name)
    with pytest.raises(NoSolutionError, match=rf"backend {name}: stopped at its time limit of 1e-06 s \(its status: "):
        backend.with_options({backend.time_limit: 1e-6}).solve(hard())


@pytest.mark.parametrize(("name", "option"), [("piqp", "max_iter"), ("proxqp", "max_iter")])
def test_a_solver_without_a_time_limit_stops_at_its_iterations(name, option):
    with pytest.raises(NoSolutionError, match=f"backend {name}: no solution found .*max"):
        Qpsolvers(name, **{option: 1}).solve(hard())


@pytest.mark.parametrize("name", backends.available())
def test_every_solver_that_can_run_away_has_a_limit(name):
    limits = {"time_limit", "time_limit_secs", "max_iter"} & set(getattr(backends.get(name), "options", {}))
    assert bool(limits) == (name not in {"kkt", "quadprog"})


def test_the_solvers_that_are_told_installed_are_those_that_qpsolvers_finds():
    known = {solver.name for solver in THROUGH_QPSOLVERS if solver.installed}
    assert known == set(qpsolvers.available_solvers)
    assert {solver.name for solver in THROUGH_CVXPY} == {"cvxpy-clarabel", "cvxpy-osqp", "cvxpy-scs"}


def test_a_solver_that_is_missing_says_how_to_get_it():
    missing = Solver("nobody", "no_such_module", "no-such-package")
    assert (missing.installed, missing.version, missing.how_to_get) == (False, None, "pip install no-such-package")
    caller = Solver("nobody", "numpy", "numpy", "no_such_caller")
    assert (caller.installed, caller.how_to_get) == (False, "pip install no_such_caller")


def test_the_list_has_every_backend_with_its_version_and_the_others_with_a_command(run, printed):
    out = printed("backends", "--json", "-")
    listed = {each["name"]: each for each in json.loads(out)["backends"]}
    assert {name for name, each in listed.items() if each["installed"]} == set(backends.available())
    import clarabel  # noqa: PLC0415

    assert listed["clarabel"]["version"] == clarabel.__version__
    assert all(bool(each["how_to_get"]) != each["installed"] for each in listed.values())
    out = printed("backends")
    assert "not installed" in out
    assert "pip install ecos" in out or listed["ecos"]["installed"]


@pytest.mark.parametrize("option", [["--names", "kkt"], ["--tolerance", "1e-8"]])
def test_options_for_programs_without_any_are_refused(refused, option):
    assert f"{option[0]} needs programs: name a measurement file, or 'paper'" in refused("backends", *option)


def test_the_command_takes_backends_repeats_and_a_tolerance(run, refused):
    arguments = ("backends", THREE, "--names", "kkt,daqp", "--repeats", "1", "--tolerance", "1e-9", "--json", "-")
    result = json.loads(run(*arguments)[1])
    assert {(row["backend"], row["tolerance"]) for row in result["rows"]} == {("kkt", None), ("daqp", 1e-9)}
    assert all(row["seconds"] > 0 for row in result["rows"] if not row["failure"])
    assert "repeats = 0" in refused("backends", THREE, "--repeats", "0")
