"""The exceptions that cvxshear raises, with printable messages.

Every exception derives from `CvxshearError`, so a caller can catch them all at once. `InputError` means that the
caller must change the input. `NoSolutionError` means that the input was valid and a solver failed.
"""

from __future__ import annotations

import importlib
from typing import Any


def printable(text: str) -> str:
    """Write a text in one line without terminal control: each unprintable character becomes its escape.

    These are control characters, line breaks, marks that change the writing direction, and lone surrogates.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode("ascii") for each in text)


class CvxshearError(Exception):
    """Base of every exception raised by cvxshear; its message passes through `printable`."""

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(str(message)))


class InputError(CvxshearError, ValueError):
    """A measurement, an option or a prior is wrong; the message states what is allowed."""


class NoScaleError(InputError):
    """The data do not fix the mass scale of the frame; accelerations under base motion do not need the scale."""


class InfeasibleError(InputError):
    """The declared constraints contradict each other; the message names a smallest contradictory set."""


class UnsuitableError(InputError):
    """The chosen method or backend cannot use these data; the message names one that can."""


class NoModesError(CvxshearError, ArithmeticError):
    """A model has no modes: a mass is not positive, or the frame would buckle."""


class FaultyEffectError(NoModesError):
    """An effect failed, or made a matrix that is not finite; the message names the effect and its place."""


class LostProcessError(CvxshearError, RuntimeError):
    """A worker process was killed from outside; the same call may succeed if repeated."""


class NoSolutionError(CvxshearError, RuntimeError):
    """A backend found no solution, or its solution failed the certificate.

    Parameters
    ----------
    backend : str
        Registered name of the backend.
    reason : str
        Message of the backend, or the residual of the certificate that is too large.
    """

    def __init__(self, backend: str, reason: str) -> None:
        super().__init__(f"backend {backend}: {reason}")
        self.backend = backend
        self.reason = reason

    def __reduce__(self) -> tuple[type[NoSolutionError], tuple[str, str]]:
        """Pickle the error by its two arguments, so that it can return from another process."""
        return type(self), (self.backend, self.reason)


def optional(module: str, needs: str) -> Any:
    """Import a module of an optional package.

    Parameters
    ----------
    module : str
    needs : str
        Beginning of the message, such as "workbooks need".

    Raises
    ------
    InputError
        If the package is not installed; the message names the package to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"{needs} {error.name}: pip install {error.name}") from None
