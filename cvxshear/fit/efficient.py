"""The efficient estimator: one fit to all configurations together, weighted by their noise."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.data import NoiseFactors
from cvxshear.effects import LocatedEffect, Scale, compose
from cvxshear.effects.composition import MEMORY, slices
from cvxshear.fit import results
from cvxshear.fit.domain import MASS_WIDTH, Domain, Uncertainty, domain_of, null_space, uncertainty
from cvxshear.fit.gauss_newton import FLAT, FULL, HOPELESS, LEAST_DAMPING, ROUGH, Accuracy, Fit, gauss_newton
from cvxshear.fit.misfit import Evaluation, Misfit, NoiseAtFit, NoiseEstimate
from cvxshear.fit.optimality import local_conditions
from cvxshear.fit.start import nearest_first
from cvxshear.fit.turning_floors import TurningFrame, general_parameters, one_shot_open, reported
from cvxshear.measurement.experiment import MOTIONS, Experiment
from cvxshear.programs import ActiveConstraint, LeastSquares
from cvxshear.programs.constraints import refuse_infeasible
from cvxshear.util import decorators, errors
from cvxshear.util.typing import Floats

#: Largest probability of an improbable residual or noise.
RESIDUAL_LEVEL = 0.01


#: Smallest deviation of a direction that the data of floors that turn leave open, relative to the size of its
#: parameters. In noise without eccentricity, the common factor of the inertias has 1.3 to 2.1; in 28 eccentric frames
#: with noise of 1 % no direction had more than 0.06.
OPEN_STD = 0.5


#: Largest change of the logarithm of a converged standard deviation: the evidence, which is stationary, changes by less
#: than 0.01.
SAME_NOISE = 0.05


@dataclass(frozen=True, eq=False)
class Estimate:
    """A joint fit with its uncertainty.

    Parameters
    ----------
    misfit : Misfit
        Misfit with the experiment, the effects and the noise of the fit.
    domain : Domain
    fit : Fit
    uncertainty : Uncertainty
        Uncertainty from the data, the priors and the effects' priors.
    noise : NoiseEstimate
        Estimate of the undeclared noise.
    """

    misfit: Misfit
    domain: Domain
    fit: Fit[Evaluation]
    uncertainty: Uncertainty
    noise: NoiseEstimate = field(default_factory=NoiseEstimate)

    @property
    def experiment(self) -> Experiment:
        """The experiment of the fit."""
        return self.misfit.experiment

    @property
    def effects(self) -> tuple[LocatedEffect, ...]:
        """The effects in the model."""
        return self.misfit.effects

    @property
    def theta(self) -> Floats:
        """All parameters, shape (P,)."""
        return self.fit.theta

    @property
    def chi2(self) -> float:
        """Sum of squared residuals of data and priors, in units of the declared or estimated noise."""
        return self.fit.at.chi2

    @decorators.cached_property
    def dof(self) -> int:
        """Number of data less number of parameters that they determine.

        Of an effect of one common size the parameters count as far as the data determine them: p - trace(C) / s^2, C
        their covariance and s that size (MacKay 1992).
        """
        free = float(self.uncertainty.free)
        for placed in self.effects:
            if placed.effect.common_size and placed.effect.parameters and not placed.fixed:
                size = self.misfit.expectation.of(placed) * self.misfit.noise.of(placed.label)
                variance = np.diag(self.uncertainty.covariance())[self.own(placed)]
                free -= float(np.sum(np.minimum(variance / size**2, 1.0)))
        return self.misfit.count(self.theta) - round(free)

    @property
    def std(self) -> Floats:
        """Standard deviations of all parameters, shape (P,); nan where undetermined."""
        return self.uncertainty.std()

    @property
    def correlation(self) -> Floats:
        """Correlations of all parameters, shape (P, P)."""
        return self.uncertainty.correlation()

    @property
    def improbable(self) -> bool:
        """Whether the residual is too large for the noise: less probable than `RESIDUAL_LEVEL`.

        Without a remaining degree of freedom, bounds may limit the model: the residual is then compared with one.
        """
        if self.dof <= 0:
            return not self.misfit.open_noises and self.fit.at.chi2 > float(special.chdtri(1, RESIDUAL_LEVEL))
        return self.p_value is not None and self.p_value < RESIDUAL_LEVEL

    @property
    def p_value(self) -> float | None:
        """Probability of a residual as large under the noise, declared or estimated; None without degrees of freedom.

        An estimated noise counts up to the largest that instruments have (`NoiseKind.largest`).
        """
        if self.dof <= 0:
            return None
        at, noise = self.fit.at, self.misfit.noise
        squares = at.r[: at.measured] ** 2
        for place, item in enumerate(self.misfit.unknown):
            if (kind := self.misfit.noises.get(item.key)) is not None:
                own = at.unknown[: at.measured] == place
                squares[own] *= max(1.0, noise.of(item.key) * kind.default / kind.largest) ** 2
        return float(special.chdtrc(self.dof, squares.sum()))

    @decorators.cached_property
    def quality(self) -> results.Quality:
        """Errors and chi-square."""
        declared = not self.misfit.open_noises
        return results.quality(self.misfit.data, self.fit.at.models, self.chi2, self.dof, declared=declared)

    @property
    def predictions(self) -> tuple[results.Prediction, ...]:
        """All modes at all floors, one prediction a configuration."""
        return results.predictions(self.fit.at.models)

    @property
    def scale(self) -> Scale:
        """Mean floor mass and story stiffness, and the heights."""
        mass, stiffness = self.experiment.levels(self.theta)
        return Scale.of(self.experiment, mass.mean(), stiffness.mean())

    @property
    def frame(self) -> results.IdentifiedFrame:
        """The frame, nan where the data do not determine a value."""
        return self._frame(np.where(self.uncertainty.determined, self.theta, np.nan), self.std)

    def own(self, placed: LocatedEffect) -> slice:
        """Return the places of an effect's parameters in theta."""
        return next(at for item, at in slices(self.effects, self.experiment.parameters) if item is placed)

    @property
    def expected_frame(self) -> results.IdentifiedFrame:
        """The frame with its own prior, so that every value is determined."""
        if self.experiment.frame.turns:
            return self._turning_frame(self.free_directions, np.zeros((len(self.theta), 0)))
        names = parameter_names(self.experiment, self.effects)
        return self._frame(self.theta, uncertainty(self.fit.at.triangle[0], self.theta, self.domain, names).std())

    def _frame(self, values: Floats, std: Floats) -> results.IdentifiedFrame:
        """Return the frame with its standard deviations, and with what effects put right of declared masses.

        A value on a bound of its own is listed. One in an active constraint on several values, such as a ratio, still
        has a deviation and is not listed.
        """
        n = self.experiment.stories
        if self.experiment.frame.turns:
            left = self.domain.scale[:, None] * left_open(self.misfit, self.theta, self.fit.at)
            return self._turning_frame(self.uncertainty.reach, left)
        names = parameter_names(self.experiment, self.effects)[: 2 * n]
        # A value on a bound has a standard deviation of rounding size.
        none_left = dict(zip(names, std[: 2 * n] <= 1e-9 * np.abs(self.theta[: 2 * n]), strict=True))
        at_bounds = tuple(name for name in names if none_left[name] and name in self.uncertainty.active)
        mass, variance = values[:n], std[:n] ** 2
        for placed, own in slices(self.effects, 2 * n):
            unit = placed.effect.corrects(placed.place, self.theta[:n])
            if unit.any():
                mass, variance = mass + unit @ self.theta[own], variance + unit**2 @ std[own] ** 2
        return results.IdentifiedFrame(mass, values[n : 2 * n], np.sqrt(variance), std[n : 2 * n], at_bounds)

    @property
    def undetermined(self) -> tuple[tuple[str, ...], ...]:
        """For each direction that the data leave open, the values that take part in it."""
        frame = self.frame
        return frame.undetermined if isinstance(frame, TurningFrame) else self.uncertainty.null_directions

    def _turning_frame(self, spread: Floats, left: Floats) -> TurningFrame:
        """Return the frame of floors that turn with the effects of all states; nan along what is left open."""
        tests = self.experiment.configurations
        bare = tests[0].unloaded("the frame itself")
        theta, slopes = general_parameters(compose(self.experiment, bare, self.effects, self.theta))
        seen = [any(np.any(each.sensor_rows[:, place::3]) for each in tests) for place in range(len(MOTIONS))]
        unseen = tuple(name for name, sees in zip(MOTIONS, seen, strict=True) if not sees)
        return reported(self.experiment, theta, slopes @ spread, slopes @ left, unseen)

    @property
    def free_directions(self) -> Floats:
        """Directions that the constraints leave free and anything determines, of unit effect on all residuals."""
        return self.uncertainty.root_of(self.fit.at.triangle[0])

    @property
    def part(self) -> results.SingleIdentification:
        """The estimate in the form that every method returns."""
        return results.SingleIdentification(
            name="",
            iterations=self.fit.steps,
            frame=self.frame,
            fit=self.quality,
            predictions=self.predictions,
            reason=self.fit.reason,
            active=self.active,
        )

    @property
    def active(self) -> tuple[ActiveConstraint, ...]:
        """The exact priors and bounds that hold with equality at the fit, with the price of each in chi-square."""
        here = local_conditions(self.theta, self.fit.at, self.domain, LEAST_DAMPING)
        return results.priced(
            here.program.replace(names=parameter_names(self.experiment, self.effects)).active_at(here.point)
        )


