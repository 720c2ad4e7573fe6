"""Everything that looks wrong in an experiment, before anything is fitted to it.

Which mistake, if any, explains what a configuration reads is a matter of odds, as in the loop. A reading, as given
and after each single repair, is compared with the nearest shear frame; the less its cost C (minus twice the
logarithm of the likelihood, `shear_fit`), the more probable it is:

    p(as given) ~ exp(-C / 2),        p(repair) ~ exp(-C_r / 2) q / K,

q the probability that a file has this kind of mistake and K the number of places where it can have been made. A reading
is refused where the repairs together leave less than `LEFT_TO_GIVEN` to it, and those that share the rest are named.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cvxshear.backends import Backend
from cvxshear.effects import Effect, LocatedEffect
from cvxshear.loop import LoopResult
from cvxshear.loop.close import search_for_effects
from cvxshear.measurement.declaration import NUMBERS
from cvxshear.measurement.experiment import Configuration, Measurement, opened
from cvxshear.measurement.reading import MeasuredModes, violations
from cvxshear.priors import Prior
from cvxshear.screening import repairs, shear_fit
from cvxshear.screening.compared_tests import frequency_units, look_alike, repeats, state_names
from cvxshear.screening.declared_masses import masses_declared, total_mass
from cvxshear.screening.doubts import DECLARED_DOUBTS
from cvxshear.screening.finding import FileFinding
from cvxshear.screening.repairs import Repair
from cvxshear.screening.shear_fit import ROUGH_STEPS, TALLEST_FITTED, NearestFrame
from cvxshear.screening.wrong_frequency import wrong_frequency
from cvxshear.util import ranking
from cvxshear.util.decorators import usual_arithmetic
from cvxshear.util.errors import InputError
from cvxshear.util.results import Shown

if TYPE_CHECKING:
    from cvxshear.records.record import Finding as RecordFinding

DOUBT_CHECKS = (*DECLARED_DOUBTS, repeats, state_names)
"""Checks of the declaration, independent of the shapes."""

SHOWN_MODES = 3
"""Modes of impossible signs that a finding lists."""

PLAUSIBLE = 4.0
"""Largest cost per datum of a repair that explains the reading."""

FAR_DATUM = 3.5
"""Data that are off by fewer standard deviations, the smaller tolerance included, are not wrong."""


MISDECLARED = ("sign", "unit", "swapped channels")
"""Kinds of remarks on a record that a change of its file settles; all others are of the record itself."""


@dataclass(frozen=True, repr=False)
class Screening(Shown):
    """What `check` shows of a file.

    Parameters
    ----------
    name : str
        Of the experiment.
    accepted : tuple of str
        Findings that the file declares to be known and right.
    findings : tuple of FileFinding
        Mistakes first, then doubts.
    record : tuple of records.record.Finding
        What the records behind it say of themselves; empty for a measurement file.
    """

    name: str
    accepted: tuple[str, ...]
    findings: tuple[FileFinding, ...]
    record: tuple[RecordFinding, ...] = ()

    json_keys = "name refused doubtful findings record"

    @staticmethod
    def of(experiment: Measurement, record: Iterable[RecordFinding] = ()) -> Screening:
        """Find what looks wrong in an experiment, and what was said of the records that it comes from."""
        experiment = opened(experiment)
        return Screening(experiment.name, tuple(experiment.frame.accept), screen(experiment), tuple(record))

    @property
    def refused(self) -> bool:
        """Whether the file is refused until a change or an acceptance."""
        return any(item.refuses for item in self.findings)

    @property
    def doubtful(self) -> bool:
        """Whether a doubt is open, or a record contradicts what its file declares of a sensor."""
        return bool(self.findings) or any(item.kind in MISDECLARED for item in self.record)


@usual_arithmetic
def screen(experiment: Measurement) -> tuple[FileFinding, ...]:
    """Find what looks wrong in an experiment.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in

    Returns
    -------
    tuple of FileFinding
        Mistakes first, then warnings; without those that `[frame] accept` lists.
    """
    experiment = opened(experiment)
    found = [*frequency_units(experiment), *(item for each in experiment.configurations for item in mistakes(each))]
    if not found and "frequency" not in experiment.frame.accept:
        found += wrong_frequency(experiment)
    # Frequencies and shapes that are wrong tell no mass.
    for doubt in DOUBT_CHECKS if found else (total_mass, masses_declared, look_alike, *DOUBT_CHECKS):
        said = {item.name for item in found}
        found += [item for item in doubt(experiment) if item.name not in said]
    return tuple(item for item in found if not item.accepted(experiment.frame.accept))


def refuse_mistakes(experiment: Measurement, weighed: Collection[str] = ()) -> tuple[FileFinding, ...]:
    """Return the warnings of `screen`, where nothing refuses.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in
    weighed : collection of str, optional
        Configurations whose mode numbers the loop weighs itself; wrong mode numbers are a warning there.

    Raises
    ------
    InputError
        The file has a mistake. The message names it, the change, and how to accept it.
    """
    experiment = opened(experiment)
    found = tuple(
        dataclasses.replace(item, refuses=False) if item.name in NUMBERS and item.configuration in weighed else item
        for item in screen(experiment)
    )
    for item in found:
        if item.refuses:
            where = f'configuration "{item.configuration}": ' if item.configuration else ""
            raise InputError(
                f"{where}{item.found}. To mend it: {item.change}; or, if it is right as it is: {item.how_to_accept}"
            )
    return found


@usual_arithmetic
def close_loop(
    experiment: Measurement,
    effects: Sequence[str | Effect] | None = None,
    assume: Sequence[str | LocatedEffect] = (),
    backend: str | Backend = "auto",
    priors: Sequence[Prior] = (),
    *,
    jobs: int = 1,
    weighed: Collection[str] = (),
) -> LoopResult:
    """Find the physical effects that the shear model lacks.

    The measurement is screened first. A mistake is an error; doubts are `warnings` of the result.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in
    effects : sequence of str or Effect, optional
        The effects to look for, as names or as objects of your own; the whole catalogue if None. An object brings its
        own probability and expected size (`Effect.expecting`).
    assume : sequence of str or LocatedEffect, optional
        Effects that are in the model from the start.
    backend : str or Backend, optional
    priors : sequence of Prior, optional
        Priors in addition to those of the experiment.
    jobs : int, optional
        Number of processes that fit sets of effects; -1 uses every core.
    weighed : collection of str, optional
        Names of the configurations whose mode numbers come from a record and not from a file. The loop weighs other
        numbers for them, so a number that looks wrong is a warning there and not a mistake.

    Returns
    -------
    LoopResult

    Raises
    ------
    InputError
        If the file holds a mistake that `[frame] accept` does not list, such as exchanged sensors; if an effect is not
        known, cannot be assumed for this experiment, or does not say how large it may be.
    NoSolutionError
        If this backend could not fit the shear model.
    """
    experiment = opened(experiment)
    # The loop weighs the mode numbers of a configuration with other_modes together with the effects.
    numbered_anew = [each.name for each in experiment.configurations if each.other_modes]
    doubts = refuse_mistakes(experiment, {*weighed, *numbered_anew})
    found = search_for_effects(experiment, effects, assume, backend, priors, jobs=jobs)
    return dataclasses.replace(found, warnings=doubts)


@dataclass(frozen=True, eq=False)
class WeighedRepair:
    """A repair and what is left after it.

    Parameters
    ----------
    repair : Repair
    cost : float
        Of its fit, less 2 log of its prior odds.
    """

    repair: Repair
    cost: float


def judge(reading: MeasuredModes) -> tuple[NearestFrame, list[WeighedRepair]]:
    """Compare a reading with shear frames, as given and after single repairs.

    Returns
    -------
    given : NearestFrame
        The frame nearest to the reading as given.
    explaining : list of WeighedRepair
        Repairs that explain the reading, best first; empty for a reading that needs no repair.
    """
    begin = shear_fit.starts(reading.stories)
    given = shear_fit.distance(reading, [*begin, *shear_fit.story_starts(reading, begin[:1])])
    if _may_stand(reading, given):
        return given, []
    robust = shear_fit.robust_fit(reading, given.theta)
    uneven = shear_fit.odd_starts(reading.stories)
    odd = shear_fit.fit(reading, [*uneven, *shear_fit.story_starts(reading, uneven)], most_steps=ROUGH_STEPS)
    given = min(given, shear_fit.distance(reading, [robust.theta, odd.theta]), key=lambda item: item.cost)
    if _may_stand(reading, given):
        return given, []
    references = [*begin, robust.theta]
    frames = [shear_fit.modes_at(theta) for theta in references]
    candidates = [repair for kind in repairs.KINDS for repair in kind(reading, frames)]
    misfits = np.array([[shear_fit.misfit(repair.reading, frame) for frame in frames] for repair in candidates])
    nearest = np.unique(np.argsort(misfits, axis=0, kind="stable")[: repairs.MOST_FITTED])
    first = {
        place: shear_fit.fit(candidates[place].reading, [references[np.argmin(misfits[place])]], most_steps=ROUGH_STEPS)
        for place in nearest.tolist()
    }
    order = ranking.ranked(first, lambda place: -first[place].cost)[: repairs.REFITTED]
    each = ((candidates[place], shear_fit.distance(candidates[place].reading, [first[place].theta])) for place in order)
    judged = sorted(
        (WeighedRepair(repair, frame.cost + repair.prior_cost) for repair, frame in each), key=lambda item: item.cost
    )
    best = judged[0]
    left = max(PLAUSIBLE * best.repair.reading.count, repairs.UNEXPLAINED * given.cost)
    if best.cost - best.repair.prior_cost > left or best.cost - given.cost > 2 * np.log(repairs.LEFT_TO_GIVEN):
        return given, []
    return given, [item for item in judged if item.cost - best.cost < repairs.RIVAL_COST]


def _may_stand(reading: MeasuredModes, given: NearestFrame) -> bool:
    """Return whether the reading needs no repair: its cost is too small for one, or noise explains all data."""
    return given.cost < repairs.SUSPICIOUS or shear_fit.farthest(reading.closer, given.modes) < FAR_DATUM


def mistakes(configuration: Configuration) -> list[FileFinding]:
    """Find the mistake in one configuration's modes, if there is one."""
    if not configuration.measured.any():
        return []
    reading = MeasuredModes.of(configuration)
    broken = violations(reading)
    tried = reading.stories <= TALLEST_FITTED
    if tried:
        given, explaining = judge(reading)
        if explaining:
            return [_explained(configuration.name, given, explaining, broken)]
    if not broken:
        return []
    change = "no single change mends it: look for more than one mistake" if tried else "look for a mistake"
    found = "; ".join(broken[:SHOWN_MODES]) + ("; and so on" if len(broken) > SHOWN_MODES else "")
    change += " in mode_shapes and modes, or leave out a mode that is of no shear frame: torsion, a swing on a floor"
    return [FileFinding("signs", configuration.name, found, change, refuses=True)]


def _explained(name: str, given: NearestFrame, explaining: list[WeighedRepair], broken: list[str]) -> FileFinding:
    """Describe a mistake that one change mends, or one of several."""
    best = explaining[0]
    changes = [(item.repair.name, item.repair.found, item.repair.change) for item in explaining]
    evidence = broken[0] if broken else "no shear frame has these modes"
    before, after = (float(np.sqrt(cost)) for cost in (given.cost, best.cost - best.repair.prior_cost))
    distances = f"(the nearest frame is {before:.0f} standard deviations away, with the change {after:.0f})"
    return FileFinding.of_changes(name, changes, f"{evidence} {distances}", refuses=True)
