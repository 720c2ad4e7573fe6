"""The filter that predicts the sensors of a frame, its innovations, their likelihood and its derivatives.

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

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cvxshear.response import state_space
from cvxshear.response.damping import DampedModel
from cvxshear.response.frame_prior import ABSENT_STD, Gaussian, Likelihood
from cvxshear.response.sources import covariance_root
from cvxshear.response.state_space import BLOCK, ROUNDING, Dynamics, Noise, Setting
from cvxshear.response.varied_frame import DIFFERENCE, VariedFrame
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Bools, Floats

#: Starting values of the fit and centers of the priors: sensor noise, relative to a channel's rms, and missed story
#: forces, relative to the rms story force.
FIRST_NOISE = 0.02

#: Bound on each unknown, in standard deviations of its prior.
FURTHEST_STDS = 10.0

#: Bound on the noise of the excitation's sensor, relative to its rms; the lower bound is as far from the start. Without
#: the upper one, this noise absorbs the effect of a yielding story, and the record passes for a linear frame's. Without
#: the lower one, the level of a noise that is not there takes twenty steps to settle.
MOST_INPUT_NOISE = 0.03

#: Bounds on the missed story forces, relative to the rms story force. Sensors at a third of the floors cannot separate
#: smaller missed forces from noise, and errors of form of 1 % miss as much. The largest bounds the model errors that a
#: reconstruction allows: beyond it, the innovations show that the record is not that of a linear frame.
LEAST_MISSED, MOST_MISSED = 2e-3, 0.1


@dataclass(frozen=True, eq=False)
class Filter:
    """One step of the Kalman filter.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance of the predicted state.
    S : ndarray, shape (m, m)
        Covariance of the innovations.
    K : ndarray, shape (n, m)
        Gain.
    """

    model: Dynamics
    P: Floats
    S: Floats
    K: Floats

    @staticmethod
    def at(model: Dynamics, P: Floats) -> Filter:
        """Return the filter for a covariance of the predicted state."""
        PH = P @ model.H.T
        S: Floats = model.H @ PH + np.diag(model.R)
        return Filter(model, P, S, np.asarray(np.linalg.solve(S, (model.A @ PH).T).T))

    @staticmethod
    def settled(model: Dynamics) -> Filter:
        """Return the filter whose covariance no longer changes.

        The doubling method for the Riccati equation (Chu, Fan, Lin and Wang 2004) needs no eigenvalues, so it also
        works for stories without observation, for which `scipy.linalg.solve_discrete_are` fails.
        """
        n = len(model.A)
        power, G, P = model.A.T, model.H.T @ (model.H / model.R[:, None]), model.Q
        for _ in range(state_space.MOST_DOUBLINGS):
            inner = np.linalg.inv(np.eye(n) + G @ P)
            more = power.T @ P @ inner @ power
            G = G + power @ inner @ G @ power.T
            power = power @ inner @ power
            P = P + more
            P, G = 0.5 * (P + P.T), 0.5 * (G + G.T)
            # Each round doubles the number of correct digits.
            if np.all(np.diag(more) <= np.sqrt(state_space.ROUNDING) * np.diag(P)):
                break
        return Filter.at(model, P)

    @property
    def F(self) -> Floats:  # noqa: N802
        """A - K H, shape (n, n)."""
        return np.asarray(self.model.A - self.K @ self.model.H)

    @property
    def pull(self) -> Floats:
        """S^-1 H, shape (m, n)."""
        return np.asarray(np.linalg.solve(self.S, self.model.H))

    @property
    def following(self) -> Floats:
        """Covariance of the next predicted state, shape (n, n)."""
        P: Floats = self.F @ self.P @ self.model.A.T + self.model.Q
        return 0.5 * (P + P.T)

    def predicted(self, excitation: Floats, y: Floats, start: Floats) -> tuple[Floats, Floats]:
        """Compute the states predicted from the past, shape (samples, n), and the innovations, shape (samples, m)."""
        seen = y - self.model.shown(excitation)
        B = np.vstack([self.K.T, self.model.before, self.model.after])
        x = state_space.recursion(self.F, B, np.hstack([seen, state_space.steps_of(excitation)]), start)
        return x, seen - x @ self.model.H.T

    def slopes(self, rates: dict[str, Floats]) -> tuple[Floats, Floats]:
        """Differentiate the gain, shape (r, n, m), and S, shape (r, m, m), of a settled filter.

        The derivative of P solves dP = F dP F' + G. The gain counts as constant there, because it is optimal.
        """
        model, K, F, P = self.model, self.K, self.F, self.P
        dA, dH, dR = rates["A"], rates["H"], rates["R"]
        turned = (dA - K @ dH) @ P @ F.T
        dP = state_space.doubled(F, turned + turned.swapaxes(1, 2) + (K * dR[:, None]) @ K.T + rates["Q"])
        crossed, across = dH @ P @ model.H.T, dP @ model.H.T
        dS = crossed + crossed.swapaxes(1, 2) + model.H @ across + dR[:, None] * np.eye(len(self.S))
        dK = dA @ P @ model.H.T + model.A @ (across + P @ dH.swapaxes(1, 2)) - K @ dS
        return dK @ np.linalg.inv(self.S), dS


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
    slopes : ndarray, shape (samples, m)
        Change of each acceleration per sample.
    """

    excitation: Floats
    y: Floats
    channels: Bools
    slopes: Floats

    @property
    def seen(self) -> Floats:
        """Accelerations of the sensors that recorded, shape (samples, recording sensors)."""
        return self.y[:, self.channels]

    def part(self, rows: slice) -> Segment:
        """Return a part of the segment."""
        return Segment(self.excitation[rows], self.y[rows], self.channels, self.slopes[rows])

    def on_time(self, late: Floats) -> Segment:
        """Return the segment without small delays of the sensors, in samples, shape (m,)."""
        return replace(self, y=self.y + self.slopes * late)


