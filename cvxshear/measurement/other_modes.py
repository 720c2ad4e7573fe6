"""Which other modes of the frame the measured ones may be: `other_modes` of a configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cvxshear.util import checks
from cvxshear.util.checks import MOST_STORIES
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Ints, Json


@dataclass(frozen=True, eq=False)
class OtherModes:
    """Another reading of which modes of the frame a configuration holds.

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
        """One entry of `other_modes`, once it fits the configuration's own modes.

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

    def to_dict(self) -> Json:
        """The table that declares it."""
        return {"modes": self.modes.tolist(), "probability": self.probability}


def other_modes(declared: object, own: Ints, where: str) -> tuple[OtherModes, ...]:
    """The entries of `other_modes`, whose probabilities leave room for the configuration's own modes.

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
