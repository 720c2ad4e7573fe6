"""Compare backends with closed forms; test their certificates, refusals, and inequalities added on demand."""

import re
import subprocess
import sys

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from cvxshear import InputError, NoSolutionError, UnsuitableError, backends
from cvxshear.backends import Backend
from cvxshear.backends.solvers import Auto, Qpsolvers
from cvxshear.programs import LeastSquares

NAMES = backends.available()
BOUNDED = [name for name in NAMES if name != "kkt"]
ACCURACY = 1e-6


def random_program(seed, n=6, rows=20, *, scale=True):
    """Return a program whose unknowns, like masses and stiffnesses, differ by orders of magnitude."""
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform(-2, 6, n) if scale else np.ones(n)
    R = rng.standard_normal((rows, n)) / sizes
    return LeastSquares(R, rng.standard_normal(rows), A=np.ones((1, n)) / sizes, b=np.array([1.0])), sizes


def kkt_by_hand(program):
    """Write the stationarity and feasibility conditions as one linear system."""
    R, s = program.weighted
    A, b = program.equalities
    n, a = R.shape[1], len(b)
    lengths = np.linalg.norm(R, axis=0)
    R, A = R / lengths, A / lengths
    system = np.block([[R.T @ R, A.T], [A, np.zeros((a, a))]])
    return np.linalg.solve(system, np.concatenate([R.T @ s, b]))[:n] / lengths


def test_the_required_backends_are_installed():
    required = {"kkt", "clarabel", "osqp", "highs", "piqp", "proxqp", "quadprog", "daqp", "scs"}
    assert required | {"cvxpy-clarabel", "cvxpy-osqp", "cvxpy-scs"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(3))
def test_every_backend_agrees_with_the_closed_form(name, seed):
    program, sizes = random_program(seed)
    found = backends.get(name).solve(program)
    expected = kkt_by_hand(program)
    np.testing.assert_allclose(found.x / sizes, expected / sizes, atol=ACCURACY * np.max(np.abs(expected / sizes)))
    assert found.certificate.worst < ACCURACY
    assert found.backend == name


@pytest.mark.parametrize("name", BOUNDED)
@pytest.mark.parametrize("seed", range(3))
def test_optimality_conditions_hold_with_active_bounds(name, seed):
    program, sizes = random_program(seed)
    free = kkt_by_hand(program)
    lower = np.full(6, -np.inf)
    lower[:2] = free[:2] + 0.3 * sizes[:2]
    program = program.replace(lower=lower, G=np.eye(6)[2:3] / sizes[2], h=np.array([free[2] / sizes[2] - 0.2]))
    found = backends.get(name).solve(program)
    G, h = program.inequalities
    y, w = found.point.y, found.point.w
    gradient = program.R.T @ (program.R @ found.x - program.s)
    tolerance = 1e-5 / sizes
    assert np.all(np.abs(gradient + program.A.T @ y + G.T @ w) <= tolerance * 10)
    unit = np.array([1.0, *sizes[:2]])
    assert np.all((G @ found.x - h) / unit <= 1e-5)
    assert np.all(w * unit >= -1e-5)
    assert np.sum(w * unit > 1e-3) >= 1
    assert np.all(w * unit * (h - G @ found.x) / unit <= 1e-5)
    reference = backends.get("quadprog").solve(program).x
    np.testing.assert_allclose(found.x / sizes, reference / sizes, atol=1e-6 * np.max(np.abs(reference / sizes)))


@pytest.mark.parametrize("name", BOUNDED)
def test_an_infeasible_program_is_an_error_and_never_a_number(name):
    program, _ = random_program(0, scale=False)
    impossible = program.replace(lower=np.full(6, 1.0))
    with pytest.raises(NoSolutionError, match=re.escape(f"backend {name}:")):
        backends.get(name).solve(impossible)


@pytest.mark.parametrize("name", NAMES)
def test_an_equality_said_twice_does_no_harm(name):
    program, sizes = random_program(5)
    twice = program.replace(A=np.concatenate([program.A, 2 * program.A]), b=np.concatenate([program.b, 2 * program.b]))
    expected = kkt_by_hand(program)
    np.testing.assert_allclose(
        backends.get(name).solve(twice).x / sizes, expected / sizes, atol=1e-6 * np.max(np.abs(expected / sizes))
    )


def test_the_closed_form_refuses_an_active_bound_and_names_another_backend():
    program, _ = random_program(1)
    upper = np.full(6, np.inf)
    upper[0] = kkt_by_hand(program)[0] - 0.5 * abs(kkt_by_hand(program)[0])
    with pytest.raises(UnsuitableError, match="equalities only; choose another backend, clarabel"):
        backends.get("kkt").solve(program.replace(upper=upper))


