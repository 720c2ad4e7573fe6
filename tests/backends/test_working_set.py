"""Adding inequalities on demand gives the same answers with less work."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from cvxshear import backends
from cvxshear.backends.solvers import Qpsolvers
from cvxshear.programs import LeastSquares


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
