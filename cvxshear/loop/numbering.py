"""Numbering of the measured modes, as a hypothesis like the effects.

A test may overlook a mode, because every sensor stands near a node or the excitation did not drive the mode. Then the
next mode takes its number, and all higher modes shift. Shapes known at every floor determine the number by their
changes of sign. Shapes at a few floors and frequencies alone do not, and a wrong number then requires effects that are
absent. So other numberings are weighed by their evidence. These are the ones that a configuration names
(`other_modes`). If the given numbers require an effect or leave a residual, each mode except the lowest is also assumed
overlooked in turn.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.measurement.reading import MeasuredModes, violations
from cvxshear.util.typing import Ints, Json

OVERLOOKED = 0.05
"""Default probability that a test overlooked a mode between its modes. Ambient tests of tall buildings lose a mode more
often, tests with a shaker or a hammer hardly ever."""

Changes = tuple[tuple[str, tuple[int, ...]], ...]
"""Configurations and their modes, if other than the given ones."""


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
    for each in experiment.configurations:
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
        dataclasses.replace(each, modes=np.array(modes[each.name]), other_modes=()) if each.name in modes else each
        for each in experiment.configurations
    )
    return dataclasses.replace(experiment, configurations=configurations)
