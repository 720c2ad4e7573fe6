"""The catalogue of physical effects that a shear model lacks.

`catalogue()` lists them in the order of the reports; `register` adds one of your own to it.
"""

from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np

from cvxshear.effects.base import Effect, LocatedEffect, Parameter, Place
from cvxshear.effects.centers import EccentricMass, EccentricStiffness, OtherCenters, TurnedAxes
from cvxshear.effects.composition import compose
from cvxshear.effects.masses import AddedMass, AttachedMass, LoadMounting, LoadScale, MassCoupling, StateMass, TotalMass
from cvxshear.effects.open_class import OPEN_CLASSES
from cvxshear.effects.readings import FloorMass, ForceScale, SensorGain, ShapeScale, WrongExactPrior, WrongPrior
from cvxshear.effects.state import STAGES, Scale, State, heights_of
from cvxshear.effects.stories import Bracing, JointRelease, JointRotation, SoftFeet, StateStiffness, StoryChange
from cvxshear.effects.whole_frame import AxialColumns, BaseRocking, Gravity, GroundSpring, Spring, Wall
from cvxshear.measurement.experiment import Experiment
from cvxshear.util import checks
from cvxshear.util.errors import CvxshearError, FaultyEffectError, InputError
from cvxshear.util.typing import Floats

__all__ = [
    "AddedMass", "AttachedMass", "AxialColumns", "BaseRocking", "Bracing", "EccentricMass", "EccentricStiffness",
    "Effect", "Gravity", "GroundSpring", "JointRelease", "JointRotation", "LoadScale", "LocatedEffect", "MassCoupling",
    "Parameter", "Place", "Scale", "SensorGain", "Spring", "State", "StateMass", "StateStiffness", "StoryChange",
    "TotalMass", "TurnedAxes", "Wall", "catalogue", "compose", "heights_of", "named", "open_classes", "refuse_faulty",
    "refuse_repeated", "register",
]  # fmt: skip

_catalogue: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        Gravity(), JointRotation(), AxialColumns(), BaseRocking(), Wall(), GroundSpring(), AddedMass(), MassCoupling(),
        SensorGain(), StoryChange(), TotalMass(), Spring(), StateStiffness(), StateMass(), LoadScale(),
        FloorMass(), JointRelease(), SoftFeet(), Bracing(), AttachedMass(), LoadMounting(), ShapeScale(),
        ForceScale(), WrongPrior(), WrongExactPrior(), EccentricMass(), EccentricStiffness(), TurnedAxes(),
    )
}  # fmt: skip

_open_classes = (*OPEN_CLASSES, OtherCenters())


def open_classes() -> tuple[Effect, ...]:
    """List the open classes: for each statement of the shear model, the violations that the catalogue lacks."""
    return _open_classes


def catalogue() -> tuple[Effect, ...]:
    """List every known effect, with the registered user-defined ones last."""
    return tuple(_catalogue.values())


def register(effect: Effect) -> None:
    """Add an effect to the catalogue; an effect with the same name is replaced.

    Raises
    ------
    InputError
        If the effect is unusable; the message names the first fault.
    """
    refuse_faulty(effect)
    _catalogue[effect.name] = effect


def named(names: Sequence[str]) -> tuple[Effect, ...]:
    """Look up the effects of these names.

    Raises
    ------
    InputError
        If a name is unknown; the message lists the known names.
    """
    return tuple(_catalogue[checks.choice(name, list(_catalogue), "effect")] for name in names)


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
    name = checks.text(getattr(effect, "name", None), "name of an effect")
    try:
        with checks.named(f"effect {name}"):
            checks.choice(effect.stage, STAGES, "stage")
            effect.expecting(size=effect.size, probability=effect.probability)
            bound = effect.bound(experiment)
            places = [] if bound.unavailable(experiment) else bound.places(experiment)
            for place in dict.fromkeys((*places[:1], *places[-1:])):
                _check_at(LocatedEffect(bound.bound_at(experiment, place), place), experiment)
    except FaultyEffectError as error:
        raise InputError(f"effect {error}") from error
    except CvxshearError:
        raise
    except Exception as error:
        # A user's effect may raise anything; its name belongs in the message.
        read_only = "read-only" in str(error) and "; apply() must change copies of the arrays that it is given"
        raise InputError(f"effect {name} raised {type(error).__name__}: {error}{read_only or ''}") from error


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


