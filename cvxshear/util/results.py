"""Shared behavior of results: conversion to JSON, to measurement files and to pandas, and display at a prompt.

Modules of higher layers display a result; `MODULES` names them.
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
    """Convert a value of a result to types of JSON.

    Parameters
    ----------
    value : object
        An object with a method `to_dict` is converted by this method, any other dataclass to a dict of its fields.
        Arrays become lists, nan and infinity None, an Enum its text.

    Returns
    -------
    object
        Made of dict, list, str, int, float, bool and None only.
    """
    if value is None or isinstance(value, str | bool | int):
        return str(value) if isinstance(value, Enum) else value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return as_json(value.tolist())
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, Mapping):
        return {str(key): as_json(each) for key, each in value.items()}
    if isinstance(value, Sequence | set | frozenset):
        return [as_json(each) for each in value]
    if dataclasses.is_dataclass(value):
        return fields_as_json(value)
    return str(value)


class InJson:
    """A dataclass that becomes a dict in JSON.

    Attributes
    ----------
    json_keys : str
        Names of attributes, separated by spaces, in the order of the JSON; if empty, all fields in their order.
        `key=path.to.value` gives an attribute, or an attribute of an attribute, another key (the value is None if an
        attribute on the path is None); `*attribute` inserts the keys of an attribute.
    """

    json_keys: ClassVar[str] = ""

    def to_dict(self) -> Json:
        """Return the documented JSON; `as_json` converts each value."""
        return fields_as_json(self)


def fields_as_json(value: Any) -> Json:
    """Collect the attributes that `json_keys` lists, or all fields if the list is empty; `as_json` converts each."""
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
    """Convert the fields of a dataclass to its table in a measurement file.

    Parameters
    ----------
    value : dataclass
    empty : bool, optional
        Whether the table includes empty lists and lists of empty lists.
    unsaid : mapping of str to object, optional
        Values of single fields that mean "not given", in addition to None.
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
    """Convert a value to types of TOML; an entry that was not measured stays nan."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, tuple):
        return [as_table(each) for each in value]
    return value.to_dict() if hasattr(value, "to_dict") else value


def data_frame(columns: Mapping[str, Sequence[object]]) -> pd.DataFrame:
    """Make a pandas table with these columns.

    Raises
    ------
    InputError
        If pandas is not installed.
    """
    found: pd.DataFrame = optional("pandas", "to_dataframe needs").DataFrame(dict(columns))
    return found


#: Modules of higher layers by their task; the first use imports one, so no module imports upward. That for "read" has
#: `experiment_from_file`, which takes a path or the name of a built-in example; that for "solve" has `solve`. That for
#: "show" has `line_of` (a result in a short line), `text` (its tables), `notebook_html` (the tables for a notebook, or
#: None), `data_frame_of` (its main table), `drawn` (one of its figures by name; the first if the name is empty).
MODULES = {"read": "cvxshear.io.modes", "show": "cvxshear.report.terminal", "solve": "cvxshear.backends.solvers"}


def ask(task: str, function: str, *given: Any) -> Any:
    """Call a function of the module for a task, and return its result.

    Parameters
    ----------
    task, function : str
    *given : object
    """
    return getattr(importlib.import_module(MODULES[task]), function)(*given)


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

    def to_dataframe(self) -> pd.DataFrame:
        """Return the main table of this result as a table of pandas.

        Returns
        -------
        DataFrame
            One row for each floor, story or mode, the lowest first. The columns have the names of the JSON with their
            SI unit, such as floor_mass_kg and floor_mass_std_kg.

        Raises
        ------
        InputError
            If the result has no table of numbers, or pandas is not installed.
        """
        found: pd.DataFrame = ask("show", "data_frame_of", self)
        return found

    def figure(self, name: str = "") -> Any:
        """Draw a figure of this result.

        Parameters
        ----------
        name : str, optional
            Name that `--figure list` prints. Default: the first figure of the result.

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