def parameter_names(experiment: Experiment, effects: Sequence[LocatedEffect]) -> tuple[str, ...]:
    """Names of the parameters of a fit, in order."""
    stories, motions = range(1, experiment.stories + 1), experiment.motions
    return (
        *(f"{name} {i}" for i in stories for name in motions.mass_names),
        *(f"{name} {i}" for i in stories for name in motions.stiffness_names),
        *(
            placed.label if len(placed.effect.parameters) == 1 else f"{placed.label} {item.name}"
            for placed in effects
            for item in placed.effect.parameters
        ),
    )


def fitted(
    misfit: Misfit, theta: Floats, backend: Backend, accuracy: Accuracy = FULL, start: Evaluation | None = None
) -> Estimate:
    """Fit from a starting point by Gauss-Newton, and estimate the undeclared noise after every step.

    Parameters
    ----------
    misfit : Misfit
        Its noise is the start of the estimate.
    theta : ndarray, shape (P,)
    backend : Backend
    accuracy : Accuracy, optional
    start : Evaluation, optional
        At theta, if it exists.
    """
    if not misfit.unknown:
        return fitted_with(misfit, theta, backend, accuracy, start)
    one, left = replace(accuracy, most_steps=1), accuracy.most_steps
    estimate = fitted_with(misfit, theta, backend, one, start)
    while (left := left - estimate.fit.steps) > 0:
        noise = _noise_at(estimate)
        if not _settled(estimate, noise):
            misfit = misfit.replaced(noise=NoiseFactors(noise.factors))
            estimate = fitted_with(misfit, estimate.theta, backend, one)
        elif estimate.fit.converged:
            return replace(estimate, noise=noise.estimate())
        else:
            rest = replace(accuracy, most_steps=left)
            estimate = fitted_with(misfit, estimate.theta, backend, rest, estimate.fit.at)
    noise = _noise_at(estimate)
    return replace(estimate, noise=noise.estimate() if _settled(estimate, noise) else noise.unsettled())


