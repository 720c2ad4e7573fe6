"""Describe a predicted response and its measurement, and the motion of all floors reconstructed from some sensors."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from cvxshear.report.describe import (
    PAGE_COLUMNS,
    Block,
    Column,
    Document,
    Points,
    Section,
    Sentence,
    Table,
    describe,
    exact,
    places,
    table,
    table_of_rows,
)
from cvxshear.report.describe.headline import MODELS
from cvxshear.response import IdentifiedDamping, Peaks, Reconstruction, RecordComparison, RecordPrediction
from cvxshear.response.predicted import RESPONSES
from cvxshear.response.reconstruction import SIGN_KNOWN
from cvxshear.util import ranking
from cvxshear.util.quantities import (
    AUTOMATIC,
    SURE,
    Units,
    capital,
    chance,
    counted,
    numbered,
    percent,
    scaled,
    significant,
    with_std,
)

SHOWN_MISSED = 0.0005
"""Smallest relative error of a record that is reported: it is written as 0.1 %."""


@describe.register
def _damping(result: IdentifiedDamping, units: Units = AUTOMATIC) -> Document:
    remarks = tuple(Sentence(each, "warning") for each in result.remarks)
    headline = f"{result.kind} damping of {counted(len(result.ratios), 'mode')}"
    return Document("damping", headline, (damping_section(result), Section("remarks", "", remarks)))


def damping_section(result: IdentifiedDamping) -> Section:
    """Tabulate the damping ratios of the modes, and the dashpots or Rayleigh factors if they exist."""
    return Section("damping", "Damping", tuple(_damping_parts(result)))


def _damping_parts(result: IdentifiedDamping) -> Iterator[Block]:
    measured = np.full(len(result.ratios), np.nan) if result.measured is None else result.measured
    numbers = [str(number) for number in range(1, len(result.ratios) + 1)]
    yield table("damping-ratios", f"damping ({result.kind})", {
        "mode": numbers,
        "ratio, %": map(partial(with_std, factor=0.01), result.ratios.tolist(), result.ratios_std.tolist()),
        "measured, %": [significant(100 * float(seen), 3) for seen in measured],
    })  # fmt: skip
    if result.story_dashpot is not None and result.story_dashpot_std is not None:
        dashpots = list(map(with_std, result.story_dashpot.tolist(), result.story_dashpot_std.tolist()))
        stories = [str(story) for story in range(1, len(dashpots) + 1)]
        yield table("story-dashpots", "story dashpots", {"story": stories, "N s/m": dashpots}, top_first=True)
    if result.rayleigh is not None:
        a, b = result.rayleigh
        yield Sentence(f"C = a M + b K, a = {significant(float(a))} 1/s, b = {significant(float(b))} s")


@describe.register
def _prediction(result: RecordPrediction, units: Units = AUTOMATIC) -> Document:
    model = result.after.fitted.label_in(result.configuration)
    how = f"{_driven(result)}, by the {model}, {result.damping.kind} damping, backend {result.backend}"
    sections = [Section("how", "", (Sentence(how),))]
    if result.after.comparison is not None:
        before = None if result.otherwise_before is None else result.otherwise_before.comparison
        sections.append(Section("errors", "Beside the record", (errors(before, result.after.comparison),)))
    sections += [
        Section("peaks", "Peaks", tuple(_peak_parts(result))),
        damping_section(result.damping),
        Section("remarks", "", tuple(Sentence(remark, "warning") for remark in result.remarks)),
    ]
    headline = capital("; ".join(_predicted(result)))
    return Document(result.after.fitted.experiment.name, headline, tuple(sections), tuple(_peak_data(result.peaks)))


def _peak_data(found: Peaks, *more: Column) -> Iterator[Table]:
    """Tabulate the peaks for programs: by floor or story, with more columns, and those of the whole frame."""
    columns = [
        (RESPONSES[name].single, exact(name, values, found.std[name], RESPONSES[name].unit))
        for name, values in found.values.items()
    ]
    numbers = places(len(found.values["story_drift"]), "floor / story", "story")
    yield Table("peaks", "Peaks", (numbers, *(column for single, column in columns if not single), *more), indexed=True)
    yield Table("base", "Peaks at the base", tuple(column for single, column in columns if single))


def _predicted(result: RecordPrediction) -> Iterator[str]:
    """Name the story with the largest drift, and give the error of the predicted motion."""
    yield _largest_drift(result.peaks)
    if (beside := result.after.comparison) is not None:
        least, most = (percent(float(each), 1) for each in (beside.nrmse.min(), beside.nrmse.max()))
        floors = numbered("floor", beside.floors.tolist())
        off = least if least == most else f"{least.removesuffix(' %')} to {most}"
        yield f"the measured accelerations of {floors} are missed by {off} (root mean square over time)"


def _largest_drift(found: Peaks) -> str:
    """Name the story with the largest peak drift, and give this drift."""
    ratios = "story_drift_ratio" in found.values
    name, factor, unit = ("story_drift_ratio", 0.01, "% of its height") if ratios else ("story_drift", 1e-3, "mm")
    top = ranking.first_largest(found.values[name])
    size = with_std(float(found.values[name][top]), float(found.std[name][top]), unit, factor=factor)
    return f"story {top + 1} drifts most: {size}"


def _driven(result: RecordPrediction) -> str:
    """Name the frame, its state and the excitation."""
    motion = result.motion
    seconds = sum(run.samples for run in motion.runs) / motion.sampling_rate
    driven = "base motion" if motion.input == "base" else "a force"
    return (
        f"{result.after.fitted.experiment.name} ({result.configuration.name}) under {driven} of {motion.name}: "
        f"{seconds:.1f} s at {motion.sampling_rate:g} Hz"
    )


def errors(before: RecordComparison | None, after: RecordComparison) -> Table:
    """Tabulate the errors of each floor's acceleration for one or both models, the top floor first."""
    modes = min(after.frf_error.shape[1], PAGE_COLUMNS)
    sides: list[tuple[tuple[str, ...], RecordComparison]] = [((), after)]
    if before is not None:
        sides = [((MODELS[0],), before), ((MODELS[1],), after)]
    rows = (
        (str(after.floors[at]), *word, *_errors(side, at, modes))
        for at in reversed(range(len(after.floors)))
        for word, side in sides
    )
    transfer = (f"H, mode {mode}" for mode in range(1, modes + 1))
    head = ("floor", *(("model",) if before is not None else ()), "error in time", "rms", "peak", *transfer)
    words = (0,) if before is None else (0, 1)
    return table_of_rows("prediction-errors", "predicted accelerations beside the measured", head, rows, words=words)


