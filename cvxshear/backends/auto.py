"""The choice when no backend is named: the closed form while it holds, else the fastest general solver that is right.

The order of the general solvers follows the table of `docs/speed.md` (python -m tests.benchmarks solvers). Once
scaled, a program has the identity for its Hessian and a few active inequalities at most, which a dual active-set
method walks through in as many steps: DAQP takes a half to an eighth of the time of Clarabel from 3 to 100
unknowns. Where the data leave a direction open the Hessian is singular, and the interior-point method comes first.
Every answer is certified; where it fails the next solver is asked.
"""

from __future__ import annotations

from collections.abc import Sequence

from cvxshear.backends.base import ACCEPTED, Backend, certify
from cvxshear.backends.canonical import Answer, Canonical
from cvxshear.backends.solution import Solution
from cvxshear.errors import NoSolutionError, UnsuitableError


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
        return self.whole_answer(problem)

    def whole_answer(self, problem: Canonical, start: Solution | None = None) -> Answer:
        try:
            return self._closed_form.answer(problem)
        except UnsuitableError:
            return self._general(problem, start)
        except NoSolutionError:
            if not len(problem.F):
                raise
            return self._general(problem, start)

    def _general(self, problem: Canonical, start: Solution | None) -> Answer:
        """The first answer of a general solver whose certificate is good; else the first one's failure or answer."""
        failure: NoSolutionError | None = None
        inaccurate: Answer | None = None
        for backend in self._singular if problem.singular else self._definite:
            try:
                found = backend.whole_answer(problem, start)
            except NoSolutionError as error:
                failure = failure or error
                continue
            if certify(problem, found).worst <= ACCEPTED:
                return found
            inaccurate = inaccurate or found
        if inaccurate is not None:
            # `solve` computes its certificate again, and refuses it with the residuals named.
            return inaccurate
        raise failure if failure is not None else NoSolutionError(self.name, "there is no general solver")
