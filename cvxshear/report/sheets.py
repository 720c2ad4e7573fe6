"""Convert results to plain tables for spreadsheet programs."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from cvxshear.fit.results import Identification
from cvxshear.io.spreadsheets import Cell, Sheet
from cvxshear.loop import LoopResult
from cvxshear.measurement.experiment import Experiment
from cvxshear.records import ModalResult
from cvxshear.report.describe.consequences import MODELS, compared_errors
from cvxshear.response.peaks import RESPONSES
from cvxshear.util.typing import Json

EFFECTS = ("effect", "floor", "story", "configuration", "parameter", "unit", "value", "std")
FRAME = ("floor / story", "floor mass, kg", "floor mass std, kg", "story stiffness, N/m", "story stiffness std, N/m")


def sheets_of_modes(results: Sequence[ModalResult]) -> list[Sheet]:
    """Make one sheet for each record, in the format that `csv` and `xlsx` of a configuration read."""
    return [_modes(result) for result in results]


def sheets_of_identification(result: Identification) -> list[Sheet]:
    """Tabulate the identified frames, and their modes beside the measured ones."""
    said = result.to_dict()
    parts = [("", said)] if result.joint else [(part["name"], part) for part in said["configurations"]]
    several = len(parts) > 1
    header = ("configuration", *FRAME) if several else FRAME
    rows = [(name, *row) if several else row for name, part in parts for row in _frame_rows(part["frame"])]
    predicted = [item for _, part in parts for item in part["predictions"]]
    return [Sheet("frame", header, rows), _frequencies(result.experiment, predicted)]


def sheets_of_closure(result: LoopResult) -> list[Sheet]:
    """Tabulate the identified frame, the effects added, the errors of both models, and the modes."""
    said = result.to_dict()
    words = {key: label for key, label, _ in compared_errors("predicted from the rest")}
    errors: list[tuple[Cell, ...]] = [
        (words.get(key, _words(key)), said["before"][key], said["after"][key]) for key in said["before"]
    ]
    return [
        Sheet("frame", FRAME, list(_frame_rows(said["frame"]))),
        Sheet("effects", EFFECTS, list(_effects(result))),
        Sheet("errors", ("error", *MODELS), errors),
        _frequencies(result.experiment, said["predictions"]),
    ]


def sheets_of_response(said: Json) -> list[Sheet]:
    """Tabulate the peaks of a prediction or reconstruction with their deviations by floor or story, then single values.

    Parameters
    ----------
    said : dict
        JSON of the result.
    """
    peaks = {name: values for name, values in said["peaks"].items() if isinstance(values, list)}
    header = ("floor / story", *map(_with_unit, peaks))
    rows: list[tuple[Cell, ...]] = [(place, *row) for place, row in enumerate(zip(*peaks.values(), strict=True), 1)]
    alone = [(_with_unit(name), value) for name, value in said["peaks"].items() if not isinstance(value, list)]
    frame = said.get("frame")
    sheets = [Sheet("peaks", header, rows), Sheet("base", ("quantity", "value"), [*alone])]
    if frame is not None:
        keys = ("story_factor", "story_factor_std", "change_probability")
        table = zip(*(frame[key] for key in keys), strict=True)
        sheets.append(Sheet("frame", ("story", *map(_words, keys)), [(at, *row) for at, row in enumerate(table, 1)]))
    if said.get("limits"):
        chances = zip(*(each["probability"] for each in said["limits"]), strict=True)
        names = tuple(each["name"] for each in said["limits"])
        sheets.append(Sheet("limits", ("story", *names), [(at, *row) for at, row in enumerate(chances, 1)]))
    return sheets


def _modes(result: ModalResult) -> Sheet:
    floors = result.floors.tolist()
    # The unit marks mass-normalized shapes; other shapes have the largest entry 1.
    unit = ", 1/sqrt(kg)" if result.mass_normalized else ""
    largest = np.abs(result.mode_shapes).max(axis=1, keepdims=True)
    scale = np.ones_like(largest) if result.mass_normalized else 1.0 / largest
    columns = {
        "mode": result.modes,
        "frequency, Hz": result.frequencies,
        "frequency std, Hz": result.frequencies * result.frequency_std,
        "damping ratio": result.damping_ratios,
        **{f"floor {floor}{unit}": each for floor, each in zip(floors, (scale * result.mode_shapes).T, strict=True)},
        **{
            f"floor {floor} std{unit}": each
            for floor, each in zip(floors, (scale * largest * result.entry_std).T, strict=True)
        },
    }
    given = {name: each.tolist() for name, each in columns.items() if np.any(np.isfinite(each))}
    return Sheet(result.name, tuple(given), list(zip(*given.values(), strict=True)))


def _frame_rows(frame: Json) -> Iterator[tuple[Cell, ...]]:
    columns = [frame[key] for key in ("floor_mass", "floor_mass_std", "story_stiffness", "story_stiffness_std")]
    given = [[None] * len(columns[0]) if column is None else column for column in columns]
    yield from ((place, *row) for place, row in enumerate(zip(*given, strict=True), 1))


def _frequencies(experiment: Experiment, predictions: Sequence[Json]) -> Sheet:
    """Tabulate every measured frequency beside the model's."""
    rows: list[tuple[Cell, ...]] = []
    for item in predictions:
        configuration = next(each for each in experiment.configurations if each.name == item["configuration"])
        for mode, measured in zip(configuration.modes.tolist(), configuration.frequencies.tolist(), strict=True):
            modelled = item["frequencies"][mode - 1]
            error = None if math.isnan(modelled) else modelled / measured - 1
            rows.append((configuration.name, mode, measured, modelled, error))
    return Sheet("modes", ("configuration", "mode", "measured, Hz", "model, Hz", "relative error"), rows)


def _effects(result: LoopResult) -> Iterator[tuple[Cell, ...]]:
    """List each parameter of each effect with its unit, value and standard deviation."""
    for found in result.effects:
        said = found.to_dict()
        names = (item.name for item in found.placed.effect.parameters)
        units = dict(zip(names, found.placed.units(result.experiment), strict=True))
        where = (_words(said["name"]), said["floor"], said["story"], said["configuration"])
        for name, value in said["parameters"].items():
            yield (*where, _words(name), units.get(name, ""), value, said["std"][name])


def _with_unit(name: str) -> str:
    """Write the name of a peak, or of its standard deviation, with its unit."""
    unit = RESPONSES[name.removesuffix("_std")].unit
    return f"{_words(name)}, {unit}" if unit else _words(name)


def _words(name: str) -> str:
    return name.replace("_", " ")
