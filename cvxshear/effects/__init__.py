"""The catalogue of physical effects that a shear model lacks.

`catalogue()` lists them; `register` adds one of your own to it.
"""

from cvxshear.effects.attached_mass import AttachedMass
from cvxshear.effects.base import Effect, LocatedEffect, Parameter, Place
from cvxshear.effects.composition import compose
from cvxshear.effects.guests import refuse_faulty, refuse_repeated
from cvxshear.effects.joints import JointRelease, JointRotation
from cvxshear.effects.masses import AddedMass, LoadScale, MassCoupling, StateMass, TotalMass
from cvxshear.effects.readings import SensorGain
from cvxshear.effects.registry import catalogue, named, open_classes, register
from cvxshear.effects.springs import GroundSpring, Spring
from cvxshear.effects.state import Scale, State
from cvxshear.effects.stories import Bracing, StateStiffness, StoryChange
from cvxshear.effects.whole_frame import AxialColumns, BaseRocking, Gravity

__all__ = [
    "AddedMass",
    "AttachedMass",
    "AxialColumns",
    "BaseRocking",
    "Bracing",
    "Effect",
    "Gravity",
    "GroundSpring",
    "JointRelease",
    "JointRotation",
    "LoadScale",
    "LocatedEffect",
    "MassCoupling",
    "Parameter",
    "Place",
    "Scale",
    "SensorGain",
    "Spring",
    "State",
    "StateMass",
    "StateStiffness",
    "StoryChange",
    "TotalMass",
    "catalogue",
    "compose",
    "named",
    "open_classes",
    "refuse_faulty",
    "refuse_repeated",
    "register",
]  # fmt: skip
