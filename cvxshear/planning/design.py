"""Knowledge of a frame before the test: design values, their uncertainty, and earlier measurements."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear import backends
from cvxshear.effects import LocatedEffect, Place, Scale, catalogue, compose
from cvxshear.fit.efficient import Estimate, efficient
from cvxshear.fit.misfit import Misfit
from cvxshear.io.toml import is_built_in, load, read_result, read_tables
from cvxshear.measurement.experiment import Configuration, Experiment, Frame, Measurement, Prior, opened
from cvxshear.model import modes
from cvxshear.priors import Value, check_prior
from cvxshear.screening import close_loop
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.quantities import listed
from cvxshear.util.typing import Floats, Ints

FRAME_QUANTITIES = ("floor_mass", "story_stiffness")
"""Quantities of a frame, in the order of the parameters."""

UNKNOWN_STD = 1.0
"""Least relative standard deviation of an unknown mass or stiffness; the uncertainty equals the value."""


@dataclass(frozen=True)
class MeasuredFrequency:
    """A measured frequency and the corresponding frequency of the plan's frame.

    Parameters
    ----------
    configuration : str
    mode : int
        1 the lowest.
    expected, measured : float
        Hz.
    """

    configuration: str
    mode: int
    expected: float
    measured: float

    @property
    def error(self) -> float:
        """Relative difference of the two frequencies."""
        return self.expected / self.measured - 1.0


@dataclass(frozen=True, eq=False)
class Design:
    """Knowledge of a frame before a test.

    Parameters
    ----------
    frame : Frame
        Frame with its number of stories.
    floor_mass, story_stiffness : ndarray, shape (N,)
        Expected values, kg without added mass and N/m.
    priors : tuple of Prior
        Uncertainty of the expected values.
    measured : Experiment or None
        Earlier measurements; their information counts.
    declared : tuple of Configuration
        Configurations of the file that gave the values.
    name : str
    effects : tuple of LocatedEffect
        Effects that an earlier loop found in the frame; they act in the planned tests, too.
    values, value_std : ndarray, shape (e,)
        Parameters of the effects in their units, and their standard deviations if no measurement counts.
    state : str or None
        State of the frame in the planned tests; None if it does not matter.
    """

    frame: Frame
    floor_mass: Floats
    story_stiffness: Floats
    priors: tuple[Prior, ...] = ()
    measured: Experiment | None = None
    declared: tuple[Configuration, ...] = ()
    name: str = "design"
    effects: tuple[LocatedEffect, ...] = ()
    values: Floats = field(default_factory=lambda: np.zeros(0))
    value_std: Floats = field(default_factory=lambda: np.zeros(0))
    state: str | None = None

    @property
    def stories(self) -> int:
        """Number of stories N."""
        return self.frame.stories

    @property
    def scale(self) -> Scale:
        """Mean floor mass, mean story stiffness and story heights; the expected sizes of effects depend on these."""
        heights = np.ones(self.stories) if self.frame.story_heights is None else self.frame.story_heights
        return Scale(float(self.floor_mass.mean()), float(self.story_stiffness.mean()), heights)

    @property
    def sizes(self) -> Floats:
        """Floor masses, then story stiffnesses, shape (2N,)."""
        return np.concatenate([self.floor_mass, self.story_stiffness])

    @property
    def theta(self) -> Floats:
        """Floor masses, story stiffnesses, and parameters of the effects found, shape (2N + e,)."""
        return np.concatenate([self.sizes, self.values])

    @property
    def units(self) -> Floats:
        """Size of each parameter, the unit of relative derivatives, shape (2N + e,)."""
        parameters = [item for placed in self.effects for item in placed.effect.parameters]
        away = [
            abs(value - item.null) or abs(item.start - item.null) or 1.0
            for item, value in zip(parameters, self.values, strict=True)
        ]
        return np.concatenate([self.sizes, away])

    def measured_frequencies(self) -> tuple[MeasuredFrequency, ...]:
        """Pairs of each frequency measured in the file and the frequency of this frame."""
        found: list[MeasuredFrequency] = []
        shell = self.shell()
        for test in self.declared:
            state = compose(shell, test, self.effects, self.theta, derivatives=False)
            expected = modes(state.system.M, state.system.K).frequencies[test.modes - 1]
            pairs = zip(test.modes, expected, test.frequencies, strict=True)
            found += [MeasuredFrequency(test.name, int(mode), float(own), float(seen)) for mode, own, seen in pairs]
        return tuple(found)

    def shell(self) -> Experiment:
        """Make an experiment with the frame's dimensions and expected masses for the forward model."""
        # The states of the file's tests do not apply to the planned test.
        unsaid = dataclasses.replace(
            self.frame, total_mass=None, total_mass_std=None, total_mass_placeholder=False, reference=None
        )
        frame = dataclasses.replace(unsaid, floor_masses=self.floor_mass)
        return Experiment(frame, (self.blank(np.zeros(self.stories), np.array([1])),))

    def blank(self, added_mass: Floats, modes: Ints) -> Configuration:
        """Make a configuration with these added masses and modes, 1 the lowest, and without measurements."""
        return Configuration(
            modes.astype(float), name="planned test", state=self.state or "", added_mass=added_mass, modes=modes
        )

    def fixed(self) -> Floats:
        """Return rows whose product with every relative change of masses and stiffnesses is zero, shape (e, 2N)."""
        n, size = self.stories, self.sizes
        rows = [np.zeros((0, 2 * n))]
        if self.frame.floor_masses is not None:
            rows.append(np.eye(n, 2 * n))
        elif self.frame.total_mass is not None and self.frame.total_mass_std is None:
            rows.append(self._of_the_total)
        for prior in self.priors:
            A = prior.constraints(n).A
            if A is not None:
                at = _place(prior, n)
                row = np.zeros((len(A), 2 * n))
                row[:, at] = A * size[at]
                rows.append(row / np.linalg.norm(row, axis=1, keepdims=True))
        return np.concatenate(rows)

    @property
    def _of_the_total(self) -> Floats:
        """Return the relative change of the total mass per relative change of each parameter, shape (1, 2N)."""
        share: Floats = np.concatenate([self.floor_mass, np.zeros(self.stories)])[None] / self.floor_mass.sum()
        return share

    def known(self, more: Sequence[LocatedEffect] = (), nulls: Sequence[float] = ()) -> Floats:
        """Return the prior information, rows in standard deviations, shape (k, 2N + e + m).

        Derivatives are relative to `units`.

        Parameters
        ----------
        more : sequence of LocatedEffect
            Possible effects with one parameter, besides the effects found; derivatives by these m parameters are in
            the parameters' own units.
        nulls : sequence of float
            Values of the parameters without an effect.
        """
        n, size = self.stories, self.sizes
        units = np.concatenate([self.units, np.ones(len(more))])
        if self.measured is not None:
            theta = np.concatenate([self.theta, nulls])
            return np.asarray(Misfit(self.measured, (*self.effects, *more)).evaluate(theta).J * units)
        rows = [np.zeros((0, len(units)))]
        if self.frame.total_mass_std is not None:
            rows.append(self._of_the_total @ np.eye(2 * n, len(units)) / self.frame.total_mass_std)
        for prior in self.priors:
            at = _place(prior, n)
            _, J = prior.residual(size[at])
            row = np.zeros((len(J), len(units)))
            row[:, at] = J * size[at]
            rows.append(row)
        for place, std in enumerate(self.value_std, 2 * n):
            if np.isfinite(std) and std > 0:
                rows.append(np.eye(1, len(units), place) * units[place] / std)
        return np.concatenate(rows)

    @staticmethod
    def of_experiment(
        experiment: Measurement, *, fresh: bool = False, loop: bool = False, configuration: str | None = None
    ) -> Design:
        """Take the frame from a measurement.

        Parameters
        ----------
        experiment : Experiment, path or name of a built-in
            Experiment that is fitted first.
        fresh : bool, optional
            Use the fitted values and the priors, but do not count the measurements as known.
        loop : bool, optional
            Use the frame with the effects that the loop finds, instead of the shear frame.
        configuration : str, optional
            Configuration or state of the frame in the planned tests; the first configuration if None.
        """
        experiment = opened(experiment)
        state_of = {each.state: each.state for each in experiment.configurations}
        state_of |= {each.name: each.state for each in experiment.configurations}
        if configuration is not None:
            checks.choice(configuration, list(state_of), "configuration")
        found: Estimate = close_loop(experiment).estimate if loop else efficient(experiment, backends.get("auto"))
        n = experiment.stories
        determined = found.uncertainty.determined[: 2 * n]
        if not np.all(determined):
            open_ones = listed(found.uncertainty.null_directions[0][:4])
            raise InputError(
                f"{experiment.name} does not determine {open_ones}, so there is no frame to plan for; declare design "
                "values (a nominal prior with std)"
            )
        local = configuration is not None or any(placed.place.state is not None for placed in found.effects)
        return Design(
            experiment.frame,
            found.theta[:n],
            found.theta[n : 2 * n],
            experiment.priors,
            None if fresh else found.experiment,
            found.experiment.configurations,
            experiment.name,
            found.effects,
            found.theta[2 * n :],
            found.std[2 * n :],
            state_of[configuration or experiment.configurations[0].name] if local else None,
        )

    @staticmethod
    def of_file(declared: Mapping[str, Any], name: str) -> Design:
        """Read the frame of a measurement file without configurations: `[frame]` and priors with design values.

        Raises
        ------
        InputError
            If no design values are declared.
        """
        if "record" in declared:
            raise InputError(
                "a record file holds no design values: plan with the measurement file that 'cvxshear modes' makes of it"
            )
        table = checks.keys(declared, ["frame", "prior"], ["prior"], "a file of design values")
        frame = Frame.from_dict(table.get("frame") or {})
        priors = tuple(Prior.from_dict(item) for _, item in checks.tables(table, "prior"))
        stiffness = _nominal(priors, "story_stiffness", frame.stories)
        if stiffness is None:
            raise InputError(
                'no story stiffness is expected: add a [[prior]] with kind = "nominal", quantity = "story_stiffness", '
                "its design values and their std"
            )
        mass = frame.floor_masses if frame.floor_masses is not None else _nominal(priors, "floor_mass", frame.stories)
        n = len(stiffness)
        if mass is None and frame.total_mass is not None:
            mass = np.ones(n)
        if mass is None:
            raise InputError(
                "no floor mass is expected: declare frame: floor_masses or total_mass, or a nominal prior of floor_mass"
            )
        if len(mass) != n or frame.stories not in (0, n):
            raise InputError(
                f"{n} story stiffnesses, {len(mass)} floor masses and frame: stories = {frame.stories or 'not given'} "
                "must agree"
            )
        if frame.total_mass is not None and frame.floor_masses is None:
            mass = mass * frame.total_mass / mass.sum()
        for prior in priors:
            check_prior(prior, n)
        frame = dataclasses.replace(frame, stories=n)
        return Design(frame, np.array(mass), np.array(stiffness), priors, name=name)

    @staticmethod
    def of_result(result: Mapping[str, Any], name: str) -> Design:
        """Read the frame from the JSON of a result of `identify` or `loop`: values with standard deviations.

        Raises
        ------
        InputError
            If the result has no frame.
        """
        frame = result.get("frame")
        keys = [f"{quantity}{part}" for quantity in FRAME_QUANTITIES for part in ("", "_std")]
        if not isinstance(frame, Mapping) or any(not isinstance(frame.get(key), list) for key in keys):
            raise InputError(
                f"{name} holds no frame with standard deviations; it must be the JSON of loop, or of identify by the "
                "efficient method"
            )
        mass, stiffness = (checks.vector(frame[key], f"frame: {key}", above=0.0) for key in FRAME_QUANTITIES)
        priors = tuple(
            Value(quantity=quantity, at=place, value=float(value), std=None if not std else float(std) / float(value))
            for quantity, values in zip(FRAME_QUANTITIES, (mass, stiffness), strict=True)
            for place, (value, std) in enumerate(zip(values, frame[f"{quantity}_std"], strict=True), 1)
        )
        return Design(Frame(stories=len(mass)), mass, stiffness, priors, None, (), name, *_effects(result))


