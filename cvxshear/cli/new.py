"""The command that begins a measurement file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from cvxshear.cli.output import writes
from cvxshear.cli.streams import printing
from cvxshear.util.errors import InputError
from cvxshear.util.writing import write_file


def new(
    output: Annotated[
        str | None,
        writes("--output", "-o", what="Write it here; printed where not given.", metavar="TOML", endings=(".toml",)),
    ] = None,
    stories: Annotated[int | None, typer.Option(help="How many stories the frame has; 3 where not given.")] = None,
    modes: Annotated[
        str | None,
        typer.Option("--from", help="Take the modes from this table (.csv, .xlsx) or universal file.", metavar="FILE"),
    ] = None,
) -> None:
    """Begin a measurement file: one with every key explained, to fill in.

    Example: cvxshear new --stories 5 -o test.toml
    """
    from cvxshear.files.template import template, template_from

    if modes is not None and stories is not None:
        raise InputError("give either --from, whose floors tell the stories, or --stories")
    if output is not None and Path(output).exists():
        raise InputError(f"{output} is there already; name a new file, or delete the old one first")
    folder = Path(output).parent if output is not None else Path()
    text = template_from(modes, folder) if modes is not None else template(3 if stories is None else stories)
    if output is None:
        with printing():
            sys.stdout.write(text)
    else:
        write_file(output, text)
