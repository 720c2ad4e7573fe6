"""Mistakes in measured modes: hypotheses, weighed by the data as they would be if mended.

A hypothesis changes one thing: a sign, a sensor's place or unit, an order, a mode's number. The nearest shear frame is
fitted to the data as given and as changed. A change that can be made at K places has the prior odds q / K against the
data as given, q the share of files with a mistake of its kind. The evidence of each fit makes them probabilities
(`ranking.weigh`). A mistake is named if the data as given are improbable, with all changes that are needed to make the
mistake certain.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import comb
from typing import Any, TypeVar

import numpy as np
from scipy import linalg
from scipy.optimize import linear_sum_assignment

from cvxshear import backends
from cvxshear.measurement import reading as readings
from cvxshear.measurement.configuration import Sensor
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.measurement.reading import MeasuredModes
from cvxshear.model import Modes
from cvxshear.motions import THREE_MOTIONS
from cvxshear.programs.turning import TurningTest
from cvxshear.screening import nearest_frame
from cvxshear.screening.doubts import FileFinding, in_words
from cvxshear.screening.nearest_frame import NearestFrame, ShearFrames
from cvxshear.util import errors, quantities, ranking
from cvxshear.util.typing import Floats, Ints

#: Factors between units of sensors: m and mm, m/s2 and g.
UNITS = (1e3, 1e-3, quantities.STANDARD_GRAVITY, 1 / quantities.STANDARD_GRAVITY)


UNFITTED = NearestFrame(np.zeros(0))


@dataclass(frozen=True, eq=False)
class Change:
    """A hypothesis: one change of the data, and the nearest frame with it.

    Parameters
    ----------
    key : str
        Of the words for the mistake.
    reading : MeasuredModes
        The data as they would be.
    choices : int
        Number of places where a mistake of this kind can be made.
    gaps : mapping
        What the words leave open.
    frame : NearestFrame, optional
        The frame nearest to the changed data, after it was fitted.
    """

    key: str
    reading: MeasuredModes
    choices: int
    gaps: Mapping[str, object]
    frame: NearestFrame = UNFITTED

    @property
    def frames(self) -> ShearFrames:
        """Shear frames compared with the changed data."""
        return ShearFrames.of(self.reading)

    @property
    def plausible(self) -> bool:
        """Whether a shear frame explains the data."""
        return self.frame.misfit < nearest_frame.PLAUSIBLE * self.frames.count


Mistake = TypeVar("Mistake")


def log_prior(choices: int) -> float:
    """Return the logarithm of the prior odds of a change with this number of places against the data as given."""
    return float(np.log(nearest_frame.MISTAKEN / choices))


def needs_no_search(frames: ShearFrames, given: NearestFrame) -> bool:
    """Return whether no change can be certain: data cannot be nearer to a frame than on it, by the least tolerance."""
    lost = max(given.stds - frames.tolerant(readings.CLOSER).stds, 0.0)
    return bool(given.misfit + lost < 2 * np.log(quantities.SURE / (1 - quantities.SURE) / nearest_frame.MISTAKEN))


def named(given: float, tried: Sequence[tuple[float, int, Mistake]]) -> list[Mistake]:
    """Return the changes that together are certain, the most probable first; none if the data may stand as given.

    Parameters
    ----------
    given : float
        Logarithm of the evidence of the data as given.
    tried : sequence of (float, int, object)
        Logarithm of the evidence of the changed data, number of places of the change, and the change.
    """
    if not tried:
        return []
    evidence = [given, *(each for each, _, _ in tried)]
    probability = ranking.weigh(evidence, [0.0, *(log_prior(choices) for _, choices, _ in tried)])
    if probability[0] > 1 - quantities.SURE:
        return []
    order = ranking.order(probability[1:])
    needed = int(np.searchsorted(np.cumsum(probability[1:][order]), quantities.SURE * (1 - probability[0]))) + 1
    return [tried[place][-1] for place in order[:needed]]


def mistakes(configuration: Configuration) -> list[FileFinding]:
    """Find the mistake in one test's modes, if there is one."""
    if not configuration.measured.any():
        return []
    reading = MeasuredModes.of(configuration)
    broken, tried = readings.violations(reading), reading.stories <= nearest_frame.TALLEST_FITTED
    if tried:
        given, explaining = of_modes(reading)
        if explaining:
            away = ShearFrames.of(reading).distance(given)
            left = explaining[0].frames.distance(explaining[0].frame)
            evidence = (
                f"{broken[0] if broken else 'no shear frame has these modes'} (the nearest frame is {away:.0f} "
                f"standard deviations away, with the change {left:.0f})"
            )
            words = [in_words(item.key, **item.gaps) for item in explaining]
            return [FileFinding.of_changes(configuration.name, words, evidence, refuses=True)]
    if not broken:
        return []
    change = "no single change mends it: look for more than one mistake" if tried else "look for a mistake"
    others = quantities.counted(len(broken) - 1, "other mode")
    found = broken[0] + (f"; likewise {others}" if len(broken) > 1 else "")
    change += " in mode_shapes and modes, or leave out a mode that is of no shear frame: torsion, a swing on a floor"
    return [FileFinding("signs", configuration.name, found, change, refuses=True)]


