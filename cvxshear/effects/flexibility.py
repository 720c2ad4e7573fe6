"""What effects that add flexibility have in common: K becomes (K^-1 + p D)^-1."""

from __future__ import annotations

import numpy as np

from cvxshear.effects.state import State
from cvxshear.util.typing import Floats


def add_flexibility(state: State, p: float, D: Floats, own: slice) -> State:
    """The state with p D added to its flexibility.

    Parameters
    ----------
    state : State
    p : float
        The effect's parameter.
    D : ndarray, shape (N, N)
        Flexibility for p = 1, m/N; it depends on no parameter of the fit.
    own : slice

    Notes
    -----
    With A = (1 + p K D)^-1 the new stiffness is A K, without inverting K; and since the flexibility F = K^-1
    changes by -F dK F, the new stiffness changes by A dK A' - (A K) D (A K) dp.
    """
    system = state.system
    A = np.linalg.inv(np.eye(len(D)) + p * (system.K @ D))
    K = A @ system.K
    K = 0.5 * (K + K.T)
    dK = A @ system.dK @ A.T
    dK[own] -= K @ D @ K
    return state.with_stiffness(K, dK)
