"""Neighbors of a fitted set of effects that are worth a fit.

With one effect more, or several, as the linearised model at its fit promises; with the causes that the entries
of an open class stand for; with an effect that brings a motion of its own; and the groups of its effects for which one
cause may stand.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from cvxshear.effects import LocatedEffect
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
"""Largest distance from the best set, in log probability, of a set that is followed up: a thousandth of the best
probability."""

MOTIONS = 12
"""Largest number of fits of effects that add degrees of freedom."""

FROM_FRAMES = 20
"""Largest number of fits that start at given frames. Each fit costs milliseconds, because frequencies are few."""

NEAR_ENOUGH = 4.0
"""Largest objective after a first step, relative to the objective of a set that explains the data. Far from its
optimum, a mass on its own spring is not linear, and further steps halve the objective after the first one."""

MOST_FURTHER = 10
LEAST_FURTHER = 1
RESCALING = 3
"""Most and least further effects, and effects on the accuracy of data, that are fitted when a set is expanded."""

Set = frozenset[LocatedEffect]


def promising(model: ModelClass, linear: Linearised, fitter: Fitter, behind: float) -> list[Set]:
    """List sets with one more effect, or several, by what the linearised model promises.

    Parameters
    ----------
    model : ModelClass
    linear : Linearised
        Linearised model at the fit of the set, with the effects that the set lacks.
    fitter : Fitter
    behind : float
        Distance of the set from the best in log probability; the added effects must close this distance.
    """
    odds = fitter.log_priors(linear.candidates, model.effects)
    gains = linear.gains + odds
    order = ranking.order(gains)
    floor = max(float(gains[order[0]]), 0.0, behind) - WITHIN
    # Far from the data the model is not linear: the order of the gains is still useful, their sizes are not.
    least = MOST_FURTHER if _far_off(model) else LEAST_FURTHER
    single = [linear.candidates[i] for at, i in enumerate(order[:MOST_FURTHER]) if at < least or gains[i] > floor]
    if model.improbable:
        # An effect that leaves the accuracy of some data open shows its full gain only after these data lose weight.
        by_gain = [linear.candidates[i] for i in ranking.order(linear.gains)]
        single += [placed for placed in by_gain if placed.effect.rescales][:RESCALING]
    several = model.effects.union(linear.forward(odds))
    return [*(model.effects | {placed} for placed in single), several]


def _far_off(model: ModelClass) -> bool:
    """Whether the residuals of a set are too large for a linear prediction of an effect's gain."""
    assert model.estimate is not None
    at = model.estimate.fit.at
    return at.objective > HOPELESS * len(at.r)


def named_entries(model: ModelClass, fitter: Fitter) -> list[FitProposal]:
    """Propose sets in which causes of the catalogue replace an open class: the causes of its significant entries.

    Derivatives at null hardly show several simultaneous large changes; the fitted class provides their sizes.
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
    """Propose sets of the shear model and one effect that adds degrees of freedom, the most promising starts first.

    If the best set explains the data, a start is dropped if its first step leaves a much larger objective.
    """
    motions = [item.placed for item in fitter.hypotheses if item.placed.effect.adds_motion]
    assert best.estimate is not None, "a best set has a fit"
    most = np.inf if best.improbable else NEAR_ENOUGH * best.estimate.fit.at.objective
    return _from_starts([(fitter.proposal(base, (*base.effects, motion)), motion) for motion in motions], base, most)


def with_companions(base: Estimate, fitter: Fitter, best: ModelClass) -> list[FitProposal]:
    """Propose the best set with both an effect that adds degrees of freedom and its companion.

    The best set holds one of the two. The fits begin at the shear model's frame and at all starts of the effect. With
    the companion the optimum may be far from the fit without it. Another effect at the same place, such as a lighter
    floor, may have imitated the missing one, so the pair is also tried without the other effects of this place.
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


def _from_starts(
    proposals: Sequence[tuple[FitProposal, LocatedEffect]], base: Estimate, most: float
) -> list[FitProposal]:
    """Start each proposal from the frame of the base and from every start of its last effect.

    Derivatives at zero mass carry no information on the effect, so one step from each start selects the starts to
    follow.
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
    """Propose fits of sets that start at given frames, those with the lowest objective after one step first.

    Parameters
    ----------
    starts : sequence of (frozenset of LocatedEffect, ndarray of shape (2N,))
    base : Estimate
        Estimate that provides the data and the noise.
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
    """List groups of at least two effects: by state, by name, and all; if wanted, also each open class alone."""
    by_state, by_name = defaultdict[str | None, set[LocatedEffect]](set), defaultdict[str, set[LocatedEffect]](set)
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
