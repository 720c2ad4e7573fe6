"""Frequency response functions of responses that were cut off before they had decayed.

The inverse transform of such a function is the impulse response itself, cut; that of a function sampled in
truth is the impulse response folded back onto itself. Either is a sum of the same decaying exponentials, so
frequencies and damping are free of leakage both ways; only the residues, and with them the masses, differ,
by 1 - exp(eigenvalue * length).
"""

from __future__ import annotations

import numpy as np

from cvxshear.modal.estimate import Replication, details
from cvxshear.modal.findings import Finding
from cvxshear.modal.frf import FrfSource
from cvxshear.modal.picking import Values
from cvxshear.modal.record import FrfRecord, Record
from cvxshear.util.typing import Floats

NOTICEABLE = 0.01
"""Share of a mode's impulse response that is left at the end of the window."""


def settle_truncation(record: Record, setting: Replication, values: Values) -> list[Finding]:
    """Decide, where the record does not say, which of the two a table of functions is; sets the source's flag.

    The products of a real mode's shape entries are real. Of the two readings the one is taken whose products
    are nearer to it, the modes weighted by how much their residues depend on the question.
    """
    source = setting.source
    if not isinstance(record, FrfRecord) or not isinstance(source, FrfSource):
        return []
    length = source.samples / source.sampling_rate
    left = np.abs(np.exp(values.eigenvalues * length))
    if left.max() < NOTICEABLE:
        return []
    if record.truncated is not None:
        return [_finding(record.truncated, "as declared", length, left)]
    angles = {}
    for truncated in (True, False):
        source.wrapped = not truncated
        angles[truncated] = _angle(setting, values, left)
    truncated = angles[True] <= angles[False]
    source.wrapped = not truncated
    why = (
        f"told from the residues' phases, {angles[truncated]:.1f} degrees from real where the other reading leaves "
        f"{angles[not truncated]:.1f}"
    )
    return [_finding(truncated, why, length, left)]


def _angle(setting: Replication, values: Values, left: Floats) -> float:
    """Root mean square phase of the products, degrees, weighted by their size and by what is left at the end."""
    products = details(setting, values, None).products
    if products is None:
        return 0.0
    folded = np.angle(products * np.where(products.real < 0, -1.0, 1.0))
    weight = np.abs(products) ** 2
    weight = weight / weight.sum(axis=(1, 2), keepdims=True) * left[:, None, None] ** 2
    return float(np.degrees(np.sqrt(np.sum(weight * folded**2) / np.sum(weight))))


def _finding(truncated: bool, why: str, length: float, left: Floats) -> Finding:
    mode = int(np.argmax(left)) + 1
    kind = "those of responses cut off there" if truncated else "samples of the true functions"
    return Finding(
        "leakage",
        f"{100 * left.max():.1f} % of mode {mode}'s impulse response is left at the end of the window of "
        f"{length:.3g} s; the functions are taken for {kind} ({why}); its residues depend on that by as much, its "
        "frequency and damping do not",
        {"mode": mode, "left": float(left.max()), "length": length, "truncated": truncated},
    )
