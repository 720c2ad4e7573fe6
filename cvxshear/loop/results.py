"""What closing the loop returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.effects import Placed
from cvxshear.experiment import Experiment
from cvxshear.identification.efficient import Estimate
from cvxshear.identification.results import IdentifiedFrame
from cvxshear.loop.candidates import Candidate, parameters_of
from cvxshear.loop.next_test import NextTest
from cvxshear.loop.residual import by_floor, by_mode
from cvxshear.typing import Json

VERDICTS = {
    "adequate": "The shear model explains the data; nothing was added.",
    "explained": "The shear model alone does not explain the data; with what was added they are explained.",
    "ambiguous": "The data are explained with what was added, but something else would explain them as well.",
    "unexplained": "A significant residual is left that no effect of the catalogue accounts for.",
}


@dataclass(frozen=True, eq=False)
class Step:
    """One fit on the way.

    Parameters
    ----------
    estimate : Estimate
    action : str
        What led to it, in words.
    tried : int
        How many candidates were fitted to choose it.
    p_value : float or None
        Of the residual that it leaves.
    held_out : float or None
        Held-out frequency error.
    """

    estimate: Estimate
    action: str
    tried: int
    p_value: float | None
    held_out: float | None

    def to_dict(self) -> Json:
        """The figures that `before` and `after` have, and the effects so far."""
        figures = self.estimate.quality.to_dict()
        return {**figures, "p_value": self.p_value, "held_out_frequency_error": self.held_out}


@dataclass(frozen=True, eq=False)
class Found:
    """An effect that was added, with its rivals.

    Parameters
    ----------
    placed : Placed
    parameters, std : dict of str to float
    rivals : tuple of Candidate
        Whose fit in its place is not significantly worse.
    log_p : float
        Logarithm of the probability of its gain if it were not there.
    """

    placed: Placed
    parameters: dict[str, float]
    std: dict[str, float | None]
    rivals: tuple[Candidate, ...]
    log_p: float

    def to_dict(self) -> Json:
        """Name, place, parameters, standard deviations, rivals."""
        return {
            **self.placed.to_dict(),
            "parameters": self.parameters,
            "std": self.std,
            "gain_p_value": float(np.exp(self.log_p)),
            "rivals": [rival.to_dict() for rival in self.rivals],
        }


@dataclass(frozen=True, eq=False)
class Closure:
    """The result of `close_loop`.

    Parameters
    ----------
    experiment : Experiment
    backend : str
    verdict : str
        A key of `VERDICTS`.
    rests_on : str
        What the verdict rests on: the declared noise, or an estimate of it.
    steps : tuple of Step
        The first is the shear model, the last the final one.
    effects : tuple of Found
    assumed : tuple of Placed
    candidates : tuple of Candidate
        Ranking of the last step at which candidates were fitted.
    not_considered : dict of str to str
        Effects that were not looked for, and what the experiment would have to declare.
    remains : tuple of str
        Where a significant residual sits, in words.
    information : tuple of str
        What the data cannot show but is known.
    next_test : NextTest or None
    fits, programs : int
        How many fits were made, and how many step programs they solved.
    """

    experiment: Experiment
    backend: str
    verdict: str
    rests_on: str
    steps: tuple[Step, ...]
    effects: tuple[Found, ...]
    assumed: tuple[Placed, ...]
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
        """The identified frame."""
        return self.estimate.frame

    def _repr_html_(self) -> str | None:
        """What a notebook shows."""
        from cvxshear.report.notebook import closure_html  # noqa: PLC0415 - loaded by a notebook only

        return closure_html(self)

    def to_dict(self) -> Json:
        """The documented JSON."""
        return {
            "verdict": self.verdict,
            "rests_on": self.rests_on,
            "backend": self.backend,
            "effects": [item.to_dict() for item in self.effects],
            "assumed": [{**p.to_dict(), "parameters": parameters_of(self.estimate, p)} for p in self.assumed],
            "before": self.before.to_dict(),
            "after": self.after.to_dict(),
            "steps": [
                {
                    "action": step.action,
                    "tried": step.tried,
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
                "by_mode": {
                    "before": [item.to_dict() for item in by_mode(self.before.estimate)],
                    "after": [item.to_dict() for item in by_mode(self.estimate)],
                },
                "by_floor": {"before": by_floor(self.before.estimate), "after": by_floor(self.estimate)},
            },
            "remains": list(self.remains),
            "information": list(self.information),
            "next_test": None if self.next_test is None else self.next_test.to_dict(),
            "fits": self.fits,
            "programs": self.programs,
        }
