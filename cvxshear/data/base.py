"""Base class of all kinds of data, and the model of a tested state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from cvxshear.effects.state import State
from cvxshear.measurement.experiment import Configuration, Experiment, Tested
from cvxshear.model import Modes, Observation, System, attached_share, frame_modes, mode_derivatives, modes
from cvxshear.util import decorators, ranking
from cvxshear.util.errors import InputError
from cvxshear.util.results import InJson
from cvxshear.util.typing import Bools, Floats, Ints

#: Minimum modal assurance criterion of a measured mode and its mode in the model; below it, the other modes are
#: searched.
PAIRED = 0.5

#: Minimum share of an attached mass in the kinetic energy of a mode shared with the frame. A mode with less resembles a
#: mode of the frame alone, and with more than 1 - SHARED a mode of the mass alone.
SHARED = 0.1


@dataclass(frozen=True)
class ErrorFigure:
    """An error of a kind of data that an engineer reads.

    Parameters
    ----------
    key : str
        Its key in the JSON: "max_frequency_error".
    label : str
        Its name in tables and sentences: "largest frequency error".
    errors : str
        Key of the errors in `Datum.errors` that it summarizes.
    statistic : callable
        Takes these errors of all data, and returns one number.
    relative : bool
        Whether it is a share, written in percent.
    """

    key: str
    label: str
    errors: str
    statistic: Callable[[Floats], Any]
    relative: bool = True


@dataclass(frozen=True)
class NoiseKind:
    """The noise of a kind of data: how large it is, and which errors it makes.

    Parameters
    ----------
    name : str
        Its key in the JSON, in the singular: "mode_shape".
    plural : str
        Name of the data: "mode shapes".
    default : float
        Standard deviation if none is declared; the estimated factor multiplies it.
    largest : float
        Largest standard deviation that instruments have.
    reason : str
        Why these two.
    figures : tuple of ErrorFigure
        A headline names the first one that is relative.
    negligible : float
        Largest relative error that no engineer would look into.
    unit : str
        Unit of the standard deviations; empty where they are relative.
    """

    name: str
    plural: str
    default: float
    largest: float
    reason: str
    figures: tuple[ErrorFigure, ...] = ()
    negligible: float = 0.0
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse deviations that leave no room for an estimate."""
        if not 0 < self.default <= self.largest:
            raise InputError(
                f"noise {self.name!r}: default {self.default:g} and largest {self.largest:g} must be positive, "
                "the largest not below the default"
            )

    @property
    def leading(self) -> ErrorFigure | None:
        """The error that a headline names; None where no error is relative."""
        return next((each for each in self.figures if each.relative), None)

    def sized(self, *factors: float) -> tuple[tuple[float, ...], str]:
        """Scale the default by each factor, with its unit: percent where it is relative."""
        scale = self.default if self.unit else 100 * self.default
        return tuple(scale * factor for factor in factors), self.unit or "%"


def largest(errors: Floats) -> float:
    """Find the largest size of an error."""
    return float(np.max(np.abs(errors)))


@dataclass(frozen=True)
class NoiseFactors:
    """Factors on the default standard deviations of what declares none.

    Parameters
    ----------
    factors : tuple of (str, float)
        The name of each noise whose standard deviation somebody left open, with its factor.
    """

    factors: tuple[tuple[str, float], ...] = ()

    def of(self, kind: str) -> float:
        """Return the factor of a kind of noise; 1 for other kinds."""
        return dict(self.factors).get(kind, 1.0)


def numbered(configuration: Configuration, found: Modes, M: Floats, motions: int = 1) -> Ints:
    """Find the modes of the model that a configuration's mode numbers mean, zero-based, shape (m,).

    Numbers count the modes of the frame, without the own mode of a mass that is attached to a floor. Where that mass
    shares its energy among several modes, as one that is tuned to a mode does, each of them may be the one that was
    not measured; the numbers are then those that fit the measured frequencies best.
    """
    floors = motions * len(configuration.added_mass)
    declared = configuration.modes - 1
    if len(M) == floors:
        return declared
    if len(M) == floors + 1:
        share = attached_share(found, M, floors)
        every = np.arange(floors + 1)
        unseen = set(np.flatnonzero(share >= SHARED).tolist())
        if share.max() <= 1.0 - SHARED:
            unseen.add(floors)
        log_found, measured = np.log(found.frequencies), np.log(configuration.frequencies)
        candidates = [np.delete(every, mode)[declared] for mode in sorted(unseen)]
        return ranking.ranked(candidates, lambda each: -float(np.sum((log_found[each] - measured) ** 2)))[0]
    return np.asarray(frame_modes(found, M, floors)[declared])


