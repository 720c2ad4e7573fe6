"""A second opinion on modes: another method's on the same record, a peer's, or peaks in the frequency domain."""

from __future__ import annotations

import numpy as np

from cvxshear.modal.adapters import from_arrays
from cvxshear.modal.functions import Functions
from cvxshear.modal.result import ModalResult
from cvxshear.records.mode_shapes import mac
from cvxshear.records.record import Finding
from cvxshear.util.errors import NoSolutionError
from cvxshear.util.typing import Floats

FDD = "fdd"
"""The name of the frequency domain decomposition among methods."""
NEAR = 0.05
"""Relative distance of frequencies within which two methods may have found the same mode."""
ALIKE = 0.9
"""MAC from which on two shapes within that distance are taken for those of one mode; usual in correlating tests."""


def frequency_domain_decomposition(functions: Functions, count: int, stories: int) -> ModalResult:
    """Modes at the peaks of the largest singular value of the measured functions, with its singular vectors as shapes.

    The largest peaks, each refined by the parabola through three lines of the logarithm. Of half-spectra this is the
    frequency domain decomposition (Brincker, Zhang and Andersen 2001), of frequency response functions the complex mode
    indicator function (Shih, Tsuei, Allemang and Brown 1988); neither uses a model of the poles.

    Parameters
    ----------
    functions : Functions
        Of a record, by `identify_modes` with `functions=True`.
    count : int
        Most modes.
    stories : int

    Returns
    -------
    ModalResult
        Frequencies known to a line's width over the root of twelve; shape entries to an assumed 1 %.

    Raises
    ------
    NoSolutionError
        Where there is no peak.
    """
    left, values, _ = np.linalg.svd(functions.values, full_matrices=False)
    height = np.log(np.maximum(values[:, 0], 1e-300))
    peaks = np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:])) + 1
    # A peak of noise stands little above the valleys on both sides of it.
    prominence = np.array([height[place] - _saddle(height, int(place)) for place in peaks])
    places = np.sort(peaks[np.argsort(-prominence)[:count]])
    if not len(places):
        raise NoSolutionError(FDD, "the measured functions have no peak")
    before, at, after = (height[places + step] for step in (-1, 0, 1))
    step = functions.frequencies[1] - functions.frequencies[0]
    frequencies = functions.frequencies[places] + 0.5 * step * (before - after) / (before - 2 * at + after)
    return from_arrays(
        frequencies,
        left[places, :, 0],
        floors=functions.floors,
        stories=stories,
        frequency_std=step / np.sqrt(12.0) / frequencies,
        name=FDD,
    )


def _saddle(height: Floats, place: int) -> float:
    """The higher of the two lowest points between a peak and what is higher than it on either side."""
    lowest = []
    for side in (height[:place][::-1], height[place + 1 :]):
        higher = np.flatnonzero(side > height[place])
        lowest.append(side[: higher[0] if higher.size else None].min())
    return float(max(lowest))


def second_opinion(result: ModalResult, other: ModalResult) -> list[Finding]:
    """What another identification of the same test says of each mode.

    Parameters
    ----------
    result : ModalResult
    other : ModalResult
        By another method, or of a peer by `from_pyoma`, `from_sdypy` or `from_arrays`.

    Returns
    -------
    list of Finding
        One a mode: the other's frequency and the MAC of the shapes at the floors that both have, or that it is not
        among the other's; and one for each mode that the other alone has.
    """
    common = np.intersect1d(result.floors, other.floors)
    own, its = (
        item.mode_shapes[:, np.isin(item.floors, common)] / np.abs(item.mode_shapes).max(axis=1, keepdims=True)
        for item in (result, other)
    )
    found, seen = [], set()
    for row, (mode, frequency) in enumerate(zip(result.modes.tolist(), result.frequencies.tolist(), strict=True)):
        changes = other.frequencies / frequency - 1.0
        alike = np.array([mac(own[row], shape) for shape in its])
        near = np.flatnonzero((np.abs(changes) < NEAR) & (alike > ALIKE))
        numbers = {"mode": mode, "method": other.name}
        if not near.size:
            closest = int(np.argmin(np.abs(changes)))
            found.append(
                Finding(
                    "second opinion",
                    f"{other.name} has no mode {mode}, {frequency:.4g} Hz; its nearest is "
                    f"{other.frequencies[closest]:.4g} Hz, MAC {alike[closest]:.3f}",
                    {**numbers, "agrees": False},
                )
            )
            continue
        place = int(near[np.argmin(np.abs(changes[near]))])
        seen.add(place)
        found.append(
            Finding(
                "second opinion",
                f"{other.name} has mode {mode} at {other.frequencies[place]:.5g} Hz "
                f"{alike[place]:.4f}",
                {
                    **numbers,
                    "agrees": True,
                    "frequency": float(other.frequencies[place]),
                    "change": float(changes[place]),
                    "mac": float(alike[place]),
                },
            )
        )
    found += [
        Finding(
            "second opinion",
            f"{other.name} has a mode at {frequency:.4g} Hz that is not among these",
            {"method": other.name, "agrees": False, "frequency": frequency},
        )
        for place, frequency in enumerate(other.frequencies.tolist())
        if place not in seen
    ]
    return found
