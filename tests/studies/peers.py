"""Compare with alternatives in the same run: the paper's masses by cvxpy, SciPy and dense numpy."""

import cvxpy as cp
import numpy as np
from scipy.optimize import least_squares, minimize

from cvxshear import identify
from cvxshear.programs.formulations import mass_rows, normalized
from tests.studies.scaling import exact_experiment
from tests.studies.timing import fastest, shown, table

SIZES = (3, 10, 30)
TOLERANCE = 1e-6


def main():
    rows = []
    for stories in SIZES:
        of, mass, _ = exact_experiment(stories)
        shapes, total = of.configurations[0].mode_shapes.T, float(mass.sum())
        start = np.full(stories, total / stories)
        ours, part = fastest(lambda of=of: identify(of, "two-stage").parts[0], 3)
        rows.append(
            [
                stories,
                "cvxshear, two-stage with stiffnesses and checks",
                shown(ours),
                "1",
                _error(part.frame.floor_mass, mass),
            ]
        )
        for name, run in PEERS.items():
            try:
                seconds, found = fastest(lambda run=run, given=(shapes, start, total): run(*given), 1)
            except cp.SolverError as error:
                rows.append([stories, name, "failed", "", str(error).split(".")[0]])
                continue
            rows.append([stories, name, shown(seconds), f"{seconds / ours:.1f}", _error(found, mass)])
    table(
        "Peers: floor masses from exact modes", ["stories", "how", "time", "over ours", "largest relative error"], rows
    )


def _error(found, mass):
    return f"{np.max(np.abs(found / mass - 1)):.0e}"


def iterated(shapes, mass, step):
    """Run the paper's iteration with any solver for its step."""
    for _ in range(1000):
        dm = step(normalized(shapes, mass), mass)
        mass = mass + dm
        if np.max(np.abs(dm)) < TOLERANCE * np.max(np.abs(mass)):
            return mass
    raise RuntimeError("no convergence")


def anew(shapes, start, total):
    def step(phi, mass):
        problem, x = mass_rows(phi, mass, total).to_cvxpy()
        problem.solve(solver="CLARABEL")
        return x.value

    return iterated(shapes, start, step)


def printed(shapes, start, total):
    """Solve Eqs. 8 to 14 literally: the matrix of pairs row by row, its square, and the inverse of the system."""

    def step(phi, mass):
        n = len(mass)
        pairs = [(i, j) for i in range(n) for j in range(i, n)]
        A = np.array([phi[:, i] * phi[:, j] for i, j in pairs])
        modal = phi.T @ np.diag(mass) @ phi
        B = np.array([(i == j) - modal[i, j] for i, j in pairs])
        system = np.block([[2 * A.T @ A, np.ones((n, 1))], [np.ones((1, n)), np.zeros((1, 1))]])
        return (np.linalg.inv(system) @ np.concatenate([2 * A.T @ B, [total - mass.sum()]]))[:n]

    return iterated(shapes, start, step)


def _residual(shapes, total):
    """Return the orthogonality residual of unit shapes; residual and unknowns are relative to the mean mass."""
    unit = shapes / np.linalg.norm(shapes, axis=0)
    i, j = np.triu_indices(len(shapes), k=1)
    rows = (unit[:, i] * unit[:, j]).T
    return lambda x: rows @ x


def finite_differences(shapes, start, total):
    mean, n = total / len(start), len(start)
    orthogonal = _residual(shapes, total)
    found = least_squares(lambda x: np.append(orthogonal(x), x.sum() - n), start / mean, xtol=1e-12, ftol=1e-12)
    return found.x * mean


def slsqp(shapes, start, total):
    mean, n = total / len(start), len(start)
    orthogonal = _residual(shapes, total)
    found = minimize(
        lambda x: orthogonal(x) @ orthogonal(x), start / mean, method="SLSQP", bounds=[(0, None)] * n,
        constraints={"type": "eq", "fun": lambda x: x.sum() - n}, options={"ftol": 1e-14, "maxiter": 1000},
    )  # fmt: skip
    return found.x * mean


PEERS = {
    "cvxpy built anew in each iteration": anew,
    "numpy, Eqs. 8-14 as printed": printed,
    "scipy least_squares, finite differences": finite_differences,
    "scipy SLSQP with the constraints": slsqp,
}
