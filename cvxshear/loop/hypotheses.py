"""Hypotheses of the loop: every effect at every place, and the numbers of the modes, each with its prior odds.

A test may overlook a mode, because every sensor stands near a node or the excitation did not drive the mode. Then the
next mode takes its number, and all higher modes shift. Shapes known at every floor determine the number by their
changes of sign. Shapes at a few floors and frequencies alone do not, and a wrong number then requires effects that are
absent. So other numberings are weighed by their evidence. These are the ones that a configuration names
(`other_modes`). If the given numbers require an effect or leave a residual, each mode except the lowest is also assumed
overlooked in turn.

Frequencies alone also admit a second frame. A chain of N stories k_i and floors m_i has the eigenvalues of the chain
with stories 1 / m_(N+1-i) and floors 1 / k_(N+1-i), up to scale. So every set of effects has a dual that fits equally
well, in which a loss in story j is a mass on floor N+1-j (`Effect.dual`). With added mass in some tests the dual fits
worse or better, and lies near its own minimum. No fit from the first frame reaches this minimum, so sets of effects are
also visited from this frame.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from cvxshear.effects import Effect, LocatedEffect, Place, catalogue, open_classes, refuse_faulty, refuse_repeated
from cvxshear.measurement.experiment import Configuration, ExpectedEffect, Experiment
from cvxshear.measurement.reading import MeasuredModes, violations
from cvxshear.util import checks, errors
from cvxshear.util.typing import Floats, Ints, Json, T

#: Kind of the open classes, and the common name of all of them.
OPEN = "open"

#: Smallest number of kinds of effects in one state (or in the frame) that an unknown cause may imitate.
MANY_CAUSES = 3

#: Default probability that a test overlooked a mode between its modes. Ambient tests of tall buildings lose a mode more
#: often, tests with a shaker or a hammer hardly ever.
OVERLOOKED = 0.05

#: Configurations and their modes, if other than the given ones.
Changes = tuple[tuple[str, tuple[int, ...]], ...]


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
    experiment: Experiment, effects: Sequence[Effect], assumed: Sequence[LocatedEffect] = ()
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
    assumed : sequence of LocatedEffect, optional
        Effects that the model holds already.

    Raises
    ------
    InputError
        If the experiment declares a prior for an unknown effect.
    """
    known = {OPEN, *(effect.name for effect in (*catalogue(), *open_classes(), *effects))}
    for each in experiment.expected:
        checks.choice(each.name, sorted(known), "effect: name")
    taken = {(placed.effect.name, placed.place) for placed in assumed}
    return [
        item
        for effect in (each.bound(experiment) for each in effects)
        if not effect.unavailable(experiment)
        for item in _of(effect, experiment)
        if (effect.name, item.placed.place) not in taken
    ]


def _of(effect: Effect, experiment: Experiment) -> list[Hypothesis]:
    """List one effect at its places, except the excluded ones."""
    said = {place: _said(experiment, effect, place) for place in effect.places(experiment)}
    places = [place for place, known in said.items() if not any(each.exclude for each in known)]
    by_state = experiment.frame.reference is not None and effect.kind != OPEN
    weights = {place: effect.weight(place, experiment) for place in places}
    totals = defaultdict[tuple[object, str | None], float](float)
    for place in places:
        for source in (None, *map(id, said[place])):
            totals[source, place.state if by_state else None] += weights[place]

    def spread(probability: float, place: Place, source: object = None) -> float:
        share = weights[place] / totals[source, place.state if by_state else None]
        return float(-np.expm1(np.log1p(-probability) * share))

    return [
        Hypothesis(
            LocatedEffect(effect.bound_at(experiment, place), place),
            _last(
                [spread(each.probability, place, id(each)) for each in said[place] if each.probability is not None],
                spread(effect.probability, place),
            ),
            _last([each.size for each in said[place] if each.size is not None], None),
        )
        for place in places
    ]


