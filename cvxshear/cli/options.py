"""Define the options of the commands, and check the named files against each other before a command runs."""

import copy
import inspect
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from cvxshear.util.errors import InputError
from cvxshear.util.writing import check_output, same_file

OTHERS_ENDINGS = (".toml", ".csv", ".xlsx", ".mat", ".uff", ".html", ".htm", ".svg", ".png", ".pdf")
"""Forbidden endings of a JSON file: a typing error must not replace a file of another kind."""


used: list[str] = []
"""Names of the files that the running command reads, as typed; the written results list these names."""

WRITTEN, READ = f"{__name__}.written", f"{__name__}.read"
"""Keys of a command's context for its written and read files; options are checked in the typed order."""


def output_file(*endings: str) -> Callable[[typer.Context, typer.CallbackParam, str | None], str | None]:
    """Make the check of an option that names an output file; the check runs before the command.

    Parameters
    ----------
    *endings : str
        Allowed endings. Without endings, the file is JSON and may have any ending outside `OTHERS_ENDINGS`.
    """

    def check(context: typer.Context, option: typer.CallbackParam, path: str | None) -> str | None:
        if path is not None and path != "-" and not context.resilient_parsing:
            claim(context, option.opts[0], path, endings)
        return path

    return check


def claim(context: typer.Context, name: str, path: str, endings: Sequence[str]) -> None:
    """Register an output file after a check that the file can be written and has no second use in the command.

    Parameters
    ----------
    context : typer.Context
    name : str
        Option that names the file.
    path : str
    endings : sequence of str
        As for `output_file`.

    Raises
    ------
    InputError
        If the file cannot be written or has a second use; the message names the option.
    """
    try:
        check_output(path, endings=endings)
        if not endings and Path(path).suffix.lower() in OTHERS_ENDINGS:
            raise InputError(f"{path} has the ending of another kind of file; JSON is written to a .json")
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
        # A pipe can be read only once, and the command itself reports a missing file. Both are skipped here.
        context.meta[READ] = (*context.meta.get(READ, ()), *(files_of(file) if Path(file).is_file() else ()))
    _refuse_overlap(context.meta.get(WRITTEN, ()), context.meta.get(READ, ()))
    return files


def _refuse_overlap(written: Iterable[tuple[str, str]], read: Iterable[Path]) -> None:
    for source in read:
        for option, path in written:
            if same_file(path, source):
                raise InputError(f"{option}: {path} would be written over {source}, which is read; name another file")


PARAMETER = re.compile(r"^(\w+)(?: :(?: (--\S+))?(?: (\S+))?)?\n((?: {4}.*\n?)+)", re.MULTILINE)
"""Pattern of a parameter in a docstring: its name, the names of the option and its value, and its description."""


def documented(command: Callable[..., None]) -> Callable[..., None]:
    """Take the help of a command's options from the numpydoc parameters of its docstring.

    The name of a parameter may be followed by a different name of the option, and by the name of its value in the help:
    "goal : --for" or "modes : --from FILE". A flag with the default false has no option that turns the flag off.

    Parameters
    ----------
    command : callable
        Function of the command. Its docstring keeps the part before the parameters, which is the help of the command.
    """
    command.__doc__, _, listed = (inspect.getdoc(command) or "").partition("\n\nParameters\n----------\n")
    hints, types = get_type_hints(command, include_extras=True), get_type_hints(command)
    for name, called, value, text in PARAMETER.findall(listed):
        *_, option = getattr(hints[name], "__metadata__", [None])
        if option is None:
            flag = f"--{name.replace('_', '-')}" if inspect.signature(command).parameters[name].default is False else ""
            option = typer.Option(*filter(None, [called or flag]), metavar=value or None)
        option = copy.copy(option)
        option.help = " ".join(text.split())
        command.__annotations__[name] = Annotated[types[name], option]
    return command


File = Annotated[str, typer.Argument(metavar="FILE", callback=input_files)]
Files = Annotated[list[str], typer.Argument(metavar="FILE...", callback=input_files)]


def writes(*names: str, what: str = "", metavar: str = "OUT", endings: Iterable[str] = ()) -> Any:
    """Declare an option that names an output file."""
    return typer.Option(*names, help=what, metavar=metavar, callback=output_file(*endings))


FIGURES = (".svg", ".png", ".pdf")

JsonOut = Annotated[
    str | None, writes("--json", what="Write the result as JSON to this file, '-' for standard output.")
]
FigureOut = Annotated[str | None, writes("--figure", what="Draw into this file: .svg, .png or .pdf.", endings=FIGURES)]
ReportOut = Annotated[
    str | None, writes("--report", what="Write a report, one HTML file.", metavar="OUT.html", endings=(".html", ".htm"))
]
TomlOut = Annotated[str | None, writes("--output", "-o", metavar="TOML", endings=(".toml",))]
UnitsOption = Annotated[
    str | None,
    typer.Option("--units", help="Units that quantities are shown in, such as t,kN,mm.", metavar="MASS,FORCE,LENGTH"),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")]
BackendName = Annotated[
    str, typer.Option("--backend", help="Which solver; 'cvxshear backends' lists them.", metavar="NAME")
]
