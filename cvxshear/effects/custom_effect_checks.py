"""Checks of a custom effect: its declaration, and its changes of a typical frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from functools import lru_cache

import numpy as np

from cvxshear.effects.base import Effect, LocatedEffect, Parameter, Place
from cvxshear.effects.composition import compose
from cvxshear.effects.state import STAGES, Scale, State, heights_of
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.errors import CvxshearError, FaultyEffectError, InputError
from cvxshear.util.typing import Floats

Statements = Iterator[tuple[object, str]]
"""Conditions, each with the fault that is told if it does not hold."""

QUOTIENT_STEP = 1e-4
"""Step of the difference quotients, in parts of each mass, stiffness and expected size. The error of central
differences is then some 1e-8 of the curvature, and 1e-12 from rounding."""

WRONG_SLOPE = 1e-3
"""Relative error of a wrong derivative: far above the error of the difference quotients, far below the error of a wrong
formula."""

ROUNDED_PART = 1e-9
"""Rounding: smallest difference that counts, in parts of the matrix."""


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
    experiment = typical_experiment() if experiment is None else experiment
    try:
        for holds, otherwise in _statements(effect, experiment):
            if not holds:
                raise InputError(f"effect {getattr(effect, 'name', type(effect).__name__)}: {otherwise}")
    except FaultyEffectError as error:
        raise InputError(f"effect {error}") from error
    except CvxshearError:
        raise
    except Exception as error:
        read_only = "read-only" in str(error) and "; apply() must change copies of the arrays that it is given"
        raise InputError(f"effect {effect.name} raised {type(error).__name__}: {error}{read_only or ''}") from error


def _statements(effect: Effect, experiment: Experiment) -> Statements:
    """Yield what must hold for the effect: its declaration, then its changes at the first and the last place."""
    yield from _about_declaration(effect)
    bound = effect.bound(experiment)
    if bound.lacks(experiment):
        return
    places = list(bound.places(experiment))
    yield all(isinstance(place, Place) for place in places), "places() must list objects of class Place"
    for place in dict.fromkeys((*places[:1], *places[-1:])):
        yield from _about_place(LocatedEffect(bound.bound_at(experiment, place), place), experiment)


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


def _about_declaration(effect: Effect) -> Statements:
    """State what must hold for name, sentences, stage, place, requirements, probability and size."""
    for key in ("name", "summary", "formula", "source", "stage"):
        value = getattr(effect, key, None)
        yield isinstance(value, str) and value.strip(), f"{key} is {value!r}, no text"
    yield effect.stage in STAGES, f"stage = {effect.stage!r} is unknown; the stages are {', '.join(STAGES)}"
    parts = {field.name for field in dataclasses.fields(Place)}
    for key, known in (("sits_at", parts), ("needs", {"heights", "several states"})):
        value = getattr(effect, key)
        fits = isinstance(value, tuple) and set(value) <= known
        yield fits, f"{key} = {value!r} must be a tuple of {', '.join(map(repr, sorted(known)))}"
    units, unit = ("", "floor_mass", "story_stiffness"), effect.usual_in
    yield unit in units, f"usual_in = {unit!r} must be one of {', '.join(map(repr, units))}"
    inside = isinstance(effect.probability, int | float) and 0.0 < effect.probability < 1.0
    yield inside, f"probability = {effect.probability!r} must lie between 0 and 1"
    yield effect.size is None or 0 < effect.size < np.inf, f"size = {effect.size!r} must be a positive number"


def _about_place(placed: LocatedEffect, experiment: Experiment) -> Statements:
    """State what must hold at one place: the parameters, their sizes, the limits, and the changes of a frame."""
    effect, place, n = placed.effect, placed.place, experiment.stories
    items = getattr(effect, "parameters", None)
    fits = isinstance(items, tuple) and all(isinstance(item, Parameter) for item in items)
    yield fits, "parameters must be a tuple of objects of the class Parameter"
    assert isinstance(items, tuple)
    frame = _typical_frame(experiment)
    sizes = effect.expected_sizes(Scale(float(np.mean(frame[:n])), float(np.mean(frame[n:])), heights_of(experiment)))
    yield np.shape(sizes) == (len(items),), f"sizes() has the shape {np.shape(sizes)}, not ({len(items)},)"
    for item, size in zip(items, sizes, strict=True):
        yield from _about_parameter(item, float(size))
    limits, columns = effect.limits(experiment, place), 2 * n + len(items)
    for key, rows in (("G", limits.G), ("A", limits.A)):
        fits = rows is None or (rows.shape[1] == columns and bool(np.all(np.isfinite(rows))))
        what = "finite numbers, floor masses, story stiffnesses and own parameters"
        yield fits, f"limits(): {key} must have {columns} columns of {what}"
    nulls, lower, upper = (np.array([getattr(item, key) for item in items]) for key in ("null", "lower", "upper"))
    uniform = np.isinf(sizes)
    with np.errstate(invalid="ignore"):
        # Half an expected size from null, or the middle of a uniform prior.
        own = np.where(uniform, 0.5 * (lower + upper), np.clip(nulls + 0.5 * sizes, lower, upper))
        steps = QUOTIENT_STEP * np.concatenate([frame, np.where(uniform, upper - lower, sizes)])
    yield from _about_matrices(placed, experiment, np.concatenate([frame, own]), np.concatenate([frame, nulls]), steps)


def _about_parameter(item: Parameter, size: float) -> Statements:
    """State what must hold for a parameter: its bounds, null and start value, and its expected size."""
    name, lower, upper = item.name, item.lower, item.upper
    yield size > 0, f"the size of {name} is {size:g}: it must be positive"
    yield lower < upper, f"{name}: lower = {lower:g} must be below upper = {upper:g}"
    for key, value in (("null", item.null), ("start", item.start)):
        # With a uniform prior between the bounds, the null value may lie outside the bounds.
        within = lower <= value <= upper or (key == "null" and np.isinf(size))
        bounds = f"its bounds {lower:g} and {upper:g}"
        yield np.isfinite(value) and within, f"{name}: {key} = {value:g} is not between {bounds}"
    bounded = np.isfinite(size) or np.isfinite(upper - lower)
    yield bounded, f"sizes() says nothing of {name} and its bounds are infinite: give a size or two bounds"


def _typical_frame(experiment: Experiment) -> Floats:
    """Return unequal floor masses and story stiffnesses of the declared scale; the first mode is near 2 Hz."""
    n = experiment.stories
    each = (experiment.frame.total_mass or 10.0 * n) / n
    return each * np.concatenate([1.0 + 0.2 * np.cos(np.arange(n)), 2000.0 * (1.0 + 0.2 * np.sin(np.arange(n)))])


class _Idle(Effect):
    """Effect with the same parameters as the checked effect, and without any influence."""

    name = "idle"
    stage = "shape"

    def __init__(self, parameters: tuple[Parameter, ...]) -> None:
        self.parameters = parameters

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        return state


def _about_matrices(
    placed: LocatedEffect, experiment: Experiment, at: Floats, null: Floats, steps: Floats
) -> Statements:
    """State what must hold for matrices, at some parameters and at null, and for their derivatives."""
    effect, n = placed.effect, experiment.stories
    tested = next(each for each in experiment.tested if placed.acts_on(each))
    plain = compose(experiment, tested, [LocatedEffect(_Idle(effect.parameters))], at)
    own = slice(2 * n, len(at))
    values = at[own].copy()
    for array in (*vars(plain).values(), *vars(plain.system).values(), values):
        if isinstance(array, np.ndarray):
            array.flags.writeable = False
    found = effect.apply(plain, placed.place, values, own)
    yield isinstance(found, State), f"apply() returned a {type(found).__name__}, not a State"
    here = compose(experiment, tested, [placed], at)
    motions = len(here.system.K)
    square = (motions, motions)
    slopes = [("dM", here.system.dM, (len(at), *square)), ("dK", here.system.dK, (len(at), *square))]
    shapes = (square, square, (n, motions))
    for name, value, shape in [(*item, shape) for item, shape in zip(_matrices(here), shapes, strict=True)] + slopes:
        yield value.shape == shape, f"{name} has the shape {value.shape} after apply(), not {shape}"
        yield value.dtype == np.float64, f"{name} is no array of real numbers after apply()"
    for name, value in _matrices(here)[:2]:
        yield _apart(value, value.T) <= ROUNDED_PART, f"{name} is not symmetric after apply()"
    if motions == n:
        at_null = compose(experiment, tested, [placed], null)
        for (name, value), (_, before) in zip(_matrices(at_null), _matrices(plain), strict=True):
            same = _apart(value, before) <= ROUNDED_PART
            yield same, f"{name} is not that of the shear frame at the null values"
    where = placed.place.describe() or "its place"
    rng = np.random.default_rng(20)
    for word, part in (("its own parameters", own), ("masses and stiffnesses", slice(0, 2 * n))):
        direction = np.zeros(len(at))
        direction[part] = (steps * rng.standard_normal(len(at)))[part]
        ends = [_matrices(compose(experiment, tested, [placed], at + sign * direction)) for sign in (1.0, -1.0)]
        for (name, value), slope, (_, up), (_, down) in zip(
            _matrices(here), _slopes(here, direction), *ends, strict=True
        ):
            quotient = 0.5 * (up - down)
            largest = float(np.max(np.abs(quotient)))
            allowed = WRONG_SLOPE * largest + QUOTIENT_STEP * ROUNDED_PART * float(np.max(np.abs(value)))
            gap = float(np.max(np.abs(slope - quotient)))
            yield (
                gap <= allowed,
                (
                    f"the derivative of {name} by {word} is wrong at {where}: it differs from the difference quotient "
                    f"by {100 * gap / max(largest, allowed):.3g} % of its size"
                ),
            )


def _apart(value: Floats, other: Floats) -> float:
    """Return the largest difference of two matrices, in parts of the largest entry."""
    return float(np.max(np.abs(value - other)) / np.max(np.abs(other)))


def _matrices(state: State) -> tuple[tuple[str, Floats], ...]:
    return ("M", state.system.M), ("K", state.system.K), ("the observation", state.observation.matrix)


def _slopes(state: State, direction: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the derivatives of M, K and the observation matrix along a direction of the parameters."""
    observed = np.zeros_like(state.observation.matrix)
    for parameter, slope in state.observation.slopes.items():
        observed = observed + direction[parameter] * slope
    return np.tensordot(direction, state.system.dM, 1), np.tensordot(direction, state.system.dK, 1), observed
