"""Whether the declared total mass agrees with what the added masses did to the frequencies.

An added mass lowers the frequencies the more, the lighter the frame: lambda = phi' K phi / phi' (M + A) phi. So
configurations with different added mass have a total of their own: that of the shear frame nearest to all of them
together, its scale free.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.optimize import least_squares

from cvxshear.measurement.experiment import Experiment
from cvxshear.measurement.reading import Reading
from cvxshear.model.shear import mass_matrix, modes, stiffness_matrix
from cvxshear.screening.finding import Finding
from cvxshear.screening.shear_fit import MASS_SPREAD, STIFFNESS_SPREAD, WIDEST, shape_residual
from cvxshear.util.quantities import quantity
from cvxshear.util.typing import Floats

SIGNIFICANT = 4.0
"""Standard deviations between the logarithms of the two totals."""

LEAST = 0.3
"""Of the logarithm: a smaller contradiction is not worth a word."""

POOREST = 0.6
"""Standard deviation of the logarithm of a total that tells nothing."""

UNIT = 0.5
"""Of the logarithm: so near must the ratio be to 1000, or its inverse, to look like a unit."""

TALLEST = 24
"""Stories up to which the frame is fitted."""


def total_mass(experiment: Experiment) -> Iterator[Finding]:
    """The declared total against that of the configurations, and a total that nobody gave."""
    if experiment.frame.total_mass_placeholder:
        said = f"total_mass = {experiment.frame.total_mass:g} stands for one that nobody gave: masses and stiffnesses "
        change = "write total_mass in kg, and take total_mass_placeholder out"
        yield Finding("total_mass", None, f"{said}are relative to it", change, refuses=False)
        return
    declared = experiment.frame.known_total
    different = {tuple(each.added_mass) for each in experiment.configurations}
    if declared is None or len(different) < 2 or experiment.stories > TALLEST:
        return
    total, std = implied_total(experiment)
    off = float(np.log(declared / total))
    if std > POOREST or abs(off) < max(LEAST, SIGNIFICANT * std):
        return
    said = (
        f"the added masses changed the frequencies as they would those of a frame of {quantity(total, 'kg', 3)} "
        f"(give or take {100 * std:.0f} %), and {quantity(declared, 'kg', 6)} are declared"
    )
    unit = next((unit for unit, factor in (("g", 1e3), ("t", 1e-3)) if abs(off - np.log(factor)) < UNIT), None)
    if unit is not None:
        change = "write total_mass (or floor_masses) in kg"
        yield Finding("masses", None, f"{said}: it looks like {unit}", change, refuses=False)
        return
    change = "check total_mass (or floor_masses, without the added mass) and each added_mass"
    yield Finding("total_mass", None, said, change, refuses=False)


def implied_total(experiment: Experiment) -> tuple[float, float]:
    """The total mass without added mass, kg, that the configurations imply, and the std of its logarithm.

    Parameters
    ----------
    experiment : Experiment
        Of two configurations at least with different added mass.
    """
    N = experiment.stories
    readings = [(Reading.of(each), each.added_mass) for each in experiment.configurations]
    heaviest = max(float(added.sum()) for _, added in readings) / N
    start = np.concatenate([np.full(N, np.log(heaviest)), np.zeros(N)])
    first, added = readings[0]
    off = first.log_frequencies - np.log(_frequencies(start, added)[first.modes])
    start[N:] += 2 * np.mean(off)

    def theta(x: Floats) -> Floats:
        return start + np.clip(x, -WIDEST, WIDEST)

    def residual(x: Floats) -> Floats:
        return _residual(theta(x), readings)

    found = least_squares(residual, np.zeros(2 * N), method="lm")
    share = np.exp(theta(found.x)[:N])
    slope = np.asarray(found.jac)
    covariance = np.linalg.pinv(slope.T @ slope)
    by_masses = share / share.sum()
    freedom = max(len(found.fun) - 2 * N, 1)
    scatter = max(1.0, 2 * float(found.cost) / freedom)
    return float(share.sum()), float(np.sqrt(scatter * by_masses @ covariance[:N, :N] @ by_masses))


def _frequencies(theta: Floats, added: Floats) -> Floats:
    mass, stiffness = np.split(np.exp(theta), 2)
    return modes(mass_matrix(mass + added), stiffness_matrix(stiffness)).frequencies


def _residual(theta: Floats, readings: list[tuple[Reading, Floats]]) -> Floats:
    """Frequencies and shapes of all configurations, and how far floors and stories are from each other."""
    mass, stiffness = np.split(np.exp(theta), 2)
    log_mass, log_stiffness = np.split(theta, 2)
    parts = [
        (log_mass - log_mass.mean()) / MASS_SPREAD,
        (log_stiffness - log_stiffness.mean()) / STIFFNESS_SPREAD,
    ]
    for reading, added in readings:
        found = modes(mass_matrix(mass + added), stiffness_matrix(stiffness))
        parts.append((np.log(found.frequencies[reading.modes]) - reading.log_frequencies) / reading.frequency_std)
        parts.append(shape_residual(reading, found, reading.weights).ravel())
    return np.concatenate(parts)
