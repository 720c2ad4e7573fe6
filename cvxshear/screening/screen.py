"""Everything that looks wrong in an experiment, before anything is fitted to it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cvxshear.backends import Backend
from cvxshear.effects import Effect, LocatedEffect
from cvxshear.loop import LoopResult, close
from cvxshear.measurement.declaration import NUMBERS
from cvxshear.measurement.experiment import Measurement, opened
from cvxshear.priors import Prior
from cvxshear.screening import doubts, mistakes
from cvxshear.util import decorators, errors, results

if TYPE_CHECKING:
    from cvxshear.records.record import Finding as RecordFinding

#: Kinds of remarks on a record that a change of its file settles; all others are of the record itself.
MISDECLARED = ("sign", "unit", "swapped channels")


@dataclass(frozen=True, repr=False)
class Screening(results.Shown):
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
    findings: tuple[doubts.FileFinding, ...]
    record: tuple[RecordFinding, ...] = ()

    json_keys = "name refused doubtful findings record"

    @staticmethod
    def of(experiment: Measurement, record: Iterable[RecordFinding] = ()) -> Screening:
        """Find what looks wrong in an experiment, and what was said of the records that it comes from."""
        experiment = opened(experiment, turning=True)
        return Screening(experiment.name, tuple(experiment.frame.accept), screen(experiment), tuple(record))

    @property
    def refused(self) -> bool:
        """Whether the file is refused until a change or an acceptance."""
        return any(item.refuses for item in self.findings)

    @property
    def doubtful(self) -> bool:
        """Whether a doubt is open, or a record contradicts what its file declares of a sensor."""
        return bool(self.findings) or any(item.kind in MISDECLARED for item in self.record)


@decorators.usual_arithmetic
def screen(experiment: Measurement) -> tuple[doubts.FileFinding, ...]:
    """Find what looks wrong in an experiment.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in

    Returns
    -------
    tuple of FileFinding
        Mistakes first, then warnings; without those that `[frame] accept` lists.
    """
    experiment = opened(experiment, turning=True)
    if experiment.frame.turns:
        # Sensors outside the plan, in another unit or from another origin, tell nothing of each other.
        turning = doubts.outside_the_plan(experiment) or [
            item for each in experiment.configurations for item in mistakes.of_sensors(experiment, each)
        ]
        return tuple(item for item in turning if not item.accepted(experiment.frame.accept))
    found = [
        *doubts.frequency_units(experiment),
        *(item for each in experiment.configurations for item in mistakes.mistakes(each)),
    ]
    # Frequencies and shapes that are wrong tell no mass.
    by_modes = () if found else (doubts.total_mass, doubts.look_alike)
    for doubt in (*by_modes, *doubts.DECLARED_DOUBTS):
        said = {item.name for item in found}
        found += [item for item in doubt(experiment) if item.name not in said]
    return tuple(item for item in found if not item.accepted(experiment.frame.accept))


def refuse_mistakes(experiment: Measurement, weighed: Collection[str] = ()) -> tuple[doubts.FileFinding, ...]:
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
    experiment = opened(experiment, turning=True)
    found = tuple(
        replace(item, refuses=False) if item.name in NUMBERS and item.configuration in weighed else item
        for item in screen(experiment)
    )
    for item in found:
        if item.refuses:
            where = f'configuration "{item.configuration}": ' if item.configuration else ""
            raise errors.InputError(
                f"{where}{item.found}. To mend it: {item.change}; or, if it is right as it is: {item.how_to_accept}"
            )
    return found


@decorators.usual_arithmetic
def close_loop(
    experiment: Measurement,
    effects: Sequence[str | Effect] | None = None,
    assume: Sequence[str | LocatedEffect] = (),
    backend: str | Backend = "auto",
    priors: Sequence[Prior] = (),
    *,
    weighed: Collection[str] = (),
) -> LoopResult:
    """Find the physical effects that the shear model lacks.

    The measurement is screened first. A mistake is an error; doubts are `warnings` of the result. Of floors that turn,
    the model without effects is symmetric about the reference point (`Experiment.symmetric`).

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
    experiment = opened(experiment, turning=True)
    # The loop weighs the mode numbers of a configuration with other_modes together with the effects.
    numbered_anew = [each.name for each in experiment.configurations if each.other_modes]
    warnings = refuse_mistakes(experiment, {*weighed, *numbered_anew})
    found = close.search_for_effects(experiment, effects, assume, backend, priors)
    return replace(found, warnings=warnings)
