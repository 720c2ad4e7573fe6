"""The single changes that would mend a reading, one function a kind of mistake.

Each proposes all possible places of its mistake in a reading. Whether one was made is not
decided here.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import comb
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from cvxshear.measurement.reading import MeasuredModes
from cvxshear.model.shear import Modes
from cvxshear.screening.finding import in_words
from cvxshear.util.typing import Floats, Ints

MISTAKEN = 1e-2
"""Probability that a configuration has a mistake of one kind: one file in a hundred."""

LEFT_TO_GIVEN = 1e-3
"""Refuse a reading if its odds against the best repair are smaller: a wrong refusal costs more than a doubt."""

SUSPICIOUS = 25.0
"""Readings with a smaller cost need no search: a repair cannot be 1e5 times as probable, which takes 2 log 1e5."""

RIVAL_COST = 9.0
"""Name a repair beside the best one if their costs differ by less: at least a hundredth of its probability."""

UNEXPLAINED = 0.25
"""Share of the cost as given that a repair may leave at most, where that is more."""

MOST_FITTED = 6
"""Repairs of the least misfit to each reference frame that are fitted."""

REFITTED = 6
"""Repairs, the best of those fitted, that are fitted again with each tolerance."""

MOST_NUMBERINGS = 60
"""Sets of mode numbers are all tried where there are no more; else those that leave out one mode."""


@dataclass(frozen=True, eq=False)
class Repair:
    """A change of a reading.

    Parameters
    ----------
    name : str
        Of the mistake that it mends, a key of `cvxshear.measurement.declaration.MISTAKES`.
    found, change : str
        What the mistake would be, and what to change: parts of sentences.
    reading : MeasuredModes
        As it would be.
    choices : int
        Among how many of its kind it is one; the more there are the better must it be.
    """

    name: str
    found: str
    change: str
    reading: MeasuredModes
    choices: int

    @property
    def prior_cost(self) -> float:
        """Minus twice the logarithm of the odds that it is what happened."""
        return prior_cost(self.choices)


def _repair(key: str, reading: MeasuredModes, choices: int, /, **gaps: object) -> Repair:
    """Describe a repair in the words of its key."""
    return Repair(*in_words(key, **gaps), reading, choices)


def _picked(reading: MeasuredModes, which: Any) -> MeasuredModes:
    """Pick entries of the shapes and their standard deviations by an index."""
    return replace(reading, shapes=reading.shapes[which], noise=reading.noise[which])


def prior_cost(choices: int) -> float:
    """Minus twice the logarithm of the odds of a mistake of one kind at one of the given number of places."""
    return 2 * float(np.log(choices / MISTAKEN))


def sensor_signs(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Each sensor turned round in every mode."""
    width = len(reading.floors)
    for column, floor in enumerate(reading.floors + 1):
        turned = np.where(np.arange(width) == column, -1.0, 1.0)
        yield _repair("sensor_sign", replace(reading, shapes=reading.shapes * turned), width, floor=floor)


