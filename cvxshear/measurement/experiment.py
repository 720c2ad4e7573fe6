"""The experiment: the frame, its configurations and priors, and their validation.

Every object is frozen and its arrays are read-only, so a result can refer to the experiment it came from.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from cvxshear.measurement.configuration import Configuration
from cvxshear.measurement.declaration import (
    DAMPING_KINDS,
    MOTIONS,
    Damping,
    ExpectedEffect,
    Frame,
    Heading,
    Limits,
    StaticTest,
    named_in,
)
from cvxshear.motions import ONE_MOTION, SYMMETRIC_MOTIONS, THREE_MOTIONS, Motions
from cvxshear.priors import Prior, check_prior
from cvxshear.util import checks, decorators
from cvxshear.util.errors import InputError, NoScaleError, UnsuitableError
from cvxshear.util.results import Shown, as_table, ask
from cvxshear.util.typing import Floats, Ints, Json, T

__all__ = [
    "DAMPING_KINDS", "MOTIONS", "Configuration", "Damping", "ExpectedEffect", "Experiment", "Frame",
    "Limits", "Prior", "StaticTest", "Tested",
]  # fmt: skip

#: Measurement of one state of the frame; both types have a `name`, a `state` and an `added_mass`.
Tested = Configuration | StaticTest


@dataclass(frozen=True, eq=False, repr=False)
class Experiment(Shown):
    """A frame, the configurations it was tested in, and what is known beforehand.

    Parameters
    ----------
    frame : Frame
    configurations : sequence of Configuration
        At least one.
    priors : sequence of Prior, optional
    name : str, optional
        For reports; the file's name where it was read from one.
    static : sequence of StaticTest, optional
        Pull or tilt tests.
    expected : sequence of ExpectedEffect, optional
        What is known beforehand of effects that the shear model lacks.
    damping : Damping, optional
    report : Heading, optional
        What a report says of the test: title, client, author, date.
    limits : Limits, optional
        Drift ratios whose passing a reconstruction judges.
    symmetric : bool, optional
        Whether floors that turn are taken as symmetric about the reference point: the base model of the loop.

    Raises
    ------
    InputError
        The parts contradict each other, or the mass scale is unknown.
    """

    frame: Frame
    configurations: tuple[Configuration, ...]
    priors: tuple[Prior, ...] = ()
    name: str = "experiment"
    static: tuple[StaticTest, ...] = ()
    expected: tuple[ExpectedEffect, ...] = ()
    damping: Damping = field(default_factory=Damping)
    report: Heading = field(default_factory=Heading)
    limits: Limits | None = None
    symmetric: bool = False

    def __post_init__(self) -> None:
        put = object.__setattr__
        checks.text(self.name, "name of the experiment")
        if not isinstance(self.frame, Frame):
            raise InputError(f"frame must be a Frame, not {checks.shown(self.frame)}")
        put(self, "configurations", _all_of(Configuration, self.configurations, "configurations"))
        put(self, "priors", _all_of(Prior, self.priors, "priors"))
        put(self, "static", _all_of(StaticTest, self.static, "static"))
        put(self, "expected", _all_of(ExpectedEffect, self.expected, "expected"))
        if not self.configurations:
            raise InputError("at least one [[configuration]] is needed: none was found")
        self._check_names()
        self._check_motions()
        stories = self._count_stories()
        put(self, "frame", replace(self.frame, stories=stories))
        motions = len(self.frame.motions)
        put(self, "configurations", tuple(each.in_frame(stories, motions) for each in self.configurations))
        put(self, "static", tuple(each.in_frame(stories) for each in self.static))
        self._check_states()
        for place, prior in enumerate(self.priors, 1):
            with checks.named(f"prior {place}"):
                check_prior(prior, stories)
        self._check_scale()

    def _check_names(self) -> None:
        seen: set[str] = set()
        for tested in self.tested:
            if tested.name in seen:
                raise InputError(f'two configurations are named "{tested.name}"; give each a name of its own')
            seen.add(tested.name)

    def _check_motions(self) -> None:
        """Raise where sensors and motions of the floors do not belong together."""
        for each in self.configurations:
            where = f'configuration "{each.name}"'
            if not self.frame.turns and (each.sensors or len(each.added_mass_position)):
                key = "sensors" if each.sensors else "added_mass_position"
                raise InputError(f"{where}: {key} belongs to floors that turn; declare frame: motions")
            if self.frame.turns and each.mode_shapes.shape[1] and not each.sensors:
                raise InputError(
                    f"{where}: the floors turn (frame: motions), so sensors must give the floor, position and "
                    "direction of each entry of a shape, in place of measured_floors"
                )
        if self.frame.turns:
            of_stories = [each for each in self.priors if each.quantity == "story_stiffness"]
            for what, given in (("[[prior]] of story_stiffness", of_stories), ("[[static]]", self.static)):
                if given:
                    raise InputError(f"{what} is of frames with one motion per floor; this one turns (motions)")

    def _check_states(self) -> None:
        """Raise where the reference or an expected effect names a state, floor or story that there is not."""
        states = self.states
        if self.frame.reference is not None:
            checks.choice(self.frame.reference, states, "frame: reference")
        for each in self.expected:
            each.check(self.stories, states)

    def _count_stories(self) -> int:
        """Find the number of stories, which every part must agree on."""
        frame = self.frame
        per_floor = {
            "story_heights": None if frame.elevations is None else frame.story_heights,
            "floor_masses": frame.floor_masses,
            "plan": frame.plan if frame.plan is not None and frame.plan.ndim > 1 else None,
        }
        said = {"frame: stories": frame.stories} if frame.stories else {}
        said |= {f"frame: {key}": len(values) for key, values in per_floor.items() if values is not None}
        for each in self.configurations:
            if len(each.added_mass):
                said[f'configuration "{each.name}": added_mass'] = len(each.added_mass)
            if not each.sensors and not len(each.measured_floors) and each.mode_shapes.shape[1]:
                where = f'configuration "{each.name}": mode_shapes (no measured_floors given)'
                said[where] = each.mode_shapes.shape[1]
        said |= {f'static test "{each.name}": force': len(each.force) for each in self.static}
        if not said:
            seen = {each: each.highest_floor for each in self.configurations if each.highest_floor}
            if not seen:
                raise InputError("nothing tells how many stories the frame has; give frame: stories")
            each = max(seen, key=lambda item: seen[item])
            key = "sensors" if each.sensors else "measured_floors"
            said[f'configuration "{each.name}": {key}'] = seen[each]
        (first, stories), *others = said.items()
        for key, count in others:
            if count != stories:
                raise InputError(f"{key} speaks of {count} stories, {first} of {stories}; they must agree")
        if stories > checks.MOST_STORIES:
            raise InputError(f"{first} speaks of {stories} stories; {checks.MOST_STORIES} are the most that are taken")
        return stories

    @property
    def scale_known_otherwise(self) -> bool:
        """Whether something else than a declared total or floor masses tells how heavy the frame is."""
        return (
            len({tuple(each.added_mass) for each in self.configurations}) > 1
            or any(each.mass_normalized and each.measured.any() for each in self.configurations)
            or any(prior.fixes_scale for prior in self.priors)
            or bool(self.static)
        )

    def _check_scale(self) -> None:
        if self.frame.known_total is None and not self.scale_known_otherwise:
            raise NoScaleError(
                "nothing tells how heavy the frame is: give frame: total_mass or floor_masses, two configurations with "
                "different added_mass, mass_normalized shapes, a static test, or a prior that fixes the scale (value, "
                "or nominal without free_scale)"
            )

    @staticmethod
    def from_dict(declared: object, *, name: str = "experiment") -> Experiment:
        """Read the experiment that a dict of the measurement file's shape declares.

        Parameters
        ----------
        declared : dict
            The keys `frame` (optional), `configuration` (list), and the optional lists `prior`, `static`, `effect`.
        name : str, optional

        Returns
        -------
        Experiment

        Raises
        ------
        InputError
            Naming the key, the value found and what would be right.
        """
        frame_keys = {item.name: "[frame]" for item in fields(Frame)}
        tested_keys = {item.name: "[[configuration]]" for item in fields(Configuration)}
        tables = ["frame", "configuration", "prior", "static", "effect", "damping", "report", "limits"]
        table = checks.keys(declared, tables, [], "the measurement file", elsewhere={**tested_keys, **frame_keys})
        if table.get("configuration") is None:
            design = table.get("prior") and "; a file of design values, before any test, is for cvxshear plan"
            raise InputError(f"at least one [[configuration]] is needed: none was found{design or ''}")
        frame = Frame.from_dict({} if table.get("frame") is None else table["frame"], elsewhere=tested_keys)
        configurations = tuple(
            Configuration.from_dict(item, name=f"configuration {place}", elsewhere=frame_keys)
            for place, item in checks.tables(table, "configuration")
        )
        priors = []
        for place, item in checks.tables(table, "prior"):
            with checks.named(f"prior {place}"):
                priors.append(Prior.from_dict(item))
        static = []
        for place, item in checks.tables(table, "static"):
            name_of_test = f"static test {place}"
            where = named_in(item, "static test", name_of_test)
            static.append(StaticTest.of_table(item, where, "force", "displacement", name=name_of_test))
        effects = [ExpectedEffect.of_table(item, f"effect {at}", "name") for at, item in checks.tables(table, "effect")]
        said = {key: value for key, value in table.items() if value is not None}
        damping = Damping(**checks.keys(said.get("damping", {}), ["kind"], [], "damping"))
        report = Heading.from_dict(said.get("report", {}))
        limits = Limits.of_table(said["limits"], "limits", "story_drift") if "limits" in said else None
        return Experiment(
            frame, configurations, tuple(priors), name, tuple(static), tuple(effects), damping, report, limits
        )

    def to_dict(self) -> Json:
        """Return the dict of the measurement file's shape that declares this experiment."""
        tables = {
            "frame": self.frame,
            "damping": {} if self.damping.kind == Damping().kind else {"kind": self.damping.kind},
            "limits": self.limits,
            "prior": self.priors,
            "effect": self.expected,
            "configuration": self.configurations,
            "static": self.static,
            "report": self.report,
        }
        return {name: table for name, found in tables.items() if (table := as_table(found))}

    @property
    def tested(self) -> tuple[Tested, ...]:
        """Configurations, then static tests."""
        return (*self.configurations, *self.static)

    @property
    def states(self) -> tuple[str, ...]:
        """The states that were tested, in the order in which they come first."""
        return tuple(dict.fromkeys(each.state for each in self.tested))

    @property
    def changed_states(self) -> tuple[str, ...]:
        """The states that may differ from the frame itself: all but the reference."""
        return tuple(state for state in self.states if state != self.frame.reference)

    @property
    def stories(self) -> int:
        """Number of stories N."""
        return self.frame.stories

    @property
    def motions(self) -> Motions:
        """The motions of each floor, with the parameters of floors and stories."""
        if not self.frame.turns:
            return ONE_MOTION
        return SYMMETRIC_MOTIONS if self.symmetric else THREE_MOTIONS

    @decorators.cached_property
    def of_floors(self) -> slice:
        """Slice of theta with the parameters of the floors, the lowest floor first."""
        return slice(0, self.stories * len(self.motions.mass_names))

    @decorators.cached_property
    def of_masses(self) -> slice:
        """Slice of theta with the floor masses, the lowest floor first."""
        return slice(0, self.of_floors.stop, len(self.motions.mass_names))

    @decorators.cached_property
    def of_stories(self) -> slice:
        """Slice of theta with the parameters of the stories, the lowest story first."""
        return slice(self.of_floors.stop, self.of_floors.stop + self.stories * len(self.motions.stiffness_names))

    @decorators.cached_property
    def positive(self) -> Ints:
        """Places of the parameters of the frame that are positive, ascending."""
        return np.flatnonzero(np.concatenate([np.tile(each, self.stories) for each in self.motions.positive]))

    @property
    def parameters(self) -> int:
        """Number of parameters of the frame."""
        return int(self.of_stories.stop)

    def levels(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the mass of each floor and the stiffness of each story (mean of x and y), both of shape (N,)."""
        mass, stiffness = (theta[own].reshape(self.stories, -1) for own in (self.of_floors, self.of_stories))
        return mass[:, 0], stiffness[:, 0] if stiffness.shape[1] == 1 else np.mean(stiffness[:, :2], axis=1)

    @decorators.cached_property
    def radius(self) -> Floats:
        """Radius of gyration of each floor, shape (N,), m: of its plan, else of the places of the sensors."""
        if self.frame.plan is not None:
            return np.broadcast_to(np.sqrt(np.sum(self.frame.plan**2, axis=-1) / 12.0), (self.stories,))
        places = np.array([sensor.position for each in self.configurations for sensor in each.sensors])
        found = float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1)))) if len(places) else 1.0
        return np.full(self.stories, found or 1.0)

    def units(self, mass: float, stiffness: float) -> Floats:
        """Return the size of every parameter of a frame with a typical floor mass and story stiffness."""
        return self.motions.units(mass, stiffness, self.radius)

    @decorators.cached_property
    def half_plan(self) -> Floats:
        """Half the sides of each floor's plan, else the farthest sensors from the reference point, shape (N, 2), m."""
        if self.frame.plan is not None:
            return np.broadcast_to(self.frame.plan / 2.0, (self.stories, 2))
        places = np.array([sensor.position for each in self.configurations for sensor in each.sensors])
        farthest = np.max(np.abs(places), axis=0)
        return np.broadcast_to(np.where(farthest > 0, farthest, self.radius[0]), (self.stories, 2))

    @property
    def noise_declared(self) -> bool:
        """Whether every configuration declares both standard deviations; otherwise the weights are only relative."""
        return all(each.noise_declared for each in self.configurations)

    @property
    def stated(self) -> dict[str, Prior]:
        """The priors by their words, as `soft_statements` has them."""
        words = [text for text, _ in self.soft_statements]
        return dict(zip(words[len(words) - len(self.priors) :], self.priors, strict=True))

    @property
    def soft_statements(self) -> tuple[tuple[str, int], ...]:
        """Each prior in words with its number of residuals, none where it is exact; a soft total mass comes first.

        Words that come twice carry a number.
        """
        frame = self.frame
        found = [(prior.describe(), len(prior.residual(np.ones(self.stories))[0])) for prior in self.priors]
        if frame.total_mass is not None and frame.total_mass_std is not None:
            found.insert(0, (f"total mass = {frame.total_mass:g} kg within {100 * frame.total_mass_std:g} %", 1))
        words = [item[0] for item in found]
        return tuple(
            (f"{text} ({words[: place + 1].count(text)})" if words.count(text) > 1 else text, rows)
            for place, (text, rows) in enumerate(found)
        )

    def with_priors(self, priors: Sequence[Prior]) -> Experiment:
        """Add these priors to those declared."""
        return replace(self, priors=(*self.priors, *priors)) if priors else self


def _all_of(kind: type[T], items: object, where: str) -> tuple[T, ...]:
    """Return the items as a tuple, once each is of the kind that is needed."""
    if not isinstance(items, Iterable) or isinstance(items, str):
        raise InputError(f"{where} must be a sequence of {kind.__name__}, not {checks.shown(items)}")
    result = tuple(items)
    for place, item in enumerate(result, 1):
        if not isinstance(item, kind):
            raise InputError(f"{where}, entry {place} must be a {kind.__name__}, not {checks.shown(item)}")
    return result


#: An experiment, its dict, the path of a measurement file or a record file, or the name of a built-in example.
Measurement = str | Path | Json | Experiment


def opened(source: Measurement, *, turning: bool = False) -> Experiment:
    """Return an experiment as it is, or read it from its file.

    Parameters
    ----------
    source : Experiment, dict, str or Path
        A built-in's name, or the path of a measurement file or a record file. The modes of a record are identified.
    turning : bool, optional
        Whether its floors may turn.

    Raises
    ------
    InputError
        The source has another type, or the file cannot be read.
    NoSolutionError
        Where no mode was found in a record.
    UnsuitableError
        If the floors turn and the caller takes one motion per floor.
    """
    found = _read(source)
    if found.frame.turns and not turning:
        raise UnsuitableError(
            f"the floors of {found.name} turn (frame: motions), and this takes frames with one motion per floor; "
            "identify (methods efficient and one-shot), compare_backends, close_loop, programs.one_shot_masses and "
            "programs.story_stiffnesses take such floors"
        )
    return found


def _read(source: Measurement) -> Experiment:
    if isinstance(source, Experiment):
        return source
    if isinstance(source, Mapping):
        return Experiment.from_dict(source)
    if not isinstance(source, str | Path):
        needed = "an Experiment, its dict, the path of its file or the name of a built-in example"
        raise InputError(f"{needed} is needed, not {checks.shown(source)}")
    found: Experiment = ask("read", "experiment_from_file", source)
    return found
