"""A fitted frame in one state with uncertain parameters and damping ratios, and standard deviations of its functions.

The damping itself (modal, story dashpots or Rayleigh's) is one such function (`damping_of`).

Standard deviations are linear, along each independent direction of the frame's uncertainty: half the difference between
the values at plus and minus one standard deviation. This is the slope of a secant. The time of a peak can change along
the way; a derivative at one point would not see this change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cvxshear import backends
from cvxshear.effects import State, compose
from cvxshear.fit.efficient import Estimate
from cvxshear.measurement.experiment import DAMPING_KINDS, Configuration, Measurement, opened
from cvxshear.model import Modes, modes, stiffness_matrix
from cvxshear.response import damping
from cvxshear.response.sources import Fitted, covariance_root
from cvxshear.util import checks
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import NoModesError, UnsuitableError
from cvxshear.util.results import Shown
from cvxshear.util.typing import Floats, T


@dataclass(frozen=True, eq=False)
class Damped:
    """A model with its damping, and the parameters of the damping.

    Parameters
    ----------
    rayleigh : ndarray, shape (2,), optional
        a (1/s) and b (s) of C = a M + b K.
    """

    model: damping.DampedModel
    dashpots: damping.Dashpots | None = None
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
    ratios: damping.Ratios
    kind: str
    backend: backends.Backend

    @staticmethod
    def of(fitted: Fitted, configuration: Configuration, kind: str | None, backend: backends.Backend) -> UncertainFrame:
        """Use the damping ratios that the experiment declares, and by default its kind of damping."""
        experiment = fitted.experiment
        named = experiment.damping.kind if kind is None else checks.choice(kind, DAMPING_KINDS, "damping")
        return UncertainFrame(fitted, configuration, damping.damping_ratios(experiment, configuration), named, backend)

    @property
    def size(self) -> int:
        """Number of standard normal numbers xi."""
        return int(self.fitted.root.shape[1]) + len(self.ratios.values)

    @property
    def story_stiffness(self) -> Floats:
        """Story stiffnesses of this state at the fitted parameters, shape (N,), N/m."""
        return self._state(self.configuration, self.fitted.theta).story_stiffness

    def undamped(self, theta: Floats) -> damping.DampedModel:
        """Build the matrices of this state at given parameters, without damping."""
        state = self._state(self.configuration, theta)
        M, K = state.system.M, state.system.K
        return damping.DampedModel(M, np.zeros_like(M), K, state.gain, self.fitted.experiment.frame.story_heights)

    def conditional_stiffness(self) -> Floats:
        """Compute the covariance of the log story stiffnesses, given masses and effects, shape (N, N).

        A fit to a record compares its stiffnesses with this covariance; masses and effects stay fixed.
        """
        n = self.fitted.experiment.stories
        own = slice(n, 2 * n)
        along = self.nuisance_root()[own]
        given = self.fitted.misfit * self.fitted.covariance[own, own] - along @ along.T
        root = covariance_root(given / np.outer(self.fitted.theta[own], self.fitted.theta[own]))
        return root @ root.T

    def nuisance_root(self) -> Floats:
        """Return L; L L' is the covariance of masses and effects, with the stiffnesses conditional on both."""
        n = self.fitted.experiment.stories
        covariance = self.fitted.covariance
        rest = np.r_[0:n, 2 * n : len(self.fitted.theta)]
        # With R R' the covariance of masses and effects, the stiffnesses follow by their regression.
        own = covariance_root(covariance[np.ix_(rest, rest)])
        return np.asarray(np.sqrt(self.fitted.misfit) * covariance[:, rest] @ np.linalg.pinv(own).T)

    @cached_property
    def centre(self) -> Damped:
        """The frame as fitted."""
        return self.at(np.zeros(self.size))

    def at(self, xi: Floats) -> Damped:
        """Build the damped model at one value of xi.

        Raises
        ------
        InputError
            If the frame has no modes at xi.
        """
        root = self.fitted.root
        theta = self.fitted.theta + root @ xi[: root.shape[1]]
        zeta = self.ratios.values * np.exp(self.ratios.std * xi[root.shape[1] :])
        return self.damped(theta, replace(self.ratios, values=zeta))

    def damped(self, theta: Floats, ratios: damping.Ratios) -> Damped:
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
                dashpots = damping.story_dashpots(real, tested.story_stiffness, ratios, self.backend)
                C = stiffness_matrix(dashpots.values)
            else:
                factors = damping.rayleigh(real, ratios, self.backend)
                C = factors[0] * M + factors[1] * K
        model = damping.DampedModel(M, C, K, state.gain, experiment.frame.story_heights, self.fitted.mass_known)
        return Damped(model, dashpots, factors)

    def _state(self, configuration: Configuration, theta: Floats) -> State:
        return compose(self.fitted.experiment, configuration, self.fitted.effects, theta, derivatives=False)


