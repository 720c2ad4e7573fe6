"""Compare evidence with nested sampling: `python -m tests.studies nested` prints the table of docs/calibration.md.

Each problem is a frame of two or three stories with noise. The study compares the difference of log Z between the shear
model and a set of effects. This module implements likelihood and priors from docs/theory/loop.md, and dynesty (Speagle
2020) integrates them. The library supplies only the fits. Their optimum and width bound the sampled box of the frame's
parameters. The study fails if a box truncates the posterior.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module

import numpy as np
from scipy import linalg, special, stats

from cvxshear import Experiment, backends
from cvxshear.effects import LocatedEffect, Place, Scale, named, open_classes
from cvxshear.fit.domain import EffectPrior
from cvxshear.fit.efficient import fitted
from cvxshear.fit.gauss_newton import Accuracy
from cvxshear.fit.misfit import Misfit
from cvxshear.loop.fitter import log_evidence

FLOOR_MASS, STORY_STIFFNESS, HEIGHT, GRAVITY = 10.0, 22e3, 0.4, 9.81
"""Typical floor mass (kg), story stiffness (N/m), story height (m) and gravity (m/s2)."""

FREQUENCY_STD, SHAPE_STD = 0.002, 0.01
MASS_WIDTH, STIFFNESS_WIDTH, NOISE_WIDTH, SIZE_WIDTH, TAIL = 1.0, 2.0, 0.7, 1.5, 4
"""Stated widths of the logarithms of floor mass, story stiffness, noise and common size; degrees of Student's t."""

REACH = 9.0
"""Half-width of the sampled box in standard deviations of the fit."""

EDGE = 0.01
"""Fraction of the box at each end that must contain at most 0.001 of the posterior."""

LIVE = 150
DRAWS, DEGREES, WIDER = 8000, 5, 1.2
"""Draws, degrees and width factor of Student's t in importance sampling; the error is a tenth of nested sampling's."""

MANY = 8
TOLERANCE = 0.05
"""Remaining log evidence at the end of nested sampling."""

SIZES = {
    "ground_spring": 0.1 * STORY_STIFFNESS, "sensor_gain": 0.05, "total_mass": 0.1, "state_stiffness": 0.1,
    "state_mass": 0.1, "story_change": 0.25, "added_mass": 0.15 * FLOOR_MASS, "other_stiffness": 0.02 * STORY_STIFFNESS,
    "other_changes": 0.1,
}  # fmt: skip
"""Stated size of each effect."""

OPEN = ("other_stiffness", "other_changes")


@dataclass(frozen=True)
class Problem:
    """Frame, its true effect, and the effect under test.

    Parameters
    ----------
    name : str
    effect : str
    at : dict
        Floor, story or state of the effect.
    true : tuple of float
        True parameters of the effect; a negative spring reaches its bound.
    stories, tests, seed : int
    undeclared : bool
        Whether the noise is undeclared.
    noise : float
        Factor on the true noise.
    """

    name: str
    effect: str
    at: dict = field(default_factory=dict)
    true: tuple[float, ...] = (0.0,)
    stories: int = 2
    tests: int = 3
    seed: int = 1
    undeclared: bool = False
    noise: float = 1.0


PROBLEMS = (
    Problem("a spring that is there", "ground_spring", {"floor": 2}, (900.0,)),
    Problem("a spring pressed on its bound", "ground_spring", {"floor": 2}, (-500.0,)),
    Problem("gravity, even on its interval", "gravity", {}, (1.15,)),
    Problem("a gain that is not there, noise undeclared", "sensor_gain", {"floor": 1}, undeclared=True),
    Problem("a spring that is there, noise undeclared and twice", "ground_spring", {"floor": 2}, (1500.0,),
            undeclared=True, noise=2.0),
    Problem("a gain of eight sizes: the tail", "sensor_gain", {"floor": 1}, (0.4,)),
    Problem("a declared total that is off", "total_mass", {}, (0.08,)),
    Problem("a state that is softer as a whole", "state_stiffness", {"state": "test 2"}, (-0.09,), 3, 2),
    Problem("the same data, its twin: a heavier state", "state_mass", {"state": "test 2"}, (1 / 0.91 - 1,), 3, 2),
    Problem("an open class: springs between all levels", "other_stiffness", {}, (1200.0, 0.0, 300.0), 3, 3),
    Problem("an open class: every story of a state", "other_changes", {"state": "test 2"}, (-0.1, 0.0, 0.15), 3, 2),
)  # fmt: skip