def strongest(y: Floats, most: int) -> slice:
    """Find the part of at most `most` samples with the strongest motion; all channels have the same weight."""
    samples = len(y)
    if samples <= most:
        return slice(0, samples)
    scale = np.maximum(np.mean(y**2, axis=0), 1e-300)
    power = np.concatenate([[0.0], np.cumsum(np.sum(y**2 / scale, axis=1))])
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


#: Derivatives of residuals, shape (d, r), the residuals, (d,), and their number per sample; 0 for residuals other than
#: innovations.
_Rows = tuple[Floats, Floats, int]


class PredictionErrors:
    """Innovations of candidates for the frame in a record.

    The unknowns are the frame's (`VariedFrame`), the logarithms of m sensor noises, of the missed story forces, and of
    the excitation's noise, and the delay of each sensor in samples.

    Parameters
    ----------
    noise : Noise
        Starting values of the noise levels.
    """

    def __init__(self, varied: VariedFrame, setting: Setting, stretches: Sequence[Segment], noise: Noise) -> None:
        self.varied, self.setting, self.stretches, self.noise = varied, setting, stretches, noise
        self.stories = len(varied.story_stiffness)
        self.frame = slice(0, sum(varied.sizes))
        self.levels = slice(self.frame.stop, self.frame.stop + len(setting.floors) + 2)
        self.delays = slice(self.levels.stop, self.levels.stop + len(setting.floors))
        self.size = self.delays.stop

    def bounds(self, prior: Gaussian) -> tuple[Floats, Floats]:
        """Return lower and upper bounds of the unknowns, shape (P,)."""
        far = FURTHEST_STDS * np.sqrt(np.diag(prior.covariance))
        lower, upper = -far, far
        lower[self.varied.dashpots] = np.maximum(lower[self.varied.dashpots], -FURTHEST_STDS * ABSENT_STD)
        force = self.levels.stop - 2
        lower[force], upper[force] = np.log(np.array([LEAST_MISSED, MOST_MISSED]) / self.noise.force)
        upper[force + 1] = np.log(MOST_INPUT_NOISE / FIRST_NOISE)
        lower[force + 1] = -upper[force + 1]
        return lower, upper

    @property
    def samples(self) -> int:
        """Number of samples in all segments."""
        return sum(len(each.y) for each in self.stretches)

    def shortened(self, most: int) -> PredictionErrors:
        """Return the strongest part of each segment, of at most `most` samples."""
        parts = [each.part(strongest(each.y, most)) for each in self.stretches]
        return PredictionErrors(self.varied, self.setting, parts, self.noise)

    @cached_property
    def spreads(self) -> list[Floats]:
        """Roots L of covariances L L' of the state at the beginning of each segment, for the identified frame.

        They explain the rms of the first period.
        """
        model, first = self.dynamics(np.zeros(self.size)), self.varied.first_samples(self.setting.step)
        first_seen = (np.where(run.channels, run.y[:first], np.nan) for run in self.stretches)
        return [covariance_root(model.start_covariance(each)) for each in first_seen]

    def _filtered(self, p: Floats) -> list[tuple[Filter, list[tuple[Segment, Floats]]]]:
        """Settle the filter of each set of sensors; return it with the segments of this set and their `spreads`."""
        model = self.dynamics(p)
        sets: dict[bytes, list[tuple[Segment, Floats]]] = {}
        for run, spread in zip(self.stretches, self.spreads, strict=True):
            sets.setdefault(run.channels.tobytes(), []).append((run.on_time(p[self.delays]), spread))
        return [(Filter.settled(model.seen_by(runs[0][0].channels)), runs) for runs in sets.values()]

    def model(self, p: Floats) -> DampedModel:
        """Return the frame at these unknowns."""
        return self.varied.model(p[self.frame])

    def noise_at(self, p: Floats) -> Noise:
        """Return the noise at these unknowns."""
        levels = np.exp(p[self.levels])
        m = len(self.setting.floors)
        force, ground = self.noise.force * levels[m], self.noise.ground * levels[m + 1]
        return Noise(self.noise.sensors * levels[:m], float(force), float(ground))

    def dynamics(self, p: Floats) -> Dynamics:
        """Return the state-space model at these unknowns."""
        return state_space.dynamics(self.model(p), self.noise_at(p), self.setting)

    def objective(self, p: Floats) -> float:
        """Compute -2 log likelihood, without its constant."""
        total = 0.0
        for filtered, runs in self._filtered(p):
            _, log_det = np.linalg.slogdet(filtered.S)
            whitening = np.linalg.inv(np.linalg.cholesky(filtered.S))
            for run, spread in runs:
                free, white = _from_rest(filtered, run, spread, whitening)
                total += len(run.y) * float(log_det) + float(white @ (white - free @ _projected(free, white)))
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
        np.fill_diagonal(products, (1.0 + len(products) * ROUNDING) * products.diagonal() + np.finfo(np.float64).tiny)
        whole = np.asarray(np.linalg.cholesky(products), dtype=np.float64).T
        frame = int(np.count_nonzero(np.any(along.columns[self.frame] != 0, axis=0)))
        return Likelihood(whole[:-1, :-1] @ along.rows, whole[:-1, -1], self._inflation(parts, frame))

    def _rows(self, p: Floats, columns: Floats) -> list[_Rows]:
        """Return the residuals and their derivatives along some directions."""
        sizes = DIFFERENCE / np.maximum(1.0, np.max(np.abs(columns), axis=0))
        rates = state_space.slopes(
            self.dynamics(p), [self.dynamics(p + row) for row in sizes[:, None] * columns.T], sizes
        )
        rates["late"] = columns[self.delays].T
        parts: list[_Rows] = []
        for here, runs in self._filtered(p):
            seen = {name: each[:, runs[0][0].channels] if name in ("H", "direct", "R", "late") else each
                    for name, each in rates.items()}  # fmt: skip
            parts += _rows_of(here, runs, seen)
        return parts

    def _inflation(self, parts: Sequence[_Rows], rows: int) -> float:
        """Compute the scatter of the summed scores of the first directions, relative to white innovations.

        Scores are summed over one period of the frame, the correlation time of errors of the model.
        """
        samples = max(1, round(self.varied.period / self.setting.step))
        spread, curvature = np.zeros(rows), np.zeros(rows)
        for J, r, sensors in parts:
            length = sensors * samples
            blocks = len(r) // length if length else 0
            if blocks < 2:
                continue
            flat = J[: blocks * length, :rows]
            summed = (r[: len(flat)].reshape(blocks, 1, length) @ flat.reshape(blocks, length, rows))[:, 0]
            # At the most probable frame the scores balance the prior; their sum need not be zero.
            summed = summed - summed.mean(axis=0)
            spread += np.sum(summed**2, axis=0) * (blocks / (blocks - 1))
            curvature += np.einsum("ij,ij->j", flat, flat)
        # A fixed frame has no directions.
        return 1.0 if not rows else max(1.0, float(np.mean(spread / np.maximum(curvature, 1e-300))))


