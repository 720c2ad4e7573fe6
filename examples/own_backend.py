"""A custom backend: scipy's SLSQP, with certified solutions."""

from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import cvxshear
from cvxshear.backends import Answer, Backend, register
from cvxshear.priors import Bounds
from cvxshear.util.errors import NoSolutionError


class Slsqp(Backend):
    """minimize |C z - q|^2 / 2 subject to E z = e, F z <= f."""

    name = "slsqp"

    def answer(self, problem):
        def gradient(z):
            return problem.C.T @ (problem.C @ z - problem.q)

        found = minimize(
            lambda z: 0.5 * np.sum((problem.C @ z - problem.q) ** 2),
            problem.q,
            jac=gradient,
            constraints=[
                {"type": "eq", "fun": lambda z: problem.E @ z - problem.e, "jac": lambda z: problem.E},
                {"type": "ineq", "fun": lambda z: problem.f - problem.F @ z, "jac": lambda z: -problem.F},
            ],
            method="SLSQP",
            options={"ftol": 1e-16, "maxiter": 1000},
        )
        if not found.success:
            raise NoSolutionError(self.name, found.message)
        # SLSQP returns no multipliers; they are the least-squares solution of stationarity on the active rows.
        active = problem.f - problem.F @ found.x < 1e-8
        rows = np.concatenate([problem.E, problem.F[active]])
        multipliers = np.linalg.lstsq(rows.T, -gradient(found.x), rcond=None)[0]
        w = np.zeros(len(problem.f))
        w[active] = multipliers[len(problem.e) :]
        return Answer(found.x, multipliers[: len(problem.e)], w, found.message, found.nit)


register(Slsqp())
experiment = cvxshear.load(Path(__file__).with_name("noisy_three_story.toml"))
bound = Bounds("floor_mass", upper=10.5)
for name in ("slsqp", "clarabel"):
    mass = cvxshear.identify(experiment, method="one-shot", backend=name, priors=[bound]).frame.floor_mass
    print(f"{name:9s} m = {mass.round(6)} kg")
