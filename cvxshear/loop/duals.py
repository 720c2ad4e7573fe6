"""The other frame that has the same frequencies.

A chain of N stories k_i and floors m_i has the eigenvalues of the chain with stories 1 / m_(N+1-i) and floors
1 / k_(N+1-i), up to scale. So where frequencies alone were measured, without added mass, every set of effects has a
dual that fits as well: a loss in story j is a mass on floor N+1-j (`Effect.dual`). With added mass in some tests the
dual fits worse, or better, and is near a minimum of its own, to which no fit from the other frame leads.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects import Placed
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats


def few_floors_seen(experiment: Experiment) -> bool:
    """Whether no test shows more than half of the floors: frames far from each other may fit such data as well."""
    return not any(2 * each.measured.any(axis=0).sum() > experiment.stories for each in experiment.configurations)


def dual_fits_as_well(experiment: Experiment) -> bool:
    """Whether nothing but frequencies was measured, and no mass added: data that do not tell a frame from its dual."""
    return not experiment.static and not any(
        each.measured.any() or np.any(each.added_mass) for each in experiment.configurations
    )


def dual_frame(frame: Floats) -> Floats:
    """Masses and stiffnesses of the dual frame of the same total mass, shape (2N,).

    Parameters
    ----------
    frame : ndarray, shape (2N,)
        Floor masses and story stiffnesses, kg and N/m.
    """
    floor_mass, story_stiffness = np.split(frame, 2)
    scale = floor_mass.sum() / np.sum(1.0 / story_stiffness)
    dual: Floats = scale * np.concatenate([1.0 / story_stiffness[::-1], 1.0 / floor_mass[::-1]])
    return dual


def dual_set(effects: frozenset[Placed], known: Sequence[Placed], stories: int) -> frozenset[Placed] | None:
    """Find the effects of the dual frame that have the same frequencies; None where one of them has no dual.

    Parameters
    ----------
    effects : frozenset of Placed
    known : sequence of Placed
        All that are looked for.
    stories : int
    """
    by_place = {(placed.effect.name, placed.place): placed for placed in known}
    found = [placed.effect.dual(placed.place, stories) for placed in effects]
    duals = [by_place.get(each) if each is not None else None for each in found]
    return frozenset(each for each in duals if each is not None) if None not in duals else None
