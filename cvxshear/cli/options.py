"""Define the options of the commands in groups, and check the named files before a command runs."""

from __future__ import annotations

import copy
import inspect
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import partial, wraps
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from cvxshear.cli.output import as_typed, deliver, doubts_of, show, used
from cvxshear.report import terminal
from cvxshear.report.blocks import describe
from cvxshear.util.errors import InputError
from cvxshear.util.writing import check_output, same_file, write_file

if TYPE_CHECKING:
    from rich.console import RenderableType

    from cvxshear.report.figures import FigureEntry
    from cvxshear.screening import FileFinding
    from cvxshear.util.typing import Json

#: Writes one file of a result that is known.
Writer = Callable[[], None]

#: Keys of a command's context for its written and read files; options are checked in the typed order.
WRITTEN, READ = f"{__name__}.written", f"{__name__}.read"


def claim(context: typer.Context, name: str, path: str, endings: Sequence[str]) -> None:
    """Register an output file after a check that the file can be written and has no second use in the command.

    Parameters
    ----------
    context : typer.Context
    name : str
        Option that names the file.
    path : str
    endings : sequence of str
        Allowed endings.

    Raises
    ------
    InputError
        If the file cannot be written or has a second use; the message names the option.
    """
    try:
        check_output(path, endings=endings)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    written = context.meta.setdefault(WRITTEN, [])
    for other, place in written:
        if same_file(path, place):
            raise InputError(f"{name} and {other} name the same file, {path}")
    written.append((name, path))
    _refuse_overlap(written, context.meta.get(READ, ()))


def input_files(context: typer.Context, files: Any) -> Any:
    """Register the input files of a command, and refuse to overwrite them."""
    if files is None or context.resilient_parsing:
        return files
    from cvxshear.io.toml import files_of

    for file in [files] if isinstance(files, str) else files:
        used.append(file)
        # The command itself reports a missing file, a device or a pipe.
        context.meta[READ] = (*context.meta.get(READ, ()), *(files_of(file) if os.path.isfile(file) else ()))
    _refuse_overlap(context.meta.get(WRITTEN, ()), context.meta.get(READ, ()))
    return files


def _refuse_overlap(written: Iterable[tuple[str, str]], read: Iterable[os.PathLike[str]]) -> None:
    for source in read:
        for option, path in written:
            if same_file(path, source):
                raise InputError(f"{option}: {path} would be written over {source}, which is read; name another file")


#: Pattern of a parameter in a docstring: its name, the names of the option and its value, and its description.
PARAMETER = re.compile(r"^(\w+)(?: :(?: (--\S+))?(?: (\S+))?)?\n((?: {4}.*\n?)+)", re.MULTILINE)


def documented(command: Callable[..., None]) -> Callable[..., None]:
    """Make a command of a function: groups of options become single options, with their help from the docstrings.

    A group is a dataclass. The numpydoc parameters of the command and of its groups are the help of the options. The
    name of a parameter may be followed by a different name of the option, and by the name of its value in the help:
    "goal : --for" or "modes : --from FILE". A flag with the default false has no option that turns the flag off.

    Parameters
    ----------
    command : callable
        Function of the command. Its docstring keeps the part before the parameters, which is the help of the command.
    """
    given = inspect.signature(command, eval_str=True).parameters
    groups: dict[str, Any] = {name: each.annotation for name, each in given.items() if is_dataclass(each.annotation)}
    parameters, listed = [], []
    for name, parameter in given.items():
        if name not in groups:
            parameters.append(parameter)
            continue
        hints = get_type_hints(groups[name], include_extras=True)
        parameters += [
            inspect.Parameter(
                each.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if each.default is MISSING else each.default,
                annotation=hints[each.name],
            )
            for each in fields(groups[name])
        ]
        listed.append((inspect.getdoc(groups[name]) or "").partition(HEADING)[2])
    text, _, own = (inspect.getdoc(command) or "").partition(HEADING)
    described = {found[0]: found[1:] for part in (*listed, own) for found in PARAMETER.findall(part)}
    parameters = [_with_help(each, *described[each.name]) if each.name in described else each for each in parameters]

    @wraps(command)
    def run(**options: Any) -> None:
        grouped = {
            name: group(**{each.name: options.pop(each.name) for each in fields(group)})
            for name, group in groups.items()
        }
        command(**options, **grouped)

    run.__doc__ = text
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what `inspect.signature` returns
    return run


#: Text between the summary of a docstring and its parameters.
HEADING = "\n\nParameters\n----------\n"


def _with_help(parameter: inspect.Parameter, called: str, value: str, text: str) -> inspect.Parameter:
    """Return a parameter whose option has this help; called and value name the option and its value if not empty."""
    declared = getattr(parameter.annotation, "__metadata__", ())
    if declared:
        kind, option = parameter.annotation.__origin__, copy.copy(declared[-1])
    else:
        flag = f"--{parameter.name.replace('_', '-')}" if parameter.default is False else ""
        kind, option = parameter.annotation, typer.Option(*filter(None, [called or flag]), metavar=value or None)
    option.help = " ".join(text.split())
    return parameter.replace(annotation=Annotated[kind, option])


File = Annotated[str, typer.Argument(metavar="FILE", callback=input_files)]
Files = Annotated[list[str], typer.Argument(metavar="FILE...", callback=input_files)]


