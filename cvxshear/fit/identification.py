"""The identification by a method, a backend and priors; and every backend on the programs of an identification."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend, BenchmarkProgram, Comparison, Recorder
from cvxshear.fit.domain import domain_of
from cvxshear.fit.efficient import efficient, parameter_names
from cvxshear.fit.gauss_newton import step_program
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.other_frames import other_frames
from cvxshear.fit.paper_methods import TOLERANCE, berman, one_shot, qi, two_stage
from cvxshear.fit.results import Identification, SingleIdentification
from cvxshear.fit.start import starts, uniform
from cvxshear.fit.turning_floors import one_shot_turning
from cvxshear.measurement.experiment import Measurement, opened
from cvxshear.priors import Prior
from cvxshear.programs import LeastSquares, MatrixInequality
from cvxshear.programs.formulations import CompleteTest, complete_test, normalized, stiffness_rows
from cvxshear.programs.turning import TurningTest, turning_tests
from cvxshear.util import checks, decorators, errors, ranking
from cvxshear.util.typing import Floats

METHODS = ("efficient", "two-stage", "one-shot", "berman", "qi")


@decorators.usual_arithmetic
def identify(
    experiment: Measurement,
    method: str | None = None,
    backend: str | Backend = "auto",
    priors: Sequence[Prior] = (),
    initial_mass: Sequence[float] | Floats | None = None,
    tolerance: float = TOLERANCE,
    *,
    keep_programs: bool = False,
) -> Identification:
    """Identify the floor masses and story stiffnesses of a frame.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in example
    method : str, optional
        "efficient" (the default): one weighted fit to all configurations, which may be incomplete. "two-stage" (the
        paper's), "one-shot", "berman" and "qi": each configuration by itself, with all modes at all floors and the
        total mass. Floors that turn take "efficient" and "one-shot", with as many modes as they have.
    backend : str or Backend, optional
        Solver of the programs; `cvxshear.backends.available()` lists them.
    priors : sequence of Prior, optional
        In addition to the priors of the experiment.
    initial_mass : array_like, shape (N,), optional
        Start of the mass iteration, kg without added mass (two-stage, berman, qi).
    tolerance : float, optional
        e of Eq. 15, the stopping tolerance of the mass iteration (two-stage).
    keep_programs : bool, optional
        Whether the result keeps every program that was solved, with its solution, in `Identification.programs`.

    Returns
    -------
    Identification

    Raises
    ------
    UnsuitableError
        If the method cannot use these data.
    InfeasibleError
        If declared masses and priors contradict each other.
    NoSolutionError
        If the backend does not solve a program.
    """
    method = "efficient" if method is None else checks.choice(method, METHODS, "method")
    experiment = opened(experiment, turning=method in ("efficient", "one-shot")).with_priors(tuple(priors))
    solver = Recorder(backends.get(backend)) if keep_programs else backends.get(backend)
    checks.number(tolerance, "tolerance", above=0.0)
    start = None
    if initial_mass is not None:
        if method in ("efficient", "one-shot"):
            raise errors.UnsuitableError(f"method {method} takes no initial mass; two-stage, berman and qi do")
        start = checks.vector(np.asarray(initial_mass), "initial mass", length=experiment.stories, above=0.0)
    if method == "efficient":
        estimate = efficient(experiment, solver)
        found = Identification(
            experiment,
            method,
            solver.name,
            (estimate.part,),
            joint=True,
            correlation=estimate.correlation,
            parameter_names=parameter_names(experiment, ()),
            undetermined=estimate.undetermined,
            others=other_frames(estimate, backends.get("auto")),
        )
    else:
        methods: dict[str, Callable[[CompleteTest, Backend], SingleIdentification]] = {
            "two-stage": partial(two_stage, initial_mass=start, tolerance=tolerance),
            "one-shot": one_shot,
            "berman": partial(berman, initial_mass=start),
            "qi": partial(qi, initial_mass=start),
        }
        turning, user = experiment.frame.turns, f"method {method}"
        parts = tuple(
            one_shot_turning(TurningTest.of(experiment, each, user), solver)
            if turning
            else methods[method](complete_test(experiment, each, user), solver)
            for each in experiment.configurations
        )
        found = Identification(experiment, method, solver.name, parts)
    return dataclasses.replace(found, programs=tuple(solver.solved)) if isinstance(solver, Recorder) else found


#: Upper bound of the largest unknown of the bounded programs, relative to its free value, so that a bound is active.
TIGHTER = 0.95


@decorators.usual_arithmetic
def compare_backends(
    experiment: Measurement, names: Sequence[str] | None = None, *, repeats: int = 3, tolerance: float | None = None
) -> Comparison:
    """Solve the same programs of an experiment with every backend.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in
    names : sequence of str, optional
        Backends. Default: all that are installed.
    repeats : int, optional
        Number of solves of each program; the fastest counts.
    tolerance : float, optional
        Accuracy asked of the solvers, in place of their settings here.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If a named backend is not installed, or a number is out of range.
    """
    experiment = opened(experiment, turning=True)
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
        Kinds "mass" (Eqs. 5 to 14), "stiffness" (Eqs. 20 to 24) and "one-shot"; "bounded mass" (unless the floor masses
        are declared) and "bounded stiffness", with an active upper bound; "singular stiffness", of the first mode
        alone, where upper bounds determine the answer; "step", of the efficient estimator at a frame of uniform
        stiffness. Of floors that turn: "one-shot", "stiffness", "bounded mass" with an active matrix inequality, and
        "step" at the solution of the story equations.
    left_out : str
        Why only the last kind exists; empty if all do.
    """
    experiment = dataclasses.replace(opened(experiment, turning=True), symmetric=False)
    separate: list[BenchmarkProgram] = []
    left_out = ""
    if experiment.frame.turns:
        for test in turning_tests(experiment):
            separate += _programs_of_turning(test)
        theta = starts(experiment)[0]
    else:
        try:
            for each in experiment.configurations:
                separate += _programs_of_one(complete_test(experiment, each, "method two-stage"))
        except errors.UnsuitableError as error:
            separate, left_out = [], str(error)
        theta = uniform(experiment)
    step = step_program(Misfit(experiment).evaluate(theta), theta, domain_of(experiment, (), theta))
    return [*separate, BenchmarkProgram("step", step, theta)], left_out


def _programs_of_turning(test: TurningTest) -> Iterator[BenchmarkProgram]:
    floors = test.one_shot_masses()
    masses = backends.get("auto").solve(floors).x
    stories = test.story_stiffnesses(masses)
    yield BenchmarkProgram("one-shot", floors, np.zeros(floors.unknowns))
    yield BenchmarkProgram("stiffness", stories, np.zeros(stories.unknowns))
    first, *others = floors.lmi
    # The least eigenvalue of the first floor's matrix, a tenth above that of the answer.
    raised = first.constant - 1.1 * np.linalg.eigvalsh(first.at(masses))[0] * np.eye(3)
    held = floors.replace(lmi=(MatrixInequality(first.name, raised, first.slopes), *others))
    yield BenchmarkProgram("bounded mass", held, np.zeros(floors.unknowns))


def _programs_of_one(test: CompleteTest) -> Iterator[BenchmarkProgram]:
    added, start = test.configuration.added_mass, test.start_mass()
    mass, one_shot_program = test.mass_correction(start), test.one_shot_masses()
    net = backends.get("auto").solve(one_shot_program).x
    zero = np.zeros(len(start))
    stiffness = test.story_stiffnesses(net + added)
    yield BenchmarkProgram("mass", mass, start)
    yield BenchmarkProgram("stiffness", stiffness, zero)
    yield BenchmarkProgram("one-shot", one_shot_program, zero)
    if test.experiment.frame.floor_masses is None:
        yield BenchmarkProgram("bounded mass", _tightened(mass, start), start)
    yield BenchmarkProgram("bounded stiffness", _tightened(stiffness, zero), zero)
    if len(start) > 1:
        # The first mode alone gives one row without negative entries. Upper bounds below the uniform stiffness do not
        # reach its right side, so the bounds are the answer.
        first = normalized(test.shapes, net + added)[:, :1]
        alone = stiffness_rows(first, test.eigenvalues[:1])
        bounded = alone.replace(lower=zero, upper=TIGHTER * test.even_stiffness(net + added))
        yield BenchmarkProgram("singular stiffness", bounded, zero)


def _tightened(program: LeastSquares, origin: Floats) -> LeastSquares:
    """Bound the program's largest answer below what it would be."""
    answer = origin + backends.get("auto").solve(program).x
    upper = np.full(len(origin), np.inf) if program.upper is None else program.upper.copy()
    largest = ranking.first_largest(answer)
    upper[largest] = min(upper[largest], TIGHTER * answer[largest] - origin[largest])
    return program.replace(upper=upper)
