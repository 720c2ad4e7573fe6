"""Simulate measurements of finite-element frames, with noise, in the form of a measurement file."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tests.fe.elements import Floats
from tests.fe.frame import Building, SwayModes, assemble, sway_modes

FREQUENCY_STD = 0.001
MODE_SHAPE_STD = 0.01
GRAVITY = 9.81
HEIGHT = 0.39
"""Height of every story, m. It is typical for a laboratory frame, like the masses and stiffnesses drawn below."""

AT_FLOOR = ("ground_spring", "added_mass", "sensor_gain", "joint_release")
AT_TWO_FLOORS = ("spring",)
AT_STORY = ("story_change",)
Put = tuple[str, float | None, dict[str, int | None]]
"""Name, size and place of an effect."""

IN_ONE_CONFIGURATION = ("added_mass", "story_change", "state_stiffness", "state_mass", "joint_release")


def simulated(
    effect: str | Sequence[str] | None,
    *,
    stories: int,
    configurations: int,
    rng: np.random.Generator,
    size: float | None = None,
    floor: int | None = None,
    story: int | None = None,
    configuration: int | None = None,
    added_mass: Sequence[Sequence[float]] | None = None,
    noise: float = 1.0,
    measured_floors: Sequence[int] | None = None,
    modes: int | None = None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the tests of a frame with effects that the shear model lacks, and the truth.

    The generator draws floor masses, story stiffnesses, the effects' places if not given, and the noise, in this order.
    Places count from 1; `practical_size` is the default size. By default configuration 1 carries nothing and each other
    one 6 kg on one floor, from the top down. `noise` is a factor on the declared standard deviations, `modes` a number
    from the lowest. The truth's frequencies and shapes have all modes at all floors, without noise but with the
    sensors' gains. For one effect or none, it also has the effect's name, place and size.
    """
    frame = _drawn(stories, rng)
    added = _default_added(stories, configurations) if added_mass is None else np.asarray(added_mass, dtype=float)
    single = effect is None or isinstance(effect, str)
    names = [effect] if single else list(effect)
    there = []
    for name in names:
        place = _placed(name, stories, configurations, rng, floor=floor, story=story, configuration=configuration)
        if name is not None:
            there.append((name, practical_size(name, frame) if size is None else size, place))
    seen = _all_tested(frame, added, there)
    experiment = {
        "frame": _declared(frame, frame.floor_mass.sum()),
        "configuration": [
            measured(each, rng, name=_name(number), added=extra, noise=noise, floors=measured_floors, modes=modes)
            for number, (each, extra) in enumerate(zip(seen, added, strict=True), 1)
        ],
    }
    truth = {
        "effects": [_put(name, where) for name, _, where in there],
        "floor_mass": frame.floor_mass,
        "story_stiffness": frame.story_stiffness,
        "frequencies": [each.frequencies for each in seen],
        "mode_shapes": [each.shapes.T for each in seen],
    }
    if single:
        truth |= {**place, "effect": effect, "size": there[0][1] if there else None}
        truth["configuration"] = None if place["configuration"] is None else _name(place["configuration"])
    return experiment, truth


