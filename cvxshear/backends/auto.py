"""The choice when no backend is named: the closed form while it holds, else the fastest general solver that is right.

The order of the general solvers follows the table of `docs/speed.md` (python -m tests.benchmarks solvers). Once
scaled, a program has the identity for its Hessian and a few active inequalities at most, which a dual active-set
method walks through in as many steps: DAQP takes a half to an eighth of the time of Clarabel from 3 to 100
unknowns. Where the data leave a direction open the Hessian is singular, and the interior-point method comes first.
Every answer is certified; where it fails the next solver is asked.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from cvxshear.backends.base import Backend
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.certificate import Assembled
from cvxshear.backends.solution import Solution
from cvxshear.util.errors import NoSolutionError, UnsuitableError


class Auto(Backend):
    """`closed_form` where no inequality is active, the first of the general solvers that succeeds where one is.

    Parameters
    ----------
    closed_form : Backend
    definite, singular : sequence of Backend
        General solvers in the order in which they are asked, for programs whose data determine every unknown, and
        for those whose data do not.
    """

    name = "auto"

    def __init__(self, closed_form: Backend, definite: Sequence[Backend], singular: Sequence[Backend]) -> None:
        self._closed_form = closed_form
        self._definite = tuple(definite)
        self._singular = tuple(singular)

    def answer(self, problem: Canonical) -> Answer:
        """The closed form's answer; what asks the others is `certified`, since which one is right shows there."""
        return self._closed_form.answer(problem)

    def certified(self, of: Assembled, problem: Canonical, start: Solution | None = None) -> Solution:
        return dataclasses.replace(self._first(of, problem, start), backend=self.name)

    def _first(self, of: Assembled, problem: Canonical, start: Solution | None) -> Solution:
        """The first solution that is certified; where there is none, the first general solver's failure."""
        failure: NoSolutionError | None = None
        try:
            return self._closed_form.certified(of, problem, start)
        except UnsuitableError:
            pass
        except NoSolutionError:
            if not len(problem.F):
                raise
        for backend in self._singular if problem.singular else self._definite:
            try:
                return backend.certified(of, problem, start)
            except NoSolutionError as error:
                failure = failure or error
        raise failure if failure is not None else NoSolutionError(self.name, "there is no general solver")
