"""Standardized residuals of all data, soft priors and parameter priors together, their derivatives, and the noise.

Each residual is divided by its standard deviation. An undeclared standard deviation is a factor on a default, estimated
with the rest: one factor for each kind of noise, and one for the common size of an effect with many parameters.

**A test that was not made** is a configuration that is measured at every floor exactly as a model predicts, so the data
themselves (`cvxshear.data`) give its rows: derivatives by the parameters, or differences from another model, in
standard deviations of the test's noise. Sensors at some floors choose among these rows; the free scale of each shape is
eliminated over the floors that have a sensor. `plan` adds these rows to the information about a frame. `next_test`
compares two fits by the distance of their predictions (`fit/gaussian.py`).
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import optimize

from cvxshear import data
from cvxshear.data.base import numbered
from cvxshear.effects import LocatedEffect, composition
from cvxshear.fit.domain import EffectPrior
from cvxshear.fit.gaussian import LARGEST_LOG_CHANGE, SizeMarginal, UnknownSize
from cvxshear.fit.optimality import PlainResiduals
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.programs import turning
from cvxshear.util import decorators, errors
from cvxshear.util.typing import Bools, Floats, Ints, Json

#: Standard deviation of the logarithm of the factor on a default standard deviation: two thirds of all tests lie
#: between half and twice the default, nineteen in twenty between a quarter and four times.
WIDTH = 0.7


@dataclass(frozen=True, eq=False)
class Evaluation(PlainResiduals):
    """Residuals at one point.

    Parameters
    ----------
    r : ndarray, shape (d,)
        Model minus measurement in standard deviations: data and soft priors, then the priors of the effects, then the
        prior of the frame.
    J : ndarray, shape (d, P)
        dr/dtheta; without rows if derivatives were not requested.
    models : tuple of data.Model
        One per tested state.
    measured, known : int
        Number of rows of data and soft priors; the same with the priors of the effects.
    blocks : tuple of int
        Rows of each datum, in the order of `Misfit.data`.
    unknown : ndarray of int, shape (d,)
        For each row with an estimated standard deviation its place in `Misfit.unknown`, -1 for the others.
    """

    models: tuple[data.Model, ...]
    measured: int
    known: int
    blocks: tuple[int, ...]
    unknown: Ints

    @property
    def chi2(self) -> float:
        """Sum of squares of the residuals of data and soft priors."""
        return float(self.r[: self.measured] @ self.r[: self.measured])

    def of_a_result(self) -> Evaluation:
        """Return the same with models that hold no derivatives of their matrices."""
        changed = copy.copy(self)
        changed.__dict__["models"] = tuple(model.without_derivatives() for model in self.models)
        return changed

    @decorators.cached_property
    def known_triangle(self) -> Floats:
        """The triangular factor of J without the prior of the frame."""
        return np.asarray(np.linalg.qr(self.J[: self.known], mode="r"))


class Misfit:
    """The residuals of an experiment under a model with these effects.

    Parameters
    ----------
    experiment : Experiment
    effects : sequence of LocatedEffect
    leave_out : array of bool for each configuration, optional
        Modes of a configuration that do not count, by its name.
    noise : data.NoiseFactors, optional
        Factors on the default standard deviations of undeclared noise.
    expectation : EffectPrior, optional
        Priors of the effects and of the frame. Default: none.
    noise_inflation : float, optional
        Factor on all standard deviations of the data, declared ones too, for a residual without explanation.
    held : ndarray, shape (P, k), optional
        Directions that a fit holds (`fit.domain.domain_of`).
    """

    def __init__(
        self,
        experiment: Experiment,
        effects: Sequence[LocatedEffect] = (),
        leave_out: dict[str, Bools] | None = None,
        noise: data.NoiseFactors | None = None,
        expectation: EffectPrior | None = None,
        noise_inflation: float = 1.0,
        held: Floats | None = None,
    ) -> None:
        self.experiment = experiment
        self.effects = tuple(effects)
        self.leave_out = leave_out or {}
        self.noise = noise or data.NoiseFactors()
        self.expectation = expectation or EffectPrior()
        self.noise_inflation = noise_inflation
        self.held = held
        self.data = [
            datum.without(self.leave_out[datum.tested.name]) if datum.tested.name in self.leave_out else datum
            for datum in data.data_of(experiment)
        ]

    def replaced(
        self,
        effects: Sequence[LocatedEffect] | None = None,
        noise: data.NoiseFactors | None = None,
        noise_inflation: float | None = None,
    ) -> Misfit:
        """Return the same data with other effects, another noise, or another noise inflation."""
        return Misfit(
            self.experiment,
            self.effects if effects is None else effects,
            self.leave_out,
            noise or self.noise,
            self.expectation,
            self.noise_inflation if noise_inflation is None else noise_inflation,
            self.held,
        )

    def holding(self, held: Floats) -> Misfit:
        """Return the same data with other directions held, or none."""
        changed = copy.copy(self)
        changed.held = held if held.size else None
        return changed

    @property
    def parameters(self) -> int:
        """Number P of parameters: floor masses, story stiffnesses and parameters of the effects."""
        return self.experiment.parameters + sum(len(placed.effect.parameters) for placed in self.effects)

    @decorators.cached_property
    def unknown(self) -> tuple[UnknownSize, ...]:
        """Every standard deviation that is estimated with the rest: of kinds of noise, then of effects."""
        counts = dict.fromkeys(data.noise_kinds(), 0.0)
        rescaled = {placed.label: 0.0 for placed in self.effects if placed.effect.rescales}
        for datum, (keys, which) in zip(self.data, self._keys, strict=True):
            # The free scale of each mode takes the same share from the rows of both noises.
            share = datum.count / max(datum.entries, 1)
            for place, key in enumerate(keys):
                if key:
                    into = rescaled if key in rescaled else counts
                    into[key] += share * int(np.sum((which == place) & datum.known))
        noises = [UnknownSize(key, count, WIDTH) for key, count in counts.items() if count]
        sizes = [
            UnknownSize(
                placed.label,
                rescaled.get(placed.label, len(placed.effect.parameters)),
                placed.effect.size_width,
                placed.effect.rescales,
            )
            for placed in self.effects
            if placed.effect.common_size and not placed.fixed
        ]
        return (*noises, *sizes)

    @property
    def noises(self) -> dict[str, data.NoiseKind]:
        """The noise of each kind of the data, by its name."""
        return {datum.noise.name: datum.noise for datum in self.data}

    @property
    def open_noises(self) -> dict[str, float]:
        """The undeclared kinds of noise, each with its number of data."""
        return {item.key: item.count for item in self.unknown if item.key in self.noises}

    def rescaled_rows(self, at: Evaluation, placed: LocatedEffect) -> Bools:
        """Return the rows of an evaluation whose standard deviation an effect leaves open, shape (d,)."""
        found = np.zeros(len(at.r), dtype=bool)
        found[: sum(at.blocks)] = np.concatenate([self._rescaled(datum, placed) for datum in self.data])
        return found

    def _rescaled(self, datum: data.Datum, placed: LocatedEffect) -> Bools:
        """Return the rows of a datum whose standard deviation an effect leaves open."""
        return placed.effect.rescaled(datum.tested, datum.noise.name, datum.floors, placed.place)

    @decorators.cached_property
    def _keys(self) -> list[tuple[list[str], Ints]]:
        """Keys of the factors on the standard deviations of each datum, and the key of each of its rows.

        A key is empty if the standard deviation is declared.
        """
        found = []
        for datum in self.data:
            keys, which = ["" if datum.declared else datum.noise.name], np.zeros(len(datum.floors), dtype=np.int64)
            for placed in self.effects:
                if placed.effect.rescales:
                    which[self._rescaled(datum, placed)] = len(keys)
                    keys.append(placed.label)
            found.append((keys, which))
        return found

    def count(self, theta: Floats) -> int:
        """Count the data, soft priors included."""
        return sum(datum.count for datum in self.data) + len(self._soft(theta)[0])

    def evaluate(self, theta: Floats, *, derivatives: bool = True) -> Evaluation:
        """Compute the residuals and their derivatives.

        Parameters
        ----------
        theta : ndarray, shape (P,)
            Floor masses without added mass, story stiffnesses, effect parameters.
        derivatives : bool, optional

        Raises
        ------
        NoModesError
            If the model has no modes there: a mass is not positive, or the frame buckles.
        """
        if np.any(theta[self.experiment.positive] <= 0):
            raise errors.NoModesError("floor masses and story stiffnesses must be positive")
        models = {}
        for each in self.experiment.tested:
            state = composition.compose(self.experiment, each, self.effects, theta, derivatives=derivatives)
            models[id(each)] = data.Model(state, slice(None), derivatives)
        places, of_data, factors = self._deviations
        parts, rows = [np.zeros(0)], []
        for datum, factor in zip(self.data, factors, strict=True):
            found = datum.inflated_residual(models[id(datum.tested)], factor)
            parts.append(found.r)
            rows.append(found.J)
        soft = self._soft(theta)
        expected, expected_keys, frame = self.expectation.residuals(theta, self.effects, dict(self.noise.factors))
        more_keys = [""] * len(soft[0]) + expected_keys + [""] * len(frame[0])
        unknown = [*of_data, np.array([places.get(key, -1) for key in more_keys], dtype=np.int64)]
        r = np.concatenate([*parts, soft[0], expected[0], frame[0]])
        measured = len(r) - len(expected[0]) - len(frame[0])
        more = [part[1] for part in (soft, expected, frame)]
        return Evaluation(
            r,
            np.concatenate([*rows, *more]) if derivatives else np.zeros((0, len(theta))),
            tuple(models.values()),
            measured,
            len(r) - len(frame[0]),
            tuple(len(part) for part in parts[1:]),
            np.concatenate(unknown),
        )

    def slopes_by(self, theta: Floats, further: Sequence[LocatedEffect]) -> Floats:
        """Compute the derivatives of data and soft priors by the parameters of further effects, at their null values.

        Parameters
        ----------
        theta : ndarray, shape (P,)
        further : sequence of LocatedEffect
            Effects with p parameters.

        Returns
        -------
        ndarray, shape (measured, p)
        """
        more, by = self.replaced((*self.effects, *further)), slice(len(theta), None)
        theta = np.concatenate([theta, [item.null for placed in further for item in placed.effect.parameters]])
        models = {
            id(each): data.Model(composition.compose(self.experiment, each, more.effects, theta), by, derivatives=True)
            for each in self.experiment.tested
            if any(placed.acts_on(each) for placed in further)
        }
        rows = [
            datum.inflated_residual(models[id(datum.tested)], factor).J
            if id(datum.tested) in models
            else np.zeros((len(factor), more.parameters - self.parameters))
            for datum, factor in zip(more.data, more._deviations[2], strict=True)
        ]
        return np.concatenate([*rows, more._soft(theta)[1][:, by]])

    @decorators.cached_property
    def _deviations(self) -> tuple[dict[str, int], list[Ints], list[Floats]]:
        """Places of the unknown standard deviations by their keys; places and factors of each datum's rows."""
        places = {item.key: place for place, item in enumerate(self.unknown)}
        # Shapes of a single sensor have neither a declared deviation nor information about it.
        unknown = [np.array([places.get(key, -1) for key in keys])[which] for keys, which in self._keys]
        factors = [
            np.array([self.noise_inflation * self.noise.of(key) for key in keys])[which] for keys, which in self._keys
        ]
        return places, unknown, factors

    def statement_deviations(self, theta: Floats) -> list[data.Deviation]:
        """How far each soft prior, and a soft total mass, lies from the model, in its own standard deviations.

        An effect that releases a prior does not count.
        """
        plain = Misfit(self.experiment)
        residuals, at = plain._soft(theta[: self.experiment.parameters])[0], 0
        found = []
        for words, rows in self.experiment.soft_statements:
            own = residuals[at : at + rows]
            at += rows
            if rows:
                size = float(own[0]) if rows == 1 else float(np.sqrt(np.mean(own**2)))
                found.append(data.Deviation("prior", "", words, None, size, rows))
        return found

    def _soft(self, theta: Floats) -> tuple[Floats, Floats]:
        """Write the soft priors, and a total mass declared with a standard deviation, as data; last of a plan."""
        n = self.experiment.stories
        residuals, rows = [np.zeros(0)], [np.zeros((0, len(theta)))]
        frame = self.experiment.frame
        if frame.total_mass_std is not None and frame.total_mass is not None:
            unit = 1.0 / (frame.total_mass_std * frame.total_mass)
            of_masses = np.zeros(len(theta))
            of_masses[self.experiment.of_masses] = unit
            residuals.append(np.array([of_masses @ theta - unit * frame.total_mass]))
            rows.append(of_masses[None])
        for prior in self.experiment.priors:
            at = self.experiment.of_masses if prior.quantity == "floor_mass" else self.experiment.of_stories
            r, J = prior.residual(theta[at])
            row = np.zeros((len(r), len(theta)))
            row[:, at] = J
            residuals.append(r)
            rows.append(row)
        if frame.plan is not None:
            of_plan = np.zeros((n, len(theta)))
            of_plan[:, self.experiment.of_floors] = turning.plan_rows(self.experiment)
            residuals.append(of_plan @ theta)
            rows.append(of_plan)
        for placed, own in composition.slices(self.effects, self.experiment.parameters):
            # A test that is only imagined has no priors that could be wrong.
            if placed.place.prior in self._statements and "prior" not in placed.effect.releases:
                at_prior = 1 + self._statements.index(placed.place.prior)
                residuals[at_prior] = residuals[at_prior] - theta[own]
                rows[at_prior][:, own] -= np.eye(own.stop - own.start)
        return np.concatenate(residuals), np.concatenate(rows)

    @decorators.cached_property
    def _statements(self) -> list[str]:
        """The soft total mass and the priors in words, in the order of their rows."""
        return [words for words, _ in self.experiment.soft_statements]


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Factors on the default standard deviations of undeclared noise.

    Parameters
    ----------
    kinds : tuple of str
        Names of noises, then labels of effects whose common size is unknown.
    log_factors : ndarray, shape (g,)
    covariance : ndarray, shape (g, g)
        Covariance of the logarithms.
    gain : float
        log p(data, u) of the linearized fit, u integrated out, without -objective / 2 - log det H / 2 of that fit.
    settled : bool
        Whether the fit was made with these factors.
    """

    kinds: tuple[str, ...] = ()
    log_factors: Floats = field(default_factory=lambda: np.zeros(0))
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    gain: float = 0.0
    settled: bool = True

    @property
    def noise(self) -> data.NoiseFactors:
        """The factors."""
        return data.NoiseFactors(tuple(zip(self.kinds, np.exp(self.log_factors).tolist(), strict=True)))

    def to_dict(self) -> Json:
        """Return for each kind its factor and the factor's standard deviation; null if declared."""
        return {kind: self.of(kind) for kind in data.noise_kinds()}

    def of(self, key: str) -> Json | None:
        """Return the factor of a noise or of an effect's size, and its standard deviation; None if declared."""
        if key not in self.kinds:
            return None
        at = self.kinds.index(key)
        factor = float(np.exp(self.log_factors[at]))
        return {"factor": factor, "std": factor * float(np.sqrt(self.covariance[at, at]))}


