"""Innovations of a frame's filter, their likelihood and its derivatives.

The filter of a candidate frame predicts each sample of each sensor from all earlier samples. The prediction errors are
the innovations. The right frame and noise give white innovations with the covariance of the filter (prediction-error
method, Ljung 1999). With F = A - K H the derivatives of

    -2 log L = sum over samples of e_t' S^-1 e_t + samples log det S

run with the filter:

    x'_(t+1) = F x'_t + (A' - K' H - K H') x_t + K' (y_t - D p_t) + B' p_t,   e'_t = -H x'_t - H' x_t - D' p_t.

log det S has no residual of its own; rows sqrt(T/2) (I - S^(-1/2) mean(e e') S^(-1/2)) have its gradient and its
expected curvature (Fisher scoring), so that a Gauss-Newton step stays one least-squares program with bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.response.damped import DampedModel
from cvxshear.response.dynamics import BLOCK, SHORT, Dynamics, Noise, Setting, doubled, dynamics, dynamics_slopes
from cvxshear.response.smoother import SWEPT_AT_ONCE, Steady
from cvxshear.response.varied_frame import GAIN_UNIT, VariedFrame
from cvxshear.util.errors import NoModesError
from cvxshear.util.typing import Bools, Floats

FIRST_SENSOR = 0.02
FIRST_FORCE = 0.02
"""Starting values of the fit and centers of the priors: sensor noise, relative to a channel's rms, and missed story
forces, relative to the rms story force."""

MOST_INPUT_NOISE = 0.03
"""Bound on the noise of the excitation's sensor, relative to its rms. With a larger bound, this noise absorbs the
effect of a yielding story. Without the bound, the motion of a fixed frame is less exact."""

FURTHEST = np.log(10.0)
"""Bound on the logarithm of factors on stiffness and damping; a story ten times softer is another frame."""

FURTHEST_DASHPOT = 20.0
"""Bound on a dashpot, in units of the dashpot that gives a mode its measured ratio; this bound nearly locks a story."""

FURTHEST_STDS = 20.0
"""Bound on masses and effects, in standard deviations. An incomplete model can state too small deviations."""

FURTHEST_GAIN = np.log(2.0)
"""Bound on the logarithm of a sensor's gain: a larger error is a wrong unit or amplifier."""

FURTHEST_MASS = 0.25
"""Bound on the change of a floor's mass since the tests, five times its larger standard deviation."""

FURTHEST_FORM = 0.5
"""Bound on the errors of the model's form: beyond 1 the frame could have no modes."""

FURTHEST_NOISE = np.log(30.0)
"""Bound on the logarithm of a sensor's noise around its start; real sensors have more noise than 0.1 % of a
building's motion."""

LEAST_MISSED, MISSED_BY_FORM, MOST_MISSED = 2e-4, 2e-3, 0.1
"""Bounds on the missed story forces, relative to the rms story force. The largest bounds the model errors that a
reconstruction allows. The middle one is the minimum for a model with a wrong form: sensors at a third of the floors
cannot separate smaller missed forces from noise, and the bands become too narrow. The least applies to a frame without
errors of form."""

MISSED_A_FORM = 0.2
"""Missed force, relative to the rms story force, for an error of form of one (`FORM_STDS`). An error of 1 % gives the
middle bound."""

DIFFERENCE = 1e-5
"""Step of finite differences of small matrices: rounding and curvature both give relative errors of 1e-5."""

SIDE_BY_SIDE = 32
"""Number of derivatives in one pass of the filter. Fewer take longer; more need more memory."""

LOST_DIGITS = 1e-13
"""Relative rounding error of a sum of squares for a hundred unknowns."""

SCORE_PERIODS = 1.0
"""Length of the blocks in which scores are summed, in fundamental periods: the correlation time of model errors."""


