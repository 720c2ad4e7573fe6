"""A prediction for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from cvxshear.quantities import percent, scaled, significant, with_std
from cvxshear.report.terminal import plain_table
from cvxshear.response import IdentifiedDamping, RecordComparison, RecordPrediction
from cvxshear.typing import Floats

SHOWN_MODES = 6
"""Columns of the transfer functions' errors; the higher modes stand in the JSON."""


def prediction(result: RecordPrediction) -> Iterator[RenderableType]:
    """What was predicted, the errors before and after, peaks, damping, remarks."""
    motion = result.motion
    seconds = sum(drive.samples for drive in motion.drives) / motion.sampling_rate
    driven = "base motion" if motion.input == "base" else "a force"
    yield Text(
        f"{result.after.fitted.experiment.name} ({result.configuration.name}) under {driven} of {motion.name}: "
        f"{seconds:.1f} s at {motion.sampling_rate:g} Hz",
        style="bold",
    )
    yield Text(f"by the {result.after.fitted.label}, {result.damping.kind} damping, backend {result.backend}\n")
    if result.after.comparison is not None:
        yield errors(result)
        yield Text("")
    yield peaks(result)
    yield Text("")
    yield from damping(result.damping)
    for remark in result.remarks:
        yield Text(remark, style="yellow")


def errors(result: RecordPrediction) -> Table:
    """Errors of each floor's acceleration, before and after."""
    after = result.after.comparison
    assert after is not None
    before = None if result.before is None else result.before.comparison
    modes = min(after.frf_error.shape[1], SHOWN_MODES)
    table = plain_table(
        "predicted accelerations beside the measured",
        "floor", "model", "error in time", "rms", "peak", *(f"H, mode {mode + 1}" for mode in range(modes)),
    )  # fmt: skip
    for row in reversed(range(len(after.floors))):
        for word, side in (("before", before), ("after", after)):
            if side is not None:
                table.add_row(str(after.floors[row]), word, *_cells(side, row, modes))
    return table


def _cells(side: RecordComparison, row: int, modes: int) -> list[str]:
    return [
        percent(float(side.nrmse[row]), 1),
        _ratio(float(side.rms_ratio[row])),
        _ratio(float(side.peak_ratio[row])),
        *(percent(float(value), 1) for value in side.frf_error[row, :modes]),
    ]


def _ratio(value: float) -> str:
    """A ratio to one as a deviation in percent."""
    return "–" if np.isnan(value) else f"{100 * (value - 1):+.1f} %"


def peaks(result: RecordPrediction) -> Table:
    """Largest values at every floor and story, the top first."""
    values, std = result.peaks.values, result.peaks.std
    shown = [
        ("floor_acceleration", "acceleration", "m/s2"),
        ("floor_displacement", "displacement", "m"),
        ("story_drift", "drift", "m"),
        ("story_drift_ratio", "drift ratio", ""),
        ("story_shear", "shear", "N"),
    ]
    columns = []
    for name, word, unit in shown:
        if name in values:
            factor, prefixed = (1e-3, "mm") if unit == "m" else scaled(values[name].tolist(), unit)
            columns.append((f"{word}, {prefixed}" if unit else word, values[name], std[name], factor if unit else 1.0))
    table = plain_table("peaks ± standard deviation", "floor / story", *(head for head, *_ in columns))
    for i in reversed(range(len(values["floor_acceleration"]))):
        table.add_row(str(i + 1), *(_cell(of, deviation, i, factor) for _, of, deviation, factor in columns))
    if "overturning_moment" in values:
        moment = with_std(float(values["overturning_moment"][0]), float(std["overturning_moment"][0]), "N m")
        table.add_row("base", *([""] * (len(columns) - 1)), f"moment {moment}")
    return table


def _cell(values: Floats, std: Floats, i: int, factor: float) -> str:
    return with_std(float(values[i]), float(std[i]), factor=factor)


def damping(found: IdentifiedDamping) -> Iterator[RenderableType]:
    """Damping ratios of the modes, and the dashpots or Rayleigh's factors where there are such."""
    table = plain_table(f"damping ({found.kind})", "mode", "ratio, %")
    for mode in range(len(found.ratios)):
        table.add_row(str(mode + 1), with_std(float(found.ratios[mode]), float(found.ratios_std[mode]), factor=0.01))
    yield table
    if found.story_dashpot is not None and found.story_dashpot_std is not None:
        table = plain_table("story dashpots", "story", "N s/m")
        for i in reversed(range(len(found.story_dashpot))):
            table.add_row(str(i + 1), with_std(float(found.story_dashpot[i]), float(found.story_dashpot_std[i])))
        yield table
    if found.rayleigh is not None:
        yield Text(f"C = a M + b K, a = {significant(found.rayleigh[0])} 1/s, b = {significant(found.rayleigh[1])} s")