def _said(experiment: Experiment, effect: Effect, place: Place) -> list[ExpectedEffect]:
    """List the experiment's priors for an effect at a place, the most general first."""
    at = asdict(place)
    names = (effect.name, OPEN) if effect.kind == OPEN else (effect.name,)
    said = [each for each in experiment.expected if any(each.concerns(name, at) for name in names)]
    return sorted(said, key=lambda each: sum(getattr(each, part, None) is not None for part in at))


def _last(values: Sequence[T], default: T) -> T:
    return values[-1] if values else default


def chosen(effects: Sequence[str | Effect] | None, experiment: Experiment) -> tuple[Effect, ...]:
    """List the effects to look for: names or objects; by default all of the catalogue and the open classes that suit.

    The name "open" stands for all open classes.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    everything = (*catalogue(), *open_classes())
    if effects is None:
        return tuple(effect for effect in everything if effect.suits(experiment))
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
        except errors.InputError as error:
            if len(wanted) == 1:
                raise
            messages.append(str(error))
    return tuple(sound), tuple(messages)


def assumed_effects(experiment: Experiment, assume: Sequence[str | LocatedEffect]) -> tuple[LocatedEffect, ...]:
    """List the effects that are declared from the start; a name alone means the whole frame, or the only place.

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
        effect = chosen([each], experiment)[0].bound(experiment)
        if lack := effect.unavailable(experiment):
            raise errors.InputError(f"effect {each} cannot be assumed: the experiment does not declare {lack}")
        places = effect.places(experiment)
        places = [place for place in places if place == Place()] or places
        if len(places) > 1:
            raise errors.InputError(
                f"effect {each} can sit at {len(places)} places; which one is said in Python: "
                "close_loop(assume=[LocatedEffect(effect, Place(...))])"
            )
        result.append(LocatedEffect(effect, places[0]))
    return tuple(result)


@dataclass(frozen=True, eq=False)
class Numbering:
    """Experiment under one numbering of its modes.

    Parameters
    ----------
    experiment : Experiment
    log_odds : float
        Logarithm of the prior odds of these numbers against the given ones.
    changes : tuple of (str, tuple of int)
        Name and modes of each configuration whose modes differ from the given ones.
    """

    experiment: Experiment
    log_odds: float = 0.0
    changes: Changes = ()


@dataclass(frozen=True)
class NumberingProbability:
    """Probability of a numbering.

    Parameters
    ----------
    changes : tuple of (str, tuple of int)
        As in `Numbering`; empty for the given numbers.
    probability : float
    """

    changes: Changes
    probability: float

    def to_dict(self) -> Json:
        """Return the changes and their probability."""
        return {"changes": changes_to_dict(self.changes), "probability": self.probability}


def changes_to_dict(changes: Changes) -> list[Json]:
    """Return the configuration and the modes of each change."""
    return [{"configuration": name, "modes": list(modes)} for name, modes in changes]


def named_numberings(experiment: Experiment) -> list[Numbering]:
    """List the other numberings that configurations name, applied to all configurations that name them or to one."""
    named: dict[tuple[int, ...], dict[str, float]] = {}
    for each in experiment.configurations:
        rest = 1.0 - sum(other.probability for other in each.other_modes)
        for other in each.other_modes:
            named.setdefault(tuple(other.modes.tolist()), {})[each.name] = other.probability / rest
    return [
        item
        for modes, odds in named.items()
        for item in _together_or_alone(experiment, [(name, modes) for name in odds], max(odds.values()))
    ]


def overlooked_in_all(experiment: Experiment) -> list[Numbering]:
    """List the numberings in which all configurations that may have overlooked a mode did so."""
    return [item[0] for item in _overlooked(experiment)]


def overlooked_in_one(experiment: Experiment) -> list[Numbering]:
    """List the numberings in which one configuration overlooked a mode that the others found."""
    return [each for item in _overlooked(experiment) for each in item[1:]]


def _overlooked(experiment: Experiment) -> list[list[Numbering]]:
    """List the numberings for each mode that may be overlooked: in all configurations, and in each alone."""
    highest = max(int(each.modes[-1]) for each in experiment.configurations)
    lost = [changes for mode in range(2, highest + 1) if (changes := _without(experiment, mode))]
    odds = OVERLOOKED / (1.0 - OVERLOOKED) / max(len(lost), 1)
    return [_together_or_alone(experiment, changes, odds) for changes in lost]


