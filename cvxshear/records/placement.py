"""Reversed and exchanged channels, and channels in another unit, as hypotheses weighed by the modes.

The modes of a shear frame on the ground are a Markov system (its flexibility matrix is oscillatory: Gantmacher and
Krein 1950, "Oscillation matrices and kernels"), and stay one at any choice of floors: the first mode has one sign and
grows with height, the second over the first falls with height. The first does not hold for a reversed channel; neither
holds for two exchanged ones; a factor on a channel spoils the first alone. Against each stands that the lowest mode was
not found, or the second: what is then called the first has another shape, and another ratio of frequencies to the next.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cvxshear.records import prepare
from cvxshear.records.clocks import FAULTY
from cvxshear.records.record import Channel, Finding, finding
from cvxshear.util import quantities, ranking
from cvxshear.util.typing import Floats, Ints

#: Probability beforehand that a channel is in another unit than declared.
OTHER_UNIT = 0.005
#: Standard deviation of the logarithm of a story's flexibility about the median story's: a factor of two either way.
SPREAD_OF_STIFFNESS = 0.7
#: Deviation of an entry, relative to the mode's largest, by noise, a sensor that is askew and effects outside the shear
#: frame.
SHAPE_ERROR = 0.03
#: Ratio of the frequencies of two modes of a shear frame, and the standard deviation of its logarithm: uniform frames
#: of 4 to 12 stories have 2.9 to 3.0, 4.4 to 4.9 and 1.5 to 1.65, those with a soft or a stiff story spread about it.
FREQUENCY_RATIOS = {(1, 2): (2.85, 0.2), (1, 3): (4.6, 0.25), (2, 3): (1.62, 0.15)}
#: Largest loss of log likelihood for one rule broken: no rule is as certain as its Gaussian says far out.
WORST = 10.0


@dataclasses.dataclass(frozen=True)
class ChannelMistake:
    """A possible mistake in the channels.

    Parameters
    ----------
    kind : str
        "sign", "swapped channels" or "unit".
    places : tuple of int
        Of the channels, in their order.
    factor : float
        By which a channel is multiplied that is reversed or in another unit.
    prior : float
        Its probability before the modes are seen.
    """

    kind: str
    places: tuple[int, ...]
    factor: float
    prior: float

    @property
    def order(self) -> tuple[int, ...]:
        """The channels that belong in the places."""
        return self.places[::-1] if self.kind == "swapped channels" else self.places

    def undone(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return shapes or responses as they are without the mistake, one column a channel."""
        result = values.copy()
        result[:, list(self.places)] = self.factor * values[:, list(self.order)]
        return result

    def mended(self, record: prepare.AnyRecord) -> prepare.AnyRecord:
        """Return the record as it is without the mistake."""
        channels = list(record.channels)
        for place, other in zip(self.places, self.order, strict=True):
            channels[place] = dataclasses.replace(record.channels[other], floor=record.channels[place].floor)
        return prepare.with_responses(record, [self.undone(run.responses) for run in record.runs], tuple(channels))


@dataclasses.dataclass(frozen=True)
class ChannelHypothesis:
    """The mistakes that may be in a record together; none where the channels are as declared.

    Parameters
    ----------
    mistakes : tuple of ChannelMistake
        Of different channels.
    probability : float
        After the modes have been seen.
    missed : bool
        Whether a mode below those found was probably missed, given the mistakes.
    """

    mistakes: tuple[ChannelMistake, ...]
    probability: float
    missed: bool = False


def possible_mistakes(count: int) -> list[tuple[ChannelMistake, ...]]:
    """List what may be wrong with some channels: nothing, one mistake, or one on each of two channels."""
    pairs, gravity = list(itertools.combinations(range(count), 2)), quantities.STANDARD_GRAVITY
    swaps = [ChannelMistake("swapped channels", pair, 1.0, FAULTY / (count - 1)) for pair in pairs]
    of_one = [
        # Of two channels, one reversed is the same as the other.
        *(ChannelMistake("sign", (i,), -1.0, FAULTY) for i in range(count if count > 2 else 1)),
        *(ChannelMistake("unit", (i,), g, OTHER_UNIT) for i in range(count) for g in (gravity, 1.0 / gravity)),
    ]
    of_two = [(one, other) for one, other in itertools.combinations(of_one, 2) if one.places != other.places]
    return [(), *((item,) for item in (*of_one, *swaps)), *of_two]


