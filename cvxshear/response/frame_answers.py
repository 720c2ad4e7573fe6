"""Which stories, dashpots and sensors changed by themselves in a record: answers compared by their evidence.

The likelihood is linearised once; an answer is a Gaussian prior, so that its evidence is one formula.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.response.frame_prior import FORM_STDS, SCATTER_STDS, FramePrior, Gaussian
from cvxshear.response.innovations import Likelihood
from cvxshear.util.typing import Bools, Floats

LEAST_WEIGHT = 1e-3
"""Probability of an answer, relative to the most probable one, below which it is left out of the average."""

MOST_CHANGES = 3
KEPT_SETS = 6
"""Changed stories in a set at most, and sets of each size that the next size grows from."""

Widths = tuple[tuple[int, ...], float, float, float, float]
"""What changed by itself, and the standard deviations of form, stories, masses and gains."""


@dataclass(frozen=True, eq=False)
class Answer:
    """One possible way in which the frame differs from the identified one.

    Parameters
    ----------
    changed : tuple of int
        Stories, from 0, and sensors that changed by themselves: places in `FramePrior.single`.
    form_std : float
        Standard deviation of the errors of the model's form.
    scatter_std : float
        Standard deviation of the factors of the other stories.
    mass_std : float
        Standard deviation of the factors of the floor masses.
    gain_std : float
        Standard deviation of the gains of the sensors.
    probability : float
    """

    changed: tuple[int, ...]
    form_std: float
    scatter_std: float
    mass_std: float
    gain_std: float
    probability: float

    @property
    def prior(self) -> Widths:
        """Arguments of `FramePrior.gaussian`."""
        return self.changed, self.form_std, self.scatter_std, self.mass_std, self.gain_std


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Log evidence of linear data, but for a constant.

    Parameters
    ----------
    plain : float
        Of the prior as it is.
    G, b : ndarray, shapes (N, N) and (N,)
        Products of the directions along which it may be wider, as the data see them, with each other and the data.
    """

    plain: float
    G: Floats
    b: Floats

    def of(self, sets: Sequence[tuple[int, ...]], one_sided: Bools) -> Floats:
        """Log evidences of priors whose covariance is larger by the outer products of some directions, shape (len,).

        Parameters
        ----------
        sets : sequence of tuple of int
        one_sided : ndarray of bool, shape (N,)
            Directions along which unknowns are positive: sets in which one would be negative have no evidence.
        """
        result = np.full(len(sets), self.plain)
        # Sets of one size together: one by one they take half the time of a reconstruction.
        for size in {len(own) for own in sets} - {0}:
            chosen = np.array([place for place, own in enumerate(sets) if len(own) == size])
            at = np.array([sets[place] for place in chosen], dtype=np.int64)
            wider = np.eye(size) + self.G[at[:, :, None], at[:, None, :]]
            within = np.linalg.solve(wider, self.b[at][:, :, None])[:, :, 0]
            result[chosen] += 0.5 * (np.sum(self.b[at] * within, axis=1) - np.linalg.slogdet(wider)[1])
            result[chosen[np.any((within < 0) & one_sided[at], axis=1)]] = -np.inf
        return result


class Linear:
    """Linear data of unknowns with a Gaussian prior, the likelihood tempered by its inflation.

    Parameters
    ----------
    at : Likelihood
    p : ndarray, shape (P,)
        Where it was linearised.
    prior : Gaussian
    """

    def __init__(self, at: Likelihood, p: Floats, prior: Gaussian) -> None:
        self.U, self.prior, self.covariance = at.U, prior, prior.covariance
        self.data = at.U @ (p - prior.mean) - at.c
        self.seen = at.U @ prior.covariance @ at.U.T + at.inflation * np.eye(len(at.c))

    def evidence(self, changes: Floats) -> _Evidence:
        """Return the evidence, as it depends on what changed by itself.

        Parameters
        ----------
        changes : ndarray, shape (P, N)
            Directions, each a standard deviation long, along which the prior may be wider.
        """
        half = np.asarray(np.linalg.cholesky(self.seen))
        white = np.linalg.solve(half, np.column_stack([self.U @ changes, self.data]))
        moved, data = white[:, :-1], white[:, -1]
        plain = self.prior.evidence - 0.5 * float(data @ data) - float(np.sum(np.log(half.diagonal())))
        return _Evidence(plain, moved.T @ moved, moved.T @ data)

    def posterior(self) -> tuple[Floats, Floats]:
        """Mean and covariance of the unknowns."""
        spread = self.U @ self.covariance
        gain = np.linalg.solve(self.seen, spread).T
        return self.prior.mean + gain @ self.data, self.covariance - gain @ spread


def possible_answers(at: Likelihood, prior: FramePrior, p: Floats) -> tuple[Answer, ...]:
    """Which stories and gains may have changed and how much the form may miss, by the linearised likelihood's evidence.

    Sets of each size grow from the best of the size before. All sizes of the form's errors, of the scatter of the
    stories, and of what the masses changed by, are equally probable beforehand.

    Parameters
    ----------
    at : Likelihood
        At p.
    prior : FramePrior
    p : ndarray, shape (P,)
    """
    single, log_odds, one_sided = range(len(prior.single)), prior.log_odds.tolist(), prior.one_sided
    scores: dict[Widths, float] = {}
    changes = np.eye(len(p))[:, prior.single] * prior.single_std
    for widths in itertools.product(FORM_STDS, SCATTER_STDS, prior.mass_stds, prior.gain_stds):
        evidence = Linear(at, p, prior.gaussian((), *widths)).evidence(changes)
        level: list[tuple[int, ...]] = [()]
        for size in range(min(MOST_CHANGES, len(single)) + 1):
            grown = level
            if size:
                pairs = itertools.product(level, single)
                grown = sorted({tuple(sorted({*base, other})) for base, other in pairs if other not in base})
            own = {
                each: score + sum(log_odds[at] for at in each)
                for each, score in zip(grown, evidence.of(grown, one_sided).tolist(), strict=True)
            }
            scores |= {(each, *widths): score for each, score in own.items()}
            level = sorted(own, key=own.__getitem__, reverse=True)[:KEPT_SETS]
    best = max(scores.values())
    kept = {each: np.exp(score - best) for each, score in scores.items() if score > best + np.log(LEAST_WEIGHT)}
    total = sum(kept.values())
    order = sorted(kept, key=lambda each: -kept[each])
    return tuple(Answer(*each, float(kept[each] / total)) for each in order)
