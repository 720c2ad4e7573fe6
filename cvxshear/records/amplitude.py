"""Frequencies that depend on amplitude: strong parts of a record against weak ones, a whole decay against its end."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from scipy import special

from cvxshear.records.estimate import Replication, jackknife
from cvxshear.records.findings import finding
from cvxshear.records.frf import ImpulseSource
from cvxshear.records.picking import Parts, Values
from cvxshear.records.realization import Impulse
from cvxshear.records.record import Finding
from cvxshear.records.result import ModalResult
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats

SIGNIFICANT = 3.0
"""Report changes of frequency above this number of standard deviations; chance exceeds it for one mode in 370."""
SMALLEST_CHANGE = 1e-3
"""Least relative change of frequency in a report; four degrees of temperature have this effect on a steel frame."""
SCATTERED = 2.5
"""The same of the halves' own scatter, by Student's t, besides: a dozen blocks tell it to a fifth."""
ALL_TOGETHER = 4.0
"""Standard deviations that the changes of all modes have together, their sum over the root of their number: one of 88
simulated records of linear frames reached 3.0, and their root mean square was 1.2."""
SCATTERS = 3.0
"""Times that a frequency scatters in the stronger half of a record what it does in the weaker: the variances of ten
equal blocks each have that ratio by chance once in 740 modes, and noise, which is less of the stronger half, makes it
smaller."""
STRONGER = 1.5
"""Times the motion of the weaker half: below, both halves are alike, and neither has to scatter more."""
FEWEST_BLOCKS = 8
"""Blocks of which half, four, still determine the modes and show how they scatter."""


def amplitude_findings(setting: Replication, result: ModalResult) -> Iterator[Finding]:
    """Modes whose frequency differs between strong and weak motion by more than chance allows."""
    if setting.source.unit == "block" and len(setting.source.groups) >= FEWEST_BLOCKS:
        yield from _strong_against_weak(setting, result)
    elif setting.source.impulse() is not None:
        yield from _early_against_late(setting, result)


def _strong_against_weak(setting: Replication, result: ModalResult) -> Iterator[Finding]:
    energies = setting.source.energies
    strong = energies > np.median(energies)
    first, second = _log_frequencies(setting, strong), _log_frequencies(setting, ~strong)
    if first is None or second is None:
        return
    ratio = float(np.sqrt(energies[strong].mean() / energies[~strong].mean()))
    changes = first - second
    large = np.abs(changes) > np.maximum(SIGNIFICANT * 2 * result.frequency_std, SMALLEST_CHANGE)
    scattered = (ratio > STRONGER) & (result.frequency_std > SMALLEST_CHANGE)
    if not np.any(large | scattered):
        # How the halves scatter, which takes as long as all the rest, could not make anything of that.
        return
    stronger, weaker = _scatter(setting, strong), _scatter(setting, ~strong)
    if stronger is None or weaker is None:
        return
    (first_std, first_freedom), (second_std, second_freedom) = stronger, weaker
    # Noise that the stronger half hardly shows may be a tenth of the weaker: each half says itself how it scatters.
    student = special.stdtrit(np.minimum(first_freedom, second_freedom), special.ndtr(SCATTERED))
    std = np.hypot(first_std, second_std)
    score = np.divide(changes, std, out=np.zeros(len(std)), where=std > 0)
    together = float(np.sum(score) / np.sqrt(len(score)))
    certain = large & ((np.abs(score) > student) | ((abs(together) > ALL_TOGETHER) & (score * together > 0)))
    # A sweep may pass a mode in the weaker half; all blocks together then determine its frequency better.
    scatter = np.minimum(first_std, result.frequency_std)
    suspected = scattered & (scatter > np.maximum(SCATTERS * second_std, SMALLEST_CHANGE))
    for place in np.flatnonzero(certain | suspected).tolist():
        mode, change = int(result.modes[place]), float(changes[place])
        numbers = {"mode": mode, "std": float(std[place]), "amplitude_ratio": ratio}
        if certain[place]:
            yield finding(
                "amplitude", {**numbers, "change": change}, strong=np.exp(first[place]), weak=np.exp(second[place]),
                score=abs(score[place]), together=abs(together),
            )  # fmt: skip
        else:
            yield finding("amplitude/scatter", numbers, strong=first_std[place], weak=second_std[place])


def _scatter(setting: Replication, half: Bools) -> tuple[Floats, Floats] | None:
    """Find the standard deviations of the log frequencies of half of the blocks, and their degrees of freedom."""
    blocks = np.flatnonzero(half)

    def estimate(keep: Bools) -> Floats | None:
        left = np.zeros(len(half), dtype=bool)
        left[blocks[keep]] = True
        return _log_frequencies(setting, left)

    try:
        covariance, freedom, _ = jackknife(estimate, np.zeros(len(blocks), dtype=np.int64), np.ones(len(blocks)))
    except InputError:
        return None
    return np.sqrt(np.diag(covariance)), freedom


def _log_frequencies(setting: Replication, keep: Bools) -> Floats | None:
    return _logarithms(setting, setting.values(keep))


def _logarithms(setting: Replication, values: Values | None) -> Floats | None:
    return None if values is None else np.log(np.abs(values.eigenvalues + setting.shift) / (2 * np.pi))


def _early_against_late(setting: Replication, result: ModalResult) -> Iterator[Finding]:
    """Compare the impulse response from its start with the same once it has decayed to a third."""
    later = _later(setting, None)
    if later is None:
        return
    change = np.log(result.frequencies) - later
    if np.all(np.abs(change) < SMALLEST_CHANGE):
        return
    std = np.maximum(result.frequency_std * _grown(setting, result), _std_of_change(setting))
    for place, mode in enumerate(result.modes):
        bound = SIGNIFICANT * std[place]
        if abs(change[place]) > max(bound, SMALLEST_CHANGE):
            numbers = {"mode": int(mode), "change": float(change[place]), "chance": float(bound)}
            yield finding("amplitude/decay", numbers, whole=result.frequencies[place], later=np.exp(later[place]))


def _grown(setting: Replication, result: ModalResult) -> Floats:
    """Loss of signal-to-noise ratio of each mode when the decay becomes weak."""
    impulse = setting.source.impulse()
    begun = None if impulse is None else _weak_from(impulse)
    if impulse is None or begun is None:
        return np.ones(len(result.modes))
    lost = 2 * np.pi * result.frequencies * result.damping_ratios * (begun - impulse.start)
    return np.asarray(np.exp(np.clip(lost / setting.source.sampling_rate, 0.0, 50.0)))


def _std_of_change(setting: Replication) -> Floats | float:
    """Find the deviation of the change by leaving hits or releases out; 0 where they are too few for that."""
    groups = setting.source.groups
    if len(groups) < 4:
        return 0.0
    changes = []
    for piece in range(len(groups)):
        keep = np.arange(len(groups)) != piece
        whole, later = _log_frequencies(setting, keep), _later(setting, keep)
        if whole is not None and later is not None:
            changes.append(whole - later)
    if len(changes) < 4:
        return 0.0
    return np.asarray(np.sqrt((len(changes) - 1) * np.var(changes, axis=0)))


def _later(setting: Replication, keep: Bools | None) -> Floats | None:
    impulse = setting.source.impulse(keep)
    if impulse is None:
        return None
    begun = _weak_from(impulse)
    if begun is None:
        return None
    source = ImpulseSource(dataclasses.replace(impulse, start=begun), setting.source.sampling_rate)
    return _logarithms(setting, Parts(source, setting.sweep.poles).values(setting.sweep.chosen, None))


def _weak_from(impulse: Impulse) -> int | None:
    """Find the sample from which a ninth of the energy is left; None where what follows is too short."""
    power = np.sum(impulse.sequence**2, axis=(1, 2))
    left = np.cumsum(power[::-1])[::-1]
    weak = np.flatnonzero(left < left[impulse.start] / 9)
    return None if not weak.size or weak[0] > 0.6 * len(power) else int(weak[0])
