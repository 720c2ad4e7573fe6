"""Changes of one test's data that would mend a mistake, one function a kind of mistake.

Each function lists every place of its mistake. Whether a mistake was made is decided in `mistakes`.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import comb
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from cvxshear.measurement.reading import CERTAIN, MeasuredModes
from cvxshear.model import Modes
from cvxshear.util.quantities import STANDARD_GRAVITY
from cvxshear.util.typing import Floats, Ints

UNITS = (1e3, 1e-3, STANDARD_GRAVITY, 1 / STANDARD_GRAVITY)
"""Factors between units of sensors: m and mm, m/s2 and g."""


@dataclass(frozen=True, eq=False)
class Repair:
    """A change of one test's data.

    Parameters
    ----------
    key : str
        Of the words for the mistake.
    reading : MeasuredModes
        The data as they would be.
    choices : int
        Number of places where a mistake of this kind can be made.
    gaps : dict
        What the words leave open.
    """

    key: str
    reading: MeasuredModes
    choices: int
    gaps: dict[str, object]


Kind = Callable[[MeasuredModes, Sequence[Modes]], Iterator[Repair]]
"""A kind of mistake: the repairs of a reading; some kinds ask frames of about the right proportions."""


def _picked(reading: MeasuredModes, which: Any) -> MeasuredModes:
    """Pick entries of the shapes and their standard deviations by an index."""
    return replace(reading, shapes=reading.shapes[which], noise=reading.noise[which])


def _scaled(reading: MeasuredModes, column: int, factor: float) -> MeasuredModes:
    """Multiply the entries of one sensor by a factor."""
    scale = np.where(np.arange(len(reading.floors)) == column, factor, 1.0)
    return replace(reading, shapes=reading.shapes * scale, noise=reading.noise * np.abs(scale))


def sensor_signs(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Each sensor reversed in every mode."""
    for column, floor in enumerate(reading.floors + 1):
        yield Repair("sensor_sign", _scaled(reading, column, -1.0), len(reading.floors), {"floor": floor})


