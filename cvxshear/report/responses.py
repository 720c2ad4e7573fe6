"""Describe predicted and reconstructed responses, and write their time series."""

import re
from collections.abc import Callable, Iterator
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
from scipy import io

from cvxshear.report import blocks
from cvxshear.report.headline import MODELS
from cvxshear.response import IdentifiedDamping, Peaks, Reconstruction, RecordComparison, RecordPrediction, Response
from cvxshear.response.predicted import RESPONSES, histories
from cvxshear.response.reconstruction import SIGN_KNOWN
from cvxshear.util import quantities, ranking
from cvxshear.util.typing import Floats
from cvxshear.util.writing import ending_of, write_file

Moved = RecordPrediction | Reconstruction


@blocks.describe.register
def _damping(result: IdentifiedDamping) -> blocks.Document:
    headline = f"{result.kind} damping of {quantities.counted(len(result.ratios), 'mode')}"
    remarks = blocks.section("remarks", "", *blocks.warnings(result.remarks))
    damping = blocks.section("damping", "Damping", *_damping_parts(result))
    return blocks.Document("damping", headline, (damping, remarks))


def _damping_parts(result: IdentifiedDamping) -> Iterator[blocks.Block]:
    """Tabulate the damping ratios of the modes, and the dashpots or Rayleigh factors if they exist."""
    measured = np.full(len(result.ratios), np.nan) if result.measured is None else result.measured
    numbers = [str(number) for number in range(1, len(result.ratios) + 1)]
    yield blocks.table("damping-ratios", f"damping ({result.kind})", {
        "mode": numbers,
        "ratio, %": _written(result.ratios, result.ratios_std, 0.01),
        "measured, %": [quantities.significant(100 * float(seen), 3) for seen in measured],
    })  # fmt: skip
    if result.story_dashpot is not None and result.story_dashpot_std is not None:
        dashpots = _written(result.story_dashpot, result.story_dashpot_std)
        stories = [str(story) for story in range(1, len(dashpots) + 1)]
        yield blocks.table("story-dashpots", "story dashpots", {"story": stories, "N s/m": dashpots}, top_first=True)
    if result.rayleigh is not None:
        a, b = (quantities.significant(float(each)) for each in result.rayleigh)
        yield blocks.Sentence(f"C = a M + b K, a = {a} 1/s, b = {b} s")


def _written(values: Floats, std: Floats, factor: float | None = None) -> list[str]:
    """Write values with their standard deviations, in units of a factor."""
    pairs = zip(values.tolist(), std.tolist(), strict=True)
    return [quantities.with_std(*pair, factor=factor) for pair in pairs]


@blocks.describe.register
def _prediction(result: RecordPrediction) -> blocks.Document:
    model = result.after.fitted.label_in(result.configuration)
    how = f"{_driven(result)}, by the {model}, {result.damping.kind} damping, backend {result.backend}"
    sections = (
        blocks.section("how", "", how),
        blocks.section("errors", "Beside the record", *errors(result)),
        blocks.section("peaks", "Peaks", *_peak_parts(result)),
        blocks.section("damping", "Damping", *_damping_parts(result.damping)),
        blocks.section("remarks", "", *blocks.warnings(result.remarks)),
    )
    title, headline = result.after.fitted.experiment.name, quantities.capital("; ".join(_predicted(result)))
    return blocks.Document(title, headline, sections, tuple(_peak_data(result.peaks)), heading="Predicted response")


def _peak_data(found: Peaks, *more: blocks.Column) -> Iterator[blocks.Table]:
    """Tabulate the peaks for programs: by floor or story, with more columns, and those of the whole frame."""
    columns: dict[bool, list[blocks.Column]] = {False: [], True: []}
    for name, values in found.values.items():
        single, unit = RESPONSES[name].single, RESPONSES[name].unit
        columns[single].append(blocks.exact(name, values, found.std[name], unit))
    numbers = blocks.places(len(found.values["story_drift"]), "floor / story", "story")
    yield blocks.Table("peaks", "Peaks", (numbers, *columns[False], *more), indexed=True)
    yield blocks.Table("base", "Peaks at the base", tuple(columns[True]))


def _predicted(result: RecordPrediction) -> Iterator[str]:
    """Name the story with the largest drift, and give the error of the predicted motion."""
    yield _largest_drift(result.peaks)
    yield from _limits(result)
    if (beside := result.after.comparison) is not None:
        least, most = (quantities.percent(float(each), 1) for each in (beside.nrmse.min(), beside.nrmse.max()))
        floors = quantities.numbered("floor", beside.floors.tolist())
        off = least if least == most else f"{least.removesuffix(' %')} to {most}"
        yield f"the measured accelerations of {floors} are missed by {off} (root mean square over time)"


