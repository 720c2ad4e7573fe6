"""Check values that come from outside; each error message states what is allowed.

Every function takes a value and the name of its place, as the message shows it. The function returns the value in
the type that the library works with, or raises `InputError`.
"""

import datetime
import difflib
import math
import reprlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats, Ints

Scalar = TypeVar("Scalar", bound=np.generic)

#: Largest number of stories. A larger number is refused as a mistake: its matrices would fill the memory.
MOST_STORIES = 2000

#: Largest size of a quantity in SI units. Every structure stays below this size, and its square does not overflow.
LARGEST = 1e30

#: Smallest positive quantity in SI units. Every structure stays above it, and its square does not underflow.
SMALLEST = 1e-30

#: Relative step of a central difference: its curvature and its rounding are both far below `DERIVATIVE_ERROR`.
DIFFERENCE_STEP = 1e-5

#: Largest relative difference of a derivative along a direction from its difference quotient. Correct derivatives agree
#: to about 1e-7; one wrong column by a factor of two among a thousand gives 1e-2.
DERIVATIVE_ERROR = 1e-3

_short = reprlib.Repr()
_short.maxlevel, _short.maxlist, _short.maxtuple, _short.maxdict = 3, 6, 6, 3
_short.maxstring = _short.maxlong = _short.maxother = 60


def shown(value: object) -> str:
    """Return `value` as an error message shows it: its repr, cut to a readable length."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    try:
        text = _short.repr(value)
    except ValueError:
        # Python refuses to print whole numbers of more than a few thousand digits.
        text = "a number too long to print"
    return text if len(text) <= 60 else text[:57] + "..."


@contextmanager
def named(where: str) -> Iterator[None]:
    """Put the place before the message of each `InputError` raised inside that does not begin with it."""
    try:
        yield
    except InputError as error:
        if str(error).startswith(where):
            raise
        raise type(error)(f"{where}: {error}") from error


def put(target: object, name: str, check: Callable[..., object], where: str, **limits: object) -> None:
    """Check a field of a frozen dataclass and store the checked value; a default of None stays.

    Parameters
    ----------
    target : dataclass
    name : str
        Name of the field.
    check : callable
        One of the functions below.
    where : str
    **limits
        Options of the check.
    """
    value = getattr(target, name)
    if value is not None or getattr(type(target), name, ...) is not None:
        object.__setattr__(target, name, check(value, where, **limits))


def keys(
    table: object,
    known: Collection[str],
    required: Collection[str],
    where: str,
    *,
    elsewhere: Mapping[str, str] | None = None,
) -> Mapping[str, Any]:
    """Return the table after a check that each key is known and no required key is missing.

    `elsewhere` maps keys of other tables to the names of these tables: a key below the wrong header is the most
    common slip in TOML.
    """
    if not isinstance(table, Mapping):
        raise InputError(f"{where} must be a table of keys and values, not {shown(table)}")
    for key in table:
        if key not in known:
            raise InputError(f"{where}: unknown key {shown(key)}; {_hint(key, known, elsewhere or {})}")
    for key in required:
        if key not in table:
            raise InputError(f"{where}: the key {key!r} is missing")
    return table


def tables(declared: Mapping[str, object], key: str) -> list[tuple[int, object]]:
    """Return the tables below the headers `[[key]]`, each with its number, which starts at 1."""
    value = declared.get(key)
    if value is None:
        return []
    if isinstance(value, Mapping):
        raise InputError(f"[{key}] must be a list of tables: write [[{key}]], in double brackets")
    if not isinstance(value, list | tuple):
        raise InputError(f"{key} must be a list of tables, each below [[{key}]], not {shown(value)}")
    return list(enumerate(value, 1))


def _hint(key: object, known: Collection[str], elsewhere: Mapping[str, str]) -> str:
    """Suggest a correction for an unknown key."""
    if isinstance(key, str) and key in elsewhere:
        return f"it belongs in {elsewhere[key]}"
    return near(key, known, 0.5).removeprefix("; ") or f"known keys are {', '.join(sorted(known))}"


def near(word: object, known: Iterable[str], cutoff: float = 0.6) -> str:
    """Suggest the nearest known name, as the end of a message; empty if no name is near."""
    found = difflib.get_close_matches(str(word)[:60].lower(), list(known), n=1, cutoff=cutoff)
    return f"; did you mean {found[0]!r}?" if found else ""


def number(value: object, where: str, *, above: float = -math.inf, least: float = -math.inf) -> float:
    """Check a finite number, greater than `above` and not less than `least`."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        # A masked number becomes None.
        value = value.tolist()
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        raise InputError(f"{where} must be a number, not {shown(value)}")
    try:
        result = float(value)
    except OverflowError:
        result = LARGEST * 10 if value > 0 else -LARGEST * 10
    if not math.isfinite(result):
        raise InputError(f"{where} must be a finite number, not {shown(value)}")
    if result <= above:
        raise InputError(f"{where} = {result:g} must be greater than {above:g}")
    if result < least:
        raise InputError(f"{where} = {result:g} must not be less than {least:g}")
    if abs(result) > LARGEST or (above == 0.0 and result < SMALLEST):
        size = f"between {SMALLEST:g} and {LARGEST:g}" if above == 0.0 else f"at most {LARGEST:g} in size"
        raise InputError(f"{where} = {shown(value)} must be {size}; check its unit")
    return result