def exchanged_sensors(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Each pair of sensors exchanged."""
    width = len(reading.floors)
    for low, high in itertools.combinations(range(width), 2):
        names = f"floors {reading.floors[low] + 1} and {reading.floors[high] + 1}"
        there = _picked(reading, np.s_[:, _exchanged(width, low, high)])
        yield Repair("swapped_sensors", there, comb(width, 2), {"floors": names})


def floors_from_top(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """List the floors in the opposite order."""
    if len(reading.floors) > 1:
        yield Repair("floors_from_top", _picked(reading, np.s_[:, ::-1]), 1, {})


def other_floors(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """All sensors one floor higher or lower, and each of them alone; one on the ground shows no motion."""
    floors, top = reading.floors, reading.stories - 1
    choices = 2 * (len(floors) + 1)
    for by, word in ((1, "low"), (-1, "high")):
        moved = floors + by
        on = (moved >= 0) & (moved <= top)
        still = np.all(np.abs(reading.scaled * reading.weights)[:, moved < 0] < CERTAIN)
        if np.all(moved <= top) and still and on.any():
            listed = ", ".join(str(floor + 1) for floor in moved)
            but = "" if np.all(on) else " (0 is the ground: leave its entries out)"
            there = replace(_picked(reading, np.s_[:, on]), floors=moved[on])
            yield Repair("sensor_floors/all", there, choices, {"low": word, "floors": listed, "but": but})
        for column, floor in enumerate(moved.tolist()):
            if 0 <= floor <= top and floor not in floors:
                there = replace(reading, floors=np.where(np.arange(len(floors)) == column, floor, floors))
                gaps = {"low": word, "before": floors[column] + 1, "floor": floor + 1}
                yield Repair("sensor_floors/one", there, choices, gaps)


def other_units(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Each sensor in another unit."""
    width = len(reading.floors)
    for column, factor in itertools.product(range(width if width > 1 else 0), UNITS):
        gaps = {"floor": reading.floors[column] + 1, "factor": factor}
        yield Repair("sensor_unit", _scaled(reading, column, factor), width * len(UNITS), gaps)


def periods(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Take the frequencies for periods, which descend from the first mode to the last."""
    if len(reading.modes) > 1:
        turned = _picked(reading, np.s_[::-1])
        logs, noise = -reading.log_frequencies[::-1], reading.frequency_noise[::-1]
        yield Repair("periods", replace(turned, log_frequencies=logs, frequency_noise=noise), 1, {})


def drifts(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Drifts of the stories added up to displacements of the floors."""
    width = len(reading.floors)
    if width > 1 and np.array_equal(reading.floors, np.arange(width)):
        noise = np.sqrt(np.cumsum(reading.noise**2, axis=1))
        yield Repair("drifts", replace(reading, shapes=np.cumsum(reading.shapes, axis=1), noise=noise), 1, {})


def transposed(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Rows for columns."""
    if len(reading.floors) == len(reading.modes) > 1:
        yield Repair("transposed", replace(reading, shapes=reading.shapes.T, noise=reading.noise.T), 1, {})


def other_orders(reading: MeasuredModes, frames: Sequence[Modes]) -> Iterator[Repair]:
    """Each exchange of two shapes, and the best order of the shapes for each frame."""
    count = len(reading.modes)
    orders = {tuple(_exchanged(count, i, j)) for i, j in itertools.combinations(range(count), 2)}
    orders |= {tuple(_assigned(reading, frame)) for frame in frames}
    orders.discard(tuple(range(count)))
    for order in sorted(orders):
        places = [place for place in range(count) if order[place] != place]
        rows, others = (", ".join(str(each + 1) for each in some) for some in (places, [order[at] for at in places]))
        choices = comb(count, 2) * 2 ** (len(places) - 2)
        yield Repair("mode_order", _picked(reading, list(order)), choices, {"rows": rows, "others": others})


def _exchanged(count: int, i: int, j: int) -> Ints:
    order = np.arange(count)
    order[[i, j]] = j, i
    return order


def _assigned(reading: MeasuredModes, frame: Modes) -> Ints:
    """Find the order of rows with the largest sum of modal assurance criteria with the frame's modes."""
    psi, read, weight = frame.shapes[np.ix_(reading.modes, reading.floors)], reading.scaled, reading.known.astype(float)
    length = np.sum(read**2, axis=1, keepdims=True) * (weight @ (psi**2).T)
    rows, places = linear_sum_assignment(-((read @ psi.T) ** 2) / np.where(length > 0, length, 1.0))
    order: Ints = np.empty(len(rows), dtype=np.int64)
    order[places] = rows
    return order


def other_numbers(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Other numbers of the modes: one or two left out where they are 1, 2, 3, ...; else one number changed."""
    count, N = len(reading.modes), reading.stories
    running = bool(np.all(reading.modes == np.arange(count)))
    if running:
        numberings = list(itertools.combinations(range(min(count + 2, N)), count))[1:]
    else:
        numberings = list(_one_changed(reading.modes.tolist(), N))
    for numbers in numberings:
        modes = ", ".join(str(number + 1) for number in numbers)
        there = replace(reading, modes=np.array(numbers))
        if running:
            absent = [str(number + 1) for number in range(numbers[-1]) if number not in numbers]
            gaps: dict[str, object] = {"modes": modes, "s": "s" * (len(absent) > 1), "absent": ", ".join(absent)}
            yield Repair("missing_mode", there, len(numberings), gaps)
        else:
            pairs = zip(reading.modes + 1, np.array(numbers) + 1, strict=True)
            wrong = ", ".join(f"what is called mode {called} is mode {new}" for called, new in pairs if called != new)
            yield Repair("mode_number", there, len(numberings), {"modes": modes, "wrong": wrong})


def _one_changed(numbers: list[int], N: int) -> Iterator[tuple[int, ...]]:
    """Change one of the numbers, so that they still ascend."""
    for place in range(len(numbers)):
        low = numbers[place - 1] + 1 if place else 0
        high = numbers[place + 1] if place + 1 < len(numbers) else N
        for number in range(low, high):
            if number != numbers[place]:
                yield (*numbers[:place], number, *numbers[place + 1 :])


def entry_signs(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Each entry reversed."""
    known = np.argwhere(reading.known)
    for row, column in known:
        shapes: Floats = reading.shapes.copy()
        shapes[row, column] *= -1
        place = {"floor": reading.floors[column] + 1, "mode": reading.modes[row] + 1}
        yield Repair("entry_sign", replace(reading, shapes=shapes), len(known), place)


KINDS: tuple[Kind, ...] = (
    transposed, floors_from_top, periods, drifts, other_floors, other_units, sensor_signs, exchanged_sensors,
    other_numbers, other_orders, entry_signs,
)  # fmt: skip
"""Kinds of mistakes, the simplest first: of two that are alike the first is named."""
