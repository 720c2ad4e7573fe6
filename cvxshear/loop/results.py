"""What closing the loop returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cvxshear.effects import Placed
from cvxshear.fit.efficient import Estimate
from cvxshear.fit.noise import NoiseEstimate
from cvxshear.fit.results import IdentifiedFrame
from cvxshear.loop.next_test import NextTest
from cvxshear.loop.numbering import Changes, NumberingProbability, changes_to_dict
from cvxshear.loop.posterior import Rival
from cvxshear.loop.residual import by_floor, by_part
from cvxshear.loop.verdicts import VERDICTS
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.plain import data_frame
from cvxshear.util.showing import Shown
from cvxshear.util.typing import Json

if TYPE_CHECKING:
    import pandas as pd

@dataclass(frozen=True, eq=False)
class Step:
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

    def to_dict(self) -> Json:
        """The figures that `before` and `after` have, and the effects so far."""
        figures = self.estimate.quality.to_dict()
        return {**figures, "p_value": self.p_value, "held_out_frequency_error": self.held_out}


@dataclass(frozen=True, eq=False)
class AddedEffect:
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

    def to_dict(self) -> Json:
        """Name, place, probability, parameters, standard deviations, size in words, rivals."""
        return {
            **self.placed.to_dict(),
            "kind": self.placed.effect.kind,
            "probability": self.probability,
            "parameters": self.parameters,
            "std": self.std,
            "size": self.size,
            "rivals": [
                {**rival.placed.to_dict(), "probability": rival.probability, "twin": rival.twin}
                for rival in self.rivals
            ],
        }


@dataclass(frozen=True)
class Candidate:
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

    def to_dict(self) -> Json:
        """Name, place and figures."""
        return {
            **self.placed.to_dict(),
            "probability": self.probability,
            "prior_probability": self.prior,
            "chi2": self.chi2,
            "dof": self.dof,
            "p_value": self.p_value,
            "confounded_with": list(self.confounded_with),
        }


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
        """The fields by name; the numbering only where it is other than given."""
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
        What the verdict rests on: the declared noise or an estimate of it, and what it takes for granted because no
        datum tells.
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
        """The masses and stiffnesses of the verdict's set, and those averaged over all sets, as a table of pandas.

        Returns
        -------
        DataFrame
            One row a floor: floor, floor_mass (kg), floor_mass_std, story_stiffness (N/m, of the story below that
            floor), story_stiffness_std, and the same four with `averaged_` before their names.

        Raises
        ------
        InputError
            Where pandas is not installed.
        """
        columns: dict[str, Sequence[object]] = {"floor": range(1, self.experiment.stories + 1), **self.frame.columns}
        columns |= {f"averaged_{key}": values for key, values in self.averaged.columns.items()}
        return data_frame(columns)

    def to_dict(self) -> Json:
        """The documented JSON."""
        return {
            "verdict": self.verdict,
            "rests_on": list(self.rests_on),
            "backend": self.backend,
            "provisional": VERDICTS[self.verdict].provisional,
            "effects": [item.to_dict() for item in self.effects],
            "assumed": [{**p.to_dict(), "parameters": parameters_of(self.estimate, p)} for p in self.assumed],
            "numberings": [item.to_dict() for item in self.numberings],
            "models": [item.to_dict() for item in self.models],
            "averaged": self.averaged.to_dict(),
            "noise": self.noise.to_dict(),
            "before": self.before.to_dict(),
            "after": self.after.to_dict(),
            "steps": [
                {
                    "action": step.action,
                    "effects": [
                        {**p.to_dict(), "parameters": parameters_of(step.estimate, p)} for p in step.estimate.effects
                    ],
                    **step.to_dict(),
                }
                for step in self.steps
            ],
            "candidates": [item.to_dict() for item in self.candidates],
            "not_considered": self.not_considered,
            "frame": self.frame.to_dict(),
            "undetermined": [list(names) for names in self.estimate.uncertainty.null_directions],
            "at_bounds": list(self.estimate.uncertainty.active),
            "predictions": [item.to_dict() for item in self.estimate.predictions],
            "residual": {
                "by_part": {
                    "before": [item.to_dict() for item in by_part(self.before.estimate)],
                    "after": [item.to_dict() for item in by_part(self.estimate)],
                },
                "by_floor": {"before": by_floor(self.before.estimate), "after": by_floor(self.estimate)},
            },
            "remains": list(self.remains),
            "information": list(self.information),
            "next_test": None if self.next_test is None else self.next_test.to_dict(),
            "fits": self.fits,
            "programs": self.programs,
        }


def parameters_of(estimate: Estimate, placed: Placed) -> dict[str, float]:
    """The values of an effect's parameters by name."""
    values = estimate.theta[estimate.own(placed)]
    return {item.name: float(value) for item, value in zip(placed.effect.parameters, values, strict=True)}


def stds_of(estimate: Estimate, placed: Placed) -> dict[str, float | None]:
    """Their standard deviations; None where not determined."""
    stds = estimate.std[estimate.own(placed)]
    names = [item.name for item in placed.effect.parameters]
    return {name: None if np.isnan(std) else float(std) for name, std in zip(names, stds, strict=True)}