def test_the_closed_form_refuses_what_nothing_determines():
    with pytest.raises(NoSolutionError, match="do not determine every unknown"):
        backends.get("kkt").solve(LeastSquares(np.array([[1.0, 1.0]]), np.array([1.0])))


def test_an_unknown_backend_is_refused_with_the_nearest_name():
    with pytest.raises(InputError, match=r"no backend named 'clarable' is installed here; did you mean 'clarabel'\?"):
        backends.get("clarable")


def test_a_far_bound_changes_neither_the_answer_nor_the_scaling():
    program, sizes = random_program(3)
    far = program.replace(lower=-1e9 * sizes, upper=1e9 * sizes)
    for name in ("clarabel", "osqp", "scs"):
        np.testing.assert_allclose(
            backends.get(name).solve(far).x / sizes,
            kkt_by_hand(program) / sizes,
            atol=1e-6 * np.max(np.abs(kkt_by_hand(program) / sizes)),
        )


def test_no_solver_prints():
    """HiGHS 1.16 prints its version once per process; other tools that read the output would fail."""
    script = "import cvxshear\nfor name in ('highs', 'osqp', 'scs'): cvxshear.identify('paper', backend=name)"
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ran.stdout == ""


class Failing(Backend):
    """A solver that never answers."""

    def __init__(self, name):
        self.name = name

    def answer(self, problem):
        raise NoSolutionError(self.name, "no")


def test_auto_fails_with_what_the_first_general_solver_said():
    """The closed form refuses an active bound and a program with several solutions; both then ask a general solver."""
    several = LeastSquares(np.array([[1.0, 1.0]]), np.array([1.0]), lower=np.zeros(2))
    bounded = LeastSquares(np.eye(2), np.ones(2), upper=np.zeros(2))
    solvers = [Failing("a"), Failing("b")], [Failing("c"), Failing("d")]
    for program, name in ((bounded, "a"), (several, "c")):
        with pytest.raises(NoSolutionError) as caught:
            Auto(backends.get("kkt"), *solvers).solve(program)
        assert caught.value.backend == name
    with pytest.raises(NoSolutionError, match="there is no general solver"):
        Auto(backends.get("kkt"), [], []).solve(bounded)
    with pytest.raises(NoSolutionError) as caught:
        Auto(Failing("kkt"), *solvers).solve(LeastSquares(np.eye(2), np.ones(2)))
    assert caught.value.backend == "kkt"


class Recording(Qpsolvers):
    """A solver that records its number of inequalities."""

    def __init__(self, name):
        super().__init__(name)
        self.inequalities = []

    def answer(self, problem):
        self.inequalities.append(len(problem.f))
        return super().answer(problem)


def bounded(seed, n=40, rows=120):
    """Return a least-squares problem whose bounds cut off a quarter of the unbounded solution's entries."""
    rng = np.random.default_rng(seed)
    R, s = rng.standard_normal((rows, n)), rng.standard_normal(rows)
    free = np.linalg.lstsq(R, s, rcond=None)[0]
    lower, upper = np.full(n, np.quantile(free, 0.15)), np.full(n, np.quantile(free, 0.9))
    return LeastSquares(R, s, lower=lower, upper=upper)


def by_scipy(program):
    found = lsq_linear(program.R, program.s, (program.lower, program.upper), method="bvls", tol=1e-14)
    assert found.status > 0
    return found.x


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["clarabel", "daqp", "osqp", "cvxpy-clarabel"])
def test_the_answer_is_that_of_all_inequalities(name, seed):
    program = bounded(seed)
    found = backends.get(name).solve(program)
    np.testing.assert_allclose(found.x, by_scipy(program), atol=1e-7)
    G, h = program.inequalities
    assert np.all(G @ found.x <= h + 1e-8)
    slack = h - G @ found.x
    assert np.all(found.point.w[slack > 1e-6] <= 1e-7)
    gradient = program.R.T @ (program.R @ found.x - program.s)
    np.testing.assert_allclose(gradient + G.T @ found.point.w, 0.0, atol=1e-6)


def test_the_solver_sees_few_inequalities_and_more_only_as_they_matter():
    program, solver = bounded(1), Recording("daqp")
    found = solver.solve(program)
    active = int(np.sum(found.point.w > 0))
    assert 0 < active <= solver.inequalities[-1] < len(program.inequalities[1]) / 3
    assert sorted(solver.inequalities) == solver.inequalities
    assert len(solver.inequalities) > 1, "this program is meant to need more than one round"


def test_without_an_active_inequality_the_solver_sees_none():
    program = bounded(2)
    solver = Recording("daqp")
    solver.solve(program.replace(lower=np.full(40, -1e6), upper=np.full(40, 1e6)))
    assert solver.inequalities == [0]