def _check_at(placed: LocatedEffect, experiment: Experiment) -> None:
    """Check the parameters at one place, and what the effect does there to a frame of the declared mass near 2 Hz."""
    items, n = placed.effect.parameters, experiment.stories
    each = (experiment.frame.total_mass or 10.0 * n) / n
    frame = experiment.units(each, 2000.0 * each)
    frame *= 1.0 + 0.2 * np.cos(np.arange(len(frame)))
    scale = Scale.of(experiment, each, 2000.0 * each)
    sizes = placed.effect.expected_sizes(scale)
    if np.shape(sizes) != (len(items),):
        raise InputError(f"sizes() has the shape {np.shape(sizes)}, not ({len(items)},)")
    for item, size in zip(items, sizes, strict=True):
        if not size > 0:
            raise InputError(f"the size of {item.name} is {size:g}: it must be positive")
        if not item.lower <= item.start <= item.upper:
            raise InputError(f"{item.name}: start = {item.start:g} is not between {item.lower:g} and {item.upper:g}")
        if np.isinf(size) and np.isinf(item.upper - item.lower):
            raise InputError(f"sizes() says nothing of {item.name} and its bounds are infinite: give a size or bounds")
    nulls, lower, upper = (np.array([getattr(item, key) for item in items]) for key in ("null", "lower", "upper"))
    uniform = np.isinf(sizes)
    with np.errstate(invalid="ignore"):
        # Half an expected size from null, or the middle of a uniform prior.
        own = np.where(uniform, 0.5 * (lower + upper), np.clip(nulls + 0.5 * sizes, lower, upper))
        steps = np.concatenate([frame, np.where(uniform, upper - lower, sizes)])
    _check_matrices(placed, experiment, np.concatenate([frame, own]), np.concatenate([frame, nulls]), steps)


def _check_matrices(placed: LocatedEffect, experiment: Experiment, at: Floats, null: Floats, steps: Floats) -> None:
    """Check the matrices at some parameters and at null, and their derivatives."""
    first, tested = experiment.parameters, next(each for each in experiment.tested if placed.acts_on(each))

    def matrices(state: State) -> dict[str, Floats]:
        return {"M": state.system.M, "K": state.system.K, "the observation": state.observation.matrix}

    plain, values = compose(experiment, tested, [], at), at[first:].copy()
    for array in (*vars(plain).values(), plain.system.M, plain.system.K, values):
        if isinstance(array, np.ndarray):
            array.flags.writeable = False
    placed.effect.apply(plain, placed.place, values, slice(first, len(at)))
    state = compose(experiment, tested, [placed], at)
    square = (len(state.system.K),) * 2
    for name, shape in (("M", square), ("K", square), ("dM", (len(at), *square)), ("dK", (len(at), *square))):
        found = getattr(state.system, name)
        if found.shape != shape:
            raise InputError(f"{name} has the shape {found.shape} after apply(), not {shape}")
        if not np.allclose(found, np.swapaxes(found, -1, -2)):
            raise InputError(f"{name} is not symmetric after apply()")
    if len(state.system.K) == len(plain.system.K):
        before = matrices(plain)
        for name, value in matrices(compose(experiment, tested, [placed], null)).items():
            if not np.allclose(value, before[name]):
                raise InputError(f"{name} is not that of the shear frame at the null values")
    rng, where = np.random.default_rng(20), placed.place.describe() or "its place"
    for word, part in (("its own parameters", slice(first, None)), ("masses and stiffnesses", slice(0, first))):
        direction = np.zeros(len(at))
        direction[part] = checks.DIFFERENCE_STEP * (steps * rng.standard_normal(len(at)))[part]
        up, down = (matrices(compose(experiment, tested, [placed], at + sign * direction)) for sign in (1.0, -1.0))
        slopes = [np.tensordot(direction, each, 1) for each in (state.system.dM, state.system.dK)]
        observed = np.zeros_like(state.observation.matrix)
        for parameter, slope in state.observation.slopes.items():
            observed += direction[parameter] * slope
        for (name, value), stated in zip(matrices(state).items(), (*slopes, observed), strict=True):
            change = 0.5 * (up[name] - down[name])
            said = f"the derivative of {name} by {word} at {where}"
            checks.derivative(stated, change, np.max(np.abs(change)), value, said)
