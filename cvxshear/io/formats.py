"""How files that a user names are opened, and the table of formats: the endings of each kind of file and its readers.

A format of one's own is one more line of the table: `register(Format(...))`. Record files and `cvxshear new` then
accept the format, and its name is a key of measurement files.
"""

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from cvxshear.util.errors import CvxshearError, InputError, printable
from cvxshear.util.quantities import listed

logger = logging.getLogger(__name__)

MEGABYTE = 1_000_000

#: Largest size of a file without samples, bytes. A larger file is refused as a mistake, such as a record.
LARGEST_FILE = 5_000_000
#: Default limit on the size of a record's file, bytes.
LIMIT = 100_000_000
TOO_LARGE = "cut it into runs, or raise the limit by size_limit, in MB, in the table [record]"


def read_bytes(path: Path, largest: float, remedy: str, *, absent: str = "") -> bytes:
    """Read the content of a file.

    Parameters
    ----------
    path : Path
    largest : float
        Bytes.
    remedy : str
        End of the message about a larger file.
    absent : str, optional
        Addition to the message if the file does not exist.

    Raises
    ------
    InputError
        If the file cannot be read or is larger, or is a device or a pipe, which can be read once only.
    """
    where = str(path)
    try:
        if path.exists() and not path.is_file():
            kind = "folder; name a file in it" if path.is_dir() else "device or a pipe; save what it gives in a file"
            raise InputError(f"{where} is a {kind}")
        with path.open("rb") as file:
            content = file.read(int(largest) + 1)
    except FileNotFoundError:
        raise InputError(f"{where}: no such file{absent and f' ({absent})'}") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{where} cannot be read: {getattr(error, 'strerror', error)}") from None
    if len(content) > largest:
        raise InputError(f"{where} has more than {largest / MEGABYTE:g} MB; {remedy}")
    logger.info("read %s, %d bytes", printable(where), len(content))
    return content


@contextmanager
def reading(path: object, words: str) -> Iterator[None]:
    """Convert an exception of a reader, whatever a damaged file makes it run into, to an error that names the file.

    Parameters
    ----------
    path : str or Path
    words : str
        Name of such a file in messages: "a workbook".
    """
    try:
        yield
    except CvxshearError:
        raise
    except Exception as error:
        raise InputError(f"{path} cannot be read as {words}: {str(error)[:200] or type(error).__name__}") from error


def named_after(path: str | Path) -> str:
    """Return the name of a file without its ending; bytes that are not text are replaced by a mark."""
    stem = os.fsencode(Path(path).stem).decode("utf-8", "replace")
    return stem if stem.strip() else "unnamed"


ColumnReader = Callable[[Path, float], Any]
ModeReader = Callable[[str | Path], dict[str, Any]]

#: Endings that do not identify the kind of a text.
ANY_TEXT = (".txt", ".dat", ".asc")


@dataclass(frozen=True)
class Format:
    """One kind of file.

    Parameters
    ----------
    name : str
        Name of the format; for a format of modes, the key of a [[configuration]] that names such a file.
    endings : tuple of str
        In small letters, with the dot; the first is the usual one.
    words : str
        Name of such a file in messages: "a workbook".
    columns : callable or str, optional
        (path, limit in bytes) to `Columns`: the reader of time histories and frequency response functions. A
        reader that loads slowly is named, "module:function".
    modes : callable or str, optional
        (path) to the keys of a table [[configuration]]: the reader of modes.
    """

    name: str
    endings: tuple[str, ...]
    words: str
    columns: ColumnReader | str | None = None
    modes: ModeReader | str | None = None

    def read_columns(self, path: Path, limit: float) -> Any:
        """Read the `Columns` of such a file."""
        return self._read(self.columns, path, limit)

    def read_modes(self, path: str | Path) -> dict[str, Any]:
        """Read the keys of a table [[configuration]] that such a file holds."""
        return cast("dict[str, Any]", self._read(self.modes, path))

    def _read(self, reader: Callable[..., object] | str | None, *given: object) -> object:
        """Call a reader, in a module that is imported now or in the hands of a user."""
        assert reader is not None
        if isinstance(reader, str):
            module, _, name = reader.partition(":")
            reader = cast("Callable[..., object]", getattr(import_module(module), name))
        with reading(given[0], self.words):
            return reader(*given)


