"""One model of a channel: its ratio to the other channels over frequency and time, in phase and in amplitude.

Between two channels of a lightly damped frame the phase is nearly 0 or 180 degrees, at the modes and in the band
between them, and the amplitudes have one ratio at all times. A clock that is late by t turns each component of angular
frequency w by -w t, a first-order low-pass of corner c by -arctan(w / c), and a sensor that resonates by the phase of a
second-order factor. So the squared cross-spectra of a channel with all others have phases near twice that: a straight
line over frequency, which in a clock that drifts grows steeper with time and where samples are lost changes at one
instant, or an arctangent. A gain that steps changes the amplitudes at one instant. A channel without motion has no line
at all. Each of these is a hypothesis with a likelihood and a prior. A fault that is sure is corrected, or its channel
left out, the surest first, before the rest is judged again.

The phases of the modes tell a delay of less than half a sample more exactly (`offsets`). A damper turns single modes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
from scipy import special

from cvxshear.records import prepare
from cvxshear.records.record import Finding, TimeRecord, finding
from cvxshear.util import quantities, ranking
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Bools, Complexes, Floats, Ints

#: Probability beforehand of each mistake, one in fifty: that a clock is late, that it drifts, that a sensor is slow,
#: that a gain steps, that a channel carries no motion, is reversed or in another's place, and that a mode was missed.
FAULTY = 0.02
#: Longest delay, s: the segments of two channels then still share seven eighths; loggers started by hand are two
#: seconds apart. A delay of 1 to 2 ms is as probable as one of 1 to 2 s.
LONGEST_DELAY = prepare.SEGMENT / 8
#: Samples; the phases of the modes determine shorter delays more exactly.
SHORTEST_DELAY = 0.5
#: Corners of a first-order low-pass, over the sampling rate, a tenth apart: a lower one leaves no mode in the channel,
#: a higher one takes less than 3 % from any. All are as probable.
CORNERS = np.geomspace(0.02, 2.0, 47)
#: Damping ratios of a sensor's resonance at one of the corners: lively enough to be no delay.
RESONANT = np.array([0.05, 0.1, 0.2, 0.4])
#: s a second; crystals differ by a tenth of that at most.
FASTEST_DRIFT = 1e-3
#: Independent phases between a channel and another. Resonances and dampers turn neighboring lines together, so more
#: lines tell no more. From 40 to 80 a strong dashpot is no delay, and a delay of 16 samples beside it is sure.
PHASES = 50
#: Parts of a record, and parts of the spectrum of equal weight, in each of which the delay is estimated by itself.
CLOCK_PARTS = 8
#: Times the tenth of a channel's lines that hold least: below it a line counts little.
NOISE_FLOOR = 10.0


@dataclass(frozen=True, eq=False)
class Segments:
    """Spectra of a record in overlapping segments.

    Parameters
    ----------
    spectra : array of complex, shape (segments, lines, clocks)
        The channels, then the input where there is one.
    weights : array, shape (segments, lines, clocks)
        Between 0 and 1: the part of a line above the possible noise.
    times : array, shape (segments,)
        Middle of each, s; 0 for blows, whose runs do not say what passed between them.
    groups : list of array of int
        The segments of each part of the record in which delays are estimated by themselves.
    length : int
        Samples.
    rate : float
        Hz.
    decaying : bool
        Whether the motion decays from blows or releases.
    floors : int
        Number of channels that are not the input; they come first.
    """

    spectra: Complexes
    weights: Floats
    times: Floats
    groups: list[Ints]
    length: int
    rate: float
    decaying: bool
    floors: int

    @staticmethod
    def of(record: TimeRecord) -> Segments:
        """Cut a record into segments and transform them."""
        rate = record.sampling_rate
        length = min(int(prepare.SEGMENT * rate), *(run.samples for run in record.runs)) // 2 * 2
        blows = prepare.struck(record)
        decaying = blows or record.input == "free_decay"
        window = _window(length, decaying=decaying)
        spectra, times, started = [], [], 0
        for run in record.runs:
            both = [run.responses] if run.excitation is None else [run.responses, run.excitation[:, None]]
            values = np.column_stack(both)
            values = values - np.median(values, axis=0)
            for start in range(0, run.samples - length + 1, length // 2):
                spectra.append(np.fft.rfft(values[start : start + length] * window, axis=0))
                times.append(0.0 if blows else (started + start + length / 2) / rate)
            started += run.samples
        found = np.array(spectra)
        power = np.abs(found) ** 2
        floor = NOISE_FLOOR * np.quantile(power.mean(axis=0)[2:], 0.1, axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            weights = np.nan_to_num(power / (power + floor)) ** 2
        weights[:, :2] = 0.0
        groups = np.array_split(np.arange(len(times)), min(CLOCK_PARTS, len(times)))
        return Segments(
            found, weights, np.array(times), groups, length, rate, decaying, record.runs[0].responses.shape[1]
        )

    @property
    def omega(self) -> Floats:
        """Angular frequency of each line, rad/s."""
        return 2 * np.pi * np.arange(self.spectra.shape[1]) * self.rate / self.length

    def earlier(self, clock: int, seconds: float, slope: float) -> Segments:
        """Correct a clock that is late by `seconds` at the start of the record, and by `slope` more in each second."""
        spectra = self.spectra.copy()
        spectra[:, :, clock] *= np.exp(1j * np.outer(seconds + slope * self.times, self.omega))
        return replace(self, spectra=spectra)

    def against(self, clock: int, others: list[int]) -> ChannelRatios:
        """Compare a clock with others."""
        pairs, levels, weights = [], [], np.zeros(self.spectra.shape[:2])
        for other in others:
            cross = self.spectra[:, :, clock] * np.conj(self.spectra[:, :, other])
            size, weight = np.abs(cross), self.weights[:, :, clock] * self.weights[:, :, other]
            # Squared, the phasors of 0 and of 180 degrees are the same.
            square = weight * np.divide(cross, size, out=np.zeros_like(cross), where=size > 0) ** 2
            pairs.append([square[group].sum(axis=0) for group in self.groups])
            weights += weight
            # A line's amplitude over the other's has one level at all times.
            over = np.abs(self.spectra[:, :, [clock, other]])
            level = np.subtract(*np.moveaxis(np.log(np.maximum(over, 1e-300)), 2, 0))
            level = level - (weight * level).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
            levels.append((weight * level).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300))
        by_group = np.array([weights[group].sum() for group in self.groups])
        times = np.array([self.times[group].mean() for group in self.groups])
        many = weights.sum() ** 2 / max(float((weights**2).sum()), 1e-300)
        chance = 1.0 / np.sqrt(2.0 * max(many, 1.0))
        floors = np.maximum(clock, others) < self.floors
        return ChannelRatios(
            np.array(pairs), by_group, times, np.median(levels, axis=0), weights.sum(axis=1), chance, floors, self
        )


@dataclass(frozen=True, eq=False)
class ChannelRatios:
    """A channel over others: the squared phasors of its cross-spectra, and its amplitudes.

    Parameters
    ----------
    pairs : array of complex, shape (others, groups, lines)
    weights : array, shape (groups,)
    times : array, shape (groups,)
        s.
    levels : array, shape (segments,)
        Logarithm of its amplitude over the others', less the mean over time: the median of the others.
    loudness : array, shape (segments,)
        Weights of the levels.
    chance : float
        Agreement that a channel without motion has at one delay by chance.
    floors : array of bool, shape (others,)
        Whether neither is the input, over which every floor has the resonances of the frame.
    segments : Segments
    """

    pairs: Complexes
    weights: Floats
    times: Floats
    levels: Floats
    loudness: Floats
    chance: float
    floors: Bools
    segments: Segments

    @cached_property
    def squares(self) -> Complexes:
        """Against all others together, shape (groups, lines)."""
        return np.asarray(self.pairs.sum(axis=0))

    def fault(self) -> ChannelFault:
        """Find the first fault that is sure: samples lost, a slow sensor, a drift, a delay or a step of the gain."""
        drifting, curved = self._fitted(*self._best_line[1:]), self._curved()
        # What a slow sensor leaves of a line differs from band to band, and the bands are loud at different times.
        ordered = (drifting, curved) if curved.late else (curved, drifting)
        for told in (self._lost(), *ordered, self._stepped()):
            if told is not None and told.probability >= quantities.SURE:
                return told
        return ChannelFault("", 0.0, 0.0)

    def _curved(self) -> ChannelFault:
        """Weigh delays, low-passes and resonances, each one curve of phase over frequency, against none."""
        each, rate = self.pairs.sum(axis=1), self.segments.rate
        grid, delayed = self._delays(each)
        beyond = np.abs(grid) >= SHORTEST_DELAY / rate
        lags, omega = grid[beyond], self.segments.omega[:, None] / (2 * np.pi * rate)
        # In a decay there is motion at the modes alone, and a damper turns single modes as a resonance does.
        ratios = RESONANT[:0] if self.segments.decaying else RESONANT
        at, ratios = (item.ravel() for item in np.meshgrid(CORNERS, ratios))
        ringing = np.arctan2(2.0 * ratios * omega / at, 1.0 - (omega / at) ** 2)
        curves = np.exp(2j * np.hstack([np.arctan(omega / CORNERS), ringing]))
        slow = (each @ curves).real
        sound = delayed[:, ~beyond].max(axis=1, keepdims=True)
        slow[~self.floors, len(CORNERS) :] = sound[~self.floors]
        agreement = np.hstack([sound, delayed[:, beyond], slow])
        likely = PHASES * _log_likelihood(agreement / np.maximum(np.abs(each).sum(axis=1, keepdims=True), 1e-300)).mean(
            axis=0
        )
        priors = [1.0 / np.abs(lags) / np.sum(1.0 / np.abs(lags))]
        priors += [np.full(count, 1.0 / max(count, 1)) for count in (len(CORNERS), len(at))]
        logs = np.append(0.0, np.log(FAULTY * np.concatenate(priors)))
        slows = ranking.weigh(likely, logs)[1 + len(lags) :]
        first = ranking.first_largest(slows)
        # A clock that drifts leaves less of the highest frequencies, too, but agrees better with its own line.
        if slows.sum() >= quantities.SURE and (self.squares @ curves[:, first]).real.sum() > self._best_line[0]:
            evidence = float(likely[1 + len(lags) + first] - likely[0])
            kind = "low-pass" if first < len(CORNERS) else "resonance"
            return ChannelFault(kind, float(slows.sum()), evidence, rate * float(np.append(CORNERS, at)[first]))
        chances = ranking.weigh(likely[: 1 + len(lags)], logs[: 1 + len(lags)])
        best = ranking.first_largest(chances[1:])
        evidence = float(likely[1 + best] - likely[0])
        near = np.abs(lags - lags[best]) <= SHORTEST_DELAY / rate
        probability = float(chances[1:][near].sum())
        return replace(self._fitted(float(lags[best]), 0.0, drifts=False), probability=probability, evidence=evidence)

    def _stepped(self) -> ChannelFault | None:
        """Find the instant at which the amplitudes change; None where no order of time is known."""
        times, weight = self.segments.times, self.loudness
        if len(times) < CLOCK_PARTS or np.any(np.diff(times) <= 0):
            return None
        before, first = np.cumsum(weight)[:-1], np.cumsum(weight * self.levels)[:-1]
        whole, total = max(float(weight.sum()), 1e-300), float(weight @ self.levels)
        between = whole * (first - before * total / whole) ** 2 / np.maximum(before * (whole - before), 1e-300)
        scatter = float(weight @ (self.levels - total / whole) ** 2) + 1e-300
        # Student's likelihood of as many segments as weigh; they overlap by half.
        count = 0.5 * whole**2 / max(float(weight @ weight), 1e-300)
        gains = -0.5 * count * np.log(np.maximum(1.0 - between / scatter, 1e-12))
        chances = ranking.weigh(
            np.append(0.0, gains), np.log(np.append(1.0 - FAULTY, np.full(len(gains), FAULTY / len(gains))))
        )
        split = ranking.first_largest(gains)
        parts = np.maximum([before[split], whole - before[split]], 1e-300)
        step = (total - first[split]) / parts[1] - first[split] / parts[0]
        time = float(times[split : split + 2].mean())
        return ChannelFault("gain step", float(1.0 - chances[0]), float(gains[split]), float(np.exp(step)), time=time)

    def _lost(self) -> ChannelFault | None:
        """Find the delay that changes at one instant, as where samples are lost; None where no order of time is known.

        One delay before the instant and another after it are weighed against the best line.
        """
        if len(self.times) < 2 or np.any(np.diff(self.times) <= 0):
            return None
        grid, table = self._delays(self.squares)
        before = np.cumsum(table, axis=0)[:-1]
        after = before[-1] + table[-1] - before
        tops = before.max(axis=1) + after.max(axis=1)
        split = ranking.first_largest(tops)
        early, late = (float(grid[ranking.first_largest(each[split])]) for each in (before, after))
        size = max(float(np.abs(self.squares).sum()), 1e-300)
        gain = PHASES * float(_log_likelihood(tops[split] / size) - _log_likelihood(self._best_line[0] / size))
        chance = ranking.weigh([0.0, gain + np.log(FAULTY / (len(tops) * len(grid)))])[1]
        jump, time = late - early, float(self.times[split : split + 2].mean())
        sure = float(chance) if abs(jump) >= SHORTEST_DELAY / self.segments.rate else 0.0
        return ChannelFault("lost samples", sure, gain, jump, time=time)

    def _delays(self, squares: Complexes) -> tuple[Floats, Floats]:
        """Sum phasors over the lines, turned back by each delay, shape (..., delays); the delays come first."""
        length, rate = self.segments.length, self.segments.rate
        samples = 4 * length
        grid = (np.arange(samples) - samples // 2) * length / (2 * rate * samples)
        near = np.abs(grid) <= LONGEST_DELAY
        return grid[near], np.fft.fftshift(np.fft.ifft(squares, n=samples).real * samples, axes=-1)[..., near]

    @cached_property
    def _around(self) -> Floats:
        return np.asarray(self.times - np.average(self.times, weights=np.maximum(self.weights, 1e-300)))

    @property
    def _steps_of_drift(self) -> tuple[float, int]:
        """The step of the search over drifts, s a second, which is an eighth of a sample at the end; and how many."""
        step = 1.0 / (8 * self.segments.rate * max(float(np.abs(self._around).max()), 1e-9))
        return step, int(FASTEST_DRIFT / step) if len(self.times) > 2 else 0

    @cached_property
    def _best_line(self) -> tuple[float, float, float]:
        """Find the largest agreement on a grid, with its delay at the mean time and its drift."""
        step, most = self._steps_of_drift
        grid, table = self._delays(self.squares)
        beside, half = np.pad(table, [(0, 0), (most, most)]), max(float(np.abs(self._around).max()), 1e-9)
        best = (-np.inf, 0.0, 0.0)
        for turns in sorted(range(-most, most + 1), key=abs):
            firsts = (most + np.round(turns * self._around / half).astype(int)).tolist()
            top = np.sum([row[first : first + len(grid)] for row, first in zip(beside, firsts, strict=True)], axis=0)
            place = ranking.first_largest(top)
            best = max(best, (float(top[place]), float(grid[place]), turns * step), key=itemgetter(0))
        return best

    def _fitted(self, late: float, slope: float, *, drifts: bool = True) -> ChannelFault:
        """Fit what a line leaves in each part of the record and each band: one delay a band, one drift of them all.

        A clock is late by the same in every band. The phases that a damper makes differ from band to band, and those
        that a sweep passes through at different times look like a drift where bands may not have delays of their own.
        """
        omega, around = self.segments.omega, self._around
        # The line that was found is corrected twice: the first leaves half a step of the grid.
        for _ in range(2):
            turned = self.squares * np.exp(2j * np.outer(late + slope * around, omega))
            loud = np.cumsum(np.abs(self.squares).sum(axis=0))
            edges = np.searchsorted(loud, np.arange(CLOCK_PARTS) / CLOCK_PARTS * loud[-1], side="right")
            edges = np.unique(np.minimum(edges, len(omega) - 1))
            cells, sizes = (np.add.reduceat(each, edges, axis=1) for each in (turned, np.abs(turned)))
            middles = np.add.reduceat(np.abs(turned) * omega, edges, axis=1) / np.maximum(sizes, 1e-300)
            middles = np.maximum(middles, omega[1])
            left, weight = -np.angle(cells) / (2 * middles), np.abs(cells) * middles**2
            of_bands = np.maximum(weight.sum(axis=0), 1e-300)
            mean = (weight * left).sum(axis=0) / of_bands
            off, times = left - mean, around[:, None] - (weight * around[:, None]).sum(axis=0) / of_bands
            parts = float(np.sum(of_bands**2 / np.maximum((weight**2).sum(axis=0), 1e-300) - 1.0))
            information = max(float((weight * times**2).sum()), 1e-300)
            more = float((weight * times * off).sum()) / information
            freedom = max(int(parts) - 1, 1)
            scatter = float((weight * (off - more * times) ** 2).sum()) / freedom
            shares = of_bands / of_bands.sum()
            late, slope = late + float(shares @ mean), slope + more
        if not drifts:
            std = float(np.sqrt(scatter / of_bands.sum() + shares @ (mean - shares @ mean) ** 2))
            return ChannelFault("clock offset", 0.0, 0.0, late, std, late=(late, 0.0))
        std = max(float(np.sqrt(scatter / information)), 1e-300)
        # Student's likelihood of the slope with that of none, and a uniform prior. A slope that the data do not tell
        # keeps its prior probability.
        gain = 0.5 * (freedom + 1) * np.log1p((slope / std) ** 2 / freedom)
        share = min(std * np.sqrt(2 * np.pi) / (2 * FASTEST_DRIFT), 1.0)
        probability = float(ranking.weigh([0.0, gain + np.log(FAULTY * share)])[1])
        start = late - slope * float(np.average(self.times, weights=np.maximum(self.weights, 1e-300)))
        return ChannelFault("clock drift", probability, float(gain), slope, std, late=(start, slope))

    @cached_property
    def agreement(self) -> float:
        """Largest agreement over all delays and drifts: 1 for all lines of one phase, 0 for nothing in common."""
        return self._best_line[0] / max(float(self.weights.sum()), 1e-300)

    @property
    def by_chance(self) -> float:
        """The agreement that a channel without motion exceeds at some delay or drift with probability `FAULTY`."""
        tried = 2 * LONGEST_DELAY * 8 * self.segments.rate * (2 * self._steps_of_drift[1] + 1)
        return self.chance * float(np.sqrt(2.0 * np.log(tried / FAULTY)))

    def nearer(self, seconds: float) -> bool:
        """Whether the phases of the whole band agree better with a delay than without one."""
        turned = self.squares.sum(axis=0) * np.exp(2j * self.segments.omega * seconds)
        return bool(turned.real.sum() > self.squares.real.sum())


@dataclass(frozen=True)
class ChannelFault:
    """A fault of a channel.

    Parameters
    ----------
    kind : str
        That of its finding; empty where there is none.
    probability : float
    evidence : float
        Log likelihood of the fault over that of a sound channel.
    size, std : float, optional
        Seconds of a delay, or by which it changes; seconds a second; a low-pass's corner or a resonance, Hz; a step's
        factor.
    time : float or None, optional
        When it changes, s.
    late : (float, float), optional
        What is to be taken out: seconds at the start of the record, and more in each second after. Where it is missing,
        the channel is left out.
    """

    kind: str
    probability: float
    evidence: float
    size: float = 0.0
    std: float = 0.0
    time: float | None = None
    late: tuple[float, float] | None = None


def _log_likelihood(agreement: Floats | float) -> Floats:
    """Log likelihood of a phase about its line, the most that a von Mises distribution of any width gives.

    An agreement R has the concentration k = R (2 - R^2) / (1 - R^2), nearly (Banerjee, Dhillon, Ghosh and Sra 2005).
    """
    r = np.clip(agreement, 0.0, 1.0 - 1e-4)
    k = r * (2.0 - r**2) / (1.0 - r**2)
    return np.asarray(k * (r - 1.0) - np.log(special.ive(0, k)))


def with_right_channels(record: TimeRecord) -> tuple[TimeRecord, list[Finding]]:
    """Leave out channels that cannot be mended, and set clocks right that are late or drift."""
    names = [channel.name for channel in record.channels]
    clocks = names if record.runs[0].excitation is None else [*names, "input"]
    if len(clocks) < 2 or min(run.samples for run in record.runs) < 4 * record.sampling_rate:
        return record, []
    segments = Segments.of(record)
    everyone = list(range(len(clocks)))
    compared = [segments.against(clock, [k for k in everyone if k != clock]) for clock in everyone]
    common = np.array([each.agreement for each in compared])
    reference = ranking.first_largest(common)
    chances = np.array([each.by_chance for each in compared])
    heard = common > chances
    # Where most channels show no more than chance the record is too short to tell.
    out = [clock for clock in range(len(names)) if not heard[clock] and 2 * heard.sum() > len(clocks)]
    findings = []
    for place in out:
        channel, chance = record.channels[place], float(chances[place])
        numbers = {"channel": channel.name, "floor": channel.floor, "agreement": float(common[place]), "out": True}
        findings.append(finding("dead channel/silent", numbers, where=channel, chance=chance))
    wrong: dict[int, tuple[float, float]] = {}
    while len(wrong) + len(out) < len(clocks) / 2:
        left = [clock for clock in everyone if clock not in out]
        others = [clock for clock in left if clock not in wrong]
        faults = [segments.against(clock, [k for k in left if k != clock]).fault() for clock in others]
        worst = ranking.first_largest(
            [each.evidence if each.probability >= quantities.SURE else 0.0 for each in faults]
        )
        fault, clock = faults[worst], others[worst]
        if fault.probability < quantities.SURE:
            break
        against = reference if clock != reference else max(
            (k for k in left if k != clock), key=lambda k: float(common[k])
        )  # fmt: skip
        where = str(record.channels[clock]) if clock < len(names) else "the input channel"
        findings.append(_said(fault, clocks[clock], where, clocks[against], record.sampling_rate))
        if fault.late is None:
            out.append(clock)
        else:
            wrong[clock] = fault.late
            segments = segments.earlier(clock, *fault.late)
    record = prepare.without(record, findings)
    return (prepare.in_step(record, {clocks[k]: late for k, late in wrong.items()}) if wrong else record), findings


#: What the size of a fault that cannot be mended is called.
FAULT_SIZES = {"low-pass": "corner", "resonance": "corner", "gain step": "factor", "lost samples": "samples"}


def _said(fault: ChannelFault, name: str, where: str, reference: str, rate: float) -> Finding:
    """Report a fault by the phases of the whole band: its channel, but not the input, is left out, or set right."""
    if fault.late is None:
        numbers = {"channel": name, "out": name != "input", "probability": fault.probability, "time": fault.time}
        numbers[FAULT_SIZES[fault.kind]] = round(abs(fault.size) * rate) if fault.kind == "lost samples" else fault.size
        what, left_out = "loses" if fault.size < 0 else "repeats", "; left out" if numbers["out"] else ""
        return finding(fault.kind, numbers, where=where, what=what, left_out=left_out)
    start = fault.late[0]
    numbers = {"channel": name, "reference": reference, "seconds": start, "corrected": True}
    late = "late" if start > 0 else "early"
    if fault.kind == "clock drift":
        numbers |= {"drift": fault.size, "drift_std": fault.std}
        slow, std = "slow" if fault.size > 0 else "fast", quantities.significant(1e6 * fault.std, 2)
        return finding("clock drift", numbers, slow=slow, by=abs(fault.size), std=std, start=abs(start), late=late)
    numbers |= {"std": fault.std}
    spread = quantities.significant(1e3 * fault.std, 2)
    return finding("clock offset", numbers, by=abs(start), late=late, spread=spread)


def _window(length: int, *, decaying: bool) -> Floats:
    """Hann's window, its rise cut to a tenth where what comes first is loudest, shape (length, 1)."""
    if not decaying:
        return np.hanning(length)[:, None]
    rise = length // 10
    return np.concatenate([np.hanning(2 * rise)[:rise], np.hanning(2 * (length - rise))[length - rise :]])[:, None]


