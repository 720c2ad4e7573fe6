"""Alternative mode numbers of a configuration (`other_modes`), and modes that were measured twice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.declaration import InTable
from cvxshear.util import checks
from cvxshear.util.checks import MOST_STORIES
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints


@dataclass(frozen=True, eq=False)
class OtherModes(InTable):
    """Alternative mode numbers of a configuration, with their probability.

    Parameters
    ----------
    modes : array_like of int, shape (m,)
        In place of the configuration's own, ascending.
    probability : float
        That these are right, before anything is fitted.
    """

    modes: Ints
    probability: float

    @staticmethod
    def of(declared: object, own: Ints, where: str) -> OtherModes:
        """Read one entry of `other_modes`, which must fit the configuration's own modes.

        Parameters
        ----------
        declared : OtherModes or dict
        own : ndarray of int, shape (m,)
        where : str
            The key, for messages.

        Raises
        ------
        InputError
        """
        if isinstance(declared, OtherModes):
            declared = declared.to_dict()
        table = checks.keys(declared, ["modes", "probability"], ["modes", "probability"], where)
        modes = checks.ascending_whole(table["modes"], f"{where}: modes", most=MOST_STORIES)
        if len(modes) != len(own):
            needed = f"{checks.entries(len(own))}, one a frequency"
            raise InputError(f"{where}: modes must have {needed}, not {len(modes)}")
        if np.array_equal(modes, own):
            raise InputError(f"{where}: modes are those of the configuration itself; leave the entry out")
        probability = checks.number(table["probability"], f"{where}: probability", above=0.0)
        if probability >= 1.0:
            raise InputError(f"{where}: probability = {probability:g} must be below 1; give these as modes")
        return OtherModes(modes, probability)


def other_modes(declared: object, own: Ints, where: str) -> tuple[OtherModes, ...]:
    """Read the entries of `other_modes`; the sum of their probabilities must be less than 1.

    Raises
    ------
    InputError
    """
    if not isinstance(declared, list | tuple) or not all(isinstance(item, Mapping | OtherModes) for item in declared):
        needed = "a list of tables, each with modes and probability"
        raise InputError(f"{where} must be {needed}, not {checks.shown(declared)}")
    found = tuple(OtherModes.of(item, own, f"{where}, entry {place}") for place, item in enumerate(declared, 1))
    if len({tuple(item.modes.tolist()) for item in found}) < len(found):
        raise InputError(f"{where} has the same modes twice")
    total = sum(item.probability for item in found)
    if total >= 1.0:
        raise InputError(f"{where}: the probabilities add up to {total:g}; leave something to the modes given")
    return found


SAME_SHAPE = 1e-12
"""Two shapes are equal if the squared sine of the angle between them is smaller than this."""

ENTRIES_OF_A_COPY = 3
"""Equal entries that make a row a copy of another: where floors are missing two modes may share one or two."""


def copied_rows(shapes: Floats) -> tuple[int, int] | None:
    """Find the first two rows that have the same numbers, at least two, in the same places.

    Parameters
    ----------
    shapes : ndarray, shape (m, n)
        nan where not measured.

    Returns
    -------
    tuple of (int, int) or None
    """
    seen: dict[bytes, int] = {}
    for row, shape in enumerate(shapes):
        if np.isfinite(shape).sum() >= ENTRIES_OF_A_COPY and (before := seen.setdefault(shape.tobytes(), row)) != row:
            return before, row
    return None


def proportional_rows(shapes: Floats) -> tuple[int, int] | None:
    """Find the first two rows that were measured everywhere and are proportional to each other.

    Parameters
    ----------
    shapes : ndarray, shape (m, n)
        nan where not measured.

    Returns
    -------
    tuple of (int, int) or None
    """
    places = np.flatnonzero(np.isfinite(shapes).all(axis=1))
    if len(places) < 2:
        return None
    whole = shapes[places]
    # Scaled by the largest entry first, so that no square overflows or vanishes.
    whole = whole / np.max(np.abs(whole), axis=1, keepdims=True)
    whole = whole / np.linalg.norm(whole, axis=1, keepdims=True)
    later, earlier = np.nonzero(np.tril((whole @ whole.T) ** 2 >= 1 - SAME_SHAPE, -1))
    return (int(places[earlier[0]]), int(places[later[0]])) if later.size else None
