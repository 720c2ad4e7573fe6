"""The command line."""

import io
import os
import sys
from contextlib import suppress
from typing import Annotated, Any

import typer

from cvxshear.cli import commands, modes_and_check
from cvxshear.cli.options import documented
from cvxshear.cli.output import complain, present, typed, used
from cvxshear.util.errors import CvxshearError, LostProcessError, NoSolutionError

STATUSES = (
    "Exit status: 0 done, whatever the verdict; 1 no solution was found, or standard output could not be written; "
    "2 wrong input, or 'check' found a mistake; 3 'check --strict' and a doubt, or 'loop --strict' and a verdict other "
    "than adequate or explained; "
    "130 interrupted."
)

app = typer.Typer(
    name="cvxshear",
    help="Floor masses and story stiffnesses of shear-type frames from measured modes, and what the shear model lacks.",
    epilog=STATUSES,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
study = typer.Typer(help="Many identifications at once.", no_args_is_help=True)
for command in (
    commands.identify, commands.loop, commands.predict, commands.reconstruct, commands.history, modes_and_check.modes,
    modes_and_check.new, modes_and_check.check, commands.backends, commands.plan, commands.reproduce,
):  # fmt: skip
    app.command()(documented(command))
study.command()(documented(commands.noise))
app.add_typer(study, name="study")


def _show_version(asked: bool) -> None:
    if asked:
        from cvxshear import __version__

        typer.echo(f"cvxshear {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_show_version, is_eager=True)
    ] = False,
    verbose: Annotated[
        int, typer.Option("--verbose", "-v", count=True, help="Log what is done to standard error; twice: in detail.")
    ] = 0,
) -> None:
    if verbose:
        import logging

        level = logging.DEBUG if verbose > 1 else logging.INFO
        logging.basicConfig(stream=sys.stderr, level=level, format="%(name)s: %(message)s", force=True)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; exit with status 0 if done, 1 without a solution, 2 for bad input."""
    status: Any = 0
    used.clear()
    typed[:] = sys.argv[1:] if arguments is None else arguments
    try:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                # Characters outside the encoding of a terminal become escapes.
                stream.reconfigure(errors="backslashreplace")
        # The check comes first: numpy and matplotlib also read SOURCE_DATE_EPOCH at import.
        present()
        status = app(args=arguments, standalone_mode=False)
        sys.stdout.flush()
    except (NoSolutionError, LostProcessError) as error:
        complain(error)
        status = 1
    except CvxshearError as error:
        complain(error)
        status = 2
    except OSError as error:
        # Unreadable and unwritable files raise InputError; an OSError comes from printing. A program such as `head`
        # reads the first lines only and needs no error message.
        if not isinstance(error, BrokenPipeError):
            complain(f"standard output cannot be written: {error.strerror}")
        # Python flushes again at its end and would report the error a second time.
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 1
    except MemoryError:
        complain("the memory of this computer is not enough for it")
        status = 1
    except (typer.Abort, KeyboardInterrupt):
        status = 130
    except Exception as error:
        # Typer's errors about options have a method that prints them.
        if not hasattr(error, "show") or not hasattr(error, "exit_code"):
            raise
        error.show()
        status = error.exit_code
    sys.exit(status if isinstance(status, int) else 0)
