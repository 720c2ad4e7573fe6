"""Where the efficient estimator starts.

**Story equations**, linear in masses and stiffnesses. The inertia forces of a mode above story i are carried by it,

    k_i (phi_i - phi_(i-1)) - lambda sum over l >= i of m_l phi_l = lambda sum over l >= i of a_l phi_l,

with a the added mass. Every mode of every configuration gives N such rows for the 2N unknowns. A row is as uncertain
as the shape's error makes its two sides: it weighs 1 / (sqrt(2) k_i + lambda |m + a| above), the masses and
stiffnesses those found before. So a stiff story, whose drift in the low modes is nothing but error, is found from the
modes that move it. Floors without a sensor are filled in from the modes of the model found so far.

**Smooth frames**, where no other start is near the data. A tall frame has many local minima: a high mode of the model
with its nodes half a wave off fits worse on the way to where it fits. The lowest modes have hardly any, and they see
masses and stiffnesses as smooth functions of the height. So the logarithms of both are polynomials in the height,

    theta = theta_0 o exp(B c),        B Legendre polynomials up to a degree,

fitted to the first mode, then to twice as many with a degree more, and so on up to all; every stage starts where the
last one ended. What is not smooth is left to Gauss-Newton, which then starts in the right valley.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from cvxshear import backends
from cvxshear.fit.domain import Domain, spread
from cvxshear.fit.gauss_newton import Accuracy, gauss_newton
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.optimality import PlainResiduals
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model.shear import Modes, mass_matrix, modes, stiffness_matrix, transformation
from cvxshear.priors import Constraints
from cvxshear.programs import LeastSquares
from cvxshear.programs.statements import NamedConstraints, constrained, statements
from cvxshear.util.errors import CvxshearError, InputError, NoModesError, NoSolutionError
from cvxshear.util.typing import Floats

START_PASSES = 6
"""Times that the story equations are weighed, missing entries filled in, and solved: with stiffnesses that differ by
1e6 the first pass has them wrong by a factor of thirty, the third to the noise."""

SMALLEST_START = 0.05
POSITIVE = 1e-9
"""Start of a mass or stiffness that the equations find not positive, and the least that counts as positive, as parts
of their mean: a start at zero is none."""

TAPERS = (0.2, 0.4, 0.6, 0.8)
"""Parts of the bottom story's stiffness by which the top story's is smaller."""

FAR_OFF = 100.0
"""Chi-square a datum beyond which a starting point is not near the data: errors of ten standard deviations."""

MOST_DEGREE = 8
"""Largest degree of the polynomials: with it a profile has a bend every few stories of a tall frame."""

MOST_SMOOTH_STEPS = 20
SMOOTH_STEP = 1e-2
"""Steps of a stage at most, and the change of a residual that counts as none: the next stage starts from here."""

COEFFICIENT_STD = 1.0 / 3.0
"""Standard deviation of each coefficient about zero: what these data do not determine stays uniform."""

LARGEST_CHANGE = 3.0
"""Bound of |B c| in a stage, so that no trial overflows: factors from 1/20 to 20."""


def starts(experiment: Experiment) -> list[Floats]:
    """List the starting points theta, each of shape (2N,), masses and stiffnesses positive.

    Design values of both, those that priors suggest, where there are any; the story equations; and frames of equal
    masses, of uniform stiffness and of the stiffness that falls with height as the ratios of the frequencies say.
    """
    even = uniform(experiment)
    points = []
    theta = even
    for number in range(START_PASSES):
        try:
            theta = _from_story_equations(experiment, theta, weighed=number > 0)
        except CvxshearError:
            break
        points.append(theta)
    return [*_nominal(experiment), *points[-1:], even, _tapered(experiment)]


def _tapered(experiment: Experiment) -> Floats:
    """Find the frame of `uniform` whose taper suits the frequencies best."""
    return min((uniform(experiment, taper) for taper in TAPERS), key=lambda theta: _frequency_misfit(experiment, theta))


def _frequency_misfit(experiment: Experiment, theta: Floats) -> float:
    """Sum of the squared errors of the logarithms of the frequencies."""
    n = experiment.stories
    return sum(
        float(np.sum(_log_eigenvalue_ratios(each, theta[:n], theta[n:]) ** 2)) for each in experiment.configurations
    )


def _log_eigenvalue_ratios(configuration: Configuration, mass: Floats, stiffness: Floats) -> Floats:
    """log(measured / modelled) of the eigenvalues."""
    found = modes(mass_matrix(mass + configuration.added_mass), stiffness_matrix(stiffness))
    measured = (2 * np.pi * configuration.frequencies) ** 2
    return np.log(measured / found.eigenvalues[configuration.modes - 1])


def _nominal(experiment: Experiment) -> list[Floats]:
    """Return the design values of masses and stiffnesses, where both are declared, at the right mean frequency."""
    values = {}
    for prior in experiment.priors:
        suggested = prior.suggested(experiment.stories)
        if suggested is not None and not np.any(np.isnan(suggested)):
            values[prior.quantity] = suggested
    if len(values) < 2:
        return []
    mass, stiffness = values["floor_mass"], values["story_stiffness"]
    known = experiment.frame.known_total
    if known is not None:
        mass = mass * known / mass.sum()
    return [np.concatenate([mass, stiffness * _frequency_factor(experiment, mass, stiffness)])]


def _frequency_factor(experiment: Experiment, mass: Floats, stiffness: Floats) -> float:
    """By how much the stiffnesses must be multiplied for the mean logarithm of the frequencies to be right."""
    ratios = [np.mean(_log_eigenvalue_ratios(each, mass, stiffness)) for each in experiment.configurations]
    return float(np.exp(np.mean(ratios)))


def uniform(experiment: Experiment, taper: float = 0.0) -> Floats:
    """Build a frame of equal masses, stiffnesses falling by `taper` to the top, at the right first frequency."""
    n = experiment.stories
    frame = experiment.frame
    shape = 1.0 - taper * np.arange(n) / max(n - 1, 1)
    known = frame.known_total
    mass = np.full(n, (known if known is not None else _guessed_total(experiment)) / n)
    if frame.floor_masses is not None:
        mass = frame.floor_masses.copy()
    for prior in experiment.priors:
        suggested = prior.suggested(n)
        if prior.quantity == "floor_mass" and prior.fixes_scale and known is None and suggested is not None:
            mass = np.where(np.isnan(suggested), np.nanmean(suggested), suggested)
    return np.concatenate([mass, shape * _frequency_factor(experiment, mass, shape)])


def _guessed_total(experiment: Experiment) -> float:
    """Return a total mass where none is declared: that of the scaled shapes, else the added mass itself."""
    for each in experiment.configurations:
        if each.mass_normalized and each.measured.any():
            known = each.mode_shapes[each.measured.any(axis=1)]
            return float(experiment.stories / np.mean(np.nanmax(known**2, axis=1)))
    return float(np.max([each.added_mass.sum() for each in experiment.configurations])) or 1.0


def _from_story_equations(experiment: Experiment, theta: Floats, *, weighed: bool) -> Floats:
    """Masses and stiffnesses that meet the story equations best, shapes filled in by the model at theta."""
    n = experiment.stories
    mass, stiffness = theta[:n], theta[n:]
    shapes, eigenvalues, added = [], [], []
    for each in experiment.configurations:
        model = modes(mass_matrix(mass + each.added_mass), stiffness_matrix(stiffness))
        shapes += [filled(each, j, model) for j in range(len(each.frequencies))]
        eigenvalues.append((2 * np.pi * each.frequencies) ** 2)
        added += [each.added_mass] * len(each.frequencies)
    on_mass = statements(experiment.priors, "floor_mass", n, experiment.frame)
    on_stiffness = statements(experiment.priors, "story_stiffness", n)
    exact = spread(on_mass, on_stiffness, n, 2 * n)
    return solved_story_equations(
        np.array(shapes), np.concatenate(eigenvalues), np.array(added), theta, exact, weighed=weighed
    )


def solved_story_equations(
    shapes: Floats,
    eigenvalues: Floats,
    added: Floats,
    theta: Floats,
    exact: Sequence[NamedConstraints],
    *,
    weighed: bool,
) -> Floats:
    """Masses and stiffnesses that meet the story equations best, by one least-squares program.

    Parameters
    ----------
    shapes : ndarray, shape (r, N)
        Mode shapes at every floor, a row a mode.
    eigenvalues : ndarray, shape (r,)
        Squared circular frequencies, 1/s2.
    added : ndarray, shape (r, N)
        Added mass of each mode's test, kg.
    theta : ndarray, shape (2N,)
        Masses (kg) and stiffnesses (N/m) that the weights are made of.
    exact : sequence of NamedConstraints
    weighed : bool
        Whether the stiffnesses of theta count in the weights.

    Returns
    -------
    ndarray, shape (2N,)
        All positive.

    Raises
    ------
    InputError
        Where the equations have no solution of positive mean.
    """
    n = shapes.shape[1]
    rows, sides = [], []
    for phi, lam, more in zip(shapes, eigenvalues, added, strict=True):
        above = np.triu(np.broadcast_to(phi, (n, n)))
        drifts = np.diag(transformation(n).T @ phi)
        inertia = np.sqrt(np.cumsum((theta[:n] + more)[::-1] ** 2)[::-1])
        weight = 1.0 / (np.linalg.norm(phi) * (lam * inertia + (np.sqrt(2.0) * theta[n:] if weighed else 0.0)))
        rows.append(weight[:, None] * np.hstack([-lam * above, drifts]))
        sides.append(weight * lam * (above @ more))
    ridge = 1e-6 / theta
    program = LeastSquares(
        R=np.concatenate([*rows, np.diag(ridge)]), s=np.concatenate([*sides, ridge * theta]),
    )  # fmt: skip
    found = np.split(backends.get("auto").solve(constrained(program, exact, np.zeros(2 * n))).x, 2)
    if any(values.mean() <= 0 for values in found):
        raise InputError("the story equations have no solution of positive masses and stiffnesses")
    return np.concatenate(
        [np.where(values > POSITIVE * values.mean(), values, SMALLEST_START * values.mean()) for values in found]
    )


def filled(configuration: Configuration, j: int, model: Modes) -> Floats:
    """Mode j at every floor, shape (N,): what was measured, and between it what the model's modes make of it.

    The measured entries are expanded in the model's modes nearest to mode j, half as many as there are entries.
    """
    n = len(model.eigenvalues)
    known = configuration.measured[j]
    floors = configuration.measured_floors[known] - 1
    own = int(configuration.modes[j]) - 1
    if not len(floors):
        alone: Floats = model.shapes[own]
        return alone
    count = max(1, len(floors) // 2)
    near = np.argsort(np.abs(np.arange(n) - own), kind="stable")[:count]
    values = configuration.mode_shapes[j, known]
    share = np.linalg.lstsq(model.shapes[np.ix_(near, floors)].T, values, rcond=None)[0]
    phi: Floats = share @ model.shapes[near]
    phi[floors] = values
    return phi


@dataclass(frozen=True, eq=False)
class _SmoothFrames:
    """The misfit of frames of smooth profiles, as a problem in their coefficients.

    Parameters
    ----------
    misfit : Misfit
    base : ndarray, shape (2N,)
        theta_0.
    mass, stiffness : ndarray, shapes (N, a) and (N, b)
        Polynomials of the logarithms; `mass` of no columns where the masses are known.
    total : float or None
        What the masses add up to, kg, if known.
    """

    misfit: Misfit
    base: Floats
    mass: Floats
    stiffness: Floats
    total: float | None

    def at(self, c: Floats) -> tuple[Floats, Floats]:
        """theta, and the derivative of its logarithm by c."""
        n = len(self.mass)
        theta = self.base * np.exp(block_diag(self.mass, self.stiffness) @ c)
        mass = self.mass
        if self.total is not None and mass.shape[1]:
            theta[:n] *= self.total / theta[:n].sum()
            mass = mass - theta[:n] @ mass / self.total
        return theta, block_diag(mass, self.stiffness)

    def evaluate(self, c: Floats, /, *, derivatives: bool = True) -> PlainResiduals:
        """Residuals of the frame and of the coefficients about zero."""
        theta, slope = self.at(c)
        found = self.misfit.evaluate(theta, derivatives=derivatives)
        r = np.concatenate([found.r, c / COEFFICIENT_STD])
        J = np.concatenate([(found.J * theta) @ slope, np.eye(len(c)) / COEFFICIENT_STD])
        return PlainResiduals(r, J if derivatives else np.zeros((0, len(c))))

    def best(self) -> Floats:
        """Return the frame of the smallest misfit, shape (2N,)."""
        profiles = block_diag(self.mass, self.stiffness)
        size = profiles.shape[1]
        within = Constraints(G=np.concatenate([profiles, -profiles]), h=np.full(2 * len(profiles), LARGEST_CHANGE))
        domain = Domain(
            (NamedConstraints("smooth profiles", within),), np.full(size, COEFFICIENT_STD), np.full(size, np.inf)
        )
        fit = gauss_newton(self, np.zeros(size), domain, backends.get("auto"), Accuracy(SMOOTH_STEP, MOST_SMOOTH_STEPS))
        return self.at(fit.theta)[0]


def smooth_start(experiment: Experiment, base: Floats) -> Floats:
    """Find the smooth frame that suits all modes, reached from the lowest.

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
        theta = _smooth_frames(Misfit(experiment, (), above), theta, degree).best()
    return theta


