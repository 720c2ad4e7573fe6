"""Clocks that drift between the releases of a frame, by the phases of its modes.

In each release of a linear frame a mode has the same complex shape, dampers or not. A clock that drifts turns its
channel's entries by a phase in proportion to the frequency of the mode and the time of the release.
"""

import numpy as np
from scipy import special

from cvxshear.records.estimate import LAST_SAMPLE
from cvxshear.records.findings import finding
from cvxshear.records.frf import residues
from cvxshear.records.late_clocks import DRIFT_SHORTEST
from cvxshear.records.prepare import releases_of
from cvxshear.records.record import Finding, TimeRecord
from cvxshear.records.signals import in_step
from cvxshear.util.quantities import significant
from cvxshear.util.typing import Complexes, Floats

SLOPE_CHANCE = 1e-4
"""Significance level of a slope. The drift of a sound clock is also a fraction of `DRIFT_SHORTEST`."""


def without_drifts(record: TimeRecord, eigenvalues: Complexes) -> tuple[TimeRecord, list[Finding]]:
    """Set clocks right that drift from release to release, and say so.

    Parameters
    ----------
    record : TimeRecord
        Free decays.
    eigenvalues : array of complex, shape (modes,)
        1/s.
    """
    decays, starts = releases_of(record)
    rate, channels = record.sampling_rate, len(record.channels)
    before = np.cumsum([0, *(run.samples for run in record.runs)])[:-1]
    times = (before + starts) / rate
    if len(times) < 2 or channels < 3 or not len(eigenvalues):
        return record, []
    amplitudes = residues(decays[:LAST_SAMPLE], eigenvalues, rate, 0)
    omega = np.abs(eigenvalues.imag)[:, None]
    findings, late = [], {}
    for _ in range(channels // 2):
        fits = [_drift(amplitudes, omega, times, channel) for channel in range(channels)]
        worst = int(np.argmax([abs(slope) / max(std, 1e-300) for slope, std, _ in fits]))
        slope, std, freedom = fits[worst]
        certain = -float(special.stdtrit(freedom, SLOPE_CHANCE)) * std
        if abs(slope) < max(certain, DRIFT_SHORTEST / rate / (np.ptp(times) / 2)):
            break
        amplitudes[:, worst] *= np.exp(1j * omega * slope * times)
        name, start = record.channels[worst].name, -slope * float(times.mean())
        late[name] = (start, slope)
        numbers = {"channel": name, "seconds": start, "drift": slope, "drift_std": std, "corrected": True}
        slow, spread = "slow" if slope > 0 else "fast", significant(1e6 * std, 2)
        findings.append(finding("clock drift/releases", numbers, slow=slow, by=abs(slope), std=spread))
    return (in_step(record, late) if late else record), findings


def _drift(amplitudes: Complexes, omega: Floats, times: Floats, channel: int) -> tuple[float, float, float]:
    """Find by how much a clock drifts against all others, s a second, its standard deviation and degrees of freedom.

    The scatter is taken from all channels; other channels are compared without this one.
    """
    others = [each for each in range(amplitudes.shape[1]) if each != channel]
    slope, scatter, freedom, information = _line(amplitudes, omega, times, channel, others)
    for other in others:
        _, more, count, _ = _line(amplitudes, omega, times, other, [each for each in others if each != other])
        scatter, freedom = scatter + more, freedom + count
    return slope, float(np.sqrt(scatter / freedom / information)), freedom


def _line(
    amplitudes: Complexes, omega: Floats, times: Floats, channel: int, others: list[int]
) -> tuple[float, float, float, float]:
    """Fit one slope of a channel's delays against others to all modes, each mode with a delay of its own.

    The slope, the weighted squares that it leaves, their degrees of freedom, and the information on the slope.
    """
    shapes = np.array([np.linalg.svd(each[others])[0][:, 0] for each in amplitudes])
    motion = np.einsum("rc,rck->rk", shapes.conj(), amplitudes[:, others])
    turned = amplitudes[:, channel] * motion.conj()
    late = -np.angle(turned * turned.sum(axis=1, keepdims=True).conj()) / omega
    weight = np.minimum(np.abs(amplitudes[:, channel]), np.abs(motion)) ** 2 * omega**2
    total = weight.sum(axis=1, keepdims=True)
    off = late - (weight * late).sum(axis=1, keepdims=True) / total
    around = times - (weight * times).sum(axis=1, keepdims=True) / total
    information = float((weight * around**2).sum())
    slope = float((weight * around * off).sum()) / information
    freedom = float((total[:, 0] ** 2 / (weight**2).sum(axis=1) - 1.0).sum()) - 1.0
    return slope, float((weight * (off - slope * around) ** 2).sum()), max(freedom, 0.1), information