def _largest_drift(found: Peaks) -> str:
    """Name the story with the largest peak drift, and give this drift."""
    ratios = "story_drift_ratio" in found.values
    name, factor, unit = ("story_drift_ratio", 0.01, "% of its height") if ratios else ("story_drift", 1e-3, "mm")
    top = ranking.first_largest(found.values[name])
    size = quantities.with_std(float(found.values[name][top]), float(found.std[name][top]), unit, factor=factor)
    return f"story {top + 1} drifts most: {size}"


def _driven(result: Moved) -> str:
    """Name the frame, its state, the excitation, and the floors that a reconstruction starts from."""
    if isinstance(result, Reconstruction):
        fitted, record = result.fitted, result.recording
        seen = f", from {quantities.numbered('floor', record.floors.tolist())}"
    else:
        fitted, record, seen = result.after.fitted, result.motion, ""
    driven = "base motion" if record.input == "base" else "a force"
    return (
        f"{fitted.experiment.name} ({result.configuration.name}) under {driven} of {record.name}{seen}: "
        f"{record.seconds:.1f} s at {record.sampling_rate:g} Hz"
    )


def errors(result: RecordPrediction) -> Iterator[blocks.Table]:
    """Tabulate the errors of each floor's acceleration for one or both models, the top floor first."""
    after, other = result.after.comparison, result.otherwise_before
    if after is None:
        return
    before = other.comparison if other is not None else None
    modes = min(after.frf_error.shape[1], blocks.PAGE_COLUMNS)
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
    title, words = "predicted accelerations beside the measured", (0,) if before is None else (0, 1)
    yield blocks.table_of_rows("prediction-errors", title, head, rows, words=words)


def _errors(side: RecordComparison, at: int, modes: int) -> Iterator[str]:
    yield quantities.percent(float(side.nrmse[at]), 1)
    for ratio in (side.rms_ratio[at], side.peak_ratio[at]):
        yield "–" if np.isnan(ratio) else f"{100 * (float(ratio) - 1):+.1f} %"
    yield from (quantities.percent(float(value), 1) for value in side.frf_error[at, :modes])


def peaks(found: Peaks) -> Iterator[blocks.Sentence | blocks.Table]:
    """Tabulate the peak values of every floor and story, the top first, and the base moment, without drift ratios."""
    values, std = found.values, found.std
    columns = {"floor / story": [str(floor) for floor in range(1, len(values["story_drift"]) + 1)]}
    for name, quantity in RESPONSES.items():
        if name in values and quantity.unit and not quantity.single:
            lengths = quantity.unit == "m"
            factor, prefixed = (1e-3, "mm") if lengths else quantities.scaled(values[name].tolist(), quantity.unit)
            columns[f"{quantity.word}, {prefixed}"] = _written(values[name], std[name], factor)
    yield blocks.table("prediction-peaks", "peaks ± standard deviation", columns, top_first=True)
    if "overturning_moment" in values:
        moment, deviation = (float(each["overturning_moment"][0]) for each in (values, std))
        yield blocks.Sentence(f"Overturning moment at the base: {quantities.with_std(moment, deviation, 'N m')}")


def _peak_parts(result: RecordPrediction) -> Iterator[blocks.Sentence | blocks.Table]:
    """Yield the tables of the peaks, and explain their standard deviations."""
    yield from peaks(result.peaks)
    if "story_drift_ratio" in result.peaks.values:
        # One table of all peaks would be too wide for a page.
        cells = _written(result.peaks.values["story_drift_ratio"], result.peaks.std["story_drift_ratio"], 0.01)
        columns = {"story": [str(story) for story in range(1, len(cells) + 1)], "% of height": cells}
        columns |= {f"P(> {name})": _chances(each) for name, _, each in _passed(result)}
        yield blocks.table("prediction-drift-ratios", "peak drift ± standard deviation", columns, top_first=True)
    if result.missed is None or result.after.comparison is None:
        yield blocks.Sentence(
            "the deviations hold what the frame leaves uncertain, not the noise of the measured excitation nor what "
            "the model itself lacks, which a record with accelerations of floors would show"
        )
        return
    floors = quantities.numbered("floor", result.after.comparison.floors.tolist())
    where = f"the accelerations of {floors} in this record were missed"
    wide = " (for peaks too much, since the motions fall out of step)" if result.after.comparison.shifts else ""
    share = quantities.percent(result.missed, 1)
    missed = f"{'< 0.1 %' if share == '0.0 %' else share} of each peak"
    yield blocks.Sentence(
        f"the deviations hold what the frame leaves uncertain and {missed}, by which {where} beyond that: noise of the "
        f"measured motions, and what the model lacks{wide}"
    )


