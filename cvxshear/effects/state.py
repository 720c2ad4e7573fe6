"""The tested state of a frame that effects act on, and the sizes that they are compared with."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from cvxshear.measurement.experiment import Experiment, Tested
from cvxshear.model.shear import System
from cvxshear.util.typing import Floats

STAGES = ("story", "elastic", "flexibility", "spring", "mass", "gravity", "inertia", "shape")
"""The order in which effects act on a tested state, whatever the order they were named in: story stiffnesses,
the elastic frame made of them, what adds flexibility, what adds springs, masses, the weight of those masses, how
masses are coupled, and what the sensors make of the shapes."""


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
    frame_stiffness : ndarray, shape (N,)
        Story stiffnesses of the frame itself, N/m.
    story_stiffness : ndarray, shape (N,)
        Those of this state, N/m.
    d_story_stiffness : ndarray, shape (P, N)
    system : System
        Matrices and their derivatives, those of the effects' own parameters included (P rows).
    gain : ndarray, shape (N,)
        What the measured shape has at each floor in place of 1.
    d_gain : ndarray, shape (P, N)
    """

    experiment: Experiment
    tested: Tested
    frame_stiffness: Floats
    story_stiffness: Floats
    d_story_stiffness: Floats
    system: System
    gain: Floats
    d_gain: Floats

    def with_stiffness(self, K: Floats, dK: Floats) -> State:
        """The same state with another stiffness matrix and its derivatives."""
        return dataclasses.replace(self, system=dataclasses.replace(self.system, K=K, dK=dK))

    def with_mass(self, M: Floats, dM: Floats) -> State:
        """The same state with another mass matrix and its derivatives."""
        return dataclasses.replace(self, system=dataclasses.replace(self.system, M=M, dM=dM))

    @property
    def heights(self) -> Floats:
        """Story heights, shape (N,), m; ones where they are not declared."""
        return heights_of(self.experiment)

    @property
    def elevations(self) -> Floats:
        """Elevations of the floors, shape (N,), m."""
        return np.cumsum(self.heights)
