"""Knowledge of a frame before a test: design values with their uncertainty, and earlier measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear import backends
from cvxshear.fit.efficient import Estimate, efficient
from cvxshear.fit.misfit import Misfit
from cvxshear.io.toml import is_built_in, load, read_tables
from cvxshear.measurement.experiment import Configuration, Experiment, Frame, Measurement, Prior, opened
from cvxshear.priors import check_prior
from cvxshear.util import checks
from cvxshear.util.errors import InputError, UnsuitableError
from cvxshear.util.quantities import listed
from cvxshear.util.typing import Floats, Ints

#: Least relative standard deviation of an unknown mass or stiffness; the uncertainty equals the value.
UNKNOWN_STD = 1.0


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
    """

    frame: Frame
    floor_mass: Floats
    story_stiffness: Floats
    priors: tuple[Prior, ...] = ()
    measured: Experiment | None = None
    declared: tuple[Configuration, ...] = ()
    name: str = "design"

    @property
    def stories(self) -> int:
        """Number of stories N."""
        return self.frame.stories

    @property
    def sizes(self) -> Floats:
        """Floor masses, then story stiffnesses, shape (2N,)."""
        return np.concatenate([self.floor_mass, self.story_stiffness])

    def shell(self) -> Experiment:
        """Make an experiment with the frame's dimensions and expected masses for the forward model."""
        # The states of the file's tests do not apply to the planned test.
        unsaid = replace(self.frame, total_mass=None, total_mass_std=None, total_mass_placeholder=False, reference=None)
        frame = replace(unsaid, floor_masses=self.floor_mass)
        return Experiment(frame, (self.blank(np.zeros(self.stories), np.array([1])),))

    def blank(self, added_mass: Floats, modes: Ints) -> Configuration:
        """Make a configuration with these added masses and modes, 1 the lowest, and without measurements."""
        return Configuration(modes.astype(float), name="planned test", added_mass=added_mass, modes=modes)

    def fixed(self) -> Floats:
        """Return rows whose product with every relative change of masses and stiffnesses is zero, shape (e, 2N)."""
        n = self.stories
        rows = [np.zeros((0, 2 * n))]
        if self.frame.floor_masses is not None:
            rows.append(np.eye(n, 2 * n))
        elif self.frame.total_mass is not None and self.frame.total_mass_std is None:
            rows.append(self.share_of_total)
        for prior in self.priors:
            A = prior.constraints(n).A
            if A is not None:
                row = self._by_relative_changes(prior, A)
                rows.append(row / np.linalg.norm(row, axis=1, keepdims=True))
        return np.concatenate(rows)

    @property
    def share_of_total(self) -> Floats:
        """Return the relative change of the total mass per relative change of each parameter, shape (1, 2N)."""
        return np.asarray(np.concatenate([self.floor_mass, np.zeros(self.stories)])[None] / self.floor_mass.sum())

    def known(self) -> Floats:
        """Return the prior information, rows in standard deviations by relative changes, shape (k, 2N)."""
        if self.measured is not None:
            return np.asarray(Misfit(self.measured, ()).evaluate(self.sizes).J * self.sizes)
        rows = [np.zeros((0, 2 * self.stories))]
        if self.frame.total_mass_std is not None:
            rows.append(self.share_of_total / self.frame.total_mass_std)
        for prior in self.priors:
            _, J = prior.residual(self.sizes[self.place(prior.quantity)])
            rows.append(self._by_relative_changes(prior, J))
        return np.concatenate(rows)

    def place(self, quantity: str) -> slice:
        """Return the place of the floor masses, or of the story stiffnesses, among all parameters."""
        return slice(0, self.stories) if quantity == "floor_mass" else slice(self.stories, None)

    def _by_relative_changes(self, prior: Prior, rows: Floats) -> Floats:
        """Write rows about the quantity of a prior as rows by relative changes of all parameters, shape (k, 2N)."""
        at, found = self.place(prior.quantity), np.zeros((len(rows), 2 * self.stories))
        found[:, at] = rows * self.sizes[at]
        return found

    @staticmethod
    def of_experiment(experiment: Measurement, *, fresh: bool = False) -> Design:
        """Take the frame from a measurement.

        Parameters
        ----------
        experiment : Experiment, path or name of a built-in
            Experiment that is fitted first.
        fresh : bool, optional
            Use the fitted values and the priors, but do not count the measurements as known.
        """
        experiment = opened(experiment)
        found: Estimate = efficient(experiment, backends.get("auto"))
        n = experiment.stories
        determined = found.uncertainty.determined[: 2 * n]
        if not np.all(determined):
            open_ones = listed(found.uncertainty.null_directions[0][:4])
            raise InputError(
                f"{experiment.name} does not determine {open_ones}, so there is no frame to plan for; declare design "
                "values (a nominal prior with std)"
            )
        return Design(
            experiment.frame,
            found.theta[:n],
            found.theta[n : 2 * n],
            experiment.priors,
            None if fresh else found.experiment,
            found.experiment.configurations,
            experiment.report.title or experiment.name,
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
        if frame.turns:
            raise UnsuitableError("the floors turn (frame: motions); a plan is for frames with one motion per floor")
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
        frame = replace(frame, stories=n)
        return Design(frame, np.array(mass), np.array(stiffness), priors, name=name)


def _nominal(priors: Sequence[Prior], quantity: str, stories: int) -> Floats | None:
    """Read the design values of a quantity if a prior declares all of them; `stories` is 0 if not declared."""
    values = [prior.suggested(stories) for prior in priors if prior.quantity == quantity]
    return next((each for each in values if each is not None and each.size and not np.any(np.isnan(each))), None)


def read_design(source: Measurement, *, fresh: bool = False) -> Design:
    """Read the frame before the test from a source.

    Parameters
    ----------
    source : str, Path, dict or Experiment
        "paper"; a TOML file, or its dict, with configurations (fitted first) or without (design values).
    fresh : bool, optional
        Do not count earlier measurements as known.

    Raises
    ------
    InputError
        If the source is not valid; the message names the file and the remedy.
    """
    if isinstance(source, Mapping) and "configuration" not in source:
        return Design.of_file(source, "design")
    measured = measurement_of(source) if isinstance(source, str | Path) else opened(source)
    if measured is not None:
        return Design.of_experiment(measured, fresh=fresh)
    path = Path(str(source))
    with checks.named(str(path)):
        return Design.of_file(read_tables(path), path.stem)


def measurement_of(source: str | Path) -> Experiment | None:
    """Read the measurements of a file; None if the file has design values.

    Raises
    ------
    InputError
        If the file is not valid; the message names the file and the remedy.
    """
    return load(source) if is_built_in(source) or "configuration" in read_tables(Path(source)) else None