def _errors(side: RecordComparison, at: int, modes: int) -> Iterator[str]:
    yield percent(float(side.nrmse[at]), 1)
    for ratio in (side.rms_ratio[at], side.peak_ratio[at]):
        yield "–" if np.isnan(ratio) else f"{100 * (float(ratio) - 1):+.1f} %"
    yield from (percent(float(value), 1) for value in side.frf_error[at, :modes])


def peaks(found: Peaks) -> Iterator[Sentence | Table]:
    """Tabulate the peak values of every floor and story, the top first, and the base moment, without drift ratios."""
    values, std = found.values, found.std
    columns = {"floor / story": [str(floor) for floor in range(1, len(values["story_drift"]) + 1)]}
    for name, quantity in RESPONSES.items():
        if name in values and quantity.unit and not quantity.single:
            lengths = quantity.unit == "m"
            factor, prefixed = (1e-3, "mm") if lengths else scaled(values[name].tolist(), quantity.unit)
            columns[f"{quantity.word}, {prefixed}"] = _each_with_std(found, name, factor)
    yield table("prediction-peaks", "peaks ± standard deviation", columns, top_first=True)
    if "overturning_moment" in values:
        moment = with_std(float(values["overturning_moment"][0]), float(std["overturning_moment"][0]), "N m")
        yield Sentence(f"overturning moment at the base: {moment}")


