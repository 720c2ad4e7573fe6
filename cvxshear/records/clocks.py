"""Clocks of the channels: late by a constant, or by more and more.

A clock that is late by tau turns each component of angular frequency w by -w tau. Between two
channels of a lightly damped frame the phase is otherwise nearly nought or half a turn, at the modes and in the band
between them: over the whole band the delay is the one straight line through the origin that leaves no more than that,
and the modes' own phases make it finer (`records.clock_offsets`). A damper turns single modes, not the band.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cvxshear.records.segments import Segments
from cvxshear.util.typing import Complexes, Floats, Ints

LONGEST_DELAY = 2.6
"""Longest delay, s, that is looked for: two seconds, which loggers started by hand are apart, and room beyond."""
FASTEST_DRIFT = 1e-3
"""s a second; crystals differ by a tenth of that at most."""
DELAY_BANDS = 8
"""Parts of the band, of equal weight, that must agree in a delay."""
NO_PHASE = 3.0
"""Degrees; a phase of a band that a delay leaves and that noise may have made; twice that in a part of a record."""
WELL_TURNED = 30.0
"""Degrees; a third of what chance leaves at most in a band that a long delay turns several times."""
NEARLY_TURNED = 0.75
"""Fraction of a right angle. Bands that a delay turns more are not compared with their phases without the delay."""
HEARD = 0.25
"""Fraction of the largest agreement of lines in a band; other bands have little motion in common."""
MOST_BANDS = 0.75
"""Share of the bands whose phases a delay must make smaller; resonances turn the others."""
TRUSTED_DRIFT = 4.0
"""Standard deviations of a drift, or else the delay is looked for without one."""
FINER = 4
"""Steps of the search in the time that a quarter of a sample makes."""
NO_DRIFT = 0.97
"""A clock has no drift if the agreement without a drift reaches this fraction of the agreement with it."""
STEADY = 0.01
"""Samples that the delay of a sound clock may seem to change by, as modes ring with other weights."""
AS_GOOD = 0.97
"""Fraction of the largest agreement: take the smallest delay that reaches it, not a sidelobe of a few modes."""


@dataclass(frozen=True)
class BandClock:
    """How late one channel's clock is against another's.

    Parameters
    ----------
    middle : float
        The delay at the mean time of the data, s.
    std : float
        Of that.
    agreement : float
        1 where the delay makes all lines agree in phase, 0 where the channels have nothing in common.
    chance : float
        Agreement that channels with nothing in common reach by chance.
    slope, slope_std : float, optional
        Seconds more in each second after, as fitted, significant or not.
    freedom : int, optional
        Degrees of freedom of `slope_std`; 0 where no slope could be fitted.
    time : float, optional
        The mean time, s, and the longest time from it to either end.
    reach : float, optional
    """

    middle: float
    std: float
    agreement: float
    chance: float
    slope: float = 0.0
    slope_std: float = np.inf
    freedom: int = 0
    time: float = 0.0
    reach: float = 0.0


def band_clock(segments: Segments, first: int, second: int) -> BandClock:
    """How late the first clock is against the second, by the phases of the whole band.

    The agreement sum w z exp(2 i w t), z the squared phasors, is searched over delay and drift on a grid and then, in
    each part of the record, climbed to its top; a straight line through the tops is the delay and its drift.
    """
    squares, weights, times, chance = segments.agreement(first, second)
    total = float(weights.sum())
    if total <= 0:
        return BandClock(0.0, np.inf, 0.0, 1.0)
    samples = FINER * segments.length
    grid = (np.arange(samples) - samples // 2) * segments.length / (2 * segments.rate * samples)
    near = np.abs(grid) <= LONGEST_DELAY
    table = np.fft.fftshift(np.fft.ifft(squares, n=samples, axis=1).real * samples, axes=1)[:, near]
    grid, step = grid[near], float(grid[1] - grid[0])
    time = float(np.average(times, weights=weights))
    around = times - time
    drifting, steady = _best_lines(table, around, step, grid)
    found = _fitted(squares, weights, around, grid[drifting[0]], drifting[1], step, segments)
    if drifting[1] and abs(found.slope) < TRUSTED_DRIFT * found.slope_std:
        # A sweep that passes a damper's phases one after the other looks like a drift as well.
        found = _fitted(squares, weights, around, grid[steady], 0, step, segments)
    return replace(found, chance=chance, time=time)


def _fitted(
    squares: Complexes, weights: Floats, around: Floats, start: float, turns: int, step: float, segments: Segments
) -> BandClock:
    """Fit delay and drift near a line: a delay at the middle, and steps of the grid from the middle to the end."""
    half = max(float(np.abs(around).max()), 1e-9)
    line = start + turns * step / half * around
    tops, heights = _climbed(squares, line, segments, step)
    agreement = float(heights.sum()) / float(weights.sum())
    high = heights > 0.3 * np.median(heights / np.maximum(weights, 1e-300)) * weights
    sound = high & (np.abs(tops - line) < step * FINER)
    if np.count_nonzero(sound) < 3:
        return BandClock(float(start), step, agreement, 0.0)
    # The line by weighted least squares; without a slope where a motion that dies leaves weight at one time alone.
    mean, middle = np.average([around[sound], tops[sound]], axis=1, weights=heights[sound]).tolist()
    off = heights[sound] * (around[sound] - mean)
    spread = float(off @ (around[sound] - mean))
    slope = float(off @ tops[sound]) / spread if spread > 0.0 else 0.0
    middle -= slope * mean
    fitted = _over_bands(squares[sound], around[sound], middle + slope * around[sound], segments, segments.hit[sound])
    middle, slope = middle + fitted.middle, slope + fitted.slope
    slope_std = float(np.hypot(fitted.slope_std, STEADY / segments.rate / half))
    return replace(fitted, middle=middle, agreement=agreement, slope=slope, slope_std=slope_std, reach=half)


def straight(
    segments: Segments, first: int, second: int, seconds: float, slope: float = 0.0, time: float = 0.0
) -> bool:
    """Whether a delay, or a drift on top of it, makes the phases of two clocks smaller in nearly every band.

    The phases that dampers make are small below the first mode, and grow there with the cube of the frequency: the
    delay that explains them at the modes leaves more in the lowest bands than it takes.

    Parameters
    ----------
    segments : Segments
    first, second : int
        Clocks.
    seconds : float
        How late the first is; at the time `time` where it drifts.
    slope : float, optional
        Seconds more in each second after. With a slope, the phases in the parts of the record are compared with the
        phases of the delay alone.
    time : float, optional
        s.
    """
    squares, _, times, _ = segments.agreement(first, second)
    edges, steady = _bands(squares), 0.0 if slope == 0.0 else seconds
    parts = squares if slope else squares.sum(axis=0)[None]
    before, _ = _phases(parts, np.full(len(times), steady), edges, segments.omega)
    after, agreed = _phases(parts, seconds + slope * (times - time), edges, segments.omega)
    # Without the delay, the phase of a band that is turned by about a right angle is arbitrary.
    middles = segments.omega[(edges + np.append(edges[1:], squares.shape[1])) // 2]
    turned = middles * np.abs(seconds - steady) > NEARLY_TURNED * np.pi / 2
    noise = 2 * NO_PHASE if slope else NO_PHASE
    allowed = np.maximum(before, np.radians(np.where(turned, WELL_TURNED, noise)))
    low = slice(None, len(edges) // 4 + 1)
    less = np.cumsum(after[low] ** 2) <= np.cumsum(allowed[low] ** 2)
    # In the wind's own band the floors move each by itself.
    heard = agreed > HEARD * agreed.max()
    return bool(less.all() and np.mean(after[heard] <= allowed[heard]) >= MOST_BANDS)


def _phases(squares: Complexes, late: Floats, edges: Ints, omega: Floats) -> tuple[Floats, Floats]:
    """Root mean square phase of each band over the parts of a record, rad, with a delay in each part taken out.

    The agreement of the lines in each band, between 0 and 1, comes second.
    """
    cells = np.add.reduceat(squares * np.exp(2j * late[: len(squares), None] * omega), edges, axis=1)
    size = np.abs(cells)
    total = np.maximum(size.sum(axis=0), 1e-300)
    agreed = total / np.maximum(np.add.reduceat(np.abs(squares).sum(axis=0), edges), 1e-300)
    return np.sqrt(np.sum(size * np.angle(cells) ** 2, axis=0) / total) / 2, agreed


def _bands(squares: Complexes) -> Ints:
    """Places of the first lines of bands of equal weight."""
    loud = np.cumsum(np.abs(squares).sum(axis=0))
    edges = np.searchsorted(loud, np.arange(DELAY_BANDS) / DELAY_BANDS * loud[-1], side="right")
    return np.unique(np.minimum(edges, squares.shape[1] - 1))


def _over_bands(squares: Complexes, times: Floats, line: Floats, segments: Segments, hit: Ints) -> BandClock:
    """Fit what a line leaves in each part of the record and each band: one delay a band, one drift of them all.

    Bands have other delays where another floor was hit.

    A clock is late by the same in every band. The phases that a damper makes differ from band to band, and those that a
    sweep passes through at different times look like a drift where the bands may not have delays of their own.
    """
    omega, edges = segments.omega, _bands(squares)
    turned = squares * np.exp(2j * line[:, None] * omega[None, :])
    cells = np.add.reduceat(turned, edges, axis=1)
    middles = np.add.reduceat(np.abs(turned) * omega, edges, axis=1) / np.maximum(
        np.add.reduceat(np.abs(turned), edges, axis=1), 1e-300
    )
    middles = np.maximum(middles, omega[1])
    late, weight = -np.angle(cells) / (2 * middles), np.abs(cells) * middles**2
    off, around, parts = np.zeros(late.shape), np.zeros(late.shape), 0.0
    for floor in np.unique(hit):
        same = hit == floor
        total = np.maximum(weight[same].sum(axis=0), 1e-300)
        off[same] = late[same] - (weight * late)[same].sum(axis=0) / total
        around[same] = times[same, None] - (weight * times[:, None])[same].sum(axis=0) / total
        parts += float(np.sum(total**2 / np.maximum((weight[same] ** 2).sum(axis=0), 1e-300) - 1.0))
    information = float((weight * around**2).sum())
    slope = float((weight * around * off).sum()) / max(information, 1e-300)
    freedom = max(int(parts) - 1, 1)
    scatter = float((weight * (off - slope * around) ** 2).sum()) / freedom
    of_bands = np.maximum(weight.sum(axis=0), 1e-300)
    mean, shares = (weight * late).sum(axis=0) / of_bands, of_bands / of_bands.sum()
    middle = float(shares @ mean)
    spread = float(shares @ (mean - middle) ** 2)
    std = float(np.sqrt(scatter / of_bands.sum() + spread))
    return BandClock(middle, std, 1.0, 0.0, slope, float(np.sqrt(scatter / max(information, 1e-300))), freedom)


def _best_lines(table: Floats, around: Floats, step: float, grid: Floats) -> tuple[tuple[int, int], int]:
    """Return the line of the largest agreement, and the place of the largest agreement without a drift.

    A line is a place on the grid and the steps of drift from the middle to the end. The line has a drift only if the
    drift increases the agreement by more than `NO_DRIFT` allows.
    """
    half = max(float(np.abs(around).max()), 1e-9)
    most = int(FASTEST_DRIFT * half / step) if len(table) > 2 else 0
    best, without = (-np.inf, 0, 0), (-np.inf, 0)
    beside, length = np.pad(table, [(0, 0), (most, most)]), table.shape[1]
    for turns in range(-most, most + 1):
        total = np.zeros(length)
        for row, first in zip(beside, (most + np.round(turns * around / half).astype(int)).tolist(), strict=True):
            total += row[first : first + length]
        if turns and total.max() <= best[0]:
            continue
        tops = np.flatnonzero((total[1:-1] >= total[:-2]) & (total[1:-1] >= total[2:])) + 1
        if not tops.size:
            continue
        high = tops[total[tops] >= AS_GOOD * total[tops].max()]
        place = int(high[np.argmin(np.abs(grid[high]))])
        if turns == 0:
            without = (float(total[place]), place)
        if total[place] > best[0]:
            best = (float(total[place]), place, turns)
    line = (without[1], 0) if without[0] >= NO_DRIFT * best[0] else best[1:]
    return line, without[1]


def _climbed(squares: Complexes, line: Floats, segments: Segments, step: float) -> tuple[Floats, Floats]:
    """Climb to the top of the agreement near a line, for each part of the record; its height comes second."""
    omega = segments.omega
    tops, heights = [], []
    for square, start in zip(squares, line, strict=True):
        top = float(start)
        for _ in range(4):
            turned = square * np.exp(2j * omega * top)
            slope, bend = -2 * np.sum(omega * turned.imag), -4 * np.sum(omega**2 * turned.real)
            if bend >= 0:
                break
            top -= float(np.clip(slope / bend, -step, step))
        tops.append(top)
        heights.append(max(0.0, float(np.sum((square * np.exp(2j * omega * top)).real))))
    return np.array(tops), np.array(heights)
