"""Results as plain values, ready for JSON, and as tables of pandas, where that is installed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np

from cvxshear.util.errors import InputError
from cvxshear.util.typing import Json

if TYPE_CHECKING:
    import pandas as pd


def as_json(value: Any) -> Any:  # noqa: PLR0911 - a line a kind of value
    """A value of a result as JSON has it.

    Parameters
    ----------
    value : object
        A dataclass gives its fields by their names, but those whose metadata say `json=False`; what has a method
        `to_dict` gives that. Arrays become lists as a whole, nan and infinity None, an Enum its text.

    Returns
    -------
    object
        Of dict, list, str, int, float, bool and None alone.
    """
    if value is None or isinstance(value, str | bool | int):
        return str(value) if isinstance(value, Enum) else value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        if value.dtype.kind != "f" or np.isfinite(value).all():
            return value.tolist()
        found = value.astype(object)
        found[~np.isfinite(value)] = None
        return found.tolist()
    if isinstance(value, np.generic):
        return as_json(value.item())
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, Mapping):
        return {str(key): as_json(each) for key, each in value.items()}
    if isinstance(value, Sequence | set | frozenset):
        return [as_json(each) for each in value]
    if dataclasses.is_dataclass(value):
        return fields_as_json(value)
    return str(value)


def fields_as_json(value: Any) -> Json:
    """The fields of a dataclass, each by `as_json`: what its `to_dict` returns where the JSON has no other keys."""
    return {
        each.name: as_json(getattr(value, each.name))
        for each in dataclasses.fields(value)
        if each.metadata.get("json", True)
    }


def data_frame(columns: Mapping[str, Sequence[object]]) -> pd.DataFrame:
    """A table with these columns.

    Raises
    ------
    InputError
        Where pandas is not installed.
    """
    try:
        import pandas as pd  # noqa: PLC0415 - optional, and loads slowly
    except ImportError:
        raise InputError("to_dataframe needs pandas: pip install pandas") from None
    return pd.DataFrame(dict(columns))
