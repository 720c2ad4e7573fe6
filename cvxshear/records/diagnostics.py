"""Findings about a record from its modes: clocks, driving points, reciprocity, amplitude, missing and other modes."""

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import scipy

from cvxshear.records import clocks, estimate, examination, frf, picking
from cvxshear.records.record import Finding, Record, TimeRecord, finding
from cvxshear.records.result import OVERLOOKED_KIND, SENSOR_STD, ModalResult
from cvxshear.util import quantities, ranking
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats, Ints

#: Probability that a stable pole of no reproducible shape between two modes is a mode of the frame: of another
#: direction, of twisting, of a floor or of noise it is as often.
A_MODE = 0.3


def overlooked_modes(
    frequencies: Floats, modes: Ints, left_out: Sequence[picking.PoleCandidate], *, floors: int, stories: int
) -> list[Finding]:
    """Name the resonances that put the numbers of modes in doubt.

    Parameters
    ----------
    frequencies : ndarray, shape (m,)
        Of the modes found, Hz.
    modes : ndarray of int, shape (m,)
        Their numbers.
    left_out : sequence of PoleCandidate
        Stable poles that were not chosen.
    floors : int
        Measured.
    stories : int

    Returns
    -------
    list of Finding
        Each with the numbers `frequency`, `modes` as they would be, and `probability`.
    """
    if floors == stories:
        return []
    between: dict[int, list[float]] = {}
    for item in left_out:
        between.setdefault(int(np.searchsorted(frequencies, item.frequency)), []).append(item.frequency)
    share = A_MODE / max(len(between), 1)
    findings = []
    for place, resonances in sorted(between.items()):
        moved = modes + (np.arange(len(modes)) >= place)
        if not 0 < place < len(modes) or moved[-1] > stories:
            continue
        below, above, at = modes[place - 1], modes[place], quantities.listed([f"{each:.4g}" for each in resonances])
        numbers = {"frequency": resonances[0], "modes": moved.tolist(), "probability": share}
        findings.append(finding(OVERLOOKED_KIND, numbers, below=below, above=above, at=at, next=above + 1))
    return findings


def left_out(
    candidates: Sequence[picking.PoleCandidate], chosen: Sequence[picking.PoleCandidate]
) -> list[picking.PoleCandidate]:
    """List the candidates that are resonances of something, and not among those chosen."""
    taken = {item.members for item in chosen}
    return [item for item in candidates if (item.physical or item.shaky) and item.members not in taken]


#: Degrees at the highest mode; a clock offset that turns it less changes nothing that is reported.
LEAST_TURN = 1.0
#: Least reported relative difference between the two directions of a transfer, for sensors and a hammer accurate to 1
#: %.
UNRECIPROCAL = 0.02
OTHER = (
    "{}: torsion, another axis, a local mode, a load that moves on its mounting, a split mode, a multiple of a louder "
    "frequency, or {}"
)


def modal_findings(
    result: ModalResult,
    setting: estimate.Replication,
    full: estimate.Details,
    lost: int,
    turning: Callable[[float], float] | None = None,
) -> Iterator[Finding]:
    """Everything the modes say about the record they came from; `turning` is the share of rotation at a frequency."""
    record = setting.record
    yield from clock_findings(record, result, full)
    yield from reciprocity_findings(full, setting)
    yield from driving_point_findings(full, setting)
    yield from amplitude_findings(setting, result)
    yield from _first_mode_findings(record, result)
    yield from _mode_findings(record, result, setting)
    shares = [] if turning is None else [turning(frequency) for frequency in result.frequencies.tolist()]
    for mode, share in zip(result.modes.tolist(), shares, strict=False):
        if share > examination.ROTATES:
            yield finding("rotation", {"mode": mode, "share": share})
    if lost:
        yield finding("std", {"lost": lost}, count=len(setting.source.groups), unit=setting.source.unit)


