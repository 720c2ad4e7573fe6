"""Registry of the effects, in the order of the reports."""

from __future__ import annotations

from collections.abc import Sequence

from cvxshear.effects.attached_mass import AttachedMass, LoadMounting
from cvxshear.effects.base import Effect
from cvxshear.effects.custom_effect_checks import refuse_faulty
from cvxshear.effects.joints import JointRelease, JointRotation, SoftFeet
from cvxshear.effects.masses import AddedMass, FloorMass, LoadScale, MassCoupling, StateMass, TotalMass
from cvxshear.effects.open_class import (
    OtherBeams,
    OtherChanges,
    OtherFrequencies,
    OtherGains,
    OtherInertia,
    OtherLoads,
    OtherShapes,
    OtherStiffness,
)
from cvxshear.effects.readings import ForceScale, SensorGain, ShapeScale, WrongExactPrior, WrongPrior
from cvxshear.effects.springs import GroundSpring, Spring
from cvxshear.effects.stories import Bracing, StateStiffness, StoryChange
from cvxshear.effects.whole_frame import AxialColumns, BaseRocking, Gravity, Wall
from cvxshear.util import checks

_catalogue: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        Gravity(),
        JointRotation(),
        AxialColumns(),
        BaseRocking(),
        Wall(),
        GroundSpring(),
        AddedMass(),
        MassCoupling(),
        SensorGain(),
        StoryChange(),
        TotalMass(),
        Spring(),
        StateStiffness(),
        StateMass(),
        LoadScale(),
        FloorMass(),
        JointRelease(),
        SoftFeet(),
        Bracing(),
        AttachedMass(),
        LoadMounting(),
        ShapeScale(),
        ForceScale(),
        WrongPrior(),
        WrongExactPrior(),
    )
}

_open_classes: tuple[Effect, ...] = (
    OtherStiffness(),
    OtherInertia(),
    OtherBeams(),
    OtherChanges(),
    OtherLoads(),
    OtherGains(),
    OtherShapes(),
    OtherFrequencies(),
)


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
