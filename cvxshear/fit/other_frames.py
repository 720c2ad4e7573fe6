"""All frames that fit the same data, and the test that distinguishes them.

A frame of known masses has one frequency for each story, and the equations of these frequencies have several roots:
of three frequencies and equal floors, often two frames are exact whose stories differ by a factor of three.

**Every root.** With G = T' M^-1 T and G_S its rows and columns of the stories in S (Cauchy and Binet),

    sum over all S of j stories of det(G_S) prod_S k = e_j(lambda),        j = 1, ..., N,

e_j the elementary symmetric functions of the squared circular frequencies. These polynomials have the degrees 1 to N,
so N! roots at most (Bezout). A homotopy from k_j^j = 1 leads to each of them (Garcia and Zangwill 1979): with a random
complex factor on the start its paths do not meet. For N frequencies of known masses no path diverges, so that N!
different ends are all roots there are. A fit starts at the real part of each root that is not far from the data: a root
that is nearly real can be a frame within the noise.

**Other data.** Fits start at points drawn from the prior of the frame, until a number of fits in a row finds nothing
new.

The probability of a frame is the prior density of its logarithms (`fit/domain.py:EffectPrior`) times exp(-chi2 / 2),
relative to the sum over all frames that were found.
"""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import linalg, special

from cvxshear.backends import Backend
from cvxshear.effects import Scale
from cvxshear.fit import domain, results
from cvxshear.fit.efficient import Estimate, fitted_with
from cvxshear.fit.gauss_newton import FULL, HOPELESS, ROUGH
from cvxshear.fit.next_test import next_test
from cvxshear.model import transformation
from cvxshear.util import errors, ranking
from cvxshear.util.typing import Complexes, Floats

#: Tallest frame whose other frames are looked for: each further story multiplies their number.
TALLEST_SEARCHED = 5

#: Largest relative difference of masses and stiffnesses of one frame. Frequencies of the usual accuracy, 0.2 %, tell
#: stiffnesses no closer than this.
INSEPARABLE = 5e-3

#: Smallest likelihood of a frame that fits as well, relative to the identified one.
LEAST_LIKELIHOOD = 1e-3

#: Largest relative difference of two computed values of one root; Newton steps end at rounding.
SAME_ROOT = 1e-6


def may_have_others(estimate: Estimate) -> bool:
    """Whether the data are frequencies alone, or no more than the unknowns, and determine the frame locally."""
    experiment = estimate.experiment
    if (
        experiment.frame.turns
        or experiment.stories > TALLEST_SEARCHED
        or experiment.static
        or estimate.uncertainty.null_directions
    ):
        return False
    return estimate.dof <= 0 or not any(each.measured.any() for each in experiment.configurations)


def equivalent_fits(estimate: Estimate, backend: Backend, unsuccessful: int = 20) -> tuple[list[Estimate], str]:
    """Find the frames besides an estimate that fit the same data, with the noise of the estimate.

    Parameters
    ----------
    estimate : Estimate
        A fit, with effects or without; the search starts from other frames and from the same effects.
    backend : Backend
    unsuccessful : int, optional
        Number of fits a story, in a row, without a new frame that end the search from random points.

    Returns
    -------
    fits : list of Estimate
        Empty if the data determine one frame (`may_have_others`).
    searched : str
        What was searched, in words; empty if nothing had to be.
    """
    if not may_have_others(estimate):
        return [], ""
    n = estimate.experiment.stories
    roots, patience = _roots_of(estimate), unsuccessful * n
    searched = f"fits from random frames, until {patience} in a row found no new one"
    if roots is not None:
        searched = f"all {len(roots)} roots of the equations of {n} frequencies"
    found, since = [estimate], 0
    for start in _drawn(estimate) if roots is None else _near_real(roots, estimate):
        if since == patience and roots is None:
            break
        since += 1
        new = _another(found, np.concatenate([start, estimate.theta[2 * n :]]), backend)
        if new is not None:
            found.append(new)
            since = 0
    return found[1:], searched


