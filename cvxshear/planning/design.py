"""Knowledge of a frame before the test, and the expected results of tests that have not been made.

The knowledge is design values with their uncertainty, and earlier measurements. The expected results have their noise,
and their derivatives by the frame's parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg

from cvxshear import backends
from cvxshear.fit import misfit
from cvxshear.fit.efficient import Estimate, efficient
from cvxshear.fit.misfit import ExpectedTest, Misfit
from cvxshear.io.toml import is_built_in, load, read_tables
from cvxshear.measurement.configuration import DEFAULT_FREQUENCY_STD, DEFAULT_MODE_SHAPE_STD
from cvxshear.measurement.experiment import Configuration, Experiment, Frame, Measurement, Prior, opened
from cvxshear.planning.choice import Candidates, candidates, free_changes
from cvxshear.priors import check_prior
from cvxshear.util import checks
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError
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
        n, size = self.stories, self.sizes
        rows = [np.zeros((0, 2 * n))]
        if self.frame.floor_masses is not None:
            rows.append(np.eye(n, 2 * n))
        elif self.frame.total_mass is not None and self.frame.total_mass_std is None:
            rows.append(self.share_of_total)
        for prior in self.priors:
            A = prior.constraints(n).A
            if A is not None:
                at = _place(prior, n)
                row = np.zeros((len(A), 2 * n))
                row[:, at] = A * size[at]
                rows.append(row / np.linalg.norm(row, axis=1, keepdims=True))
        return np.concatenate(rows)

    @property
    def share_of_total(self) -> Floats:
        """Return the relative change of the total mass per relative change of each parameter, shape (1, 2N)."""
        return np.asarray(np.concatenate([self.floor_mass, np.zeros(self.stories)])[None] / self.floor_mass.sum())

    def known(self) -> Floats:
        """Return the prior information, rows in standard deviations by relative changes, shape (k, 2N)."""
        n, size = self.stories, self.sizes
        if self.measured is not None:
            return np.asarray(Misfit(self.measured, ()).evaluate(size).J * size)
        rows = [np.zeros((0, 2 * n))]
        if self.frame.total_mass_std is not None:
            rows.append(self.share_of_total / self.frame.total_mass_std)
        for prior in self.priors:
            at = _place(prior, n)
            _, J = prior.residual(size[at])
            row = np.zeros((len(J), 2 * n))
            row[:, at] = J * size[at]
            rows.append(row)
        return np.concatenate(rows)

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
            experiment.name,
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
        frame = replace(frame, stories=n)
        return Design(frame, np.array(mass), np.array(stiffness), priors, name=name)


def _place(prior: Prior, n: int) -> slice:
    return slice(0, n) if prior.quantity == "floor_mass" else slice(n, 2 * n)


def _nominal(priors: Sequence[Prior], quantity: str, stories: int) -> Floats | None:
    """Read the design values of a quantity if a prior declares all of them; `stories` is 0 if not declared."""
    values = [prior.suggested(stories) for prior in priors if prior.quantity == quantity]
    return next((each for each in values if each is not None and each.size and not np.any(np.isnan(each))), None)


def read_design(source: str | Path | Experiment, *, fresh: bool = False) -> Design:
    """Read the frame before the test from a source.

    Parameters
    ----------
    source : str, Path or Experiment
        "paper"; a TOML file with configurations (fitted first) or without (design values).
    fresh : bool, optional
        Do not count earlier measurements as known.

    Raises
    ------
    InputError
        If the source is not valid; the message names the file and the remedy.
    """
    measured = source if isinstance(source, Experiment) else measurement_of(source)
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


#: Prior standard deviation of an unknown parameter, relative to its size. A finite value gives every choice, even of a
#: single sensor, finite standard deviations to compare.
UNKNOWN_STDS = 10.0


@dataclass(frozen=True)
class Declared:
    """Noise that is the same for every mode.

    Parameters
    ----------
    frequency_std, mode_shape_std : float
        Relative deviation of a frequency; deviation of a shape entry if the mode's largest entry is 1.
    """

    frequency_std: float = DEFAULT_FREQUENCY_STD
    mode_shape_std: float = DEFAULT_MODE_SHAPE_STD

    def __post_init__(self) -> None:
        checks.number(self.frequency_std, "frequency_std", above=0.0)
        checks.number(self.mode_shape_std, "mode_shape_std", above=0.0)

    @staticmethod
    def of_tests(tests: Sequence[Configuration]) -> Declared:
        """Return the median of the tests' declared deviations; the default if the tests declare none."""
        if not tests:
            return Declared()
        frequency = np.concatenate([each.log_frequency_std for each in tests])
        # A shape without measured entries has no deviations.
        shapes = [
            (each.entry_std / np.max(np.abs(each.known_shapes), axis=1, keepdims=True))[each.measured]
            for each in tests
            if np.all(np.any(each.measured, axis=1))
        ]
        entries = np.concatenate([*shapes, np.zeros(0)])
        return Declared(
            float(np.median(frequency)), float(np.median(entries)) if len(entries) else DEFAULT_MODE_SHAPE_STD
        )

    @property
    def words(self) -> str:
        """Description of the noise, as a part of a sentence."""
        return f"frequencies to {100 * self.frequency_std:.3g} %, shapes to {100 * self.mode_shape_std:.3g} %"