def of_modes(reading: MeasuredModes) -> tuple[NearestFrame, list[Change]]:
    """Weigh the changes of a reading; return the frame nearest to it as given, and the changes that are named."""
    N = reading.stories
    frames, even = ShearFrames.of(reading), nearest_frame.even_starts(N)
    given = frames.likeliest(frames.story_starts(even[:1]) or even)
    references = [given.theta]
    if frames.distance(given) ** 2 > frames.count:
        odd = frames.nearest(frames.odd_starts(np.zeros(2 * N)))
        given = ranking.ranked([given, frames.likeliest([*even, odd.theta])], lambda item: item.log_evidence)[0]
        # The fit to wrong data may be far from the frame.
        references = even if given.at is None else [*even, given.theta]
    if needs_no_search(frames, given):
        return given, []
    shapes = [NearestFrame(theta).modes for theta in references]
    changes = [change for kind in KINDS for change in kind(replace(reading, part=readings.FARTHER), shapes)]
    misfits = np.array([[nearest_frame.misfit(change.reading, each) for each in shapes] for change in changes])
    rough = []
    for place in np.unique(np.argsort(misfits, axis=0, kind="stable")[: nearest_frame.SHORTLIST]):
        change = replace(changes[place], reading=replace(changes[place].reading, part=1.0))
        begin = references[np.argmin(misfits[place])]
        rough.append(replace(change, frame=change.frames.nearest([begin])))
    # A change that mends a mistake brings the data near to a frame, and nearer than as given, at the usual tolerance.
    usual = frames.nearest([given.theta]).log_evidence
    nearer = [each for each in rough if each.plausible and each.frame.log_evidence > usual]
    nearer = ranking.ranked(nearer, lambda item: item.frame.log_evidence + log_prior(item.choices))
    best = [
        replace(each, frame=each.frames.likeliest([each.frame.theta])) for each in nearer[: nearest_frame.SHORTLIST]
    ]
    return given, named(given.log_evidence, [(each.frame.log_evidence, each.choices, each) for each in best])


#: A kind of mistake: the changes of a reading that would mend it, some by frames of about the right proportions.
Kind = Callable[[MeasuredModes, Sequence[Modes]], Iterator[Change]]


def _picked(reading: MeasuredModes, which: Any) -> MeasuredModes:
    """Pick entries of the shapes and their standard deviations by an index."""
    return replace(reading, shapes=reading.shapes[which], noise=reading.noise[which])


def _scaled(reading: MeasuredModes, column: int, factor: float) -> MeasuredModes:
    """Multiply the entries of one sensor by a factor."""
    scale = np.where(np.arange(len(reading.floors)) == column, factor, 1.0)
    return replace(reading, shapes=reading.shapes * scale, noise=reading.noise * np.abs(scale))


