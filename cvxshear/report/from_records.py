"""Describe the modes of a record, and the doubtful entries of a record or a measurement file."""

from collections.abc import Iterator, Sequence

import numpy as np

from cvxshear.measurement.declaration import MOTIONS
from cvxshear.records import ModalResult
from cvxshear.records.result import over_amplitude
from cvxshear.report import blocks
from cvxshear.screening import FileFinding, Screening
from cvxshear.util.quantities import capital, counted, listed, numbered, percent, significants, with_std, with_stds

#: Names of the methods of `identify_modes` in words; names from other libraries stay unchanged.
METHOD_WORDS = {
    "era": "eigensystem realization (era)",
    "subspace": "subspace identification (subspace)", "ssi": "stochastic subspace identification (ssi)",
    "given": "modes found elsewhere",
}  # fmt: skip


def method_in_words(result: ModalResult) -> str:
    """Name the method of modal identification in words."""
    return METHOD_WORDS.get(result.method, result.method)


@blocks.describe.register
def _modes(result: ModalResult) -> blocks.Document:
    how = f"{capital(method_in_words(result))}; standard deviations: {result.uncertainty_in_words}."
    findings = blocks.warnings(f"{capital(each.kind)}: {each.message}" for each in result.findings)
    shapes = _shapes(result).folded(blocks.PAGE_COLUMNS)
    sections = (blocks.section("modes", "Modes", how, *findings, _table(result), *shapes),)
    count, floors = len(result.frequencies), np.unique(result.floors).tolist()
    headline = f"{result.name}: {counted(count, 'mode')} at {numbered('floor', floors)}"
    first = ", ".join(f"{frequency:.4g}" for frequency in result.frequencies[:4])
    line = f"{headline}, {first}{', ...' if count > 4 else ''} Hz"
    return blocks.Document(result.name, headline, sections, (modes_data(result),), line)


def _table(result: ModalResult) -> blocks.Table:
    frequencies = zip(result.frequencies.tolist(), result.written_frequency_std.tolist(), strict=True)
    damping = zip(result.damping_ratios.tolist(), result.written_damping_std.tolist(), strict=True)
    title = "Modes ± standard deviation; where all floors move in step, MPC is 1 and the lost phase 0°"
    shares = result.motion_shares
    moved = {} if shares is None else dict(zip(MOTIONS, (100 * shares.T).tolist(), strict=True))
    return blocks.table("identified-modes", title, {
        "mode": [str(mode) for mode in result.modes],
        "frequency, Hz": [with_std(value, value * std, factor=1.0) for value, std in frequencies],
        # A damping ratio of zero means that the ratio is unknown.
        "damping, %": [with_std(value, std, factor=0.01) if value else "–" for value, std in damping],
        "MPC": [f"{value:.4f}" for value in result.phase_collinearity.tolist()],
        "lost phase": [f"{value:.1f}°" for value in result.lost_phase],
        **{f"{name}, %": [f"{share:.0f}" for share in each] for name, each in moved.items()},
    })  # fmt: skip


def modes_data(result: ModalResult) -> blocks.Table:
    """Tabulate the modes for programs, in the format that `csv` and `xlsx` of a configuration read."""
    # The unit marks mass-normalized shapes; other shapes have the largest entry 1.
    unit = "1/sqrt(kg)" if result.mass_normalized else ""
    largest = np.abs(result.mode_shapes).max(axis=1, keepdims=True)
    shapes = result.mode_shapes if result.mass_normalized else result.mode_shapes / largest
    stds = (largest if result.mass_normalized else 1.0) * result.written_entry_std
    values = {
        ("mode", ""): result.modes,
        ("frequency", "Hz"): result.frequencies,
        ("frequency std", "Hz"): result.frequencies * result.written_frequency_std,
        ("damping ratio", ""): result.damping_ratios,
        **{(name, unit): shapes[:, at] for at, name in enumerate(result.entries)},
        **{(f"{name} std", unit): stds[:, at] for at, name in enumerate(result.entries)},
    }
    columns = (blocks.exact(name, each, unit=unit) for (name, unit), each in values.items() if np.isfinite(each).any())
    return blocks.Table(result.name, "Modes", tuple(columns))


