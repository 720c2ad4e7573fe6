"""The identification by a method, a backend and priors; and every backend on the programs that identification makes."""

from collections.abc import Iterator, Sequence

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend, BenchmarkProgram, Comparison
from cvxshear.backends.benchmark import REPEATS
from cvxshear.fit.domain import domain_of
from cvxshear.fit.efficient import efficient, parameter_names
from cvxshear.fit.gauss_newton import step_program
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.results import Identification, SingleIdentification
from cvxshear.fit.start import uniform
from cvxshear.measurement.experiment import Measurement, opened
from cvxshear.methods.paper_methods import TOLERANCE, berman, one_shot, qi, two_stage
from cvxshear.methods.separate import CompleteTest, complete_test, start_mass
from cvxshear.priors import Prior
from cvxshear.programs import LeastSquares, mass_correction, one_shot_masses, story_stiffnesses
from cvxshear.programs.orthogonality import normalized
from cvxshear.programs.statements import constrained
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


TIGHTER = 0.95
"""The bounded programs hold their largest answer to this part of what it would be, so that a bound is active."""


def compare_backends(
    experiment: Measurement,
    names: Sequence[str] | None = None,
    *,
    repeats: int = REPEATS,
    tolerance: float | None = None,
) -> Comparison:
    """Solve the same programs of an experiment with every backend.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in
    names : sequence of str, optional
        Backends; all that are installed where not given.
    repeats : int, optional
        Solves of each program of which the fastest counts.
    tolerance : float, optional
        Accuracy asked of the solvers, in place of their settings here.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        Where a named backend is not installed, or a number makes no sense.
    """
    experiment = opened(experiment)
    programs, left_out = programs_of(experiment)
    return backends.compare(
        programs, names, repeats=repeats, tolerance=tolerance, experiment=experiment.name, left_out=left_out
    )


def programs_of(experiment: Measurement) -> tuple[list[BenchmarkProgram], str]:
    """List the programs of an experiment, of each configuration by itself and of all together.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in

    Returns
    -------
    programs : list of BenchmarkProgram
        Kinds "mass" (Eqs. 5 to 14), "stiffness" (Eqs. 20 to 24) and "one-shot"; "bounded mass" and "bounded
        stiffness", where an upper bound is active; "singular stiffness", of the first mode alone, where upper bounds
        determine what the data do not; "step", of the efficient estimator at a frame of uniform stiffness.
    left_out : str
        Why there is none of the kinds but the last; empty where there are.
    """
    experiment = opened(experiment)
    separate: list[BenchmarkProgram] = []
    left_out = ""
    try:
        for each in experiment.configurations:
            separate += _programs_of_one(complete_test(experiment, each, "two-stage"))
    except UnsuitableError as error:
        separate, left_out = [], str(error)
    theta = uniform(experiment)
    step = step_program(Misfit(experiment).evaluate(theta), theta, domain_of(experiment, (), theta))
    return [*separate, BenchmarkProgram("step", step, theta)], left_out


def _programs_of_one(test: CompleteTest) -> Iterator[BenchmarkProgram]:
    added = test.configuration.added_mass
    start = start_mass(test, None)
    mass = constrained(
        mass_correction(normalized(test.shapes, start), start, test.total), test.mass_statements, start - added
    )
    one_shot = constrained(one_shot_masses(test.shapes, test.total), test.mass_statements, -added)
    shapes = normalized(test.shapes, backends.get("auto").solve(one_shot).x)
    nothing = np.zeros(len(start))
    stiffness = constrained(story_stiffnesses(shapes, test.eigenvalues), test.stiffness_statements, nothing)
    yield BenchmarkProgram("mass", mass, start)
    yield BenchmarkProgram("stiffness", stiffness, nothing)
    yield BenchmarkProgram("one-shot", one_shot, nothing)
    yield BenchmarkProgram("bounded mass", _tightened(mass, start), start)
    yield BenchmarkProgram("bounded stiffness", _tightened(stiffness, nothing), nothing)
    if len(start) > 1:
        # The program of the first mode alone has one row, without a negative entry, that asks for more than the bounds
        # allow below the uniform stiffness: so they are the answer.
        uniform_stiffness = test.eigenvalues[0] / np.sum(np.diff(shapes[:, 0], prepend=0.0) ** 2)
        alone = story_stiffnesses(shapes[:, :1], test.eigenvalues[:1], rows=True)
        bounded = alone.replace(lower=nothing, upper=np.full(len(start), TIGHTER * uniform_stiffness))
        yield BenchmarkProgram("singular stiffness", bounded, nothing)


def _tightened(program: LeastSquares, origin: Floats) -> LeastSquares:
    """Bound the program's largest answer below what it would be."""
    answer = origin + backends.get("auto").solve(program).x
    upper = np.full(len(origin), np.inf) if program.upper is None else program.upper.copy()
    largest = int(np.argmax(answer))
    upper[largest] = min(upper[largest], TIGHTER * answer[largest] - origin[largest])
    return program.replace(upper=upper)
