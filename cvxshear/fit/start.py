"""Starting points of the efficient estimator.

**Story equations** are linear in masses and stiffnesses. Story i carries the inertia forces of a mode above it,

    k_i (phi_i - phi_(i-1)) - lambda sum over l >= i of m_l phi_l = lambda sum over l >= i of a_l phi_l,

with the added mass a. Every mode of every configuration gives N such rows for the 2N unknowns. The error of the shape
gives each row the weight 1 / (sqrt(2) k_i + lambda |m + a| above), with the masses and stiffnesses of the previous
pass. So the modes that deform a stiff story determine it; its drift in the low modes is only error. The modes
of the current model fill in floors without a sensor.

**Smooth frames** are used if no other start is near the data. A tall frame has many local minima, since a high mode of
the model with shifted nodes fits worse on the way to its correct place. The lowest modes have few local minima, and
they depend on masses and stiffnesses as smooth functions of the height. So the logarithms of both are polynomials in
the height,

    theta = theta_0 o exp(B c),        B Legendre polynomials up to a degree,

fitted to the first mode, then to twice the number of modes with one more degree, up to all modes. Every stage starts
at the result of the previous one. Gauss-Newton then starts near the right minimum.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from cvxshear import backends
from cvxshear.fit.domain import Domain, domain_of, spread
from cvxshear.fit.gauss_newton import Accuracy, gauss_newton
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.optimality import PlainResiduals
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model import Modes, mass_matrix, modes, stiffness_matrix, transformation
from cvxshear.priors import Constraints
from cvxshear.programs import LeastSquares, turning
from cvxshear.programs.constraints import NamedConstraints, constrained, statements
from cvxshear.util.errors import CvxshearError, InputError, NoModesError, NoSolutionError
from cvxshear.util.typing import Floats

#: Number of passes over the story equations. With stiffnesses that differ by 1e6, the first pass is wrong by a factor
#: of thirty, the third to the noise.
START_PASSES = 6

#: The same of floors that turn: the first pass has the weights of an even frame.
TURNING_PASSES = 2

#: Relative deviation of an inertia from that of an even floor, at the start.
INERTIA_STD = 0.05

#: Start of a mass or stiffness for which the equations give a value that is not positive, relative to the mean.
SMALLEST_START = 0.05

#: Relative decreases of the stiffness from the bottom to the top story that are tried.
TAPERS = (0.2, 0.4, 0.6, 0.8)

#: Largest chi-square per datum of a starting point near the data: errors of ten standard deviations.
FAR_OFF = 100.0


@dataclass(frozen=True)
class SmoothProfiles:
    """Options of the smooth frames.

    Parameters
    ----------
    degree : int
        Largest degree of the polynomials: a bend every few stories of a tall frame.
    coefficient_std : float
        Prior standard deviation of each coefficient, so that an undetermined profile stays uniform.
    largest_change : float
        Largest |B c| in a stage, so that no trial overflows: factors from 1/20 to 20.
    step, most_steps
        `Accuracy` of each stage.
    """

    degree: int = 8
    coefficient_std: float = 1.0 / 3.0
    largest_change: float = 3.0
    step: float = 1e-2
    most_steps: int = 20


SMOOTH = SmoothProfiles()


def starts(experiment: Experiment) -> list[Floats]:
    """List the starting points theta, each of shape (2N,), masses and stiffnesses positive.

    Of floors that turn they are the solution of their story equations, and even floors and stories. Else they are the
    design values of the priors, if these suggest both; the solution of the story equations; and frames of equal masses
    with uniform stiffness and with the taper that fits the ratios of the frequencies best.
    """
    if experiment.frame.turns:
        return _turning_starts(experiment)
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


def _turning_starts(experiment: Experiment) -> list[Floats]:
    """Solve the story equations of floors that turn from even floors and stories; list the solution and the latter.

    Raises
    ------
    UnsuitableError
        If no configuration has every reading.
    """
    tests = turning.turning_tests(experiment)
    masses = tests[0].even_masses
    theta = even = np.concatenate([masses, tests[0].even_stiffnesses(masses)])
    mass, stiffness = (float(np.mean(each)) for each in experiment.levels(even))
    domain = domain_of(experiment, (), even)
    # Rows of decoupled rotations are zero for no inertia at all.
    inertia = np.zeros((experiment.stories, len(even)))
    inertia[:, experiment.of_floors] = turning.plan_rows(experiment, INERTIA_STD)
    ridge = 1e-6 / experiment.units(mass, stiffness)
    for _ in range(TURNING_PASSES):
        rows, sides = zip(*(test.story_equations(theta) for test in tests), strict=True)
        program = LeastSquares(
            np.concatenate([*rows, inertia, np.diag(ridge)]),
            np.concatenate([*sides, np.zeros(len(inertia)), ridge * even]),
        )
        theta = backends.get("auto").solve(domain.around(program, np.zeros(len(even)))).x
    return [theta, even]


def _tapered(experiment: Experiment) -> Floats:
    """Find the frame of `uniform` with the taper that fits the frequencies best."""
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
    """Return the design values of masses and stiffnesses, if both are declared, scaled to the mean frequency."""
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
    """Compute the factor on the stiffnesses that makes the mean logarithm of the frequencies right."""
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
    """Guess an undeclared total mass, from the mass-normalized shapes or else as the added mass."""
    for each in experiment.configurations:
        if each.mass_normalized and each.measured.any():
            known = each.mode_shapes[each.measured.any(axis=1)]
            return float(experiment.stories / np.mean(np.nanmax(known**2, axis=1)))
    return float(np.max([each.added_mass.sum() for each in experiment.configurations])) or 1.0


def _from_story_equations(experiment: Experiment, theta: Floats, *, weighed: bool) -> Floats:
    """Solve the story equations, with the shapes filled in by the model at theta."""
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
    """Solve the story equations for masses and stiffnesses, by one least-squares program.

    Parameters
    ----------
    shapes : ndarray, shape (r, N)
        Mode shapes at every floor, a row a mode.
    eigenvalues : ndarray, shape (r,)
        Squared circular frequencies, 1/s2.
    added : ndarray, shape (r, N)
        Added mass of each mode's test, kg.
    theta : ndarray, shape (2N,)
        Masses (kg) and stiffnesses (N/m) for the weights.
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
        If the solution has no positive mean.
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
        [np.where(values > 1e-9 * values.mean(), values, SMALLEST_START * values.mean()) for values in found]
    )