def _noise_at(estimate: Estimate) -> NoiseAtFit:
    """Find the most probable undeclared noise in the linear model about a fit."""
    return NoiseAtFit.of(estimate.misfit, estimate.fit.at, estimate.free_directions)


def _settled(estimate: Estimate, noise: NoiseAtFit) -> bool:
    """Whether the most probable noise is the noise of the fit."""
    known = estimate.misfit.noise
    return all(abs(np.log(factor / known.of(key))) < SAME_NOISE for key, factor in noise.factors)


def fitted_with(
    misfit: Misfit, theta: Floats, backend: Backend, accuracy: Accuracy = FULL, start: Evaluation | None = None
) -> Estimate:
    """Fit from a starting point by Gauss-Newton with a fixed noise.

    Parameters
    ----------
    misfit : Misfit
    theta : ndarray, shape (P,)
    backend : Backend
    accuracy : Accuracy, optional
    start : Evaluation, optional
        At theta, if it exists.
    """
    domain = domain_of(misfit.experiment, misfit.effects, theta, misfit.held)
    fit = gauss_newton(misfit, theta, domain, backend, accuracy, start)
    fit = replace(fit, at=fit.at.of_a_result())
    names = parameter_names(misfit.experiment, misfit.effects)
    return Estimate(misfit, domain, fit, uncertainty(fit.at.known_triangle, fit.theta, domain, names))


def efficient(experiment: Experiment, backend: Backend, effects: Sequence[LocatedEffect] = ()) -> Estimate:
    """Fit floor masses, story stiffnesses and effects to all configurations together.

    The starting points are tried in the order of their misfit until a fit is good; the best fit is kept.

    Parameters
    ----------
    experiment : Experiment
    backend : Backend
    effects : sequence of LocatedEffect, optional

    Returns
    -------
    Estimate

    Raises
    ------
    InfeasibleError
        If declared masses and exact priors contradict each other.
    NoModesError
        If the frame has no modes at any starting point.
    NoSolutionError
        If no starting point leads to a fit.
    UnsuitableError
        If the fit would take more than `MEMORY`.
    """
    misfit = Misfit(experiment, effects)
    _refuse_large(misfit)
    refuse_infeasible(experiment)
    own = np.array([value for placed in effects for value in placed.start])
    best: Estimate | None = None
    failure: errors.CvxshearError | None = None
    missed = np.inf
    for start in nearest_first(misfit, own):
        theta = np.concatenate([start, own])
        try:
            # A rough fit shows whether a further start leads to a better one.
            found = _fitted_from(misfit, theta, backend, FULL if best is None else ROUGH)
            if best is not None and _missed(found) < _missed(best):
                found = fitted(found.misfit, found.theta, backend)
        except errors.NoModesError as error:
            # If a frequency is 1e12 times the others, rounding can make the lowest eigenvalue negative.
            failure = failure or error
            continue
        except errors.NoSolutionError as error:
            failure = failure or error
            missed = min(missed, misfit.evaluate(theta, derivatives=False).chi2)
            continue
        if best is None or _missed(found) < _missed(best):
            best = found
        if _missed(best) <= 3.0 * max(best.dof, 1) and not misfit.open_noises:
            break
    if best is None:
        raise failure if failure is not None else errors.NoSolutionError(backend.name, "no starting point has modes")
    if failure is not None and best.misfit.replaced(noise=misfit.noise).evaluate(best.theta).chi2 > missed:
        # The backend failed at a start that fits better than the result: the result is no minimum.
        raise failure
    if backend.name != "auto" and not misfit.open_noises and best.chi2 > HOPELESS * max(best.dof, 1):
        _refuse_local_minimum(best, backend, efficient(experiment, backends.get("auto"), effects))
    return best


