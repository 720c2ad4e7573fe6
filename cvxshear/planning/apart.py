"""How far a test tells effects apart: the probability of the right verdict, before the test.

Where the model is linear and the noise Gaussian, all that the data say of the effects is y = G x + e, x their values in
units of their expected size, G the information about them with the frame's masses and stiffnesses marginalised, and
cov(e) = G. The evidence of "effect g alone", with its value expected to be mu +- tau, over that of "none" is then

    (1 + tau^2 G_gg)^(-1/2) exp(m^2 / (2 v) - mu^2 / (2 tau^2)),
    v = 1 / (G_gg + 1 / tau^2),  m = v (y_g + mu / tau^2),

times 2 Phi(m / sqrt(v)) where physics lets the value be on one side of none alone;
and from even odds follows a probability of each. The verdict is right where the effect that is there has 95 %; where
there is none, where none has a half, from which on one would be added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from cvxshear.planning.targets import Target
from cvxshear.util.typing import Floats, Json

SURE = 0.95
"""Probability from which on a verdict is given."""

ADDED = 0.5
"""Probability from which on an effect is added to the model."""

DRAWS = 20_000
SEED = 2014

SUFFICES = 0.9
"""Probability of the right verdict from which on a test is said to suffice."""


@dataclass(frozen=True)
class Apart:
    """What becomes of one of the possibilities.

    Parameters
    ----------
    label : str
        The effect at its place, or "none of them".
    size : float or None
        That it is expected to have.
    distance : float or None
        Standard deviations that its effect on the data is from none, the frame following.
    nearest : str or None
        What it is hardest to tell from.
    nearest_distance : float or None
        Standard deviations from that, whatever the size of the other.
    probability : float
        That the verdict is right if it is this.
    """

    label: str
    size: float | None
    distance: float | None
    nearest: str | None
    nearest_distance: float | None
    probability: float

    def to_dict(self) -> Json:
        """The fields by name."""
        return {
            "effect": self.label,
            "size": self.size,
            "standard_deviations": self.distance,
            "nearest": self.nearest,
            "nearest_standard_deviations": self.nearest_distance,
            "probability": self.probability,
        }


NONE = "none of them"


def apart(targets: Sequence[Target], information: Floats) -> tuple[Apart, ...]:
    """What becomes of each possibility: none of the effects, or one of them.

    Parameters
    ----------
    targets : sequence of Target
    information : ndarray, shape (e, e)
        About their values in units of their sizes, the frame marginalised.
    """
    G = information
    right = _right(targets, G)
    result = [Apart(NONE, None, None, *_nearest_to_none(targets, G), right[0])]
    for i, each in enumerate(targets):
        pairs = [(float(np.sqrt(G[i, i])), NONE)]
        for j, other in enumerate(targets):
            if j != i:
                pairs.append((_distance(G, i, j, other), other.placed.label))
        least, nearest = min(pairs)
        result.append(Apart(each.placed.label, each.size, float(np.sqrt(G[i, i])), nearest, least, right[i + 1]))
    return tuple(result)


def _distance(G: Floats, i: int, j: int, other: Target) -> float:
    """Standard deviations of effect i from the value of effect j that does most like it, within what physics lets."""
    value = G[i, j] / G[j, j]
    if value * other.side < 0:
        return float(np.sqrt(G[i, i]))
    return float(np.sqrt(max(G[i, i] - value * G[i, j], 0.0)))


def _nearest_to_none(targets: Sequence[Target], G: Floats) -> tuple[str, float]:
    place = int(np.argmin(np.diag(G)))
    return targets[place].placed.label, float(np.sqrt(G[place, place]))


def log_evidence(targets: Sequence[Target], G: Floats, y: Floats) -> Floats:
    """Logarithm of the evidence of "none" and of each effect alone, over that of "none"; shape (..., 1 + e).

    Parameters
    ----------
    targets : sequence of Target
    G : ndarray, shape (e, e)
    y : ndarray, shape (..., e)
    """
    found = [evidence_of(each, float(G[i, i]), y[..., i]) for i, each in enumerate(targets)]
    return np.stack([np.zeros(y.shape[:-1]), *found], axis=-1)


def evidence_of(target: Target, own: float, y: Floats) -> Floats:
    """Logarithm of the evidence of an effect alone over that of none.

    Parameters
    ----------
    target : Target
    own : float
        Information about its value, the frame marginalised.
    y : ndarray
    """
    mu, tau2 = target.mean, target.spread**2
    v = 1 / (own + 1 / tau2)
    m = v * (y + mu / tau2)
    found: Floats = m**2 / (2 * v) - mu**2 / (2 * tau2) - np.log1p(tau2 * own) / 2
    return found if target.side == 0 else found + np.log(2) + log_ndtr(target.side * m / np.sqrt(v))


def _right(targets: Sequence[Target], G: Floats) -> list[float]:
    """Probability of the right verdict if there is none of the effects, and for each if it is there."""
    rng = np.random.default_rng(SEED)
    e = len(targets)
    noise = rng.standard_normal((DRAWS, e)) @ np.linalg.cholesky(G).T
    result = []
    for truth in range(e + 1):
        y = noise if truth == 0 else noise + G[:, truth - 1]
        evidence = log_evidence(targets, G, y)
        likely = np.exp(evidence - evidence.max(axis=1, keepdims=True))
        likely /= likely.sum(axis=1, keepdims=True)
        right = likely[:, truth] >= SURE if truth else likely[:, 1:].max(axis=1) < ADDED
        result.append(float(np.mean(right)))
    return result
