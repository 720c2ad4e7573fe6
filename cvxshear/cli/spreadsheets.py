"""The options --csv and --xlsx: results as tables for a spreadsheet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated

from cvxshear.cli.output import writes

if TYPE_CHECKING:
    from cvxshear.files.spreadsheets import Sheet

CsvOut = Annotated[str | None, writes("--csv", what="Write the result's main table here.", endings=(".csv",))]
XlsxOut = Annotated[
    str | None, writes("--xlsx", what="Write the result's tables as a workbook here.", endings=(".xlsx",))
]


class Spreadsheets:
    """The tables that were asked for, checked before anything runs and written once there is a result.

    Parameters
    ----------
    csv, xlsx : str, optional
        The files to write.

    Raises
    ------
    InputError
        Where a workbook is asked for and openpyxl is not installed.
    """

    def __init__(self, csv: str | None, xlsx: str | None) -> None:
        self._csv, self._xlsx = csv, xlsx
        if xlsx is not None:
            from cvxshear.files.spreadsheets import load_openpyxl

            load_openpyxl()

    def of(self, sheets: Callable[[], Sequence[Sheet]]) -> list[Callable[[], None]]:
        """What makes the tables and writes each file."""
        return [
            partial(self._write, path, sheets, workbook=workbook)
            for path, workbook in ((self._csv, False), (self._xlsx, True))
            if path is not None
        ]

    @staticmethod
    def _write(path: str, sheets: Callable[[], Sequence[Sheet]], *, workbook: bool) -> None:
        from cvxshear.files.spreadsheets import write_csv, write_xlsx

        (write_xlsx if workbook else write_csv)(path, sheets())