def exchanged_sensors(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Each pair of sensors exchanged."""
    width = len(reading.floors)
    for low, high in itertools.combinations(range(width), 2):
        names = f"floors {reading.floors[low] + 1} and {reading.floors[high] + 1}"
        order = np.s_[:, _exchanged(width, low, high)]
        yield _repair("swapped_sensors", _picked(reading, order), comb(width, 2), floors=names)


def floors_from_top(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """List the floors in the opposite order."""
    if len(reading.floors) > 1:
        yield _repair("floors_from_top", _picked(reading, np.s_[:, ::-1]), 1)


GROUND_STILL = 3.0
"""An entry may come from a sensor on the ground if it is smaller than this number of standard deviations, tolerance
included."""

UNITS = (1e3, 1e-3, 9.80665, 1 / 9.80665)
"""Factors between units in which sensors are read: m and mm, m/s2 and g."""


def other_floors(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """All sensors one floor higher or lower, and each of them by itself; one on the ground shows no motion."""
    floors, top = reading.floors, reading.stories - 1
    choices = 2 * (len(floors) + 1)
    for by, word in ((1, "low"), (-1, "high")):
        moved = floors + by
        on = (moved >= 0) & (moved <= top)
        # A sensor on the ground must show no motion.
        still = np.all(np.abs(reading.scaled * reading.weights)[:, moved < 0] < GROUND_STILL)
        if np.all(moved <= top) and still and on.any():
            listed = ", ".join(str(floor + 1) for floor in moved)
            but = "" if np.all(on) else " (0 is the ground: leave its entries out)"
            there = replace(_picked(reading, np.s_[:, on]), floors=moved[on])
            yield _repair("sensor_floors/all", there, choices, low=word, floors=listed, but=but)
        for column, floor in enumerate(moved.tolist()):
            if 0 <= floor <= top and floor not in floors:
                there = replace(reading, floors=np.where(np.arange(len(floors)) == column, floor, floors))
                yield _repair("sensor_floors/one", there, choices, low=word, before=floors[column] + 1, floor=floor + 1)


def other_units(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Each sensor in another unit."""
    width = len(reading.floors)
    for column in range(width if width > 1 else 0):
        for factor in UNITS:
            scale = np.where(np.arange(width) == column, factor, 1.0)
            other = replace(reading, shapes=reading.shapes * scale, noise=reading.noise * scale)
            yield _repair("sensor_unit", other, width * len(UNITS), floor=reading.floors[column] + 1, factor=factor)


def periods(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Take the frequencies for periods, which descend from the first mode to the last."""
    if len(reading.modes) > 1:
        noise = reading.frequency_noise[::-1]
        turned = _picked(reading, np.s_[::-1])
        yield _repair(
            "periods", replace(turned, log_frequencies=-reading.log_frequencies[::-1], frequency_noise=noise), 1
        )


def drifts(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Drifts of the stories added up to displacements of the floors."""
    width = len(reading.floors)
    if width > 1 and np.array_equal(reading.floors, np.arange(width)):
        noise = np.sqrt(np.cumsum(reading.noise**2, axis=1))
        yield _repair("drifts", replace(reading, shapes=np.cumsum(reading.shapes, axis=1), noise=noise), 1)


def transposed(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Rows for columns."""
    if len(reading.floors) == len(reading.modes) > 1:
        yield _repair("transposed", replace(reading, shapes=reading.shapes.T, noise=reading.noise.T), 1)


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
        yield _repair("mode_order", _picked(reading, list(order)), choices, rows=rows, others=others)


def _exchanged(count: int, i: int, j: int) -> Ints:
    order = np.arange(count)
    order[[i, j]] = j, i
    return order


def _assigned(reading: MeasuredModes, frame: Modes) -> Ints:
    """Find the order of rows with the largest sum of modal assurance criteria with the frame's modes."""
    psi = frame.shapes[np.ix_(reading.modes, reading.floors)]
    read = reading.scaled
    weight = reading.known.astype(float)
    length = np.sum(read**2, axis=1, keepdims=True) * (weight @ (psi**2).T)
    mac = (read @ psi.T) ** 2 / np.where(length > 0, length, 1.0)
    rows, places = linear_sum_assignment(-mac)
    order: Ints = np.empty(len(rows), dtype=np.int64)
    order[places] = rows
    return order


def other_numbers(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Renumber the modes: other sets where they are 1, 2, 3, ...; else with one number changed."""
    count, N = len(reading.modes), reading.stories
    running = bool(np.all(reading.modes == np.arange(count)))
    numberings = list(_gaps(count, N) if running else _one_changed(reading.modes.tolist(), N))
    for numbers in numberings:
        modes = ", ".join(str(number + 1) for number in numbers)
        other = replace(reading, modes=np.array(numbers)), len(numberings)
        if running:
            absent = [str(number + 1) for number in range(numbers[-1]) if number not in numbers]
            plural = "s" * (len(absent) > 1)
            yield _repair("missing_mode", *other, modes=modes, s=plural, absent=", ".join(absent))
        else:
            pairs = zip(reading.modes + 1, np.array(numbers) + 1, strict=True)
            wrong = ", ".join(f"what is called mode {called} is mode {new}" for called, new in pairs if called != new)
            yield _repair("mode_number", *other, modes=modes, wrong=wrong)


def _gaps(count: int, N: int) -> Iterator[tuple[int, ...]]:
    """Numbers of `count` of N modes that are not the lowest."""
    if comb(N, count) <= MOST_NUMBERINGS:
        yield from itertools.islice(itertools.combinations(range(N), count), 1, None)
    elif count < N:
        for absent in range(count):
            yield tuple(number for number in range(count + 1) if number != absent)


def _one_changed(numbers: list[int], N: int) -> Iterator[tuple[int, ...]]:
    """Change one of the numbers, so that they still ascend."""
    for place in range(len(numbers)):
        low = numbers[place - 1] + 1 if place else 0
        high = numbers[place + 1] if place + 1 < len(numbers) else N
        for number in range(low, high):
            if number != numbers[place]:
                yield (*numbers[:place], number, *numbers[place + 1 :])


def entry_signs(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Repair]:
    """Each entry turned round."""
    known = np.argwhere(reading.known)
    for row, column in known:
        shapes: Floats = reading.shapes.copy()
        shapes[row, column] *= -1
        place = {"floor": reading.floors[column] + 1, "mode": reading.modes[row] + 1}
        yield _repair("entry_sign", replace(reading, shapes=shapes), len(known), **place)


KINDS: tuple[Callable[[MeasuredModes, Sequence[Modes]], Iterator[Repair]], ...] = (
    transposed, floors_from_top, periods, drifts, other_floors, other_units, sensor_signs, exchanged_sensors,
    other_numbers, other_orders, entry_signs,
)  # fmt: skip
"""Kinds of repairs, the simplest first: of two that are alike the first is named."""