@blocks.describe.register
def _reconstruction(result: Reconstruction) -> blocks.Document:
    warnings, frame = blocks.warnings(blocks.sentences(result.warnings)), result.frame
    motion = (*_sensor_drifts(result), stories(result), *peaks(result.peaks))
    sections = (
        blocks.section("findings", "", *warnings, _driven(result)),
        blocks.section("checks", "Each sensor from the others", left_out(result)),
        blocks.section("motion", "What the stories did", *motion),
        blocks.section("frame", "The frame in this record", *_frame_parts(result)),
        blocks.section("evidence", "Sensors", sensors(result)),
        blocks.section("remarks", "What to bear in mind", blocks.Points("remarks", blocks.sentences(result.remarks))),
    )
    more = [
        blocks.exact("story_factor", frame.factors, frame.factors_std),
        blocks.exact("change_probability", frame.story_probability),
        blocks.exact("dashpot_probability", frame.dashpot_probability),
        *(blocks.exact(f"probability_beyond_{name}", each) for name, _, each in _passed(result)),
    ]
    title, headline = result.fitted.experiment.name, quantities.capital("; ".join(_findings(result)))
    data = tuple(_peak_data(result.peaks, *more))
    return blocks.Document(title, headline, sections, data, heading="Reconstructed response")


def _findings(result: Reconstruction) -> Iterator[str]:
    """Yield the findings for an owner: the largest drift, the exceeded limits, and changes of the building."""
    if result.fallback:
        lower, upper, drift = max(result.sensor_drifts, key=lambda each: each[2])
        where = "the base" if lower == 0 else f"floor {lower}"
        yield result.fallback.partition(" (")[0]
        size = quantities.significant(1e3 * drift, 3)
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
            size = quantities.with_std(100 * abs(change), 100 * deviation, "%", factor=1.0)
            probable = quantities.chance(float(result.frame.story_probability[story - 1]))
            yield f"story {story} was {size} {word} than identified, against the others ({probable} probable)"
    elif result.names_changes:
        yield "no single story changed"
    for story in result.dampers:
        damper, deviation = (float(each[story - 1]) for each in result.frame.dashpots)
        how_large = f" of {quantities.with_std(damper, deviation, 'N s/m')}" if result.fitted.mass_known else ""
        probable = quantities.chance(float(result.frame.dashpot_probability[story - 1]))
        yield f"story {story} damps by itself, as a damper{how_large} would ({probable} probable)"
    if result.masses_changed:
        sizes = [
            f"floor {floor} by {100 * change:+.0f} ± {100 * std:.0f} %"
            for floor, (change, std) in enumerate(zip(*result.frame.mass_change, strict=True), 1)
            if abs(change) > SIGN_KNOWN * std
        ]
        probable = quantities.chance(result.frame.mass_probability)
        where = f": {', '.join(sizes)}" if sizes else "; which of them is open"
        yield f"the floors do not weigh what they did in the tests ({probable} probable){where}"


def _whole_frame(result: Reconstruction) -> Iterator[str]:
    """Yield the change of the lowest frequency and the common change of the stories, if their signs are known."""
    if not result.names_changes:
        return
    before = float(result.frame.errors.varied.centre.model.modes.frequencies[0])
    now, relative = float(result.model.modes.frequencies[0]), float(result.frame.modal_std[0][0])
    if abs(np.log(now / before)) > SIGN_KNOWN * relative:
        found = quantities.with_std(now, relative * now, "Hz", factor=1.0)
        yield f"f1 was {found}, {quantities.significant(before, 4)} Hz in the tests"
    mean, deviation = result.frame.mean_factor
    if abs(mean - 1) > SIGN_KNOWN * deviation:
        size = quantities.with_std(100 * abs(mean - 1), 100 * deviation, "%", factor=1.0)
        yield f"on average the stories were {size} {'softer' if mean < 1 else 'stiffer'} than identified"


