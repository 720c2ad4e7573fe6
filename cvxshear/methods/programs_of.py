"""The programs that an experiment gives rise to, for comparing backends on them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cvxshear import backends
from cvxshear.backends import BenchmarkProgram, Comparison
from cvxshear.backends.benchmark import REPEATS
from cvxshear.fit.domain import domain_of
from cvxshear.fit.gauss_newton import step_program
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.start import uniform
from cvxshear.measurement.experiment import Experiment, Measurement, opened
from cvxshear.methods.separate import CompleteTest, complete_test, start_mass
from cvxshear.programs import LeastSquares, mass_correction, one_shot_masses, story_stiffnesses
from cvxshear.programs.orthogonality import normalized
from cvxshear.programs.statements import constrained
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Floats

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
    separate, left_out = _separate_programs(experiment)
    return [*separate, *_step_programs(experiment)], left_out


def _separate_programs(experiment: Experiment) -> tuple[list[BenchmarkProgram], str]:
    """List the programs of the methods that identify each configuration by itself, or say why there are none."""
    programs: list[BenchmarkProgram] = []
    try:
        for each in experiment.configurations:
            programs += _programs_of_one(complete_test(experiment, each, "two-stage"))
    except UnsuitableError as error:
        return [], str(error)
    return programs, ""


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
        yield BenchmarkProgram("singular stiffness", _of_first_mode(shapes[:, 0], test.eigenvalues[0]), nothing)


def _tightened(program: LeastSquares, origin: Floats) -> LeastSquares:
    """Bound the program's largest answer below what it would be."""
    answer = origin + backends.get("auto").solve(program).x
    upper = np.full(len(origin), np.inf) if program.upper is None else program.upper.copy()
    largest = int(np.argmax(answer))
    upper[largest] = min(upper[largest], TIGHTER * answer[largest] - origin[largest])
    return program.replace(upper=upper)


def _of_first_mode(shape: Floats, eigenvalue: float) -> LeastSquares:
    """Make the stiffness program of one mode alone, the stiffnesses bounded below the uniform one that it asks for.

    Its one row has no negative entry and asks for more than the bounds allow, so that they are the answer.
    """
    uniform_stiffness = eigenvalue / np.sum(np.diff(shape, prepend=0.0) ** 2)
    alone = story_stiffnesses(shape[:, None], np.array([eigenvalue]), rows=True)
    return alone.replace(lower=np.zeros(len(shape)), upper=np.full(len(shape), TIGHTER * uniform_stiffness))


def _step_programs(experiment: Experiment) -> list[BenchmarkProgram]:
    """Make the step program of the efficient estimator at a frame of uniform stiffness, where there is a way to go."""
    theta = uniform(experiment)
    at = Misfit(experiment).evaluate(theta)
    return [BenchmarkProgram("step", step_program(at, theta, domain_of(experiment, (), theta)), theta)]