def clock_findings(record: Record, result: ModalResult, full: estimate.Details) -> Iterator[Finding]:
    """Clocks whose phase grows linearly with frequency, by more than the data's scatter.

    Dampers turn the phases of modes, too. The phases of the whole band must agree better with the delay than without.
    """
    names = list(result.clock_offsets)
    segments = clocks.Segments.of(record) if isinstance(record, TimeRecord) else None
    for (name, (late, std)), left in zip(result.clock_offsets.items(), full.clocks.unexplained, strict=False):
        turn = float(360.0 * full.frequencies.max() * abs(late))
        if len(full.frequencies) < 2 or turn < LEAST_TURN or std <= 0.0:
            continue
        # The deviation holds the phases that the straight line leaves. Delays are equally probable up to the longest.
        gain = 0.5 * (late / std) ** 2 + np.log(std * np.sqrt(2 * np.pi) / (2 * clocks.LONGEST))
        if ranking.weigh([0.0, gain + np.log(clocks.FAULTY)])[1] < quantities.SURE:
            continue
        place, beside, late_by = names.index(name), full.clocks.reference, full.clocks.seconds
        floors = [floor for floor in range(len(record.channels)) if floor != place]
        if beside == len(record.channels) and floors:
            # Every resonance turns the phases between the input and a floor; those between two floors it does not.
            beside = min(floors, key=lambda floor: abs(late_by[floor]))
        apart = float(late_by[place] - late_by[beside])
        if segments is not None and not segments.against(place, [beside]).nearer(apart):
            continue
        if late > 0 and len(names) > 2 and max(place, beside) < len(record.channels):
            omega = 2 * np.pi * full.frequencies
            between = full.shapes[:, place] * np.conj(full.shapes[:, beside]) * np.exp(-1j * omega * apart)
            corner, probability = clocks.slow_sensor(omega, between, record.sampling_rate)
            if probability >= quantities.SURE:
                numbers = {"channel": name, "corner": corner, "probability": probability, "out": True}
                yield finding("low-pass/modes", numbers, where=record.channels[place])
                continue
        yield finding(
            "clock offset/modes", {"channel": name, "seconds": late, "std": std, "left_degrees": left}, by=abs(late),
            late="late" if late > 0 else "early", spread=quantities.significant(std * 1e3, 2),
            reference=names[full.clocks.reference],
            which="" if len(names) > 2 else "; which of the two is off no third clock tells",
        )  # fmt: skip


#: Damping ratio; the least that frames without cladding have. A machine's tone has less.
UNDAMPED = 1e-3


def reciprocity_findings(full: estimate.Details, setting: estimate.Replication) -> Iterator[Finding]:
    """Pairs of driving points whose transfers differ with the direction (Maxwell and Betti say they do not)."""
    if full.products is None or not setting.driving_point:
        return
    places = {int(floor): place for place, floor in enumerate(setting.record.floors)}
    driven = {int(floor): column for column, floor in enumerate(full.driven)}
    for low, high in itertools.combinations(sorted(set(places) & set(driven)), 2):
        up = full.products[:, places[high], driven[low]]
        down = full.products[:, places[low], driven[high]]
        ratio = float(np.linalg.norm(up - down) / (0.5 * (np.linalg.norm(up) + np.linalg.norm(down))))
        each = np.abs(np.abs(up) - np.abs(down)) / (0.5 * (np.abs(up) + np.abs(down)))
        # Near a node of the mode a transfer is too small to say anything of calibrations.
        pair = full.real[:, [places[low], places[high]]]
        unsure = SENSOR_STD * np.linalg.norm(pair, axis=1)
        beyond_doubt = np.where(each * np.abs(pair.prod(axis=1)) > unsure, each, 0.0)
        if beyond_doubt.max() > UNRECIPROCAL:
            largest, worst = float(beyond_doubt.max()), ranking.first_largest(beyond_doubt) + 1
            numbers = {"floors": [low, high], "largest": largest, "over_all": ratio, "by_mode": each.tolist()}
            yield finding("reciprocity", numbers, low=low, high=high, worst=worst)


