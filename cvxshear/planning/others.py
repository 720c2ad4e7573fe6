"""Other ways of placing sensors, for comparison: they look at the mode shapes alone."""

from __future__ import annotations

import numpy as np

from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats


def equally_spaced(floors: int, number: int) -> list[int]:
    """So many floors at equal distances, the top one among them; zero-based."""
    return [round((place + 1) * floors / number) - 1 for place in range(number)]


def effective_independence(shapes: Floats, number: int) -> list[int]:
    """Floors that keep the modes independent (Kammer 1991): the least useful one is dropped, one after the other.

    A floor's use is its diagonal entry of the projector on the shapes that are left, Phi (Phi'Phi)^-1 Phi'.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column a mode.
    number : int
        With fewer floors than modes the later modes are left out, as many as must be.

    Returns
    -------
    list of int
        Ascending, zero-based.
    """
    shapes = shapes[:, : min(number, shapes.shape[1])]
    left = list(range(len(shapes)))
    while len(left) > number:
        basis, _ = np.linalg.qr(shapes[left])
        del left[int(np.argmin(np.sum(basis**2, axis=1)))]
    return left


def qr_pivots(shapes: Floats, number: int) -> list[int]:
    """Floors of the pivots of a QR factorization of the shapes, as PySensors takes them.

    Parameters
    ----------
    shapes : ndarray, shape (N, m)
        One column a mode.
    number : int

    Returns
    -------
    list of int
        Ascending, zero-based.

    Raises
    ------
    InputError
        Where PySensors is not installed.
    """
    try:
        from pysensors.optimizers import QR  # noqa: PLC0415 - slow, and needed for the comparison alone
    except ImportError as error:
        raise InputError("the comparison with QR pivoting needs PySensors: pip install python-sensors") from error
    pivots = QR().fit(shapes).get_sensors()
    return sorted(int(floor) for floor in pivots[:number])
