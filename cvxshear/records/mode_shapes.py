"""Mode shapes: phases, changes of sign, and the shapes of a shear frame.

The stiffness matrix of a shear frame is a Jacobi matrix, so mode r changes sign r - 1 times from the ground up
(Gantmacher and Krein 1950), and the first mode grows with height.
"""

import numpy as np

from cvxshear.measurement.reading import fewest_changes, most_changes
from cvxshear.util import ranking
from cvxshear.util.typing import Complexes, Floats

RULES = ("magnitude", "projection")
"""Ways to make a complex shape real: each entry's modulus with a sign, or its part along the shape's main axis."""


def collinearity(shape: Complexes) -> float:
    """Modal phase collinearity (MPC): 1 where all entries lie on one line through the origin, 0 for a circle.

    ((Sxx - Syy)^2 + 4 Sxy^2) / (Sxx + Syy)^2 with S the second moments of real and imaginary parts
    (Pappa, Elliott and Schenk 1993).
    """
    x, y = shape.real, shape.imag
    sxx, syy, sxy = x @ x, y @ y, x @ y
    return float(((sxx - syy) ** 2 + 4 * sxy**2) / (sxx + syy) ** 2)


def main_axis(shape: Complexes) -> Complexes:
    """Turn a shape so that the sum of its squared imaginary parts is least; its largest entry is positive."""
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))
    largest = turned[ranking.first_largest(np.abs(turned))]
    return np.asarray(turned if largest.real > 0 else -turned)


def real_shape(shape: Complexes) -> Floats:
    """Find the real normal mode of a complex shape: moduli, with the sign of the real part on the main axis.

    A phase that a clock offset or damping put there costs a modulus nothing.

    Parameters
    ----------
    shape : array of complex, shape (n,)

    Returns
    -------
    array, shape (n,)
    """
    turned = main_axis(shape)
    return np.abs(turned) * np.where(turned.real < 0, -1.0, 1.0)


def signed_projection(shape: Complexes, straight: Complexes) -> Floats:
    """Find the least-squares real shape: the part on the main axis, with the signs that true clocks would show.

    Parameters
    ----------
    shape : array of complex, shape (n,)
        As recorded.
    straight : array of complex, shape (n,)
        Clock offsets undone.

    Returns
    -------
    array, shape (n,)
    """
    return np.abs(main_axis(shape).real) * np.where(main_axis(straight).real < 0, -1.0, 1.0)


def lost_phase(shape: Complexes) -> float:
    """Angle off the main axis that a real shape leaves out, degrees, root mean square weighted by modulus squared."""
    return rms_phase(main_axis(shape))


def folded_phase(values: Complexes) -> Floats:
    """Angle off the real axis to the nearer side, rad."""
    return np.angle(values * np.where(values.real < 0, -1.0, 1.0))


def rms_phase(values: Complexes, weight: Floats | None = None) -> float:
    """Root mean square angle off the real axis, degrees, weighted by default by the squared moduli."""
    weight = np.abs(values) ** 2 if weight is None else weight
    return float(np.degrees(np.sqrt(np.sum(weight * folded_phase(values) ** 2) / np.sum(weight))))


def sign_changes(shape: Floats) -> int:
    """How often the shape changes sign from the ground up."""
    return fewest_changes(np.sign(shape))


def possible_changes(shape: Floats, tolerance: float) -> tuple[int, int]:
    """Fewest and most changes of sign, where entries below a part of the largest can have either sign.

    Over a distance of d floors between entries whose sign is sure there are d changes at most, and an odd number of
    them just where the signs differ.

    Parameters
    ----------
    shape : array, shape (n,)
    tolerance : float
        Of the largest entry.
    """
    signs = np.where(np.abs(shape) > tolerance * np.abs(shape).max(), np.sign(shape), 0.0)
    return fewest_changes(signs), most_changes(signs)


def scaled_to_one(shape: Floats) -> Floats:
    """Scale a shape to a largest entry of 1."""
    return np.asarray(shape / shape[ranking.first_largest(np.abs(shape))])
