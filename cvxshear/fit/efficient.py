"""The efficient estimator: one fit over all configurations together, weighted by what the noise is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import special

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.data import Noise
from cvxshear.effects import Placed, Scale
from cvxshear.effects.composition import slices
from cvxshear.effects.state import heights_of
from cvxshear.fit.domain import Domain, domain_of, refuse_contradicting
from cvxshear.fit.gauss_newton import FLAT, FULL, HOPELESS, ROUGH, Accuracy, Fit, gauss_newton
from cvxshear.fit.misfit import Evaluation, Misfit
from cvxshear.fit.noise import NoiseEstimate, estimated_noise
from cvxshear.fit.quality import Quality, quality
from cvxshear.fit.results import IdentifiedFrame, Prediction, SingleIdentification, predictions
from cvxshear.fit.start import nearest_first
from cvxshear.fit.uncertainty import Uncertainty, uncertainty
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.errors import CvxshearError, NoModesError, NoSolutionError, UnsuitableError
from cvxshear.util.typing import Floats

MEMORY = 1e9
"""Bytes that a joint fit may take. It holds the derivatives of all data by all parameters some twelve times over, and
squares in the parameters some 25 times (measured from 100 to 600 stories)."""

MOST_NOISES = 8
"""Times that a fit is made again with another estimate of the standard deviations that nobody declared."""

STEPS_A_NOISE = 4
"""Steps of Gauss-Newton at most before those deviations are estimated anew: a fit followed to the end of a flat valley
under a noise that is still wrong is thrown away."""

LONGEST_STEP = 1.5
"""Largest change of the logarithm of such a standard deviation between two fits: a factor of 4.5."""

SHORTENED = 0.75
"""Part of the largest change of one step that the next may have."""

HELD = 1e-9
"""Relative standard deviation of what a bound holds: nothing but rounding."""

SAME_NOISE = 0.05
"""Relative change of such a standard deviation that counts as none: the evidence, stationary there, moves by a
hundredth."""

RESIDUAL_LEVEL = 0.01
"""Probability below which a residual, or a noise, counts as improbable."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """A joint fit with its uncertainty.

    Parameters
    ----------
    misfit : Misfit
        With the experiment, the effects and the noise of the fit.
    domain : Domain
    fit : Fit
    uncertainty : Uncertainty
        From data, priors, and what is expected of the effects.
    noise : NoiseEstimate
        Of what was left undeclared.
    """

    misfit: Misfit
    domain: Domain
    fit: Fit[Evaluation]
    uncertainty: Uncertainty
    noise: NoiseEstimate = field(default_factory=NoiseEstimate)

    @property
    def experiment(self) -> Experiment:
        """What was measured."""
        return self.misfit.experiment

    @property
    def effects(self) -> tuple[Placed, ...]:
        """The effects in the model."""
        return self.misfit.effects

    @property
    def theta(self) -> Floats:
        """All parameters, shape (P,)."""
        return self.fit.theta

    @property
    def chi2(self) -> float:
        """Sum of squared residuals of data and priors, in units of the declared or the estimated noise."""
        return self.fit.at.chi2

    @cached_property
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

        Where no degree of freedom is left bounds may hold the model back: the residual is then compared with one.
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

    @cached_property
    def quality(self) -> Quality:
        """Errors and chi-square."""
        declared = not self.misfit.open_noises
        return quality(self.misfit.data, self.fit.at.models, self.chi2, self.dof, declared=declared)

    @property
    def predictions(self) -> tuple[Prediction, ...]:
        """All modes at all floors, one prediction a configuration."""
        return predictions(self.fit.at.models)

    @property
    def scale(self) -> Scale:
        """Mean floor mass and story stiffness, and the heights."""
        n = self.experiment.stories
        return Scale(float(self.theta[:n].mean()), float(self.theta[n : 2 * n].mean()), heights_of(self.experiment))

    @property
    def frame(self) -> IdentifiedFrame:
        """The frame, nan where the data do not determine a value."""
        n = self.experiment.stories
        values = np.where(self.uncertainty.determined, self.theta, np.nan)
        std = self.std
        at_bounds = self._held_by_bounds(std)
        mass, mass_std = self._corrected(values[:n], std)
        return IdentifiedFrame(mass, values[n : 2 * n], mass_std, std[n : 2 * n], at_bounds)

    def own(self, placed: Placed) -> slice:
        """Where an effect's parameters stand in theta."""
        return next(at for item, at in slices(self.effects, 2 * self.experiment.stories) if item is placed)

    @property
    def expected_frame(self) -> IdentifiedFrame:
        """The frame with what was expected of it counted too, so that nothing of it is undetermined."""
        names = parameter_names(self.experiment, self.effects)
        n = self.experiment.stories
        std = uncertainty(self.fit.at.triangle[0], self.theta, self.domain, names).std()
        at_bounds = self._held_by_bounds(std)
        mass, mass_std = self._corrected(self.theta[:n], std)
        return IdentifiedFrame(mass, self.theta[n : 2 * n], mass_std, std[n : 2 * n], at_bounds)

    def _corrected(self, mass: Floats, std: Floats) -> tuple[Floats, Floats]:
        """Floor masses and their standard deviations with what effects put right of declared ones."""
        variance = std[: len(mass)] ** 2
        for placed, own in slices(self.effects, 2 * len(mass)):
            unit = placed.effect.corrects(placed.place, self.theta[: len(mass)])
            if unit.any():
                mass, variance = mass + unit @ self.theta[own], variance + unit**2 @ std[own] ** 2
        return mass, np.sqrt(variance)

    def _held_by_bounds(self, std: Floats) -> tuple[str, ...]:
        """List the masses and stiffnesses that bounds leave no freedom.

        Not those of which a bound on several together, such as a ratio, is active: they have a deviation still.
        """
        n = self.experiment.stories
        names = parameter_names(self.experiment, self.effects)[: 2 * n]
        active = set(self.uncertainty.active)
        none_left = std[: 2 * n] <= HELD * np.abs(self.theta[: 2 * n])
        return tuple(name for name, at_bounds in zip(names, none_left, strict=True) if at_bounds and name in active)

    @property
    def free_directions(self) -> Floats:
        """Directions that the constraints leave free and anything determines, of unit effect on all residuals."""
        return self.uncertainty.root_of(self.fit.at.triangle[0])

    @property
    def part(self) -> SingleIdentification:
        """The estimate in the form that every method returns."""
        return SingleIdentification(
            name="",
            iterations=self.fit.steps,
            frame=self.frame,
            fit=self.quality,
            predictions=self.predictions,
            reason=self.fit.reason,
        )


