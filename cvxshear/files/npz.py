"""Reader of NumPy's own files: one array in .npy, several by their names in .npz."""

from __future__ import annotations

import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.files.columns import LIMIT, TOO_LARGE, Columns
from cvxshear.files.mat import columns_of_arrays
from cvxshear.files.reading import MEGABYTE, read_bytes
from cvxshear.util.errors import InputError

LONE = "column"
"""The name of a lone array that has none: its columns are `column[1]`, `column[2]`, ..."""


def read_npz(path: str | Path, limit: float = LIMIT) -> Columns:
    """Read the arrays of a .npy or .npz file as columns, named as those of a MAT file.

    Parameters
    ----------
    path : str or Path
        An array with named fields gives a column a field.
    limit : float, optional
        Bytes that the file may have, as it is and once inflated.

    Raises
    ------
    InputError
        Where the file cannot be read, is too large, or holds no numbers. Pickled objects are never read.
    """
    where = str(path)
    content = BytesIO(read_bytes(Path(path), limit, TOO_LARGE))
    try:
        if zipfile.is_zipfile(content):
            with zipfile.ZipFile(content) as archive:
                inflated = sum(each.file_size for each in archive.infolist())
            if inflated > limit:
                raise InputError(f"{where} inflates to more than {limit / MEGABYTE:g} MB; {TOO_LARGE}")
        content.seek(0)
        loaded: Any = np.load(content, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            names = loaded.dtype.names
            arrays = {LONE: loaded} if names is None else {name: loaded[name] for name in names}
        else:
            arrays = {name: loaded[name] for name in loaded.files}
    except InputError:
        raise
    except Exception as error:
        # numpy raises whatever a damaged file makes it run into.
        raise InputError(f"{where} is not a NumPy file that can be read ({type(error).__name__})") from None
    return columns_of_arrays(arrays, where)
