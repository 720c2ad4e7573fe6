"""Spectra of a record in overlapping segments, and the agreement of two channels, for the comparison of clocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.records.record import TimeRecord
from cvxshear.records.signals import struck
from cvxshear.util.typing import Complexes, Floats, Ints

SEGMENT = 20.0
"""s; long beside the longest delay, short enough that a record has many."""
GROUPS = 12
"""Parts of a record in which the delay is estimated by itself."""
NOISE_FLOOR = 10.0
"""Times the tenth of a channel's lines that hold least: below it a line counts little."""
BETWEEN_RESONANCES = 0.03
"""Of the highest line: below it lines of a decay count little. There the tails of several modes overlap, with phases
that change from release to release; counted in full, drifts erred by twice their standard deviations."""
MAINS = (50.0, 60.0)
"""Mains frequencies, Hz; their lines, harmonics up to the third and aliases are not used."""


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
        Middle of each, s.
    groups : list of array of int
        The segments of each part of the record in which delays are estimated by themselves.
    hit : array of int, shape (groups,)
        The floor that a hammer hit in each; 0 for other records.
    length : int
        Samples.
    rate : float
        Hz.
    """

    spectra: Complexes
    weights: Floats
    times: Floats
    groups: list[Ints]
    hit: Ints
    length: int
    rate: float

    @staticmethod
    def of(record: TimeRecord) -> Segments:
        """Cut a record into segments and transform them."""
        rate = record.sampling_rate
        length = min(int(SEGMENT * rate), *(run.samples for run in record.runs)) // 2 * 2
        blows = struck(record)
        window = _window(length, decaying=blows or record.input == "free_decay")
        spectra, times, driven, started = [], [], [], 0
        for run in record.runs:
            both = [run.responses] if run.excitation is None else [run.responses, run.excitation[:, None]]
            values = np.column_stack(both)
            values = values - np.median(values, axis=0)
            for start in range(0, run.samples - length + 1, length // 2):
                spectra.append(np.fft.rfft(values[start : start + length] * window, axis=0))
                times.append((started + start + length / 2) / rate)
                driven.append(run.floor if blows else 0)
            started += run.samples
        found = np.array(spectra)
        power = np.abs(found) ** 2
        floor = NOISE_FLOOR * np.quantile(power.mean(axis=0)[2:], 0.1, axis=0)
        mains = mains_lines(length, rate)
        if record.input == "free_decay":
            loudest = np.delete(power.mean(axis=0), mains, axis=0).max(axis=0)
            floor = np.maximum(floor, BETWEEN_RESONANCES * loudest)
        with np.errstate(invalid="ignore", divide="ignore"):
            weights = np.nan_to_num(power / (power + floor)) ** 2
        weights[:, mains] = 0.0
        weights[:, :2] = 0.0
        # With dampers a frame answers to a blow at another floor with other phases.
        by_floor = [np.flatnonzero(np.array(driven) == floor) for floor in np.unique(driven)]
        counts = [min(max(1, round(GROUPS * len(each) / len(times))), len(each)) for each in by_floor]
        groups = [part for each, count in zip(by_floor, counts, strict=True) for part in np.array_split(each, count)]
        hit = np.array([driven[group[0]] for group in groups])
        return Segments(found, weights, np.array(times), groups, hit, length, rate)

    def agreement(self, first: int, second: int) -> tuple[Complexes, Floats, Floats, float]:
        """Find what two clocks agree in: squared phasors and their weights by groups, mean times, and the chance level.

        Squared, the phasors of nought and half a turn are the same.
        """
        cross = self.spectra[:, :, first] * np.conj(self.spectra[:, :, second])
        size = np.abs(cross)
        weight = self.weights[:, :, first] * self.weights[:, :, second]
        square = weight * np.divide(cross, size, out=np.zeros_like(cross), where=size > 0) ** 2
        many = weight.sum() ** 2 / max(float((weight**2).sum()), 1e-300)
        return (
            np.array([square[group].sum(axis=0) for group in self.groups]),
            np.array([weight[group].sum() for group in self.groups]),
            np.array([self.times[group].mean() for group in self.groups]),
            float(1.0 / np.sqrt(2.0 * max(many, 1.0))),
        )

    @property
    def omega(self) -> Floats:
        """Angular frequency of each line, rad/s."""
        return 2 * np.pi * np.arange(self.spectra.shape[1]) * self.rate / self.length

    def agreed(self, first: int, second: int, seconds: float) -> float:
        """Find the agreement in phase of two clocks if the first is late by a delay: 1 for complete agreement."""
        squares, weights, _, _ = self.agreement(first, second)
        turn = np.exp(2j * self.omega * seconds)
        return float(np.sum((squares.sum(axis=0) * turn).real) / max(float(weights.sum()), 1e-300))


def _window(length: int, *, decaying: bool) -> Floats:
    """Hann's window, its rise cut to a tenth where what comes first is loudest, shape (length, 1)."""
    if not decaying:
        return np.hanning(length)[:, None]
    rise = max(length // 10, 2)
    return np.concatenate([np.hanning(2 * rise)[:rise], np.hanning(2 * (length - rise))[length - rise :]])[:, None]


def mains_lines(length: int, rate: float) -> Ints:
    """List the lines of a spectrum at mains frequencies and their aliases."""
    places = {
        round(abs((multiple * mains + rate / 2) % rate - rate / 2) * length / rate) + near
        for mains in MAINS
        for multiple in (1, 2, 3)
        for near in (-1, 0, 1)
    }
    return np.array([place for place in sorted(places) if 0 <= place <= length // 2], dtype=np.int64)
