"""A frame with damping, and how its floors move under base motion or a force."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cvxshear.model.shear import Modes, modes
from cvxshear.records.motion import Drive
from cvxshear.response.hold import held
from cvxshear.response.poles import Poles, modal_damping, poles
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class DampedModel:
    """Mass, damping and stiffness matrices of one state of the frame.

    Parameters
    ----------
    M, C, K : ndarray, shape (N, N)
        kg, N s/m, N/m.
    gain : ndarray, shape (N,)
        What a sensor on each floor shows in place of 1.
    heights : ndarray, shape (N,), optional
        Story heights, m.
    mass_known : bool, optional
        Whether the masses have a scale, without which forces have none.
    """

    M: Floats
    C: Floats
    K: Floats
    gain: Floats
    heights: Floats | None = None
    mass_known: bool = True

    @cached_property
    def modes(self) -> Modes:
        """Undamped modes."""
        return modes(self.M, self.K)

    @cached_property
    def poles(self) -> Poles:
        """Complex modes."""
        return poles(self.M, self.C, self.K)

    @cached_property
    def ratios(self) -> Floats:
        """Damping ratio of each mode, shape (N,): of its pole, of Phi' C Phi where a mode is overdamped."""
        if len(self.poles.values) == len(self.M) and np.all(self.poles.values.imag > 0):
            return self.poles.ratios
        ratios: Floats = np.diag(modal_damping(self.modes, self.C)) / (2 * np.sqrt(self.modes.eigenvalues))
        return ratios


@dataclass(frozen=True, eq=False)
class Response:
    """How every floor moves, from rest.

    Parameters
    ----------
    time : ndarray, shape (samples,)
        s.
    acceleration : ndarray, shape (samples, N)
        Total accelerations of the floors, m/s2.
    displacement : ndarray, shape (samples, N)
        Of the floors against the ground, m.
    story_force : ndarray, shape (samples, N)
        Shear that story i carries to what lies below: the forces on floors i and above less their inertia, N.
        Per kilogram of the frame where its masses have no scale.
    heights : ndarray, shape (N,), optional
        Story heights, m.
    mass_known : bool
    """

    time: Floats
    acceleration: Floats
    displacement: Floats
    story_force: Floats
    heights: Floats | None
    mass_known: bool

    @property
    def drift(self) -> Floats:
        """Of each story, floor less floor below, shape (samples, N), m."""
        return np.diff(self.displacement, axis=1, prepend=0.0)

    @property
    def drift_ratio(self) -> Floats | None:
        """Drift over story height, shape (samples, N); None where heights are not declared."""
        return None if self.heights is None else self.drift / self.heights

    @property
    def story_shear(self) -> Floats | None:
        """`story_force`, N; None where the masses have no scale."""
        return self.story_force if self.mass_known else None

    @property
    def base_shear(self) -> Floats | None:
        """Shear of the first story, shape (samples,), N."""
        return self.story_force[:, 0] if self.mass_known else None

    @property
    def overturning_moment(self) -> Floats | None:
        """Of the floors' forces about the base, shape (samples,), N m; weights on displaced floors are not in it."""
        return self.story_force @ self.heights if self.mass_known and self.heights is not None else None


def response(model: DampedModel, drive: Drive, step: float) -> Response:
    """How the floors move, exact for an excitation that is a straight line between samples.

    Parameters
    ----------
    model : DampedModel
    drive : Drive
        A base acceleration where its floor is 0, else a force.
    step : float
        Time between samples, s.

    Raises
    ------
    InputError
        Where the force acts on a floor that the frame has not.
    """
    n, p = len(model.M), drive.excitation
    load = _load(model, drive.floor)
    of = model.poles
    factors = of.weights * (of.shapes.T @ load) / of.scales
    z = held(of.values, p, step)
    # u = Re(sum of shapes factors z); its second derivative has s^2 in each term, and a jump at the load itself that
    # for base motion is the ground's own acceleration, which the total one has besides.
    table = of.shapes * factors
    both = np.concatenate([table * of.values**2, table])
    moved = np.hstack([both.real, -both.imag]) @ np.vstack([z.real, z.imag])
    acceleration, displacement = moved[:n].T, moved[n:].T
    forces = np.zeros((len(p), n))
    if drive.floor:
        acceleration = acceleration + np.outer(p, np.linalg.solve(model.M, load))
        forces[:, drive.floor - 1] = p
    unbalanced = forces - acceleration @ model.M
    return Response(
        time=step * np.arange(len(p), dtype=np.float64),
        acceleration=acceleration,
        displacement=displacement,
        story_force=np.cumsum(unbalanced[:, ::-1], axis=1)[:, ::-1],
        heights=model.heights,
        mass_known=model.mass_known,
    )


def _load(model: DampedModel, floor: int) -> Floats:
    """b of the forces b p(t): -M 1 for a base acceleration, a unit vector for a force."""
    n = len(model.M)
    if floor == 0:
        total: Floats = model.M.sum(axis=1)
        return -total
    if floor > n:
        raise InputError(f"the force acts on floor {floor} of a frame of {n} stories")
    unit = np.zeros(n)
    unit[floor - 1] = 1.0
    return unit