def parameters(problem):
    """Return the number of parameters of the effect."""
    return 3 if problem.effect in OPEN and problem.stories == 3 else 1


def matrices(problem, number, mass, stiffness, added, x):
    """Return M, K and gains of test `number`, counted from 1, for one frame."""
    n = problem.stories
    m, k, gain = mass + added, stiffness.copy(), np.ones(n)
    changed = problem.at.get("state") == f"test {number}"
    if problem.effect == "state_stiffness" and changed:
        k = k * (1 + x[0])
    if problem.effect == "other_changes" and changed:
        k = k * (1 + x)
    if problem.effect == "state_mass" and changed:
        m = mass * (1 + x[0]) + added
    if problem.effect == "gravity":
        k = k - x[0] * GRAVITY * np.cumsum(m[::-1])[::-1] / HEIGHT
    K = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    if problem.effect == "ground_spring":
        K[problem.at["floor"] - 1, problem.at["floor"] - 1] += x[0]
    if problem.effect == "sensor_gain":
        gain[problem.at["floor"] - 1] += x[0]
    if problem.effect == "other_stiffness":
        for (i, j), s in zip(((0, 2), (0, 3), (1, 3)), x, strict=True):
            d = np.zeros(n)
            d[j - 1] = 1.0
            if i:
                d[i - 1] = -1.0
            K += s * np.outer(d, d)
    return m, K, gain


def modes(m, K, gain):
    """Return frequencies and shapes, one row per mode; None if the frame is unstable."""
    if not (m.min() > 0 and np.isfinite(K).all()):
        return None
    root = np.sqrt(m)
    values, vectors = np.linalg.eigh(K / np.outer(root, root))
    if values[0] <= 0:
        return None
    return np.sqrt(values) / (2 * np.pi), (vectors / root[:, None] * gain[:, None]).T


def measured(problem):
    """Return the experiment for the library."""
    rng = np.random.default_rng(problem.seed)
    n = problem.stories
    mass, stiffness = np.array([11.0, 9.0, 10.0])[:n], np.array([24e3, 20e3, 18e3])[:n]
    added = np.zeros((problem.tests, n))
    for number in range(1, problem.tests):
        added[number, (number - 1) % n] = 0.0 if problem.effect in ("state_stiffness", "state_mass") else 3.0
    tables = []
    x = np.array(problem.true)
    if problem.effect == "state_mass":  # use the data of the equivalent problem
        stiffer = Problem("", "state_stiffness", problem.at, stories=n)
    for number, extra in enumerate(added, 1):
        own = matrices(problem, number, mass, stiffness, extra, x)
        if problem.effect == "state_mass":
            own = matrices(stiffer, number, mass, stiffness, extra, np.array([-0.09]))
        f, shapes = modes(*own)
        shapes = shapes / np.max(np.abs(shapes), axis=1, keepdims=True)
        tables.append({
            "name": f"test {number}",
            "added_mass": extra.tolist(),
            "frequencies": (f * np.exp(problem.noise * FREQUENCY_STD * rng.standard_normal(n))).tolist(),
            "mode_shapes": (shapes + problem.noise * SHAPE_STD * rng.standard_normal((n, n))).tolist(),
            **({} if problem.undeclared else {"frequency_std": FREQUENCY_STD, "mode_shape_std": SHAPE_STD}),
        })  # fmt: skip
    total = float(mass.sum()) / (1 + (problem.true[0] if problem.effect == "total_mass" else 0.0))
    frame = {"stories": n, "total_mass": total, "story_heights": [HEIGHT] * n, "gravity": GRAVITY}
    return Experiment.from_dict({"frame": frame, "configuration": tables})


