"""Options of the commands, and the files that they name, checked against each other before a command runs."""

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
"""What a file of JSON must not be called, lest a slip of the keyboard replace something else."""


used: list[str] = []
"""The files that the running command reads, as they were named; what it writes says which they were."""

WRITTEN, READ = f"{__name__}.written", f"{__name__}.read"
"""Keys of a command's context for the files it writes and reads; options are checked in the order they were typed."""


def output_file(*endings: str) -> Callable[[typer.Context, typer.CallbackParam, str | None], str | None]:
    """Make the check of an option that names a file to write; it runs before the command does.

    Parameters
    ----------
    *endings : str
        Those that such a file has; where none is named, it is JSON, which goes by any name but another kind's.
    """

    def check(context: typer.Context, option: typer.CallbackParam, path: str | None) -> str | None:
        if path is not None and path != "-" and not context.resilient_parsing:
            claim(context, option.opts[0], path, endings)
        return path

    return check


def claim(context: typer.Context, name: str, path: str, endings: Sequence[str]) -> None:
    """Note a file that a command is to write, once it can be, and refuse one that it reads or writes besides.

    Parameters
    ----------
    context : typer.Context
    name : str
        The option that names it.
    path : str
    endings : sequence of str
        As for `output_file`.

    Raises
    ------
    InputError
        Naming the option.
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
    """Note what a command reads, one file or several, and refuse to write over it."""
    if files is None or context.resilient_parsing:
        return files
    from cvxshear.io.toml import files_of

    for file in [files] if isinstance(files, str) else files:
        used.append(file)
        # What a pipe holds can be read once; a file that is not there is for the command to complain of.
        context.meta[READ] = (*context.meta.get(READ, ()), *(files_of(file) if Path(file).is_file() else ()))
    _refuse_overlap(context.meta.get(WRITTEN, ()), context.meta.get(READ, ()))
    return files


def _refuse_overlap(written: Iterable[tuple[str, str]], read: Iterable[Path]) -> None:
    for source in read:
        for option, path in written:
            if same_file(path, source):
                raise InputError(f"{option}: {path} would be written over {source}, which is read; name another file")


PARAMETER = re.compile(r"^(\w+)(?: :(?: (--\S+))?(?: (\S+))?)?\n((?: {4}.*\n?)+)", re.MULTILINE)
"""A parameter in a docstring: its name, what the option and its value are called, and its description."""


def documented(command: Callable[..., None]) -> Callable[..., None]:
    """Take the help of a command's options from its docstring, which lists them as numpydoc does.

    Behind the name of a parameter may stand the name of the option, where it is another one, and what stands for its
    value in the help: "goal : --for" or "modes : --from FILE". A flag that is off has no name that leaves it off.

    Parameters
    ----------
    command : callable
        Keeps the part of its docstring before the parameters, which is the help of the command itself.
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
    """Declare an option that names a file to write."""
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
