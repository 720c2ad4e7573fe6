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
from dataclasses import dataclass

import numpy as np

from cvxshear.records.clocks import FAULTY
from cvxshear.records.examination import OTHER_UNIT, in_unit, unit_in_truth
from cvxshear.records.record import Channel, Finding, finding
from cvxshear.util import odds, quantities, ranking
from cvxshear.util.typing import Floats, Ints

SPREAD_OF_STIFFNESS = 0.7
"""Standard deviation of the logarithm of a story's flexibility about the median story's: a factor of two either way."""
SHAPE_ERROR = 0.03
"""Deviation of an entry, relative to the mode's largest, by noise, a sensor that is askew and effects outside the shear
frame."""
FREQUENCY_RATIOS = {(1, 2): (2.85, 0.2), (1, 3): (4.6, 0.25), (2, 3): (1.62, 0.15)}
"""Ratio of the frequencies of two modes of a shear frame, and the standard deviation of its logarithm: uniform frames
of 4 to 12 stories have 2.9 to 3.0, 4.4 to 4.9 and 1.5 to 1.65, those with a soft or a stiff story spread about it."""
WORST = 10.0
"""Largest loss of log likelihood for one rule broken: no rule is as certain as its Gaussian says far out."""
DOUBTFUL = 0.3
"""Least probability of a hypothesis that is reported beside the declared channels."""


@dataclass(frozen=True)
class ChannelMistake:
    """A possible mistake in the channels.

    Parameters
    ----------
    kind : str
        "sound", "sign", "swapped channels" or "unit".
    places : tuple of int
        Of the channels, in their order.
    factor : float
        By which a channel in another unit is multiplied.
    probability : float
        After the modes have been seen.
    missed : float
        Probability of a missed mode, given the hypothesis.
    """

    kind: str
    places: tuple[int, ...] = ()
    factor: float = 1.0
    probability: float = 0.0
    missed: float = 0.0

    def undone(self, shapes: Floats) -> Floats:
        """Return the shapes as they are where the hypothesis is true, shape (m, n)."""
        result = np.array(shapes, dtype=np.float64)
        if self.kind == "swapped channels":
            result[:, list(self.places)] = result[:, list(self.places[::-1])]
        elif self.kind == "sign":
            result[:, list(self.places)] *= -1.0
        elif self.kind == "unit":
            result[:, list(self.places)] *= self.factor
        return result


def weighed(frequencies: Floats, shapes: Floats, floors: Ints, stories: int) -> list[ChannelMistake]:
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
    count = len(floors)
    pairs = list(itertools.combinations(range(count), 2))
    # All channels but some reversed is the same as those reversed.
    prior = [(ChannelMistake("sound"), 1.0)]
    prior += [(ChannelMistake("sign", (i,)), FAULTY) for i in range(count if count > 2 else 1)]
    prior += [(ChannelMistake("sign", pair), FAULTY**2) for pair in (pairs if count > 4 else ())]
    prior += [(ChannelMistake("swapped channels", pair), FAULTY / (count - 1)) for pair in pairs]
    prior += [
        (ChannelMistake("unit", (i,), factor), OTHER_UNIT)
        for i in range(count)
        for factor in (quantities.STANDARD_GRAVITY, 1.0 / quantities.STANDARD_GRAVITY)
    ]
    likely = [
        [_likelihood(frequencies, item.undone(shapes), floors, stories, numbers) for numbers in FREQUENCY_RATIOS]
        for item, _ in prior
    ]
    of_numbers = np.log([1.0 if numbers == (1, 2) else FAULTY for numbers in FREQUENCY_RATIOS])
    log_priors = np.log([[before] for _, before in prior]) + of_numbers
    probabilities = odds.weigh(np.ravel(likely), log_priors.ravel()).reshape(log_priors.shape)
    found = [
        dataclasses.replace(item, probability=float(row.sum()), missed=float(row[1:].sum() / max(row.sum(), 1e-300)))
        for (item, _), row in zip(prior, probabilities, strict=True)
    ]
    return ranking.ranked(found, lambda item: item.probability)


def _likelihood(frequencies: Floats, shapes: Floats, floors: Ints, stories: int, numbers: tuple[int, int]) -> float:
    """Log likelihood of the two lowest modes found, where these are their numbers."""
    ratio, spread = FREQUENCY_RATIOS[numbers]
    off = (np.log(frequencies[1] / frequencies[0]) - np.log(ratio)) / spread
    result = -min(0.5 * off**2, WORST)
    low, high = (shape / np.abs(shape).max() for shape in shapes[:2])
    if numbers[0] == 1:
        low = low * np.sign(low[ranking.first_largest(np.abs(low))])
        result -= _unlike_a_first_mode(low, floors, stories)
    else:
        # Its node lies in the upper half: sensors below and at the top are on both sides of it.
        around = floors[0] <= stories / 2 and floors[-1] == stories
        result -= WORST * (abs(_changes(low) - 1) if around else max(0, _changes(low) - 1))
    if numbers == (1, 2):
        result -= _rises(low, high)
    else:
        whole = len(floors) == stories
        result -= WORST * (abs(_changes(high) - 2) if whole else max(0, _changes(high) - 2))
    return float(result)


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