def _products(parts: Sequence[_Rows]) -> Floats:
    """Compute the products of all derivatives and residuals, summed over all rows, shape (r + 1, r + 1)."""
    rows = (np.column_stack([J, r]) for J, r, _ in parts)
    return np.asarray(sum(each.T @ each for each in rows))


def _projected(free: Floats, values: Floats) -> Floats:
    """Return (1 + F'F)^-1 F' values: the state that makes the values smallest, beside its own unit prior."""
    return np.asarray(np.linalg.solve(np.eye(free.shape[1]) + free.T @ free, free.T @ values))


def _rows_of(here: Filter, runs: Sequence[tuple[Segment, Floats]], rates: dict[str, Floats]) -> list[_Rows]:
    """Return one part per segment that the same sensors recorded, and one part for log det S and the initial states."""
    dK, dS = here.slopes(rates)
    whitening = np.linalg.inv(np.linalg.cholesky(here.S))
    m, samples = len(whitening), sum(len(run.y) for run, _ in runs)
    parts: list[_Rows] = []
    starts: list[tuple[Floats, Floats]] = []
    mean = np.zeros((m, m))
    for run, spread in runs:
        # The initial state is the most probable one for every frame: variable projection.
        free, white = _from_rest(here, run, spread, whitening)
        z = _projected(free, white)
        white = white - free @ z
        x, _ = here.predicted(run.excitation, run.seen, spread @ z)
        J = (_moved(here, rates, dK, run, x) @ whitening.T).swapaxes(1, 2).reshape(len(white), -1)
        dz = _projected(free, J)
        starts.append((dz, z))
        parts.append((J - free @ dz, white, m))
        mean += white.reshape(-1, m).T @ white.reshape(-1, m)
    root = np.sqrt(samples / 2)
    # For these rows, J'r is half the gradient of T log det S + sum e' S^-1 e with respect to S.
    r = [root * (np.eye(m) - mean / samples).ravel(), *(z for _, z in starts)]
    scatter = whitening @ dS @ whitening.T
    R = [scatter.reshape(len(dS), -1).T * root, *(dz for dz, _ in starts)]
    return [*parts, (np.concatenate(R), np.concatenate(r), 0)]


