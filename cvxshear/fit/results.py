"""What an identification returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from cvxshear.data import Model
from cvxshear.fit.gauss_newton import Ending
from cvxshear.fit.quality import Quality
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.util.results import InJson, Shown, as_json, data_frame
from cvxshear.util.typing import Bools, Floats, Json

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class IdentifiedFrame(InJson):
    """Floor masses and story stiffnesses, nan where the data do not determine one.

    Parameters
    ----------
    floor_mass : ndarray, shape (N,)
        kg, without added mass.
    story_stiffness : ndarray, shape (N,)
        N/m.
    floor_mass_std, story_stiffness_std : ndarray, shape (N,), optional
        Standard deviations in the same units, of the methods that give them.
    at_bounds : tuple of str, optional
        What only a bound keeps from going on, such as "floor_mass 5": its value is the bound's, and a standard
        deviation would be nothing but rounding, so that what is written of the frame has none.
    """

    floor_mass: Floats
    story_stiffness: Floats
    floor_mass_std: Floats | None = None
    story_stiffness_std: Floats | None = None
    at_bounds: tuple[str, ...] = ()

    json_keys = "*known"

    def stopped(self, quantity: str) -> Bools:
        """Where "floor_mass" or "story_stiffness" is at a bound, shape (N,)."""
        return np.array([f"{quantity} {place}" in self.at_bounds for place in range(1, len(self.floor_mass) + 1)])

    @property
    def known(self) -> dict[str, Floats | None]:
        """Values and standard deviations by name, shape (N,); nan where a value stopped at a bound."""
        found: dict[str, Floats | None] = {}
        for name in ("floor_mass", "story_stiffness"):
            std = getattr(self, f"{name}_std")
            found[name] = getattr(self, name)
            found[f"{name}_std"] = None if std is None else np.where(self.stopped(name), np.nan, std)
        return found

    @property
    def columns(self) -> dict[str, list[float]]:
        """Values and deviations by name, floor by floor from the lowest; nan where there is no standard deviation."""
        unknown = np.full(len(self.floor_mass), np.nan)
        return {name: (unknown if values is None else values).tolist() for name, values in self.known.items()}


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
        # Sensors' gains are no part of the frame's motion; attached masses stand on no floor.
        shapes = model.modes.shapes[:, : len(model.state.story_stiffness)]
        largest = shapes[np.arange(len(shapes)), np.argmax(np.abs(shapes), axis=1)]
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
        Of the configuration; empty for all together.
    iterations : int
    frame : IdentifiedFrame
    fit : Quality
    predictions : tuple of Prediction
    history : ndarray, shape (iterations + 1, N), optional
        Floor masses without added mass at the start and after each iteration, kg.
    mass_matrix : ndarray, shape (N, N), optional
        Where a baseline's corrected mass matrix is full; with added mass, kg.
    reason : Ending
        Why the iteration stopped.
    """

    name: str
    iterations: int
    frame: IdentifiedFrame
    fit: Quality
    predictions: tuple[Prediction, ...]
    history: Floats | None = None
    mass_matrix: Floats | None = None
    reason: Ending = Ending.SOLVED

    json_keys = "name converged iterations reason frame fit predictions history"

    @property
    def converged(self) -> bool:
        """Whether the iteration stopped because there was nothing left to gain."""
        return self.reason.converged

    def to_dict(self) -> Json:
        """Return the documented JSON; the full mass matrix only where there is one."""
        return super().to_dict() | ({} if self.mass_matrix is None else {"mass_matrix": as_json(self.mass_matrix)})


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
    """

    experiment: Experiment
    method: str
    backend: str
    parts: tuple[SingleIdentification, ...]
    joint: bool = False
    correlation: Floats | None = None
    parameter_names: tuple[str, ...] = ()
    undetermined: tuple[tuple[str, ...], ...] = field(default=())

    @property
    def single(self) -> SingleIdentification | None:
        """The only part, where there is only one."""
        return self.parts[0] if len(self.parts) == 1 else None

    @property
    def frame(self) -> IdentifiedFrame | None:
        """The identified frame; None where several configurations were identified each by itself."""
        return None if self.single is None else self.single.frame

    @property
    def fit(self) -> Quality | None:
        """Its errors; None where several configurations were identified each by itself."""
        return None if self.single is None else self.single.fit

    @property
    def converged(self) -> bool:
        """Whether every part converged."""
        return all(part.converged for part in self.parts)

    def to_dataframe(self) -> pd.DataFrame:
        """Return the identified masses and stiffnesses as a table of pandas.

        Returns
        -------
        DataFrame
            One row a floor of each part: configuration (empty for all together), floor, floor_mass (kg),
            floor_mass_std, story_stiffness (N/m, of the story below that floor), story_stiffness_std.

        Raises
        ------
        InputError
            Where pandas is not installed.
        """
        floors = range(1, self.experiment.stories + 1)
        named: dict[str, list[object]] = {
            "configuration": [part.name for part in self.parts for _ in floors],
            "floor": [floor for _ in self.parts for floor in floors],
        }
        frames = [part.frame.columns for part in self.parts]
        return data_frame(named | {key: [value for each in frames for value in each[key]] for key in frames[0]})

    def to_dict(self) -> Json:
        """Return the documented JSON."""
        single = None if self.single is None else self.single.to_dict()
        top = {
            key: None if single is None else single[key]
            for key in ("iterations", "reason", "frame", "fit", "predictions", "history")
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