def _each_with_std(found: Peaks, name: str, factor: float) -> list[str]:
    return list(map(partial(with_std, factor=factor), found.values[name].tolist(), found.std[name].tolist()))


def _peak_parts(result: RecordPrediction) -> Iterator[Sentence | Table]:
    """Yield the tables of the peaks, and explain their standard deviations."""
    yield from peaks(result.peaks)
    yield from _drift_ratios(result.peaks)
    if result.after.fitted.covariance is None:
        return
    if result.missed is None or result.after.comparison is None:
        yield Sentence(
            "the deviations hold what the frame leaves uncertain, not the noise of the measured excitation nor what "
            "the model itself lacks, which a record with accelerations of floors would show"
        )
        return
    floors = numbered("floor", result.after.comparison.floors.tolist())
    where = f"the accelerations of {floors} in this record were missed"
    if result.missed < SHOWN_MISSED:
        yield Sentence(f"the deviations hold what the frame leaves uncertain; {where} by no more than that")
        return
    wide = " (for peaks too much, since the motions fall out of step)" if result.after.comparison.shifts else ""
    yield Sentence(
        f"the deviations hold what the frame leaves uncertain and {percent(result.missed, 1)} of each peak, by which "
        f"{where} beyond that: noise of the measured motions, and what the model lacks{wide}"
    )


def _drift_ratios(found: Peaks) -> Iterator[Table]:
    """Yield a separate table of drift ratios: one table of all peaks would be too wide for a page."""
    if "story_drift_ratio" in found.values:
        cells = _each_with_std(found, "story_drift_ratio", 0.01)
        columns = {"story": [str(story) for story in range(1, len(cells) + 1)], "% of height": cells}
        yield table("prediction-drift-ratios", "peak drift ± standard deviation", columns, top_first=True)


@describe.register
def _reconstruction(result: Reconstruction, units: Units = AUTOMATIC) -> Document:
    checks = (Section("checks", "Each sensor from the others", (left_out(result),)),) if result.checks else ()
    warnings = [Sentence(each, "warning") for each in result.warnings]
    sections = (
        Section("findings", "", (*warnings, Sentence(_reconstructed(result)))),
        *checks,
        Section("motion", "What the stories did", (*_sensor_drifts(result), stories(result), *peaks(result.peaks))),
        Section("frame", "The frame in this record", tuple(_frame_parts(result))),
        Section("evidence", "Sensors", (sensors(result),)),
        Section("remarks", "What to bear in mind", (Points("remarks", result.remarks),)),
    )
    frame = result.frame
    chances = (
        () if result.passed is None or result.limits is None else zip(result.limits.names, result.passed, strict=True)
    )
    more = (
        exact("story_factor", frame.factors, frame.factors_std),
        exact("change_probability", frame.story_probability),
        exact("dashpot_probability", frame.dashpot_probability),
        *(exact(f"probability_beyond_{name}", each) for name, each in chances),
    )
    data = tuple(_peak_data(result.peaks, *more))
    return Document(result.fitted.experiment.name, capital("; ".join(_findings(result))), sections, data)


def _reconstructed(result: Reconstruction) -> str:
    """Name the frame, the measured floors and the excitation."""
    floors = numbered("floor", result.recording.floors.tolist())
    words = {"base": "base motion", "force": "a force"}
    driven = words[result.recording.input]
    return (
        f"{result.fitted.experiment.name} ({result.configuration.name}) under {driven} of {result.recording.name}, "
        f"from {floors}: {result.recording.seconds:.1f} s at {result.recording.sampling_rate:g} Hz"
    )