#: Largest offset, s, looked for in the phases of the modes: the phases of the whole band show longer ones before.
LONGEST = 0.05
#: Offsets tried between the two largest: steps of 25 microseconds turn a mode at 100 Hz by one degree. As many corners
#: of a low-pass.
STEPS = 4001
#: Degrees, root mean square over the modes: uneven damping turns the entries of lightly damped modes by as much.
LEAST_PHASE = 0.3
#: Fraction of half the sampling rate. At higher frequencies, aliasing turns the phases of resonances.
FOLDED = 0.85


def folded_phase(values: Complexes) -> Floats:
    """Angle off the real axis to the nearer side, rad."""
    return np.angle(values * np.where(values.real < 0, -1.0, 1.0))


def rms_phase(values: Complexes) -> float:
    """Root mean square angle off the real axis, degrees, weighted by the squared moduli."""
    weight = np.abs(values) ** 2
    return float(np.degrees(np.sqrt(np.sum(weight * folded_phase(values) ** 2) / np.sum(weight))))


@dataclass(frozen=True, eq=False)
class Offsets:
    """Estimated clock offsets.

    Parameters
    ----------
    seconds : array, shape (clocks,)
        Positive where a channel's record is late, against the clock that is nearest to all the others; the
        channels in order of floor, then the input where its clock is seen.
    unexplained : array, shape (clocks,)
        Root mean square angle to the clock that the offsets count from, degrees, that the offset leaves over the modes.
    reference : int
        The clock that the offsets count from.
    """

    seconds: Floats
    unexplained: Floats
    reference: int


