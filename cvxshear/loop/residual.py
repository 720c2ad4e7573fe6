"""Where a residual sits: by configuration and mode, and by floor."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from scipy import stats

from cvxshear.identification.efficient import Estimate
from cvxshear.identification.quality import frequency_errors, shape_error
from cvxshear.typing import Json

CONSPICUOUS = 0.01
"""Probability below which a part of the residual is pointed out, the number of parts accounted for."""


@dataclass(frozen=True)
class ModeResidual:
    """What one measured mode leaves unexplained.

    Parameters
    ----------
    configuration : str
    mode : int
    frequency_error : float
        model / measured - 1.
    frequency_deviation : float
        The same in standard deviations.
    shape_error : float or None
        Largest difference of an entry, the mode scaled to a largest entry of 1.
    shape_deviation : float or None
        Root mean square of the entries' residuals in standard deviations.
    """

    configuration: str
    mode: int
    frequency_error: float
    frequency_deviation: float
    shape_error: float | None
    shape_deviation: float | None

    def to_dict(self) -> Json:
        """The fields by name."""
        return asdict(self)


def by_mode(estimate: Estimate) -> list[ModeResidual]:
    """The residual of every measured mode of every configuration."""
    result = []
    scale = estimate.noise_scale if np.isfinite(estimate.noise_scale) and estimate.noise_scale > 0 else 1.0
    for target, match in zip(estimate.misfit.targets, estimate.fit.at.matches, strict=True):
        errors = frequency_errors(target, match)
        z = np.log1p(errors) * target.frequency_weights / scale
        shapes = target.weights * (match.seen - target.shapes) / scale
        for j, mode in enumerate(target.modes):
            known = target.weights[j] > 0
            some = bool(known.any())
            result.append(
                ModeResidual(
                    target.configuration.name,
                    int(mode) + 1,
                    float(errors[j]),
                    float(z[j]),
                    shape_error(target.shapes[j, known], match.seen[j, known]) if some else None,
                    float(np.sqrt(np.mean(shapes[j, known] ** 2))) if some else None,
                )
            )
    return result


def by_floor(estimate: Estimate) -> dict[int, float]:
    """Root mean square of the shape residuals at each measured floor, in standard deviations, all configurations."""
    squares: dict[int, list[float]] = {}
    scale = estimate.noise_scale if np.isfinite(estimate.noise_scale) and estimate.noise_scale > 0 else 1.0
    for target, match in zip(estimate.misfit.targets, estimate.fit.at.matches, strict=True):
        z = target.weights * (match.seen - target.shapes) / scale
        for column, floor in enumerate(target.floors):
            known = target.weights[:, column] > 0
            squares.setdefault(int(floor) + 1, []).extend(z[known, column] ** 2)
    return {floor: float(np.sqrt(np.mean(values))) for floor, values in sorted(squares.items()) if values}


def where_it_sits(estimate: Estimate) -> list[str]:
    """The conspicuous parts of a residual in words, the largest first; empty where none stands out."""
    parts: list[tuple[float, str]] = []
    modes = by_mode(estimate)
    floors = by_floor(estimate)
    level = CONSPICUOUS / (2 * len(modes) + len(floors))
    for item in modes:
        place = f'mode {item.mode} of "{item.configuration}"'
        if stats.norm.sf(abs(item.frequency_deviation)) * 2 < level:
            size = f"{100 * item.frequency_error:+.2f} %, {item.frequency_deviation:+.1f} standard deviations"
            text = f"the frequency of {place} ({size})"
            parts.append((abs(item.frequency_deviation), text))
        entries = len(estimate.misfit.targets[0].floors)
        if item.shape_deviation is not None and stats.chi2.sf(item.shape_deviation**2 * entries, entries) < level:
            parts.append(
                (item.shape_deviation, f"the shape of {place} ({item.shape_deviation:.1f} standard deviations a floor)")
            )
    for floor, deviation in floors.items():
        if stats.chi2.sf(deviation**2 * len(modes), len(modes)) < level:
            parts.append((deviation, f"the shapes at floor {floor} ({deviation:.1f} standard deviations a mode)"))
    return [text for _, text in sorted(parts, key=lambda part: -part[0])]
