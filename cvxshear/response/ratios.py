"""Damping ratios of all modes, from those that were measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.errors import InputError
from cvxshear.experiment import Configuration, Experiment
from cvxshear.typing import Bools, Floats

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
    declared : bool
        Whether the deviations of the measured ones are declared.
    """

    values: Floats
    std: Floats
    measured: Bools
    declared: bool

    def assumed(self) -> tuple[str, ...]:
        """What is taken for known and was not measured, in words."""
        said = []
        if not self.measured.all():
            names = ", ".join(str(j + 1) for j in np.flatnonzero(~self.measured))
            said.append(
                f"no damping ratio was measured of mode{'s' if (~self.measured).sum() > 1 else ''} {names}: the mean "
                f"of the others is taken, {100 * self.values[~self.measured][0]:.2g} % of critical within "
                f"{100 * ASSUMED_STD:g} %"
            )
        if not self.declared:
            said.append(
                f"no deviation of the damping ratios is declared (damping_ratio_std): {100 * DEFAULT_STD:g} % is taken"
            )
        return tuple(said)


def known(experiment: Experiment) -> bool:
    """Whether any configuration has damping ratios."""
    return any(each.damping_ratios is not None for each in experiment.configurations)


def damping_ratios(experiment: Experiment, configuration: Configuration) -> Ratios:
    """The ratios of a configuration, or the mean over all where it has none.

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
    sources = [each for each in sources if each.name == configuration.name] or sources
    n = experiment.stories
    total, squares, count = np.zeros(n), np.zeros(n), np.zeros(n)
    for each in sources:
        assert each.damping_ratios is not None
        std = np.full(len(each.modes), DEFAULT_STD) if each.damping_ratio_std is None else each.damping_ratio_std
        total[each.modes - 1] += each.damping_ratios
        squares[each.modes - 1] += std**2
        count[each.modes - 1] += 1
    seen = count > 0
    counted = np.where(seen, count, 1.0)
    values = np.where(seen, total / counted, total[seen].sum() / count[seen].sum())
    std = np.where(seen, np.sqrt(squares) / counted, ASSUMED_STD)
    return Ratios(values, std, seen, all(each.damping_ratio_std is not None for each in sources))
