"""Every backend on the same programs, against the closed form."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from cvxshear import backends
from cvxshear.errors import CvxshearError, UnsuitableError
from cvxshear.experiment import Experiment
from cvxshear.identification.domain import domain_of
from cvxshear.identification.gauss_newton import step_program
from cvxshear.identification.misfit import Misfit
from cvxshear.identification.separate import Setting, setting, start_mass
from cvxshear.identification.start import uniform
from cvxshear.programs import LeastSquares, mass_correction, one_shot_masses, story_stiffnesses
from cvxshear.programs.mass import normalized
from cvxshear.programs.rows import constrained
from cvxshear.showing import Shown
from cvxshear.typing import Floats, Json

REPEATS = 3
TIGHTER = 0.95
"""The bounded programs hold their largest answer to this part of what it would be, so that a bound is active."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A program of an experiment, and the quantity that its unknown changes.

    Parameters
    ----------
    kind : str
        "mass", "stiffness", "one-shot", "bounded mass", "bounded stiffness" or "step".
    program : LeastSquares
    origin : ndarray, shape (n,)
        The quantity itself is origin + x.
    """

    kind: str
    program: LeastSquares
    origin: Floats


@dataclass(frozen=True)
class Row:
    """One backend on all programs of one kind.

    Parameters
    ----------
    kind, backend : str
    programs : int
        How many programs of the kind there were.
    difference : float or None
        Largest relative difference from the reference; None where the backend solved none.
    reference : str
        "closed form", or "consensus" (the median of the backends) where a bound is active.
    primal_residual, dual_residual, duality_gap : float or None
        The worst of the certificates.
    iterations : int or None
        Sum over the programs; None where the backend does not tell.
    relative_time : float or None
        Time of the fastest of a few solves, over that of the closed form on the same programs (on the programs of
        the same kind without bounds, where bounds are active).
    failure : str
        Why a program was not solved; empty where all were.
    """

    kind: str
    backend: str
    programs: int
    difference: float | None
    reference: str
    primal_residual: float | None
    dual_residual: float | None
    duality_gap: float | None
    iterations: int | None
    relative_time: float | None
    failure: str


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """The result of `compare_backends`.

    Parameters
    ----------
    experiment : str
        Its name.
    rows : tuple of Row
    left_out : str
        Why the programs of the paper are not among them; empty where they are.
    """

    experiment: str
    rows: tuple[Row, ...]
    left_out: str

    def to_dict(self) -> Json:
        """The rows as dicts."""
        return {"experiment": self.experiment, "left_out": self.left_out, "rows": [asdict(row) for row in self.rows]}


def compare_backends(experiment: Experiment, names: Sequence[str] | None = None) -> Comparison:
    """Solve the same programs of an experiment with every backend.

    Parameters
    ----------
    experiment : Experiment
    names : sequence of str, optional
        Backends; all that are installed where not given.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        Where a named backend is not installed.
    """
    names = backends.available() if names is None else [backends.get(name).name for name in names]
    problems, left_out = _paper_problems(experiment)
    problems += _step_problems(experiment)
    rows: list[Row] = []
    kinds = list(dict.fromkeys(problem.kind for problem in problems))
    for kind in kinds:
        rows += _compared(kind, [problem for problem in problems if problem.kind == kind], names)
    return Comparison(experiment.name, tuple(rows), left_out)


def _paper_problems(experiment: Experiment) -> tuple[list[Problem], str]:
    """The programs of the methods that identify each configuration by itself, or why there are none."""
    problems: list[Problem] = []
    try:
        for each in experiment.configurations:
            problems += _problems_of(setting(experiment, each, "two-stage"))
    except UnsuitableError as error:
        return [], str(error)
    return problems, ""


def _problems_of(of: Setting) -> Iterator[Problem]:
    added = of.configuration.added_mass
    start = start_mass(of, None)
    mass = constrained(
        mass_correction(normalized(of.shapes, start), start, of.total), of.mass_statements, start - added
    )
    one = constrained(one_shot_masses(of.shapes, of.total), of.mass_statements, -added)
    kkt = backends.get("auto")
    masses = kkt.solve(one).x
    stiff = constrained(
        story_stiffnesses(normalized(of.shapes, masses), of.eigenvalues), of.stiffness_statements, np.zeros(len(start))
    )
    nothing = np.zeros(len(start))
    yield Problem("mass", mass, start)
    yield Problem("stiffness", stiff, nothing)
    yield Problem("one-shot", one, nothing)
    yield Problem("bounded mass", _tightened(mass, start), start)
    yield Problem("bounded stiffness", _tightened(stiff, nothing), nothing)


def _tightened(program: LeastSquares, origin: Floats) -> LeastSquares:
    """The program with its largest answer held below what it would be."""
    answer = origin + backends.get("auto").solve(program).x
    upper = np.full(len(origin), np.inf) if program.upper is None else program.upper.copy()
    largest = int(np.argmax(answer))
    upper[largest] = min(upper[largest], TIGHTER * answer[largest] - origin[largest])
    return program.replace(upper=upper)


def _step_problems(experiment: Experiment) -> list[Problem]:
    """The step program of the efficient estimator at a frame of uniform stiffness, where there is a way to go."""
    theta = uniform(experiment)
    at = Misfit(experiment).evaluate(theta)
    return [Problem("step", step_program(at, theta, domain_of(experiment, (), theta)), theta)]


def _compared(kind: str, problems: list[Problem], names: Sequence[str]) -> list[Row]:
    """One row a backend, for the programs of one kind."""
    answers = {name: _Answers.of(name, problems) for name in names}
    closed = answers["kkt"] if "kkt" in answers else _Answers.of("kkt", problems)
    bounded = bool(closed.failure)
    if bounded:
        solved = [item for item in answers.values() if not item.failure]
        reference = (
            [np.median([item.values[i] for item in solved], axis=0) for i in range(len(problems))] if solved else []
        )
        free = [Problem(item.kind, item.program.replace(lower=None, upper=None), item.origin) for item in problems]
        unit = _Answers.of("kkt", free).seconds
    else:
        reference, unit = closed.values, closed.seconds
    return [item.row(kind, name, reference, unit, bounded) for name, item in answers.items()]


@dataclass(frozen=True, eq=False)
class _Answers:
    """What one backend made of some programs."""

    values: list[Floats]
    solutions: list[backends.Solution]
    seconds: float
    failure: str

    @staticmethod
    def of(name: str, problems: Sequence[Problem]) -> _Answers:
        backend = backends.get(name)
        values, solutions, seconds = [], [], 0.0
        for problem in problems:
            try:
                solution = backend.solve(problem.program)
                seconds += min(_timed(backend, problem.program) for _ in range(REPEATS))
            except CvxshearError as error:
                return _Answers([], [], float("nan"), str(error))
            values.append(problem.origin + solution.x)
            solutions.append(solution)
        return _Answers(values, solutions, seconds, "")

    def row(self, kind: str, name: str, reference: list[Floats], unit: float, bounded: bool) -> Row:
        said = "consensus" if bounded else "closed form"
        if self.failure:
            return Row(kind, name, len(reference), None, said, None, None, None, None, None, self.failure)
        certificates = [item.certificate for item in self.solutions]
        iterations = [item.iterations for item in self.solutions]
        return Row(
            kind,
            name,
            len(reference),
            max(float(np.max(np.abs(a - b) / np.abs(b))) for a, b in zip(self.values, reference, strict=True)),
            said,
            max(item.primal_residual for item in certificates),
            max(item.dual_residual for item in certificates),
            max(item.duality_gap for item in certificates),
            sum(item for item in iterations if item is not None) if None not in iterations else None,
            self.seconds / unit if unit > 0 else None,
            "",
        )


def _timed(backend: backends.Backend, program: LeastSquares) -> float:
    start = time.perf_counter()
    backend.solve(program)
    return time.perf_counter() - start