@dataclass(frozen=True, eq=False)
class Segment:
    """A part of a run in which the same sensors recorded.

    Parameters
    ----------
    excitation : ndarray, shape (samples, 2)
        As in `Dynamics`.
    y : ndarray, shape (samples, m)
        Accelerations, spikes and gaps filled in.
    channels : ndarray of bool, shape (m,)
        The sensors that recorded.
    start : ndarray, shape (n,)
        State at the beginning.
    spread : ndarray, shape (n, n), optional
        Root L of the covariance L L' of the state at the beginning; None if the frame is at rest there.
    """

    excitation: Floats
    y: Floats
    channels: Bools
    start: Floats
    spread: Floats | None = None

    @property
    def seen(self) -> Floats:
        """Accelerations of the sensors that recorded, shape (samples, recording sensors)."""
        return self.y[:, self.channels]

    def strongest(self, most: int) -> slice:
        """Find the part of at most `most` samples with the strongest motion; all channels have the same weight."""
        samples = len(self.y)
        if samples <= most:
            return slice(0, samples)
        scale = np.maximum(np.mean(self.y**2, axis=0), 1e-300)
        power = np.concatenate([[0.0], np.cumsum(np.sum(self.y**2 / scale, axis=1))])
        first = int(np.argmax(power[most:] - power[:-most]))
        return slice(first, first + most)


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions in the space of the unknowns along which a likelihood is linearized.

    Parameters
    ----------
    columns : ndarray, shape (P, r)
    rows : ndarray, shape (r, P)
        The component of a change d along the directions is columns rows d; the rest does not change the innovations.
    """

    columns: Floats
    rows: Floats

    def without(self, gone: int) -> Directions:
        """Return the directions without one noise level, which has a direction of its own."""
        own = int(np.flatnonzero(self.rows[:, gone])[-1])
        return Directions(*(
            np.delete(np.delete(each, row, axis=0), column, axis=1)
            for each, row, column in ((self.columns, gone, own), (self.rows, own, gone))
        ))  # fmt: skip


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The linearized likelihood at one point: -2 log L = |U d + c|^2 + constant for a step d.

    Parameters
    ----------
    U, c : ndarray, shapes (r, P) and (r,)
    inflation : float
        Scatter of the summed scores, relative to white innovations; at least 1.
    """

    U: Floats
    c: Floats
    inflation: float


