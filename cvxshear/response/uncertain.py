"""A fitted frame in one state, its parameters and damping ratios uncertain, and what that makes of any function of it.

Standard deviations are linear, along each of the independent directions of the frame's uncertainty: half the difference
between plus and minus one standard deviation. That is the slope of a secant; a peak changes its time along the way,
where a derivative at one point would know but one of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cvxshear.backends import Backend
from cvxshear.effects import State, compose
from cvxshear.measurement.experiment import DAMPING_KINDS, Configuration
from cvxshear.model.shear import Modes, modes, stiffness_matrix
from cvxshear.response.damped import DampedModel
from cvxshear.response.dashpots import Dashpots, Ratios, damping_ratios, rayleigh, story_dashpots
from cvxshear.response.fitted import Fitted
from cvxshear.util import checks
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Floats


@dataclass(frozen=True, eq=False)
class Damped:
    """A model with its damping, and what the damping is made of.

    Parameters
    ----------
    model : DampedModel
    dashpots : Dashpots or None
    rayleigh : ndarray, shape (2,), optional
        a (1/s) and b (s) of C = a M + b K.
    """

    model: DampedModel
    dashpots: Dashpots | None = None
    rayleigh: Floats | None = None


@dataclass(frozen=True, eq=False)
class UncertainFrame:
    """A fitted model in one state, of uncertain parameters and damping ratios.

    Its uncertainty is that of independent standard normal numbers xi: theta + L xi for masses, stiffnesses and
    effects, zeta exp(std xi) for the damping ratios. Whatever is computed of the frame is a function of xi.

    Parameters
    ----------
    fitted : Fitted
    configuration : Configuration
        The state: added mass, and which effects are in it.
    ratios : Ratios
    kind : str
        "modal", "story" or "rayleigh".
    backend : Backend
    """

    fitted: Fitted
    configuration: Configuration
    ratios: Ratios
    kind: str
    backend: Backend

    @staticmethod
    def of(fitted: Fitted, configuration: Configuration, kind: str | None, backend: Backend) -> UncertainFrame:
        """With the damping ratios that the experiment declares, and its kind of damping where none is named."""
        experiment = fitted.experiment
        named = experiment.damping.kind if kind is None else checks.choice(kind, DAMPING_KINDS, "damping")
        return UncertainFrame(fitted, configuration, damping_ratios(experiment, configuration), named, backend)

    @property
    def uncertain(self) -> bool:
        """Whether anything tells how uncertain the parameters are."""
        return self.fitted.covariance is not None

    @property
    def size(self) -> int:
        """How many standard normal numbers there are."""
        return int(self.fitted.root.shape[1]) + len(self.ratios.values)

    @property
    def story_stiffness(self) -> Floats:
        """Of this state at the fitted parameters, shape (N,), N/m."""
        return self._state(self.configuration, self.fitted.theta).story_stiffness

    def undamped(self, theta: Floats) -> DampedModel:
        """Build the matrices of this state at given parameters, without damping."""
        state = self._state(self.configuration, theta)
        M, K = state.system.M, state.system.K
        return DampedModel(M, np.zeros_like(M), K, state.gain, self.fitted.experiment.frame.story_heights)

    def conditional_stiffness(self) -> Floats:
        """Covariance of the logarithms of the story stiffnesses with masses and effects given, shape (N, N).

        What a record tells of the frame is compared with this: masses and effects stay what they are.
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
        """L with L L' the covariance of masses and effects, the stiffnesses moving along as they were identified."""
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
        """Build the damped model at one value of xi.

        Parameters
        ----------
        xi : ndarray, shape (size,)
        near : Damped, optional
            Whose dashpots the programs start from.

        Raises
        ------
        InputError
            Where the frame has no modes there.
        """
        root = self.fitted.root
        theta = self.fitted.theta + root @ xi[: root.shape[1]]
        zeta = self.ratios.values * np.exp(self.ratios.std * xi[root.shape[1] :])
        return self.damped(theta, dataclasses.replace(self.ratios, values=zeta), near)

    def damped(self, theta: Floats, ratios: Ratios, near: Damped | None = None) -> Damped:
        """Build the damped model of given parameters and ratios.

        Dashpots and Rayleigh's factors are those of the state in which the ratios were measured; modal damping has the
        same ratios in every state.
        """
        experiment = self.fitted.experiment
        state = self._state(self.configuration, theta)
        M, K = state.system.M, state.system.K
        if len(M) > experiment.stories:
            raise UnsuitableError(
                "nothing measured the damping of a mass that is attached to a floor: the response of a frame with one "
                "is not computed; leave that effect out"
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
    """C = M Phi diag(2 zeta omega) Phi' M, with which the modes have these damping ratios and do not couple."""
    turned = M @ real.shapes.T
    return (turned * (2 * ratios * np.sqrt(real.eigenvalues))) @ turned.T


FARTHEST_SECANT = 0.5
"""Largest relative change of a mass or stiffness on the way; a direction that would change one by more is gone along
as far as that."""


def propagated(frame: UncertainFrame, function: Callable[[Damped], Floats]) -> tuple[Damped, Floats]:
    """Return the frame as it was fitted, and the standard deviations of a function of it.

    Parameters
    ----------
    frame : UncertainFrame
    function : callable
        Takes a `Damped`, returns an array of any one shape.

    Returns
    -------
    centre : Damped
    std : ndarray
        Of the shape that the function returns; nan where nothing tells the noise.
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
    """How far each direction is gone along, in standard deviations."""
    fitted = frame.fitted
    n = 2 * fitted.experiment.stories
    share = np.max(np.abs(fitted.root[:n]) / fitted.theta[:n, None], axis=0, initial=0.0)
    steps = np.minimum(1.0, FARTHEST_SECANT / np.maximum(share, FARTHEST_SECANT))
    return np.concatenate([steps, np.ones(frame.size - len(steps))])
