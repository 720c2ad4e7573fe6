"""What a prediction needs of a fit, and its JSON, from which the fit need not be made again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cvxshear.effects import Place, Placed, catalogue, open_classes
from cvxshear.effects.readings import WrongPrior
from cvxshear.fit.efficient import Estimate
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.methods import Identification
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import listed
from cvxshear.util.results import InJson, as_json
from cvxshear.util.typing import Floats, Json

NO_VARIANCE = 1e-12
"""Eigenvalue of a correlation matrix, relative to the largest, below which it is rounding."""


IMPROBABLE = 0.01
"""p-value of the fit's residual below which the modes speak against the model."""


@dataclass(frozen=True, eq=False)
class Fitted(InJson):
    """A fitted model.

    Parameters
    ----------
    experiment : Experiment
    effects : tuple of Placed
    theta : ndarray, shape (P,)
        Floor masses (N), story stiffnesses (N), the effects' parameters.
    covariance : ndarray, shape (P, P), optional
        Of the part that the data determine; None where nothing tells the noise.
    undetermined : tuple of tuple of str
        For each direction that the data leave open, the parameters that take part.
    misfit : float, optional
        Chi-square a degree of freedom where the modes speak against the model; 1 where they do not.
    lacking : float, optional
        Largest error of a mode shape, of its largest entry, where the modes speak against the model; else 0.
    """

    experiment: Experiment
    effects: tuple[Placed, ...]
    theta: Floats
    covariance: Floats | None
    undetermined: tuple[tuple[str, ...], ...] = ()
    misfit: float = 1.0
    lacking: float = 0.0

    json_keys = "effects theta covariance undetermined misfit lacking"

    @staticmethod
    def of(estimate: Estimate) -> Fitted:
        """Take over an estimate."""
        return Fitted(
            estimate.experiment,
            estimate.effects,
            estimate.theta,
            estimate.uncertainty.covariance(),
            estimate.uncertainty.null_directions,
            *_misfit(estimate),
        )

    @staticmethod
    def of_identification(result: Identification) -> Fitted | None:
        """Take over a joint identification; None for other methods, and where values were left open."""
        frame = result.frame
        if not result.joint or frame is None or result.correlation is None:
            return None
        theta = np.concatenate([frame.floor_mass, frame.story_stiffness])
        if frame.floor_mass_std is None or frame.story_stiffness_std is None or not np.isfinite(theta).all():
            return None
        std = np.concatenate([frame.floor_mass_std, frame.story_stiffness_std])
        covariance = np.nan_to_num(result.correlation) * np.outer(std, std) if np.isfinite(std).all() else None
        return Fitted(result.experiment, (), theta, covariance, result.undetermined)

    @property
    def mass_known(self) -> bool:
        """Whether the masses have a scale; not where a total of 1 kg stands for one that nobody gave."""
        return not self.experiment.frame.total_mass_placeholder

    def label_in(self, configuration: Configuration) -> str:
        """Name the model and its effects that act in this configuration."""
        names = listed([placed.label for placed in self.effects if placed.acts_on(configuration)])
        if names:
            return f"shear model with {names}"
        return "shear model (the effects found sit in other states)" if self.effects else "shear model"

    @cached_property
    def root(self) -> Floats:
        """L with L L' = covariance, shape (P, r); of no columns where the covariance is unknown."""
        size = len(self.theta)
        if self.covariance is None:
            return np.zeros((size, 0))
        std = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        unit = np.where(std > 0, std, 1.0)
        values, vectors = np.linalg.eigh(self.covariance / np.outer(unit, unit))
        kept = values > NO_VARIANCE * max(float(values[-1]), NO_VARIANCE)
        root: Floats = unit[:, None] * vectors[:, kept] * np.sqrt(values[kept])
        return root

    def to_dict(self) -> Json:
        """Parameters, covariance and effects; the experiment is written once for several models of it."""
        effects = [{**placed.to_dict(), "fixed": list(placed.fixed)} for placed in self.effects]
        return super().to_dict() | {"effects": effects}

    @staticmethod
    def from_dict(declared: object, experiment: Experiment, where: str) -> Fitted:
        """Read the fitted model that `to_dict` wrote.

        Raises
        ------
        InputError
            Naming what is missing or of the wrong size.
        """
        keys = ["effects", "theta", "covariance", "undetermined"]
        table = checks.keys(declared, [*keys, "misfit", "lacking"], keys, where)
        effects = tuple(_placed(item, f"{where}: effects", experiment) for item in table["effects"])
        size = 2 * experiment.stories + sum(len(placed.effect.parameters) for placed in effects)
        theta = checks.vector(table["theta"], f"{where}: theta", length=size)
        covariance = None
        if table["covariance"] is not None:
            covariance = checks.table(table["covariance"], f"{where}: covariance", rows=size)
            if covariance.shape != (size, size):
                raise InputError(f"{where}: covariance must have {size} rows of {size} numbers, one a parameter")
        undetermined = tuple(tuple(str(name) for name in names) for names in table["undetermined"])
        misfit, lacking = float(table.get("misfit", 1.0)), float(table.get("lacking", 0.0))
        return Fitted(experiment, effects, theta, covariance, undetermined, misfit, lacking)