def sensor_signs(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Change]:
    """Each sensor reversed in every mode."""
    for column, floor in enumerate(reading.floors + 1):
        yield Change("sensor_sign", _scaled(reading, column, -1.0), len(reading.floors), {"floor": floor})


def exchanged_sensors(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Change]:
    """Each pair of sensors exchanged."""
    width = len(reading.floors)
    for low, high in itertools.combinations(range(width), 2):
        names = f"floors {reading.floors[low] + 1} and {reading.floors[high] + 1}"
        there = _picked(reading, np.s_[:, _exchanged(width, low, high)])
        yield Change("swapped_sensors", there, comb(width, 2), {"floors": names})


def floors_from_top(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Change]:
    """List the floors in the opposite order."""
    if len(reading.floors) > 1:
        yield Change("floors_from_top", _picked(reading, np.s_[:, ::-1]), 1, {})


def other_floors(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Change]:
    """All sensors one floor higher or lower, and each of them alone; one on the ground shows no motion."""
    floors, top = reading.floors, reading.stories - 1
    choices = 2 * (len(floors) + 1)
    for by, word in ((1, "low"), (-1, "high")):
        moved = floors + by
        on = (moved >= 0) & (moved <= top)
        still = np.all(np.abs(reading.scaled * reading.weights)[:, moved < 0] < readings.CERTAIN)
        if np.all(moved <= top) and still and on.any():
            listed = ", ".join(str(floor + 1) for floor in moved)
            but = "" if np.all(on) else " (0 is the ground: leave its entries out)"
            there = replace(_picked(reading, np.s_[:, on]), floors=moved[on])
            yield Change("sensor_floors/all", there, choices, {"low": word, "floors": listed, "but": but})
        for column, floor in enumerate(moved.tolist()):
            if 0 <= floor <= top and floor not in floors:
                there = replace(reading, floors=np.where(np.arange(len(floors)) == column, floor, floors))
                gaps = {"low": word, "before": floors[column] + 1, "floor": floor + 1}
                yield Change("sensor_floors/one", there, choices, gaps)


def other_units(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Change]:
    """Each sensor in another unit."""
    width = len(reading.floors)
    for column, factor in itertools.product(range(width if width > 1 else 0), UNITS):
        gaps = {"floor": reading.floors[column] + 1, "factor": factor}
        yield Change("sensor_unit", _scaled(reading, column, factor), width * len(UNITS), gaps)


def periods(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Change]:
    """Take the frequencies for periods, which descend from the first mode to the last."""
    if len(reading.modes) > 1:
        turned = _picked(reading, np.s_[::-1])
        logs, noise = -reading.log_frequencies[::-1], reading.frequency_noise[::-1]
        yield Change("periods", replace(turned, log_frequencies=logs, frequency_noise=noise), 1, {})


def drifts(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Change]:
    """Drifts of the stories added up to displacements of the floors."""
    width = len(reading.floors)
    if width > 1 and np.array_equal(reading.floors, np.arange(width)):
        noise = np.sqrt(np.cumsum(reading.noise**2, axis=1))
        yield Change("drifts", replace(reading, shapes=np.cumsum(reading.shapes, axis=1), noise=noise), 1, {})


def transposed(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Change]:
    """Rows for columns."""
    if len(reading.floors) == len(reading.modes) > 1:
        yield Change("transposed", replace(reading, shapes=reading.shapes.T, noise=reading.noise.T), 1, {})


def other_orders(reading: MeasuredModes, frames: Sequence[Modes]) -> Iterator[Change]:
    """Each exchange of two shapes, and the best order of the shapes for each frame."""
    count = len(reading.modes)
    orders = {tuple(_exchanged(count, i, j)) for i, j in itertools.combinations(range(count), 2)}
    orders |= {tuple(_assigned(reading, frame)) for frame in frames}
    orders.discard(tuple(range(count)))
    for order in sorted(orders):
        places = [place for place in range(count) if order[place] != place]
        rows, others = (", ".join(str(each + 1) for each in some) for some in (places, [order[at] for at in places]))
        choices = comb(count, 2) * 2 ** (len(places) - 2)
        yield Change("mode_order", _picked(reading, list(order)), choices, {"rows": rows, "others": others})


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


