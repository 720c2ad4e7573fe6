"""Noise study of known frames: scatter of identified masses and stiffnesses, and the smallest possible scatter.

All methods get the same seeded samples. The paper's study (its Section 5.2, Table 3, Figs. 5 and 6) reports bias and
coefficient of variation. This study adds the root-mean-square error, the Cramer-Rao bound of the same data, and the
coverage of stated 95 % intervals. The two-stage and the one-shot method run in closed form on all complete samples at
once, with normal matrices, which do not need one row per pair of modes (`programs.formulations`). A normal matrix has
the squared condition number; this costs no visible accuracy for frames of a few stories. `identify` keeps the rows.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cvxshear.fit.identification import METHODS, identify
from cvxshear.fit.paper_methods import MOST_ITERATIONS, TOLERANCE
from cvxshear.model import transformation
from cvxshear.paper.setups import Setup, bound, six_story
from cvxshear.programs.formulations import pair_normal
from cvxshear.util import checks
from cvxshear.util.errors import InputError, NoSolutionError
from cvxshear.util.parallel import Progress, each
from cvxshear.util.quantities import NORMAL_95
from cvxshear.util.results import InJson, Shown
from cvxshear.util.typing import Bools, Floats


@dataclass(frozen=True, eq=False)
class Scatter(InJson):
    """Results of one method on the samples of one noise level.

    Parameters
    ----------
    setup : Setup
    method : str
    estimates : ndarray, shape (S, 2N)
        Floor masses, then story stiffnesses, kg and N/m; nan for samples without an answer.
    stated_std : ndarray, shape (S, 2N) or None
        Standard deviations that the method states; None if it states none.
    bound : ndarray, shape (2N,)
        Cramer-Rao bound of the standard deviations, kg and N/m.
    seconds : float
    """

    setup: Setup
    method: str
    estimates: Floats
    stated_std: Floats | None
    bound: Floats
    seconds: float

    json_keys = (
        "setup method samples failures seconds mean bias bias_error variation rmse bound=relative_bound ratio coverage"
    )

    @property
    def answered(self) -> Bools:
        """Mask of the samples with an answer, shape (S,); all figures use only these samples."""
        return np.asarray(np.isfinite(self.estimates).all(axis=1), dtype=np.bool_)

    @property
    def samples(self) -> int:
        """Number of samples S."""
        return len(self.estimates)

    @property
    def failures(self) -> int:
        """Number of samples without an answer."""
        return int(np.sum(~self.answered))

    @property
    def errors(self) -> Floats:
        """Estimate minus truth, relative to the truth, shape (answered, 2N)."""
        return self.estimates[self.answered] / self.setup.truth - 1.0

    @property
    def mean(self) -> Floats:
        """Mean estimate, shape (2N,), kg and N/m."""
        return np.asarray(self.estimates[self.answered].mean(axis=0))

    @property
    def bias(self) -> Floats:
        """Relative error of the mean, shape (2N,): Table 3."""
        return np.asarray(self.errors.mean(axis=0))

    @property
    def bias_error(self) -> Floats:
        """Standard error of `bias`, shape (2N,)."""
        return np.asarray(self.errors.std(axis=0, ddof=1) / np.sqrt(len(self.errors)))

    @property
    def variation(self) -> Floats:
        """Coefficient of variation (Eq. 28), shape (2N,): Fig. 6."""
        return np.asarray(self.estimates[self.answered].std(axis=0, ddof=1) / self.mean)

    @property
    def rmse(self) -> Floats:
        """Root-mean-square error, relative to the truth, shape (2N,)."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=0)))

    @property
    def relative_bound(self) -> Floats:
        """Cramer-Rao bound, relative to the truth, shape (2N,)."""
        return self.bound / self.setup.truth

    @property
    def ratio(self) -> Floats:
        """Ratio of rms error and Cramer-Rao bound, shape (2N,); nan for exactly known parameters."""
        free = self.bound > 0
        return np.where(free, self.rmse / np.where(free, self.relative_bound, 1.0), np.nan)

    @property
    def coverage(self) -> Floats | None:
        """Fraction of the samples whose stated 95 % interval contains the truth, shape (2N,)."""
        if self.stated_std is None:
            return None
        distance = np.abs(self.estimates - self.setup.truth)[self.answered]
        return np.asarray(np.mean(distance <= NORMAL_95 * self.stated_std[self.answered], axis=0))