def _findings(result: Reconstruction) -> Iterator[str]:
    """Yield the findings for an owner: the largest drift, the exceeded limits, and changes of the building."""
    if result.fallback:
        lower, upper, drift = max(result.sensor_drifts, key=lambda each: each[2])
        where = "the base" if lower == 0 else f"floor {lower}"
        yield result.fallback.partition(" (")[0]
        size = significant(1e3 * drift, 3)
        yield f"between {where} and floor {upper} the frame drifted by {size} mm, from two sensors"
        yield "drifts of single stories are rough, and limits, the largest drift and changes cannot be told"
        return
    if result.undetermined:
        yield "the tests do not determine the frame: drifts are rough, and what changed since cannot be told"
    yield _largest_drift(result.peaks).replace("drifts", "drifted")
    if result.provisional:
        yield "drifts are provisional: the record needs changes of three kinds at once"
    yield from _limits(result)
    yield from _whole_frame(result)
    if result.changed:
        for story in result.changed:
            change, deviation = (float(each[story - 1]) for each in result.frame.against_others)
            word = "softer" if change < 0 else "stiffer"
            size = with_std(100 * abs(change), 100 * deviation, "%", factor=1.0)
            probable = chance(float(result.frame.story_probability[story - 1]))
            yield f"story {story} was {size} {word} than identified, against the others ({probable} probable)"
    elif result.names_changes:
        yield "no single story changed"
    for story in result.dampers:
        damper, deviation = (float(each[story - 1]) for each in result.frame.dashpots)
        how_large = f" of {with_std(damper, deviation, 'N s/m')}" if result.fitted.mass_known else ""
        probable = chance(float(result.frame.dashpot_probability[story - 1]))
        yield f"story {story} damps by itself, as a damper{how_large} would ({probable} probable)"
    if result.masses_changed:
        sizes = [
            f"floor {floor} by {100 * change:+.0f} ± {100 * std:.0f} %"
            for floor, (change, std) in enumerate(zip(*result.frame.mass_change, strict=True), 1)
            if abs(change) > SIGN_KNOWN * std
        ]
        probable = chance(result.frame.mass_probability)
        where = f": {', '.join(sizes)}" if sizes else "; which of them is open"
        yield f"the floors do not weigh what they did in the tests ({probable} probable){where}"


def _whole_frame(result: Reconstruction) -> Iterator[str]:
    """Yield the change of the lowest frequency and the common change of the stories, if their signs are known."""
    if not result.names_changes:
        return
    before = float(result.frame.errors.varied.centre.model.modes.frequencies[0])
    now, relative = float(result.model.modes.frequencies[0]), float(result.frame.modal_std[0][0])
    if abs(np.log(now / before)) > SIGN_KNOWN * relative:
        yield f"f1 was {with_std(now, relative * now, 'Hz', factor=1.0)}, {significant(before, 4)} Hz in the tests"
    mean, deviation = result.frame.mean_factor
    if abs(mean - 1) > SIGN_KNOWN * deviation:
        size = with_std(100 * abs(mean - 1), 100 * deviation, "%", factor=1.0)
        yield f"on average the stories were {size} {'softer' if mean < 1 else 'stiffer'} than identified"


def _sensor_drifts(result: Reconstruction) -> Iterator[Table]:
    """Tabulate the drifts between neighboring sensors in a fallback, the top first."""
    if result.fallback and result.sensor_drifts:
        lower, upper, drifts = zip(*result.sensor_drifts, strict=True)
        yield table("sensor-drifts", "peak drift between neighboring sensors, from their records alone", {
            "from": ["base" if floor == 0 else str(floor) for floor in lower],
            "to floor": [str(floor) for floor in upper],
            "peak drift, mm": [significant(1e3 * drift, 3) for drift in drifts],
        }, top_first=True)  # fmt: skip


def _limits(result: Reconstruction) -> Iterator[str]:
    """Name the stories that exceeded each limit."""
    if result.limits is None or result.passed is None:
        return
    for limit, word, chances in zip(result.limits.story_drift, result.limits.names, result.passed, strict=True):
        sure = [int(story) + 1 for story in np.flatnonzero(chances >= SURE)]
        unsure = (chances > 1 - SURE) & (chances < SURE)
        open_ = [int(story) + 1 for story in np.flatnonzero(unsure)]
        label = f"{100 * limit:g} %" if word == f"{100 * limit:g} %" else f"{word} ({100 * limit:g} %)"
        passed = f"passed in {numbered('story', sure)}" if sure else "passed in no story"
        if np.isnan(chances).any():
            passed = f"passed in {numbered('story', sure)}, elsewhere that cannot be told" if sure else "cannot be told"
        yield f"limit {label}: {passed}" + (f", possibly in {numbered('story', open_)}" if open_ else "")