def weighed(frequencies: Floats, shapes: Floats, floors: Ints, stories: int) -> list[ChannelHypothesis]:
    """Weigh the hypotheses against each other, and sort them by probability, the most probable first.

    Parameters
    ----------
    frequencies : ndarray, shape (m,)
        Hz, ascending, of the modes found; two at least.
    shapes : ndarray, shape (m, n)
        As recorded.
    floors : ndarray of int, shape (n,)
    stories : int
    """
    all_mistakes, scores = possible_mistakes(len(floors)), []
    of_numbers = np.log([1.0 if numbers == (1, 2) else FAULTY for numbers in FREQUENCY_RATIOS])
    for mistakes in all_mistakes:
        right = shapes
        for item in mistakes:
            right = item.undone(right)
        likely = [_likelihood(frequencies, right, floors, stories, numbers) for numbers in FREQUENCY_RATIOS]
        scores.append(likely + of_numbers + np.sum(np.log([item.prior for item in mistakes])))
    chances = ranking.weigh(np.ravel(scores)).reshape(len(scores), -1)
    found = [
        ChannelHypothesis(mistakes, float(row.sum()), bool(row[0] < row[1:].sum()))
        for mistakes, row in zip(all_mistakes, chances, strict=True)
    ]
    return ranking.ranked(found, lambda item: item.probability)


def _likelihood(frequencies: Floats, shapes: Floats, floors: Ints, stories: int, numbers: tuple[int, int]) -> float:
    """Log likelihood of the two lowest modes found, where these are their numbers."""
    ratio, spread = FREQUENCY_RATIOS[numbers]
    off = (np.log(frequencies[1] / frequencies[0]) - np.log(ratio)) / spread
    result = -min(0.5 * off**2, WORST)
    low, high = (shape / np.abs(shape).max() for shape in shapes[:2])
    if numbers[0] == 1:
        result -= _unlike_a_first_mode(low * np.sign(low[ranking.first_largest(np.abs(low))]), floors, stories)
    else:
        # Its node lies in the upper half: sensors below and at the top are on both sides of it.
        result -= _miscounted(low, 2, whole=floors[0] <= stories / 2 and floors[-1] == stories)
    result -= _rises(low, high) if numbers == (1, 2) else _miscounted(high, 3, whole=len(floors) == stories)
    return float(result)


def _miscounted(shape: Floats, mode: int, *, whole: bool) -> float:
    """How far a shape has more changes of sign than its mode can have, or fewer where the sensors show them all."""
    sure = shape[np.abs(shape) > SHAPE_ERROR]
    more = int(np.sum(np.sign(sure[1:]) != np.sign(sure[:-1]))) - (mode - 1)
    return WORST * (abs(more) if whole else max(0, more))


def _unlike_a_first_mode(shape: Floats, floors: Ints, stories: int) -> float:
    """How far stories, by the drifts of a first mode under its own inertia, differ in flexibility."""
    levels = np.arange(stories + 1)
    everywhere = np.interp(levels, np.concatenate([[0], floors]), np.concatenate([[0.0], shape]))
    shear = np.cumsum(everywhere[::-1])[::-1]
    bounds = np.concatenate([[0], floors])
    drifts = np.diff(np.concatenate([[0.0], shape]))
    forces = np.array([shear[low + 1 : high + 1].sum() for low, high in itertools.pairwise(bounds)])
    if np.any(forces <= 0):
        return 2.0 * WORST
    flexible = drifts / forces
    typical = np.median(flexible)
    if typical <= 0:
        return 2.0 * WORST
    with np.errstate(invalid="ignore", divide="ignore"):
        logarithmic = 0.5 * (np.log(np.maximum(flexible / typical, 1e-6)) / SPREAD_OF_STIFFNESS) ** 2
    additive = 0.5 * ((drifts - typical * forces) / (np.sqrt(2.0) * SHAPE_ERROR)) ** 2
    return float(np.minimum(np.minimum(logarithmic, additive), WORST).sum())


def _rises(low: Floats, high: Floats) -> float:
    """How far the second mode over the first rises with height anywhere, where it should fall."""
    steady = np.abs(low) > SHAPE_ERROR
    low, high = low[steady], high[steady]
    if len(low) < 2:
        return 0.0
    ratio = high / low
    if ratio[0] < ratio[-1]:
        ratio = -ratio
    error = SHAPE_ERROR * np.hypot(1.0 / np.abs(low), high / low**2)
    worst = 0.0
    for i, j in itertools.combinations(range(len(ratio)), 2):
        rise = max(0.0, float(ratio[j] - ratio[i])) / np.hypot(error[i], error[j])
        worst = max(worst, 0.5 * rise**2)
    return min(worst, 2.0 * WORST)


