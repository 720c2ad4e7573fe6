"""A fitted frame in one state with uncertain parameters and damping ratios, and standard deviations of its functions.

The damping itself (modal, story dashpots or Rayleigh's) is one such function (`damping_of`).

Standard deviations are linear, along each independent direction of the frame's uncertainty: half the difference between
the values at plus and minus one standard deviation. This is the slope of a secant. The time of a peak can change along
the way; a derivative at one point would not see this change.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.effects import State, compose
from cvxshear.fit.efficient import Estimate
from cvxshear.measurement.experiment import DAMPING_KINDS, Configuration, Measurement, opened
from cvxshear.model import Modes, modes, stiffness_matrix
from cvxshear.response.damping import (
    LEAST_RATIO,
    DampedModel,
    Dashpots,
    Ratios,
    damping_ratios,
    rayleigh,
    story_dashpots,
)
from cvxshear.response.sources import Fitted
from cvxshear.util import checks, ranking
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.quantities import NORMAL_95, percent, ranged
from cvxshear.util.results import Shown
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class Damped:
    """A model with its damping, and the parameters of the damping.

    Parameters
    ----------
    rayleigh : ndarray, shape (2,), optional
        a (1/s) and b (s) of C = a M + b K.
    """

    model: DampedModel
    dashpots: Dashpots | None = None
    rayleigh: Floats | None = None


@dataclass(frozen=True, eq=False)
class UncertainFrame:
    """A fitted model in one state, with uncertain parameters and damping ratios.

    Independent standard normal numbers xi describe the uncertainty: theta + L xi for masses, stiffnesses and effects,
    zeta exp(std xi) for the damping ratios. Every quantity of the frame is a function of xi.

    Parameters
    ----------
    configuration : Configuration
        The state: added mass, and the effects that act in it.
    kind : str
        "modal", "story" or "rayleigh".
    """

    fitted: Fitted
    configuration: Configuration
    ratios: Ratios
    kind: str
    backend: Backend

    @staticmethod
    def of(fitted: Fitted, configuration: Configuration, kind: str | None, backend: Backend) -> UncertainFrame:
        """Use the damping ratios that the experiment declares, and by default its kind of damping."""
        experiment = fitted.experiment
        named = experiment.damping.kind if kind is None else checks.choice(kind, DAMPING_KINDS, "damping")
        return UncertainFrame(fitted, configuration, damping_ratios(experiment, configuration), named, backend)

    @property
    def uncertain(self) -> bool:
        """Whether the standard deviations of the parameters are known."""
        return self.fitted.covariance is not None

    @property
    def size(self) -> int:
        """Number of standard normal numbers xi."""
        return int(self.fitted.root.shape[1]) + len(self.ratios.values)

    @property
    def story_stiffness(self) -> Floats:
        """Story stiffnesses of this state at the fitted parameters, shape (N,), N/m."""
        return self._state(self.configuration, self.fitted.theta).story_stiffness

    def undamped(self, theta: Floats) -> DampedModel:
        """Build the matrices of this state at given parameters, without damping."""
        state = self._state(self.configuration, theta)
        M, K = state.system.M, state.system.K
        return DampedModel(M, np.zeros_like(M), K, state.gain, self.fitted.experiment.frame.story_heights)

    def conditional_stiffness(self) -> Floats:
        """Compute the covariance of the log story stiffnesses, given masses and effects, shape (N, N).

        A fit to a record compares its stiffnesses with this covariance; masses and effects stay fixed.
        """
        n = self.fitted.experiment.stories
        covariance = self.fitted.covariance
        if covariance is None:
            return np.zeros((n, n))
        own, rest = slice(n, 2 * n), np.r_[0:n, 2 * n : len(self.fitted.theta)]
        cross = covariance[own][:, rest]
        given = covariance[own, own] - cross @ np.linalg.pinv(covariance[np.ix_(rest, rest)], rcond=1e-10) @ cross.T
        relative = given / np.outer(self.fitted.theta[own], self.fitted.theta[own])
        values, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
        spread: Floats = self.fitted.misfit * (vectors * np.maximum(values, 0.0)) @ vectors.T
        return spread

    def nuisance_root(self) -> Floats:
        """Return L; L L' is the covariance of masses and effects, with the stiffnesses conditional on both."""
        n = self.fitted.experiment.stories
        covariance = self.fitted.covariance
        if covariance is None:
            return np.zeros((len(self.fitted.theta), 0))
        rest = np.r_[0:n, 2 * n : len(self.fitted.theta)]
        std = np.sqrt(np.maximum(np.diag(covariance)[rest], 0.0))
        unit = np.where(std > 0, std, 1.0)
        values, vectors = np.linalg.eigh(covariance[np.ix_(rest, rest)] / np.outer(unit, unit))
        kept = values > 1e-10 * max(float(values[-1]), 1e-300)
        scaled = vectors[:, kept] / np.sqrt(values[kept])
        root: Floats = np.sqrt(self.fitted.misfit) * (covariance[:, rest] / unit) @ scaled
        return root

    def at(self, xi: Floats, near: Damped | None = None) -> Damped:
        """Build the damped model at one value of xi; the programs of dashpots start from the model `near`.

        Raises
        ------
        InputError
            If the frame has no modes at xi.
        """
        root = self.fitted.root
        theta = self.fitted.theta + root @ xi[: root.shape[1]]
        zeta = self.ratios.values * np.exp(self.ratios.std * xi[root.shape[1] :])
        return self.damped(theta, dataclasses.replace(self.ratios, values=zeta), near)

    def damped(self, theta: Floats, ratios: Ratios, near: Damped | None = None) -> Damped:
        """Build the damped model of given parameters and ratios.

        Dashpots and Rayleigh's factors belong to the state of the measured ratios. Modal damping has the same ratios in
        every state.
        """
        experiment = self.fitted.experiment
        state = self._state(self.configuration, theta)
        M, K = state.system.M, state.system.K
        if len(M) > experiment.stories:
            raise UnsuitableError(
                "nothing measured the damping of a mass that is attached to a floor, so that the response of a frame "
                "with one is not known"
            )
        dashpots, factors = None, None
        if self.kind == "modal":
            C = modal_matrix(M, modes(M, K), ratios.values)
        else:
            tested = self._state(ratios.tested, theta)
            real = modes(tested.system.M, tested.system.K)
            if self.kind == "story":
                start = None if near is None or near.dashpots is None else near.dashpots.values
                priors = experiment.damping.priors
                dashpots = story_dashpots(real, tested.story_stiffness, ratios, self.backend, priors, start)
                C = stiffness_matrix(dashpots.values)
            else:
                factors = rayleigh(real, ratios, self.backend)
                C = factors[0] * M + factors[1] * K
        model = DampedModel(M, C, K, state.gain, experiment.frame.story_heights, self.fitted.mass_known)
        return Damped(model, dashpots, factors)

    def _state(self, configuration: Configuration, theta: Floats) -> State:
        return compose(self.fitted.experiment, configuration, self.fitted.effects, theta, derivatives=False)


