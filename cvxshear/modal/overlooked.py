"""Resonances between the modes that were found, which may be modes of the frame themselves.

Where every floor is measured a shape tells its mode's number by its changes of sign. Where some are not, modes are
numbered as they come, and one that is left out, because its shape is too weak to be told or it was not asked for,
makes the number of every mode above it doubtful.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.modal.findings import Finding
from cvxshear.modal.picking import PoleCandidate
from cvxshear.util.quantities import listed
from cvxshear.util.typing import Floats, Ints

A_MODE = 0.3
"""Probability that a stable pole of no reproducible shape between two modes is a mode of the frame: of another
direction, of twisting, of a floor or of noise it is as often."""

OVERLOOKED = "overlooked mode"
"""The kind of these findings."""


def overlooked_modes(
    frequencies: Floats, modes: Ints, left_out: Sequence[PoleCandidate], *, floors: int, stories: int
) -> list[Finding]:
    """The resonances that put the numbers of modes in doubt.

    Parameters
    ----------
    frequencies : ndarray, shape (m,)
        Of the modes found, Hz.
    modes : ndarray of int, shape (m,)
        Their numbers.
    left_out : sequence of PoleCandidate
        Stable poles that are none of them.
    floors : int
        Measured.
    stories : int

    Returns
    -------
    list of Finding
        Each with the numbers `frequency`, `modes` as they would be, and `probability`.
    """
    if floors == stories:
        return []
    between: dict[int, list[float]] = {}
    for item in left_out:
        between.setdefault(int(np.searchsorted(frequencies, item.frequency)), []).append(item.frequency)
    share = A_MODE / max(len(between), 1)
    findings = []
    for place, resonances in sorted(between.items()):
        moved = modes + (np.arange(len(modes)) >= place)
        if not 0 < place < len(modes) or moved[-1] > stories:
            continue
        below, above, at = modes[place - 1], modes[place], listed([f"{each:.4g}" for each in resonances])
        findings.append(
            Finding(
                OVERLOOKED,
                f"between modes {below} and {above} lies a resonance that is not among them, at {at} Hz; if it is a "
                f"mode of the frame, what is called mode {above} is mode {above + 1}, and so on (written as "
                f"other_modes, with a probability of {100 * share:.0f} %)",
                {"frequency": resonances[0], "modes": moved.tolist(), "probability": share},
            )
        )
    return findings


def left_out(candidates: Sequence[PoleCandidate], chosen: Sequence[PoleCandidate]) -> list[PoleCandidate]:
    """The candidates that are resonances of something, and not among those chosen."""
    taken = {item.members for item in chosen}
    return [item for item in candidates if (item.physical or item.shaky) and item.members not in taken]
