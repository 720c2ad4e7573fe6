"""A predicted response, beside what was measured."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cvxshear.report.describe.identified import damping_section
from cvxshear.report.describe.vocabulary import Document, Row, Section, Sentence, Table, describe, plain_rows
from cvxshear.response import RecordComparison, RecordPrediction
from cvxshear.util.quantities import AUTOMATIC, Units, percent, scaled, with_std

SHOWN_MODES = 6
"""Columns of the transfer functions' errors; the higher modes stand in the JSON."""

PEAKS = (
    ("floor_acceleration", "acceleration", "m/s2"),
    ("floor_displacement", "displacement", "m"),
    ("story_drift", "drift", "m"),
    ("story_drift_ratio", "drift ratio", ""),
    ("story_shear", "shear", "N"),
)
"""Quantities with a value a floor or story, their words and units."""


@describe.register
def _prediction(of: RecordPrediction, units: Units = AUTOMATIC) -> Document:
    how = f"by the {of.after.fitted.label}, {of.damping.kind} damping, backend {of.backend}"
    sections = [Section("how", "", (Sentence(how),))]
    if of.after.comparison is not None:
        before = None if of.otherwise_before is None else of.otherwise_before.comparison
        sections.append(Section("errors", "Beside the record", (errors(before, of.after.comparison),)))
    sections += [
        Section("peaks", "Peaks", (peaks(of),)),
        damping_section(of.damping),
        Section("remarks", "", tuple(Sentence(remark, "warning") for remark in of.remarks)),
    ]
    return Document(of.after.fitted.experiment.name, _headline(of), tuple(sections))


def _headline(of: RecordPrediction) -> str:
    """Which frame, in which state, under what."""
    motion = of.motion
    seconds = sum(drive.samples for drive in motion.drives) / motion.sampling_rate
    driven = "base motion" if motion.input == "base" else "a force"
    return (
        f"{of.after.fitted.experiment.name} ({of.configuration.name}) under {driven} of {motion.name}: "
        f"{seconds:.1f} s at {motion.sampling_rate:g} Hz"
    )


def errors(before: RecordComparison | None, after: RecordComparison) -> Table:
    """Errors of each floor's acceleration, before (where there is one) and after, the top floor first."""
    modes = min(after.frf_error.shape[1], SHOWN_MODES)
    sides: list[tuple[tuple[str, ...], RecordComparison]] = [((), after)]
    if before is not None:
        sides = [(("before",), before), (("after",), after)]
    rows = plain_rows(
        (str(after.floors[at]), *word, *_errors(side, at, modes))
        for at in reversed(range(len(after.floors)))
        for word, side in sides
    )
    transfer = (f"H, mode {mode}" for mode in range(1, modes + 1))
    head = ("floor", *(("model",) if before is not None else ()), "error in time", "rms", "peak", *transfer)
    words = (0,) if before is None else (0, 1)
    return Table("prediction-errors", "predicted accelerations beside the measured", head, rows, words=words)


def _errors(side: RecordComparison, at: int, modes: int) -> Iterator[str]:
    yield percent(float(side.nrmse[at]), 1)
    for ratio in (side.rms_ratio[at], side.peak_ratio[at]):
        yield "–" if np.isnan(ratio) else f"{100 * (float(ratio) - 1):+.1f} %"
    yield from (percent(float(value), 1) for value in side.frf_error[at, :modes])


def peaks(of: RecordPrediction) -> Table:
    """Largest values at every floor and story, the top first."""
    values, std = of.peaks.values, of.peaks.std
    head, columns = ["floor / story"], []
    for name, word, unit in PEAKS:
        if name in values:
            factor, prefixed = (1e-3, "mm") if unit == "m" else scaled(values[name].tolist(), unit)
            head.append(f"{word}, {prefixed}" if unit else word)
            columns.append([
                with_std(float(value), float(deviation), factor=factor if unit else 1.0)
                for value, deviation in zip(values[name], std[name], strict=True)
            ])  # fmt: skip
    rows = [Row((str(floor), *cells)) for floor, cells in enumerate(zip(*columns, strict=True), 1)]
    if "overturning_moment" in values:
        moment = with_std(float(values["overturning_moment"][0]), float(std["overturning_moment"][0]), "N m")
        rows.insert(0, Row(("base", *([""] * (len(columns) - 1)), f"moment {moment}")))
    return Table("prediction-peaks", "peaks ± standard deviation", tuple(head), tuple(reversed(rows)))