def modal_matrix(M: Floats, real: Modes, ratios: Floats) -> Floats:
    """Return C = M Phi diag(2 zeta omega) Phi' M; it gives the modes these damping ratios without coupling."""
    turned = M @ real.shapes.T
    return (turned * (2 * ratios * np.sqrt(real.eigenvalues))) @ turned.T


FARTHEST_SECANT = 0.5
"""Largest relative change of a mass or stiffness in a difference quotient; a shorter step replaces a larger change."""


def propagated(frame: UncertainFrame, function: Callable[[Damped], Floats]) -> tuple[Damped, Floats]:
    """Return the frame as fitted, and the standard deviations of an array that is a function of the frame.

    The standard deviations are nan if the noise is unknown.
    """
    centre = frame.at(np.zeros(frame.size))
    if not frame.uncertain:
        return centre, np.full_like(function(centre), np.nan)
    variance: Floats | float = 0.0
    for direction, length in enumerate(_lengths(frame)):
        xi = np.zeros(frame.size)
        xi[direction] = length
        slope = (function(frame.at(xi, centre)) - function(frame.at(-xi, centre))) / (2 * length)
        variance = variance + slope**2
    return centre, np.sqrt(variance)


def _lengths(frame: UncertainFrame) -> Floats:
    """Return the step along each direction, in standard deviations."""
    fitted = frame.fitted
    n = 2 * fitted.experiment.stories
    share = np.max(np.abs(fitted.root[:n]) / fitted.theta[:n, None], axis=0, initial=0.0)
    steps = np.minimum(1.0, FARTHEST_SECANT / np.maximum(share, FARTHEST_SECANT))
    return np.concatenate([steps, np.ones(frame.size - len(steps))])


@dataclass(frozen=True, eq=False, repr=False)
class IdentifiedDamping(Shown):
    """Damping with its standard deviations.

    Parameters
    ----------
    kind : str
        "modal", "story" or "rayleigh".
    ratios, ratios_std : ndarray, shape (N,)
        Ratios of the model's modes; standard deviations are also fractions of critical, nan if unknown.
    story_dashpot, story_dashpot_std : ndarray, shape (N,), optional
        N s/m; nan for undetermined dashpots. Only for story damping.
    rayleigh, rayleigh_std : ndarray, shape (2,), optional
        a (1/s) and b (s). Only for Rayleigh damping.
    measured : ndarray, shape (N,), optional
        The measured ratios; nan for unmeasured modes.
    remarks : tuple of str
        Assumptions, and undetermined parameters.
    """

    kind: str
    ratios: Floats
    ratios_std: Floats
    story_dashpot: Floats | None = None
    story_dashpot_std: Floats | None = None
    rayleigh: Floats | None = None
    rayleigh_std: Floats | None = None
    measured: Floats | None = None
    remarks: tuple[str, ...] = ()

    json_keys = (
        "kind story_dashpot story_dashpot_std ratios ratios_std ratios_measured=measured rayleigh rayleigh_std remarks"
    )


