"""Verdicts and results of closing the loop, and the location of a residual by part of the data and by floor."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import special

from cvxshear.data import Datum, Deviation, Model
from cvxshear.effects import LocatedEffect
from cvxshear.fit import misfit, results
from cvxshear.fit.efficient import Estimate
from cvxshear.loop import hypotheses, posterior
from cvxshear.measurement.experiment import Experiment
from cvxshear.util import ranking
from cvxshear.util.results import InJson, Shown
from cvxshear.util.typing import Json

#: Largest probability of a part of the residual that is reported, corrected for the number of parts.
CONSPICUOUS = 0.01

#: Fields that a headline may hold in braces.
#:
#: model: the initial model of the loop; found: the effects in clauses, each with its probability; doubt: the reason why
#: the verdict is not certain; place: the place of the remaining residual; change: the final value of the error that
#: carried the verdict; within: the noise level that the residual does not exceed.
FIELDS = ("model", "found", "doubt", "place", "change", "within")


@dataclass(frozen=True)
class Verdict:
    """A verdict in words.

    Parameters
    ----------
    name : str
        Name in the JSON.
    sentence : str
        Meaning for a result with effects, or for any result if `plain` is empty.
    plain : str
        Meaning for a result without effects.
    headline : str
        Sentence for a result with effects, with `FIELDS` in braces. A semicolon separates its parts; a part whose
        fields are all empty is left out.
    bare : str
        The same for a result without effects.
    advice : str
        Advice on the use of the result, printed below the next test.
    colour, dark : str
        CSS colour of its mark on a light and on a dark page.
    provisional : bool
        Whether the effects of such a result are provisional: none of them is reported as found.
    certain : bool
        Whether the result may be used directly; if not, `cvxshear loop --strict` ends with status 3.
    """

    name: str
    sentence: str
    plain: str
    headline: str
    bare: str
    advice: str
    colour: str
    dark: str
    provisional: bool = False
    certain: bool = False

    def __post_init__(self) -> None:
        """Raise an error for an unknown field of a headline now, not in the first report."""
        nothing = dict.fromkeys(FIELDS, "")
        for text in (self.headline, self.bare):
            try:
                text.format(**nothing)
            except (KeyError, IndexError, ValueError) as error:
                raise ValueError(f"verdict {self.name!r}: {text!r} may name {', '.join(FIELDS)} in braces") from error

    def says(self, *, added: bool, **fields: str) -> str:
        """Write the headline of a result, without the full stop.

        Parameters
        ----------
        added : bool
            Whether the result has effects.
        **fields : str
            Text for each of `FIELDS`; empty if the result has none.
        """
        parts = (self.headline if added else self.bare).split("; ")
        given = [part for part in parts if "{" not in part or any(fields[n] for n in FIELDS if f"{{{n}}}" in part)]
        return "; ".join(" ".join(part.format(**fields).split()) for part in given)


_ALL = (
    Verdict(
        "adequate",
        "The shear model explains the data; nothing was added.",
        "",
        "{model} explains the data {within}; {doubt}",
        "{model} explains the data {within}; {doubt}",
        "The standard deviations of masses and stiffnesses allow for what else may be there.",
        "#00664a",
        "#4fc3a1",
        certain=True,
    ),
    Verdict(
        "explained",
        "The shear model alone does not explain the data; with the effects that were added it does.",
        "The shear model explains the data once the modes are numbered otherwise; nothing was added.",
        "{found}; {change}",
        "{model} explains the data; {change}",
        "The standard deviations of masses and stiffnesses allow for what else may be there.",
        "#00664a",
        "#4fc3a1",
        certain=True,
    ),
    Verdict(
        "ambiguous",
        "The data are explained with the effects that were added, but something else would explain them as well.",
        "The shear model explains the data, but so might something that these data cannot tell from it.",
        "{found}; but {doubt}; {change}",
        "{model} explains the data; but {doubt}; {change}",
        "Take what was found and its rivals as possible causes until a test distinguishes them.",
        "#8a5a00",
        "#e0b04a",
    ),
    Verdict(
        "located",
        "No cause in the catalogue explains the data, but which statement of the shear model fails is known.",
        "",
        "{found}; no cause in the catalogue accounts for it; {doubt}; {change}",
        "which statement of the shear model fails is known; no cause in the catalogue accounts for it; {change}",
        "Look at the place that is named; a cause of your own can be added as an effect.",
        "#5a3f94",
        "#b39ddb",
    ),
    Verdict(
        "unexplained",
        "A significant residual is left that no effect of the catalogue accounts for.",
        "",
        "a significant residual is left {place}; provisionally, {found}; {change}",
        "a significant residual is left {place}; no effect that was looked for accounts for it",
        "Check the measurement where the residual sits first; what is named is provisional.",
        "#a33a00",
        "#ff9a6b",
        provisional=True,
    ),
)

#: Verdicts of a loop by name; a new verdict is one more entry.
VERDICTS = {each.name: each for each in _ALL}


@dataclass(frozen=True, eq=False)
class Step(InJson):
    """One fit of the loop.

    Parameters
    ----------
    estimate : Estimate
        Fit in the noise of the final model.
    action : str
        Description of the fit in words.
    p_value : float or None
        p-value of the residual in the noise of the final model. If this noise is the final model's own estimate, the
        p-value of the noise.
    held_out : float or None
        Held-out frequency error.
    """

    estimate: Estimate
    action: str
    p_value: float | None
    held_out: float | None = None

    json_keys = "*estimate.quality p_value held_out_frequency_error=held_out"

    @property
    def quality(self) -> results.Quality:
        """Errors and chi-square of the fit."""
        return self.estimate.quality


@dataclass(frozen=True)
class SharedStory:
    """A story that several effects explain, one of which is there.

    Parameters
    ----------
    change : str
        What the story lost or gained, in words.
    probability : float
        Probability that one of the effects is there.
    parts : dict of LocatedEffect to str
        The effects, each with the part of the story in words.
    """

    change: str
    probability: float
    parts: dict[LocatedEffect, str]


@dataclass(frozen=True, eq=False)
class AddedEffect(InJson):
    """Added effect, with its rivals.

    Parameters
    ----------
    placed : LocatedEffect
    probability : float
        Probability that the effect is present.
    parameters, std : dict of str to float
    size : str
        Effect, place and size in words.
    rivals : tuple of Rival
        Effects that may be present instead.
    remarks : tuple of str
        Parameters on a physical bound.
    story : SharedStory or None
        The story, if rivals are other parts of the same story in the same state.
    """

    placed: LocatedEffect
    probability: float
    parameters: dict[str, float]
    std: dict[str, float | None]
    size: str
    rivals: tuple[posterior.Rival, ...]
    remarks: tuple[str, ...] = ()
    story: SharedStory | None = None

    json_keys = "*placed kind=placed.effect.kind probability parameters std size rivals"


@dataclass(frozen=True)
class Candidate(InJson):
    """Effect that was looked for.

    Parameters
    ----------
    placed : LocatedEffect
    probability : float
        Probability that the effect is present.
    prior : float
        Prior probability.
    chi2 : float
        Chi-square of the final model with the effect added, from the linearised model; if the final model holds the
        effect, its own chi-square.
    dof : int
    p_value : float
        p-value of the gain in chi-square, times the number of effects that were looked for.
    confounded_with : tuple of str
        Parameters that the data cannot distinguish from the effect; empty if there are none.
    """

    placed: LocatedEffect
    probability: float
    prior: float
    chi2: float
    dof: int
    p_value: float
    confounded_with: tuple[str, ...] = ()

    json_keys = "*placed probability prior_probability=prior chi2 dof p_value confounded_with"


@dataclass(frozen=True)
class EffectSet:
    """Set of effects among the visited ones.

    Parameters
    ----------
    effects : tuple of LocatedEffect
    probability : float
    log_evidence : float
    chi2 : float
        Chi-square in the noise of the set's own fit.
    changes : tuple of (str, tuple of int)
        Configurations with other mode numbers than the given ones, with these modes.
    """

    effects: tuple[LocatedEffect, ...]
    probability: float
    log_evidence: float
    chi2: float
    changes: hypotheses.Changes = ()

    def to_dict(self) -> Json:
        """Return the fields by name; the numbering only if it differs from the given one."""
        return {
            "effects": [placed.to_dict() for placed in self.effects],
            **({"numbering": hypotheses.changes_to_dict(self.changes)} if self.changes else {}),
            "probability": self.probability,
            "log_evidence": self.log_evidence,
            "chi2": self.chi2,
        }


@dataclass(frozen=True, eq=False, repr=False)
class LoopResult(Shown):
    """Result of `close_loop`.

    Parameters
    ----------
    experiment : Experiment
        Experiment under the most probable numbering of its modes.
    backend : str
    verdict : str
        Key of `VERDICTS`.
    rests_on : tuple of str
        Basis of the verdict: the declared or estimated noise, and the assumptions that the data hardly test.
    steps : tuple of Step
        The first is the shear model, the last the final one.
    judged : Estimate
        Fit that determines the effects: the fit of the last step. If its residual is unexplained, a fit under noise so
        wide that the residual is probable.
    effects : tuple of AddedEffect
        Most probable first; provisional if the verdict is provisional.
    assumed : tuple of LocatedEffect
    numberings : tuple of NumberingProbability
        Numberings of the measured modes, most probable first; only the given one if no other was considered.
    models : tuple of EffectSet
        The sets of a probability of 0.1 % or more, most probable first.
    averaged : IdentifiedFrame
        The frame averaged over all sets but those with an effect that the data do not determine.
    candidates : tuple of Candidate
        All effects that were looked for, most probable first.
    not_considered : dict of str to str
        Effects that were not looked for, with the declarations that the experiment lacks.
    remains : tuple of str
        Location of a significant residual, in words.
    information : tuple of str
        Knowledge that the data cannot show, and further messages about the fits.
    next_test : NextTest or None
    fits, programs : int
        Number of fits, and number of step programs that they solved.
    warnings : tuple of screening.Finding
        Doubtful parts of the measurement; empty if `cvxshear.screening` was not used.
    others : OtherFrames
        Other frames that fit the same data as well with these effects, if these are few.
    """

    experiment: Experiment
    backend: str
    verdict: str
    rests_on: tuple[str, ...]
    steps: tuple[Step, ...]
    judged: Estimate
    effects: tuple[AddedEffect, ...]
    assumed: tuple[LocatedEffect, ...]
    numberings: tuple[hypotheses.NumberingProbability, ...]
    models: tuple[EffectSet, ...]
    averaged: results.IdentifiedFrame
    candidates: tuple[Candidate, ...]
    not_considered: dict[str, str]
    remains: tuple[str, ...]
    information: tuple[str, ...]
    next_test: results.NextTest | None
    fits: int
    programs: int
    warnings: tuple[Any, ...] = ()
    others: results.OtherFrames = field(default_factory=results.OtherFrames)

    json_keys = (
        "verdict rests_on backend provisional effects assumed numberings models averaged noise before after steps "
        "candidates not_considered frame undetermined=estimate.undetermined "
        "at_bounds=estimate.uncertainty.active predictions=estimate.predictions residual remains information "
        "next_test other_frames searched=others.searched fits programs warnings"
    )

    @property
    def before(self) -> Step:
        """Initial model of the loop."""
        return self.steps[0]

    @property
    def after(self) -> Step:
        """Final model of the loop."""
        return self.steps[-1]

    @property
    def estimate(self) -> Estimate:
        """Final fit."""
        return self.after.estimate

    @property
    def frame(self) -> results.IdentifiedFrame:
        """Identified frame; its standard deviations follow from the noise that explains the residual."""
        return self.judged.frame

    @property
    def other_frames(self) -> tuple[results.OtherFrame, ...]:
        """Other frames that fit the same data as well, the most probable first."""
        return self.others.frames

    @property
    def noise(self) -> misfit.NoiseEstimate:
        """Estimated noise."""
        return self.estimate.noise

    @property
    def provisional(self) -> bool:
        """Whether the verdict reports an unexplained residual."""
        return VERDICTS[self.verdict].provisional

    @property
    def residual(self) -> Json:
        """Residual of each part of the data and of each floor, by the first model and the last."""
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


def _with_parameters(estimate: Estimate, effects: Sequence[LocatedEffect]) -> list[Json]:
    return [{**placed.to_dict(), "parameters": parameters_of(estimate, placed)} for placed in effects]


def parameters_of(estimate: Estimate, placed: LocatedEffect) -> dict[str, float]:
    """Return the values of an effect's parameters by name."""
    values = estimate.theta[estimate.own(placed)]
    return {item.name: float(value) for item, value in zip(placed.effect.parameters, values, strict=True)}


