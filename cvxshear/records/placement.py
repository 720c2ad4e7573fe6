"""Reversed and exchanged channels, and channels in another unit, as hypotheses weighed by the modes, or by the base.

The modes of a shear frame on the ground are a Markov system (its flexibility matrix is oscillatory: Gantmacher and
Krein 1950, "Oscillation matrices and kernels"), and stay one at any choice of floors: the first mode has one sign and
grows with height, the second over the first falls with height. The first does not hold for a reversed channel; neither
holds for two exchanged ones; a factor on a channel spoils the first alone. Against each stands that the lowest mode was
not found, or the second: what is then called the first has another shape, and another ratio of frequencies to the next.

Under base motion every floor moves with the base at low frequency, which tells signs and units without modes.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from cvxshear.records import frf, picking, prepare
from cvxshear.records.clocks import FAULTY
from cvxshear.records.record import Channel, Finding, TimeRecord, finding
from cvxshear.util import quantities, ranking
from cvxshear.util.typing import Floats, Ints

#: Fraction of the lowest frequency where a floor moves twice as far as the base. At lower frequencies the floors move
#: with the base.
QUIET = 0.5
#: Coherence with the base of lines that count.
COHERENT_LINE = 0.8
#: A channel's ratio to the base falls if the upper half of such lines has less than this fraction of the lower half.
FALLING = 0.9
#: Relative standard deviation of a level at low frequency, and of a ratio to another unit.
SAME_RATIO = 0.2
#: Probability beforehand that a channel is in another unit than declared.
OTHER_UNIT = 0.005
#: Density of levels that neither explains: one channel in a thousand, of a level up to a thousand.
NEITHER = 1e-6
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
#: Least probability of a hypothesis that is reported beside the declared channels.
DOUBTFUL = 0.3


@dataclasses.dataclass(frozen=True)
class ChannelMistake:
    """A possible mistake in the channels.

    Parameters
    ----------
    kind : str
        "sound", "sign", "swapped channels" or "unit".
    places : tuple of int
        Of the channels, in their order.
    factor : float
        By which a channel is multiplied that is reversed or in another unit.
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
        result[:, list(self.places)] = self.factor * result[:, list(self.order)]
        return result

    @property
    def order(self) -> tuple[int, ...]:
        """The channels that belong in the places."""
        return self.places[::-1] if self.kind == "swapped channels" else self.places

    def mended(self, record: prepare.AnyRecord) -> prepare.AnyRecord:
        """Return the record as it is where the hypothesis is true."""
        order, factors = np.arange(len(record.channels)), np.ones(len(record.channels))
        order[list(self.places)], factors[list(self.places)] = self.order, self.factor
        channels = tuple(
            dataclasses.replace(record.channels[other], floor=channel.floor)
            for other, channel in zip(order.tolist(), record.channels, strict=True)
        )
        return prepare.with_responses(record, [run.responses[:, order] * factors for run in record.runs], channels)


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
    prior += [(ChannelMistake("sign", (i,), -1.0), FAULTY) for i in range(count if count > 2 else 1)]
    prior += [(ChannelMistake("sign", pair, -1.0), FAULTY**2) for pair in (pairs if count > 4 else ())]
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
    probabilities = ranking.weigh(np.ravel(likely), log_priors.ravel()).reshape(log_priors.shape)
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
    logarithmic = 0.5 * (np.log(np.maximum(flexible / typical, 1e-6)) / SPREAD_OF_STIFFNESS) ** 2
    additive = 0.5 * ((drifts - typical * forces) / (np.sqrt(2.0) * SHAPE_ERROR)) ** 2
    return float(np.minimum(np.minimum(logarithmic, additive), WORST).sum())


def _rises(low: Floats, high: Floats) -> float:
    """How far the second mode over the first rises with height anywhere, where it should fall."""
    steady = np.abs(low) > SHAPE_ERROR
    ratio = high[steady] / low[steady]
    if ratio[0] < ratio[-1]:
        ratio = -ratio
    error = SHAPE_ERROR * np.hypot(1.0, ratio) / np.abs(low[steady])
    rises = np.triu(ratio - ratio[:, None]) / np.hypot(error, error[:, None])
    return min(0.5 * float(rises.max()) ** 2, 2.0 * WORST)


def _changes(shape: Floats) -> int:
    """Count the changes of sign that are sure."""
    return picking.possible_changes(shape, SHAPE_ERROR)[0]


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
    said = (
        f"by the lowest modes {quantities.listed(options, 'or')}; look at the cables and units. The record is taken as "
        f"declared: nothing reaches {100 * quantities.SURE:.0f} %"
    )
    numbers = {"channels": names, "probabilities": [item.probability for item in rivals], "corrected": False}
    return [Finding(rivals[0].kind, said, numbers)]


def _named(item: ChannelMistake, channels: Sequence[Channel]) -> list[str]:
    """List the names of the channels that a hypothesis is about; of two channels either may be the reversed one."""
    if item.kind == "sign" and len(channels) == 2:
        return [channel.name for channel in channels]
    return list(dict.fromkeys(channels[place].name for place in item.places))


def _in_words(item: ChannelMistake, channels: Sequence[Channel]) -> str:
    named = quantities.listed([str(channels[place]) for place in item.places])
    if item.kind == "unit":
        return f"{named} {_other_unit(channels[item.places[0]], item.factor)[1]}"
    if item.kind == "swapped channels":
        return f"{named} are in each other's place"
    if len(channels) == 2:
        named = quantities.listed(list(map(str, channels)), "or")
    return f"{named} {'is' if len(item.places) == 1 else 'are'} reversed"


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
        "swapped channels", {**numbers, "corrected": True}, low=low, high=high, shape=shape, odds=odds, dead=dead,
    )  # fmt: skip


