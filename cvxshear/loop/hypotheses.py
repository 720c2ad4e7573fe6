"""Hypotheses of the loop: every effect at every place, each with its prior odds."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.effects import Effect, LocatedEffect, Place, catalogue, open_classes
from cvxshear.effects.custom_effect_checks import refuse_faulty, refuse_repeated
from cvxshear.measurement.experiment import ExpectedEffect, Experiment
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import T

OPEN = "open"
"""Kind of the open classes, and the common name of all of them."""


@dataclass(frozen=True)
class Hypothesis:
    """Effect at a place, with its prior.

    Parameters
    ----------
    placed : LocatedEffect
    probability : float
        Prior probability that the effect is present.
    size : float or None
        Standard deviation of the first parameter, if the experiment declares one in place of the effect's default.
    """

    placed: LocatedEffect
    probability: float
    size: float | None = None

    @property
    def log_odds(self) -> float:
        """Logarithm of the prior odds that the effect is present."""
        return log_odds(self.probability)


def log_odds(probability: float) -> float:
    """Return the logarithm of the odds of a probability."""
    return float(np.log(probability) - np.log1p(-probability))


def hypotheses(
    experiment: Experiment, effects: Sequence[Effect], there: Sequence[LocatedEffect] = ()
) -> list[Hypothesis]:
    """List all hypotheses.

    An effect's probability p is spread over its places by their weights. A place with the share s of all weights has
    the probability 1 - (1 - p)^s, so the effect is present at one or more places with the probability p. If a reference
    state is named, the frame may have been changed in every other state: p then holds for each state, and is spread
    over its floors or stories. The probability of an open class holds for all states together, because a statement of
    the shear model either holds for a frame or does not.

    Parameters
    ----------
    experiment : Experiment
        Experiment with its priors of effects.
    effects : sequence of Effect
    there : sequence of LocatedEffect, optional
        Effects that the model holds already.

    Raises
    ------
    InputError
        If the experiment declares a prior for an unknown effect.
    """
    known = {OPEN, *(effect.name for effect in (*catalogue(), *open_classes(), *effects))}
    for each in experiment.expected:
        checks.choice(each.name, sorted(known), "effect: name")
    taken = {(placed.effect.name, placed.place) for placed in there}
    return [
        item
        for effect in (each.bound(experiment) for each in effects)
        if not effect.lacks(experiment)
        for item in _of(effect, experiment)
        if (effect.name, item.placed.place) not in taken
    ]


def _of(effect: Effect, experiment: Experiment) -> list[Hypothesis]:
    """List one effect at its places, except the excluded ones."""
    said = {place: _said(experiment, effect, place) for place in effect.places(experiment)}
    places = [place for place, known in said.items() if not any(each.exclude for each in known)]
    by_state = experiment.frame.reference is not None and effect.kind != OPEN

    def share(place: Place, among: Iterable[Place]) -> float:
        alike = [other for other in among if not by_state or other.state == place.state]
        return effect.weight(place, experiment) / sum(effect.weight(other, experiment) for other in alike)

    return [
        Hypothesis(
            LocatedEffect(effect.bound_at(experiment, place), place),
            _last(
                [
                    _spread(each.probability, share(place, [other for other in places if each in said[other]]))
                    for each in said[place]
                    if each.probability is not None
                ],
                _spread(effect.probability, share(place, places)),
            ),
            _last([each.size for each in said[place] if each.size is not None], None),
        )
        for place in places
    ]


def _said(experiment: Experiment, effect: Effect, place: Place) -> list[ExpectedEffect]:
    """List the experiment's priors for an effect at a place, the most general first."""
    at = dataclasses.asdict(place)
    names = (effect.name, OPEN) if effect.kind == OPEN else (effect.name,)
    said = [each for each in experiment.expected if any(each.concerns(name, at) for name in names)]
    return sorted(said, key=lambda each: sum(getattr(each, part, None) is not None for part in at))


def _spread(probability: float, share: float) -> float:
    return float(-np.expm1(np.log1p(-probability) * share))


def _last(values: Sequence[T], default: T) -> T:
    return values[-1] if values else default


def chosen(effects: Sequence[str | Effect] | None) -> tuple[Effect, ...]:
    """List the effects to look for: names or objects; by default the whole catalogue and the open classes.

    The name "open" stands for all open classes.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    everything = (*catalogue(), *open_classes())
    if effects is None:
        return everything
    known = {effect.name: (effect,) for effect in everything} | {OPEN: open_classes()}
    return tuple(
        effect
        for each in effects
        for effect in ((each,) if isinstance(each, Effect) else known[checks.choice(each, list(known), "effect")])
    )


def able_to_take_part(wanted: Sequence[Effect], experiment: Experiment) -> tuple[tuple[Effect, ...], tuple[str, ...]]:
    """List the usable effects, and messages that explain why user-defined effects are unusable.

    Raises
    ------
    InputError
        If two effects share one name, or the only effect is unusable.
    """
    refuse_repeated(wanted)
    own = {id(effect) for effect in (*catalogue(), *open_classes())}
    sound: list[Effect] = []
    messages = []
    for effect in wanted:
        try:
            if id(effect) not in own:
                refuse_faulty(effect, experiment)
            sound.append(effect)
        except InputError as error:
            if len(wanted) == 1:
                raise
            messages.append(str(error))
    return tuple(sound), tuple(messages)


def assumed(experiment: Experiment, assume: Sequence[str | LocatedEffect]) -> tuple[LocatedEffect, ...]:
    """List the effects that are declared from the start; an effect given by name alone must have only one place.

    Raises
    ------
    InputError
        If an effect is unknown, the experiment lacks a declaration that it needs, or its place is missing.
    """
    result = []
    for each in assume:
        if isinstance(each, LocatedEffect):
            result.append(each)
            continue
        effect = chosen([each])[0].bound(experiment)
        if effect.lacks(experiment):
            raise InputError(
                f"effect {each} cannot be assumed: the experiment does not declare {effect.lacks(experiment)}"
            )
        places = effect.places(experiment)
        if len(places) > 1:
            raise InputError(
                f"effect {each} can sit at {len(places)} places; which one is said in Python: "
                "close_loop(assume=[LocatedEffect(effect, Place(...))])"
            )
        result.append(LocatedEffect(effect, places[0]))
    return tuple(result)