def left_out(result: Reconstruction) -> Table:
    """Tabulate the actual and the stated error of each sensor, predicted from all others."""
    alone = [each.prediction_error / each.measured for each in result.checks]
    return table("left-out-sensors", "each measured floor from the other sensors alone", {
        "floor": [str(each.floor) for each in result.checks],
        "rms, m/s²": [significant(each.measured, 3) for each in result.checks],
        "error": [percent(each.error / each.measured, 1) for each in result.checks],
        "stated": [percent(each.stated / each.measured, 1) for each in result.checks],
        "within 95 % band": [percent(each.within, 0) for each in result.checks],
        "prediction alone": [percent(ratio, 1) for ratio in alone],
    }, top_first=True)  # fmt: skip


def stories(result: Reconstruction) -> Table:
    """Tabulate the peak drifts, their limits and the changes of each story, the top first."""
    name = "story_drift_ratio" if "story_drift_ratio" in result.peaks.values else "story_drift"
    factor, unit = (0.01, "% of height") if name == "story_drift_ratio" else (1e-3, "mm")
    values, std = result.peaks.values[name], result.peaks.std[name]
    head = ["story", f"peak drift, {unit}", "by prediction", "stiffness / identified", "changed by itself"]
    names = () if result.limits is None or result.passed is None else result.limits.names
    head += [f"P(> {each})" for each in names]
    rows = []
    for story in reversed(range(len(values))):
        cells = [
            str(story + 1), with_std(float(values[story]), float(std[story]), factor=factor),
            significant(float(result.predicted_peaks.values[name][story]) / factor, 3),
            with_std(float(result.frame.factors[story]), float(result.frame.factors_std[story]), factor=1.0),
            "–" if result.change_probability is None else chance(float(result.change_probability[story])),
        ]  # fmt: skip
        if result.passed is not None:
            cells += ["–" if np.isnan(each[story]) else chance(float(each[story])) for each in result.passed]
        rows.append(tuple(cells))
    return table_of_rows("reconstructed-stories", "peak drift ± standard deviation", head, rows)


def _frame_parts(result: Reconstruction) -> Iterator[Sentence | Table]:
    before = result.frame.errors.varied.centre.model
    shown = slice(min(len(result.model.M), PAGE_COLUMNS))
    values = [each[shown] for each in (result.model.modes.frequencies, result.model.ratios)]
    stds = [(own * each[shown]).tolist() for own, each in zip(values, result.frame.modal_std, strict=True)]
    yield table("reconstructed-modes", "modes of the frame ± standard deviation", {
        "mode": [str(mode) for mode in range(1, shown.stop + 1)],
        "identified, Hz": map(significant, before.modes.frequencies[shown].tolist()),
        "in this record, Hz": map(partial(with_std, factor=1.0), values[0].tolist(), stds[0]),
        "damping identified": map(percent, before.ratios[shown].tolist()),
        "damping in this record, %": map(partial(with_std, factor=0.01), values[1].tolist(), stds[1]),
    })  # fmt: skip
    noise = result.frame.errors.noise_at(result.frame.p)
    yield Sentence(
        f"story forces that the model misses: {percent(noise.force, 1)} of the rms story force; "
        f"{result.kind} damping, backend {result.backend}"
    )


def sensors(result: Reconstruction) -> Table:
    """Tabulate the noise of each sensor, and its samples that are spikes or missing."""
    noise = result.frame.errors.noise_at(result.frame.p).sensors
    return table("sensors", "noise and faulty samples", {
        "floor": [str(floor) for floor in result.recording.floors],
        "sensor noise, m/s²": [significant(float(own), 3) for own in noise],
        "spikes": [str(count) for count in result.spikes],
        "missing": [str(count) for count in result.missing],
    }, top_first=True)  # fmt: skip
