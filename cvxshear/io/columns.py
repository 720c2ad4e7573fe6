"""Tables of named columns, whatever file they came from, and the checks that name a column and a line."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

FEWEST_ROWS = 32
"""Fewest samples of a record."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of equal length.

    Parameters
    ----------
    source : str
        The file, for messages.
    names : tuple of str
    values : array, shape (rows, columns)
    lines : array of int, shape (rows,), optional
        The line of the file that each row stands on; None for a binary file.
    units : tuple of str, optional
        Unit of each column, from a line of units; empty without such a line.
    stated_rate : tuple of (str, float), optional
        A lone number of the file that gives the sampling rate: its name, and the rate in Hz.
    """

    source: str
    names: tuple[str, ...]
    values: Floats
    lines: Ints | None = None
    units: tuple[str, ...] = ()
    stated_rate: tuple[str, float] | None = None

    def __post_init__(self) -> None:
        if len(self.values) < FEWEST_ROWS:
            raise InputError(f"{self.source} holds {len(self.values)} samples; at least {FEWEST_ROWS} are needed")
        seen: set[str] = set()
        for name in self.names:
            if name in seen:
                raise InputError(f'{self.source} has two columns named "{name}"')
            seen.add(name)

    def at(self, row: int) -> str:
        """Name the place of a row for a message: its line or its sample."""
        if self.lines is None:
            return f"{self.source}, sample {row + 1}"
        return f"{self.source}, line {int(self.lines[row])}"

    def rows(self, which: slice) -> Columns:
        """Keep some of the rows."""
        lines = None if self.lines is None else self.lines[which]
        return replace(self, values=self.values[which], lines=lines)

    def check(self, name: str, asked: str) -> None:
        """Raise `InputError` if there is no such column; `asked` names the user of the column."""
        if name not in self.names:
            shown = ", ".join(each[:60] for each in self.names[:12]) + (", ..." if len(self.names) > 12 else "")
            raise InputError(f'{asked}: {self.source} has no column "{name[:60]}"; it has {shown}')

    def column(self, name: str, asked: str) -> Floats:
        """Return the values of a column after a check that they are finite, shape (rows,).

        Parameters
        ----------
        name : str
        asked : str
            The user of the column, for messages.
        """
        self.check(name, asked)
        values = self.values[:, self.names.index(name)]
        bad = np.flatnonzero(~(np.abs(values) <= checks.LARGEST))
        if bad.size:
            raise InputError(
                f'{self.at(int(bad[0]))}: channel "{name}" holds {values[bad[0]]} ({bad.size} such values in '
                "all); mend the record or cut it before that line"
            )
        return checks.frozen(values.copy())