@dataclass(frozen=True, eq=False)
class NoiseAtFit:
    """Undeclared noise of a fit, in the linear model about it.

    Parameters
    ----------
    kinds : tuple of str
        As in `NoiseEstimate`.
    marginal : SizeMarginal
        log p(data, v), v the normal variables of the factors.
    v : ndarray, shape (g,)
        Its maximum.
    """

    kinds: tuple[str, ...]
    marginal: SizeMarginal
    v: Floats

    @staticmethod
    def of(misfit: Misfit, at: Evaluation, free: Floats) -> NoiseAtFit:
        """Find the most probable factors.

        Parameters
        ----------
        misfit : Misfit
            Misfit with the noise of the fit.
        at : Evaluation
            At its optimum.
        free : ndarray, shape (P, f)
            Free directions of the parameters, each of unit effect on the residuals.
        """
        factors = [misfit.noise.of(item.key) for item in misfit.unknown]
        rows = [at.unknown == place for place in range(len(misfit.unknown))]
        marginal = SizeMarginal(
            misfit.unknown,
            factors,
            [at.J[own] @ free for own in rows],
            [at.r[own] for own in rows],
            free.T @ (at.J.T @ at.r),
        )
        best = optimize.minimize(marginal.negative, marginal.start, jac=True, method="BFGS").x
        # A marginal without maximum makes the search diverge.
        v: Floats = np.clip(best, -LARGEST_LOG_CHANGE, LARGEST_LOG_CHANGE)
        return NoiseAtFit(tuple(item.key for item in misfit.unknown), marginal, v)

    @property
    def factors(self) -> tuple[tuple[str, float], ...]:
        """The most probable factor of each kind."""
        return tuple(zip(self.kinds, np.exp(self.marginal.log_factors(self.v)[0]).tolist(), strict=True))

    def estimate(self) -> NoiseEstimate:
        """Estimate the factors and their covariance, and integrate over them."""
        covariance, u, spread = self._spread(self.v)
        return NoiseEstimate(self.kinds, u, spread, self.marginal.log_integral(self.v, covariance))

    def unsettled(self) -> NoiseEstimate:
        """Keep the factors of the fit: the maximum is outside the range of the linear model."""
        v = self.marginal.start
        covariance, u, spread = self._spread(v)
        local = -self.marginal.negative(v)[0] + 0.5 * float(np.linalg.slogdet(covariance)[1])
        local -= float(np.sum(np.log(self.marginal.widths)))
        return NoiseEstimate(self.kinds, u, spread, local, settled=False)

    def _spread(self, v: Floats) -> tuple[Floats, Floats, Floats]:
        """Covariance of v; logarithms of the factors and their covariance."""
        covariance: Floats = np.asarray(np.linalg.inv(self.marginal.curvature(v)), dtype=np.float64)
        u, slope = self.marginal.log_factors(v)
        return covariance, u, slope[:, None] * covariance * slope


