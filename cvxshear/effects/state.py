"""The tested state of a frame that effects act on, and the sizes that they are compared with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.experiment import Experiment, Tested
from cvxshear.model.observation import Observation
from cvxshear.model.shear import System
from cvxshear.util.errors import NoModesError
from cvxshear.util.typing import Floats

STAGES = (
    "bracing", "story", "joint", "beams", "flexibility", "spring", "mass", "gravity", "inertia", "attachment", "shape",
)  # fmt: skip
"""The order in which effects act on a tested state, whatever the order they were named in: which part of the stories
is braces, the story stiffnesses, the joints between columns and beams, how the beams differ from floor to floor, what
adds flexibility to the frame made of them, what adds springs, masses, the weight of those masses, how masses are
coupled, what swings on the floors, and what the sensors make of the shapes."""

OF_THE_FRAME = STAGES[:4]
"""Stages whose effects change what the elastic frame is made of; its stiffness matrix is assembled after them."""


@dataclass(frozen=True, eq=False)
class Scale:
    """Sizes of a frame, which the effects' own are compared with.

    Parameters
    ----------
    floor_mass, story_stiffness : float
        Means, kg and N/m.
    heights : ndarray, shape (N,)
        Story heights, m; ones where they are not declared.
    """

    floor_mass: float
    story_stiffness: float
    heights: Floats

    @property
    def elevations(self) -> Floats:
        """Of the floors, shape (N,)."""
        return np.cumsum(self.heights)

    @property
    def sway(self) -> float:
        """Displacement of the top under a unit force there, m/N, all stories alike."""
        return len(self.heights) / self.story_stiffness


def heights_of(experiment: Experiment) -> Floats:
    """Story heights, shape (N,), m; ones, all stories alike, where they are not declared."""
    heights = experiment.frame.story_heights
    return np.ones(experiment.stories) if heights is None else heights


@dataclass(frozen=True, eq=False)
class State:
    """One tested state of the frame while effects act on it, with derivatives by all P parameters of the fit.

    The parameters are the N floor masses, the N story stiffnesses, and then the effects' own.

    Parameters
    ----------
    experiment : Experiment
    tested : Tested
    floor_mass : ndarray, shape (N,)
        Of the frame itself, without added mass, kg.
    story_stiffness, d_story_stiffness : ndarray, shapes (N,) and (P, N)
        Of this state, braces included, N/m.
    brace_stiffness, d_brace_stiffness : ndarray, shapes (N,) and (P, N)
        The braces' part of them: they shear, and turn no joint.
    column_stiffness, d_column_stiffness : ndarray, shapes (N,) and (P, N)
        Of the stories' columns before single stories changed, N/m: what the stiffness of beams and joints is
        measured by.
    joint_flexibility, d_joint_flexibility : ndarray, shapes (N + 1,) and (P, N + 1)
        Turn of each floor's joints under a unit moment, rad/(N m), the base first; zero where they cannot turn.
    system : System
        Matrices and their derivatives, those of the effects' own parameters included (P rows).
    observation : Observation
        What the sensors show of the frame's motions.
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
        """Return the same state with values_i units_i more stiffness, summed over the parameters `own`.

        Parameters
        ----------
        values : ndarray, shape (p,)
        units : ndarray, shape (p, N, N)
            Matrices that depend on no parameter of the fit; motions beyond the floors' N have no part in them.
        own : slice
            Which rows of the derivatives are by these parameters.

        Raises
        ------
        ValueError
            If `units` has another shape.
        """
        return self.with_stiffness(*self._plus(self.system.K, self.system.dK, values, units, own))

    def plus_mass(self, values: Floats, units: Floats, own: slice) -> State:
        """Return the same state with values_i units_i more mass, as `plus_stiffness` does with stiffness."""
        return self.with_mass(*self._plus(self.system.M, self.system.dM, values, units, own))

    def _plus(self, matrix: Floats, slopes: Floats, values: Floats, units: Floats, own: slice) -> tuple[Floats, Floats]:
        units, n = np.asarray(units), len(self.floor_mass)
        if units.shape != (len(values), n, n):
            raise ValueError(f"units has the shape {units.shape}, not {(len(values), n, n)}")
        more, d_more = matrix.copy(), slopes.copy()
        more[:n, :n] += summed(values, units)
        d_more[own, :n, :n] += units
        return more, d_more

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
            Where the stiffness is singular with it.
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
        """Return the same state with rho / mean(k h^2) more flexibility of joints, k the columns' stiffness, rad/(N m).

        Parameters
        ----------
        joints : slice
            Of the floors' joints, the base's first.
        rho : float
        own : int
            Which row of the derivatives is by rho.

        Raises
        ------
        NoModesError
            Where no story has columns.
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
        """What the sensor on each floor shows of that floor's motion in place of 1, shape (N,)."""
        return self.observation.gain

    @property
    def heights(self) -> Floats:
        """Story heights, shape (N,), m; ones where they are not declared."""
        return heights_of(self.experiment)

    @property
    def elevations(self) -> Floats:
        """Elevations of the floors, shape (N,), m."""
        return np.cumsum(self.heights)


def summed(values: Floats, units: Floats) -> Floats:
    """Add up values_i units_i, over the last axis of the values; `numpy.tensordot` takes several times as long."""
    found: Floats = (values @ units.reshape(len(units), -1)).reshape(values.shape[:-1] + units.shape[1:])
    return found