def _smooth_frames(misfit: Misfit, base: Floats, degree: int) -> _SmoothFrames:
    """Profiles about a frame: that of the masses without a constant where their total is known."""
    n, frame = misfit.experiment.stories, misfit.experiment.frame
    polynomials = np.asarray(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), degree), dtype=float)
    # A known total takes the constant of the masses, known masses all of their profile.
    first = degree + 1 if frame.floor_masses is not None else int(frame.known_total is not None)
    return _SmoothFrames(misfit, base, polynomials[:, first:], polynomials, frame.known_total)


def nearest_start(misfit: Misfit) -> Floats:
    """Find the starting point nearest to the data, the effects' parameters where they start.

    Parameters
    ----------
    misfit : Misfit

    Returns
    -------
    ndarray, shape (P,)

    Raises
    ------
    NoModesError
        Where no starting point has modes.
    """
    own = np.array([value for placed in misfit.effects for value in placed.start])
    for start in nearest_first(misfit, own):
        return np.concatenate([start, own])
    raise NoModesError("no starting point has modes")


def nearest_first(misfit: Misfit, own: Floats) -> list[Floats]:
    """Sort the starting points with modes, the nearest to the data first; a smooth frame leads where none is near.

    Parameters
    ----------
    misfit : Misfit
    own : ndarray, shape (p,)
        Starting values of the effects' parameters.

    Returns
    -------
    list of ndarray, shape (2N,)
    """

    def chi2(start: Floats) -> float:
        try:
            return misfit.evaluate(np.concatenate([start, own]), derivatives=False).chi2
        except NoModesError:
            return float("inf")

    measured = [(chi2(start), start) for start in starts(misfit.experiment)]
    usable = sorted((item for item in measured if np.isfinite(item[0])), key=lambda item: item[0])
    ordered = [start for _, start in usable]
    if usable and usable[0][0] <= FAR_OFF * misfit.count(np.concatenate([ordered[0], own])):
        return ordered
    try:
        smooth = smooth_start(misfit.experiment, uniform(misfit.experiment))
    except NoSolutionError:
        return ordered
    return [smooth, *ordered] if np.isfinite(chi2(smooth)) else ordered
