"""The result of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cvxshear.backends import SolvedProgram
from cvxshear.data import Model
from cvxshear.fit.gauss_newton import Ending
from cvxshear.fit.quality import Quality
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.programs import ActiveConstraint
from cvxshear.util import ranking
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.results import InJson, Shown, as_json
from cvxshear.util.typing import Bools, Floats, Json

UNITS_OF_FRAME = {"floor_mass": "kg", "story_stiffness": "N/m"}


@dataclass(frozen=True, eq=False)
class IdentifiedFrame(InJson):
    """Floor masses and story stiffnesses, nan if the data do not determine them.

    Parameters
    ----------
    floor_mass : ndarray, shape (N,)
        kg, without added mass.
    story_stiffness : ndarray, shape (N,)
        N/m.
    floor_mass_std, story_stiffness_std : ndarray, shape (N,)
        Standard deviations in the same units; nan where the method gives none.
    at_bounds : tuple of str, optional
        Values on a bound, such as "floor_mass 5". They have no standard deviation of their own.
    """

    floor_mass: Floats
    story_stiffness: Floats
    floor_mass_std: Floats
    story_stiffness_std: Floats
    at_bounds: tuple[str, ...] = ()

    json_keys = "*known"

    def stopped(self, quantity: str) -> Bools:
        """Whether each "floor_mass" or "story_stiffness" is on a bound, shape (N,)."""
        return np.array([f"{quantity} {place}" in self.at_bounds for place in range(1, len(self.floor_mass) + 1)])

    @property
    def known(self) -> dict[str, Floats | None]:
        """Values and standard deviations by name, shape (N,); deviations are nan for values on a bound."""
        found: dict[str, Floats | None] = {}
        for name in ("floor_mass", "story_stiffness"):
            std = getattr(self, f"{name}_std")
            found[name] = getattr(self, name)
            found[f"{name}_std"] = None if np.all(np.isnan(std)) else np.where(self.stopped(name), np.nan, std)
        return found


@dataclass(frozen=True, eq=False)
class Prediction(InJson):
    """All modes of the model at all floors, in one configuration.

    Parameters
    ----------
    configuration : str
    frequencies : ndarray, shape (N,)
        Hz.
    mode_shapes : ndarray, shape (N, N)
        One row a mode, largest entry 1.
    """

    configuration: str
    frequencies: Floats
    mode_shapes: Floats

    @staticmethod
    def of(model: Model) -> Prediction:
        """Return the prediction of a model of a tested state."""
        # Gains of sensors are not part of the motion; attached masses are not floors.
        shapes = model.modes.shapes[:, : len(model.state.story_stiffness)]
        largest = shapes[np.arange(len(shapes)), ranking.largest(np.abs(shapes))]
        return Prediction(model.state.tested.name, model.modes.frequencies, shapes / largest[:, None])


def predictions(models: Sequence[Model]) -> tuple[Prediction, ...]:
    """One prediction a configuration."""
    return tuple(Prediction.of(model) for model in models if isinstance(model.state.tested, Configuration))


@dataclass(frozen=True, eq=False)
class SingleIdentification(InJson):
    """An identification from one configuration, or from all together.

    Parameters
    ----------
    name : str
        Name of the configuration; empty for all together.
    iterations : int
    frame : IdentifiedFrame
    fit : Quality
    predictions : tuple of Prediction
    history : ndarray, shape (iterations + 1, N), optional
        Floor masses without added mass at the start and after each iteration, kg.
    mass_matrix : ndarray, shape (N, N), optional
        Mass matrix with added mass, kg, if a baseline's corrected mass matrix is full.
    reason : Ending
        Why the iteration stopped.
    active : tuple of ActiveConstraint
        The exact priors and bounds that hold with equality, each with its dual: the misfit (chi-square of the efficient
        method, else the sum of squares of the program) changes by -dual for each kg or N/m that is added to its side.
    """

    name: str
    iterations: int
    frame: IdentifiedFrame
    fit: Quality
    predictions: tuple[Prediction, ...]
    history: Floats | None = None
    mass_matrix: Floats | None = None
    reason: Ending = Ending.SOLVED
    active: tuple[ActiveConstraint, ...] = ()

    json_keys = "name converged iterations reason frame fit predictions history active"

    @property
    def converged(self) -> bool:
        """Whether the iteration stopped at its tolerance."""
        return self.reason.converged

    def to_dict(self) -> Json:
        """Return the documented JSON, with the full mass matrix if there is one."""
        return super().to_dict() | ({} if self.mass_matrix is None else {"mass_matrix": as_json(self.mass_matrix)})


def priced(active: Sequence[ActiveConstraint]) -> tuple[ActiveConstraint, ...]:
    """Leave out the declared masses, which are equalities of every program."""
    return tuple(each for each in active if each.constraint != "A" or each.source.startswith("prior"))


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Shown):
    """The result of `identify`.

    Parameters
    ----------
    experiment : Experiment
    method, backend : str
    parts : tuple of SingleIdentification
        One for all configurations together, or one a configuration.
    joint : bool
        Whether all configurations were fitted together.
    correlation : ndarray, shape (P, P), optional
    parameter_names : tuple of str
    undetermined : tuple of tuple of str
        For each direction that the data leave open, the parameters that take part in it.
    programs : tuple of SolvedProgram
        Every program that was solved, in order, with its solution, if `identify` was asked to keep them.
    """

    experiment: Experiment
    method: str
    backend: str
    parts: tuple[SingleIdentification, ...]
    joint: bool = False
    correlation: Floats | None = None
    parameter_names: tuple[str, ...] = ()
    undetermined: tuple[tuple[str, ...], ...] = field(default=())
    programs: tuple[SolvedProgram, ...] = ()

    @property
    def single(self) -> SingleIdentification | None:
        """The only part, where there is only one."""
        return self.parts[0] if len(self.parts) == 1 else None

    @property
    def frame(self) -> IdentifiedFrame:
        """The identified frame.

        Raises
        ------
        UnsuitableError
            If the method identified several configurations, each by itself: `parts` has a frame for each.
        """
        return self._only("frame").frame

    @property
    def fit(self) -> Quality:
        """The errors of the identified frame.

        Raises
        ------
        UnsuitableError
            If the method identified several configurations, each by itself: `parts` has a fit for each.
        """
        return self._only("fit").fit

    def _only(self, attribute: str) -> SingleIdentification:
        """Return the only part."""
        if self.single is None:
            raise UnsuitableError(
                f"method {self.method} identified {len(self.parts)} configurations, each by itself, so there is no "
                f"single {attribute}; use parts[0].{attribute}, parts[1].{attribute}, ..., or method efficient"
            )
        return self.single

    @property
    def converged(self) -> bool:
        """Whether every part converged."""
        return all(part.converged for part in self.parts)

    def to_dict(self) -> Json:
        """Return the documented JSON."""
        single = None if self.single is None else self.single.to_dict()
        top = {
            key: None if single is None else single[key]
            for key in ("iterations", "reason", "frame", "fit", "predictions", "history", "active")
        }
        result: Json = {"method": self.method, "backend": self.backend, "converged": self.converged, **top}
        if single is not None and "mass_matrix" in single:
            result["mass_matrix"] = single["mass_matrix"]
        if self.joint:
            result["parameters"] = list(self.parameter_names)
            result["correlation"] = as_json(self.correlation)
            result["undetermined"] = [list(names) for names in self.undetermined]
            result["at_bounds"] = [name for part in self.parts for name in part.frame.at_bounds]
        else:
            result["configurations"] = [part.to_dict() for part in self.parts] if single is None else [single]
        return result
