"""A starting frame for data that no other start is near: smooth over the height, from the lowest modes to all.

A tall frame has many local minima: a high mode of the model with its nodes half a wave off fits worse on the way to
where it fits. The lowest modes have hardly any, and they see masses and stiffnesses as smooth functions of the height.
So the logarithms of both are polynomials in the height,

    theta = theta_0 o exp(B c),        B Legendre polynomials up to a degree,

fitted to the first mode, then to twice as many with a degree more, and so on up to all; every stage starts where the
last one ended. What is not smooth is left to Gauss-Newton, which then starts in the right valley.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from cvxshear.fit.misfit import Misfit
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats

MOST_DEGREE = 8
MOST_EVALUATIONS = 20
ACCURACY = 1e-3
"""Relative change of the misfit or of the coefficients at which a stage ends."""

STD = 1.0 / 3.0
"""Standard deviation of each coefficient about zero: what these data do not tell stays uniform."""

LARGEST = 3.0
"""Bound of |B c| in a stage, so that no trial overflows: factors from 1/20 to 20."""


@dataclass(frozen=True, eq=False)
class _Family:
    """Frames of smooth profiles.

    Parameters
    ----------
    base : ndarray, shape (2N,)
        theta_0.
    mass, stiffness : ndarray, shapes (N, a) and (N, b)
        Polynomials of the logarithms; `mass` of no columns where the masses are known.
    total : float or None
        What the masses add up to, kg, if known.
    """

    base: Floats
    mass: Floats
    stiffness: Floats
    total: float | None

    def at(self, c: Floats) -> tuple[Floats, Floats]:
        """theta, and the derivative of its logarithm by c."""
        n = len(self.mass)
        logs = np.clip(block_diag(self.mass, self.stiffness) @ c, -LARGEST, LARGEST)
        theta = self.base * np.exp(logs)
        mass = self.mass
        if self.total is not None and mass.shape[1]:
            theta[:n] *= self.total / theta[:n].sum()
            mass = mass - theta[:n] @ mass / self.total
        return theta, block_diag(mass, self.stiffness)


def smooth_start(experiment: Experiment, base: Floats) -> Floats:
    """The smooth frame that suits all modes, reached from the lowest.

    Parameters
    ----------
    experiment : Experiment
    base : ndarray, shape (2N,)
        Masses and stiffnesses of a frame of about the right first frequency.

    Returns
    -------
    ndarray, shape (2N,)
    """
    modes = max(int(each.modes.max()) for each in experiment.configurations)
    theta, count, degree = base, 0, 0
    while count < modes:
        count, degree = min(max(1, 2 * count), modes), min(degree + 1, MOST_DEGREE)
        above = {each.name: each.modes > count for each in experiment.configurations}
        theta = _fitted(Misfit(experiment, (), above), _family(experiment, theta, degree))
    return theta


def _family(experiment: Experiment, base: Floats, degree: int) -> _Family:
    """Profiles about a frame: that of the masses without a constant where their total is known."""
    n, frame = experiment.stories, experiment.frame
    polynomials = np.asarray(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), degree), dtype=float)
    # A known total takes the constant of the masses, known masses all of their profile.
    first = degree + 1 if frame.floor_masses is not None else int(frame.known_total is not None)
    return _Family(base, polynomials[:, first:], polynomials, frame.known_total)


def _fitted(misfit: Misfit, family: _Family) -> Floats:
    """The frame of the family with the smallest misfit."""

    def residuals(c: Floats) -> Floats:
        return np.concatenate([misfit.evaluate(family.at(c)[0], derivatives=False).r, c / STD])

    def derivatives(c: Floats) -> Floats:
        theta, slope = family.at(c)
        return np.concatenate([(misfit.evaluate(theta).J * theta) @ slope, np.eye(len(c)) / STD])

    start = np.zeros(family.mass.shape[1] + family.stiffness.shape[1])
    found = least_squares(
        residuals, start, derivatives, x_scale="jac", ftol=ACCURACY, xtol=ACCURACY, max_nfev=MOST_EVALUATIONS
    )
    return family.at(found.x)[0]
