"""Compute the matrices of a plane beam-column by numerical integration of its shape functions.

No coefficient is copied from a table. The Hermite cubics follow from their end conditions, and every matrix is a
Gauss-Legendre sum of their derivatives. A coefficient such as 6/5 is therefore a result.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ACROSS = [1, 2, 4, 5]
"""End displacements that bend the element, among the six (along, across, turn at either end)."""
ALONG = [0, 3]
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(5)
"""Points and weights of a quadrature that is exact to degree 9; the mass of a cubic has degree 6."""


@dataclass(frozen=True)
class Section:
    """A member's cross section, including its material: EI, N m2; EA, N; kg/m."""

    bending: float
    axial: float
    line_mass: float = 0.0


def hermite(length: float) -> tuple[Polynomial, ...]:
    """Return the four cubics on [0, length] with unit displacement or slope at one end and zero in the other three."""
    ends = []
    for x in (0.0, length):
        ends.append([x**power for power in range(4)])
        ends.append([power * x ** (power - 1) if power else 0.0 for power in range(4)])
    return tuple(Polynomial(column) for column in np.linalg.inv(np.array(ends)).T)


@cache
def integral(family: Callable[[float], tuple[Polynomial, ...]], order: int, length: float) -> Floats:
    """Integrate over the element all products of the derivatives of this order of a family of shapes."""
    shapes = family(length)
    x = 0.5 * length * (POINTS + 1.0)
    values = np.array([shape.deriv(order)(x) if order else shape(x) for shape in shapes])
    return (values * WEIGHTS * 0.5 * length) @ values.T


def stiffness(section: Section, length: float) -> Floats:
    """Return the elastic stiffness in the element's own axes, shape (6, 6)."""
    K = np.zeros((6, 6))
    K[np.ix_(ACROSS, ACROSS)] = section.bending * integral(hermite, 2, length)
    K[np.ix_(ALONG, ALONG)] = section.axial * integral(linear, 1, length)
    return K


def consistent_mass(section: Section, length: float) -> Floats:
    """Return the consistent mass in the element's own axes, shape (6, 6)."""
    M = np.zeros((6, 6))
    M[np.ix_(ACROSS, ACROSS)] = section.line_mass * integral(hermite, 0, length)
    M[np.ix_(ALONG, ALONG)] = section.line_mass * integral(linear, 0, length)
    return M


def geometric_stiffness(compression: float, length: float) -> Floats:
    """Return the stiffness lost by a compressive force, N, if the cubic leans and bends, shape (6, 6)."""
    K = np.zeros((6, 6))
    K[np.ix_(ACROSS, ACROSS)] = -compression * integral(hermite, 1, length)
    return K


def linear(length: float) -> tuple[Polynomial, ...]:
    """Return the two straight lines on [0, length], one at one end and zero at the other."""
    return Polynomial([1.0, -1.0 / length]), Polynomial([0.0, 1.0 / length])


def own_axes(run: float, rise: float) -> Floats:
    """Return the matrix, (6, 6), from (ux, uy, turn) at both ends to (along, across, turn), to the far end."""
    length = np.hypot(run, rise)
    cos, sin = run / length, rise / length
    one_end = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.kron(np.eye(2), one_end)
