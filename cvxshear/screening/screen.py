"""Everything that looks wrong in an experiment, before anything is fitted to it."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

import numpy as np

from cvxshear.measurement.declaration import NUMBERS
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.measurement.reading import Reading
from cvxshear.measurement.sign_rule import violations
from cvxshear.screening.finding import Finding
from cvxshear.screening.mistakes import TALLEST, Verdict, judge
from cvxshear.screening.total_mass import total_mass
from cvxshear.screening.units import angular_frequency, gravity, heights, masses
from cvxshear.util.errors import InputError

DOUBTS = (angular_frequency, heights, masses, gravity)
"""What is looked for in the declaration, whatever the shapes are like."""

SHOWN = 3
"""Modes of impossible signs that a finding lists."""


def screen(experiment: Experiment) -> tuple[Finding, ...]:
    """What looks wrong in an experiment.

    Parameters
    ----------
    experiment : Experiment

    Returns
    -------
    tuple of Finding
        Mistakes first, then warnings; without those that `[frame] accept` lists.
    """
    found = [item for each in experiment.configurations for item in mistakes(each)]
    # Shapes that are wrong tell no mass.
    for doubt in DOUBTS if found else (total_mass, *DOUBTS):
        said = {item.name for item in found}
        found += [item for item in doubt(experiment) if item.name not in said]
    return tuple(item for item in found if not item.accepted(experiment.frame.accept))


def refuse_mistakes(experiment: Experiment, weighed: Collection[str] = ()) -> tuple[Finding, ...]:
    """The warnings of `screen`, where nothing refuses.

    Parameters
    ----------
    experiment : Experiment
    weighed : collection of str, optional
        Configurations of which what follows weighs the numbers of the modes itself; that they look wrong is a warning.

    Raises
    ------
    InputError
        Naming the first mistake found, what to change and how to accept it.
    """
    found = tuple(
        dataclasses.replace(item, refuses=item.refuses and not _left_to_the_loop(item, weighed))
        for item in screen(experiment)
    )
    for item in found:
        if item.refuses:
            where = f'configuration "{item.configuration}": ' if item.configuration else ""
            raise InputError(
                f"{where}{item.found}. To mend it: {item.change}; or, if it is right as it is: {item.how_to_accept}"
            )
    return found


def _left_to_the_loop(item: Finding, weighed: Collection[str]) -> bool:
    return item.name in NUMBERS and item.configuration in weighed


def mistakes(configuration: Configuration) -> list[Finding]:
    """The mistake in one configuration's modes, if there is one."""
    if not configuration.measured.any():
        return []
    reading = Reading.of(configuration)
    broken = violations(reading)
    verdict = judge(reading) if reading.stories <= TALLEST else None
    if verdict is not None and verdict.told:
        return [_told(configuration.name, verdict, broken)]
    if not broken:
        return []
    change = "no single change mends it: look for more than one mistake" if verdict else "look for a mistake"
    found = "; ".join(broken[:SHOWN]) + ("; and so on" if len(broken) > SHOWN else "")
    return [Finding("signs", configuration.name, found, f"{change} in mode_shapes and modes", refuses=True)]


def _told(name: str, verdict: Verdict, broken: list[str]) -> Finding:
    """The finding of a mistake that one change mends, or one of several."""
    told = verdict.told
    names = list(dict.fromkeys(item.repair.name for item in told))
    evidence = broken[0] if broken else "no shear frame has these modes"
    before, after = (float(np.sqrt(cost)) for cost in (verdict.given.cost, told[0].cost))
    return Finding(
        names[0],
        name,
        f"{' or '.join(item.repair.found for item in told)}: {evidence} (the nearest frame is {before:.0f} standard "
        f"deviations away, with the change {after:.0f})",
        f"{'One of: ' if len(told) > 1 else ''}{'; or '.join(item.repair.change for item in told)}",
        refuses=True,
        rivals=tuple(names[1:]),
    )
