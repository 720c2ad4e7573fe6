"""Which modes of the frame the measured ones are, as a hypothesis like the effects.

A mode that a test overlooked, because every sensor stands near a node of it or nothing drove it, makes the next one
count for it, and so all above. Shapes known at every floor tell the number by their changes of sign; shapes at a few
floors and frequencies alone do not, and a wrong number then asks for effects that are not there. So other numbers are
weighed by their evidence: those that a configuration names (`other_modes`), and where the numbers as given ask for an
effect, or leave a residual, each mode but the lowest as one that was overlooked.
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
"""Probability that a test overlooked a mode between those that it found, where nothing is said of it. Ambient tests of
tall buildings lose one more often, tests with a shaker or a hammer hardly ever."""

Changes = tuple[tuple[str, tuple[int, ...]], ...]
"""Configurations and the modes that they hold, where those are other than the ones given."""


@dataclass(frozen=True, eq=False)
class Numbering:
    """An experiment with its modes numbered in one way.

    Parameters
    ----------
    experiment : Experiment
    log_odds : float
        Logarithm of the odds of these numbers against those given, before anything is fitted.
    changes : tuple of (str, tuple of int)
        Name and modes of each configuration whose modes are other than those given.
    """

    experiment: Experiment
    log_odds: float = 0.0
    changes: Changes = ()


@dataclass(frozen=True)
class NumberingProbability:
    """How probable a numbering is.

    Parameters
    ----------
    changes : tuple of (str, tuple of int)
        As in `Numbering`; none for the numbers as given.
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
    """List the numbers that configurations name besides their own, in all of those that name them or in one."""
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
    """List the numbers that follow where all configurations that could have overlooked a mode have."""
    return [item[0] for item in _overlooked(experiment)]


def overlooked_in_one(experiment: Experiment) -> list[Numbering]:
    """List the numbers that follow where one configuration of several overlooked a mode that the others have."""
    return [each for item in _overlooked(experiment) for each in item[1:]]


def _overlooked(experiment: Experiment) -> list[list[Numbering]]:
    """For each mode that may have been overlooked the numbers that follow, in all configurations and in each alone."""
    highest = max(int(each.modes[-1]) for each in experiment.configurations)
    lost = [changes for mode in range(2, highest + 1) if (changes := _without(experiment, mode))]
    odds = OVERLOOKED / (1.0 - OVERLOOKED) / max(len(lost), 1)
    return [_together_or_alone(experiment, changes, odds) for changes in lost]


def _together_or_alone(
    experiment: Experiment, changes: Sequence[tuple[str, tuple[int, ...]]], odds: float
) -> list[Numbering]:
    """All the changes at once, then each by itself, half of the odds for either.

    Configurations of one frame lose a mode for the same reason.
    """
    several = len(changes) > 1
    sets = [(tuple(changes), odds / 2 if several else odds)]
    if several:
        sets += [((each,), odds / 2 / len(changes)) for each in changes]
    return [Numbering(_renumbered(experiment, changed), float(np.log(prior)), changed) for changed, prior in sets]


def _without(experiment: Experiment, mode: int) -> list[tuple[str, tuple[int, ...]]]:
    """List the configurations that may have overlooked a mode, with their modes then, where they do not name these."""
    found = []
    for each in experiment.configurations:
        moved = tuple(_moved(each.modes, mode).tolist())
        named = any(tuple(other.modes.tolist()) == moved for other in each.other_modes)
        if not named and _may_be_overlooked(each, mode, experiment.stories):
            found.append((each.name, moved))
    return found


def _may_be_overlooked(configuration: Configuration, mode: int, stories: int) -> bool:
    """Whether what goes by this number may be the next mode, and so all above.

    The lowest mode is not overlooked, and shapes known at every floor tell their numbers: those given, unless their
    signs speak against these.
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