class Integrand:
    """Likelihood times prior of all free parameters, on a unit cube."""

    def __init__(self, problem, of, estimate, *, with_effect):
        self.problem, self.of, self.with_effect = problem, of, with_effect
        n = self.n = problem.stories
        self.basis = linalg.null_space(np.ones((1, n)))
        theta, std = estimate.theta, estimate.std
        width = REACH * np.max(std[:n]) / FLOOR_MASS
        self.center = np.concatenate([self.basis.T @ theta[:n] / FLOOR_MASS, theta[n : 2 * n] / STORY_STIFFNESS])
        self.half = np.concatenate([np.full(n - 1, width), REACH * std[n : 2 * n] / STORY_STIFFNESS])
        self.own = parameters(problem) if with_effect else 0
        self.open = with_effect and problem.effect in OPEN
        self.frame = 2 * n - 1
        self.dims = self.frame + self.own + self.open + 2 * problem.undeclared

    def transform(self, u):
        """Map the unit cube to the frame (uniform in its box) and the other parameters (by their priors)."""
        z = np.empty(self.dims)
        z[: self.frame] = self.center + (2 * u[: self.frame] - 1) * self.half
        own = slice(self.frame, self.frame + self.own)
        last = own.stop
        if self.open:
            z[last] = SIZE_WIDTH * special.ndtri(u[last])
            z[own] = SIZES[self.problem.effect] * np.exp(z[last]) * special.ndtri(u[own])
            last += 1
        elif self.own and self.problem.effect == "gravity":
            z[own] = 1.0 + 0.2 * u[own]
        elif self.own:
            half = self.problem.effect == "ground_spring"
            z[own] = SIZES[self.problem.effect] * special.stdtrit(TAIL, 0.5 + u[own] / 2 if half else u[own])
        z[last:] = NOISE_WIDTH * special.ndtri(u[last:])
        return z

    def value(self, z):
        """Return the logarithm of likelihood times the frame's prior, divided by the density in the box."""
        n, problem = self.n, self.problem
        x = z[self.frame : self.frame + self.own] if self.with_effect else np.zeros(parameters(problem))
        total = self.of.frame.total_mass * (1 + (x[0] if problem.effect == "total_mass" else 0.0))
        mass = total / n + FLOOR_MASS * self.basis @ z[: n - 1]
        stiffness = STORY_STIFFNESS * z[n - 1 : self.frame]
        if mass.min() <= 0 or stiffness.min() <= 0:
            return -1e300
        logs = np.log(mass / FLOOR_MASS), np.log(stiffness / STORY_STIFFNESS)
        result = np.sum(np.log(2 * self.half)) - sum(each.sum() for each in logs)
        about_mean = logs[1] - np.mean(logs[1])
        result -= 0.5 * (np.sum((logs[0] / MASS_WIDTH) ** 2) + np.sum((about_mean / STIFFNESS_WIDTH) ** 2))
        u = z[-2:] if problem.undeclared else np.zeros(2)
        for number, each in enumerate(self.of.configurations, 1):
            found = modes(*matrices(problem, number, mass, stiffness, each.added_mass, x))
            if found is None:
                return -1e300
            f, shapes = found
            seen = each.mode_shapes
            scale = np.sum(shapes * seen, axis=1) / np.sum(shapes**2, axis=1)
            std = SHAPE_STD * np.max(np.abs(seen), axis=1)[:, None]
            chi2 = np.sum((np.log(f / each.frequencies) / FREQUENCY_STD) ** 2) * np.exp(-2 * u[0])
            chi2 += np.sum(((scale[:, None] * shapes - seen) / std) ** 2) * np.exp(-2 * u[1])
            # A free scale uses one entry of each shape.
            result -= 0.5 * chi2 + n * u[0] + n * (n - 1) * u[1]
        return float(result) if np.isfinite(result) else -1e300