def _another(found: Sequence[Estimate], theta: Floats, backend: Backend) -> Estimate | None:
    """Fit a frame from a starting point; None if it fails, hardly fits, or is one of those found."""
    n, worst = found[0].experiment.stories, found[0].chi2 - 2.0 * np.log(LEAST_LIKELIHOOD)
    # A rough fit recognizes most frames.
    for accuracy in (ROUGH, FULL):
        try:
            fit = fitted_with(found[0].misfit, theta, backend, accuracy)
        except errors.CvxshearError:
            return None
        theta = fit.theta
        apart = min(np.max(np.abs(np.log(theta[: 2 * n] / each.theta[: 2 * n]))) for each in found)
        if fit.chi2 >= worst or apart <= INSEPARABLE:
            return None
    return fit


def other_frames(estimate: Estimate, backend: Backend) -> results.OtherFrames:
    """Find the frames besides an estimate that fit the same data, their probabilities, and a test that decides.

    Parameters
    ----------
    estimate : Estimate
        A fit, with effects or without.
    backend : Backend
    """
    fits, searched = equivalent_fits(estimate, backend)
    return weighed(estimate, fits, searched) if fits else results.OtherFrames(searched=searched)


def weighed(estimate: Estimate, fits: Sequence[Estimate], searched: str) -> results.OtherFrames:
    """Weigh the frames of an estimate and of `equivalent_fits`."""
    n = estimate.experiment.stories
    mass, stiffness = (np.median(part) for part in estimate.experiment.levels(estimate.theta))
    prior = domain.EffectPrior(Scale.of(estimate.experiment, mass, stiffness))
    frames = [each.theta[: estimate.experiment.parameters] for each in (estimate, *fits)]
    priors = [np.sum(prior.residuals(each, (), {})[2][0] ** 2) for each in frames]
    shares = special.softmax([-0.5 * (each.chi2 + at) for each, at in zip((estimate, *fits), priors, strict=True)])
    others = [
        results.OtherFrame(frame[:n], frame[n:], fit.chi2, float(share))
        for frame, fit, share in zip(frames[1:], fits, shares[1:], strict=True)
    ]
    ordered = tuple(ranking.ranked(others, lambda each: each.probability))
    return results.OtherFrames(ordered, searched, next_test(estimate, fits))


def _drawn(estimate: Estimate) -> Iterator[Floats]:
    """Draw starting points from the prior of the frame, about the estimate, with its own level of the stiffness."""
    rng = np.random.default_rng(1)
    n = estimate.experiment.stories
    own = slice(0, 2 * n)
    # The changes of the logarithms that the exact priors leave free.
    free = linalg.null_space(estimate.uncertainty.equalities[:, own] * estimate.theta[own])
    width = np.repeat([domain.MASS_WIDTH, domain.STIFFNESS_WIDTH], n)
    while True:
        drawn = width * rng.standard_normal(2 * n)
        drawn[n:] -= drawn[n:].mean()
        yield estimate.theta[own] * np.exp(free @ (free.T @ drawn))


def _roots_of(estimate: Estimate) -> Complexes | None:
    """Return the roots for the first test of known masses with every frequency; None without such a test."""
    experiment, mass = estimate.experiment, estimate.experiment.frame.floor_masses
    tests = [each for each in experiment.configurations if len(each.frequencies) == experiment.stories]
    if mass is None or not tests or estimate.effects:
        return None
    return stiffness_roots(mass + tests[0].added_mass, (2 * np.pi * tests[0].frequencies) ** 2)