def parameter_names(experiment: Experiment, effects: Sequence[Placed]) -> tuple[str, ...]:
    """Names of the parameters of a fit, in order."""
    stories = range(1, experiment.stories + 1)
    return (
        *(f"floor_mass {i}" for i in stories),
        *(f"story_stiffness {i}" for i in stories),
        *(
            placed.label if len(placed.effect.parameters) == 1 else f"{placed.label} {item.name}"
            for placed in effects
            for item in placed.effect.parameters
        ),
    )


def fitted(
    misfit: Misfit, theta: Floats, backend: Backend, accuracy: Accuracy = FULL, start: Evaluation | None = None
) -> Estimate:
    """Find the estimate that Gauss-Newton reaches from a starting point, with the noise that it speaks for.

    Parameters
    ----------
    misfit : Misfit
        Its noise is where the estimate of an undeclared one starts.
    theta : ndarray, shape (P,)
    backend : Backend
    accuracy : Accuracy, optional
    start : Evaluation, optional
        At theta, where it was made already.
    """
    if not misfit.unknown:
        return fitted_with(misfit, theta, backend, accuracy, start)
    few = dataclasses.replace(accuracy, most_steps=STEPS_A_NOISE)
    estimate = fitted_with(misfit, theta, backend, few, start)
    longest, aim = LONGEST_STEP, dict[str, float]()
    for _ in range(MOST_NOISES):
        noise = estimated_noise(estimate.misfit, estimate.fit.at, estimate.free_directions)
        before = {item.key: estimate.misfit.noise.of(item.key) for item in misfit.unknown}
        if _same(estimate.misfit, noise):
            if estimate.fit.converged:
                return dataclasses.replace(estimate, noise=noise)
            estimate = fitted_with(estimate.misfit, estimate.theta, backend, accuracy, estimate.fit.at)
            continue
        changes = [np.log(factor / before[key]) for key, factor in noise.noise.factors]
        # A step beyond what the linearised model is good for leads to and fro: each is cut shorter than the last, until
        # one leaves the aim where it was.
        steady = aim and all(abs(np.log(factor / aim[key])) < SAME_NOISE for key, factor in noise.noise.factors)
        cut = 1.0 if steady else min(1.0, longest / max(map(abs, changes)))
        longest, aim = SHORTENED * longest, dict(noise.noise.factors)
        factors = tuple(
            (key, float(before[key] * np.exp(cut * change)))
            for (key, _), change in zip(noise.noise.factors, changes, strict=True)
        )
        misfit = estimate.misfit.replaced(noise=Noise(factors))
        estimate = fitted_with(misfit, estimate.theta, backend, few)
    if not estimate.fit.converged:
        estimate = fitted_with(estimate.misfit, estimate.theta, backend, accuracy, estimate.fit.at)
    noise = estimated_noise(estimate.misfit, estimate.fit.at, estimate.free_directions)
    if not _same(estimate.misfit, noise):
        # Where the linearised model has its maximum the model is another one: what is near the fit counts alone.
        noise = estimated_noise(estimate.misfit, estimate.fit.at, estimate.free_directions, here=True)
    return dataclasses.replace(estimate, noise=noise)