def _place(prior: Prior, n: int) -> slice:
    return slice(0, n) if prior.quantity == "floor_mass" else slice(n, 2 * n)


def _nominal(priors: Sequence[Prior], quantity: str, stories: int) -> Floats | None:
    """Read the design values of a quantity if a prior declares all of them; `stories` is 0 if not declared."""
    values = [prior.suggested(stories) for prior in priors if prior.quantity == quantity]
    return next((each for each in values if each is not None and each.size and not np.any(np.isnan(each))), None)


def _effects(result: Mapping[str, Any]) -> tuple[tuple[LocatedEffect, ...], Floats, Floats]:
    """Read the effects that a loop's result has in every state, their parameters and standard deviations.

    Raises
    ------
    InputError
        If an effect needs data that the result lacks, such as story heights.
    """
    there = {effect.name: effect for effect in catalogue()}
    found, values, std = [], [], []
    for item in (*(result.get("assumed") or ()), *(result.get("effects") or ())):
        effect = there.get(item["name"])
        if item.get("configuration") is None:
            if effect is None or "heights" in effect.needs or any(each.unit_in_stories for each in effect.parameters):
                raise InputError(
                    f"the result holds {item['name']}, which cannot be made again without the measurement; plan for "
                    "the measurement file itself, with the option loop"
                )
            parts = {each.name: item.get(each.name) for each in dataclasses.fields(Place) if each.name != "state"}
            found.append(LocatedEffect(effect, Place(**parts)))
            values += [float(value) for value in item["parameters"].values()]
            std += [float(item.get("std", {}).get(name) or np.nan) for name in item["parameters"]]
    return tuple(found), np.array(values), np.array(std)