def paired(configuration: Configuration, found: Modes, observation: Observation, M: Floats, motions: int = 1) -> Ints:
    """Which mode of the model each measured one is, zero-based.

    The declared numbers hold unless a shape speaks against them; modes that changed places are then paired
    by the assignment of the largest modal assurance criteria among the declared ones; of floors that turn, among all.

    Parameters
    ----------
    configuration : Configuration
    found : Modes
    observation : Observation
        What the sensors show of the modes.
    M : ndarray, shape (n, n)
    motions : int, optional
        Motions of each floor.
    """
    declared = numbered(configuration, found, M, motions)
    entries = configuration.entry_rows
    if len(declared) < 2 or len(entries) < 2 or not configuration.measured.any():
        return declared
    weights, shapes = configuration.entry_weights, configuration.known_shapes
    psi = observation.shown(found.shapes[declared], entries)
    modelled, measured = weights * psi, weights * shapes
    own = np.sum(modelled * measured, axis=1) ** 2
    if np.all(own >= PAIRED * np.sum(modelled**2, axis=1) * np.sum(measured**2, axis=1)):
        return declared
    among, numbers = declared, np.eye(len(declared))
    if motions > 1:
        # Sensors along one axis see some modes only, and modes in two directions have close frequencies.
        among = np.arange(len(found.eigenvalues))
        psi, numbers = observation.shown(found.shapes, entries), np.eye(len(among))[declared]
    cross = (weights**2 * shapes) @ psi.T
    energy = weights**2 @ (psi**2).T
    # Of a mode that the sensors do not see, they show rounding, which can resemble any measured shape.
    energy[energy <= np.finfo(float).eps * energy.max(axis=1, keepdims=True)] = np.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        criteria = cross**2 / (np.sum(measured**2, axis=1)[:, None] * energy)
    known = np.sum(weights > 0, axis=1) > 1
    unseen = np.zeros_like(criteria) if motions > 1 else numbers
    criteria = np.where(known[:, None], np.where(np.isfinite(criteria), criteria, unseen), numbers)
    if motions == 1 and np.all(np.diag(criteria) >= PAIRED):
        return declared
    _, columns = linear_sum_assignment(-criteria)
    return np.asarray(among[columns])


@dataclass(frozen=True, eq=False)
class Model:
    """The model of one tested state, as data of every kind see it.

    Parameters
    ----------
    state : State
        Matrices with the effects in them, and their derivatives by P parameters.
    by : slice
        Parameters of the derivatives.
    derivatives : bool
        Whether to compute derivatives.
    """

    state: State
    by: slice
    derivatives: bool

    def without_derivatives(self) -> Model:
        """Return the same without derivatives: of a tall frame they take most of the memory."""
        system = self.state.system
        none = np.zeros((0, *system.K.shape))
        return Model(self.state.having(system=System(system.M, system.K, none, none)), self.by, False)

    @decorators.cached_property
    def modes(self) -> Modes:
        """All modes."""
        return modes(self.state.system.M, self.state.system.K)

    @decorators.cached_property
    def wanted(self) -> System:
        """The matrices, with the derivatives that are wanted."""
        return self.state.system.by(self.by)

    @decorators.cached_property
    def paired(self) -> Ints:
        """Which mode of the model each measured one is, zero-based, shape (m,)."""
        assert isinstance(self.state.tested, Configuration)
        motions = self.state.experiment.motions.count
        return paired(self.state.tested, self.modes, self.state.observation, self.state.system.M, motions)

    @decorators.cached_property
    def mode_derivatives(self) -> tuple[Floats, Floats]:
        """Derivatives of the paired eigenvalues, shape (P, m), and mass-normalized shapes, shape (P, m, N)."""
        return mode_derivatives(self.modes, self.wanted, self.paired)


@dataclass(frozen=True, eq=False)
class Residual:
    """Model less measurement in standard deviations.

    Parameters
    ----------
    r : ndarray, shape (d,)
    J : ndarray, shape (d, P)
        dr/dtheta; of no rows where no derivatives were wanted.
    """

    r: Floats
    J: Floats


