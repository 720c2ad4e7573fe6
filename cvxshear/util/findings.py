"""The names of what `check` finds in a measurement file, which `[frame] accept = [...]` takes."""

from __future__ import annotations

MISTAKES = {
    "sensor_sign": "one sensor's sign is turned round in every mode",
    "swapped_sensors": "two sensors stand in each other's place",
    "floors_from_top": "the floors are listed from the top",
    "transposed": "mode_shapes has a row a floor in place of a row a mode",
    "mode_order": "the shapes stand in another order than the frequencies",
    "missing_mode": "a mode was not measured and `modes` does not say which",
    "mode_number": "one of the numbers in `modes` is wrong",
    "entry_sign": "one entry of one shape has the wrong sign",
    "sensor_floors": "one sensor, or all, are listed one floor too low or too high",
    "sensor_unit": "one sensor's entries are in another unit",
    "drifts": "mode_shapes are drifts of the stories in place of displacements of the floors",
    "frequency_unit": "one configuration's frequencies are in another unit than those of the others",
    "signs": "a shape has signs that no mode of that number has, and no single change mends it",
}
"""What is refused unless it is accepted."""

NUMBERS = ("missing_mode", "mode_number")
"""Mistakes in which modes of the frame the measured ones are."""

DOUBTS = {
    "angular_frequency": "frequencies look like rad/s in place of Hz",
    "heights": "story heights look like mm or cm in place of m",
    "masses": "masses look like g or t in place of kg",
    "elevations": "story heights are added up: elevations of the floors",
    "time_unit": "frequencies are lower than those of any frame: times in ms, or frequencies in kHz",
    "deviations": "standard deviations are finer than any instrument measures, or look like percent",
    "repeated": "configurations repeat each other to the last digit",
    "gravity": "gravity is not that of the Earth in m/s2",
    "total_mass": "the total mass contradicts what the added masses did to the frequencies",
}
"""What is warned of."""

NAMES = (*MISTAKES, *DOUBTS)