def other_numbers(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Change]:
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
            gaps = {"modes": modes, "s": "s" * (len(absent) > 1), "absent": ", ".join(absent)}
            yield Change("missing_mode", there, len(numberings), gaps)
        else:
            pairs = zip(reading.modes + 1, np.array(numbers) + 1, strict=True)
            wrong = ", ".join(f"what is called mode {called} is mode {new}" for called, new in pairs if called != new)
            yield Change("mode_number", there, len(numberings), {"modes": modes, "wrong": wrong})


def _one_changed(numbers: list[int], N: int) -> Iterator[tuple[int, ...]]:
    """Change one of the numbers, so that they still ascend."""
    for place in range(len(numbers)):
        low = numbers[place - 1] + 1 if place else 0
        high = numbers[place + 1] if place + 1 < len(numbers) else N
        for number in range(low, high):
            if number != numbers[place]:
                yield (*numbers[:place], number, *numbers[place + 1 :])


def entry_signs(reading: MeasuredModes, _: Sequence[Modes]) -> Iterator[Change]:
    """Each entry reversed."""
    known = np.argwhere(reading.known)
    for row, column in known:
        shapes: Floats = reading.shapes.copy()
        shapes[row, column] *= -1
        place = {"floor": reading.floors[column] + 1, "mode": reading.modes[row] + 1}
        yield Change("entry_sign", replace(reading, shapes=shapes), len(known), place)


#: Kinds of mistakes, the simplest first: of two that are alike the first is named.
KINDS: tuple[Kind, ...] = (
    transposed, floors_from_top, periods, drifts, other_floors, other_units, sensor_signs, exchanged_sensors,
    other_numbers, other_orders, entry_signs,
)  # fmt: skip


def of_sensors(experiment: Experiment, configuration: Configuration) -> list[FileFinding]:
    """Find the sensor of floors that turn whose place or direction is wrong, if there is one.

    The data with each set of sensors have three misfits: of the readings and rigid floors, of orthogonal modes and a
    mass matrix, and of the story stiffnesses. The scale of each is the noise, or larger where the model errs.
    """
    least = float(np.log(quantities.SURE / (1 - quantities.SURE) / nearest_frame.MISTAKEN))
    try:
        given = _misfits(experiment, configuration)
    except errors.UnsuitableError:
        return []
    if experiment.stories > nearest_frame.TALLEST_FITTED or (given and sum(_excess(*each) for each in given) < least):
        return []
    found = []
    for key, gaps, sensors in (hypotheses := [*_other_sensors(configuration.sensors)]):
        choices = sum(key == other for other, _, _ in hypotheses)
        try:
            misfits = _misfits(experiment, replace(configuration, sensors=sensors))
        except errors.CvxshearError:
            # Such sensors would read one motion twice, or not tell the motions of a floor apart.
            continue
        if misfits:
            found.append((_log_evidence(misfits), choices, in_words(key, **gaps)))
    words = named(_log_evidence(given), found)
    evidence = "the modes of rigid floors would not be orthogonal and read like this"
    return [FileFinding.of_changes(configuration.name, words, evidence, refuses=True)] if words else []


def _other_sensors(sensors: Sequence[Sensor]) -> Iterator[tuple[str, Mapping[str, object], tuple[Sensor, ...]]]:
    """Turn a sensor by right angles, mirror its place or exchange its x and y, or exchange two sensors."""

    def named_as(place: int) -> str:
        (x, y), floor = sensors[place].position, sensors[place].floor
        return f"sensor {place + 1} (floor {floor}, x = {x:g} m, y = {y:g} m, {sensors[place].direction:g} degrees)"

    for place, sensor in enumerate(sensors):
        rows = [sensor.row]
        x, y = sensor.position.tolist()
        others = [("sensor_direction", replace(sensor, direction=sensor.direction + by)) for by in (180.0, 90.0, -90.0)]
        others += [
            ("sensor_position", replace(sensor, position=np.array(at))) for at in ((-x, y), (x, -y), (-x, -y), (y, x))
        ]
        for key, other in others:
            if not any(np.allclose(other.row, row) for row in rows):
                rows.append(other.row)
                (x_there, y_there), direction = other.position, other.direction
                gaps = {"sensor": named_as(place), "direction": direction % 360.0, "x": x_there, "y": y_there}
                yield key, gaps, (*sensors[:place], other, *sensors[place + 1 :])
    for low, high in itertools.combinations(range(len(sensors)), 2):
        order = _exchanged(len(sensors), low, high)
        gaps = {"sensors": f"{named_as(low)} and {named_as(high)}"}
        yield "swapped_sensors/places", gaps, tuple(sensors[place] for place in order)


