"""What results share: they are plain values in JSON and in files, tables of pandas, and visible at a prompt.

How a result is shown is asked of whoever has said how: a result itself knows nothing of it.
"""

from __future__ import annotations

import dataclasses
import importlib
import math
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import TYPE_CHECKING, Any, ClassVar

from cvxshear.util.errors import optional

if TYPE_CHECKING:
    import pandas as pd

    from cvxshear.util.typing import Json


def as_json(value: Any) -> Any:  # noqa: PLR0911 - a line a kind of value
    """Convert a value of a result to what JSON has.

    Parameters
    ----------
    value : object
        What has a method `to_dict` gives that, any other dataclass its fields by their names. Arrays become lists as
        a whole, nan and infinity None, an Enum its text.

    Returns
    -------
    object
        Of dict, list, str, int, float, bool and None alone.
    """
    if value is None or isinstance(value, str | bool | int):
        return str(value) if isinstance(value, Enum) else value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return _array_as_json(value)
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, Mapping):
        return {str(key): as_json(each) for key, each in value.items()}
    if isinstance(value, Sequence | set | frozenset):
        return [as_json(each) for each in value]
    if dataclasses.is_dataclass(value):
        return fields_as_json(value)
    return str(value)


def _array_as_json(values: Any) -> Any:
    """Convert an array, or a number of NumPy, to lists or a number; None in place of nan and infinity."""
    import numpy as np  # noqa: PLC0415 - help and completion need none of it

    if np.ndim(values) == 0:
        return as_json(values.item())
    if values.dtype.kind != "f" or np.isfinite(values).all():
        return values.tolist()
    found = values.astype(object)
    found[~np.isfinite(values)] = None
    return found.tolist()


class InJson:
    """A dataclass that JSON has as a dict.

    Attributes
    ----------
    json_keys : str
        Attributes with spaces between, in the order of the JSON; the fields, in theirs, where empty. `key=path.to.it`
        gives an attribute, or that of an attribute, another key (None where one on the way is None); `*attribute` puts
        in the keys of that attribute.
    """

    json_keys: ClassVar[str] = ""

    def to_dict(self) -> Json:
        """Return the documented JSON, each value by `as_json`."""
        return fields_as_json(self)


def fields_as_json(value: Any) -> Json:
    """Collect what `json_keys` lists of a dataclass, or all of its fields where it lists none, each by `as_json`."""
    listed = getattr(value, "json_keys", "").split()
    found: Json = {}
    for each in listed or [field.name for field in dataclasses.fields(value)]:
        key, _, path = each.lstrip("*").partition("=")
        item = value
        for name in (path or key).split("."):
            item = None if item is None else getattr(item, name)
        item = as_json(item)
        found.update(item if each.startswith("*") else {key: item})
    return found


def fields_as_table(value: Any, *, empty: bool = False, unsaid: Mapping[str, object] | None = None) -> Json:
    """Write the fields of a dataclass as the table of a measurement file that declares it.

    Parameters
    ----------
    value : dataclass
    empty : bool, optional
        Whether an empty list, or one of empty lists, says something.
    unsaid : mapping of str to object, optional
        Values of single fields that stand for "not given", besides None.
    """
    found = {field.name: getattr(value, field.name) for field in dataclasses.fields(value) if field.init}
    unsaid = unsaid or {}
    return {
        key: as_table(item)
        for key, item in found.items()
        if item is not None
        and (empty or not hasattr(item, "__len__") or (len(item) > 0 and getattr(item, "size", 1) > 0))
        and not (key in unsaid and item == unsaid[key])
    }


def as_table(value: Any) -> Any:
    """Convert a value to what TOML has, where an entry that was not measured is nan."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, tuple):
        return [as_table(each) for each in value]
    return value.to_dict() if hasattr(value, "to_dict") else value


def data_frame(columns: Mapping[str, Sequence[object]]) -> pd.DataFrame:
    """Make a table with these columns.

    Raises
    ------
    InputError
        Where pandas is not installed.
    """
    found: pd.DataFrame = optional("pandas", "to_dataframe needs").DataFrame(dict(columns))
    return found


_modules: dict[str, str] = {}
"""Modules above this room by their task: the public face names them, so that nothing imports upward."""


def name_module(task: str, module: str) -> None:
    """Name the module that does a task; it is imported when it is first asked.

    Parameters
    ----------
    task : str
        "read", of a module with `experiment_from_file`, which takes a path or the name of a built-in example. "show",
        of one with `line_of` (a result in a short line), `text` (its tables), `notebook_html` (the same for a notebook,
        or None), `drawn` (one of its figures, by name; the first where the name is empty) and `picked` (the diagram in
        which poles are chosen).
    module : str
    """
    _modules[task] = module


def ask(task: str, function: str, *given: Any) -> Any:
    """Call a function of the module that does a task, and return what it returns.

    Parameters
    ----------
    task, function : str
    *given : object
    """
    return getattr(importlib.import_module(_modules[task]), function)(*given)


class Shown(InJson):
    """A result that a prompt shows in a line, `print` as tables, a notebook as HTML and `to_dict` as JSON."""

    def __repr__(self) -> str:
        return str(ask("show", "line_of", self))

    def __str__(self) -> str:
        return str(ask("show", "text", self))

    def _repr_html_(self) -> str | None:
        """Show a result in a notebook."""
        found: str | None = ask("show", "notebook_html", self)
        return found

    def figure(self, name: str = "") -> Any:
        """Draw a figure of this result.

        Parameters
        ----------
        name : str, optional
            As `--figure list` prints it; the first figure of such a result where not given.

        Returns
        -------
        matplotlib.figure.Figure
            A notebook shows it as the last expression of a cell.

        Raises
        ------
        InputError
            If there is no figure of that name, or the result lacks what the figure shows.
        """
        return ask("show", "drawn", self, name)
