"""Which description a result has: one function a type."""

from __future__ import annotations

from functools import singledispatch

from cvxshear.report.describe.vocabulary import Document
from cvxshear.util.quantities import AUTOMATIC, Units


@singledispatch
def describe(result: object, units: Units = AUTOMATIC) -> Document:
    """The description of a result: its tables, sentences, and numbers with units.

    Parameters
    ----------
    result : object
    units : Units, optional
        In which quantities are shown; what fits their size where not given.

    Returns
    -------
    Document

    Raises
    ------
    TypeError
        Where nobody has said how a result of this type is described.
    """
    raise TypeError(f"a {type(result).__name__} has no description; register one with describe.register")


@singledispatch
def line(result: object) -> str:
    """A result in one short line, such as a prompt shows; by default its description's headline."""
    return f"<{type(result).__name__} {describe(result).headline}>"