def driving_point_findings(full: estimate.Details, setting: estimate.Replication) -> Iterator[Finding]:
    """Report declared driving points with negative residues of a mode: the force acted elsewhere.

    The residue of mode r with response and force at one floor is phi^2 / (2 i omega), phi real: its sign is the same in
    every mode. So where the residues of the modes, divided by the declared floor's entries, change sign, another floor
    was hit; candidates are the floors without a change of sign.
    """
    if full.products is None or not setting.driving_point or full.scales is not None:
        return
    floors = setting.record.floors.tolist()
    for column, floor in enumerate(full.driven.tolist()):
        # phi of the floor that was hit, up to a positive factor in each mode.
        there = np.einsum("ri,ri->r", full.products[:, :, column].real, full.real) / np.sum(full.real**2, axis=1)
        right = [at for place, at in enumerate(floors) if np.all(there * full.real[:, place] > 0)]
        if floor in right or floor not in floors:
            continue
        if right:
            said = f"as if the force acted at floor {quantities.listed([str(at) for at in right])}"
            fits = "only it fits" if len(right) == 1 else "they fit"
            change = f"write that input_floor (of floors with a sensor {fits})"
        elif np.any([np.all(there * row < 0) for row in full.real.T]):
            said, change = "as if the force's sensor were turned round", "change its sign in the record file"
        else:
            said, change = "and at no other floor with a sensor are they right", "check input_floor and the channels"
        yield finding("scale", {"floor": floor, "positive_at": right}, as_if=said, change=change)


def _first_mode_findings(record: Record, result: ModalResult) -> Iterator[Finding]:
    """Doubt a mode 1 with almost no damping, or above nearly all of the measured input."""
    lowest, damping = float(result.frequencies[0]), float(result.damping_ratios[0])
    if result.modes[0] != 1:
        return
    if damping < UNDAMPED:
        yield finding("doubtful mode", {"mode": 1, "frequency": lowest, "damping": damping})
    if isinstance(record, TimeRecord) and record.input in ("base", "force"):
        inputs = [run.excitation for run in record.runs if run.excitation is not None]
        spectra = [scipy.signal.periodogram(each, record.sampling_rate) for each in inputs]
        above, whole = (sum(power[lines >= least].sum() for lines, power in spectra) for least in (lowest, 0.0))
        if above < frf.WEAKEST_FORCE * whole:
            yield finding("doubtful mode/input", {"mode": 1, "frequency": lowest, "excited": float(above / whole)})


def _mode_findings(record: Record, result: ModalResult, setting: estimate.Replication) -> Iterator[Finding]:
    sweep = setting.sweep
    by_signs = len(record.channels) == record.stories > 1 and not record.turns
    asked = 0 < len(sweep.choose.picked) < record.most_modes
    if by_signs and len(sweep.chosen) < record.stories:
        absent = sorted(set(range(1, record.stories + 1)) - {int(mode) for mode in result.modes})
        yield finding(
            "missing mode", {"modes": absent}, which=quantities.numbered("mode", absent), stories=record.stories,
            were="was" if len(absent) == 1 else "were", asked="not asked for" if asked else "not found in the record",
        )  # fmt: skip
    if len(record.channels) < record.stories and len(sweep.chosen) < record.stories:
        numbers = quantities.listed([str(mode) for mode in result.modes])
        were = "were asked for" if asked else "were found"
        sizes = {"measured": len(record.channels), "stories": record.stories}
        yield finding("missing mode/few sensors", sizes, count=len(sweep.chosen), were=were, numbers=numbers)
    stories = quantities.counted(record.stories, "story")
    for item in sweep.candidates:
        if item.physical and not any(item is other for other in sweep.chosen):
            what = OTHER.format(f"one more than {stories} can have", "the frame has more")
            if asked:
                what = "not among the modes asked for"
            elif len(sweep.chosen) < record.most_modes:
                what = OTHER.format(
                    "not a sway mode that the frame still lacks", "a floor or a sign is not as declared"
                )
            yield finding("other mode", {"frequency": item.frequency, "energy": item.energy}, what=what)
    # A model of noise has poles of rotation as well.
    faint = picking.FAINT * max(item.energy for item in sweep.candidates)
    for item in sweep.candidates:
        if item.reason.startswith(picking.MOSTLY_ROTATION) and item.energy > faint:
            yield finding("rotation/pole", {"frequency": item.frequency}, why=item.reason)


