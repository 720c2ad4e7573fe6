"""The library's own floating-point settings, whatever those of the caller are."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
R = TypeVar("R")


def usual_arithmetic(function: Callable[P, R]) -> Callable[P, R]:
    """Run a function with numpy's default error handling.

    Underflow is harmless and frequent, in the tails of probabilities. A caller's `np.seterr(all="raise")` would make
    it an error.
    """

    @wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"):
            return function(*args, **kwargs)

    return wrapped