def _missed(found: Estimate) -> float:
    """Return chi-square; of floors that turn, with the prior of their masses, which few modes hardly determine."""
    if not found.experiment.frame.turns:
        return found.chi2
    mass, _ = found.experiment.levels(found.theta)
    return found.chi2 + float(np.sum((np.log(mass / mass.mean()) / MASS_WIDTH) ** 2))


def _fitted_from(misfit: Misfit, theta: Floats, backend: Backend, accuracy: Accuracy) -> Estimate:
    """Fit from a starting point; of floors that turn, with the directions held that the data leave open at the fit.

    Nothing else keeps the size of such a direction. Those of the one-shot solution are held first.
    """
    if misfit.experiment.frame.turns and not misfit.experiment.symmetric:
        held = one_shot_open(misfit.experiment) / domain_of(misfit.experiment, (), theta).scale[:, None]
        held = np.linalg.qr(held)[0]
        while held.size:
            found, before = fitted(misfit.holding(held), theta, backend, ROUGH), held
            held, theta = left_open(misfit, found.theta, found.fit.at), found.theta
            if held.shape[1] >= before.shape[1]:
                break
        misfit = misfit.holding(held)
    return fitted(misfit, theta, backend, accuracy)


def left_open(misfit: Misfit, theta: Floats, at: Evaluation) -> Floats:
    """Find the directions of a frame that turns with a deviation of `OPEN_STD` or more.

    Parameters
    ----------
    misfit : Misfit
    theta : ndarray, shape (P,)
    at : Evaluation
        At theta.

    Returns
    -------
    ndarray, shape (P, k)
        Orthonormal in units of `Domain.scale`.
    """
    domain, U = domain_of(misfit.experiment, misfit.effects, theta), at.known_triangle
    exact, _ = domain.tangent(LeastSquares(U, np.zeros(len(U))), theta).equalities
    free = null_space(exact * domain.scale)
    _, values, right = np.linalg.svd(U @ (domain.scale[:, None] * free))
    known = np.concatenate([values, np.zeros(len(right) - len(values))]) > 1.0 / OPEN_STD
    return np.asarray(free @ right[~known].T)


def _refuse_local_minimum(found: Estimate, backend: Backend, reference: Estimate) -> None:
    """Raise if a fit far from the data has a larger misfit than the default backend's fit.

    Raises
    ------
    NoSolutionError
        Since all backends solve every step to a millionth, different minima mean an ill-conditioned problem.
    """
    above = found.fit.at.objective - reference.fit.at.objective
    if above > FLAT * max(1.0, reference.fit.at.objective / max(len(reference.fit.at.r), 1)):
        raise errors.NoSolutionError(
            backend.name,
            f"its fit ended in a local minimum, {above:.3g} above another backend's: too ill-conditioned to tell",
        )


def _refuse_large(misfit: Misfit) -> None:
    """Raise `UnsuitableError`, before anything is allocated, if a fit would need more than `MEMORY`.

    A fit holds about 12 copies of the derivatives of all data by all parameters, and about 25 square matrices in the
    parameters (measured from 100 to 600 stories).
    """
    rows, P = sum(datum.count for datum in misfit.data), misfit.parameters
    needed = 8.0 * (12 * rows * P + 25 * P**2)
    if needed > MEMORY:
        raise errors.UnsuitableError(
            f"a joint fit of {rows:,} data by {P:,} parameters would take about {needed / 1e9:.1f} GB, more than the "
            f"{MEMORY / 1e9:.0f} GB that are allowed; name the method one-shot or two-stage, or leave modes out"
        )
