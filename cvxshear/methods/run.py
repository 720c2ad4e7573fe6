"""The identification: a method, a backend, priors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.fit.efficient import efficient, parameter_names
from cvxshear.fit.results import Identification, SingleIdentification
from cvxshear.measurement.experiment import Measurement, opened
from cvxshear.methods.paper_methods import TOLERANCE, berman, one_shot, qi, two_stage
from cvxshear.methods.separate import CompleteTest, complete_test
from cvxshear.priors import Prior
from cvxshear.util import checks
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Floats

METHODS = ("efficient", "two-stage", "one-shot", "berman", "qi")


def identify(
    experiment: Measurement,
    method: str = "efficient",
    backend: str | Backend = "auto",
    priors: Sequence[Prior] = (),
    initial_mass: Sequence[float] | Floats | None = None,
    tolerance: float = TOLERANCE,
    *,
    accelerate: bool = False,
    rows: bool | None = None,
) -> Identification:
    """Identify the floor masses and story stiffnesses of a frame.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in
    method : str, optional
        "efficient": one weighted fit over all configurations, which takes incomplete data. "two-stage": the
        paper's, and "one-shot", "berman", "qi": each configuration by itself; these need all modes at all
        floors and the total mass.
    backend : str or Backend, optional
        Which solver solves the programs; `cvxshear.backends.available()` lists them.
    priors : sequence of Prior, optional
        Besides those of the experiment.
    initial_mass : array_like, shape (N,), optional
        Where the mass iteration starts, kg without added mass (two-stage, berman, qi).
    tolerance : float, optional
        e of Eq. 15, at which the mass iteration stops (two-stage).
    accelerate : bool, optional
        A few steps to the same masses in place of the paper's fourteen and more (two-stage).
    rows : bool, optional
        Whether the programs of two-stage and one-shot keep a row for each pair of modes, and are factorized by QR;
        else their normal matrices are, without those rows. By the number of stories where not given.

    Returns
    -------
    Identification

    Raises
    ------
    UnsuitableError
        Where the method cannot use these data.
    InfeasibleError
        Where declared masses and priors contradict each other.
    NoSolutionError
        Where the backend does not solve a program.
    """
    checks.choice(method, METHODS, "method")
    experiment = opened(experiment).with_priors(tuple(priors))
    solver = backends.get(backend)
    checks.number(tolerance, "tolerance", above=0.0)
    start = None
    if initial_mass is not None:
        if method in ("efficient", "one-shot"):
            raise UnsuitableError(f"method {method} takes no initial mass; two-stage, berman and qi do")
        start = checks.vector(np.asarray(initial_mass), "initial mass", length=experiment.stories, above=0.0)
    if accelerate and method != "two-stage":
        raise UnsuitableError(f"method {method} has no mass iteration to accelerate; two-stage has")
    if rows is not None and method not in ("two-stage", "one-shot"):
        raise UnsuitableError(f"method {method} does not choose between rows and normal matrices")
    if method == "efficient":
        estimate = efficient(experiment, solver)
        return Identification(
            experiment,
            method,
            solver.name,
            (estimate.part,),
            joint=True,
            correlation=estimate.correlation,
            parameter_names=parameter_names(experiment, ()),
            undetermined=estimate.uncertainty.null_directions,
        )
    settings = [complete_test(experiment, each, method, rows=rows) for each in experiment.configurations]
    parts = [_part(method, test, solver, start, tolerance, accelerate=accelerate) for test in settings]
    return Identification(experiment, method, solver.name, tuple(parts))


def _part(
    method: str, test: CompleteTest, solver: Backend, start: Floats | None, tolerance: float, *, accelerate: bool
) -> SingleIdentification:
    if method == "one-shot":
        return one_shot(test, solver)
    if method == "two-stage":
        return two_stage(test, solver, start, tolerance, accelerate=accelerate)
    return {"berman": berman, "qi": qi}[method](test, solver, start)
