"""Comparison of backends on the same programs: differences of their answers, certificates and times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.backends.base import Backend
from cvxshear.backends.solvers import available, get
from cvxshear.programs import LeastSquares, Solution
from cvxshear.programs.certificate import Acceptance, Assembled, largest_relative
from cvxshear.util import checks
from cvxshear.util.errors import CvxshearError
from cvxshear.util.results import Shown
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class BenchmarkProgram:
    """A program that backends are compared on, and the quantity that its unknown changes.

    Parameters
    ----------
    kind : str
        Programs of one kind are reported together.
    program : LeastSquares
    origin : ndarray, shape (n,)
        The quantity itself is origin + x; differences are relative to it.
    """

    kind: str
    program: LeastSquares
    origin: Floats


@dataclass(frozen=True)
class ProgramKind:
    """Sizes of the programs of one kind: the largest of them.

    Parameters
    ----------
    kind : str
    programs : int
        How many there are.
    unknowns, rows, equalities, inequalities : int
        Inequalities are rows of G and finite bounds.
    """

    kind: str
    programs: int
    unknowns: int
    rows: int
    equalities: int
    inequalities: int


@dataclass(frozen=True)
class BackendResult:
    """One backend on all programs of one kind.

    Parameters
    ----------
    kind, backend : str
    programs : int
        How many programs of the kind there were.
    difference : float or None
        Largest relative difference from the reference; None if the backend did not solve all of them.
    reference : str
        "closed form", or "auto" if the closed form does not apply.
    primal_residual, dual_residual, duality_gap, error_bound : float or None
        The worst of the certificates.
    iterations : int or None
        Sum over the programs; None if the backend does not report it.
    seconds : float or None
        Sum over the programs of the fastest solve, with scaling and certificate.
    relative_time : float or None
        `seconds` divided by the time of the reference on the same programs.
    tolerance : float or None
        The loosest accuracy that the solver is asked to reach; None if it takes none.
    failure : str
        Why a program was not solved; empty if all were solved.
    as_given, polished, replaced : int
        Number of answers that were accepted as the solver gave them, polished by the closed form on their active
        constraints, and replaced by it since they did not pass (see `cvxshear.programs.Acceptance`).
    """

    kind: str
    backend: str
    programs: int
    difference: float | None
    reference: str
    primal_residual: float | None
    dual_residual: float | None
    duality_gap: float | None
    error_bound: float | None
    iterations: int | None
    seconds: float | None
    relative_time: float | None
    tolerance: float | None
    failure: str
    as_given: int = 0
    polished: int = 0
    replaced: int = 0


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Backends on the same programs.

    Parameters
    ----------
    experiment : str
        Name of the experiment that the programs belong to.
    kinds : tuple of ProgramKind
    rows : tuple of BackendResult
    left_out : str
        Why the programs of the paper's methods are left out; empty if they are not.
    """

    experiment: str
    kinds: tuple[ProgramKind, ...]
    rows: tuple[BackendResult, ...]
    left_out: str = ""

    json_keys = "experiment left_out kinds rows"


def compare(
    programs: Sequence[BenchmarkProgram],
    names: Sequence[str | Backend] | None = None,
    *,
    repeats: int = 3,
    tolerance: float | None = None,
    experiment: str = "",
    left_out: str = "",
) -> Comparison:
    """Solve the same programs with every backend.

    Parameters
    ----------
    programs : sequence of BenchmarkProgram
    names : sequence of str or Backend, optional
        Backends. Default: all that are installed.
    repeats : int, optional
        Number of solves of each program; the fastest counts.
    tolerance : float, optional
        Accuracy that the solvers are asked to reach, in place of their settings here. The certificate's limits stay.
    experiment, left_out : str, optional
        As in `Comparison`.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If a named backend is not installed, or a number is out of range.
    """
    checks.whole(repeats, "repeats", least=1)
    chosen = [get(name) for name in (available() if names is None else names)]
    if tolerance is not None:
        tolerance = checks.number(tolerance, "tolerance", above=0.0)
        chosen = [backend.with_tolerance(tolerance) for backend in chosen]
    kinds, rows = [], []
    for kind in dict.fromkeys(each.kind for each in programs):
        of_kind = [each for each in programs if each.kind == kind]
        stated = [each.program for each in of_kind]
        sizes = [(p.unknowns, len(p.R), len(p.equalities[1]), len(p.inequalities[1])) for p in stated]
        kinds.append(ProgramKind(kind, len(stated), *map(max, zip(*sizes, strict=True))))
        rows += _compared(kind, of_kind, chosen, repeats)
    return Comparison(experiment, tuple(kinds), tuple(rows), left_out)