def writes(*names: str, endings: Sequence[str], what: str = "", metavar: str = "OUT") -> Any:
    """Declare an option that names an output file with one of these endings, which is checked before the command."""

    def check(context: typer.Context, option: typer.CallbackParam, path: str | None) -> str | None:
        if path is not None and (path != "-" or ".json" not in endings) and not context.resilient_parsing:
            claim(context, option.opts[0], path, endings)
        return path

    return typer.Option(*names, help=what, metavar=metavar, callback=check)


FIGURES = (".svg", ".png", ".pdf")

JsonOut = Annotated[
    str | None,
    writes("--json", what="Write the result as JSON to this file, '-' for standard output.", endings=(".json",)),
]
ReportOut = Annotated[str | None, writes("--report", metavar="OUT.html", endings=(".html", ".htm"))]
TomlOut = Annotated[str | None, writes("--output", "-o", metavar="TOML", endings=(".toml",))]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")]
BackendName = Annotated[
    str, typer.Option("--backend", help="Which solver; 'cvxshear backends' lists them.", metavar="NAME")
]


#: Value of --figure that prints the available figures.
LIST = "list"


def _among_figures(context: typer.Context, option: typer.CallbackParam, asked: list[str] | None) -> list[str] | None:
    """Check every output file of a figure before the command runs."""
    for text in asked or ():
        if not context.resilient_parsing and text != LIST:
            claim(context, option.opts[0], _path(text), FIGURES)
    return asked


FiguresOut = Annotated[list[str] | None, typer.Option("--figure", metavar="[KIND:]OUT", callback=_among_figures)]
CsvOut = Annotated[str | None, writes("--csv", endings=(".csv",))]
XlsxOut = Annotated[str | None, writes("--xlsx", endings=(".xlsx",))]
SeriesOut = Annotated[str | None, writes("--out", endings=(".csv", ".mat", ".npz"))]


@dataclass(frozen=True)
class ResultOptions:
    """Options of commands that write the tables of their result, draw its figures and report it.

    Parameters
    ----------
    csv
        Write the result's main table here.
    xlsx
        Write the result's tables as a workbook here.
    figure
        Draw a figure into this file, .svg, .png or .pdf; which one by its kind, such as mac:OUT.svg. 'list' prints the
        kinds.
    report
        Write a report, one HTML file.
    """

    quiet: Quiet = False
    out: JsonOut = None
    csv: CsvOut = None
    xlsx: XlsxOut = None
    figure: FiguresOut = None
    report: ReportOut = None

    def check(self, result: type) -> None:
        """Check the requested files before the command runs; `--figure list` prints the figures and ends the command.

        Parameters
        ----------
        result : type
            Type of the results.

        Raises
        ------
        InputError
            If a kind of figure is unknown, or a package for a file is not installed.
        """
        if self.xlsx is not None:
            from cvxshear.io.spreadsheets import load_openpyxl

            load_openpyxl()
        if not self.figure:
            return
        if LIST in self.figure:
            from cvxshear.report.figures import figures_of

            title, head = "Figures: --figure KIND:OUT.svg, .png or .pdf", ("kind", "what it shows", "needs")
            rows = ((name, entry.title, entry.needs) for name, entry in figures_of(result).items())
            show([terminal.plain_table(title, *head, words=(0, 1, 2), rows=rows)])
            raise typer.Exit
        for text in self.figure:
            _figure(text, result)

    def deliver(
        self,
        result: Any,
        *files: Writer,
        doubts: Sequence[FileFinding] | None = None,
        said: Json | None = None,
        tables: Callable[[], Iterable[RenderableType]] | None = None,
        failed: Sequence[str] = (),
    ) -> None:
        """Write the requested files of a result and print it.

        Parameters
        ----------
        result : object
            A result, or a list of results of one type.
        *files : callable
            Each writes one more file.
        doubts : sequence of FileFinding, optional
            Warnings of the measurement; None if it was not screened.
        said : dict, optional
            JSON. Default: that of the result, with the doubts.
        tables : callable, optional
            Returns the tables for the terminal. Default: the doubts and the result.
        failed : sequence of str, optional
            Reasons why other results are missing in the report.
        """
        from cvxshear.screening import in_json

        several = isinstance(result, list)
        deliver(
            {**result.to_dict(), **in_json(doubts)} if said is None else said,
            self.out,
            tables or (lambda: [*doubts_of(doubts), *terminal.shown(result)]),
            *files,
            *self._writers(result if several else [result], failed),
            title=None if several else describe(result).title,
        )

    def _writers(self, results: Sequence[Any], failed: Sequence[str]) -> Iterator[Writer]:
        """Yield the functions that write figures, tables and the report of results."""
        from cvxshear.io.spreadsheets import write_csv, write_xlsx

        for text in self.figure or ():
            from cvxshear.report.figures import save

            yield partial(lambda text: save(_figure(text, type(results[0])).draw(*results), _path(text)), text)
        if (table := self.csv) is not None:
            yield lambda: write_csv(table, terminal.sheets_of(*results))
        if (book := self.xlsx) is not None:
            yield lambda: write_xlsx(book, terminal.sheets_of(*results))
        if (page := self.report) is not None:
            from cvxshear.report.html import render

            yield lambda: write_file(page, render(results, as_typed(), failed=failed))


def _path(text: str) -> str:
    """Return the path of a requested figure; a colon after one letter belongs to a Windows path."""
    kind, colon, path = text.partition(":")
    return path if colon and len(kind) > 1 else text


def _figure(text: str, result: type) -> FigureEntry:
    """Return the figure of a request."""
    from cvxshear.report.figures import style
    from cvxshear.util import checks

    with checks.named("--figure"):
        return style.figure_named(text[: -len(_path(text)) - 1], result)
