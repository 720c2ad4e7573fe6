"""Decorators: a cached property without a lock, and NumPy's usual error handling."""

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

Given = ParamSpec("Given")
Returned = TypeVar("Returned")

if TYPE_CHECKING:
    # Type checkers know this name; the class below behaves as it does.
    from functools import cached_property as cached_property  # noqa: PLC0414
else:

    class cached_property:  # noqa: N801
        """A property that is computed once for each object and kept in its `__dict__`.

        `functools.cached_property` of Python 3.11 holds one lock for all instances of a class while it computes. A
        process that is forked meanwhile inherits the lock and waits for it forever. Without a lock, two threads may
        both compute a value; both values are equal, and one of them stays.

        Parameters
        ----------
        function : callable
            Computes the value from the object.
        """

        def __init__(self, function: Callable[[Any], Any]) -> None:
            self.func = function
            self.__doc__ = function.__doc__
            self.__module__ = function.__module__

        def __set_name__(self, owner: type, name: str) -> None:
            self.name = name

        def __get__(self, instance: object | None, owner: type | None = None) -> Any:
            """Return the value. Python asks only while the object's `__dict__` does not hold it."""
            if instance is None:
                return self
            found = self.func(instance)
            instance.__dict__[self.name] = found
            return found


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
