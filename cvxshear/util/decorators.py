"""Decorators: a cached property, and NumPy's usual error handling."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property as cached_property  # noqa: PLC0414
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np

Given = ParamSpec("Given")
Returned = TypeVar("Returned")


def usual_arithmetic(function: Callable[Given, Returned]) -> Callable[Given, Returned]:
    """Run a function with numpy's default error handling.

    Underflow is harmless and frequent, in the tails of probabilities. A caller's `np.seterr(all="raise")` would make
    it an error.
    """

    @wraps(function)
    def wrapped(*args: Given.args, **kwargs: Given.kwargs) -> Returned:
        with np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"):
            return function(*args, **kwargs)

    return wrapped
