"""An identified frame for other programs: its matrices, modes and state-space form."""

from __future__ import annotations

import numpy as np

from cvxshear.response.model import DampedModel
from cvxshear.response.uncertain import Damped
from cvxshear.util.typing import Floats


def matrices(damped: Damped) -> dict[str, Floats]:
    """Everything that another program needs of a frame, SI units.

    Returns
    -------
    dict of str to ndarray
        `M`, `C`, `K`, shape (N, N); `frequencies` (Hz), `damping_ratios`, shape (N,); `mode_shapes`, one row a
        mode, mass-normalized; `story_dashpots`, `rayleigh`, `story_heights` where there are such; and the state-space
        form `state_A`, `state_B`, `state_C`, `state_D`, of

            x' = A x + B w,   y = C x + D w

        with the displacements against the ground and the velocities in x, the base acceleration and then the force on
        each floor in w, and the total accelerations of the floors in y.
    """
    model = damped.model
    result = {
        "M": model.M,
        "C": model.C,
        "K": model.K,
        "frequencies": model.modes.frequencies,
        "damping_ratios": model.ratios,
        "mode_shapes": model.modes.shapes,
    }
    if damped.dashpots is not None:
        result["story_dashpots"] = damped.dashpots.values
    if damped.rayleigh is not None:
        result["rayleigh"] = damped.rayleigh
    if model.heights is not None:
        result["story_heights"] = model.heights
    return result | state_space(model)


def state_space(model: DampedModel) -> dict[str, Floats]:
    """The state-space form of `matrices`."""
    n = len(model.M)
    inverse = np.linalg.inv(model.M)
    rows = -inverse @ np.hstack([model.K, model.C])
    none = np.zeros((n, n))
    return {
        "state_A": np.block([[none, np.eye(n)], [rows]]),
        "state_B": np.block([[np.zeros((n, 1)), none], [-np.ones((n, 1)), inverse]]),
        "state_C": rows,
        "state_D": np.hstack([np.zeros((n, 1)), inverse]),
    }