def _together_or_alone(
    experiment: Experiment, changes: Sequence[tuple[str, tuple[int, ...]]], odds: float
) -> list[Numbering]:
    """List the numbering with all the changes, then those with one change; each group gets half of the odds.

    Configurations of one frame lose a mode for the same reason.
    """
    several = len(changes) > 1
    sets = [(tuple(changes), odds / 2 if several else odds)]
    if several:
        sets += [((each,), odds / 2 / len(changes)) for each in changes]
    return [Numbering(_renumbered(experiment, changed), float(np.log(prior)), changed) for changed, prior in sets]


def _without(experiment: Experiment, mode: int) -> list[tuple[str, tuple[int, ...]]]:
    """List the configurations that may have overlooked a mode, with the new modes, unless they name these modes."""
    found = []
    # Modes of floors that turn are paired by their shapes.
    for each in () if experiment.frame.turns else experiment.configurations:
        moved = tuple(_moved(each.modes, mode).tolist())
        named = any(tuple(other.modes.tolist()) == moved for other in each.other_modes)
        if not named and _may_be_overlooked(each, mode, experiment.stories):
            found.append((each.name, moved))
    return found


def _may_be_overlooked(configuration: Configuration, mode: int, stories: int) -> bool:
    """Whether the mode with this number may be the next higher one, and so all modes above.

    The lowest mode is never overlooked. Shapes known at every floor confirm the given numbers, unless their changes of
    sign contradict them.
    """
    modes = configuration.modes
    if mode not in modes[1:] or modes[-1] >= stories:
        return False
    above = configuration.measured[modes >= mode]
    whole = above.shape[1] == stories and bool(above.all(axis=1).any())
    return not whole or bool(violations(MeasuredModes.of(configuration)))


def _moved(modes: Ints, lost: int) -> Ints:
    return np.where(modes >= lost, modes + 1, modes)


def _renumbered(experiment: Experiment, changes: Changes) -> Experiment:
    modes = dict(changes)
    configurations = tuple(
        replace(each, modes=np.array(modes[each.name]), other_modes=()) if each.name in modes else each
        for each in experiment.configurations
    )
    return replace(experiment, configurations=configurations)


def few_floors_seen(experiment: Experiment) -> bool:
    """Whether no test measured more than half of the floors: very different frames may fit such data equally well.

    Sensors of floors that turn are at all of them.
    """
    return not experiment.frame.turns and not any(
        2 * each.measured.any(axis=0).sum() > experiment.stories for each in experiment.configurations
    )


def dual_fits_as_well(experiment: Experiment) -> bool:
    """Whether only frequencies were measured, without added mass.

    Such data do not distinguish a frame from its dual.
    """
    return not experiment.static and not any(
        each.measured.any() or np.any(each.added_mass) for each in experiment.configurations
    )


def dual_frame(frame: Floats) -> Floats:
    """Return the masses and stiffnesses of the dual frame of the same total mass, shape (2N,).

    Parameters
    ----------
    frame : ndarray, shape (2N,)
        Floor masses and story stiffnesses, kg and N/m.
    """
    floor_mass, story_stiffness = np.split(frame, 2)
    scale = floor_mass.sum() / np.sum(1.0 / story_stiffness)
    dual: Floats = scale * np.concatenate([1.0 / story_stiffness[::-1], 1.0 / floor_mass[::-1]])
    return dual


def dual_set(
    effects: frozenset[LocatedEffect], known: Sequence[LocatedEffect], stories: int
) -> frozenset[LocatedEffect] | None:
    """Find the effects of the dual frame that give the same frequencies; None if an effect has no dual.

    Parameters
    ----------
    effects : frozenset of LocatedEffect
    known : sequence of LocatedEffect
        All effects that are looked for.
    stories : int
    """
    by_place: dict[object, LocatedEffect] = {(placed.effect.name, placed.place): placed for placed in known}
    duals = [placed.effect.dual(placed.place, stories) for placed in effects]
    return frozenset(by_place[dual] for dual in duals) if all(dual in by_place for dual in duals) else None
