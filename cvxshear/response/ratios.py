"""Damping ratios of all modes, from those that were measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import ranged
from cvxshear.util.typing import Bools, Floats

DEFAULT_STD = 0.2
"""Relative, of a measured damping ratio whose deviation is not declared: what repeated tests scatter by."""

ASSUMED_STD = 0.5
"""Relative, of the damping ratio of a mode that was not measured."""


@dataclass(frozen=True, eq=False)
class Ratios:
    """Damping ratios of the N modes of a frame.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Fraction of critical; where not measured, the mean of those that were.
    std : ndarray, shape (N,)
        Relative.
    measured : ndarray of bool, shape (N,)
    tested : Configuration
        The state in which they were measured.
    """

    values: Floats
    std: Floats
    measured: Bools
    tested: Configuration

    def assumed(self) -> tuple[str, ...]:
        """What is taken for known and was not measured, in words."""
        said = []
        if not self.measured.all():
            names = ranged([int(j) + 1 for j in np.flatnonzero(~self.measured)])
            said.append(
                f"no damping ratio was measured of mode{'s' if (~self.measured).sum() > 1 else ''} {names}: the mean "
                f"of the others is taken, {100 * self.values[~self.measured][0]:.2g} % of critical within "
                f"{100 * ASSUMED_STD:g} %"
            )
        if self.tested.damping_ratio_std is None:
            said.append(
                f"no deviation of the damping ratios is declared (damping_ratio_std): {100 * DEFAULT_STD:g} % is taken"
            )
        return tuple(said)


def known(experiment: Experiment) -> bool:
    """Whether any configuration has damping ratios."""
    return any(each.damping_ratios is not None for each in experiment.configurations)


def damping_ratios(experiment: Experiment, configuration: Configuration) -> Ratios:
    """The ratios of a configuration, or of the first that has some where it has none.

    Parameters
    ----------
    experiment : Experiment
    configuration : Configuration
        By whose name its own ratios are found.

    Raises
    ------
    InputError
        Where no configuration declares any.
    """
    sources = [each for each in experiment.configurations if each.damping_ratios is not None]
    if not sources:
        raise InputError(
            "nothing tells how the frame is damped: give damping_ratios in [[configuration]] (fractions of critical, "
            "one a mode, or one number for all)"
        )
    tested = next((each for each in sources if each.name == configuration.name), sources[0])
    assert tested.damping_ratios is not None
    seen = np.zeros(experiment.stories, dtype=bool)
    seen[tested.modes - 1] = True
    values = np.full(experiment.stories, float(np.mean(tested.damping_ratios)))
    values[tested.modes - 1] = tested.damping_ratios
    std = np.full(experiment.stories, ASSUMED_STD)
    std[tested.modes - 1] = DEFAULT_STD if tested.damping_ratio_std is None else tested.damping_ratio_std
    return Ratios(values, std, seen, tested)
