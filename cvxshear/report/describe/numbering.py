"""Which modes of the frame the measured ones are, where that was in question."""

from __future__ import annotations

from collections.abc import Iterator

from cvxshear.loop import Closure
from cvxshear.loop.numbering import Changes
from cvxshear.report.describe.vocabulary import Row, Section, Table
from cvxshear.util.quantities import chance, listed

DOUBT = 0.05
"""Probability of other numbers above which a reader is told of them in a sentence."""


def numbers_in_words(changes: Changes) -> str:
    """Such as 'the modes of "ambient" are 1, 2 and 4 of the frame'.

    Parameters
    ----------
    changes : tuple of (str, tuple of int)
    """
    names: dict[tuple[int, ...], list[str]] = {}
    for name, modes in changes:
        names.setdefault(modes, []).append(f'"{name}"')
    said = [f"the modes of {listed(who)} are {listed([str(mode) for mode in modes])}" for modes, who in names.items()]
    return f"{listed(said)} of the frame"


def in_doubt(of: Closure) -> bool:
    """Whether other numbers of the modes are more than hardly probable."""
    return len(of.numberings) > 1 and of.numberings[1].probability > DOUBT


def other_numbers(of: Closure) -> str:
    """The second most probable numbering in words."""
    other = of.numberings[1]
    return numbers_in_words(other.changes) if other.changes else "the modes are those given"


def numbering_sections(of: Closure) -> Iterator[Section]:
    """A table of the numberings that were weighed; nothing where the numbers were not in question."""
    if len(of.numberings) == 1 and not of.numberings[0].changes:
        return
    rows = tuple(
        Row(
            (numbers_in_words(item.changes) if item.changes else "the modes are those given", chance(item.probability)),
            exact=(item.probability,),
        )
        for item in of.numberings
    )
    table = Table("numberings", "Which modes of the frame were measured", ("numbering", "probability"), rows)
    yield Section("numbering", "Which modes these are", (table,))
