"""Where the efficient estimator starts: masses and stiffnesses from the story equations, linear in both.

Above story i the inertia forces of a mode are carried by that story,

    k_i (phi_i - phi_(i-1)) - lambda sum over l >= i of m_l phi_l = lambda sum over l >= i of a_l phi_l,

with a the added mass. Every mode of every configuration gives N such rows for the 2N unknowns. Floors
without a sensor are filled in from the modes of the model found so far.
"""

from __future__ import annotations

import numpy as np

from cvxshear import backends
from cvxshear.fit.domain import spread
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model.shear import Modes, mass_matrix, modes, stiffness_matrix, transformation
from cvxshear.programs import LeastSquares
from cvxshear.programs.statements import constrained, statements
from cvxshear.util.errors import CvxshearError, InputError
from cvxshear.util.typing import Floats

ROUNDS = 6
SMALLEST = 0.05
"""Smallest start of a mass or stiffness, as a part of their mean: a start at zero is none."""

TAPERS = (0.2, 0.4, 0.6, 0.8)
"""Parts of the bottom story's stiffness by which the top story's is smaller."""


def starts(experiment: Experiment) -> list[Floats]:
    """Starting points theta, each of shape (2N,), masses and stiffnesses positive.

    Design values of both, those that priors suggest, where there are any; the story equations; and frames of equal
    masses, of uniform stiffness and of the stiffness that falls with height as the ratios of the frequencies say.
    """
    even = uniform(experiment)
    points = []
    theta = even
    for _ in range(1 if all(each.complete for each in experiment.configurations) else ROUNDS):
        try:
            theta = _from_story_equations(experiment, theta)
        except CvxshearError:
            break
        points.append(theta)
    return [*_nominal(experiment), *points[-1:], even, _tapered(experiment)]


def _tapered(experiment: Experiment) -> Floats:
    """The frame of `uniform` whose taper suits the frequencies best."""
    return min((uniform(experiment, taper) for taper in TAPERS), key=lambda theta: _frequency_misfit(experiment, theta))


def _frequency_misfit(experiment: Experiment, theta: Floats) -> float:
    """Sum of the squared errors of the logarithms of the frequencies."""
    n = experiment.stories
    return sum(
        float(np.sum(_log_eigenvalue_ratios(each, theta[:n], theta[n:]) ** 2)) for each in experiment.configurations
    )


def _log_eigenvalue_ratios(configuration: Configuration, mass: Floats, stiffness: Floats) -> Floats:
    """log(measured / modelled) of the eigenvalues."""
    found = modes(mass_matrix(mass + configuration.added_mass), stiffness_matrix(stiffness))
    measured = (2 * np.pi * configuration.frequencies) ** 2
    return np.log(measured / found.eigenvalues[configuration.modes - 1])


def _nominal(experiment: Experiment) -> list[Floats]:
    """The design values of masses and stiffnesses, where both are declared, at the right mean frequency."""
    values = {}
    for prior in experiment.priors:
        suggested = prior.suggested(experiment.stories)
        if suggested is not None and not np.any(np.isnan(suggested)):
            values[prior.quantity] = suggested
    if len(values) < 2:
        return []
    mass, stiffness = values["floor_mass"], values["story_stiffness"]
    known = experiment.frame.known_total
    if known is not None:
        mass = mass * known / mass.sum()
    return [np.concatenate([mass, stiffness * _frequency_factor(experiment, mass, stiffness)])]


def _frequency_factor(experiment: Experiment, mass: Floats, stiffness: Floats) -> float:
    """By how much the stiffnesses must be multiplied for the mean logarithm of the frequencies to be right."""
    ratios = [np.mean(_log_eigenvalue_ratios(each, mass, stiffness)) for each in experiment.configurations]
    return float(np.exp(np.mean(ratios)))


def uniform(experiment: Experiment, taper: float = 0.0) -> Floats:
    """A frame of equal masses and of stiffnesses that fall by `taper` to the top, at the right first frequency."""
    n = experiment.stories
    frame = experiment.frame
    shape = 1.0 - taper * np.arange(n) / max(n - 1, 1)
    known = frame.known_total
    mass = np.full(n, (known if known is not None else _guessed_total(experiment)) / n)
    if frame.floor_masses is not None:
        mass = frame.floor_masses.copy()
    for prior in experiment.priors:
        suggested = prior.suggested(n)
        if prior.quantity == "floor_mass" and prior.fixes_scale and known is None and suggested is not None:
            mass = np.where(np.isnan(suggested), np.nanmean(suggested), suggested)
    return np.concatenate([mass, shape * _frequency_factor(experiment, mass, shape)])


def _guessed_total(experiment: Experiment) -> float:
    """A total mass where none is declared: that of the scaled shapes, else the added mass itself."""
    for each in experiment.configurations:
        if each.mass_normalized and each.measured.any():
            known = each.mode_shapes[each.measured.any(axis=1)]
            return float(experiment.stories / np.mean(np.nanmax(known**2, axis=1)))
    return float(np.max([each.added_mass.sum() for each in experiment.configurations])) or 1.0


def _from_story_equations(experiment: Experiment, theta: Floats) -> Floats:
    """One least-squares program for all masses and stiffnesses, shapes filled in by the model at theta."""
    n = experiment.stories
    mass, stiffness = theta[:n], theta[n:]
    rows, sides = [], []
    for each in experiment.configurations:
        model = modes(mass_matrix(mass + each.added_mass), stiffness_matrix(stiffness))
        for j in range(len(each.frequencies)):
            phi = filled(each, j, model)
            lam = (2 * np.pi * each.frequencies[j]) ** 2
            above = np.triu(np.broadcast_to(phi, (n, n)))
            drifts = np.diag(transformation(n).T @ phi)
            weight = 1.0 / (lam * np.linalg.norm(phi) * mass.mean())
            rows.append(weight * np.hstack([-lam * above, drifts]))
            sides.append(weight * lam * (above @ each.added_mass))
    ridge = 1e-6 / theta
    program = LeastSquares(
        R=np.concatenate([*rows, np.diag(ridge)]), s=np.concatenate([*sides, ridge * theta]),
    )  # fmt: skip
    on_mass = statements(experiment.priors, "floor_mass", n, experiment.frame)
    on_stiffness = statements(experiment.priors, "story_stiffness", n)
    x = backends.get("auto").solve(constrained(program, spread(on_mass, on_stiffness, n, 2 * n), np.zeros(2 * n))).x
    m, k = x[:n], x[n:]
    if m.mean() <= 0 or k.mean() <= 0:
        raise InputError("the story equations have no solution of positive masses and stiffnesses")
    return np.concatenate([np.maximum(m, SMALLEST * m.mean()), np.maximum(k, SMALLEST * k.mean())])


def filled(configuration: Configuration, j: int, model: Modes) -> Floats:
    """Mode j at every floor, shape (N,): what was measured, and between it what the model's modes make of it.

    The measured entries are expanded in the model's modes nearest to mode j, half as many as there are entries.
    """
    n = len(model.eigenvalues)
    known = configuration.measured[j]
    floors = configuration.measured_floors[known] - 1
    own = int(configuration.modes[j]) - 1
    if not len(floors):
        alone: Floats = model.shapes[own]
        return alone
    count = max(1, len(floors) // 2)
    near = np.argsort(np.abs(np.arange(n) - own), kind="stable")[:count]
    values = configuration.mode_shapes[j, known]
    share = np.linalg.lstsq(model.shapes[np.ix_(near, floors)].T, values, rcond=None)[0]
    phi: Floats = share @ model.shapes[near]
    phi[floors] = values
    return phi
