"""The options --csv and --xlsx: results as tables for a spreadsheet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from cvxshear.cli.output import among_files

if TYPE_CHECKING:
    from cvxshear.report.sheets import Sheet

CsvOut = Annotated[
    str | None,
    typer.Option("--csv", help="Write the result's main table here.", metavar="OUT", callback=among_files(".csv")),
]
XlsxOut = Annotated[
    str | None,
    typer.Option(
        "--xlsx", help="Write the result's tables as a workbook here.", metavar="OUT", callback=among_files(".xlsx")
    ),
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
            from cvxshear.report.sheets import load_openpyxl

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
        from cvxshear.report.sheets import write_csv, write_xlsx

        (write_xlsx if workbook else write_csv)(path, sheets())