def _misfit(estimate: Estimate) -> tuple[float, float]:
    """Chi-square a degree of freedom and largest error of a shape where that is improbable, else 1 and 0."""
    if estimate.p_value is None or estimate.p_value > IMPROBABLE or not estimate.dof:
        return 1.0, 0.0
    return max(1.0, estimate.chi2 / estimate.dof), float(estimate.quality.max_shape_error or 0.0)


def _placed(item: object, where: str, experiment: Experiment) -> Placed:
    """Read an effect at its place, its parameters those that it has there."""
    table = checks.keys(item, ["name", "fixed", "floor", "to", "story", "configuration", "prior"], ["name"], where)
    known = {effect.name: effect for effect in (*catalogue(), *open_classes())}
    effect = known[checks.choice(table["name"], list(known), "effect")].bound(experiment)
    place = Place(
        table.get("floor"), table.get("story"), table.get("configuration"), table.get("to"), table.get("prior")
    )
    statements = [words for words, rows in experiment.soft_statements if rows]
    if isinstance(effect, WrongPrior) and place.prior not in statements:
        raise InputError(
            f"{where}: prior must be a statement of the experiment that has a standard deviation "
            f"({'; '.join(statements) or 'there is none'}), not {checks.shown(place.prior)}"
        )
    return Placed(effect.bound_at(experiment, place), place, tuple(table.get("fixed", ())))


@dataclass(frozen=True, eq=False)
class Models(InJson):
    """The model that closing the loop began with and the one that it ended with.

    Parameters
    ----------
    before : Fitted or None
        None where there is but one model.
    after : Fitted
    """

    before: Fitted | None
    after: Fitted

    def to_dict(self) -> Json:
        """Return the documented JSON; null for what was not measured in a shape."""
        return dict(as_json(super().to_dict()))

    json_keys = "experiment=after.experiment name=after.experiment.name mass_known=after.mass_known before after"

    @staticmethod
    def from_dict(declared: object, where: str) -> Models:
        """Read the models that `to_dict` wrote."""
        keys = ["experiment", "name", "before", "after"]
        table = checks.keys(declared, [*keys, "mass_known"], keys, where)
        experiment = Experiment.from_dict(_with_nan(table["experiment"]), name=table["name"])
        before = table["before"]
        return Models(
            None if before is None else Fitted.from_dict(before, experiment, f"{where}: before"),
            Fitted.from_dict(table["after"], experiment, f"{where}: after"),
        )


def _with_nan(value: object) -> object:
    """Put nan again where null stands for it in a list: what was not measured."""
    if isinstance(value, Mapping):
        return {key: _with_nan(each) for key, each in value.items()}
    if isinstance(value, list):
        return [math.nan if each is None else _with_nan(each) for each in value]
    return value