def _same(misfit: Misfit, noise: NoiseEstimate) -> bool:
    """Whether an estimate of the unknown standard deviations is that with which the fit was made."""
    return all(abs(np.log(factor / misfit.noise.of(key))) < SAME_NOISE for key, factor in noise.noise.factors)


def fitted_with(
    misfit: Misfit, theta: Floats, backend: Backend, accuracy: Accuracy = FULL, start: Evaluation | None = None
) -> Estimate:
    """Return the estimate that Gauss-Newton reaches from a starting point, the noise held as it is.

    Parameters
    ----------
    misfit : Misfit
    theta : ndarray, shape (P,)
    backend : Backend
    accuracy : Accuracy, optional
    start : Evaluation, optional
        At theta, where it was made already.
    """
    domain = domain_of(misfit.experiment, misfit.effects, theta)
    fit = gauss_newton(misfit, theta, domain, backend, accuracy, start)
    names = parameter_names(misfit.experiment, misfit.effects)
    return Estimate(misfit, domain, fit, uncertainty(fit.at.known_triangle, fit.theta, domain, names))


def efficient(experiment: Experiment, backend: Backend, effects: Sequence[Placed] = ()) -> Estimate:
    """Fit floor masses, story stiffnesses and effects to all configurations together.

    The starting points are tried, the nearest to the data first, until one leads to a fit that the data do not speak
    against; the best is kept.

    Parameters
    ----------
    experiment : Experiment
    backend : Backend
    effects : sequence of Placed, optional

    Returns
    -------
    Estimate

    Raises
    ------
    InfeasibleError
        Where declared masses and exact priors contradict each other.
    NoModesError
        Where the frame has no modes at any starting point.
    NoSolutionError
        Where no starting point leads to a fit.
    UnsuitableError
        Where the fit would take more than `MEMORY`.
    """
    refuse_contradicting(experiment)
    misfit = Misfit(experiment, effects)
    _refuse_large(misfit)
    own = np.array([value for placed in effects for value in placed.start])
    best: Estimate | None = None
    failure: CvxshearError | None = None
    missed = np.inf
    for start in nearest_first(misfit, own):
        theta = np.concatenate([start, own])
        try:
            # A further start leads to a better fit or nowhere: a rough one tells.
            found = fitted(misfit, theta, backend, FULL if best is None else ROUGH)
            if best is not None and found.chi2 < best.chi2:
                found = fitted(found.misfit, found.theta, backend)
        except NoModesError as error:
            # Beside a frequency of 1e12 times the others rounding leaves the lowest mode no positive eigenvalue.
            failure = failure or error
            continue
        except NoSolutionError as error:
            failure = failure or error
            missed = min(missed, misfit.evaluate(theta, derivatives=False).chi2)
            continue
        if best is None or found.chi2 < best.chi2:
            best = found
        if best.chi2 <= 3.0 * max(best.dof, 1) and not misfit.open_noises:
            break
    if best is None:
        raise failure if failure is not None else NoSolutionError(backend.name, "no starting point has modes")
    if failure is not None and best.misfit.replaced(noise=misfit.noise).evaluate(best.theta).chi2 > missed:
        # A point that fits worse than one from which the backend did not get anywhere is no minimum.
        raise failure
    if backend.name != "auto" and not misfit.open_noises and best.chi2 > HOPELESS * max(best.dof, 1):
        _refuse_local_minimum(best, backend, efficient(experiment, backends.get("auto"), effects))
    return best


def _refuse_local_minimum(found: Estimate, backend: Backend, reference: Estimate) -> None:
    """Raise where a fit that is far from the data ended above that of the default backend.

    Raises
    ------
    NoSolutionError
        Backends that solve every step to a millionth end in different valleys only where the problem magnifies that.
    """
    above = found.fit.at.objective - reference.fit.at.objective
    if above > FLAT * max(1.0, reference.fit.at.objective / max(len(reference.fit.at.r), 1)):
        raise NoSolutionError(
            backend.name,
            f"its fit ended in a local minimum, {above:.3g} above another backend's: too ill-conditioned to tell",
        )


def _refuse_large(misfit: Misfit) -> None:
    """Raise `UnsuitableError`, before anything is allocated, where a fit would not fit into `MEMORY`."""
    rows, P = sum(datum.count for datum in misfit.data), misfit.parameters
    needed = 8.0 * (12 * rows * P + 25 * P**2)
    if needed > MEMORY:
        raise UnsuitableError(
            f"a joint fit of {rows:,} data by {P:,} parameters would take about {needed / 1e9:.1f} GB, more than the "
            f"{MEMORY / 1e9:.0f} GB that are allowed; name the method one-shot or two-stage, or leave modes out"
        )