@dataclass(frozen=True, eq=False)
class TestModel:
    """The frame as designed, the goal of the plan, and the noise of its tests.

    Parameters
    ----------
    design : Design
    quantities : tuple of str
        "floor_mass", "story_stiffness", or both: the goal of the plan.
    which : ndarray of int, shape (m,)
        Modes that are measured, zero-based.
    noise : Declared
    """

    design: Design
    quantities: tuple[str, ...]
    which: Ints
    noise: Declared

    @property
    def numbers(self) -> Ints:
        """Numbers of the modes that are measured, 1 the lowest; shape (m,)."""
        return self.which + 1

    @cached_property
    def question(self) -> Floats:
        """Rows that select the parameters of the plan's goal, shape (s, 2N)."""
        n = self.design.stories
        at = {"floor_mass": slice(0, n), "story_stiffness": slice(n, 2 * n)}
        picked = np.concatenate([np.eye(2 * n)[at[each]] for each in self.quantities])
        # A parameter that is known exactly is not part of the goal.
        return np.asarray(picked[np.linalg.norm(picked @ free_changes(self.fixed), axis=1) > 1e-9])

    @cached_property
    def fixed(self) -> Floats:
        """Rows whose product with every allowed relative change is zero, shape (e, 2N)."""
        return self.design.fixed()

    @cached_property
    def known(self) -> Floats:
        """Prior information as rows in standard deviations, with a weak prior of every parameter, shape (k, 2N)."""
        return np.concatenate([self.design.known(), np.eye(2 * self.design.stories) / UNKNOWN_STDS])

    def expected(self, added_mass: Floats) -> ExpectedTest:
        """Predict a test with these added masses; derivatives are relative to the parameters' sizes."""
        blank = self.design.blank(added_mass, self.numbers)
        model = misfit.tested_model(self.design.shell(), blank, (), self.design.sizes)
        frequencies, shapes = misfit.predicted_modes(blank, model)
        frequency_std = np.full(len(frequencies), self.noise.frequency_std)
        shape_std = np.full(shapes.shape, self.noise.mode_shape_std)
        test = misfit.expected_configuration(blank, frequencies, shapes, frequency_std, shape_std)
        rows = misfit.data_rows(test, model).J * self.design.sizes
        return ExpectedTest(test, rows, test.measured)

    def sensors(self, tests: Sequence[ExpectedTest], number: int) -> Candidates:
        """Return the floors as candidates; each floor is measured in all of these tests."""
        m, n, scales = len(self.which), self.design.stories, len(self.which) * len(tests)
        rows = np.zeros((n, scales, 2 * n + scales))
        for t, test in enumerate(tests):
            own = np.arange(t * m, (t + 1) * m)
            rows[:, own, : 2 * n] = test.shape_rows.swapaxes(0, 1)
            rows[:, own, 2 * n + own] = test.entries.T
        known = linalg.block_diag(
            np.concatenate([self.known, *(test.frequency_rows for test in tests)]), np.eye(scales) / UNKNOWN_STDS
        )
        wide = [np.hstack([part, np.zeros((len(part), scales))]) for part in (self.fixed, self.question)]
        return candidates(known, wide[0], rows, wide[1], number / n)

    def choices(self, tests: Sequence[ExpectedTest], floors: Ints, number: int) -> Candidates:
        """Return the tests as candidates; each test is measured at these floors."""
        rows = np.array([test.at(floors) for test in tests])
        return candidates(self.known, self.fixed, rows, self.question, number / len(tests))

    def covariance(self, tests: Sequence[ExpectedTest], floors: Ints, exact: Floats | None = None) -> Floats:
        """Relative covariance of masses and stiffnesses after these tests at these floors, shape (2N, 2N).

        `exact` has rows, shape (e, 2N), whose product with the relative changes is known to be zero.
        """
        rows = np.concatenate([self.known, *(test.at(floors) for test in tests)])
        free = free_changes(self.fixed if exact is None else np.concatenate([self.fixed, exact]))
        half = free @ np.linalg.inv(np.linalg.qr(rows @ free, mode="r"))
        return np.asarray(half @ half.T)

    def averaged(
        self,
        tests: Sequence[ExpectedTest],
        floors: Ints,
        exact: Floats | None = None,
        pairs: int = 16,
        widest: float = 0.3,
    ) -> Floats:
        """Average the covariance over the frames that are possible before the tests, shape (2N, 2N).

        The frames are drawn from the prior information, in pairs on either side of the design values. The covariance is
        relative to the values of each frame. `widest` limits the relative deviation of a value in the draws.
        """
        values, axes = np.linalg.eigh(self.covariance([], np.zeros(0, dtype=int)))
        # The symmetric root does not depend on the choice of axes.
        root = (axes * np.sqrt(np.clip(values, 0.0, widest**2))) @ axes.T
        drawn = np.random.default_rng(1).standard_normal((pairs, len(root))) @ root
        found = []
        for change in np.concatenate([drawn, -drawn]):
            mass, stiffness = np.split(self.design.sizes * np.exp(change), 2)
            design = replace(self.design, floor_mass=mass, story_stiffness=stiffness)
            model = replace(self, design=design)
            found.append(model.covariance([model.expected(each.test.added_mass) for each in tests], floors, exact))
        return np.asarray(np.mean(found, axis=0))