def _sensor_drifts(result: Reconstruction) -> Iterator[blocks.Table]:
    """Tabulate the drifts between neighboring sensors in a fallback, the top first."""
    if result.fallback and result.sensor_drifts:
        lower, upper, drifts = zip(*result.sensor_drifts, strict=True)
        yield blocks.table("sensor-drifts", "peak drift between neighboring sensors, from their records alone", {
            "from": ["base" if floor == 0 else str(floor) for floor in lower],
            "to floor": [str(floor) for floor in upper],
            "peak drift, mm": [quantities.significant(1e3 * drift, 3) for drift in drifts],
        }, top_first=True)  # fmt: skip


def _limits(result: Moved) -> Iterator[str]:
    """Name the stories that exceeded each limit."""
    for word, limit, chances in _passed(result):
        possible, certain = chances > 1 - quantities.SURE, chances >= quantities.SURE
        sure, open_ = (np.flatnonzero(each) + 1 for each in (certain, possible & ~certain))
        label = f"{100 * limit:g} %" if word == f"{100 * limit:g} %" else f"{word} ({100 * limit:g} %)"
        unknown = bool(np.isnan(chances).any())
        passed = "cannot be told" if unknown else "passed in no story"
        if sure.size:
            elsewhere = ", elsewhere that cannot be told" if unknown else ""
            passed = f"passed in {quantities.numbered('story', sure.tolist())}{elsewhere}"
        perhaps = f", possibly in {quantities.numbered('story', open_.tolist())}" if open_.size else ""
        yield f"limit {label}: {passed}{perhaps}"


def left_out(result: Reconstruction) -> blocks.Table:
    """Tabulate the actual and the stated error of each sensor, predicted from all others."""
    alone = [each.prediction_error / each.measured for each in result.checks]
    return blocks.table("left-out-sensors", "each measured floor from the other sensors alone", {
        "floor": [str(each.floor) for each in result.checks],
        "rms, m/s²": [quantities.significant(each.measured, 3) for each in result.checks],
        "error": [quantities.percent(each.error / each.measured, 1) for each in result.checks],
        "stated": [quantities.percent(each.stated / each.measured, 1) for each in result.checks],
        "within 95 % band": [quantities.percent(each.within, 0) for each in result.checks],
        "prediction alone": [quantities.percent(ratio, 1) for ratio in alone],
    }, top_first=True)  # fmt: skip


def stories(result: Reconstruction) -> blocks.Table:
    """Tabulate the peak drifts, their limits and the changes of each story, the top first."""
    name = "story_drift_ratio" if "story_drift_ratio" in result.peaks.values else "story_drift"
    factor, unit = (0.01, "% of height") if name == "story_drift_ratio" else (1e-3, "mm")
    values, frame = result.peaks.values[name], result.frame
    unknown = np.full(len(values), np.nan)
    predicted = result.predicted_peaks.values[name] / factor
    columns = {
        "story": [str(story) for story in range(1, len(values) + 1)],
        f"peak drift, {unit}": _written(values, result.peaks.std[name], factor),
        "by prediction": [quantities.significant(value, 3) for value in predicted.tolist()],
        "stiffness / identified": _written(frame.factors, frame.factors_std, 1.0),
        "changed by itself": _chances(unknown if result.change_probability is None else result.change_probability),
        **{f"P(> {name})": _chances(each) for name, _, each in _passed(result)},
    }
    return blocks.table("reconstructed-stories", "peak drift ± standard deviation", columns, top_first=True)


def _passed(result: Moved) -> Iterator[tuple[str, float, Floats]]:
    """Yield the name of each limit, the limit, and the probability that each story passed it."""
    if result.passed is not None and result.limits is not None:
        yield from zip(result.limits.names, result.limits.story_drift.tolist(), result.passed, strict=True)


def _chances(probabilities: Floats) -> list[str]:
    return ["–" if np.isnan(each) else quantities.chance(each) for each in probabilities.tolist()]


def _frame_parts(result: Reconstruction) -> Iterator[blocks.Sentence | blocks.Table]:
    before = result.frame.errors.varied.centre.model
    shown = slice(min(len(result.model.M), blocks.PAGE_COLUMNS))
    values = [each[shown] for each in (result.model.modes.frequencies, result.model.ratios)]
    stds = [own * each[shown] for own, each in zip(values, result.frame.modal_std, strict=True)]
    yield blocks.table("reconstructed-modes", "modes of the frame ± standard deviation", {
        "mode": [str(mode) for mode in range(1, shown.stop + 1)],
        "identified, Hz": quantities.significants(before.modes.frequencies[shown].tolist(), 5),
        "in this record, Hz": _written(values[0], stds[0], 1.0),
        "damping identified": map(quantities.percent, before.ratios[shown].tolist()),
        "damping in this record, %": _written(values[1], stds[1], 0.01),
    })  # fmt: skip
    noise = result.frame.errors.noise_at(result.frame.p)
    yield blocks.Sentence(
        f"The model misses {quantities.percent(noise.force, 1)} of the rms story force. Damping is {result.kind}; "
        f"backend {result.backend}."
    )