def _changes(shape: Floats) -> int:
    sure = shape[np.abs(shape) > SHAPE_ERROR]
    return int(np.sum(np.sign(sure[1:]) != np.sign(sure[:-1])))


def findings_of(hypotheses: Sequence[ChannelMistake], channels: Sequence[Channel], first: Floats) -> list[Finding]:
    """Report what the hypotheses say of the channels: nothing, one thing that is sure, or several that may be.

    Parameters
    ----------
    hypotheses : sequence of ChannelMistake
        The most probable first.
    channels : sequence of Channel
    first : ndarray, shape (n,)
        The lowest mode found, as recorded.
    """
    best = hypotheses[0]
    sound = next(item.probability for item in hypotheses if item.kind == "sound")
    if best.kind != "sound" and best.probability >= quantities.SURE:
        return [_said(best, channels, first, sound)]
    rivals = [item for item in hypotheses if item.kind != "sound" and item.probability > best.probability / 3]
    if not rivals or rivals[0].probability < DOUBTFUL:
        return []
    names = list(dict.fromkeys(name for item in rivals for name in _named(item, channels)))
    options = [f"{_in_words(item, channels)} ({quantities.chance(item.probability)})" for item in rivals]
    missed = next(item.missed for item in hypotheses if item.kind == "sound")
    otherwise = "a mode was missed and " if missed > 0.5 else ""
    options.append(f"{otherwise}the channels are as declared ({quantities.chance(sound)})")
    rest = max(1.0 - sound - sum(item.probability for item in rivals), 0.0)
    options.append(f"something else is wrong ({quantities.chance(rest)})")
    # Where one is more probable than all others together the modes do tell, only not surely enough to change anything.
    said = (
        f"by the lowest modes {options[0]}, or {quantities.listed(options[1:], 'or')}"
        if rivals[0].probability > 0.5
        else f"the lowest modes cannot tell what is wrong: {quantities.listed(options, 'or')}"
    )
    sure = 100 * quantities.SURE
    said += f"; look at the cables and units. The record is taken as declared: nothing reaches {sure:.0f} %"
    numbers = {"channels": names, "probabilities": [item.probability for item in rivals], "corrected": False}
    return [Finding(rivals[0].kind, said, numbers)]


def _named(item: ChannelMistake, channels: Sequence[Channel]) -> list[str]:
    """List the names of the channels that a hypothesis is about; of two channels either may be the reversed one."""
    if item.kind == "sign" and len(channels) == 2:
        return [channel.name for channel in channels]
    return list(dict.fromkeys(channels[place].name for place in item.places))


def _in_words(item: ChannelMistake, channels: Sequence[Channel]) -> str:
    named = quantities.listed([str(channels[place]) for place in item.places])
    if item.kind == "sign" and len(channels) == 2:
        return f"{quantities.listed(list(map(str, channels)), 'or')} is reversed"
    if item.kind == "sign":
        return f"{named} {'is' if len(item.places) == 1 else 'are'} reversed"
    if item.kind == "unit":
        channel = channels[item.places[0]]
        unit = unit_in_truth(channel, item.factor)
        if channel.unit is not None:
            return f"{named} is in {unit or 'another unit'}, not in {channel.unit} as declared"
        return f"{named} is in {unit if unit is not None else 'm/s2 and the others in g'}"
    return f"{named} are in each other's place"


def _said(item: ChannelMistake, channels: Sequence[Channel], first: Floats, sound: float) -> Finding:
    shape = "(" + ", ".join(f"{entry:.3f}" for entry in first / first[ranking.first_largest(np.abs(first))]) + ")"
    odds = f"odds {min(item.probability / max(sound, 1e-9), 1e9):.2g} to 1 against a mode that was missed"
    names = _named(item, channels)
    numbers = {"channels": names, "probability": item.probability, "first_mode": first.tolist()}
    if item.kind == "unit":
        return in_unit(channels[item.places[0]], item.factor, f"by the lowest mode, {shape}, {odds}")
    if item.kind == "sign":
        one = len(names) == 1
        more = {"channel": names[0]} if one else {}
        what, signs = _in_words(item, channels), "its sign" if one else "their signs"
        return finding("sign", {**numbers, **more, "corrected": True}, what=what, shape=shape, odds=odds, signs=signs)
    low, high = (channels[place] for place in item.places)
    still = [channels[place] for place in item.places if abs(first[place]) < SHAPE_ERROR * np.abs(first).max()]
    dead = "".join(f", unless {channel} carries no motion at all: is its cable cut?" for channel in still)
    return finding(
        "swapped channels", {**numbers, "corrected": False}, low=low, high=high, shape=shape, odds=odds, dead=dead,
    )  # fmt: skip
