"""Results as tables of pandas, where that is installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cvxshear.util.errors import InputError

if TYPE_CHECKING:
    import pandas as pd


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
