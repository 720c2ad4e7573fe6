"""Location of a residual: by part of the data, and by floor."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import special

from cvxshear.data import Datum, Deviation, Model
from cvxshear.fit.efficient import Estimate
from cvxshear.util import ranking

CONSPICUOUS = 0.01
"""Largest probability of a part of the residual that is reported, corrected for the number of parts."""


def _compared(estimate: Estimate) -> list[tuple[Datum, Model, float]]:
    """List each datum with its model and the factor of its noise."""
    models = {id(model.state.tested): model for model in estimate.fit.at.models}
    return [
        (datum, models[id(datum.tested)], 1.0 if datum.declared else estimate.misfit.noise.of(datum.noise.name))
        for datum in estimate.misfit.data
    ]


def by_part(estimate: Estimate) -> list[Deviation]:
    """List the residuals of each part of each datum and soft prior, in standard deviations of the fit's noise."""
    return [
        dataclasses.replace(part, deviations=part.deviations / factor)
        for datum, model, factor in _compared(estimate)
        for part in datum.describe(model)
    ] + estimate.misfit.statement_deviations(estimate.theta)


def by_floor(estimate: Estimate) -> dict[int, float]:
    """Return the root mean square of the residuals at each measured floor, in standard deviations, over all tests."""
    squares: dict[int, list[float]] = {}
    for datum, model, factor in _compared(estimate):
        for floor, z in datum.by_floor(model).items():
            squares.setdefault(floor, []).extend((z / factor) ** 2)
    return {floor: float(np.sqrt(np.mean(values))) for floor, values in sorted(squares.items()) if values}


def where_it_sits(estimate: Estimate) -> list[str]:
    """Describe the significant parts of a residual, the largest first; empty if no part is significant."""
    parts, floors = by_part(estimate), by_floor(estimate)
    level = CONSPICUOUS / max(len(parts) + len(floors), 1)
    found = [
        (abs(part.deviations), _said(part))
        for part in parts
        if special.chdtrc(part.entries, part.deviations**2 * part.entries) < level
    ]
    rows = len([part for part in parts if part.entries > 1]) or 1
    found += [
        (deviation, f"floor {floor} ({deviation:.1f} standard deviations, root mean square)")
        for floor, deviation in floors.items()
        if special.chdtrc(rows, deviation**2 * rows) < level
    ]
    return [text for _, text in ranking.ranked(found, lambda item: item[0])]


def _said(part: Deviation) -> str:
    """Describe a part and its size in words."""
    if part.entries > 1:
        return f"{part.label} ({part.deviations:.1f} standard deviations a floor)"
    error = "" if part.error is None else f"{100 * part.error:+.2f} %, "
    return f"{part.label} ({error}{part.deviations:+.1f} standard deviations)"