#: Relative change of such frequencies between strong and weak motion; the mini table's are 0.6 to 2.4 %.
TYPICAL_CHANGE = 0.01
#: Relative change of a frequency that says nothing: four degrees of temperature have this effect on a steel frame.
SMALLEST_CHANGE = 1e-3
#: Least change of a frequency, in standard deviations: chance exceeds it for one mode in 370.
SIGNIFICANT = 3.0


def amplitude_findings(setting: estimate.Replication, result: ModalResult) -> Iterator[Finding]:
    """Report modes whose frequency depends on amplitude: the stronger half of the blocks against the weaker one.

    Two hypotheses, equally probable beforehand, are weighed over all modes together: no change, or changes of a
    typical size. The scatter is Student's, as it is estimated from a few pieces.
    """
    if setting.source.unit != "block":
        return
    energies = setting.source.energies
    strong = energies > np.median(energies)
    # Noise that the stronger half hardly shows may be a tenth of the weaker: each half says itself how it scatters.
    halves = [half for half in (_half(setting, strong), _half(setting, ~strong)) if half is not None]
    if len(halves) < 2:
        return
    (first, first_std, first_freedom), (second, second_std, second_freedom) = halves
    changes, freedom = first - second, np.minimum(first_freedom, second_freedom)
    std = np.hypot(first_std, second_std)
    scales = np.hypot(np.maximum(std, SMALLEST_CHANGE), np.array([[0.0], [TYPICAL_CHANGE]]))
    likely = -np.log(scales) - 0.5 * (freedom + 1.0) * np.log1p((changes / scales) ** 2 / freedom)
    if ranking.weigh(likely.sum(axis=1))[1] < quantities.SURE:
        return
    # Halves of a record differ by twice the scatter of the whole. What does not exceed that is left to the scatter.
    least = np.maximum(SIGNIFICANT * 2.0 * result.frequency_std, SMALLEST_CHANGE)
    ratio = float(np.sqrt(energies[strong].mean() / energies[~strong].mean()))
    for place in np.flatnonzero((likely[1] > likely[0]) & (np.abs(changes) > least)).tolist():
        numbers = {"mode": int(result.modes[place]), "change": float(changes[place]), "std": float(std[place])}
        frequencies = np.exp([first[place], second[place]]) / (2 * np.pi)
        numbers |= {"amplitude_ratio": ratio}
        yield finding("amplitude", numbers, strong=frequencies[0], weak=frequencies[1])


def _half(setting: estimate.Replication, half: Bools) -> tuple[Floats, Floats, Floats] | None:
    """Logarithms of angular frequencies of half of the blocks, with std and degrees of freedom; None if not found."""
    blocks = np.flatnonzero(half)

    def replicate(keep: Bools) -> Floats | None:
        left = np.zeros(len(half), dtype=bool)
        left[blocks[keep]] = True
        values = setting.values(left)
        return None if values is None else np.log(np.abs(values.eigenvalues + setting.record.window_decay))

    whole = replicate(np.ones(len(blocks), dtype=bool))
    if whole is None:
        return None
    try:
        covariance, freedom, _ = estimate.jackknife(
            replicate, np.zeros(len(blocks), dtype=np.int64), np.ones(len(blocks))
        )
    except InputError:
        return None
    return whole, np.sqrt(np.diag(covariance)), freedom