def modal_matrix(M: Floats, real: Modes, ratios: Floats) -> Floats:
    """Return C = M Phi diag(2 zeta omega) Phi' M; it gives the modes these damping ratios without coupling."""
    turned = M @ real.shapes.T
    return (turned * (2 * ratios * np.sqrt(real.eigenvalues))) @ turned.T


def either_side(at: Callable[[float], T]) -> tuple[T, T, float]:
    """Evaluate at plus and minus one deviation, or nearer until both frames have modes; return the distance, too."""
    size = 1.0
    while True:
        try:
            return at(size), at(-size), size
        except NoModesError:
            size *= 0.25


def propagated(frame: UncertainFrame, function: Callable[[Damped], dict[str, Floats]]) -> dict[str, Floats]:
    """Return the standard deviations of arrays that are functions of the frame."""

    def away(xi: Floats, size: float) -> dict[str, Floats]:
        return function(frame.at(size * xi))

    variance = {name: np.zeros_like(each) for name, each in function(frame.centre).items()}
    for xi in np.eye(frame.size):
        above, below, size = either_side(partial(away, xi))
        for name in variance:
            variance[name] += ((above[name] - below[name]) / (2 * size)) ** 2
    return {name: np.sqrt(each) for name, each in variance.items()}


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


def parts_of(damped: Damped) -> dict[str, Floats]:
    """Return the parameters of the damping that apply: ratios, dashpots, Rayleigh's factors."""
    dashpots = None if damped.dashpots is None else damped.dashpots.values
    parts = {"ratios": damped.model.ratios, "dashpots": dashpots, "rayleigh": damped.rayleigh}
    return {name: values for name, values in parts.items() if values is not None}


def described(frame: UncertainFrame, std: Mapping[str, Floats]) -> IdentifiedDamping:
    """Return the damping with standard deviations of `parts_of`."""
    damped = frame.centre
    remarks = [*frame.ratios.assumed()]
    if frame.ratios.tested.name != frame.configuration.name:
        remarks.append(f'the damping ratios were measured in "{frame.ratios.tested.name}"')
    measured = np.where(frame.ratios.measured, frame.ratios.values, np.nan)
    dashpots, dashpot_std = None, None
    if damped.dashpots is not None:
        dashpots = damped.dashpots.values
        dashpot_std = np.where(damped.dashpots.determined, std["dashpots"], np.nan)
        if damped.dashpots.open:
            remarks.append(
                f"the measured damping ratios leave open {', and '.join(damped.dashpots.open)}; what is left open is "
                "set in proportion to the story stiffness"
            )
    return IdentifiedDamping(
        frame.kind, damped.model.ratios, std["ratios"], dashpots, dashpot_std, damped.rayleigh, std.get("rayleigh"),
        measured, tuple(remarks),
    )  # fmt: skip


def damping_of(
    experiment: Measurement,
    estimate: Estimate | Fitted,
    backend: str | backends.Backend = "auto",
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
    experiment = opened(experiment, turning=True)
    names = [each.name for each in experiment.configurations if each.damping_ratios is not None]
    if not names:
        return None
    experiment = opened(experiment)
    name = names[0] if configuration is None else checks.choice(configuration, names, "configuration")
    state = next(each for each in experiment.configurations if each.name == name)
    fitted = estimate if isinstance(estimate, Fitted) else Fitted.of(estimate)
    frame = UncertainFrame.of(fitted, state, kind, backends.get(backend))
    if frame.kind == "modal":
        # Modal damping has exactly the measured ratios.
        std = {"ratios": frame.ratios.values * frame.ratios.std}
        return described(frame, std)
    return described(frame, propagated(frame, parts_of))
