"""Model of a prediction: the required parts of a fit, and their sources: a measurement, a record or a closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cvxshear.backends import Backend
from cvxshear.effects import LocatedEffect
from cvxshear.fit.efficient import RESIDUAL_LEVEL, Estimate
from cvxshear.io import modes, toml
from cvxshear.loop import LoopResult
from cvxshear.measurement.experiment import Configuration, Experiment, opened
from cvxshear.records.motion import DrivenRecord, trend
from cvxshear.screening import FileFinding, close_loop
from cvxshear.util import checks
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError, NoScaleError
from cvxshear.util.quantities import listed, percent
from cvxshear.util.typing import Floats

#: Largest eigenvalue of a correlation matrix, relative to its maximum, that counts as rounding.
NO_VARIANCE = 1e-12


def covariance_root(covariance: Floats) -> Floats:
    """Return L with L L' = covariance, shape (P, r); directions of rounding have no column."""
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(std > 0, std, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    kept = values > NO_VARIANCE * max(float(values[-1]), NO_VARIANCE)
    return np.asarray(unit[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted model.

    Parameters
    ----------
    experiment : Experiment
    effects : tuple of LocatedEffect
    theta : ndarray, shape (P,)
        Floor masses (N), story stiffnesses (N), parameters of the effects.
    covariance : ndarray, shape (P, P)
        Covariance of the part that the data determine.
    undetermined : tuple of tuple of str
        For each direction that the data do not determine, the parameters that take part.
    misfit : float, optional
        Chi-square per degree of freedom if the modes contradict the model; otherwise 1.
    lacking : float, optional
        Largest error of a mode shape, relative to its largest entry, if the modes contradict the model; otherwise 0.
    """

    experiment: Experiment
    effects: tuple[LocatedEffect, ...]
    theta: Floats
    covariance: Floats
    undetermined: tuple[tuple[str, ...], ...] = ()
    misfit: float = 1.0
    lacking: float = 0.0

    @staticmethod
    def of(estimate: Estimate) -> Fitted:
        """Return the fitted model of an estimate."""
        return Fitted(
            estimate.experiment,
            estimate.effects,
            estimate.theta,
            estimate.uncertainty.covariance(),
            estimate.uncertainty.null_directions,
            *_misfit(estimate),
        )

    @property
    def mass_known(self) -> bool:
        """Whether the mass scale is known; False if a total mass of 1 kg replaces an unknown one."""
        return not self.experiment.frame.total_mass_placeholder

    def label_in(self, configuration: Configuration) -> str:
        """Name the model with the effects that act in this configuration."""
        names = listed([placed.label for placed in self.effects if placed.acts_on(configuration)])
        if names:
            return f"shear model with {names}"
        return "shear model (the effects found sit in other states)" if self.effects else "shear model"

    @cached_property
    def root(self) -> Floats:
        """Factor L with L L' = covariance, shape (P, r)."""
        return covariance_root(self.covariance)


def _misfit(estimate: Estimate) -> tuple[float, float]:
    """Return chi-square per degree of freedom and the largest shape error if the fit is improbable, else 1 and 0."""
    if estimate.p_value is None or estimate.p_value > RESIDUAL_LEVEL or not estimate.dof:
        return 1.0, 0.0
    return max(1.0, estimate.chi2 / estimate.dof), float(estimate.quality.max_shape_error or 0.0)


@dataclass(frozen=True, eq=False)
class Models:
    """The models before and after closing the loop.

    Parameters
    ----------
    before : Fitted or None
        None if there is only one model.
    after : Fitted
    warnings : tuple of FileFinding, optional
        Doubts of the measurement that the loop was closed on.
    """

    before: Fitted | None
    after: Fitted
    warnings: tuple[FileFinding, ...] = ()


#: Kinds of measured excitation, in words.
DRIVING = {"base": "base motion", "force": "force"}

ModelSource = str | Path | Experiment | LoopResult | Estimate | Models


def models_of(source: ModelSource, backend: Backend, assume: Sequence[str | LocatedEffect] = ()) -> Models:
    """Return the models before and after closing the loop; close the loop first if the source is not a loop's result.

    Parameters
    ----------
    source : str, Path, Experiment, LoopResult, Estimate or Models
        A file is a measurement file or a record file.
    backend : Backend
    assume : sequence of str or LocatedEffect, optional
        Effects that are in the model from the start of a loop that is closed here.

    Raises
    ------
    InputError
        If a file cannot be read or has another format, or if effects are assumed for a model that already exists.
    """
    if assume and not isinstance(source, Experiment | str | Path):
        raise InputError("assume needs a measurement; for a model that is already there, give it to close_loop")
    match source:
        case Models():
            found = source
        case LoopResult():
            found = models_of_loop(source)
            opened(source.experiment)
        case Estimate():
            found = Models(None, Fitted.of(source))
        case Experiment():
            found = models_of_loop(close_loop(opened(source), assume=assume, backend=backend))
        case str() | Path():
            found = _of_file(source, backend, assume)
        case _:
            raise InputError(
                "the model of a prediction is a file, an Experiment, a LoopResult, an Estimate or Models, not "
                + checks.shown(source)
            )
    return found


def _of_file(source: str | Path, backend: Backend, assume: Sequence[str | LocatedEffect]) -> Models:
    """Close the loop on a measurement file or a record file."""
    recorded = toml.is_record_file(source)
    experiment = modes.experiment_from_file(source) if recorded else load_unscaled(source)
    names = [each.name for each in experiment.configurations]
    weighed = names if recorded else ()
    return models_of_loop(close_loop(opened(experiment), assume=assume, backend=backend, weighed=weighed))


def load_unscaled(path: str | Path) -> Experiment:
    """Read a measurement file; if it has no mass scale, use a total mass of 1 kg."""
    try:
        return toml.load(path)
    except NoScaleError:
        path = Path(path)
        declared = dict(toml.with_modes_read(toml.read_tables(path), path.parent))
        frame = declared.get("frame") or {}
        # A remark of the result reports the missing scale; warnings about the replaced masses would confuse the user.
        accepted = {*frame.get("accept", ()), "total_mass", "masses"}
        declared["frame"] = {
            **frame, "total_mass": 1.0, "total_mass_placeholder": True, "accept": sorted(accepted)
        }  # fmt: skip
        return Experiment.from_dict(declared, name=path.stem)


def models_of_loop(closure: LoopResult) -> Models:
    """Return the models that a closed loop began and ended with."""
    return Models(Fitted.of(closure.before.estimate), Fitted.of(closure.estimate), closure.warnings)


def state_of(experiment: Experiment, record: DrivenRecord, name: str | None = None) -> Configuration:
    """Find the configuration of the frame during the record.

    Parameters
    ----------
    name : str, optional
        Name of a configuration or of a state; for a state, its configuration with the record's added mass. By default:
        the record's state. If the record has none, the only configuration, or the one with the record's added mass.

    Raises
    ------
    InputError
        If there is no such configuration or state, or if floors or added mass do not fit the frame.
    """
    highest = max([*record.floors.tolist(), *(run.floor for run in record.runs)])
    if highest > experiment.stories:
        raise InputError(f"{record.name} speaks of floor {highest}, the frame has {experiment.stories} stories")
    configurations = experiment.configurations
    if name is not None:
        names = {each.name: each for each in configurations}
        checks.choice(name, [*names, *(state for state in experiment.states if state not in names)], "configuration")
        if name in names:
            return names[name]
    state = record.state if name is None else name
    if state is not None and (state in experiment.states or len(experiment.states) > 1):
        configurations = tuple(each for each in configurations if each.state == state)
        if not configurations:
            known = listed([f'"{state}"' for state in experiment.states])
            raise InputError(
                f'{record.name} was recorded in state "{record.state}", the model knows {known}; name one of its '
                "configurations (--configuration), or test that state"
            )
    if record.added_mass is None and len(configurations) == 1:
        return configurations[0]
    added = np.zeros(experiment.stories) if record.added_mass is None else record.added_mass
    if len(added) != experiment.stories:
        raise InputError(f"{record.name}: added_mass has {len(added)} entries, the frame {experiment.stories} stories")
    for each in configurations:
        if np.allclose(each.added_mass, added):
            return each
    return replace(configurations[0], name=_unused(experiment, added), added_mass=added)


def state_remarks(
    experiment: Experiment, record: DrivenRecord, configuration: Configuration, *, named: bool
) -> list[str]:
    """Report assumptions of `state_of` about the state of the frame; no assumption is needed if the user named it."""
    if record.state is not None and record.state != configuration.state:
        if named:
            return [f'the record is of state "{record.state}", the model that of "{configuration.state}", as asked']
        return [
            f'the record is of state "{record.state}", of which nothing was measured: the model is that of '
            f'"{configuration.state}"'
        ]
    if not named and record.state is None and len({each.state for each in experiment.configurations}) > 1:
        return [
            f'the record names no state: "{configuration.state}" is taken; write state = "..." in the record file, or '
            "give --configuration"
        ]
    return []


#: Least size of a removed line, relative to the rms of its channel, that is reported. A smaller line does not change
#: printed figures.
WORTH_A_WORD = 0.01


def line_remarks(before: DrivenRecord, after: DrivenRecord) -> list[str]:
    """Report the largest straight line that was removed as a fault of its sensor, if it is large enough."""
    names = [f"the {DRIVING[before.input]}", *(f"floor {floor}" for floor in before.floors)]
    # A delay that was removed is no line.
    lines = [trend(one.columns - other.columns) for one, other in zip(before.runs, after.runs, strict=True)]
    sizes = np.max(np.abs(np.concatenate(lines)), axis=0) / np.maximum(after.rms(), 1e-300)
    if np.max(sizes) < WORTH_A_WORD:
        return []
    return [
        f"a straight line of up to {percent(float(np.max(sizes)), 1)} of the rms ({names[int(np.argmax(sizes))]}) was "
        "taken for its sensor's and off; --no-detrend leaves it in"
    ]


def _unused(experiment: Experiment, added: Floats) -> str:
    """Make a name for a configuration that was not tested; no effect of a tested configuration acts on this name."""
    taken = {each.name for each in experiment.configurations}
    name = f"{added.sum():g} kg added" if np.any(added) else "nothing added"
    while name in taken:
        name += ", not tested"
    return name


def assumptions(
    fitted: Fitted, configuration: Configuration, before: DrivenRecord, after: DrivenRecord, passed: Floats | None,
    *, named: bool,
) -> list[str]:  # fmt: skip
    """Report what is assumed of the state, the record and the model, and what the model leaves out.

    Parameters
    ----------
    before, after : DrivenRecord
        The record, and the record without straight lines.
    passed : ndarray, optional
        Probabilities of the limits; None if nothing judges them.
    named : bool
        Whether the user named the configuration.
    """
    said = state_remarks(fitted.experiment, before, configuration, named=named) + line_remarks(before, after)
    if not fitted.mass_known:
        said.append("the masses have no scale (give total_mass): forces and moments are left out")
    if fitted.experiment.limits is not None and passed is None:
        said.append("drift ratios need story_heights in [frame]: the limits cannot be judged")
    return said