class PredictionErrors:
    """Innovations of candidates for the frame in a record.

    The unknowns are the frame's (`VariedFrame`), and the logarithms of m sensor noises, of the missed story forces, and
    of the excitation's noise. If the base motion was not measured, the base acceleration replaces the last one.

    Parameters
    ----------
    noise : Noise
        Starting values of the noise levels.
    """

    def __init__(self, varied: VariedFrame, setting: Setting, stretches: Sequence[Segment], noise: Noise) -> None:
        self.varied, self.setting, self.stretches, self.noise = varied, setting, stretches, noise
        self.stories = len(varied.story_stiffness)
        self.frame = slice(0, sum(varied.sizes))
        force = self.frame.stop + len(setting.floors)
        self.size = force + 2
        self.upper = np.full(self.size, FURTHEST_NOISE)
        self.upper[self.frame] = np.repeat([FURTHEST, FURTHEST, FURTHEST_STDS, FURTHEST_FORM], varied.sizes)
        self.upper[varied.dashpots] = FURTHEST_DASHPOT
        heavier = FURTHEST_MASS * np.linalg.norm(varied.heavier_floors, axis=1)
        N, D, W, _ = varied.sizes
        masses = slice(N + D, N + D + W)
        self.upper[masses] = np.maximum(self.upper[masses], heavier[masses])
        self.upper[varied.sensor_gains] = FURTHEST_GAIN / GAIN_UNIT
        self.upper[force] = np.log(MOST_MISSED / noise.force)
        if setting.base_measured:
            self.upper[force + 1] = np.log(MOST_INPUT_NOISE / FIRST_SENSOR)
        self._force = force

    def lower(self, form_std: float) -> Floats:
        """Return lower bounds of the unknowns, shape (P,), for errors of form with this standard deviation."""
        least = -self.upper
        least[self.varied.dashpots] = 0.0
        missed = min(max(LEAST_MISSED, MISSED_A_FORM * form_std), MISSED_BY_FORM)
        least[self._force] = np.log(missed / self.noise.force)
        return least

    @property
    def samples(self) -> int:
        """Number of samples in all segments."""
        return sum(len(each.y) for each in self.stretches)

    def shortened(self, most: int, p: Floats, *, free: bool = True) -> PredictionErrors:
        """Return the strongest part of each segment; its initial state is the filter's state there.

        Parameters
        ----------
        most : int
            Maximum number of samples of each segment.
        p : ndarray, shape (P,)
            Unknowns of the filter.
        free : bool, optional
            Whether the state at the beginning of a part is unknown; otherwise it is the filter's state.
        """
        parts = []
        for filtered, runs in self._filtered(p):
            for run in runs:
                part = run.strongest(most)
                start, spread = run.start, run.spread
                if part.start:
                    start = filtered.predicted(run.excitation, run.seen, run.start)[0][part.start]
                    spread = self.spread(filtered.model, run.seen[part])
                spread = spread if free else None
                parts.append(Segment(run.excitation[part], run.y[part], run.channels, start, spread))
        return PredictionErrors(self.varied, self.setting, parts, self.noise)

    def spread(self, model: Dynamics, y: Floats) -> Floats:
        """Find the root of the covariance of an initial state that explains the sensors' rms in the first period."""
        begins = y[: self.varied.first_samples(self.setting.step)]
        shown = np.sum(model.H @ model.P0 * model.H, axis=1)
        unit = np.sqrt(np.diag(model.P0))
        values, vectors = np.linalg.eigh(model.P0 / np.outer(unit, unit))
        root: Floats = unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        return root * float(np.sqrt(np.mean(begins**2) / np.mean(shown)))

    def _filtered(self, p: Floats) -> list[tuple[Steady, list[Segment]]]:
        """Settle the filter of each set of sensors; return the filter with the segments that this set recorded."""
        model = self.dynamics(p)
        sets: dict[bytes, list[Segment]] = {}
        for run in self.stretches:
            sets.setdefault(run.channels.tobytes(), []).append(run)
        return [(Steady.of(model.seen_by(runs[0].channels)), runs) for runs in sets.values()]

    def model(self, p: Floats) -> DampedModel:
        """Return the frame at these unknowns."""
        return self.varied.model(p[self.frame])

    def stable(self, p: Floats) -> bool:
        """Return whether the frame at these unknowns has modes."""
        try:
            self.model(p)
        except NoModesError:
            return False
        return True

    def noise_at(self, p: Floats) -> Noise:
        """Return the noise at these unknowns."""
        levels = np.exp(p[self.frame.stop :])
        m = len(self.setting.floors)
        force, ground = self.noise.force * levels[m], self.noise.ground * levels[m + 1]
        return Noise(self.noise.sensors * levels[:m], float(force), float(ground))

    def dynamics(self, p: Floats) -> Dynamics:
        """Return the state-space model at these unknowns."""
        return dynamics(self.model(p), self.noise_at(p), self.setting)

    def objective(self, p: Floats) -> float:
        """Compute -2 log likelihood, without its constant."""
        total = 0.0
        for filtered, runs in self._filtered(p):
            _, log_det = np.linalg.slogdet(filtered.S)
            whitening = np.linalg.inv(np.linalg.cholesky(filtered.S))
            for run in runs:
                _, e = filtered.predicted(run.excitation, run.seen, run.start)
                white = (e @ whitening.T).ravel()
                total += len(e) * float(log_det) + float(white @ white)
                if run.spread is not None:
                    free = _free(filtered, run, whitening)
                    slope = free.T @ white
                    total -= float(slope @ np.linalg.solve(np.eye(len(slope)) + free.T @ free, slope))
        return total

    def informed(self, p: Floats, root: Floats, least: float) -> Directions:
        """Find the directions of the frame on which the record has information; add one direction per noise level.

        Parameters
        ----------
        p : ndarray, shape (P,)
        root : ndarray, shape (P, P)
            Square root of the largest possible covariance of the unknowns.
        least : float
            Least norm of the change of the innovations, in their standard deviations, per prior standard deviation.
        """
        own = root[self.frame, self.frame]
        columns = np.eye(self.size)
        columns[self.frame, self.frame] = own
        squares, turns = np.linalg.eigh(_products(self._rows(p, columns[:, self.frame]))[:-1, :-1])
        turns = turns[:, squares > least**2].T[::-1]
        noise = np.eye(self.size)[self.frame.stop :]
        rows = np.zeros((len(turns), self.size))
        rows[:, self.frame] = np.linalg.solve(own.T, turns.T).T
        return Directions(np.hstack([columns[:, self.frame] @ turns.T, noise.T]), np.concatenate([rows, noise]))

    def linearised(self, p: Floats, along: Directions) -> Likelihood:
        """Return the rows of a Gauss-Newton step, reduced to a triangle."""
        parts = self._rows(p, along.columns)
        products = _products(parts)
        # Directions that the record cannot distinguish keep a pivot of the size of rounding.
        np.fill_diagonal(products, (1.0 + LOST_DIGITS) * products.diagonal() + np.finfo(np.float64).tiny)
        whole = np.asarray(np.linalg.cholesky(products), dtype=np.float64).T
        frame = along.columns.shape[1] - (self.size - self.frame.stop)
        return Likelihood(whole[:-1, :-1] @ along.rows, whole[:-1, -1], self._inflation(parts, frame))

    def _rows(self, p: Floats, columns: Floats) -> list[_Rows]:
        """Return the residuals and their derivatives along some directions."""
        sizes = DIFFERENCE / np.maximum(1.0, np.max(np.abs(columns), axis=0))
        moved = p + sizes[:, None] * columns.T
        beside = [(self.model(each), self.noise_at(each)) for each in moved]
        rates = dynamics_slopes((self.model(p), self.noise_at(p)), beside, sizes, self.setting)
        return [part for here, runs in self._filtered(p) for part in self._rows_of(here, runs, rates)]

    def _rows_of(self, here: Steady, runs: Sequence[Segment], rates: Mapping[str, Floats]) -> list[_Rows]:
        """Return the rows of the segments that the same sensors recorded.

        There is one part per segment, and one part for log det S and the initial states.
        """
        whitening = np.linalg.inv(np.linalg.cholesky(here.S))
        slopes = _Slopes.of(here, rates, runs[0].channels, whitening)
        m = len(whitening)
        parts: list[_Rows] = []
        begun: list[Floats] = []
        mean, samples = np.zeros((m, m)), sum(len(run.y) for run in runs)
        for run in runs:
            x, e = here.predicted(run.excitation, run.seen, run.start)
            seen = run.seen - here.model.shown(run.excitation)
            following = np.append(run.excitation[1:, 0], run.excitation[-1, 0])
            J = slopes.moved(x, np.column_stack([seen, run.excitation, following]))
            white = e @ whitening.T
            if run.spread is not None:
                # The initial state is minimized for every change of the frame: variable projection.
                free = _free(here, run, whitening)
                normal = np.eye(free.shape[1]) + free.T @ free
                both: Floats = np.asarray(np.linalg.solve(normal, _crossed(free, J, white.ravel())))
                turned, moved = both[:, :-1], both[:, -1]
                white -= (free @ moved).reshape(white.shape)
                for first in range(0, len(J), SWEPT_AT_ONCE):
                    some = slice(first, first + SWEPT_AT_ONCE)
                    J[some] -= free[some].astype(SHORT) @ turned.astype(SHORT)
                begun.append(both)
            parts.append(_Rows(J, white.ravel(), m))
            mean += white.T @ white
        root = np.sqrt(samples / 2)
        # For these rows, J'r is half the gradient of T log det S + sum e' S^-1 e with respect to S.
        r = [root * (np.eye(m) - mean / samples).ravel(), *(both[:, -1] for both in begun)]
        R = [slopes.S.reshape(len(slopes.S), -1).T * root, *(both[:, :-1] for both in begun)]
        return [*parts, _Rows(np.concatenate(R), np.concatenate(r), 0)]

    def _inflation(self, parts: Sequence[_Rows], rows: int) -> float:
        """Compute the scatter of the summed scores of the first directions, relative to white innovations."""
        samples = max(1, round(SCORE_PERIODS * self.varied.period / self.setting.step))
        spread, curvature = np.zeros(rows), np.zeros(rows)
        for part in parts:
            length = part.sensors * samples
            blocks = len(part.r) // length if length else 0
            if blocks < 2:
                continue
            flat = part.J[: blocks * length, :rows]
            weights = part.r[: len(flat)].astype(SHORT).reshape(blocks, 1, length)
            summed = (weights @ flat.reshape(blocks, length, rows))[:, 0].astype(np.float64)
            # At the most probable frame the scores balance the prior; their sum need not be zero.
            summed = summed - summed.mean(axis=0)
            spread += np.sum(summed**2, axis=0) * (blocks / (blocks - 1))
            curvature += np.einsum("ij,ij->j", flat, flat)
        # A fixed frame has no directions.
        return 1.0 if not rows else max(1.0, float(np.mean(spread / np.maximum(curvature, 1e-300))))