def offsets(
    eigenvalues: Complexes,
    shapes: Complexes,
    participations: Complexes | None = None,
    reference: int | None = None,
    sampling_rate: float = np.inf,
    loud: Bools | None = None,
) -> Offsets:
    """Estimate the offset of every channel's clock.

    Parameters
    ----------
    eigenvalues : array of complex, shape (modes,)
        1/s.
    shapes : array of complex, shape (modes, channels)
    participations : array of complex, shape (modes,), optional
        What turns each shape into a residue that is real for a real mode and clocks that agree; the input's
        clock is then estimated as well.
    reference : int, optional
        The clock to count from; the one nearest to all the others where None.
    sampling_rate : float, optional
        Hz. Modes above `FOLDED` of its half do not count, where two others are left.
    loud : array of bool, shape (modes,), optional
        The modes that count, where they are two at least: a straight line takes each for as sure as the others.

    Returns
    -------
    Offsets
    """
    omega = np.abs(eigenvalues.imag)
    used = np.ones(len(omega), dtype=bool)
    for heard in (omega <= FOLDED * np.pi * sampling_rate, used if loud is None else loud):
        if np.count_nonzero(used & heard) >= 2:
            used = used & heard
    omega, shapes = omega[used], shapes[used]
    if participations is not None:
        phasors = shapes * participations[used, None]
    else:
        floor = ranking.first_largest(np.min(np.abs(shapes), axis=0))
        phasors = shapes * np.conj(shapes[:, [floor]])
    phasors = phasors / np.maximum(np.linalg.norm(phasors, axis=1, keepdims=True), 1e-300)
    seconds = np.array([_slope(omega, column) for column in phasors.T])
    if participations is not None:
        seconds, phasors = np.append(seconds, 0.0), np.column_stack([phasors, np.ones(len(omega))])
    if reference is None:
        # Of an even number of clocks the two in the middle are equally near to all the others.
        reference = ranking.first_largest(-np.sum(np.abs(seconds[:, None] - seconds[None, :]), axis=1))
    seconds = seconds - seconds[reference]
    between = phasors * np.conj(phasors[:, [reference]])
    left = [rms_phase(column * np.exp(1j * omega * each)) for column, each in zip(between.T, seconds, strict=True)]
    return Offsets(seconds, np.array(left), reference)


