"""Which effects there are, in the order that reports list them."""

from __future__ import annotations

from collections.abc import Sequence

from cvxshear.effects.added_mass import AddedMass
from cvxshear.effects.attached_mass import AttachedMass
from cvxshear.effects.axial_columns import AxialColumns
from cvxshear.effects.base import Effect
from cvxshear.effects.base_rocking import BaseRocking
from cvxshear.effects.bracing import Bracing
from cvxshear.effects.gravity import Gravity
from cvxshear.effects.ground_spring import GroundSpring
from cvxshear.effects.guests import refuse_faulty
from cvxshear.effects.joint_release import JointRelease
from cvxshear.effects.joint_rotation import JointRotation
from cvxshear.effects.load_scale import LoadScale
from cvxshear.effects.mass_coupling import MassCoupling
from cvxshear.effects.other_changes import OtherChanges
from cvxshear.effects.other_gains import OtherGains
from cvxshear.effects.other_inertia import OtherInertia
from cvxshear.effects.other_loads import OtherLoads
from cvxshear.effects.other_shapes import OtherShapes
from cvxshear.effects.other_stiffness import OtherStiffness
from cvxshear.effects.sensor_gain import SensorGain
from cvxshear.effects.spring import Spring
from cvxshear.effects.state_mass import StateMass
from cvxshear.effects.state_stiffness import StateStiffness
from cvxshear.effects.story_change import StoryChange
from cvxshear.effects.total_mass import TotalMass
from cvxshear.effects.wrong_prior import WrongPrior
from cvxshear.util import checks

_catalogue: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        Gravity(),
        JointRotation(),
        AxialColumns(),
        BaseRocking(),
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
        JointRelease(),
        Bracing(),
        AttachedMass(),
        WrongPrior(),
    )
}

_open_classes: tuple[Effect, ...] = (
    OtherStiffness(),
    OtherInertia(),
    OtherChanges(),
    OtherLoads(),
    OtherGains(),
    OtherShapes(),
)


def open_classes() -> tuple[Effect, ...]:
    """For each statement of the shear model the effect that says "not so, in no way that the catalogue has"."""
    return _open_classes


def catalogue() -> tuple[Effect, ...]:
    """Every effect that is known, one's own registered ones last."""
    return tuple(_catalogue.values())


def register(effect: Effect) -> None:
    """Add an effect to the catalogue; one of the same name is replaced.

    Raises
    ------
    InputError
        Where it cannot take part, with the first thing that is wrong with it.
    """
    refuse_faulty(effect)
    _catalogue[effect.name] = effect


def named(names: Sequence[str]) -> tuple[Effect, ...]:
    """Look up the effects of these names.

    Raises
    ------
    InputError
        Where there is none of a name; the message lists those there are.
    """
    return tuple(_catalogue[checks.choice(name, list(_catalogue), "effect")] for name in names)