def _moved(here: Filter, rates: dict[str, Floats], dK: Floats, run: Segment, x: Floats) -> Floats:
    """Differentiate the innovations of a segment along r directions, shape (samples, r, m)."""
    model, K, dH, direct = here.model, here.K, rates["H"], rates["direct"]
    dF = rates["A"] - dK @ model.H - K @ dH
    late, slopes = rates["late"], run.slopes[:, run.channels]
    lines, p = state_space.steps_of(run.excitation), run.excitation[:, 1:]
    signals = np.hstack([x, run.seen - model.shown(run.excitation), lines, p, slopes])
    changes = [dF.swapaxes(1, 2), dK.swapaxes(1, 2), rates["before"][:, None], rates["after"][:, None]]
    # y - D p changes by -D' p and by the delays; the gain turns this into a change of the state.
    driven = np.concatenate([*changes, -(direct @ K.T)[:, None], late[:, :, None] * K.T], axis=1)
    driven = driven.swapaxes(0, 1).reshape(signals.shape[1], -1)
    J = slopes[:, None] * late - (x @ dH.swapaxes(1, 2) + p * direct[:, None]).swapaxes(0, 1)
    turned, state = np.ascontiguousarray(here.F.T), np.zeros(dF.shape[:2])
    # By blocks: the derivatives of all states together would need much memory.
    for first in range(0, len(x), BLOCK):
        part = slice(first, first + BLOCK)
        moved = (signals[part] @ driven).reshape(-1, *dF.shape[:2])
        for row in moved:
            state, row[...] = state @ turned + row, state
        J[part] -= moved @ model.H.T
    return J


def _from_rest(here: Filter, run: Segment, spread: Floats, whitening: Floats) -> tuple[Floats, Floats]:
    """Return whitened innovations from rest, shape (samples m,), after their change by an initial state L z."""
    _, e = here.predicted(run.excitation, run.seen, np.zeros(len(spread)))
    shown, state = whitening @ here.model.H, spread
    free = np.zeros((len(run.y), len(shown), spread.shape[1]))
    forgotten = ROUNDING * np.max(np.abs(state))
    for row in free:
        row[...] = shown @ state
        state = here.F @ state
        if np.max(np.abs(state)) <= forgotten:
            break
    return free.reshape(-1, spread.shape[1]), (e @ whitening.T).ravel()