@dataclass(frozen=True, eq=False)
class ExpectedTest:
    """A test that was not made, and rows of its data.

    Parameters
    ----------
    test : Configuration
        Measured at every floor as the model predicts, with the noise of the test.
    rows : ndarray, shape (m + m N, k)
        Columns in standard deviations: frequencies, then the entries of each shape.
    seen : ndarray of bool, shape (m, N)
        Entries that a sensor at their floor would show.
    free_scale : bool
        Whether the scales of the shapes are free.
    """

    test: Configuration
    rows: Floats
    seen: Bools
    free_scale: bool = True

    @property
    def entries(self) -> Floats:
        """Derivatives of the entries by the logarithm of their mode's scale, in standard deviations, shape (m, N)."""
        return self.test.entry_weights * self.test.mode_shapes

    @property
    def frequency_rows(self) -> Floats:
        """Rows of the frequencies, shape (m, k)."""
        return self.rows[: len(self.test.frequencies)]

    @property
    def shape_rows(self) -> Floats:
        """Rows of the entries, shape (m, N, k)."""
        return self.rows[len(self.test.frequencies) :].reshape(*self.seen.shape, -1)

    def at(self, floors: Ints) -> Floats:
        """Return the rows of a test with sensors at these floors, zero-based, free of the free scales."""
        here = np.isin(np.arange(self.seen.shape[1]), floors) & self.seen
        entries, rows = np.where(here, self.entries, 0.0), self.shape_rows
        if self.free_scale:
            length = np.linalg.norm(entries, axis=1, keepdims=True)
            unit = entries / np.where(length > 0, length, 1.0)
            rows = rows - unit[:, :, None] * np.einsum("mj,mjk->mk", unit, rows)[:, None]
        return np.concatenate([self.frequency_rows, rows[here]])