def read_design(
    source: str | Path | Experiment, *, fresh: bool = False, loop: bool = False, configuration: str | None = None
) -> Design:
    """Read the frame before the test from a source.

    Parameters
    ----------
    source : str, Path or Experiment
        "paper"; a TOML file with configurations (fitted first) or without (design values); the JSON of a result.
    fresh : bool, optional
        Do not count earlier measurements as known.
    loop : bool, optional
        Close the loop on the measurements, and plan for the frame with the effects found.
    configuration : str, optional
        Configuration or state of the frame in the planned tests.

    Raises
    ------
    InputError
        If the source is not valid; the message names the file and the remedy.
    """
    measured = source if isinstance(source, Experiment) else measurement_of(source)
    if measured is not None:
        return Design.of_experiment(measured, fresh=fresh, loop=loop, configuration=configuration)
    path = Path(str(source))
    try:
        if loop or configuration:
            raise InputError("loop and configuration need a file with measured modes ([[configuration]])")
        if path.suffix.lower() == ".json":
            return Design.of_result(read_result(path), path.stem)
        return Design.of_file(read_tables(path), path.stem)
    except InputError as error:
        raise error if str(error).startswith(str(path)) else type(error)(f"{path}: {error}") from error


def measurement_of(source: str | Path) -> Experiment | None:
    """Read the measurements of a file; None if the file has design values or the JSON of a result.

    Raises
    ------
    InputError
        If the file is not valid; the message names the file and the remedy.
    """
    if is_built_in(source):
        return load(source)
    path = Path(source)
    if path.suffix.lower() == ".json" or "configuration" not in read_tables(path):
        return None
    return load(path)