def _products(parts: Sequence[_Rows]) -> Floats:
    """Compute the products of all derivatives and residuals, summed over all rows, shape (r + 1, r + 1)."""
    return np.asarray(sum(_crossed(None, part.J, part.r) for part in parts))


def _crossed(left: Floats | None, J: Floats, r: Floats) -> Floats:
    """Multiply rows (by default [J, r]) with [J, r], in double precision, some samples at a time."""
    total: Floats = np.zeros(1)
    for first in range(0, len(r), SWEPT_AT_ONCE):
        chosen = slice(first, first + SWEPT_AT_ONCE)
        rows = np.column_stack([J[chosen], r[chosen]])
        total = total + (rows if left is None else left[chosen]).T @ rows
    return total


def _free(filtered: Steady, run: Segment, whitening: Floats) -> Floats:
    """Return the change of the whitened innovations by an initial state with unit prior, shape (samples m, n)."""
    rows = [whitening @ filtered.model.H]
    for _ in range(BLOCK - 1):
        rows.append(rows[-1] @ filtered.F)
    block = np.concatenate(rows)
    leap = np.linalg.matrix_power(filtered.F, BLOCK)
    root = np.array(run.spread)
    parts = []
    for _ in range(0, len(run.y), BLOCK):
        parts.append(block @ root)
        root = leap @ root
    result: Floats = np.concatenate(parts)[: run.seen.size]
    return result


