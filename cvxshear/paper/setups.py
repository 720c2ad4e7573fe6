"""Known frames with noisy measurements of them, and the smallest possible scatter of their masses and stiffnesses."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from cvxshear.fit.misfit import Misfit
from cvxshear.measurement.experiment import Configuration, Experiment, Frame
from cvxshear.model import mass_matrix, modes, stiffness_matrix
from cvxshear.util import checks, ranking
from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats, Ints


@dataclass(frozen=True, eq=False)
class Setup(InJson):
    """A known frame and a noisy measurement of it.

    Parameters
    ----------
    floor_mass : array_like, shape (N,)
        True floor masses, kg. Their sum is declared as the known total.
    story_stiffness : array_like, shape (N,)
        True story stiffnesses, N/m.
    mode_shape_std : float
        Standard deviation of a shape entry, defined by `mode_shape_noise`.
    mode_shape_noise : str, optional
        Factor of the standard deviation: "multiplicative", the entry itself (Eq. 27); "additive", the mode's largest.
    frequency_std : float, optional
        Declared relative standard deviation of the frequencies.
    exact_frequencies : bool, optional
        Whether the simulated frequencies have no noise, as in the paper (its Section 5.2).
    modes : array_like of int, shape (m,), optional
        Numbers of the measured modes, 1 the lowest; empty for all.
    measured_floors : array_like of int, shape (n,), optional
        Empty for all floors.
    name : str, optional

    Raises
    ------
    InputError
        If the frame, the noise or the selection is not valid.
    """

    floor_mass: Floats
    story_stiffness: Floats
    mode_shape_std: float
    mode_shape_noise: str = "multiplicative"
    frequency_std: float = 1e-5
    exact_frequencies: bool = True
    modes: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    measured_floors: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    name: str = "frame"

    json_keys = (
        "name floor_mass story_stiffness modes measured_floors mode_shape_std mode_shape_noise frequency_std "
        "exact_frequencies"
    )

    def __post_init__(self) -> None:
        checks.put(self, "floor_mass", checks.vector, "floor_mass", above=0.0)
        n = self.stories
        checks.put(self, "story_stiffness", checks.vector, "story_stiffness", length=n, above=0.0)
        for key in ("mode_shape_std", "frequency_std"):
            checks.put(self, key, checks.number, key, above=0.0)
        checks.choice(self.mode_shape_noise, ("multiplicative", "additive"), "mode_shape_noise")
        for key in ("modes", "measured_floors"):
            if not len(getattr(self, key)):
                object.__setattr__(self, key, np.arange(1, n + 1))
            checks.put(self, key, checks.ascending_whole, key, most=n)

    @property
    def stories(self) -> int:
        """Number of stories N."""
        return len(self.floor_mass)

    @property
    def truth(self) -> Floats:
        """Floor masses, then story stiffnesses, shape (2N,)."""
        return np.concatenate([self.floor_mass, self.story_stiffness])

    @property
    def complete(self) -> bool:
        """Whether all modes are measured at all floors."""
        return len(self.modes) == len(self.measured_floors) == self.stories

    def exact(self) -> tuple[Floats, Floats]:
        """Compute the measurement without noise.

        Returns
        -------
        frequencies : ndarray, shape (m,)
            Hz.
        mode_shapes : ndarray, shape (m, n)
            One row per mode, largest measured entry 1.
        """
        found = modes(mass_matrix(self.floor_mass), stiffness_matrix(self.story_stiffness))
        which = self.modes - 1
        shapes = found.shapes[np.ix_(which, self.measured_floors - 1)]
        largest = shapes[np.arange(len(shapes)), ranking.largest(np.abs(shapes))]
        return found.frequencies[which], shapes / largest[:, None]

    def draw(self, rng: np.random.Generator, samples: int) -> tuple[Floats, Floats]:
        """Draw noisy measurements.

        Parameters
        ----------
        rng : Generator
        samples : int

        Returns
        -------
        frequencies : ndarray, shape (samples, m)
            Hz.
        mode_shapes : ndarray, shape (samples, m, n)
        """
        frequencies, shapes = self.exact()
        noise = self.mode_shape_std * rng.standard_normal((samples, *shapes.shape))
        # Additive noise is proportional to the largest entry of a mode; `exact` scales this entry to 1.
        noisy = shapes + noise * (shapes if self.mode_shape_noise == "multiplicative" else 1.0)
        if self.exact_frequencies:
            return np.tile(frequencies, (samples, 1)), noisy
        return frequencies * (1.0 + self.frequency_std * rng.standard_normal((samples, len(frequencies)))), noisy

    def experiment(self, frequencies: Floats, mode_shapes: Floats) -> Experiment:
        """Make one measurement with its declared noise and total mass.

        Parameters
        ----------
        frequencies : ndarray, shape (m,)
        mode_shapes : ndarray, shape (m, n)
        """
        # Noise can swap two close frequencies; the shapes then identify the modes.
        order = np.argsort(frequencies)
        configuration = Configuration(
            frequencies=frequencies[order],
            mode_shapes=mode_shapes[order],
            measured_floors=self.measured_floors,
            modes=self.modes,
            frequency_std=np.full(len(frequencies), self.frequency_std),
            mode_shape_std=np.full(mode_shapes.shape, self.mode_shape_std),
            mode_shape_noise=self.mode_shape_noise,
        )
        frame = Frame(stories=self.stories, total_mass=float(self.floor_mass.sum()))
        return Experiment(frame, (configuration,), name=self.name)


def three_story(mode_shape_std: float) -> Setup:
    """Set up the paper's three-story frame (its Section 5.2): all modes at all floors, exact frequencies."""
    return Setup(
        floor_mass=np.array([10.0, 7.5, 5.0]),
        story_stiffness=np.array([1800.0, 1200.0, 600.0]),
        mode_shape_std=mode_shape_std,
        name="three stories, all modes at all floors",
    )