def parts_of(damped: Damped) -> Floats:
    """Return the parameters of the damping in one vector: ratios, then dashpots or Rayleigh's factors."""
    parts = [damped.model.ratios]
    if damped.dashpots is not None:
        parts.append(damped.dashpots.values)
    if damped.rayleigh is not None:
        parts.append(damped.rayleigh)
    return np.concatenate(parts)


def described(frame: UncertainFrame, damped: Damped, std: Floats) -> IdentifiedDamping:
    """Return the damping with standard deviations of `parts_of`."""
    n = len(damped.model.M)
    ratios, own = std[:n], std[n:]
    remarks = [*frame.ratios.assumed()]
    if frame.ratios.tested.name != frame.configuration.name:
        remarks.append(f'the damping ratios were measured in "{frame.ratios.tested.name}"')
    if frame.fitted.experiment.damping.priors and frame.kind != "story":
        remarks.append(f"the priors on story_damping have no part in {frame.kind} damping")
    measured = np.where(frame.ratios.measured, frame.ratios.values, np.nan)
    factors, dashpots, dashpot_std = damped.rayleigh, None, None
    if damped.dashpots is not None:
        dashpots = damped.dashpots.values
        dashpot_std = np.where(damped.dashpots.determined, own, np.nan)
        if damped.dashpots.open:
            remarks.append(
                f"the measured damping ratios leave open {', and '.join(damped.dashpots.open)}; what is left open is "
                "set in proportion to the story stiffness"
            )
    if frame.kind != "modal":
        remarks += _missed(frame, damped, measured)
    return IdentifiedDamping(
        frame.kind, damped.model.ratios, ratios, dashpots, dashpot_std, factors,
        None if factors is None else own, measured, tuple(remarks),
    )  # fmt: skip


def _missed(frame: UncertainFrame, damped: Damped, measured: Floats) -> list[str]:
    """Report the measured ratios that this kind of damping cannot reproduce; name a kind that can."""
    std = frame.ratios.std * np.maximum(frame.ratios.values, LEAST_RATIO)
    far = np.flatnonzero(np.abs(damped.model.ratios - np.nan_to_num(measured)) > NORMAL_95 * std)
    modes = [int(mode) + 1 for mode in far if np.isfinite(measured[mode])]
    if not modes:
        return []
    own = np.maximum(damped.model.ratios, 1e-9)
    worst = ranking.ranked(modes, lambda mode: abs(np.log(own[mode - 1] / max(measured[mode - 1], 1e-9))))[0]
    return [
        f"{WORDS[frame.kind]} cannot give the measured damping ratio{'s' if len(modes) > 1 else ''} of mode "
        f"{ranged(modes)} (mode {worst}: {percent(float(damped.model.ratios[worst - 1]), 2)} in place of "
        f"{percent(float(measured[worst - 1]), 2)}); modal damping can"
    ]


WORDS = {"story": "dashpots between the floors", "rayleigh": "Rayleigh damping"}
"""Kinds of damping that may not reproduce the measured ratios."""


def damping_of(
    experiment: Measurement,
    estimate: Estimate | Fitted,
    backend: str | Backend = "auto",
    *,
    kind: str | None = None,
    configuration: str | None = None,
) -> IdentifiedDamping | None:
    """Find the damping of an identified frame from the damping ratios that its experiment declares.

    Parameters
    ----------
    experiment : Experiment, path or name of a built-in
    estimate : Estimate or Fitted
        Result of `identification.efficient` or of a closed loop.
    backend : str or Backend, optional
    kind : str, optional
        "modal", "story" or "rayleigh"; by default, the kind that the experiment declares.
    configuration : str, optional
        Name of the configuration; by default, the first one with damping ratios.

    Returns
    -------
    IdentifiedDamping or None
        None if no damping ratio is declared.

    Raises
    ------
    InputError
        If there is no configuration of this name.
    UnsuitableError
        If only one ratio is known for Rayleigh damping.
    """
    experiment = opened(experiment)
    names = [each.name for each in experiment.configurations if each.damping_ratios is not None]
    if not names:
        return None
    name = names[0] if configuration is None else checks.choice(configuration, names, "configuration")
    state = next(each for each in experiment.configurations if each.name == name)
    fitted = estimate if isinstance(estimate, Fitted) else Fitted.of(estimate)
    frame = UncertainFrame.of(fitted, state, kind, backends.get(backend))
    if frame.kind == "modal":
        # Modal damping has exactly the measured ratios.
        return described(frame, frame.at(np.zeros(frame.size)), frame.ratios.values * frame.ratios.std)
    centre, std = propagated(frame, parts_of)
    return described(frame, centre, std)
