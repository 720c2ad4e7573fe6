"""Make ordinary mistakes in a sound measurement file."""

import copy

import numpy as np

WHOLE = ("transposed", "mode_number", "sensor_floors", "drifts")
"""Mistakes that need a file of all modes at all floors."""

SENSOR_MISTAKES = ("swapped_sensors", "sensor_sign", "floors_from_top", "sensor_floors", "sensor_unit", "drifts")
"""Mistakes in the setup of the sensors, so they affect every configuration. The others affect one configuration."""

LEAST_ENTRY = 0.06
"""Smallest entry, relative to a mode's largest, that a mistake multiplies by -1. Swapped sensors must differ
by at least this in some mode; smaller mistakes have no visible effect."""


def with_mistake(name, declared, rng):
    """Return the dict with one of `MISTAKES`, the configurations with it, and words of the finding's `change`."""
    declared = copy.deepcopy(declared)
    tables = declared["configuration"]
    wrong = tables if name in SENSOR_MISTAKES else [tables[int(rng.integers(len(tables)))]]
    word = MAKE[name](wrong, rng, declared["frame"]["stories"])
    return declared, [table["name"] for table in wrong], word


def missing_mode(tables, rng, stories):
    """Leave out a mode that is not the highest measured one."""
    (table,) = tables
    absent = int(rng.integers(len(table["frequencies"]) - 1))
    for key in ("frequencies", "mode_shapes"):
        del table[key][absent]
    kept = [number for number in range(1, len(table["frequencies"]) + 2) if number != absent + 1]
    return f"modes = {kept}"


def transposed(tables, rng, stories):
    (table,) = tables
    table["mode_shapes"] = np.array(table["mode_shapes"]).T.tolist()
    return "transpose"


def swapped_sensors(tables, rng, stories):
    shapes = np.array(tables[0]["mode_shapes"])
    floors = tables[0]["measured_floors"]
    while True:
        low, high = sorted(rng.choice(len(floors), 2, replace=False))
        if np.max(np.abs(shapes[:, low] - shapes[:, high])) > LEAST_ENTRY:
            break
    order = list(range(len(floors)))
    order[low], order[high] = high, low
    for table in tables:
        table["mode_shapes"] = [[row[column] for column in order] for row in table["mode_shapes"]]
    return f"floors {floors[low]} and {floors[high]}"


def sensor_sign(tables, rng, stories):
    column = int(rng.integers(len(tables[0]["measured_floors"])))
    for table in tables:
        for row in table["mode_shapes"]:
            row[column] *= -1
    return f"floor {tables[0]['measured_floors'][column]}'s"


def entry_sign(tables, rng, stories):
    (table,) = tables
    shapes = np.array(table["mode_shapes"])
    large = np.argwhere(np.abs(shapes) > LEAST_ENTRY * np.max(np.abs(shapes), axis=1, keepdims=True))
    row, column = large[rng.integers(len(large))]
    table["mode_shapes"][row][column] *= -1
    return f"floor {table['measured_floors'][column]} in mode {table.get('modes', range(1, 99))[row]}"


def floors_from_top(tables, rng, stories):
    for table in tables:
        table["mode_shapes"] = [row[::-1] for row in table["mode_shapes"]]
    return "from the lowest floor up"


def mode_order(tables, rng, stories):
    """Put the shapes in any other order."""
    (table,) = tables
    count = len(table["frequencies"])
    order = rng.permutation(count)
    while np.all(order == np.arange(count)):
        order = rng.permutation(count)
    table["mode_shapes"] = [table["mode_shapes"][place] for place in order]
    return "mode_shapes in the places of"


def mode_number(tables, rng, stories):
    """Leave out a mode, declare `modes`, and give one wrong number. The numbers differ from 1, 2, ..., the default."""
    (table,) = tables
    while True:
        count = int(rng.integers(2, stories))
        numbers = sorted(rng.choice(stories, count, replace=False) + 1)
        wrong = list(numbers)
        wrong[rng.integers(count)] = int(rng.integers(1, stories + 1))
        if wrong == sorted(set(wrong)) and wrong != numbers and wrong != list(range(1, count + 1)):
            break
    for key in ("frequencies", "mode_shapes"):
        table[key] = [table[key][number - 1] for number in numbers]
    table["modes"] = [int(number) for number in wrong]
    return f"modes = {[int(number) for number in numbers]}"


def sensor_floors(tables, rng, stories):
    """List sensors from the first floor up, though they stand from the second floor up."""
    for table in tables:
        table["mode_shapes"] = [row[1:] for row in table["mode_shapes"]]
        table["measured_floors"] = list(range(1, stories))
    return f"list them at floors 2{', 3' if stories > 2 else ''}"


def sensor_unit(tables, rng, stories):
    """Give one sensor in mm, or in g, and the others in m, or in m/s2."""
    column = int(rng.integers(len(tables[0]["measured_floors"])))
    factor = float(rng.choice([1000.0, 1 / 9.80665]))
    for table in tables:
        for row in table["mode_shapes"]:
            row[column] *= factor
    return f"floor {tables[0]['measured_floors'][column]}'s entry in every mode by {1 / factor:.4g}"


def drifts(tables, rng, stories):
    for table in tables:
        table["mode_shapes"] = [np.diff(row, prepend=0.0).tolist() for row in table["mode_shapes"]]
    return "add the entries of each mode up"


def frequency_unit(tables, rng, stories):
    """Give frequencies in rad/s, in cycles per minute or in mHz."""
    (table,) = tables
    factor = float(rng.choice([2 * np.pi, 60.0, 1000.0]))
    table["frequencies"] = [factor * value for value in table["frequencies"]]
    return "in Hz"


def periods(tables, rng, stories):
    """Give periods in ascending order, with their shapes."""
    (table,) = tables
    table["frequencies"] = [1 / value for value in table["frequencies"][::-1]]
    table["mode_shapes"] = table["mode_shapes"][::-1]
    return "write 1 / period"


MAKE = {
    make.__name__: make
    for make in (
        missing_mode, transposed, swapped_sensors, sensor_sign, entry_sign, floors_from_top, mode_order, mode_number,
        sensor_floors, sensor_unit, drifts, frequency_unit, periods,
    )
}  # fmt: skip
MISTAKES = tuple(MAKE)
