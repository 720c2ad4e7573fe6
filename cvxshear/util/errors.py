"""The exceptions that cvxshear raises.

Every one derives from `CvxshearError`, so a caller can catch them all at once. `InputError` means that
the caller can mend it by changing what was handed in; `NoSolutionError` means that the input was sound
and a solver did not deliver.
"""

from __future__ import annotations

import importlib
from typing import Any

from cvxshear.util.text import printable


class CvxshearError(Exception):
    """Base of every exception raised by cvxshear; names of a file stand in its message as `printable` shows them."""

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(str(message)))


class InputError(CvxshearError, ValueError):
    """A measurement, an option or a prior is wrong; the message says what would be right."""


class NoScaleError(InputError):
    """Nothing tells how heavy the frame is; accelerations under base motion need not know."""


class InfeasibleError(InputError):
    """The declared constraints contradict each other; the message names a smallest set that does."""


class UnsuitableError(InputError):
    """The chosen method or backend cannot use these data; the message names one that can."""


class NoModesError(CvxshearError, ArithmeticError):
    """A model has no modes: a mass is not positive, or the frame would buckle."""


class FaultyEffectError(NoModesError):
    """An effect made a mass or stiffness matrix that is not finite; the message names the effect and its place."""


class LostProcessError(CvxshearError, RuntimeError):
    """A process that worked for this one was ended from outside; the same call may well succeed again."""


class NoSolutionError(CvxshearError, RuntimeError):
    """A backend found no solution, or one whose certificate is not good enough.

    Parameters
    ----------
    backend : str
        Registered name of the backend.
    reason : str
        What the backend said, or which residual of the certificate is too large.
    """

    def __init__(self, backend: str, reason: str) -> None:
        super().__init__(f"backend {backend}: {reason}")
        self.backend = backend
        self.reason = reason

    def __reduce__(self) -> tuple[type[NoSolutionError], tuple[str, str]]:
        """Errors come back from other processes, where they are made again from both words."""
        return type(self), (self.backend, self.reason)


def optional(module: str, needs: str) -> Any:
    """Import a module of an optional package.

    Parameters
    ----------
    module : str
    needs : str
        What needs it, as the message begins: "workbooks need".

    Raises
    ------
    InputError
        Saying what to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"{needs} {error.name}: pip install {error.name}") from None