def amplitude_section(results: Sequence[ModalResult]) -> blocks.Section:
    """Tabulate frequencies and damping of several records of one frame over the amplitude of its motion.

    Parameters
    ----------
    results : sequence of ModalResult
        Each with its amplitude.
    """
    results = sorted(results, key=lambda each: each.amplitude or 0.0)
    cells = {"record": [result.name for result in results]}
    cells["largest motion (SI)"] = significants([result.amplitude or 0.0 for result in results], 3)
    trends = []
    for mode, (frequencies, damping, (change, std)) in over_amplitude(results).items():
        for head, values in ((f"mode {mode}, Hz", frequencies), (f"damping {mode}, %", 100 * damping)):
            cells[head] = ["–" if np.isnan(value) else f"{value:#.4g}" for value in values.tolist()]
        if np.isfinite(change):
            trends.append(f"mode {mode} by {with_std(100 * change, 100 * std, factor=1.0)} %")
    said = f"A tenfold motion changes the frequency of {listed(trends)}." if trends else ""
    table = blocks.table("amplitude", "Modes over the amplitude of the motion", cells)
    return blocks.section("amplitude", "", *table.folded(blocks.PAGE_COLUMNS), said)


def poles_table(result: ModalResult) -> blocks.Table:
    """Tabulate the clusters of stable poles of a record; name the modes, and the reason for each rejected cluster.

    Parameters
    ----------
    result : ModalResult
        Of `identify_modes`, which keeps its order sweep.
    """
    assert result.sweep is not None
    chosen = {item.members for item in result.sweep.chosen}
    candidates = result.sweep.candidates
    return blocks.table("poles", f"{result.name}: --pick with the frequencies, commas between", {
        "pole": [str(number) for number in range(1, len(candidates) + 1)],
        "frequency, Hz": [f"{item.frequency:.4f}" for item in candidates],
        "orders it is stable in": [percent(item.persistence, 0) for item in candidates],
        "share of energy": [percent(item.energy, 1) for item in candidates],
        "taken": ["mode" if item.members in chosen else item.reason for item in candidates],
    }, words=(0, 4))  # fmt: skip


def _shapes(result: ModalResult) -> blocks.Table:
    """Tabulate the shapes, the top of the frame first."""
    largest = np.abs(result.mode_shapes).max(axis=1, keepdims=True)
    shapes, stds = result.mode_shapes.tolist(), (result.written_entry_std * largest).tolist()
    scale = "1/√kg" if result.mass_normalized else "the largest entry is 1"
    columns = {"floor": [str(floor) for floor in result.floors]}
    if result.sensors:
        places = [(each.floor, *each.position, each.direction) for each in result.sensors]
        columns = {"sensor": [f"floor {floor}, {x:g}, {y:g} m, {angle:g}°" for floor, x, y, angle in places]}
    columns |= {f"mode {mode}": with_stds(*pair) for mode, *pair in zip(result.modes, shapes, stds, strict=True)}
    return blocks.table("identified-shapes", f"Mode shapes ± standard deviation ({scale})", columns, top_first=True)


@blocks.describe.register
def _screening(result: Screening) -> blocks.Document:
    accepted = f"accepted beforehand: {', '.join(result.accepted)}" if result.accepted else ""
    parts = [part for item in result.findings for part in _finding(item)]
    for said in result.record:
        parts += [blocks.Sentence(f"RECORD: {said.kind}", "warning"), blocks.Facts((("  found", said.message),))]
    findings = blocks.section("findings", "", accepted, *parts)
    mistakes = sum(item.refuses for item in result.findings)
    numbers = {"mistake": mistakes, "doubt": len(result.findings) - mistakes, "remark": len(result.record)}
    summary = listed([counted(number, noun) for noun, number in numbers.items() if number]) or "nothing looks wrong"
    return blocks.Document(result.name, f"{result.name}: {summary}", (findings,))


def _finding(item: FileFinding) -> Iterator[blocks.Block]:
    """Describe a finding and the recommended change."""
    word, tone = ("MISTAKE", "mistake") if item.refuses else ("WARNING", "warning")
    where = f' in configuration "{item.configuration}"' if item.configuration else ""
    yield blocks.Sentence(f"{word}: {' or '.join((item.name, *item.rivals))}{where}", tone)
    accept = f"{item.how_to_accept}, if it is right as it is"
    yield blocks.Facts((("  found", item.found), ("  change", item.change), ("  accept", accept)))


def doubts_section(found: Sequence[FileFinding]) -> blocks.Section:
    """List the warnings of a computed result, one line each."""
    said = (f"WARNING: {item.found}; {item.change} ({item.how_to_accept} silences this)" for item in found)
    return blocks.section("doubts", "", *blocks.warnings(said))