def _compared(estimate: Estimate) -> list[tuple[Datum, Model, float]]:
    """List each datum with its model and the factor of its noise."""
    models = {id(model.state.tested): model for model in estimate.fit.at.models}
    return [
        (datum, models[id(datum.tested)], 1.0 if datum.declared else estimate.misfit.noise.of(datum.noise.name))
        for datum in estimate.misfit.data
    ]


def by_part(estimate: Estimate) -> list[Deviation]:
    """List the residuals of each part of each datum and soft prior, in standard deviations of the fit's noise."""
    return [
        replace(part, deviations=part.deviations / factor)
        for datum, model, factor in _compared(estimate)
        for part in datum.describe(model)
    ] + estimate.misfit.statement_deviations(estimate.theta)


def by_floor(estimate: Estimate) -> dict[int, float]:
    """Return the root mean square of the residuals at each measured floor, in standard deviations, over all tests."""
    squares: dict[int, list[float]] = {}
    for datum, model, factor in _compared(estimate):
        for floor, z in datum.by_floor(model).items():
            squares.setdefault(floor, []).extend((z / factor) ** 2)
    return {floor: float(np.sqrt(np.mean(values))) for floor, values in sorted(squares.items()) if values}


def where_it_sits(estimate: Estimate) -> list[str]:
    """Describe the significant parts of a residual, the largest first; empty if no part is significant."""
    parts, floors = by_part(estimate), by_floor(estimate)
    level = CONSPICUOUS / max(len(parts) + len(floors), 1)
    found = [
        (abs(part.deviations), _said(part))
        for part in parts
        if special.chdtrc(part.entries, part.deviations**2 * part.entries) < level
    ]
    rows = len([part for part in parts if part.entries > 1]) or 1
    found += [
        (deviation, f"floor {floor} ({deviation:.1f} standard deviations, root mean square)")
        for floor, deviation in floors.items()
        if special.chdtrc(rows, deviation**2 * rows) < level
    ]
    return [text for _, text in ranking.ranked(found, lambda item: item[0])]


def _said(part: Deviation) -> str:
    """Describe a part and its size in words."""
    if part.entries > 1:
        return f"{part.label} ({part.deviations:.1f} standard deviations a floor)"
    error = "" if part.error is None else f"{100 * part.error:+.2f} %, "
    return f"{part.label} ({error}{part.deviations:+.1f} standard deviations)"