@dataclass(frozen=True, eq=False)
class _Rows:
    """Residuals, shape (d,), and their derivatives, shape (d, r).

    Parameters
    ----------
    sensors : int
        Number of residuals per sample; 0 for residuals other than innovations.
    """

    J: Floats
    r: Floats
    sensors: int


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Derivatives of a filter x+ = x F + s B with the whitened innovations -(x C + s D), rows of r directions.

    Parameters
    ----------
    F, B, C : ndarray, shapes (n, n), (k, n) and (n, m)
        The filter; its k signals are the sensors, the excitation (q and p) and q at the end of a step.
    dF, dB, dC, dD : ndarray, shapes (r, n, n), (r, k, n), (r, n, m) and (r, k, m)
    S : ndarray, shape (r, m, m)
        Derivatives of the innovations' covariance, whitened.
    """

    F: Floats
    B: Floats
    C: Floats
    dF: Floats
    dB: Floats
    dC: Floats
    dD: Floats
    S: Floats

    @staticmethod
    def of(here: Steady, rates: Mapping[str, Floats], channels: Bools, whitening: Floats) -> _Slopes:
        """Differentiate the filter's matrices.

        The derivative of the covariance P solves dP = F dP F' + G. The gain counts as constant there, because it is
        optimal.
        """
        model, K, F, P = here.model, here.K, here.F, here.P
        dA, dH, dR, direct = rates["A"], rates["H"][:, channels], rates["R"][:, channels], rates["direct"][:, channels]
        turned = (dA - K @ dH) @ P @ F.T
        G = turned + turned.swapaxes(1, 2) + (K * dR[:, None]) @ K.T + rates["Q"]
        dP = doubled(F, G)
        crossed, across = dH @ P @ model.H.T, dP @ model.H.T
        dS = crossed + crossed.swapaxes(1, 2) + model.H @ across + dR[:, None] * np.eye(len(K.T))
        dK = dA @ P @ model.H.T + model.A @ (across + P @ dH.swapaxes(1, 2)) - K @ dS
        dK = dK @ np.linalg.inv(here.S)
        m, nothing = len(K.T), np.zeros(len(F))
        B = np.vstack([K.T, model.before, nothing, model.after])
        # y - D p changes by -D' p; the gain turns this into a change of the state.
        dB = np.concatenate(
            [dK.swapaxes(1, 2), rates["before"][:, None], -(direct @ K.T)[:, None], rates["after"][:, None]], axis=1
        )
        dD = np.zeros((len(dA), m + 3, m))
        dD[:, m + 1] = direct @ whitening.T
        dF = (dA - dK @ model.H - K @ dH).swapaxes(1, 2)
        return _Slopes(
            F.T, B, (whitening @ model.H).T, dF, dB, (whitening @ dH).swapaxes(1, 2), dD, whitening @ dS @ whitening.T
        )

    def moved(self, x: Floats, signals: Floats) -> Floats:
        """Differentiate the whitened innovations of all samples, shape (samples m, r).

        One product gives a block of samples from the state at its beginning and its signals.
        """
        (samples, k), (n, m), r = signals.shape, self.C.shape, len(self.dF)
        # This block length minimizes the cost of the products.
        block = 2 ** max(0, round(float(np.log2(n / np.sqrt(k * m)))))
        blocks = -(-samples // block)
        own = np.zeros((blocks * block, k))
        own[:samples] = signals
        begun = np.hstack([x[::block], own.reshape(blocks, -1)]).astype(SHORT)
        maps, shown, leap = self._over(block)
        J = np.empty((blocks, block * m, r), dtype=SHORT)
        for first in range(0, r, SIDE_BY_SIDE):
            some = maps[:, first : first + SIDE_BY_SIDE]
            parts = (begun @ some.reshape(len(some), -1)).reshape(blocks, *some.shape[1:])
            starts, state = np.zeros((blocks, some.shape[1], n), dtype=SHORT), np.zeros((some.shape[1], n))
            for place, end in zip(starts, parts[:, :, block * m :], strict=True):
                place[...] = state
                state = state @ leap + end
            J[:, :, first : first + SIDE_BY_SIDE] = -(parts[:, :, : block * m] + starts @ shown).swapaxes(1, 2)
        return J.reshape(-1, r)[: samples * m]

    def _over(self, block: int) -> tuple[Floats, Floats, Floats]:
        """Differentiate the filter over a block of samples.

        Returns
        -------
        ndarray, shape (n + block k, r, block m + n)
            Derivatives of the innovations (with opposite sign) and of the final state, for each initial state and
            signal.
        ndarray, shape (n, block m)
            Effect of the derivative of the initial state on the derivatives of the innovations.
        ndarray, shape (n, n)
            Effect of the derivative of the initial state on the derivative of the final state.
        """
        (n, m), (r, k) = self.C.shape, self.dB.shape[:2]
        maps = np.zeros((n + block * k, r, block * m + n), dtype=SHORT)
        shown, dshown, driven, ddriven = [self.C], self.dC, self.B, self.dB
        between = [self.dD.swapaxes(0, 1)]
        for j in range(block):
            maps[:n, :, j * m : (j + 1) * m] = dshown.swapaxes(0, 1)
            # Signals of a sample act on the innovations j later; signals of j before the last act on the end.
            for i in range(block - j):
                maps[n + i * k : n + (i + 1) * k, :, (i + j) * m : (i + j + 1) * m] = between[j]
            last = n + (block - 1 - j) * k
            maps[last : last + k, :, block * m :] = ddriven.swapaxes(0, 1)
            between.append((self.dB @ shown[j] + self.B @ dshown).swapaxes(0, 1))
            dshown, ddriven = self.dF @ shown[j] + self.F @ dshown, ddriven @ self.F + driven @ self.dF
            shown.append(self.F @ shown[j])
            driven = driven @ self.F
        power, dpower = self.F, self.dF
        for _ in range(block.bit_length() - 1):
            power, dpower = power @ power, dpower @ power + power @ dpower
        maps[:n, :, block * m :] = dpower.swapaxes(0, 1)
        return maps, np.concatenate(shown[:block], axis=1).astype(SHORT), power