def sampled(integrand, seed, live=LIVE, draws=DRAWS):
    """Return log Z and its error by nested sampling, then by importance sampling around its points."""
    dynesty = import_module("dynesty")
    rng = np.random.default_rng(seed)
    # In many dimensions, uniform draws from a bound are inefficient. A random walk is not.
    how = {"bound": "multi", "sample": "rwalk" if integrand.dims >= MANY else "unif"}
    sampler = dynesty.NestedSampler(integrand.value, integrand.transform, integrand.dims, nlive=live, rstate=rng, **how)
    sampler.run_nested(dlogz=TOLERANCE, print_progress=False)
    result = sampler.results
    weights = np.exp(result.logwt - result.logz[-1])
    weights /= weights.sum()
    cube = np.abs(result.samples_u[:, : integrand.frame] - 0.5)
    outside = float(weights @ (cube > 0.5 - EDGE).any(axis=1))
    assert outside < 1e-3, f"the box cuts off {outside:.2g} of the posterior of {integrand.problem.name!r}"
    nested = float(result.logz[-1]), float(result.logzerr[-1])
    return nested, reweighted(integrand, stats.norm.ppf(result.samples_u), weights, rng, draws)


def reweighted(integrand, points, weights, rng, draws=DRAWS):
    """Return log Z by importance sampling from Student's t around weighted points, in normal coordinates."""
    center = weights @ points
    spread = WIDER * ((points - center).T * weights) @ (points - center)
    law = stats.multivariate_t(center, spread, df=DEGREES)
    v = law.rvs(draws, random_state=rng)
    logs = np.array([integrand.value(integrand.transform(u)) for u in stats.norm.cdf(v)])
    logs += stats.norm.logpdf(v).sum(axis=1) - law.logpdf(v)
    ratios = np.exp(logs - logs.max())
    return float(logs.max() + np.log(ratios.mean())), float(ratios.std() / ratios.mean() / np.sqrt(draws))


def fits(problem, of):
    """Return the library's fits of the shear model and of the set with the effect, and its prediction."""
    effects = {effect.name: effect for effect in open_classes()}
    effect = effects.get(problem.effect) or named([problem.effect])[0]
    place = Place(**problem.at)
    placed = LocatedEffect(effect.bound(of).bound_at(of, place), place)
    expectation = EffectPrior(Scale(FLOOR_MASS, STORY_STIFFNESS, np.full(problem.stories, HEIGHT)))
    n = problem.stories
    start = np.concatenate([np.full(n, of.frame.total_mass / n), np.full(n, STORY_STIFFNESS)])
    backend = backends.get("auto")
    without = fitted(Misfit(of, (), expectation=expectation), start, backend, Accuracy(1e-9))
    start = np.concatenate([without.theta, placed.start])
    return without, fitted(Misfit(of, (placed,), expectation=expectation), start, backend, Accuracy(1e-9)), expectation


def compared(problem, live=LIVE, seed=1, draws=DRAWS):
    """Return the difference of log Z by the library, then value and error by nested and by importance sampling."""
    of = measured(problem)
    without, with_effect, expectation = fits(problem, of)
    found = log_evidence(with_effect, expectation) - log_evidence(without, expectation)
    plain = sampled(Integrand(problem, of, without, with_effect=False), seed, live, draws)
    full = sampled(Integrand(problem, of, with_effect, with_effect=True), seed + 1, live, draws)
    nested, refined = ((b[0] - a[0], float(np.hypot(a[1], b[1]))) for a, b in zip(plain, full, strict=True))
    return found, nested, refined


def main():
    print("| problem | log Z over that of the shear model | nested sampling | importance sampling | difference |")
    print("|---|---|---|---|---|")
    for problem in PROBLEMS:
        found, nested, refined = compared(problem)
        others = " | ".join(f"{value:.2f} ± {error:.2f}" for value, error in (nested, refined))
        print(f"| {problem.name} | {found:.2f} | {others} | {found - refined[0]:+.2f} |", flush=True)


if __name__ == "__main__":
    main()