def filled(configuration: Configuration, j: int, model: Modes) -> Floats:
    """Return mode j at every floor, shape (N,): the measured entries, and between them an expansion in model modes.

    The measured entries are expanded in the modes nearest to mode j; their number is half the number of entries.
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
    """The misfit of frames with smooth profiles, as a problem in the coefficients.

    Parameters
    ----------
    misfit : Misfit
    base : ndarray, shape (2N,)
        theta_0.
    mass, stiffness : ndarray, shapes (N, a) and (N, b)
        Polynomials of the logarithms; `mass` has no columns if the masses are known.
    total : float or None
        Known total mass, kg.
    """

    misfit: Misfit
    base: Floats
    mass: Floats
    stiffness: Floats
    total: float | None

    def at(self, c: Floats) -> tuple[Floats, Floats]:
        """Return theta and the derivative of its logarithm by c."""
        n = len(self.mass)
        theta = self.base * np.exp(block_diag(self.mass, self.stiffness) @ c)
        mass = self.mass
        if self.total is not None and mass.shape[1]:
            theta[:n] *= self.total / theta[:n].sum()
            mass = mass - theta[:n] @ mass / self.total
        return theta, block_diag(mass, self.stiffness)

    def evaluate(self, c: Floats, /, *, derivatives: bool = True) -> PlainResiduals:
        """Compute the residuals of the frame and of the coefficients about zero."""
        theta, slope = self.at(c)
        found = self.misfit.evaluate(theta, derivatives=derivatives)
        r = np.concatenate([found.r, c / SMOOTH.coefficient_std])
        J = np.concatenate([(found.J * theta) @ slope, np.eye(len(c)) / SMOOTH.coefficient_std])
        return PlainResiduals(r, J if derivatives else np.zeros((0, len(c))))

    def best(self) -> Floats:
        """Return the frame with the smallest misfit, shape (2N,)."""
        profiles = block_diag(self.mass, self.stiffness)
        size = profiles.shape[1]
        limit = np.full(2 * len(profiles), SMOOTH.largest_change)
        within = NamedConstraints("smooth profiles", Constraints(G=np.concatenate([profiles, -profiles]), h=limit))
        domain = Domain((within,), np.full(size, SMOOTH.coefficient_std), np.full(size, np.inf))
        accuracy = Accuracy(SMOOTH.step, SMOOTH.most_steps)
        fit = gauss_newton(self, np.zeros(size), domain, backends.get("auto"), accuracy)
        return self.at(fit.theta)[0]


def smooth_start(experiment: Experiment, base: Floats) -> Floats:
    """Find the smooth frame that fits all modes, in stages from the lowest.

    Parameters
    ----------
    experiment : Experiment
    base : ndarray, shape (2N,)
        Masses and stiffnesses of a frame with about the right first frequency.

    Returns
    -------
    ndarray, shape (2N,)
    """
    modes = max(int(each.modes.max()) for each in experiment.configurations)
    theta, count, degree = base, 0, 0
    while count < modes:
        count, degree = min(max(1, 2 * count), modes), min(degree + 1, SMOOTH.degree)
        above = {each.name: each.modes > count for each in experiment.configurations}
        theta = smooth_frames(Misfit(experiment, (), above), theta, degree).best()
    return theta


def smooth_frames(misfit: Misfit, base: Floats, degree: int) -> _SmoothFrames:
    """Write profiles about a frame; the masses' has no constant if their total is known."""
    n, frame = misfit.experiment.stories, misfit.experiment.frame
    polynomials = np.asarray(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), degree), dtype=float)
    # A known total fixes the constant of the masses, known masses fix their whole profile.
    first = degree + 1 if frame.floor_masses is not None else int(frame.known_total is not None)
    return _SmoothFrames(misfit, base, polynomials[:, first:], polynomials, frame.known_total)


def nearest_start(misfit: Misfit) -> Floats:
    """Find the starting point nearest to the data, with the effects' parameters at their starts.

    Parameters
    ----------
    misfit : Misfit

    Returns
    -------
    ndarray, shape (P,)

    Raises
    ------
    NoModesError
        If no starting point has modes.
    """
    own = np.array([value for placed in misfit.effects for value in placed.start])
    for start in nearest_first(misfit, own):
        return np.concatenate([start, own])
    raise NoModesError("no starting point has modes")


def nearest_first(misfit: Misfit, own: Floats) -> list[Floats]:
    """Sort the starting points with modes by their misfit; if all are far from the data, a smooth frame comes first.

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
    if misfit.experiment.frame.turns:
        return [start for at, start in measured if np.isfinite(at)]
    ordered = [start for _, start in usable]
    if usable and usable[0][0] <= FAR_OFF * misfit.count(np.concatenate([ordered[0], own])):
        return ordered
    try:
        smooth = smooth_start(misfit.experiment, uniform(misfit.experiment))
    except NoSolutionError:
        return ordered
    return [smooth, *ordered] if np.isfinite(chi2(smooth)) else ordered