def _compared(
    kind: str, programs: Sequence[BenchmarkProgram], chosen: Sequence[Backend], repeats: int
) -> list[BackendResult]:
    """One row a backend, for the programs of one kind."""
    answers = [_Answers.of(backend, programs, repeats) for backend in chosen]
    named = dict(zip((backend.name for backend in chosen), answers, strict=True))
    reference, said = named.get("kkt") or _Answers.of(get("kkt"), programs, repeats), "closed form"
    if reference.failure:
        reference, said = _Answers.of(get("auto"), programs, repeats), "auto"
    return [
        item.result(kind, backend, len(programs), reference, said)
        for backend, item in zip(chosen, answers, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Answers:
    """Answers of one backend to some programs."""

    values: list[Floats]
    solutions: list[Solution]
    seconds: float | None
    failure: str

    @staticmethod
    def of(backend: Backend, programs: Sequence[BenchmarkProgram], repeats: int) -> _Answers:
        values, solutions, seconds = [], [], 0.0
        for each in programs:
            try:
                solution = backend.solve(each.program)
                seconds += min(backend.solve(each.program).seconds for _ in range(repeats))
            except CvxshearError as error:
                return _Answers([], [], None, str(error))
            values.append(each.origin + solution.x)
            solutions.append(solution)
        return _Answers(values, solutions, seconds, "")

    def result(self, kind: str, backend: Backend, programs: int, reference: _Answers, said: str) -> BackendResult:
        figures = ("primal_residual", "dual_residual", "duality_gap", "error_bound")
        certificates = [item.certificate.to_dict() for item in self.solutions]
        iterations = [item.iterations for item in self.solutions]
        accepted = [item.acceptance for item in self.solutions]
        # One of the two is empty if a program was not solved.
        pairs = zip(self.values, reference.values, self.solutions, strict=False)
        return BackendResult(
            kind=kind,
            backend=backend.name,
            programs=programs,
            difference=_largest([_difference(a, b, solution.program) for a, b, solution in pairs]),
            reference=said,
            **{name: _largest([each[name] for each in certificates]) for name in figures},
            iterations=None if self.failure or None in iterations else sum(item or 0 for item in iterations),
            seconds=self.seconds,
            relative_time=self.seconds / reference.seconds if self.seconds and reference.seconds else None,
            tolerance=backend.tolerance,
            failure=self.failure,
            as_given=accepted.count(Acceptance.AS_GIVEN),
            polished=accepted.count(Acceptance.POLISHED),
            replaced=accepted.count(Acceptance.REPLACED),
        )


def _difference(found: Floats, reference: Floats, program: LeastSquares) -> float:
    """Compute the largest difference, relative to the reference; near zero, to the rest of its size (`Certificate`)."""
    rest = Assembled(program).size(reference) - np.abs(reference)
    return largest_relative(np.abs(found - reference), np.maximum(np.abs(reference), rest))


def _largest(values: Sequence[float | None]) -> float | None:
    """Return the largest value; None if the list is empty or has a None."""
    known = [float(value) for value in values if value is not None]
    return max(known) if known and len(known) == len(values) else None