@dataclass(frozen=True, eq=False, repr=False)
class NoiseStudy(Shown):
    """Result of `noise_study`.

    Parameters
    ----------
    scatters : tuple of Scatter
        One per setup and method.
    samples, seed : int
    backend : str
    """

    scatters: tuple[Scatter, ...]
    samples: int
    seed: int
    backend: str

    json_keys = "samples seed backend scatters"

    def of(self, method: str, mode_shape_std: float | None = None) -> Scatter:
        """Find the first scatter of a method, at one noise level if given."""
        for scatter in self.scatters:
            if scatter.method == method and mode_shape_std in (None, scatter.setup.mode_shape_std):
                return scatter
        level = "" if mode_shape_std is None else f" at mode_shape_std {mode_shape_std:g}"
        raise InputError(f"the study has no method {method!r}{level}")


def noise_study(
    setups: Sequence[Setup],
    methods: Sequence[str] = ("two-stage", "one-shot", "efficient"),
    samples: int = 2000,
    seed: int = 2023,
    *,
    backend: str = "auto",
    jobs: int = 1,
    progress: Progress | None = None,
) -> NoiseStudy:
    """Identify many noisy measurements of known frames.

    Parameters
    ----------
    setups : sequence of Setup
        For example one per noise level; `paper_setups()` returns the paper's.
    methods : sequence of str, optional
        Names as in `identify`.
    samples : int, optional
        Number of samples of each setup. With 2000, the standard error of a coefficient of variation is 1.6 % of its
        value.
    seed : int, optional
        Seed of the noise. Each setup has its own random stream, which is the same for all methods.
    backend : str, optional
        Solver for methods that solve a program per sample; two-stage and one-shot on complete data have closed
        forms for all samples at once.
    jobs : int, optional
        Number of processes for those methods, -1 for every core; the figures do not depend on it.
    progress : callable, optional
        Function of the number of finished identifications and the number of all identifications.

    Returns
    -------
    NoiseStudy

    Raises
    ------
    UnsuitableError
        If a method cannot use a setup's data.
    """
    checks.whole(samples, "samples", least=2)
    checks.whole(seed, "seed", least=0)
    for method in methods:
        checks.choice(method, METHODS, "method")
    total = len(setups) * len(methods) * samples
    scatters: list[Scatter] = []

    def advance(done: int) -> None:
        if progress is not None:
            progress(len(scatters) * samples + done, total)

    for setup, stream in zip(setups, np.random.SeedSequence(seed).spawn(len(setups)), strict=True):
        measured = setup.draw(np.random.default_rng(stream), samples)
        least = bound(setup)
        for method in methods:
            began = time.perf_counter()
            estimates, std = _estimates(setup, measured, method, backend, jobs, advance)
            scatters.append(Scatter(setup, method, estimates, std, least, time.perf_counter() - began))
    return NoiseStudy(tuple(scatters), samples, seed, backend)


def six_story_study(
    samples: int = 2000, seed: int = 2023, *, backend: str = "auto", jobs: int = 1, progress: Progress | None = None
) -> NoiseStudy:
    """Study the efficient method on incomplete data: six stories, four modes at five floors, noise on everything.

    Parameters
    ----------
    samples, seed : int, optional
    backend : str, optional
    jobs : int, optional
    progress : callable, optional
        As for `noise_study`.
    """
    return noise_study([six_story()], ("efficient",), samples, seed, backend=backend, jobs=jobs, progress=progress)


def _estimates(
    setup: Setup, measured: tuple[Floats, Floats], method: str, backend: str, jobs: int, advance: Callable[[int], None]
) -> tuple[Floats, Floats | None]:
    """Return estimates and, if the method states them, standard deviations, shape (samples, 2N) each.

    `advance` is called with the number of samples done.
    """
    frequencies, shapes = measured
    samples = len(shapes)
    both = np.full((samples, 2, 2 * setup.stories), np.nan)
    one_by_one = np.arange(samples)
    if setup.complete and method in CLOSED_FORMS:
        both[:, 0] = CLOSED_FORMS[method](shapes, frequencies, float(setup.floor_mass.sum()))
        one_by_one = np.flatnonzero(np.isnan(both[:, 0, 0]))
    before = samples - len(one_by_one)
    identified = each(
        partial(_identified, setup, method, backend),
        [(frequencies[place], shapes[place]) for place in one_by_one],
        jobs=jobs,
        progress=lambda done, _: advance(before + done),
    )
    both[one_by_one] = np.reshape(identified, (len(one_by_one), *both.shape[1:]))
    advance(samples)
    return both[:, 0], both[:, 1] if method == "efficient" else None


