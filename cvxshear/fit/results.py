"""Results of an identification: the frame, its predictions, and the errors of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy import special

from cvxshear.backends import SolvedProgram
from cvxshear.data import Datum, Model, noise_kinds
from cvxshear.fit.gauss_newton import Ending
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.programs import ActiveConstraint
from cvxshear.util import ranking
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.results import InJson, Shown, as_json
from cvxshear.util.typing import Bools, Floats, Ints, Json

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
class OtherFrame(InJson):
    """A frame that fits the data as well as the identified one, or nearly so.

    Parameters
    ----------
    floor_mass : ndarray, shape (N,)
        kg, without added mass.
    story_stiffness : ndarray, shape (N,)
        N/m.
    chi2 : float
    probability : float
        Relative to all frames that were found.
    """

    floor_mass: Floats
    story_stiffness: Floats
    chi2: float
    probability: float

    json_keys = "floor_mass story_stiffness chi2 probability"


@dataclass(frozen=True)
class NextTest(InJson):
    """Test that would distinguish the rivals.

    Parameters
    ----------
    floor : int
    added_mass : float
        Mass on that floor, kg, in addition to the first configuration of its state.
    state : str
        State of the frame in the test.
    standard_deviations : float
        Distance between the predictions of the accepted model and of its nearest rival.
    tells_all : bool
        Whether some added mass would distinguish every rival from the accepted model.
    """

    floor: int
    added_mass: float
    state: str
    standard_deviations: float
    tells_all: bool = True


@dataclass(frozen=True, eq=False)
class OtherFrames:
    """All frames besides an estimate that fit its data (`fit/other_frames.py`).

    Parameters
    ----------
    frames : tuple of OtherFrame
        The most probable first.
    searched : str
        What was searched, in words; empty if the data determine the frame.
    next_test : NextTest or None
        The added mass that tells the identified frame from the others best; None without others or such a mass.
    """

    frames: tuple[OtherFrame, ...] = ()
    searched: str = ""
    next_test: NextTest | None = None


@dataclass(frozen=True)
class Quality(InJson):
    """Errors of a model, relative and not in percent.

    Parameters
    ----------
    errors : mapping of str to float or None
        Every error figure that a kind of data declares, by its key; None if the kind was not measured.
    chi2 : float
        Sum of squared standardized residuals, soft priors included.
    dof : int
        Number of data less number of free parameters.
    p_value : float or None
        p-value of chi2, if the noise is declared and a degree of freedom is left.
    """

    json_keys: ClassVar[str] = "*errors chi2 dof p_value"

    errors: Mapping[str, float | None]
    chi2: float
    dof: int
    p_value: float | None

    @staticmethod
    def of(errors: Mapping[str, float | None], chi2: float, dof: int, *, declared: bool) -> Quality:
        """Add the p-value of chi2, if every standard deviation is declared; figures without a value are None."""
        figures = [figure.key for kind in noise_kinds().values() for figure in kind.figures]
        p_value = float(special.chdtrc(dof, chi2)) if declared and dof > 0 else None
        return Quality({key: errors.get(key) for key in figures}, chi2, dof, p_value)

    @property
    def max_frequency_error(self) -> float:
        """Largest |model / measured - 1| of a frequency."""
        return self.errors["max_frequency_error"] or 0.0

    @property
    def rms_frequency_error(self) -> float:
        """Root mean square of model / measured - 1 of the frequencies."""
        return self.errors["rms_frequency_error"] or 0.0

    @property
    def min_mac(self) -> float | None:
        """Smallest modal assurance criterion; None if no shape was measured at two floors."""
        return self.errors["min_mac"]

    @property
    def max_shape_error(self) -> float | None:
        """Largest difference of a shape entry; None without measured shapes.

        The measured mode is scaled to a largest entry of 1 and the model's to it by least squares.
        """
        return self.errors["max_shape_error"]

    @property
    def max_displacement_error(self) -> float | None:
        """Largest difference of a displacement over the largest of its test; None without measured displacements."""
        return self.errors["max_displacement_error"]


def quality(data: Sequence[Datum], models: Sequence[Model], chi2: float, dof: int, *, declared: bool) -> Quality:
    """Compute the errors of a model.

    Parameters
    ----------
    data : sequence of Datum
    models : sequence of Model
        One a tested state.
    chi2 : float
    dof : int
    declared : bool
        Whether every standard deviation is declared, so that chi2 has a chi-square distribution.
    """
    by_tested = {id(model.state.tested): model for model in models}
    found: dict[str, list[Floats]] = {}
    for datum in data:
        for name, values in datum.errors(by_tested[id(datum.tested)]).items():
            found.setdefault(name, []).append(values)
    errors: dict[str, float | None] = {}
    for figure in (each for kind in noise_kinds().values() for each in kind.figures):
        values = np.concatenate(found.get(figure.errors, [np.zeros(0)]))
        errors[figure.key] = float(figure.statistic(values)) if values.size else None
    return Quality.of(errors, chi2, dof, declared=declared)


@dataclass(frozen=True, eq=False)
class Prediction(InJson):
    """All modes of the model at all floors, or at the sensors of floors that turn, in one configuration.

    Parameters
    ----------
    configuration : str
    frequencies : ndarray, shape (N,)
        Hz.
    mode_shapes : ndarray, shape (N, N)
        One row a mode, largest entry 1.
    modes : ndarray of int, shape (m,)
        Mode of the model that each measured mode is compared with, from 1: the declared one; of floors that turn, that
        of the largest sum of the MACs.
    """

    configuration: str
    frequencies: Floats
    mode_shapes: Floats
    modes: Ints


def predictions(models: Sequence[Model]) -> tuple[Prediction, ...]:
    """Predict every mode in each configuration, from the models of the tested states."""
    found = []
    for model in models:
        if isinstance(model.state.tested, Configuration):
            test, modes = model.state.tested, model.modes
            # Gains of sensors are not part of the motion; attached masses are not floors.
            shapes = modes.shapes @ test.sensor_rows.T if test.sensors else modes.shapes[:, : len(test.added_mass)]
            largest = shapes[np.arange(len(shapes)), ranking.largest(np.abs(shapes))]
            scaled = shapes / np.where(largest != 0, largest, 1.0)[:, None]
            pairs = model.paired + 1 if test.sensors else test.modes
            found.append(Prediction(test.name, modes.frequencies, scaled, pairs))
    return tuple(found)


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
    others : OtherFrames
        Other frames that fit the same data as well, if these are few.
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
    others: OtherFrames = field(default_factory=OtherFrames)

    @property
    def other_frames(self) -> tuple[OtherFrame, ...]:
        """Other frames that fit the same data as well, the most probable first."""
        return self.others.frames

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
            result["other_frames"] = as_json(self.other_frames)
            result["searched"] = self.others.searched
            result["next_test"] = as_json(self.others.next_test)
            result["at_bounds"] = [name for part in self.parts for name in part.frame.at_bounds]
        else:
            result["configurations"] = [part.to_dict() for part in self.parts] if single is None else [single]
        return result