HERE = "cvxshear.io"

#: Every kind of file that is read, in the order in which messages and help list them.
FORMATS: list[Format] = [
    Format("csv", (".csv", ".txt", ".dat", ".tsv", ".asc"), "delimited text", f"{HERE}.csv:read_csv",
           f"{HERE}.spreadsheets:read_mode_csv"),
    Format("gz", (".csv.gz", ".txt.gz", ".tsv.gz"), "delimited text compressed by gzip", f"{HERE}.csv:read_csv"),
    Format("xlsx", (".xlsx",), "a workbook", f"{HERE}.spreadsheets:read_xlsx", f"{HERE}.spreadsheets:read_mode_xlsx"),
    Format("mat", (".mat",), "a MAT file", f"{HERE}.arrays:read_mat"),
    Format("npz", (".npz", ".npy"), "arrays of NumPy", f"{HERE}.arrays:read_npz"),
    Format("uff", (".uff", ".unv", ".u58", ".u55"), "a universal file", f"{HERE}.arrays:read_uff",
           f"{HERE}.arrays:read_mode_uff"),
]  # fmt: skip


def register(added: Format) -> None:
    """Add a format; one of the same name is replaced.

    Raises
    ------
    InputError
        If an ending belongs to another format.
    """
    for other in FORMATS:
        shared = set(other.endings) & set(added.endings)
        if shared and other.name != added.name:
            raise InputError(f"the ending {min(shared)} is that of {other.words} already")
    FORMATS[:] = [each for each in FORMATS if each.name != added.name] + [added]


def format_of(path: str | Path) -> Format | None:
    """Find the format of a file by its ending; None for an unknown ending."""
    name = Path(path).name.lower()
    return next((each for each in FORMATS if any(name.endswith(ending) for ending in each.endings)), None)


def endings_of(reader: str) -> str:
    """List the usual endings of the formats that have a reader, for messages and help: ".csv, .xlsx or .uff".

    Parameters
    ----------
    reader : str
        "columns" or "modes".
    """
    return listed([each.endings[0] for each in FORMATS if getattr(each, reader) is not None], "or")


def read_columns(path: Path, limit: float) -> Any:
    """Read the `Columns` of a file of samples; a file with an unknown ending is read as delimited text.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    found = format_of(path)
    return (FORMATS[0] if found is None or found.columns is None else found).read_columns(path, limit)


def read_modes_of(path: str | Path) -> tuple[str, dict[str, Any]]:
    """Read a file of modes: the key that names such a file, and the keys of a table [[configuration]] that it holds.

    Raises
    ------
    InputError
        If such files hold no modes, or this file cannot be read.
    """
    found = format_of(path)
    if found is None or found.modes is None:
        raise InputError(f"{path!s}: modes are read from files that end in {endings_of('modes')}")
    return found.name, found.read_modes(path)


def refuse_data(path: Path, *, toml: bool = True) -> None:
    """Refuse a file of samples where a record file is needed.

    Parameters
    ----------
    path : Path
    toml : bool, optional
        Whether the file may be TOML; a .txt file may be TOML as well.

    Raises
    ------
    InputError
        The message says how to begin a record file.
    """
    found = format_of(path)
    if found is not None and found.columns is not None and not (toml and path.suffix.lower() in ANY_TEXT):
        raise InputError(
            f"{path} is {found.words}, which does not say which column is which floor: 'cvxshear new --record {path} "
            f"-o {path.name.split('.')[0]}.toml' writes a record file with the columns that it finds, to fill in (of a "
            "table of modes, 'cvxshear new --from' a measurement file), and that is what the command takes"
        )