class Datum(ABC):
    """Data of one kind from one tested state.

    A kind of one's own is a subclass with these attributes and methods, handed to `cvxshear.data.register`.

    Attributes
    ----------
    noise : NoiseKind
        How such data err; kinds of data may share a noise.
    tested : Tested
        The state of the frame that it was measured in.
    """

    noise: ClassVar[NoiseKind]
    tested: Tested

    @classmethod
    @abstractmethod
    def of(cls, experiment: Experiment) -> Sequence[Datum]:
        """All data of this kind in an experiment."""

    @property
    def label(self) -> str:
        """Quantity and test in words: 'frequencies of "bare"'."""
        return f'{self.noise.plural} of "{self.tested.name}"'

    @property
    def declared(self) -> bool:
        """Whether its standard deviation was declared: `frequency_std` of the test for the noise "frequency"."""
        return getattr(self.tested, f"{self.noise.name}_std", None) is not None

    @property
    @abstractmethod
    def count(self) -> int:
        """Number of data: entries, less what each of them leaves free."""

    @property
    def floors(self) -> Ints:
        """The floor that each residual was measured at, shape (d,); 0 where it is of no floor in particular."""
        return np.zeros(self.count, dtype=np.int64)

    @property
    def known(self) -> Bools:
        """Which residuals were measured, shape (d,)."""
        return np.ones(len(self.floors), dtype=bool)

    @property
    def entries(self) -> int:
        """Number of residuals that were measured."""
        return int(np.sum(self.known))

    @abstractmethod
    def residual(self, model: Model) -> Residual:
        """Model less measurement, in the declared or the default standard deviations."""

    def inflated_residual(self, model: Model, factor: Floats) -> Residual:
        """`residual` with each standard deviation times a factor, shape (d,)."""
        found = self.residual(model)
        return Residual(found.r / factor, found.J / factor[:, None] if model.derivatives else found.J)

    def errors(self, model: Model) -> Mapping[str, Floats]:
        """Errors that an engineer reads, by the keys that its noise summarizes; none by default."""
        return {}

    def without(self, left_out: Bools) -> Datum:
        """Leave out some of the modes of its configuration, where it speaks of modes."""
        return self

    @property
    def parts(self) -> Sequence[str]:
        """Names of the parts that `describe` lists, in the order of the residuals; by default all data together."""
        return (self.label,)

    def describe(self, model: Model) -> list[Deviation]:
        """Describe its parts, each with its error and deviation.

        The error of a part is its entry of the last errors, or the largest of the first errors if there is one part.
        """
        parts, errors = self.parts, list(self.errors(model).values())
        z, known = (each.reshape(max(len(parts), 1), -1) for each in (self.residual(model).r, self.known))
        found = []
        for place, name in enumerate(parts):
            own = z[place][known[place]]
            deviation = float(own[0]) if z.shape[1] == 1 else float(np.sqrt(np.mean(own**2))) if own.size else 0.0
            error = None
            if errors and errors[-1].size == len(parts):
                error = float(errors[-1][place])
            elif errors and errors[0].size:
                error = float(errors[0][ranking.first_largest(np.abs(errors[0]))])
            found.append(Deviation(self.noise.name, self.tested.name, name, error, deviation, max(own.size, 1)))
        return found

    def by_floor(self, model: Model) -> Mapping[int, Floats]:
        """Residuals in standard deviations by the floor they were measured at; none where they are of no floor."""
        r, floors = self.residual(model).r, np.where(self.known, self.floors, 0)
        return {int(floor): r[floors == floor] for floor in np.unique(floors) if floor}


@dataclass(frozen=True)
class Deviation(InJson):
    """How far a part of the measurement lies from the model.

    Parameters
    ----------
    noise : str
        Name of the noise, or "prior" for a declared statement.
    configuration : str
        Where it was measured; empty for a statement.
    place : str
        Which part, such as "mode 1" or "floor 2"; the statement in words.
    error : float or None
        Relative.
    deviations : float
        In standard deviations; root mean square over the entries where there are several.
    entries : int
    """

    noise: str
    configuration: str
    place: str
    error: float | None
    deviations: float
    entries: int = 1

    @property
    def label(self) -> str:
        """Name of the part, such as 'the frequency of mode 1 of "bare"'."""
        if not self.configuration:
            return f'the statement "{self.place}"'
        return f'the {self.noise.replace("_", " ")} of {self.place} of "{self.configuration}"'


#: Every kind of data by the name of its class, the built-in ones first.
REGISTERED: dict[str, type[Datum]] = {}


def register(kind: type[Datum]) -> None:
    """Add a kind of datum; one of the same name is replaced.

    Raises
    ------
    InputError
        Where it declares no noise or not the errors that the noise's figures summarize, or another kind has a
        different noise of that name.
    """
    noise = getattr(kind, "noise", None)
    if not isinstance(noise, NoiseKind):
        raise InputError(f"{kind.__name__}.noise is {noise!r}: declare a NoiseKind")
    if noise.figures and kind.errors is Datum.errors:
        raise InputError(f"{kind.__name__}: its noise has figures, so errors() must return {noise.figures[0].errors!r}")
    for other in REGISTERED.values():
        if other.__name__ != kind.__name__ and other.noise.name == noise.name and other.noise != noise:
            raise InputError(f"{kind.__name__}.noise: the name {noise.name!r} is that of the noise of {other.__name__}")
    REGISTERED[kind.__name__] = kind


def noise_kinds() -> dict[str, NoiseKind]:
    """List the noise of every kind of data, by its name."""
    return {kind.noise.name: kind.noise for kind in REGISTERED.values()}


def data_of(experiment: Experiment) -> list[Datum]:
    """All data of an experiment, kind by kind within each tested state."""
    found = [datum for kind in REGISTERED.values() for datum in kind.of(experiment)]
    order = {id(tested): place for place, tested in enumerate(experiment.tested)}
    return sorted(found, key=lambda datum: order[id(datum.tested)])
