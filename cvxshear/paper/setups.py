"""Known frames with noisy measurements, and the Cramer-Rao bound of what can be identified from them."""

from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from cvxshear.fit.misfit import Misfit
from cvxshear.measurement.experiment import Configuration, Experiment, Frame
from cvxshear.model.shear import mass_matrix, modes, stiffness_matrix
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
        Standard deviation of a shape entry, in the sense of `mode_shape_noise`.
    mode_shape_noise : str, optional
        "multiplicative": times the entry itself (Eq. 27); "additive": times the mode's largest entry.
    frequency_std : float, optional
        Declared relative standard deviation of the frequencies.
    exact_frequencies : bool, optional
        Whether the frequencies are exact all the same, as the paper has them (its Section 5.2).
    modes : array_like of int, shape (m,), optional
        Which modes are measured, 1 the lowest; all where empty.
    measured_floors : array_like of int, shape (n,), optional
        All where empty.
    name : str, optional

    Raises
    ------
    InputError
        Where the frame, the noise or the selection is not one.
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
        """Return what would be measured without noise.

        Returns
        -------
        frequencies : ndarray, shape (m,)
            Hz.
        mode_shapes : ndarray, shape (m, n)
            One row a mode, largest measured entry 1.
        """
        found = modes(mass_matrix(self.floor_mass), stiffness_matrix(self.story_stiffness))
        which = self.modes - 1
        shapes = found.shapes[np.ix_(which, self.measured_floors - 1)]
        largest = shapes[np.arange(len(shapes)), ranking.largest(np.abs(shapes))]
        return found.frequencies[which], shapes / largest[:, None]

    def draw(self, rng: np.random.Generator, samples: int) -> tuple[Floats, Floats]:
        """Noisy measurements.

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
        # Additive noise goes with the largest entry of a mode, which `exact` scales to 1.
        noisy = shapes + noise * (shapes if self.mode_shape_noise == "multiplicative" else 1.0)
        if self.exact_frequencies:
            return np.tile(frequencies, (samples, 1)), noisy
        return frequencies * (1.0 + self.frequency_std * rng.standard_normal((samples, len(frequencies)))), noisy

    def experiment(self, frequencies: Floats, mode_shapes: Floats) -> Experiment:
        """Make one measurement with what is declared of it: the noise, and the total mass.

        Parameters
        ----------
        frequencies : ndarray, shape (m,)
        mode_shapes : ndarray, shape (m, n)
        """
        # Noise can swap two close frequencies; the shapes then tell which mode is which.
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
    """Set up the paper's three-story frame (its Section 5.2): every mode at every floor, the frequencies exact."""
    return Setup(
        floor_mass=np.array([10.0, 7.5, 5.0]),
        story_stiffness=np.array([1800.0, 1200.0, 600.0]),
        mode_shape_std=mode_shape_std,
        name="three stories, all modes at all floors",
    )


def six_story(mode_shape_std: float = 0.01) -> Setup:
    """Set up a six-story frame as tests meet it: four lowest modes, floor 3 without a sensor, frequencies to 0.1 %."""
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
    """Smallest covariance of floor masses and story stiffnesses that an unbiased estimator can have.

    Z (Z' J'J Z)^-1 Z' with J the derivatives of the standardized data at the true frame, the scale of each shape
    eliminated, and Z spanning the changes that keep the total mass (Stoica and Ng, 1998).

    Parameters
    ----------
    setup : Setup

    Returns
    -------
    ndarray, shape (2N, 2N)
        Floor masses first, then story stiffnesses; kg and N/m.

    Notes
    -----
    The standard deviation of multiplicative noise depends on the parameters itself. What that tells of them, a
    part 2 sigma^2 of what the entries tell (half a percent at sigma = 5 %), is left out: the declared standard
    deviations are taken as numbers.
    """
    truth = setup.truth
    # Of relative changes, so that kg and N/m share one size.
    J = Misfit(setup.experiment(*setup.exact())).evaluate(truth).J * truth
    Z = linalg.null_space(np.concatenate([setup.floor_mass, np.zeros(setup.stories)])[None])
    root = truth[:, None] * Z @ np.linalg.inv(np.linalg.qr(J @ Z, mode="r"))
    return np.asarray(root @ root.T)


def bound(setup: Setup) -> Floats:
    """Smallest standard deviation of each floor mass and story stiffness, shape (2N,), kg and N/m."""
    return np.asarray(np.sqrt(np.diag(cramer_rao(setup))))