def whole(value: object, where: str, *, least: int, most: int | None = None) -> int:
    """Check a whole number from `least` to `most`."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise InputError(f"{where} must be a whole number, not {shown(value)}")
    if most is None and value < least:
        raise InputError(f"{where} = {shown(int(value))} must be at least {least}")
    if most is not None and not least <= value <= most:
        raise InputError(f"{where} = {shown(int(value))} must lie between {least} and {most}")
    return int(value)


def flag(value: object, where: str) -> bool:
    """Check for true or false."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{where} must be true or false, not {shown(value)}")
    return bool(value)


def text(value: object, where: str) -> str:
    """Check a text that is not empty."""
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"{where} must be a text that is not empty, not {shown(value)}")
    return value


def date(value: object, where: str) -> str:
    """Check a day or a time, of TOML or as text, and return it as ISO text."""
    if isinstance(value, datetime.date):
        return value.isoformat()
    for kind in (datetime.date, datetime.datetime):
        with suppress(ValueError, RecursionError):
            return kind.fromisoformat(str(value)).isoformat()
    raise InputError(f"{where} must be a date such as 2024-05-03, not {shown(value)}")


def choice(value: object, options: Sequence[str], where: str) -> str:
    """Check a text that must be one of the options."""
    if not isinstance(value, str) or value not in options:
        hint = near(value, options) if isinstance(value, str) else ""
        raise InputError(f"{where} must be one of {', '.join(options)}, not {shown(value)}{hint}")
    return value


def _clean(value: object, axes: int, *, above: float, least: float, nan: bool) -> Floats | None:
    """Return a read-only copy of an array of floats that all pass `number`, and need no check entry by entry."""
    if not isinstance(value, np.ndarray) or isinstance(value, np.ma.MaskedArray):
        return None
    if value.dtype != np.float64 or value.ndim != axes or not value.size:
        return None
    known = value[~np.isnan(value)] if nan else value
    size = np.abs(known)
    wrong = ~(size <= LARGEST) | (known <= above) | (known < least) | ((above == 0.0) & (size < SMALLEST))
    return None if np.any(wrong) else frozen(value.copy(order="C"))


