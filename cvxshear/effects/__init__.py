"""The catalogue of physical effects that a shear model lacks.

`catalogue()` lists them in the order of the reports; `register` adds one of your own to it.
"""

from collections.abc import Sequence

from cvxshear.effects.base import Effect, LocatedEffect, Parameter, Place
from cvxshear.effects.composition import compose
from cvxshear.effects.custom_effect_checks import refuse_faulty, refuse_repeated
from cvxshear.effects.masses import (
    AddedMass,
    AttachedMass,
    FloorMass,
    LoadMounting,
    LoadScale,
    MassCoupling,
    StateMass,
    TotalMass,
)  # fmt: skip
from cvxshear.effects.open_class import OPEN_CLASSES
from cvxshear.effects.readings import ForceScale, SensorGain, ShapeScale, WrongExactPrior, WrongPrior
from cvxshear.effects.state import Scale, State
from cvxshear.effects.stories import Bracing, JointRelease, JointRotation, SoftFeet, StateStiffness, StoryChange
from cvxshear.effects.whole_frame import AxialColumns, BaseRocking, Gravity, GroundSpring, Spring, Wall
from cvxshear.util import checks

__all__ = [
    "AddedMass", "AttachedMass", "AxialColumns", "BaseRocking", "Bracing", "Effect", "Gravity", "GroundSpring",
    "JointRelease", "JointRotation", "LoadScale", "LocatedEffect", "MassCoupling", "Parameter", "Place", "Scale",
    "SensorGain", "Spring", "State", "StateMass", "StateStiffness", "StoryChange", "TotalMass", "Wall", "catalogue",
    "compose", "named", "open_classes", "refuse_faulty", "refuse_repeated", "register",
]  # fmt: skip

_catalogue: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        Gravity(), JointRotation(), AxialColumns(), BaseRocking(), Wall(), GroundSpring(), AddedMass(), MassCoupling(),
        SensorGain(), StoryChange(), TotalMass(), Spring(), StateStiffness(), StateMass(), LoadScale(), FloorMass(),
        JointRelease(), SoftFeet(), Bracing(), AttachedMass(), LoadMounting(), ShapeScale(), ForceScale(),
        WrongPrior(), WrongExactPrior(),
    )
}  # fmt: skip


def open_classes() -> tuple[Effect, ...]:
    """List the open classes: for each statement of the shear model, the violations that the catalogue lacks."""
    return OPEN_CLASSES


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