def sensors(result: Reconstruction) -> blocks.Table:
    """Tabulate the noise of each sensor, and its samples that are spikes or missing."""
    noise = result.frame.errors.noise_at(result.frame.p).sensors
    return blocks.table("sensors", "noise and faulty samples", {
        "floor": [str(floor) for floor in result.recording.floors],
        "sensor noise, m/s²": [quantities.significant(float(own), 3) for own in noise],
        "spikes": [str(count) for count in result.spikes],
        "missing": [str(count) for count in result.missing],
    }, top_first=True)  # fmt: skip


#: Names of the columns by quantity; the columns of floor or story 1 end in `_1`.
COLUMN_NAMES = {name: quantity.word.replace(" ", "_") for name, quantity in RESPONSES.items()}

#: Units of the columns; the header of a CSV file shows them in brackets. A drift ratio has no unit.
SERIES_UNITS = {"time": "s"} | {COLUMN_NAMES[name]: each.unit.replace("²", "2") for name, each in RESPONSES.items()}


def _runs(result: Moved) -> list[tuple[Floats, Response, dict[str, Floats]]]:
    """List each run's excitation (m/s2 or N), its response, and the standard deviations by quantity."""
    if isinstance(result, Reconstruction):
        return [(run.excitation, run.response, run.std) for run in result.runs]
    excitations = [run.excitation for run in result.motion.runs]
    return list(zip(excitations, result.after.responses, result.std, strict=True))


def series(result: Moved) -> dict[str, Floats]:
    """Collect every quantity at every floor or story, one column each.

    Returns
    -------
    dict of str to ndarray, shape (samples,)
        `run` (from 1, several one after the other), `time` (s, from the start of each), `excitation` (m/s2 or N), then
        the applicable columns of `COLUMN_NAMES`, each followed by its standard deviations (`drift_std_1`).
    """
    runs = []
    for place, (excitation, response, std) in enumerate(_runs(result), 1):
        columns = {"run": np.full(len(excitation), float(place)), "time": response.time, "excitation": excitation}
        for quantity, values in histories(response).items():
            if values is not None:
                columns |= _columns(COLUMN_NAMES[quantity], values)
                if quantity in std:
                    columns |= _columns(f"{COLUMN_NAMES[quantity]}_std", std[quantity])
        runs.append(columns)
    return {name: np.concatenate([columns[name] for columns in runs]) for name in runs[0]}


def _columns(name: str, values: Floats) -> dict[str, Floats]:
    if values.ndim == 1:
        return {name: values}
    return {f"{name}_{place + 1}": values[:, place] for place in range(values.shape[1])}


def write_series(path: str | Path, result: Moved) -> None:
    """Write the time series of a prediction or a reconstruction.

    Parameters
    ----------
    path : str or Path
        Ending in .csv, .mat or .npz; a device receives CSV.
    result : RecordPrediction or Reconstruction

    Raises
    ------
    InputError
        If the ending is unknown, or the file cannot be written.
    """
    write_file(path, SERIES_WRITERS[ending_of(path, SERIES_WRITERS, "time series are written as")](result))


def _csv(result: Moved) -> bytes:
    columns, out = series(result), StringIO()
    record = result.recording if isinstance(result, Reconstruction) else result.motion
    units = SERIES_UNITS | {"excitation": "N" if record.input == "force" else "m/s2"}
    heads = [f"{name} ({unit})" if (unit := units.get(re.sub(r"_std|_\d+", "", name))) else name for name in columns]
    np.savetxt(out, np.array([*columns.values()]).T, delimiter=",", header=",".join(heads), comments="", fmt="%.9g")
    return out.getvalue().encode()


def _npz(result: Moved) -> bytes:
    np.savez_compressed(out := BytesIO(), **series(result))  # type: ignore[arg-type]  # numpy takes any names
    return out.getvalue()


def _mat(result: Moved) -> bytes:
    io.savemat(out := BytesIO(), series(result), oned_as="column")  # type: ignore[arg-type]  # a stream will do
    return out.getvalue()


#: Writers of time series by the ending of the file.
SERIES_WRITERS: dict[str, Callable[[Moved], bytes]] = {"csv": _csv, "mat": _mat, "npz": _npz}