def simulated_as_drawn(
    there: Sequence[Put],
    *,
    floor_mass: Floats,
    story_stiffness: Floats,
    added_mass: Floats,
    rng: np.random.Generator,
    noise: tuple[float, float] = (FREQUENCY_STD, MODE_SHAPE_STD),
    noise_declared: bool = True,
    total_mass_error: float = 0.0,
    measured_floors: Sequence[int] | None = None,
    modes: int | None = None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the tests and the truth like `simulated`, for given masses, stiffnesses, effects and noise.

    An effect is its name, size and place. `noise` has the deviations of frequencies and of shapes. The masses' sum is
    the declared total times one plus `total_mass_error`. An unstable frame is a ValueError.
    """
    frame = Building(np.full(len(floor_mass), HEIGHT), story_stiffness, floor_mass)
    experiment: dict[str, Any] = {
        "frame": _declared(frame, floor_mass.sum() / (1.0 + total_mass_error)),
        "configuration": [],
    }
    for number, (seen, added) in enumerate(zip(_all_tested(frame, added_mass, there), added_mass, strict=True), 1):
        exact = measured(seen, rng, name=_name(number), added=added, noise=0.0, floors=measured_floors, modes=modes)
        shapes = np.array(exact["mode_shapes"])
        exact["frequencies"] = [f * float(np.exp(noise[0] * rng.standard_normal())) for f in exact["frequencies"]]
        exact["mode_shapes"] = (shapes + noise[1] * rng.standard_normal(shapes.shape)).tolist()
        exact |= {"frequency_std": noise[0], "mode_shape_std": noise[1]}
        if not noise_declared:
            del exact["frequency_std"], exact["mode_shape_std"]
        experiment["configuration"].append(exact)
    places = [_put(name, where) for name, _, where in there]
    truth = {
        "effects": places,
        "sizes": {put: size for put, (_, size, _) in zip(places, there, strict=True)},
        "floor_mass": floor_mass,
        "story_stiffness": story_stiffness,
    }
    if total_mass_error:
        truth["effects"].append(put := ("total_mass", None, None, None, None))
        truth["sizes"][put] = total_mass_error
    return experiment, truth


def placed_at_random(effect: str, stories: int, configurations: int, rng: np.random.Generator) -> dict[str, int | None]:
    """Draw a possible place of an effect."""
    return _placed(effect, stories, configurations, rng, floor=None, story=None, configuration=None)


def simulated_attachment(
    *, stories: int, configurations: int, rng: np.random.Generator, floor: int, part: float, tuning: float
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the tests of a frame that carries a mass on a spring, without that mass's own mode, and the truth.

    `part` is the mass relative to all floors; `tuning` is its frequency on a fixed floor relative to the frame's first.
    """
    frame = _drawn(stories, rng)
    mass, frequency = part * frame.floor_mass.sum(), tuning * sway_modes(frame).frequencies[0]
    tests = []
    for number, extra in enumerate(_default_added(stories, configurations), 1):
        attached = (floor, mass, mass * (2 * np.pi * frequency) ** 2)
        model = assemble(dataclasses.replace(frame, floor_mass=frame.floor_mass + extra, attached=(attached,)))
        eigenvalues, shapes = model.modes()
        seen = np.arange(stories + 1) != np.argmax(shapes[model.coordinates["attached", 0]] ** 2)
        floors = shapes[[model.coordinates["sway", level] for level in range(1, stories + 1)]]
        modes = SwayModes(np.sqrt(eigenvalues[seen]) / (2 * np.pi), floors[:, seen])
        tests.append(measured(modes, rng, name=_name(number), added=extra))
    truth = {"mass": mass, "frequency": frequency, "floor_mass": frame.floor_mass}
    declared = {"frame": _declared(frame, frame.floor_mass.sum()), "configuration": tests}
    return declared, {**truth, "story_stiffness": frame.story_stiffness}


def _declared(frame: Building, total_mass: float) -> dict[str, Any]:
    """Return the table of the frame in a measurement file."""
    heights = [HEIGHT] * frame.stories
    return {"stories": frame.stories, "gravity": GRAVITY, "story_heights": heights, "total_mass": float(total_mass)}


def _drawn(stories: int, rng: np.random.Generator) -> Building:
    """Draw a laboratory frame: masses first, then stiffnesses that decrease with height."""
    floor_mass = rng.uniform(9.0, 13.0, stories)
    return Building(np.full(stories, HEIGHT), np.sort(rng.uniform(20e3, 28e3, stories))[::-1], floor_mass)


def _all_tested(frame: Building, added: Floats, there: Sequence[Put]) -> list[SwayModes]:
    """Return the sensors' modes of each configuration, with the effects that act in it."""
    return [
        seen_by_sensors(frame, extra, [item for item in there if item[2]["configuration"] in (None, number)])
        for number, extra in enumerate(added, 1)
    ]


def _put(name: str, where: dict[str, int | None]) -> tuple[str, int | None, int | None, int | None, str | None]:
    """Return an effect and its place, with the configuration by name."""
    number = where["configuration"]
    return name, where["floor"], where["to"], where["story"], None if number is None else _name(number)


def measured(
    seen: SwayModes,
    rng: np.random.Generator,
    *,
    name: str,
    added: Floats,
    noise: float = 1.0,
    floors: Sequence[int] | None = None,
    modes: int | None = None,
) -> dict[str, Any]:
    """Return a test as in a report: noise 0.1 % of frequencies, 1 % of each mode's largest entry."""
    count = len(seen.frequencies)
    floors = list(range(1, count + 1)) if floors is None else list(floors)
    modes = count if modes is None else modes
    frequencies = seen.frequencies[:modes]
    shapes = seen.shapes[np.array(floors) - 1, :modes].T
    shapes = shapes / np.max(np.abs(shapes), axis=1, keepdims=True)
    return {
        "name": name,
        "added_mass": added.tolist(),
        "measured_floors": floors,
        "frequencies": (frequencies * np.exp(noise * FREQUENCY_STD * rng.standard_normal(modes))).tolist(),
        "mode_shapes": (shapes + noise * MODE_SHAPE_STD * rng.standard_normal(shapes.shape)).tolist(),
        "frequency_std": FREQUENCY_STD,
        "mode_shape_std": MODE_SHAPE_STD,
        "mode_shape_noise": "additive",
    }


def practical_size(effect: str, frame: Building) -> float:
    """Return a practical size of the effect, in the catalogue's unit, for this frame.

    An effect that makes the frame more flexible adds a tenth to the sway of its top under a force there (turning
    joints: eta = 0.1). A spring, a mass, a gain or a change of stiffness is a tenth of the changed quantity.
    """
    top = float(frame.heights.sum())
    sway = 0.1 * float(np.sum(1.0 / frame.story_stiffness))
    sizes = dict.fromkeys(("joint_rotation", "sensor_gain", "state_mass", "wall"), 0.1)
    sizes |= dict.fromkeys(("story_change", "state_stiffness", "load_scale"), -0.1)
    sizes |= dict.fromkeys(("joint_release", "soft_feet"), 0.5) | {"gravity": 1.2, "bracing": 0.4}
    sizes |= dict.fromkeys(("ground_spring", "spring"), 0.1 * float(np.mean(frame.story_stiffness)))
    sizes |= dict.fromkeys(("added_mass", "mass_coupling"), 0.1 * float(np.mean(frame.floor_mass)))
    sizes |= {"axial_columns": 3 * sway / top**3, "base_rocking": sway / top**2}
    return sizes[effect]


def with_gravity(frame: Building, gamma: float, at: int | None = None) -> Building:
    """Set the share of the weight on the frame's own columns for the factor gamma: none 1, all 6/5."""
    return dataclasses.replace(frame, gravity=GRAVITY, on_frame=(gamma - 1.0) / 0.2)


def with_turning_joints(frame: Building, eta: float, at: int | None = None) -> Building:
    """Add beams of one bay that resist a turn of both their joints with mean(k h^2) / eta in all.

    By the slope-deflection equations, each end of a beam of span L takes 6 EI / L if both ends turn alike.
    """
    resistance = float(np.mean(frame.story_stiffness * frame.heights**2)) / eta
    return dataclasses.replace(frame, beam_bending=np.full(frame.stories, resistance * bay(frame) / 12))


def with_long_columns(frame: Building, inverse_EI: float, at: int | None = None) -> Building:
    """Add two columns, a bay apart, that stretch and shorten; the whole frame bends with 1 / inverse_EI.

    The floors stay rigid and tilt. Each story is then a beam. Its bending stiffness is the sum of the columns' axial
    part, EA b^2 / 2, and their own two EI; its sway stiffness at equal tilts comes from the columns alone. EA is chosen
    so that EI is the same in every story.
    """
    columns = frame.story_stiffness * frame.heights**3 / 12
    axial = 2.0 * (1.0 / inverse_EI - columns) / bay(frame) ** 2
    return dataclasses.replace(frame, column_axial=axial)


def with_rocking_base(frame: Building, inverse_k_theta: float, at: int | None = None) -> Building:
    return dataclasses.replace(frame, rocking_stiffness=1.0 / inverse_k_theta)


def with_ground_spring(frame: Building, spring: float, at: int) -> Building:
    return dataclasses.replace(frame, ground_springs={**frame.ground_springs, at: spring})


def with_mass(frame: Building, mass: float, at: int) -> Building:
    return dataclasses.replace(frame, floor_mass=frame.floor_mass + mass * (np.arange(1, frame.stories + 1) == at))


def with_heavy_columns(frame: Building, mu: float, at: int | None = None) -> Building:
    return dataclasses.replace(frame, column_mass=mu)


def with_story_change(frame: Building, change: float, at: int) -> Building:
    changed = frame.story_stiffness * (1.0 + change * (np.arange(1, frame.stories + 1) == at))
    return dataclasses.replace(frame, story_stiffness=changed)


def with_softer_state(frame: Building, e: float, at: int | None = None) -> Building:
    beams = None if frame.beam_bending is None else frame.beam_bending * (1.0 + e)
    return dataclasses.replace(
        frame,
        story_stiffness=frame.story_stiffness * (1.0 + e),
        beam_bending=beams,
        wall_bending=frame.wall_bending * (1.0 + e),
    )


def with_tie(frame: Building, spring: float, floors: tuple[int, int]) -> Building:
    """Add a diagonal between columns whose horizontal stiffness EA cos^2 / L equals the spring's."""
    low, high = floors
    run, rise = bay(frame), float(frame.heights[low:high].sum())
    length = float(np.hypot(run, rise))
    return dataclasses.replace(frame, ties=(*frame.ties, (low, high, spring * length**3 / run**2)))


def with_braces(frame: Building, beta: float, at: int | None = None) -> Building:
    """Add two crossing diagonals per story, EA cos^2 / L each, which carry a part beta of its stiffness."""
    run = bay(frame)
    length = np.hypot(run, frame.heights)
    return dataclasses.replace(
        frame,
        story_stiffness=(1.0 - beta) * frame.story_stiffness,
        brace_axial=0.5 * beta * frame.story_stiffness * length**3 / run**2,
    )


def with_loose_joints(frame: Building, rho: float, at: int) -> Building:
    """Add springs of mean(k h^2) / rho in all between a floor and its columns, or under their feet."""
    each = float(np.mean(frame.story_stiffness * frame.heights**2)) / rho / len(frame.column_x)
    if at == 0:
        return dataclasses.replace(frame, column_base=each)
    return dataclasses.replace(frame, connections={**frame.connections, at: each})


def with_soft_feet(frame: Building, rho: float, _at: int | None) -> Building:
    """Add springs of mean(k h^2) / rho in all under the feet."""
    return with_loose_joints(frame, rho, 0)


def with_wall(frame: Building, w: float, at: int | None = None) -> Building:
    """Add a wall with EI = w H^2 mean(k h), up to the roof or to a floor."""
    k, h = frame.story_stiffness[:at], frame.heights[:at]
    return dataclasses.replace(frame, wall_bending=w * float(h.sum()) ** 2 * float(np.mean(k * h)), wall_top=at)


CHANGES: dict[str, Callable[..., Building]] = {
    "gravity": with_gravity,
    "joint_rotation": with_turning_joints,
    "axial_columns": with_long_columns,
    "base_rocking": with_rocking_base,
    "ground_spring": with_ground_spring,
    "added_mass": with_mass,
    "floor_mass": with_mass,
    "mass_coupling": with_heavy_columns,
    "story_change": with_story_change,
    "state_stiffness": with_softer_state,
    "joint_release": with_loose_joints,
    "soft_feet": with_soft_feet,
    "bracing": with_braces,
    "wall": with_wall,
}
"""Function of each effect that changes the frame. A sensor's gain changes the reading, not the frame."""

OF_MASSES = ("state_mass", "load_scale")
"""Effects on the frame's own masses, or on the added ones alone."""


def seen_by_sensors(frame: Building, added: Floats, there: Sequence[Put]) -> SwayModes:
    """Return the modes of one configuration with these effects, in this order, as the sensors measure them."""
    gain = np.ones(frame.stories)
    sizes = {name: size for name, size, _ in there}
    own = frame.floor_mass * (1.0 + sizes.get("state_mass", 0.0))
    frame = dataclasses.replace(frame, floor_mass=own + added * (1.0 + sizes.get("load_scale", 0.0)))
    for name, size, place in there:
        at = place["story"] if place["floor"] is None else place["floor"]
        if name == "sensor_gain":
            gain = gain * (1.0 + size * (np.arange(1, frame.stories + 1) == at))
        elif name == "spring":
            frame = with_tie(frame, size, (at, place["to"]))
        elif name not in OF_MASSES:
            frame = CHANGES[name](frame, size, at)
    modes = sway_modes(frame)
    return SwayModes(modes.frequencies, gain[:, None] * modes.shapes)


def _placed(
    effect: str | None,
    stories: int,
    configurations: int,
    rng: np.random.Generator,
    *,
    floor: int | None,
    story: int | None,
    configuration: int | None,
) -> dict[str, int | None]:
    """Return the place of the effect: the given place, or a random possible one."""
    lowest = 2 if effect == "ground_spring" else 0 if effect == "joint_release" else 1
    if lowest > stories:
        raise ValueError("a ground spring needs two stories")
    place: dict[str, int | None] = {"floor": None, "to": None, "story": None, "configuration": None}
    if effect in AT_TWO_FLOORS:
        place["floor"] = int(rng.integers(1, stories - 1)) if floor is None else floor
        place["to"] = int(rng.integers(place["floor"] + 2, stories + 1))
    if effect in AT_FLOOR:
        place["floor"] = int(rng.integers(lowest, stories + 1)) if floor is None else floor
    if effect in AT_STORY:
        place["story"] = int(rng.integers(1, stories + 1)) if story is None else story
    if effect in IN_ONE_CONFIGURATION:
        place["configuration"] = int(rng.integers(1, configurations + 1)) if configuration is None else configuration
    return place


def _default_added(stories: int, configurations: int) -> Floats:
    added = np.zeros((configurations, stories))
    for number in range(1, configurations):
        added[number, (stories - number) % stories] = 6.0
    return added


def _name(number: int) -> str:
    return f"test {number}"


def bay(frame: Building) -> float:
    """Return the distance between the two columns, m."""
    left, right = frame.column_x
    return right - left
