"""What the loop looks for: every effect at every place, each with the odds that it is there beforehand."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.effects import Effect, Place, Placed, catalogue, open_classes
from cvxshear.effects.guests import refuse_faulty, refuse_repeated
from cvxshear.measurement.experiment import ExpectedEffect, Experiment
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import T

OPEN = "open"
"""Kind of the open classes, and the name that stands for all of them."""


@dataclass(frozen=True)
class Hypothesis:
    """An effect at a place, before anything is measured.

    Parameters
    ----------
    placed : Placed
    probability : float
        That it is there.
    size : float or None
        Standard deviation of its first parameter, where the experiment knows better than the effect.
    """

    placed: Placed
    probability: float
    size: float | None = None

    @property
    def log_odds(self) -> float:
        """Logarithm of the odds that it is there."""
        return log_odds(self.probability)


def log_odds(probability: float) -> float:
    """Logarithm of the odds of a probability."""
    return float(np.log(probability) - np.log1p(-probability))


def hypotheses(experiment: Experiment, effects: Sequence[Effect], there: Sequence[Placed] = ()) -> list[Hypothesis]:
    """Everything that can be looked for.

    An effect's probability is spread over its places by their weights: one with the share s of them all has
    1 - (1 - p)^s, so that the effect is somewhere with the probability p. Where a reference is named, every other state
    is one in which something may have been done to the frame: p is then that of each state, and spread over its floors
    or stories. That of an open class is for all states together: a statement of the shear model either holds for a
    frame or does not.

    Parameters
    ----------
    experiment : Experiment
        With what it expects of effects.
    effects : sequence of Effect
    there : sequence of Placed, optional
        Already in the model.

    Raises
    ------
    InputError
        Where the experiment expects something of an effect that there is not.
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
    """One effect at its places, but where it is excluded."""
    said = {place: _said(experiment, effect, place) for place in effect.places(experiment)}
    places = [place for place, known in said.items() if not any(each.exclude for each in known)]
    by_state = experiment.frame.reference is not None and effect.kind != OPEN

    def share(place: Place, among: Iterable[Place]) -> float:
        alike = [other for other in among if not by_state or other.state == place.state]
        return effect.weight(place, experiment) / sum(effect.weight(other, experiment) for other in alike)

    return [
        Hypothesis(
            Placed(effect.bound_at(experiment, place), place),
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
    """Say what the experiment expects of an effect at a place, the most general first."""
    at = dataclasses.asdict(place)
    names = (effect.name, OPEN) if effect.kind == OPEN else (effect.name,)
    said = [each for each in experiment.expected if any(each.concerns(name, at) for name in names)]
    return sorted(said, key=lambda each: sum(getattr(each, part, None) is not None for part in at))


def _spread(probability: float, share: float) -> float:
    return float(-np.expm1(np.log1p(-probability) * share))


def _last(values: Sequence[T], default: T) -> T:
    return values[-1] if values else default


def chosen(effects: Sequence[str | Effect] | None) -> tuple[Effect, ...]:
    """List the effects to look for: names or objects, the whole catalogue and the open classes where none are given.

    The name "open" stands for all open classes.

    Raises
    ------
    InputError
        Where there is none of a name.
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


def able_to_take_part(
    wanted: Sequence[Effect], experiment: Experiment
) -> tuple[tuple[Effect, ...], tuple[str, ...]]:
    """List the effects that can take part, and messages that say why others, of one's own, cannot.

    Raises
    ------
    InputError
        Where two go by one name, or the only one cannot take part.
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


def assumed(experiment: Experiment, assume: Sequence[str | Placed]) -> tuple[Placed, ...]:
    """List the effects that are declared from the start; one named alone must have only one place to sit.

    Raises
    ------
    InputError
        Where an effect is not known, the experiment does not declare what it needs, or its place is not said.
    """
    result = []
    for each in assume:
        if isinstance(each, Placed):
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
                "close_loop(assume=[Placed(effect, Place(...))])"
            )
        result.append(Placed(effect, places[0]))
    return tuple(result)