#: A misfit in standard deviations, its degrees of freedom, and the sum of the logarithms of the weights.
_Misfit = tuple[float, int, float]


def _misfits(experiment: Experiment, configuration: Configuration) -> list[_Misfit]:
    """Fit floors, then masses near even ones, by the program with positive ones if those are not, then stories."""
    if experiment.frame.plan is None:
        # Without a plan nothing says where the reference point is; even floors are those about the sensors' middle.
        middle = np.mean([sensor.position for sensor in configuration.sensors], axis=0)
        moved = tuple(replace(sensor, position=sensor.position - middle) for sensor in configuration.sensors)
        loads = configuration.added_mass_position
        configuration = replace(
            configuration, sensors=moved, added_mass_position=loads - middle if len(loads) else loads
        )
    test = TurningTest.of(experiment, configuration, "check")
    misfit, freedom = 0.0, 0
    for reading, std in zip(configuration.mode_shapes / configuration.entry_std, configuration.entry_std, strict=True):
        rows = test.observation / std[:, None]
        motion, _, rank, _ = np.linalg.lstsq(rows, reading, rcond=None)
        misfit, freedom = misfit + float(np.sum((rows @ motion - reading) ** 2)), freedom + len(reading) - int(rank)
    program, even = test.one_shot_masses(), test.even_masses
    known, _ = program.equalities
    rows, aim = program.weighted
    # Parameters are as large as those of even floors, which decide what the modes leave open.
    size = np.ravel(even[::4, None] * experiment.radius[:, None] ** [0.0, 1.0, 1.0, 2.0])
    free = linalg.null_space(known * size)
    both = np.vstack([rows * size, np.eye(len(even))]) @ free
    change = free @ np.linalg.lstsq(both, np.concatenate([aim - rows @ even, 0.0 * even]), rcond=None)[0]
    masses = even + size * change
    if linalg.eigvalsh(THREE_MOTIONS.masses(masses + test.added))[0] <= 0:
        masses = backends.get("auto").solve(program).x
    of_masses = float(np.sum((rows @ masses - aim) ** 2)), len(aim) - free.shape[1]
    program, weights = test.story_stiffnesses(masses), test.stiffness_rows(masses).weights
    rows, aim = program.weighted
    stiffnesses, _, rank, _ = np.linalg.lstsq(rows, aim, rcond=None)
    of_stories = float(np.sum((rows @ stiffnesses - aim) ** 2)), len(aim) - int(rank)
    return [
        (misfit, freedom, 0.0),
        (*of_masses, float(np.sum(np.log(test.mass_rows().weights)))),
        (*of_stories, float(np.sum(np.log(weights)))),
    ]


def _excess(misfit: float, freedom: int, _: float) -> float:
    """Logarithm of the likelihood that a larger scale of the noise, the most likely one, gains."""
    return 0.5 * freedom * float(np.log(max(misfit / freedom, 1.0))) if freedom > 0 else 0.0


def _log_evidence(misfits: Sequence[_Misfit]) -> float:
    """Add the likelihoods at the most likely scales; -inf without masses."""
    if not misfits:
        return -np.inf
    return sum(
        weights - _excess(misfit, freedom, 0.0) - 0.5 * min(misfit, max(freedom, 0))
        for misfit, freedom, weights in misfits
    )