def findings_of(hypotheses: Sequence[ChannelHypothesis], channels: Sequence[Channel], first: Floats) -> list[Finding]:
    """Report what the hypotheses say of the channels: nothing, what is sure, or several things that may be.

    Parameters
    ----------
    hypotheses : sequence of ChannelHypothesis
        The most probable first.
    channels : sequence of Channel
    first : ndarray, shape (n,)
        The lowest mode found, as recorded.
    """
    best, sound = hypotheses[0], next(item for item in hypotheses if not item.mistakes)
    if best is sound:
        return []
    if best.probability >= quantities.SURE:
        return [_said(item, best, sound, channels, first) for item in best.mistakes]
    rivals = [item for item in hypotheses if item.mistakes and item.probability > best.probability / 3]
    options = [
        f"{quantities.listed([_in_words(each, channels) for each in item.mistakes])} "
        f"({quantities.chance(item.probability)})"
        for item in rivals
    ]
    otherwise = "a mode was missed and " if sound.missed else ""
    options.append(f"{otherwise}the channels are as declared ({quantities.chance(sound.probability)})")
    rest = max(1.0 - sound.probability - sum(item.probability for item in rivals), 0.0)
    options.append(f"something else is wrong ({quantities.chance(rest)})")
    said = (
        f"by the lowest modes {quantities.listed(options, 'or')}; look at the cables and units. The record is taken as "
        f"declared: nothing reaches {100 * quantities.SURE:.0f} %"
    )
    names = list(dict.fromkeys(name for item in rivals for each in item.mistakes for name in _named(each, channels)))
    numbers = {"channels": names, "probabilities": [item.probability for item in rivals], "corrected": False}
    return [Finding(best.mistakes[0].kind, said, numbers)]


def _named(item: ChannelMistake, channels: Sequence[Channel]) -> list[str]:
    """List the names of the channels that a mistake is about; of two channels either may be the reversed one."""
    reversed_of_two = item.kind == "sign" and len(channels) == 2
    return [channel.name for channel in (channels if reversed_of_two else [channels[place] for place in item.places])]


def _in_words(item: ChannelMistake, channels: Sequence[Channel]) -> str:
    if item.kind == "unit":
        return f"{channels[item.places[0]]} {_other_unit(channels[item.places[0]], item.factor)[1]}"
    if item.kind == "swapped channels":
        return f"{quantities.listed([str(channels[place]) for place in item.places])} are in each other's place"
    of_two = len(channels) == 2
    return f"{quantities.listed(list(map(str, channels)), 'or') if of_two else channels[item.places[0]]} is reversed"


def _said(
    item: ChannelMistake, best: ChannelHypothesis, sound: ChannelHypothesis, channels: Sequence[Channel], first: Floats
) -> Finding:
    """Report a mistake that is sure."""
    shape = "(" + ", ".join(f"{entry:.3f}" for entry in first / first[ranking.first_largest(np.abs(first))]) + ")"
    odds = f"odds {min(best.probability / max(sound.probability, 1e-9), 1e9):.2g} to 1 against a mode that was missed"
    names = _named(item, channels)
    numbers = {"channels": names, "probability": best.probability, "first_mode": first.tolist(), "corrected": True}
    if len(names) == 1:
        numbers["channel"] = names[0]
    if item.kind == "sign":
        signs = "its sign" if len(names) == 1 else "their signs"
        return finding("sign", numbers, what=_in_words(item, channels), shape=shape, odds=odds, signs=signs)
    places = [channels[place] for place in item.places]
    if item.kind == "unit":
        unit, looks = _other_unit(places[0], item.factor)
        numbers |= {"floor": places[0].floor, "unit": unit, "factor": item.factor}
        remedy = "" if unit is None else f'. Write unit = "{unit}" in the record file'
        return finding("unit", numbers, looks=looks, where=places[0], shape=shape, odds=odds, remedy=remedy)
    still = [channels[place] for place in item.places if abs(first[place]) < SHAPE_ERROR * np.abs(first).max()]
    dead = "".join(f", unless {channel} carries no motion at all: is its cable cut?" for channel in still)
    return finding("swapped channels", numbers, low=places[0], high=places[1], shape=shape, odds=odds, dead=dead)


def _unit_of(size: float) -> str | None:
    """Name the unit of acceleration of this size in m/s2; None without one."""
    units = quantities.IN_SI["acceleration"].items()
    return next((name for name, each in units if np.isclose(size, each)), None)


def _other_unit(channel: Channel, factor: float) -> tuple[str | None, str]:
    """Name the unit of a channel whose values need a factor, None if unknown, and say what the channel looks like."""
    unit = _unit_of(quantities.IN_SI["acceleration"].get(channel.unit or "m/s2", 1.0) * factor)
    if channel.unit is not None:
        return unit, f"is declared in {channel.unit} and looks like {unit or f'{factor:.3g} times that'}"
    if unit is not None:
        return unit, f"looks like {unit}, the others like m/s2"
    return unit, f"looks like m/s2, the others like {_unit_of(1.0 / factor) or f'{1.0 / factor:.3g} times that'}"
