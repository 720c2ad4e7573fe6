"""Sets of effects that lie next to one that was fitted, and are worth a fit themselves.

With one effect more, or several, as the linearised model at its fit promises; with the causes that the entries
of an open class stand for; with an effect that brings a motion of its own; and the groups of its effects for which one
cause may stand.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from cvxshear.effects import Placed
from cvxshear.effects.open_class import OpenClass
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.gauss_newton import HOPELESS
from cvxshear.loop.fitter import FitProposal, Fitter, ModelClass
from cvxshear.loop.hypotheses import OPEN
from cvxshear.loop.linear import Linearised
from cvxshear.util import ranking
from cvxshear.util.errors import NoModesError
from cvxshear.util.typing import Floats

WITHIN = 7.0
"""Logarithm of a probability ratio: what is a thousandth as probable as the best is not followed up."""

MOTIONS = 12
"""Fits of effects that bring a motion of their own."""

FROM_FRAMES = 20
"""Fits that start at frames of their own: each costs milliseconds, as frequencies are few."""

NEAR_ENOUGH = 4.0
"""Times the objective of a set that explains the data that a first step may leave: far from its place a mass of its own
is not linear, and further steps halve what the first one leaves."""

MOST_FURTHER = 10
LEAST_FURTHER = 1
RESCALING = 3
"""Most and least further effects, and effects on the accuracy of data, that are fitted when a set is expanded."""

Set = frozenset[Placed]


def promising(model: ModelClass, linear: Linearised, fitter: Fitter, behind: float) -> list[Set]:
    """List sets with one more effect, or several, by what the linearised model promises.

    Parameters
    ----------
    model : ModelClass
    linear : Linearised
        At its fit, with what it lacks.
    fitter : Fitter
    behind : float
        By how much its logarithm of probability lies below the best: what is added must catch up.
    """
    odds = fitter.log_priors(linear.lacking, model.effects)
    gains = linear.gains + odds
    order = ranking.order(gains)
    floor = max(float(gains[order[0]]), 0.0, behind) - WITHIN
    # Far from the data the model is not linear: the order of the gains still says something, their sizes do not.
    least = MOST_FURTHER if _far_off(model) else LEAST_FURTHER
    single = [linear.lacking[i] for at, i in enumerate(order[:MOST_FURTHER]) if at < least or gains[i] > floor]
    if model.improbable:
        # What leaves the accuracy of some data open shows all that it is worth only once they weigh less.
        by_gain = [linear.lacking[i] for i in ranking.order(linear.gains)]
        single += [placed for placed in by_gain if placed.effect.rescales][:RESCALING]
    several = model.effects.union(linear.forward(odds))
    return [*(model.effects | {placed} for placed in single), several]


def _far_off(model: ModelClass) -> bool:
    """Whether the residuals of a set are too large for its linearised model to tell how much an effect brings."""
    assert model.estimate is not None
    at = model.estimate.fit.at
    return at.objective > HOPELESS * len(at.r)


def named_entries(model: ModelClass, fitter: Fitter) -> list[FitProposal]:
    """Propose the sets in which the entries of an open class that stand out are causes of the catalogue, it gone.

    Several large changes at once are hardly seen by derivatives at none of them; the class has found their sizes.
    """
    estimate, experiment = model.estimate, fitter.experiment
    assert estimate is not None, "only sets with a fit are expanded"
    known = {(item.placed.effect.name, item.placed.place): item.placed for item in fitter.hypotheses}
    proposals = []
    for placed in model.effects:
        if not isinstance(placed.effect, OpenClass):
            continue
        own = estimate.own(placed)
        values = estimate.theta[own]
        standing = placed.effect.conspicuous(values, estimate.std[own])
        causes = {
            known[at]: float(values[i])
            for i in standing
            if (at := placed.effect.cause_at(i, placed.place, experiment)) in known
        }
        if not causes:
            continue
        rest = [each for each in estimate.effects if each is not placed]
        new = [cause for cause in causes if cause not in rest]
        proposal = fitter.proposal(estimate, (*rest, *new))
        bounds = [(item.lower, item.upper) for each in new for item in each.effect.parameters]
        sizes = np.clip([causes[each] for each in new], *np.reshape(bounds, (-1, 2)).T)
        start = np.concatenate([proposal.starts[-1][: len(proposal.starts[-1]) - len(new)], sizes])
        proposals.append(dataclasses.replace(proposal, starts=(start,)))
    return proposals


def with_motions(base: Estimate, fitter: Fitter, best: ModelClass) -> list[FitProposal]:
    """Propose sets of the shear model and one effect that brings a motion of its own, the most promising starts first.

    Where the best set explains the data, those of a step that leaves much more than it does are not followed.
    """
    motions = [item.placed for item in fitter.hypotheses if item.placed.effect.adds_motion]
    assert best.estimate is not None, "a best set has a fit"
    most = np.inf if best.improbable else NEAR_ENOUGH * best.estimate.fit.at.objective
    return _from_starts([(fitter.proposal(base, (*base.effects, motion)), motion) for motion in motions], base, most)


def with_companions(base: Estimate, fitter: Fitter, best: ModelClass) -> list[FitProposal]:
    """Propose the best set with the other of a motion and its companion, from the shear model's frame and all starts.

    With the companion the motion may be another one, which the fit without it is far from; and something else at the
    same place, such as a lighter floor, may have stood for it.
    """
    assert best.estimate is not None, "a best set has a fit"
    looked_for = [item.placed for item in fitter.hypotheses]
    pairs = [
        (companion, motion)
        for motion in looked_for
        if motion.effect.adds_motion
        for companion in looked_for
        if (companion.effect.companion, companion.place) == (motion.effect.name, motion.place)
        and len(best.effects & {companion, motion}) == 1
    ]
    proposals = []
    for pair in pairs:
        beside = [placed for placed in best.estimate.effects if placed not in pair]
        elsewhere = [placed for placed in beside if placed in fitter.assumed or placed.place != pair[1].place]
        others = (beside, elsewhere) if len(elsewhere) < len(beside) else (beside,)
        proposals += [(fitter.proposal(best.estimate, (*rest, *pair)), pair[1]) for rest in others]
    return _from_starts(proposals, base, np.inf)


def _from_starts(proposals: Sequence[tuple[FitProposal, Placed]], base: Estimate, most: float) -> list[FitProposal]:
    """Start each proposal from the frame of the base and every start of the motion that is its last effect.

    Derivatives at a mass of none say nothing of it: one step from each of its starts tells which of them to follow.
    """
    frame = 2 * base.experiment.stories
    started = [
        dataclasses.replace(
            proposal, starts=(np.concatenate([base.theta[:frame], proposal.starts[-1][frame : -len(start)], start]),)
        )
        for proposal, motion in proposals
        for start in motion.effect.starts
    ]
    left = np.array([_after_a_step(proposal) for proposal in started])
    return [started[i] for i in ranking.order(-left)[:MOTIONS] if left[i] <= most]


def from_frames(starts: Sequence[tuple[Set, Floats]], base: Estimate, fitter: Fitter) -> list[FitProposal]:
    """Propose fits of sets that start at frames of their own, those that promise most after one step first.

    Parameters
    ----------
    starts : sequence of (frozenset of Placed, ndarray of shape (2N,))
    base : Estimate
        Whose data and noise they have.
    fitter : Fitter
    """
    proposals = []
    for effects, frame in starts:
        present = [item.placed for item in fitter.hypotheses if item.placed in effects]
        plain = fitter.proposal(base, (*fitter.assumed, *present))
        start = np.concatenate([frame, plain.starts[-1][len(frame) :]])
        proposals.append(dataclasses.replace(plain, starts=(start,)))
    return sorted(proposals, key=_after_a_step)[:FROM_FRAMES]


def _after_a_step(proposal: FitProposal) -> float:
    """Return the objective that the linearised model has after one step of all parameters from a start."""
    try:
        at = proposal.misfit.evaluate(proposal.starts[0])
    except NoModesError:
        return np.inf
    _, c = at.triangle
    return at.objective - float(c @ c)


def groups(effects: Set, *, open_too: bool) -> list[Set]:
    """List the groups of two effects or more: of a state, of a name, all; and, where wanted, each open class."""
    by_state, by_name = defaultdict[str | None, set[Placed]](set), defaultdict[str, set[Placed]](set)
    for placed in effects:
        by_name[placed.effect.name].add(placed)
        if placed.place.state is not None:
            by_state[placed.place.state].add(placed)
    found = [frozenset(group) for group in (*by_state.values(), *by_name.values(), set(effects))]
    classes = [frozenset([placed]) for placed in effects if open_too and placed.effect.kind == OPEN]
    return [group for group in dict.fromkeys((*found, *classes)) if len(group) > 1 or group in classes]


def holds_open(effects: Set) -> bool:
    """Whether an open class is among these effects."""
    return any(placed.effect.kind == OPEN for placed in effects)