def tested_model(
    experiment: Experiment, test: Configuration, effects: Sequence[LocatedEffect], theta: Floats
) -> data.Model:
    """Return the model of a test.

    Raises
    ------
    NoModesError
        If the model buckles under the test's masses.
    """
    return data.Model(composition.compose(experiment, test, effects, theta), slice(None), derivatives=True)


def predicted_modes(test: Configuration, model: data.Model) -> tuple[Floats, Floats]:
    """Return the frequencies, shape (m,), of a test's modes, and the shapes as sensors on every floor see them, (m, N).

    The modes have the test's numbers, whatever shapes it measured.
    """
    which = numbered(test, model.modes, model.state.system.M)
    return model.modes.frequencies[which], model.state.observation.shown(model.modes.shapes[which])


def expected_configuration(
    blank: Configuration, frequencies: Floats, shapes: Floats, frequency_std: Floats, shape_std: Floats
) -> Configuration:
    """Fill in a configuration at every floor.

    Parameters
    ----------
    blank : Configuration
        Its masses, modes and state stay, and the covariance of its frequencies if it has one.
    frequencies, shapes : ndarray, shapes (m,) and (m, N)
    frequency_std, shape_std : ndarray, shapes (m,) and (m, N)
        Relative; relative to a mode's largest entry over all floors.
    """
    return replace(
        blank,
        frequencies=frequencies,
        measured_floors=np.arange(1, shapes.shape[1] + 1),
        mode_shapes=shapes,
        repeats=None,
        frequency_std=None if blank.frequency_covariance is not None else frequency_std,
        mode_shape_std=shape_std,
        mode_shape_noise="additive",
        # `ExpectedTest.at` frees the scale over the floors that have a sensor.
        mass_normalized=True,
    )


def data_rows(test: Configuration, model: data.Model) -> data.Residual:
    """Return differences and derivatives of a model's frequencies and shapes in a test, in standard deviations."""
    every = np.ones(len(test.frequencies), dtype=bool)
    frequencies, shapes = (kind(test, every).residual(model) for kind in (data.Frequencies, data.Shapes))
    return data.Residual(np.concatenate([frequencies.r, shapes.r]), np.concatenate([frequencies.J, shapes.J]))
