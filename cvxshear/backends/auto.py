"""The choice when no backend is named: the closed form while it holds, else an interior-point solver."""

from __future__ import annotations

from cvxshear.backends.base import Answer, Backend
from cvxshear.backends.canonical import Canonical
from cvxshear.errors import NoSolutionError, UnsuitableError


class Auto(Backend):
    """`closed_form` where no inequality is active, `general` where one is.

    Parameters
    ----------
    closed_form, general : Backend
    """

    name = "auto"

    def __init__(self, closed_form: Backend, general: Backend) -> None:
        self._closed_form = closed_form
        self._general = general

    def answer(self, problem: Canonical) -> Answer:
        try:
            return self._closed_form.answer(problem)
        except UnsuitableError:
            return self._general.answer(problem)
        except NoSolutionError:
            if not len(problem.F):
                raise
            return self._general.answer(problem)