def _identified(setup: Setup, method: str, backend: str, measured: tuple[Floats, Floats]) -> Floats:
    """Identify masses, stiffnesses and their standard deviations from one sample, shape (2, 2N); nan if missing."""
    result = np.full((2, 2 * setup.stories), np.nan)
    try:
        (part,) = identify(setup.experiment(*measured), method, backend).parts
    except NoSolutionError:
        return result  # a row of nan counts as a sample without an answer
    found = part.frame
    result[0] = np.concatenate([found.floor_mass, found.story_stiffness])
    result[1] = np.concatenate([found.floor_mass_std, found.story_stiffness_std])
    return result


def two_stage_batch(mode_shapes: Floats, frequencies: Floats, total_mass: float) -> Floats:
    """Apply the paper's method (Eqs. 3-15 and 20-24) to S complete measurements of one configuration.

    Parameters
    ----------
    mode_shapes : ndarray, shape (S, N, N)
        One row per mode, of any scale.
    frequencies : ndarray, shape (S, N)
        Hz.
    total_mass : float
        kg.

    Returns
    -------
    ndarray, shape (S, 2N)
        Floor masses, then story stiffnesses, kg and N/m. A row is nan if a mass, in any iteration, or a stiffness is
        not positive: a bound is active in `identify` then, and the closed form differs from its answer.
    """
    samples, n, _ = mode_shapes.shape
    shapes = mode_shapes.transpose(0, 2, 1)
    mass = np.full((samples, n), total_mass / n)
    going = np.arange(samples)
    for _ in range(MOST_ITERATIONS):
        dm = _corrections(shapes[going], mass[going], total_mass)
        mass[going] += dm
        settled = np.max(np.abs(dm), axis=1) < TOLERANCE * np.max(np.abs(mass[going]), axis=1)
        # Eq. 3 needs positive masses: samples with other masses are given up.
        going = going[~settled & (mass[going] > 0).all(axis=1)]
        if not len(going):
            break
    return _with_stiffnesses(shapes, frequencies, mass)


def one_shot_batch(mode_shapes: Floats, frequencies: Floats, total_mass: float) -> Floats:
    """Compute masses from the modes' orthogonality and the total, stiffnesses from Eq. 24, as `two_stage_batch`."""
    shapes = mode_shapes.transpose(0, 2, 1)
    unit = shapes / np.linalg.norm(shapes, axis=1, keepdims=True)
    normal = pair_normal(unit, diagonal=False)
    return _with_stiffnesses(shapes, frequencies, _held_to_sum(normal, np.zeros(normal.shape[:2]), total_mass))


#: Methods that have a closed form for all complete samples at once.
CLOSED_FORMS = {"two-stage": two_stage_batch, "one-shot": one_shot_batch}


def _normalized(shapes: Floats, mass: Floats) -> Floats:
    """Normalize the shapes by Eq. 3, shape (S, N, N)."""
    return np.asarray(shapes / np.sqrt(np.sum(shapes**2 * mass[:, :, None], axis=1, keepdims=True)))


def _corrections(shapes: Floats, mass: Floats, total: float) -> Floats:
    """Compute dm of Eq. 14, shape (S, N)."""
    P = _normalized(shapes, mass)
    normal = pair_normal(P)
    side = np.sum(P**2, axis=2) - (normal @ mass[:, :, None])[:, :, 0]
    return _held_to_sum(normal, side, total - mass.sum(axis=1))


def _held_to_sum(normal: Floats, side: Floats, total: float | Floats) -> Floats:
    """Minimize x' normal x / 2 - side' x with sum x = total: the system of Eq. 14, shape (S, N)."""
    samples, n, _ = normal.shape
    # The row of ones is scaled to the matrix, so that it does not determine the pivots.
    scale = np.trace(normal, axis1=1, axis2=2) / n
    system = np.zeros((samples, n + 1, n + 1))
    system[:, :n, :n] = normal
    system[:, :n, n] = system[:, n, :n] = scale[:, None]
    right = np.concatenate([side, (scale * total)[:, None]], axis=1)
    return np.asarray(np.linalg.solve(system, right[:, :, None])[:, :n, 0])


def _with_stiffnesses(shapes: Floats, frequencies: Floats, mass: Floats) -> Floats:
    """Apply Eq. 24 to the samples with positive masses; return masses and stiffnesses."""
    positive = (mass > 0).all(axis=1)
    found = np.hstack([mass, np.full(mass.shape, np.nan)])
    X = transformation(mass.shape[1]).T @ _normalized(shapes[positive], mass[positive])
    side = np.sum(X**2 * ((2 * np.pi * frequencies[positive]) ** 2)[:, None, :], axis=2)
    found[positive, mass.shape[1] :] = np.linalg.solve(pair_normal(X), side[:, :, None])[:, :, 0]
    return np.where((found > 0).all(axis=1, keepdims=True), found, np.nan)
