"""The catalogue of physical effects that a shear model lacks, one file an effect.

`catalogue()` lists them; `register` adds one of your own to it.
"""

from cvxshear.effects.added_mass import AddedMass
from cvxshear.effects.attached_mass import AttachedMass
from cvxshear.effects.axial_columns import AxialColumns
from cvxshear.effects.base import Effect, Parameter, Place, Placed
from cvxshear.effects.base_rocking import BaseRocking
from cvxshear.effects.bracing import Bracing
from cvxshear.effects.composition import compose
from cvxshear.effects.gravity import Gravity
from cvxshear.effects.ground_spring import GroundSpring
from cvxshear.effects.guests import refuse_faulty, refuse_repeated
from cvxshear.effects.joint_release import JointRelease
from cvxshear.effects.joint_rotation import JointRotation
from cvxshear.effects.load_scale import LoadScale
from cvxshear.effects.mass_coupling import MassCoupling
from cvxshear.effects.registry import catalogue, named, open_classes, register
from cvxshear.effects.sensor_gain import SensorGain
from cvxshear.effects.spring import Spring
from cvxshear.effects.state import Scale, State
from cvxshear.effects.state_mass import StateMass
from cvxshear.effects.state_stiffness import StateStiffness
from cvxshear.effects.story_change import StoryChange
from cvxshear.effects.total_mass import TotalMass

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
    "MassCoupling",
    "Parameter",
    "Place",
    "Placed",
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
]
