"""Checks of a user-defined effect: its declaration, and its changes of a typical frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from cvxshear.effects.base import Effect, LocatedEffect, Parameter, Place
from cvxshear.effects.composition import compose
from cvxshear.effects.state import STAGES, Scale, State, heights_of
from cvxshear.measurement.experiment import Experiment, Tested
from cvxshear.priors import Constraints
from cvxshear.util.errors import CvxshearError, FaultyEffectError, InputError
from cvxshear.util.typing import Floats, T

PLACE_PARTS = ("floor", "to", "story", "state", "prior")
NEEDS = ("heights", "several states")
USUAL_IN = ("", "floor_mass", "story_stiffness")

QUOTIENT_STEP = 1e-4
"""Step of the difference quotients, in parts of each mass, stiffness and expected size. The error of central
differences is then some 1e-8 of the curvature, and 1e-12 from rounding."""

WRONG_SLOPE = 1e-3
"""Relative error of a wrong derivative: far above the error of the difference quotients, far below the error of a wrong
formula."""

ROUNDED_PART = 1e-9
"""Rounding: smallest difference that counts, in parts of the matrix."""

TRIED_AT = 0.4
"""Trial deviation of an effect from the null value, in expected sizes."""


def refuse_repeated(effects: Iterable[Effect]) -> None:
    """Raise `InputError` if two effects share one name."""
    seen: set[str] = set()
    for effect in effects:
        if effect.name in seen:
            raise InputError(f"effect {effect.name} is given twice; two effects need two names")
        seen.add(effect.name)


def refuse_faulty(effect: object, experiment: Experiment | None = None) -> None:
    """Raise an error for an unusable effect, with its name and the first fault.

    The checks cover the declaration (name, stage, probability, parameters, sizes). At the first and the last of the
    places, they cover the result of `apply` on a frame: shapes, finite numbers, arrays that were changed in place, no
    change at the null values, and derivatives against difference quotients in random directions.

    Parameters
    ----------
    effect : Effect
    experiment : Experiment, optional
        Experiment that the effect should explain; by default a frame of four stories tested in two states. If the
        experiment lacks a declaration for the effect, `apply` is not checked.

    Raises
    ------
    InputError
    """
    if not isinstance(effect, Effect):
        what = "the class itself: make an instance" if isinstance(effect, type) else f"a {type(effect).__name__}"
        raise InputError(f"an effect must be an instance of a subclass of cvxshear.effects.Effect, not {what}")
    _Check(effect, typical_experiment() if experiment is None else experiment).run()


@lru_cache(maxsize=1)
def typical_experiment() -> Experiment:
    """Build a frame of four unequal stories, tested in two states, one of them with added masses."""
    shapes = np.sin(np.outer([1, 3, 5, 7], np.arange(1, 5)) * np.pi / 9)
    tests = [
        {"name": name, "added_mass": added, "frequencies": [2.0, 6.0, 9.0, 11.0], "mode_shapes": shapes.tolist()}
        for name, added in (("before", [0.0] * 4), ("after", [1.0, 0.0, 2.0, 0.5]))
    ]
    frame = {"story_heights": [0.42, 0.36, 0.33, 0.38], "total_mass": 41.0}
    return Experiment.from_dict({"frame": frame, "configuration": tests})


class _Idle(Effect):
    """Effect with the same parameters as the checked effect, and without any influence."""

    name = "idle"
    stage = "shape"

    def __init__(self, parameters: tuple[Parameter, ...]) -> None:
        self.parameters = parameters

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state


@dataclasses.dataclass(frozen=True)
class _Check:
    effect: Effect
    experiment: Experiment

    def run(self) -> None:
        self._declaration()
        bound = self._call("bound", lambda: self.effect.bound(self.experiment), Effect)
        if self._call("lacks", lambda: bound.lacks(self.experiment), str):
            return
        places = list(self._call("places", lambda: bound.places(self.experiment), (list, tuple)))
        self._that(all(isinstance(place, Place) for place in places), "places() must list objects of the class Place")
        self._that(len(set(places)) == len(places), "places() lists a place twice")
        for place in dict.fromkeys((*places[:1], *places[-1:])):
            # The default binds the values of this place; mypy infers no type for a lambda's default.
            here = self._call("bound_at", lambda at=place: bound.bound_at(self.experiment, at), Effect)  # type: ignore[misc]
            sizes = self._parameters(here)
            self._limits(here, place)
            self._matrices(here, place, sizes)
            self._words(here, place)

    def _that(self, holds: object, otherwise: str) -> None:
        """Raise an error if a condition does not hold."""
        if not holds:
            raise InputError(f"effect {self.effect.name}: {otherwise}")

    def _call(self, member: str, member_call: Callable[[], T], kind: type | tuple[type, ...]) -> T:
        """Call a member of the effect, and check the type of its result."""
        try:
            found = member_call()
        except FaultyEffectError as error:
            raise InputError(f"effect {error}") from error
        except CvxshearError:
            raise
        except Exception as error:
            raise InputError(f"effect {self.effect.name}: {member}() raised {type(error).__name__}: {error}") from error
        self._that(isinstance(found, kind), f"{member}() returned a {type(found).__name__}")
        return found

    def _declaration(self) -> None:
        """Check name, sentences, stage, place, needs and probability."""
        effect = self.effect
        for key in ("name", "summary", "formula", "source", "stage"):
            value = getattr(effect, key, None)
            if not (isinstance(value, str) and value.strip()):
                raise InputError(
                    f"effect {getattr(effect, 'name', type(effect).__name__)}: {key} is {value!r}, no text"
                )
        self._that(effect.stage in STAGES, f"stage = {effect.stage!r} is unknown; the stages are {', '.join(STAGES)}")
        for key, known in (("sits_at", PLACE_PARTS), ("needs", NEEDS)):
            parts = getattr(effect, key)
            fits = isinstance(parts, tuple) and set(parts) <= set(known)
            self._that(fits, f"{key} = {parts!r} must be a tuple of {', '.join(map(repr, known))}")
        part = effect.usual_in
        self._that(part in USUAL_IN, f"usual_in = {part!r} must be one of {', '.join(map(repr, USUAL_IN))}")
        inside = isinstance(effect.probability, (int, float)) and 0.0 < effect.probability < 1.0
        self._that(inside, f"probability = {effect.probability!r} must lie between 0 and 1")
        size = effect.size
        self._that(size is None or (np.isfinite(size) and size > 0), f"size = {size!r} must be a positive number")

    def _parameters(self, here: Effect) -> Floats:
        """Check bounds, null and start values of the parameters; return their expected sizes."""
        items: Any = getattr(here, "parameters", None)
        fits = isinstance(items, tuple) and all(isinstance(item, Parameter) for item in items)
        self._that(fits, "parameters must be a tuple of objects of the class Parameter")
        names = [item.name for item in items]
        self._that(len(set(names)) == len(names), f"two parameters go by one name among {', '.join(names)}")
        found = self._call("sizes", lambda: here.expected_sizes(self._scale), np.ndarray)
        sizes = np.asarray(found, dtype=np.float64)
        self._that(sizes.shape == (len(items),), f"sizes() has the shape {sizes.shape}, not ({len(items)},)")
        for item, size in zip(items, sizes, strict=True):
            self._that(not np.isnan(size) and size > 0, f"the size of {item.name} is {size:g}: it must be positive")
            self._that(
                item.lower < item.upper, f"{item.name}: lower = {item.lower:g} must be below upper = {item.upper:g}"
            )
            for key, value in (("null", item.null), ("start", item.start)):
                # With a uniform prior between the bounds, the null value may lie outside the bounds.
                within = item.lower <= value <= item.upper or (key == "null" and np.isinf(size))
                self._that(
                    np.isfinite(value) and within,
                    f"{item.name}: {key} = {value:g} is not between its bounds {item.lower:g} and {item.upper:g}",
                )
            self._that(
                np.isfinite(size) or np.isfinite(item.upper - item.lower),
                f"sizes() says nothing of {item.name} and its bounds are infinite: give a size or two bounds",
            )
        return sizes

    def _limits(self, here: Effect, place: Place) -> None:
        """Check that the rows have the right length and finite numbers."""
        found = self._call("limits", lambda: here.limits(self.experiment, place), Constraints)
        columns = 2 * self.experiment.stories + len(here.parameters)
        for key, rows in (("G", found.G), ("A", found.A)):
            self._that(
                rows is None or (rows.ndim == 2 and rows.shape[1] == columns and np.all(np.isfinite(rows))),
                f"limits(): {key} must have {columns} columns of finite numbers, floor masses, story stiffnesses and "
                "own parameters",
            )

    def _words(self, here: Effect, place: Place) -> None:
        values = np.array([item.start for item in here.parameters])
        units = [item.unit for item in here.parameters]
        said = self._call("phrase", lambda: here.phrase(place, values, np.abs(values) + 0.1, self._scale, units), str)
        self._that(said.strip(), "phrase() is empty")

    def _matrices(self, here: Effect, place: Place, sizes: Floats) -> None:
        """Check the changes of a frame by the effect, and their derivatives."""
        placed = LocatedEffect(here, place)
        tested = next(each for each in self.experiment.tested if placed.acts_on(each))
        nulls = np.array([item.null for item in here.parameters])
        lower = np.array([item.lower for item in here.parameters])
        upper = np.array([item.upper for item in here.parameters])
        even = np.isinf(sizes)
        with np.errstate(invalid="ignore"):
            own = np.where(even, 0.5 * (lower + upper), np.clip(nulls + TRIED_AT * sizes, lower, upper))
            steps = QUOTIENT_STEP * np.concatenate([self._frame, np.where(even, upper - lower, sizes)])
        at = np.concatenate([self._frame, own])
        self._untouched(here, place, tested, at)
        plain = self._composed(tested, LocatedEffect(_Idle(here.parameters)), at)
        there = self._composed(tested, placed, at)
        n, size = self.experiment.stories, len(at)
        motions = len(there.system.K)
        for name, value, shape in (
            ("M", there.system.M, (motions, motions)),
            ("K", there.system.K, (motions, motions)),
            ("dM", there.system.dM, (size, motions, motions)),
            ("dK", there.system.dK, (size, motions, motions)),
            ("the observation matrix", there.observation.matrix, (n, motions)),
        ):
            self._that(value.shape == shape, f"{name} has the shape {value.shape} after apply(), not {shape}")
            self._that(np.all(np.isfinite(value)), f"{name} is not finite after apply()")
        for name, value in (("M", there.system.M), ("K", there.system.K)):
            gap = float(np.max(np.abs(value - value.T)))
            self._that(gap <= ROUNDED_PART * np.max(np.abs(value)), f"{name} is not symmetric after apply()")
        if motions == n:
            null = self._composed(tested, placed, np.concatenate([self._frame, nulls]))
            for name, value, before in zip(("M", "K", "the observation"), _values(null), _values(plain), strict=True):
                gap = float(np.max(np.abs(value - before)))
                self._that(
                    gap <= ROUNDED_PART * np.max(np.abs(before)),
                    f"{name} is not that of the shear frame at the null values",
                )
        self._slopes(placed, tested, at, steps)

    def _slopes(self, placed: LocatedEffect, tested: Tested, at: Floats, steps: Floats) -> None:
        """Check derivatives in a random direction of the effect's own parameters, and in one of the frame's."""
        rng = np.random.default_rng(20)
        n2 = len(self._frame)
        there = self._composed(tested, placed, at)
        for word, part in (("its own parameters", slice(n2, None)), ("masses and stiffnesses", slice(0, n2))):
            direction = np.zeros(len(at))
            direction[part] = (steps * rng.standard_normal(len(at)))[part]
            ahead, behind = (self._composed(tested, placed, at + sign * direction) for sign in (1.0, -1.0))
            for name, slope, up, down, value in zip(
                ("M", "K", "the observation"),
                _slopes(there, direction),
                _values(ahead),
                _values(behind),
                _values(there),
                strict=True,
            ):
                quotient = 0.5 * (up - down)
                allowed = WRONG_SLOPE * np.max(np.abs(quotient)) + QUOTIENT_STEP * ROUNDED_PART * np.max(np.abs(value))
                gap = float(np.max(np.abs(slope - quotient)))
                self._that(
                    gap <= allowed,
                    f"the derivative of {name} by {word} is wrong at {placed.place.describe() or 'its place'}: it "
                    f"differs from the difference quotient by {100 * gap / max(np.max(np.abs(quotient)), allowed):.3g} "
                    "% of its size",
                )

    def _untouched(self, here: Effect, place: Place, tested: Tested, at: Floats) -> None:
        """Check that `apply` does not change the arrays that it receives, including its own earlier result."""
        state = self._composed(tested, LocatedEffect(_Idle(here.parameters)), at)
        own = slice(len(self._frame), len(at))
        values = at[own].copy()
        before = {name: array.copy() for name, array in _arrays(state)}
        found = self._call("apply", lambda: here.apply(state, place, values, own), State)
        for name, array in _arrays(state):
            same = array.shape == before[name].shape and np.array_equal(array, before[name], equal_nan=True)
            self._that(same, f"apply() changes {name} of the state that it is given; change a copy")
        self._that(np.array_equal(values, at[own]), "apply() changes the parameters that it is given")
        self._that(found.system.M.dtype == np.float64, "M is no array of real numbers after apply()")
        self._that(found.system.K.dtype == np.float64, "K is no array of real numbers after apply()")

    def _composed(self, tested: Tested, placed: LocatedEffect, at: Floats) -> State:
        return self._call("apply", lambda: compose(self.experiment, tested, [placed], at), State)

    @property
    def _scale(self) -> Scale:
        n = self.experiment.stories
        return Scale(float(np.mean(self._frame[:n])), float(np.mean(self._frame[n:])), heights_of(self.experiment))

    @property
    def _frame(self) -> Floats:
        """Return unequal floor masses and story stiffnesses of the declared scale; the first mode is near 2 Hz."""
        n = self.experiment.stories
        total = self.experiment.frame.total_mass or 10.0 * n
        mass = total / n * (1.0 + 0.2 * np.cos(np.arange(n)))
        stiffness = total / n * 2000.0 * (1.0 + 0.2 * np.sin(np.arange(n)))
        return np.concatenate([mass, stiffness])


def _values(state: State) -> Sequence[Floats]:
    return state.system.M, state.system.K, state.observation.matrix


def _slopes(state: State, direction: Floats) -> Sequence[Floats]:
    """Return the derivatives of M, K and the observation matrix along a direction of the parameters."""
    observed = np.zeros_like(state.observation.matrix)
    for parameter, slope in state.observation.slopes.items():
        observed = observed + direction[parameter] * slope
    return np.tensordot(direction, state.system.dM, 1), np.tensordot(direction, state.system.dK, 1), observed


def _arrays(state: State) -> Iterator[tuple[str, Floats]]:
    """Yield every array of a state, by name."""
    for item in dataclasses.fields(state):
        value = getattr(state, item.name)
        if isinstance(value, np.ndarray):
            yield item.name, value
    for name in ("M", "K", "dM", "dK"):
        yield name, getattr(state.system, name)
