"""Tested state of a frame that effects change, and reference sizes of the effects."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cvxshear.measurement.experiment import Experiment, Tested
from cvxshear.model import Observation, System
from cvxshear.motions import ONE_MOTION, Motions
from cvxshear.util import decorators
from cvxshear.util.errors import NoModesError
from cvxshear.util.typing import Floats

#: Order of the effects on a tested state, independent of the order of their names: the axes of stories that turn, the
#: centers of floors and stories that turn, the braces' part of the stories, the story stiffnesses, the joints between
#: columns and beams, the differences of the beams between floors, added flexibility of the frame, added springs, the
#: floors' own masses, added masses, the weight of these masses, the coupling of masses, attached masses, and the
#: sensors' readings of the shapes. The stiffness matrix is assembled before the flexibility.
STAGES = (
    "axes", "center", "bracing", "story", "joint", "beams", "flexibility", "spring", "floor", "mass", "gravity",
    "inertia", "attachment", "shape",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Scale:
    """Reference sizes of a frame for the sizes of effects.

    Parameters
    ----------
    floor_mass, story_stiffness : float
        Means, kg and N/m.
    heights : ndarray, shape (N,)
        Story heights, m; ones if not declared.
    radius : ndarray, shape (N,), optional
        Radii of gyration of floors that turn, m. Default: 1 m.
    motions : Motions, optional
    """

    floor_mass: float
    story_stiffness: float
    heights: Floats
    radius: Floats = field(default_factory=lambda: np.ones(1))
    motions: Motions = ONE_MOTION

    @staticmethod
    def of(experiment: Experiment, floor_mass: float, story_stiffness: float) -> Scale:
        """Take heights, radii and motions from an experiment."""
        heights, radius = heights_of(experiment), experiment.radius
        return Scale(float(floor_mass), float(story_stiffness), heights, radius, experiment.motions)

    @property
    def mean_radius(self) -> float:
        """Mean of the radii, m."""
        return float(np.mean(self.radius))

    @decorators.cached_property
    def units(self) -> Floats:
        """Size of every parameter of a frame of such floors and stories."""
        radius = np.broadcast_to(self.radius, len(self.heights))
        return self.motions.units(self.floor_mass, self.story_stiffness, radius)

    @property
    def sway(self) -> float:
        """Displacement of the top under a unit force there, m/N, for equal stories."""
        return len(self.heights) / self.story_stiffness


def heights_of(experiment: Experiment) -> Floats:
    """Return the story heights, shape (N,), m; ones (equal stories) if not declared."""
    heights = experiment.frame.story_heights
    return np.ones(experiment.stories) if heights is None else heights


@dataclass(frozen=True, eq=False)
class State:
    """Tested state of the frame during the application of effects, with derivatives by all P parameters of the fit.

    The parameters are the N floor masses, the N story stiffnesses, and then the effects' own. Of floors that turn, they
    are those of `experiment.motions`, and the arrays `story_stiffness` and `d_story_stiffness` have the six entries xx,
    yy, rr, xy, xr and yr of each story's matrix, shapes (6 N,) and (P, 6 N).

    Parameters
    ----------
    experiment : Experiment
    tested : Tested
    floor_mass : ndarray, shape (N,)
        Floor masses of the frame itself, without added mass, kg.
    story_stiffness, d_story_stiffness : ndarray, shapes (N,) and (P, N)
        Story stiffnesses of this state with braces, N/m.
    brace_stiffness, d_brace_stiffness : ndarray, shapes (N,) and (P, N)
        Braces' part of the story stiffnesses; braces shear and do not rotate joints.
    column_stiffness, d_column_stiffness : ndarray, shapes (N,) and (P, N)
        Stiffnesses of the stories' columns before changes of single stories, N/m: the reference for the stiffness of
        beams and joints.
    joint_flexibility, d_joint_flexibility : ndarray, shapes (N + 1,) and (P, N + 1)
        Rotation of each floor's joints under a unit moment, rad/(N m), the base first; zero for rigid joints.
    system : System
        Matrices and their derivatives (P rows), also by the effects' own parameters.
    observation : Observation
        Map from the frame's motions to the sensors.
    """

    experiment: Experiment
    tested: Tested
    floor_mass: Floats
    story_stiffness: Floats
    d_story_stiffness: Floats
    brace_stiffness: Floats
    d_brace_stiffness: Floats
    column_stiffness: Floats
    d_column_stiffness: Floats
    joint_flexibility: Floats
    d_joint_flexibility: Floats
    system: System
    observation: Observation

    def having(self, **changes: object) -> State:
        """Return a copy with some fields replaced; `dataclasses.replace` takes three times as long."""
        changed = object.__new__(State)
        changed.__dict__.update(self.__dict__, **changes)
        return changed

    def with_stiffness(self, K: Floats, dK: Floats) -> State:
        """Return the same state with another stiffness matrix and its derivatives."""
        return self.having(system=System(self.system.M, K, self.system.dM, dK))

    def with_mass(self, M: Floats, dM: Floats) -> State:
        """Return the same state with another mass matrix and its derivatives."""
        return self.having(system=System(M, self.system.K, dM, self.system.dK))

    def plus_stiffness(self, values: Floats, units: Floats, own: slice) -> State:
        """Return the same state with the stiffness values_i units_i added, summed over the parameters `own`.

        Parameters
        ----------
        values : ndarray, shape (p,)
        units : ndarray, shape (p, N, N)
            Matrices that depend on no parameter of the fit; they do not include degrees of freedom beyond the N floors.
        own : slice
            Rows of the derivatives by these parameters.

        Raises
        ------
        ValueError
            If `units` has another shape.
        """
        return self._plus("K", values, units, own)

    def plus_mass(self, values: Floats, units: Floats, own: slice) -> State:
        """Return the same state with the mass values_i units_i added, as `plus_stiffness` does with stiffness."""
        return self._plus("M", values, units, own)

    def _plus(self, name: str, values: Floats, units: Floats, own: slice) -> State:
        units, n = np.asarray(units), len(self.heights) * self.experiment.motions.count
        if units.shape != (len(values), n, n):
            raise ValueError(f"units has the shape {units.shape}, not {(len(values), n, n)}")
        return self.having(system=self.system.plus(name, np.asarray(values), units, own))

    def with_flexibility(self, p: float, D: Floats, own: slice) -> State:
        """Return the same state with p D added to its flexibility.

        With A = (1 + p K D)^-1 the new stiffness is A K, without inverting K; and since the flexibility F = K^-1
        changes by -F dK F, the new stiffness changes by A dK A' - (A K) D (A K) dp.

        Parameters
        ----------
        p : float
            The effect's parameter.
        D : ndarray, shape (N, N)
            Flexibility for p = 1, m/N; it depends on no parameter of the fit.
        own : slice

        Raises
        ------
        NoModesError
            If the resulting stiffness is singular.
        """
        system = self.system
        try:
            A = np.linalg.inv(np.eye(len(D)) + p * (system.K @ D))
        except np.linalg.LinAlgError:
            raise NoModesError("the stiffness matrix is singular with the flexibility that is added to it") from None
        K = A @ system.K
        K = 0.5 * (K + K.T)
        dK = A @ system.dK @ A.T
        dK[own] -= K @ D @ K
        return self.with_stiffness(K, dK)

    def with_softer_joints(self, joints: slice, rho: float, own: int) -> State:
        """Return the same state with joints more flexible by rho / mean(k h^2), k the columns' stiffness, rad/(N m).

        Parameters
        ----------
        joints : slice
            Range among the floors' joints, the base first.
        rho : float
        own : int
            Row of the derivatives by rho.

        Raises
        ------
        NoModesError
            If no story has columns.
        """
        usual = float(np.mean(self.column_stiffness * self.heights**2))
        if usual <= 0:
            raise NoModesError("no story has columns whose joints could turn")
        unit = 1.0 / usual
        d_unit = -(unit**2) * np.mean(self.d_column_stiffness * self.heights**2, axis=1)
        softer, d_softer = self.joint_flexibility.copy(), self.d_joint_flexibility.copy()
        softer[joints] += rho * unit
        d_softer[:, joints] += rho * d_unit[:, None]
        d_softer[own, joints] += unit
        return self.having(joint_flexibility=softer, d_joint_flexibility=d_softer)

    @property
    def gain(self) -> Floats:
        """Reading of the sensor on each floor for a unit motion of this floor, shape (N,)."""
        return self.observation.gain

    @property
    def heights(self) -> Floats:
        """Story heights, shape (N,), m; ones if not declared."""
        return heights_of(self.experiment)


def summed(values: Floats, units: Floats) -> Floats:
    """Sum values_i units_i over the last axis of the values; `numpy.tensordot` takes several times longer."""
    found: Floats = (values @ units.reshape(len(units), -1)).reshape(values.shape[:-1] + units.shape[1:])
    return found