def paper_setups(sigmas: Iterable[float] = (0.01, 0.02, 0.03, 0.04, 0.05)) -> tuple[Setup, ...]:
    """Set up the paper's three-story frame at several noise levels; by default, those of Table 3."""
    return tuple(three_story(sigma) for sigma in sigmas)


def six_story(mode_shape_std: float = 0.01) -> Setup:
    """Set up a six-story frame with a typical test: four lowest modes, floor 3 not measured, frequencies to 0.1 %."""
    return Setup(
        floor_mass=np.array([10.0, 10.0, 9.0, 9.0, 8.0, 6.0]),
        story_stiffness=np.array([24e3, 22e3, 19e3, 16e3, 12e3, 8e3]),
        mode_shape_std=mode_shape_std,
        mode_shape_noise="additive",
        frequency_std=1e-3,
        exact_frequencies=False,
        modes=np.array([1, 2, 3, 4]),
        measured_floors=np.array([1, 2, 4, 5, 6]),
        name="six stories, four modes at five floors",
    )


def cramer_rao(setup: Setup) -> Floats:
    """Compute the smallest covariance of floor masses and story stiffnesses of an unbiased estimator.

    The covariance is Z (Z' J'J Z)^-1 Z'. J has the derivatives of the standardized data at the true frame, with the
    scale of each shape eliminated. Z spans the changes that keep the total mass (Stoica and Ng, 1998).

    Parameters
    ----------
    setup : Setup

    Returns
    -------
    ndarray, shape (2N, 2N)
        Floor masses first, then story stiffnesses; kg and N/m.

    Notes
    -----
    The standard deviation of multiplicative noise depends on the parameters, too. The information from this dependence,
    a fraction 2 sigma^2 of the entries' information (half a percent at sigma = 5 %), is left out: the declared standard
    deviations count as constants.
    """
    truth = setup.truth
    # Derivatives by relative changes, so that kg and N/m have the same size.
    J = Misfit(setup.experiment(*setup.exact())).evaluate(truth).J * truth
    Z = linalg.null_space(np.concatenate([setup.floor_mass, np.zeros(setup.stories)])[None])
    root = truth[:, None] * Z @ np.linalg.inv(np.linalg.qr(J @ Z, mode="r"))
    return np.asarray(root @ root.T)


def bound(setup: Setup) -> Floats:
    """Compute the smallest standard deviation of each mass and stiffness, shape (2N,), kg and N/m."""
    return np.asarray(np.sqrt(np.diag(cramer_rao(setup))))