def items(value: object, where: str, what: str) -> list[object]:
    """Check a list, a tuple or an array of anything."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        raise InputError(f"{where} must be a list of {what}, not {shown(value)}")
    return list(value)


def vector(
    value: object,
    where: str,
    *,
    length: int | None = None,
    each: str = "",
    above: float = -math.inf,
    least: float = -math.inf,
    nan: bool = False,
) -> Floats:
    """Check a list of numbers and return it as a read-only array; entries may be nan only if `nan` is true.

    `each` describes the entries in the message about a wrong `length`: ", one a mode".
    """
    clean = _clean(value, 1, above=above, least=least, nan=nan)
    if clean is not None and length in (None, len(clean)):
        return clean
    found = _list_of(value, where, "numbers", length, each)

    def checked(item: object, place: int) -> float:
        # A masked entry is None.
        if nan and (item is None or (isinstance(item, float) and math.isnan(item))):
            return math.nan
        return number(item, f"{where}, entry {place}", above=above, least=least)

    return frozen(np.array([checked(item, place) for place, item in enumerate(found, 1)]))


def _list_of(value: object, where: str, what: str, length: int | None, each: str) -> list[object]:
    """Check a list that is not empty, of a length where that is known."""
    found = items(value, where, what)
    if not found:
        raise InputError(f"{where} must not be empty")
    if length is not None and len(found) != length:
        raise InputError(f"{where} must have {entries(length)}{each}, not {len(found)}")
    return found


def entries(count: int) -> str:
    """Write a count for a message: 1 entry, 2 entries."""
    return f"{count} {'entry' if count == 1 else 'entries'}"


class ReadOnlyArrays:
    """A frozen dataclass whose arrays stay read-only when it is copied or unpickled."""

    def __setstate__(self, state: dict[str, object]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, frozen(value) if isinstance(value, np.ndarray) else value)


def many(value: object) -> bool:
    """Return whether the value is a list, a tuple or an array with at least one axis."""
    return isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim > 0)


def one_or_many(
    value: object, where: str, length: int, *, each: str = "", above: float = -math.inf, least: float = -math.inf,
    nan: bool = False,
) -> Floats:  # fmt: skip
    """Check one number for all places, or a list of `length` numbers; the list may hold nan if `nan` is true."""
    if many(value):
        return vector(value, where, length=length, each=each, above=above, least=least, nan=nan)
    return frozen(np.full(length, number(value, where, above=above, least=least)))


def ascending_whole(value: object, where: str, *, most: int, length: int | None = None, each: str = "") -> Ints:
    """Check a list of whole numbers from 1 to `most` that strictly ascend; `length` and `each` as for `vector`."""
    found = _list_of(value, where, "whole numbers", length, each)
    result = [whole(item, f"{where}, entry {place}", least=1, most=most) for place, item in enumerate(found, 1)]
    for before, after in pairwise(result):
        if after <= before:
            raise InputError(f"{where} must be ascending, none twice; found {after} after {before}")
    return frozen(np.array(result, dtype=np.int64))


def table(
    value: object, where: str, *, rows: int, columns: int | None = None, nan: bool = False, above: float = -math.inf
) -> Floats:
    """Check a list of `rows` lists of numbers, all of one length; return a read-only array of shape (rows, columns)."""
    clean = _clean(value, 2, above=above, least=-math.inf, nan=nan)
    if clean is not None and len(clean) == rows and columns in (None, clean.shape[1]):
        return clean
    found = items(value, where, "lists of numbers, one a mode")
    if len(found) != rows:
        lying = all(isinstance(item, list | tuple) and len(item) == rows for item in found)
        hint = ": a row is a mode, not a floor" if found and lying else ""
        needed = f"{rows} row{'s' * (rows != 1)}, one for each frequency"
        raise InputError(f"{where} must have {needed}, not {len(found)}{hint}")
    lines = [vector(item, f"{where}, row {place}", nan=nan, above=above) for place, item in enumerate(found, 1)]
    for place, line in enumerate(lines, 1):
        if len(line) != len(lines[0]):
            raise InputError(
                f"{where}, row {place} has {entries(len(line))}, row 1 has {len(lines[0])}: give one a measured floor"
            )
    if columns not in (None, len(lines[0])):
        raise InputError(f"{where} has {entries(len(lines[0]))} a row, not {columns}")
    return frozen(np.array(lines))


def pairs(value: object, where: str, *, length: int | None = None, above: float = -math.inf) -> Floats:
    """Check a list of pairs of numbers; return a read-only array of shape (length, 2)."""
    found = items(value, where, "pairs of numbers")
    if not found or length not in (None, len(found)):
        raise InputError(f"{where} must have {entries(length or 1)}, one a floor, not {len(found)}")
    return frozen(
        np.array([vector(item, f"{where}, entry {at}", length=2, above=above) for at, item in enumerate(found, 1)])
    )


def real(value: object, where: str) -> Floats:
    """Check the result of a user's function: an array of real numbers of any shape; nan and infinity pass."""
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.array(None)
    if array.dtype.kind not in "fiu" or isinstance(value, np.ma.MaskedArray):
        raise InputError(f"{where} must hold real numbers, not {shown(value)}")
    return array.astype(float)


def frozen(array: np.ndarray[Any, np.dtype[Scalar]]) -> np.ndarray[Any, np.dtype[Scalar]]:
    """Make an array read-only."""
    array.setflags(write=False)
    return array


def derivative(stated: Floats, change: Floats, size: ArrayLike, value: Floats, where: str) -> None:
    """Check the stated changes of a user's function along a small direction against central differences.

    Parameters
    ----------
    stated, change : ndarray, of one shape
        Derivative times direction, and half the difference of the values at both ends.
    size : array_like
        Sizes of the terms of the change, one or one an entry.
    value : ndarray
        The values themselves; their rounding does not count.
    where : str
    """
    allowed = DERIVATIVE_ERROR * (np.asarray(size) + DIFFERENCE_STEP**2 * np.max(np.abs(value), initial=0.0))
    gap = np.abs(stated - change)
    if not np.all(gap <= allowed):
        part = 100 * np.max(gap) / max(np.max(np.abs(change)), np.max(allowed))
        raise InputError(f"{where} is wrong: it differs from the difference quotient by {part:.3g} % of its size")