def undone(eigenvalues: Complexes, shapes: Complexes, seconds: Floats) -> Complexes:
    """Take the offsets' turns back, shape (modes, channels)."""
    turn = np.exp(1j * np.abs(eigenvalues.imag)[:, None] * seconds[None, : shapes.shape[1]])
    return np.asarray(shapes * turn)


def slow_sensor(omega: Floats, phasors: Complexes, rate: float) -> tuple[float, float]:
    """Weigh a first-order low-pass against a late clock, by the phases that each leaves of the modes.

    Parameters
    ----------
    omega : array, shape (modes,)
        rad/s.
    phasors : array of complex, shape (modes,)
        The channel over another.
    rate : float
        Sampling rate, Hz.

    Returns
    -------
    corner : float
        Hz.
    probability : float
    """
    corners = rate * np.geomspace(CORNERS[0], CORNERS[-1], STEPS)
    left = folded_phase(phasors * np.exp(1j * np.arctan(np.outer(0.5 / (np.pi * corners), omega))))
    best = ranking.first_largest(-(left**2) @ np.abs(phasors) ** 2)
    slow = rms_phase(phasors * np.exp(1j * np.arctan(omega / (2 * np.pi * corners[best]))))
    line = rms_phase(phasors * np.exp(1j * omega * _slope(omega, phasors)))
    # Both have one parameter, and the scatter of the phases is unknown.
    likely = -(len(omega) - 1.0) * np.log(np.hypot([line, slow], LEAST_PHASE))
    return float(corners[best]), float(ranking.weigh(likely)[1])


def _slope(omega: Floats, phasors: Complexes) -> float:
    """Find the offset that makes the phasors most nearly real, the smallest of several that do."""
    longest = min(LONGEST, 0.5 * np.pi / float(omega.min()))
    grid = np.linspace(-longest, longest, STEPS)
    turned = phasors[None, :] * np.exp(1j * grid[:, None] * omega[None, :])
    cost = np.sum(turned.imag**2, axis=1) / np.sum(np.abs(phasors) ** 2)
    start = grid[int(np.argmin(cost + 1e-3 * np.abs(grid) / longest))]
    # On the line the remaining angles are small, and least squares in the angle is a division.
    for _ in range(5):
        angle, weight = folded_phase(phasors * np.exp(1j * start * omega)), np.abs(phasors) ** 2
        start -= float(np.sum(weight * omega * angle) / np.sum(weight * omega**2))
    return float(start)