def with_the_base(record: TimeRecord) -> tuple[TimeRecord, list[Finding]]:
    """Signs and units by the motion at low frequency, where every floor moves with the base."""
    gains = floor_over_base(record)
    if gains is None:
        return record, []
    level, std = gains
    sizes = sorted(set(quantities.IN_SI["acceleration"].values()), key=lambda size: (size != 1.0, size))
    factors = np.outer([1.0, -1.0], sizes).ravel()
    priors = np.where(factors > 0, 1.0, FAULTY) * np.where(np.abs(factors) == 1.0, 1.0, OTHER_UNIT)
    # Rows: the input as declared, and reversed; then the channels; then the factors that mend a channel.
    spread = np.hypot(std[:, None], SAME_RATIO / np.abs(factors))
    off = (np.outer([1.0, -1.0], level)[:, :, None] - 1.0 / factors) / spread
    likely = np.exp(-0.5 * off**2) / spread * priors + NEITHER
    turned = int(ranking.weigh(np.log(likely.sum(axis=2)).sum(axis=1), np.log([1.0, FAULTY]))[1] >= quantities.SURE)
    findings, changes = [], {}
    if turned:
        findings.append(finding("sign/input", {"channel": "input", "corrected": True}))
        changes["input"] = -1.0
    for channel, value, error, each in zip(record.channels, level * (1 - 2 * turned), std, likely[turned], strict=True):
        best = ranking.first_largest(each)
        if best == 0 or each[0] > (1.0 - quantities.SURE) * each.sum():
            continue
        factor = float(factors[best])
        changes[channel.name] = factor
        if factor < 0:
            numbers = {"channel": channel.name, "gain": float(value), "corrected": True}
            findings.append(finding("sign/base", numbers, where=channel, spread=float(error)))
        if abs(factor) != 1.0:
            why = f"it moves {abs(value):.3g} times as much as the base at low frequency"
            findings.append(in_unit(channel, abs(factor), why))
    return (prepare.scaled(record, changes) if changes else record), findings


def _nearest_unit(size: float) -> str | None:
    """Name the unit of acceleration of this size in m/s2; None without a near unit."""
    off = {name: abs(np.log(size / each)) for name, each in quantities.IN_SI["acceleration"].items()}
    nearest = min(off, key=lambda name: off[name])
    return nearest if off[nearest] < SAME_RATIO else None


def _other_unit(channel: Channel, factor: float) -> tuple[str | None, str]:
    """Name the unit of a channel whose values need a factor, None if unknown, and say what the channel looks like."""
    unit = _nearest_unit(quantities.IN_SI["acceleration"].get(channel.unit or "m/s2", np.nan) * factor)
    if channel.unit is not None:
        return unit, f"is declared in {channel.unit} and looks like {unit or f'{factor:.3g} times that'}"
    if unit is not None:
        return unit, f"looks like {unit}, the others like m/s2"
    return unit, f"looks like m/s2, the others like {_nearest_unit(1.0 / factor) or f'{1.0 / factor:.3g} times that'}"


def in_unit(channel: Channel, factor: float, why: str) -> Finding:
    """Report a channel with another unit than the declared unit or, without a declaration, than the other channels."""
    unit, looks = _other_unit(channel, factor)
    remedy = "" if unit is None else f'. Write unit = "{unit}" in the record file'
    numbers = {"channel": channel.name, "floor": channel.floor, "unit": unit, "factor": factor, "corrected": True}
    return finding("unit", numbers, looks=looks, where=channel, why=why, remedy=remedy)


def floor_over_base(record: TimeRecord) -> tuple[Floats, Floats] | None:
    """Find each floor's motion over the base's towards 0 Hz, and its standard deviation; None if not recorded.

    Below the first resonance the transmissibility is T(f) = T(0) (1 + c f^2 + ...), with T(0) = 1 for a sensor that is
    right; T(0) is fitted to the real parts of H1 below half the lowest frequency with |T| = 2.
    """
    if record.quantity != "acceleration" or any(map(prepare.impulsive, record.runs)):
        return None
    frequencies, spectra = prepare.driven_spectra(record)
    whole = frf.Spectra.together(spectra)
    cross, base = whole.response_force, whole.force_force[:, None]
    transfer, coherence = cross / base, np.abs(cross) ** 2 / (base * whole.response_response)
    # A table hardly moves at the lowest frequencies; incoherent lines give no transmissibility.
    heard = np.flatnonzero((coherence > COHERENT_LINE).mean(axis=1) > 0.5)
    heard = heard[heard > 1]
    size = np.abs(transfer)
    if not heard.size:
        return None
    relative = size[heard[0] :] / np.maximum(size[heard[:2]].mean(axis=0), 0.05 * np.median(size[2:], axis=0))
    amplified = frequencies[heard[0] + np.flatnonzero((relative > 2.0).any(axis=1))[:1]]
    lines = heard[frequencies[heard] < QUIET * amplified.sum()]
    half = len(lines) // 2
    rows = np.column_stack([np.ones(len(lines)), (frequencies[lines] / amplified) ** 2])
    if len(lines) <= rows.shape[1]:
        return None
    # Above a resonance that the table leaves out motions fall as frequency rises, and have another sign.
    if np.median(size[lines[-half:]].sum(axis=0) / size[lines[:half]].sum(axis=0)) < FALLING:
        return None
    fit, left, *_ = np.linalg.lstsq(rows, transfer[lines].real, rcond=None)
    scatter = left / (len(lines) - 2) if left.size else np.var(transfer[lines].real, axis=0)
    return fit[0], np.sqrt(scatter * np.linalg.inv(rows.T @ rows)[0, 0])
