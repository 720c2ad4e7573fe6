"""What closing the loop returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cvxshear.effects import Placed
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.noise import NoiseEstimate
from cvxshear.fit.quality import Quality
from cvxshear.fit.results import IdentifiedFrame
from cvxshear.loop.next_test import NextTest
from cvxshear.loop.numbering import Changes, NumberingProbability, changes_to_dict
from cvxshear.loop.posterior import Rival
from cvxshear.loop.residual import by_floor, by_part
from cvxshear.loop.verdicts import VERDICTS
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.results import InJson, Shown, data_frame
from cvxshear.util.typing import Json

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Step(InJson):
    """One fit on the way.

    Parameters
    ----------
    estimate : Estimate
        In the noise of the final model.
    action : str
        What it is, in words.
    p_value : float or None
        Of the residual that it leaves, in the noise of the final model; of that noise where it is the final model's
        own and nobody declared it.
    held_out : float or None
        Held-out frequency error.
    """

    estimate: Estimate
    action: str
    p_value: float | None
    held_out: float | None = None

    json_keys = "*estimate.quality p_value held_out_frequency_error=held_out"

    @property
    def quality(self) -> Quality:
        """Errors and chi-square of the fit."""
        return self.estimate.quality


@dataclass(frozen=True, eq=False)
class AddedEffect(InJson):
    """An effect that was added, with its rivals.

    Parameters
    ----------
    placed : Placed
    probability : float
        That it is there.
    parameters, std : dict of str to float
    size : str
        Effect, place and size in words.
    rivals : tuple of Rival
        What may be there in its place.
    remarks : tuple of str
        Parameters at an end of what is physical.
    """

    placed: Placed
    probability: float
    parameters: dict[str, float]
    std: dict[str, float | None]
    size: str
    rivals: tuple[Rival, ...]
    remarks: tuple[str, ...] = ()

    json_keys = "*placed kind=placed.effect.kind probability parameters std size rivals"


@dataclass(frozen=True)
class Candidate(InJson):
    """An effect that was looked for.

    Parameters
    ----------
    placed : Placed
    probability : float
        That it is there.
    prior : float
        The same before anything was measured.
    chi2 : float
        With it in the final model, all else following, as the linearised model has it; of the final model itself
        where it is in that.
    dof : int
    p_value : float
        Of its gain in chi-square, times the number of effects that were looked for.
    confounded_with : tuple of str
        Parameters that the data cannot tell it from; empty where they can.
    """

    placed: Placed
    probability: float
    prior: float
    chi2: float
    dof: int
    p_value: float
    confounded_with: tuple[str, ...] = ()

    json_keys = "*placed probability prior_probability=prior chi2 dof p_value confounded_with"


@dataclass(frozen=True)
class EffectSet:
    """A set of effects among those visited.

    Parameters
    ----------
    effects : tuple of Placed
    probability : float
    log_evidence : float
    chi2 : float
        In its own noise.
    changes : tuple of (str, tuple of int)
        Configurations whose modes are numbered otherwise than given, with their modes then.
    """

    effects: tuple[Placed, ...]
    probability: float
    log_evidence: float
    chi2: float
    changes: Changes = ()

    def to_dict(self) -> Json:
        """Return the fields by name; the numbering only where it is other than given."""
        return {
            "effects": [placed.to_dict() for placed in self.effects],
            **({"numbering": changes_to_dict(self.changes)} if self.changes else {}),
            "probability": self.probability,
            "log_evidence": self.log_evidence,
            "chi2": self.chi2,
        }


@dataclass(frozen=True, eq=False, repr=False)
class Closure(Shown):
    """The result of `close_loop`.

    Parameters
    ----------
    experiment : Experiment
        Its modes numbered in the most probable way.
    backend : str
    verdict : str
        Of `cvxshear.loop.verdicts.VERDICTS`.
    rests_on : tuple of str
        What the verdict rests on: the declared noise or an estimate of it, and what it takes for granted because the
        data hardly tell.
    steps : tuple of Step
        The first is the shear model, the last the final one.
    judged : Estimate
        The fit that the effects are read from: the last step's or, where that leaves a residual that nothing explains,
        one under noise so wide that the residual is probable.
    effects : tuple of AddedEffect
        Most probable first; provisional where the verdict is.
    assumed : tuple of Placed
    numberings : tuple of NumberingProbability
        Which modes of the frame the measured ones are, most probable first; the numbers as given alone where they were
        not in question.
    models : tuple of EffectSet
        The sets of a probability of 0.1 % or more, most probable first.
    averaged : IdentifiedFrame
        The frame averaged over all sets.
    candidates : tuple of Candidate
        All effects that were looked for, most probable first.
    not_considered : dict of str to str
        Effects that were not looked for, and what the experiment would have to declare.
    remains : tuple of str
        Where a significant residual sits, in words.
    information : tuple of str
        What the data cannot show but is known, and what else a reader should know of the fits.
    next_test : NextTest or None
    fits, programs : int
        How many fits were made, and how many step programs they solved.
    warnings : tuple of screening.Finding
        What looks doubtful in the measurement; empty where `cvxshear.screening` was not asked.
    """

    experiment: Experiment
    backend: str
    verdict: str
    rests_on: tuple[str, ...]
    steps: tuple[Step, ...]
    judged: Estimate
    effects: tuple[AddedEffect, ...]
    assumed: tuple[Placed, ...]
    numberings: tuple[NumberingProbability, ...]
    models: tuple[EffectSet, ...]
    averaged: IdentifiedFrame
    candidates: tuple[Candidate, ...]
    not_considered: dict[str, str]
    remains: tuple[str, ...]
    information: tuple[str, ...]
    next_test: NextTest | None
    fits: int
    programs: int
    warnings: tuple[Any, ...] = ()

    json_keys = (
        "verdict rests_on backend provisional effects assumed numberings models averaged noise before after steps "
        "candidates not_considered frame undetermined=estimate.uncertainty.null_directions "
        "at_bounds=estimate.uncertainty.active predictions=estimate.predictions residual remains information "
        "next_test fits programs warnings"
    )

    @property
    def before(self) -> Step:
        """The model that the loop began with."""
        return self.steps[0]

    @property
    def after(self) -> Step:
        """The model that it ended with."""
        return self.steps[-1]

    @property
    def estimate(self) -> Estimate:
        """The final fit."""
        return self.after.estimate

    @property
    def frame(self) -> IdentifiedFrame:
        """The identified frame, its deviations those of the noise that the residual asks for."""
        return self.judged.frame

    @property
    def noise(self) -> NoiseEstimate:
        """The noise that was estimated."""
        return self.estimate.noise

    def to_dataframe(self) -> pd.DataFrame:
        """Return the masses and stiffnesses of the verdict's set, and the averaged ones, as a table of pandas.

        Returns
        -------
        DataFrame
            One row for each floor: floor, floor_mass_kg, floor_mass_std_kg, story_stiffness_N_per_m (of the story
            below that floor), story_stiffness_std_N_per_m, and the same four with `averaged_` before their names.

        Raises
        ------
        InputError
            Where pandas is not installed.
        """
        columns: dict[str, Sequence[object]] = {"floor": range(1, self.experiment.stories + 1), **self.frame.columns}
        columns |= {f"averaged_{key}": values for key, values in self.averaged.columns.items()}
        return data_frame(columns)

    @property
    def provisional(self) -> bool:
        """Whether the verdict says that something remains unexplained."""
        return VERDICTS[self.verdict].provisional

    @property
    def residual(self) -> Json:
        """The residual of each part of the data and of each floor, by the first model and the last."""
        models = {"before": self.before.estimate, "after": self.estimate}
        return {
            "by_part": {name: by_part(model) for name, model in models.items()},
            "by_floor": {name: by_floor(model) for name, model in models.items()},
        }

    def to_dict(self) -> Json:
        """Return the documented JSON."""
        steps = [
            {"action": step.action, "effects": _with_parameters(step.estimate, step.estimate.effects), **step.to_dict()}
            for step in self.steps
        ]
        return super().to_dict() | {"assumed": _with_parameters(self.estimate, self.assumed), "steps": steps}


def _with_parameters(estimate: Estimate, effects: Sequence[Placed]) -> list[Json]:
    return [{**placed.to_dict(), "parameters": parameters_of(estimate, placed)} for placed in effects]


def parameters_of(estimate: Estimate, placed: Placed) -> dict[str, float]:
    """Return the values of an effect's parameters by name."""
    values = estimate.theta[estimate.own(placed)]
    return {item.name: float(value) for item, value in zip(placed.effect.parameters, values, strict=True)}
