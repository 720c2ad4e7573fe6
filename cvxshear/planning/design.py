"""What is known of a frame before the test: its values, how sure they are, and what was measured of it before."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cvxshear import backends
from cvxshear.effects import Placed, Scale
from cvxshear.fit.efficient import efficient
from cvxshear.fit.misfit import Misfit
from cvxshear.measurement.experiment import Configuration, Experiment, Frame, Prior
from cvxshear.priors import Value, check_prior
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

QUANTITIES = ("floor_mass", "story_stiffness")


@dataclass(frozen=True, eq=False)
class Design:
    """A frame before a test.

    Parameters
    ----------
    frame : Frame
        With its number of stories.
    floor_mass, story_stiffness : ndarray, shape (N,)
        The values that are expected, kg without added mass and N/m.
    priors : tuple of Prior
        How sure they are.
    measured : Experiment or None
        What was measured before; its information counts.
    declared : tuple of Configuration
        The configurations of the file that the values come from.
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
    def scale(self) -> Scale:
        """Mean floor mass and story stiffness, and the heights; effects expect sizes in these."""
        heights = self.frame.story_heights
        return Scale(
            float(self.floor_mass.mean()),
            float(self.story_stiffness.mean()),
            np.ones(self.stories) if heights is None else heights,
        )

    @property
    def sizes(self) -> Floats:
        """Floor masses, then story stiffnesses, shape (2N,)."""
        return np.concatenate([self.floor_mass, self.story_stiffness])

    def fixed(self) -> Floats:
        """Rows on which every relative change of masses and stiffnesses is zero, shape (e, 2N)."""
        n, size = self.stories, self.sizes
        rows = [np.zeros((0, 2 * n))]
        if self.frame.floor_masses is not None:
            rows.append(np.eye(n, 2 * n))
        elif self.frame.total_mass is not None:
            rows.append(np.concatenate([self.floor_mass, np.zeros(n)])[None] / self.floor_mass.sum())
        for prior in self.priors:
            A = prior.constraints(n).A
            if A is not None:
                at = _place(prior, n)
                row = np.zeros((len(A), 2 * n))
                row[:, at] = A * size[at]
                rows.append(row / np.linalg.norm(row, axis=1, keepdims=True))
        return np.concatenate(rows)

    def known(self, effects: Sequence[Placed], values: Floats) -> Floats:
        """What is known before the test, as rows by relative changes in standard deviations, shape (k, 2N + e).

        Parameters
        ----------
        effects : sequence of Placed
        values : ndarray, shape (e,)
            Their parameters; the rows are by these in their own units.
        """
        n, size = self.stories, self.sizes
        if self.measured is not None:
            theta = np.concatenate([size, values])
            measured: Floats = Misfit(self.measured, effects).evaluate(theta).J
            result: Floats = measured * np.concatenate([size, np.ones(len(values))])
            return result
        rows = [np.zeros((0, 2 * n + len(values)))]
        for prior in self.priors:
            at = _place(prior, n)
            _, J = prior.residual(size[at])
            row = np.zeros((len(J), 2 * n + len(values)))
            row[:, at] = J * size[at]
            rows.append(row)
        return np.concatenate(rows)

    @staticmethod
    def of_experiment(experiment: Experiment, *, fresh: bool = False) -> Design:
        """The frame that a measurement tells of.

        Parameters
        ----------
        experiment : Experiment
            Fitted first.
        fresh : bool, optional
            Take the values from it, and its priors, but count none of its measurements as known.
        """
        found = efficient(experiment, backends.get("auto"))
        if not np.all(found.uncertainty.determined):
            open_ones = " and ".join(found.uncertainty.null_directions[0][:4])
            raise InputError(
                f"{experiment.name} does not determine {open_ones}, so there is no frame to plan for; declare design "
                "values (a nominal prior with std)"
            )
        n = experiment.stories
        return Design(
            experiment.frame,
            found.theta[:n],
            found.theta[n : 2 * n],
            experiment.priors,
            None if fresh else experiment,
            experiment.configurations,
            experiment.name,
        )

    @staticmethod
    def of_file(declared: Mapping[str, Any], name: str) -> Design:
        """The frame that a measurement file without configurations declares: `[frame]` and priors with design values.

        Raises
        ------
        InputError
            Where no design values are declared.
        """
        table = checks.keys(declared, ["frame", "prior"], ["prior"], "a file of design values")
        frame = Frame.from_dict(table.get("frame") or {})
        items = table["prior"]
        if not isinstance(items, list):
            raise InputError("[prior] must be a list of tables: write [[prior]], in double brackets")
        priors = tuple(Prior.from_dict(item) for item in items)
        stiffness = _nominal(priors, "story_stiffness", frame.stories)
        if stiffness is None:
            raise InputError(
                'no story stiffness is expected: add a [[prior]] with kind = "nominal", quantity = "story_stiffness", '
                "its design values and their std"
            )
        mass = frame.floor_masses if frame.floor_masses is not None else _nominal(priors, "floor_mass", frame.stories)
        n = len(stiffness)
        if mass is None and frame.total_mass is not None:
            mass = np.full(n, frame.total_mass / n)
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
        return Design(_completed(frame, n), np.array(mass), np.array(stiffness), priors, name=name)

    @staticmethod
    def of_result(result: Mapping[str, Any], name: str) -> Design:
        """The frame of a result's JSON, of `identify` or `loop`: values with standard deviations.

        Raises
        ------
        InputError
            Where it has none.
        """
        frame = result.get("frame")
        keys = [f"{quantity}{part}" for quantity in QUANTITIES for part in ("", "_std")]
        if not isinstance(frame, Mapping) or any(not isinstance(frame.get(key), list) for key in keys):
            raise InputError(
                f"{name} holds no frame with standard deviations; it must be the JSON of loop, or of identify by the "
                "efficient method"
            )
        mass, stiffness = (checks.vector(frame[key], f"frame: {key}", above=0.0) for key in QUANTITIES)
        priors = tuple(
            Value(quantity=quantity, at=place, value=float(value), std=None if not std else float(std) / float(value))
            for quantity, values in zip(QUANTITIES, (mass, stiffness), strict=True)
            for place, (value, std) in enumerate(zip(values, frame[f"{quantity}_std"], strict=True), 1)
        )
        return Design(_completed(Frame(), len(mass)), mass, stiffness, priors, name=name)


def _place(prior: Prior, n: int) -> slice:
    return slice(0, n) if prior.quantity == "floor_mass" else slice(n, 2 * n)


def _nominal(priors: Sequence[Prior], quantity: str, stories: int) -> Floats | None:
    """The design values of a quantity, where a prior declares all of them; `stories` is 0 where not declared."""
    values = [prior.suggested(stories) for prior in priors if prior.quantity == quantity]
    return next((each for each in values if each is not None and each.size and not np.any(np.isnan(each))), None)


def _completed(frame: Frame, stories: int) -> Frame:
    """The frame with its number of stories, and one height a story."""
    heights = frame.story_heights
    whole = heights if heights is None or heights.ndim else np.full(stories, float(heights))
    return dataclasses.replace(frame, stories=stories, story_heights=whole)