def _near_real(roots: Complexes, estimate: Estimate) -> Iterator[Floats]:
    """Yield the frames of the roots whose real part is not far from the data, one of each conjugate pair."""
    first = roots[:, 0].imag >= -SAME_ROOT * np.abs(roots[:, 0])
    for root in roots[first & np.all(roots.real > 0, axis=1)]:
        start = np.concatenate([estimate.theta[: estimate.experiment.stories], root.real])
        at = estimate.misfit.evaluate(start, derivatives=False)
        if at.chi2 - estimate.chi2 <= HOPELESS * len(at.r):
            yield start


def stiffness_roots(mass: Floats, eigenvalues: Floats, most_steps: int = 3000) -> Complexes | None:
    """Find every complex root of the equations of the frequencies of a frame of known masses.

    Parameters
    ----------
    mass : ndarray, shape (N,)
        kg, with the added mass.
    eigenvalues : ndarray, shape (N,)
        Squared circular frequencies, (rad/s)^2.
    most_steps : int, optional
        Largest number of steps along the paths.

    Returns
    -------
    ndarray, shape (N!, N), or None
        Story stiffnesses, N/m; None if two paths ended at one root or a path did not end, so that one may be missing.
    """
    n, unit = len(mass), np.exp(np.mean(np.log(mass)) + np.mean(np.log(eigenvalues)))
    T, degrees = transformation(n), np.arange(1, n + 1)
    G = (T.T * (np.exp(np.mean(np.log(mass))) / mass)) @ T
    member = np.array(list(itertools.product([False, True], repeat=n))[1:])
    symmetric = np.poly(-eigenvalues / np.exp(np.mean(np.log(eigenvalues))))
    sizes = member.sum(axis=1)
    factors = np.array([np.linalg.det(G[np.ix_(each, each)]) for each in member]) / symmetric[sizes]
    W = np.where(sizes == degrees[:, None], factors, 0.0)
    turn = np.exp(2j * np.pi * np.random.default_rng(0).random(n))

    def equations(x: Complexes, t: Floats) -> tuple[Complexes, Complexes, Complexes]:
        """Compute the homotopy, and its derivatives by t and by x."""
        products = np.prod(np.where(member, x[:, None], 1.0), axis=2)
        f, start = products @ W.T - 1.0, turn * (x**degrees - 1.0)
        df = (products[:, None] * W) @ member.astype(float) / x[:, None]
        dstart = (turn * degrees * x ** (degrees - 1))[:, None] * np.eye(n)
        t = t[:, None]
        return t * f + (1.0 - t) * start, f - start, t[..., None] * df + (1.0 - t[..., None]) * dstart

    def solved(J: Complexes, f: Complexes) -> Complexes:
        return np.asarray(np.linalg.solve(J, f[..., None])[..., 0])

    x = np.array(list(itertools.product(*(np.exp(2j * np.pi * np.arange(d) / d) for d in degrees))))
    t, h = np.zeros(len(x)), np.full(len(x), 1.0 / n)
    for _ in range(most_steps):
        at = np.flatnonzero(t < 1.0)
        if not len(at):
            break
        new = np.minimum(t[at] + h[at], 1.0)
        step = (new - t[at])[:, None]
        _, along, J = equations(x[at], t[at])
        middle = x[at] - 0.5 * step * solved(J, along)
        _, along, J = equations(middle, 0.5 * (t[at] + new))
        trial = x[at] - step * solved(J, along)
        sizes_of_steps = []
        for _ in range(3):
            value, _, J = equations(trial, new)
            change = solved(J, value)
            trial = trial - change
            sizes_of_steps.append(np.max(np.abs(change) / np.abs(trial), axis=1))
        kept = sizes_of_steps[-1] < SAME_ROOT
        x[at[kept]], t[at[kept]] = trial[kept], new[kept]
        h[at] *= np.where(kept, 1.5, 0.5)
    apart = np.max(np.abs(x[:, None] - x) / np.abs(x), axis=2) + np.eye(len(x))
    return x * unit if np.all(t >= 1.0) and np.min(apart) > SAME_ROOT else None
