"""Describe the changes by a closed loop: the errors before and after, and the consequences for the frame."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.data import Deviation, Frequencies, noise_kinds
from cvxshear.effects import LocatedEffect, compose
from cvxshear.effects.state import State
from cvxshear.fit.efficient import Estimate
from cvxshear.loop import LoopResult
from cvxshear.loop.results import by_part
from cvxshear.measurement.experiment import Configuration
from cvxshear.model.shear import frame_modes, modes
from cvxshear.report.describe.headline import noise_facts
from cvxshear.report.describe.vocabulary import Block, Exact, Facts, Row, Section, Sentence, Table, table
from cvxshear.util import ranking
from cvxshear.util.quantities import (
    AUTOMATIC,
    Units,
    capital,
    percent,
    percents,
    probability,
    signed,
    significant,
    significants,
)
from cvxshear.util.typing import Floats

Writer = Callable[[Sequence[float | None]], list[str]]


def _each(written: Callable[[float | None], str]) -> Writer:
    return lambda values: [written(value) for value in values]


MODELS = ("shear model", "with effects")
"""Names of the first and the final model of the loop. The words "before" and "after" may be names of states."""


def compared_errors(held_out: str) -> Iterator[tuple[str, str, Writer]]:
    """Yield the JSON key, the label and the format of each compared error.

    Parameters
    ----------
    held_out : str
        Text that explains the prediction of the held-out frequencies.
    """
    for kind in noise_kinds().values():
        for figure in kind.figures:
            yield figure.key, figure.label, percents if figure.relative else _each(lambda value: significant(value, 6))
        if kind is Frequencies.noise:
            yield "held_out_frequency_error", f"largest frequency error, {held_out}", percents
    yield "chi2", "chi-square of the residual", significants
    yield "dof", "its degrees of freedom", _each(lambda value: f"{value:.0f}" if value is not None else "–")
    yield "p_value", "p: such a residual by chance", _each(probability)


def before_after(result: LoopResult) -> Section:
    """Compare the first and the final model of the loop."""
    first = capital(result.before.action)
    same = "" if len(result.steps) > 1 else " Nothing was added, so that both are the same."
    which = f"{first} beside the final model, in the same noise.{same}"
    noise = Facts(tuple(noise_facts(result)))
    parts: tuple[Block, ...] = (Sentence(which), errors_table(result), *not_converged(result), noise)
    return Section("before-after", "The shear model and the model with effects", parts)


def errors_table(result: LoopResult) -> Table:
    """Tabulate all errors of both models."""
    before, after = result.before.to_dict(), result.after.to_dict()
    several = len(result.experiment.configurations) > 1
    held_out = "each test predicted from the others" if several else "each mode predicted from the others"
    rows = []
    for key, label, written in compared_errors(held_out):
        values: tuple[Exact, ...] = (before[key], after[key])
        if any(value is not None for value in values):
            rows.append(Row((label, *written([before[key], after[key]])), key, values))
    return Table("errors", "Errors of the model against the measurement", ("error", *MODELS), tuple(rows))


def not_converged(result: LoopResult) -> Iterator[Sentence]:
    """Warn of each shown fit that did not converge."""
    for step in result.steps:
        fit = step.estimate.fit
        if not fit.converged:
            yield Sentence(
                f"NOT CONVERGED: {step.action} ({fit.reason}). Its numbers are where the fit stopped.", "warning"
            )


def residual_section(result: LoopResult) -> Section:
    """Tabulate the residual of every part of the measurement, one table for each kind of data."""
    before, after = by_part(result.before.estimate), by_part(result.estimate)
    pairs = list(zip(before, after, strict=True))
    kinds = dict.fromkeys(item.noise for item in after)
    tables = tuple(_residuals(kind, [pair for pair in pairs if pair[1].noise == kind]) for kind in kinds)
    return Section("residual", "Where the residual sits", tables, below=True)


def _residuals(kind: str, pairs: list[tuple[Deviation, Deviation]]) -> Table:
    signed = all(item.entries == 1 for pair in pairs for item in pair)
    errors = percents([item.error for pair in pairs for item in pair], sign=signed)
    rows = tuple(
        Row((after.configuration, after.place, *errors[2 * at : 2 * at + 2], *(_std(item) for item in (before, after))))
        for at, (before, after) in enumerate(pairs)
    )
    title = f"{capital(kind.replace('_', ' '))}: model less measurement, in percent and in standard deviations (std)"
    head = ("configuration", "part", *MODELS, *(f"std, {model}" for model in MODELS))
    return Table(f"residual-{kind.replace('_', '-')}", title, head, rows, words=(0, 1))


def _std(item: Deviation) -> str:
    return signed(item.deviations, 1) if item.entries == 1 else f"{item.deviations:.1f}"


def steps_section(result: LoopResult) -> Section:
    """Tabulate each fit of the loop. With fewer than three fits, only the full report shows this table."""
    errors = percents([step.estimate.quality.max_frequency_error for step in result.steps])
    chi2 = significants([step.estimate.chi2 for step in result.steps])
    steps = table("steps-table", "How the model was arrived at, in the noise of the last step", {
        "step": [step.action for step in result.steps],
        "chi-square": chi2,
        "dof": [str(step.estimate.dof) for step in result.steps],
        "p": [probability(step.p_value) for step in result.steps],
        "largest frequency error": errors,
    })  # fmt: skip
    return Section("steps", "Step by step", (steps,), detail=len(result.steps) < 3, below=True)


NOTHING = 1e-9
"""Smallest relative change that is mentioned."""


@dataclass(frozen=True, eq=False)
class Change:
    """Changes that one effect causes in one configuration.

    Parameters
    ----------
    configuration : str
    stiffness : ndarray, shape (N,)
        Change of the sway stiffness of each story, N/m. The sway stiffness is the force at the top over the story's
        drift.
    stiffness_share : ndarray, shape (N,)
        Change of the sway stiffness over the stiffness without the effect.
    mass : ndarray, shape (N,)
        Change of the mass that moves with each floor, kg.
    mass_share : ndarray, shape (N,)
        Change of the floor's mass over the mass without the effect.
    gain : ndarray, shape (N,)
        Relative change of the sensor signals.
    frequencies : ndarray, shape (N,)
        Relative change of the natural frequencies.
    alone : bool
        Whether the frame without the effect is a shear frame.
    """

    configuration: str
    stiffness: Floats
    stiffness_share: Floats
    mass: Floats
    mass_share: Floats
    gain: Floats
    frequencies: Floats
    alone: bool


def changes(estimate: Estimate, placed: LocatedEffect) -> list[Change]:
    """Compute the changes that one effect causes in each configuration; all other parameters stay fixed.

    Parameters
    ----------
    estimate : Estimate
    placed : LocatedEffect
        One of its effects.
    """
    own = estimate.own(placed)
    rest = [item for item in estimate.effects if item is not placed]
    without = np.delete(estimate.theta, np.arange(own.start, own.stop))
    models = (rest, without), (estimate.effects, estimate.theta)
    return [
        _change(each, *(compose(estimate.experiment, each, *model) for model in models))
        for each in estimate.experiment.configurations
        if placed.acts_on(each)
    ]


def _change(configuration: Configuration, before: State, after: State) -> Change:
    n = len(after.story_stiffness)
    stiff = _sway_stiffness(before), _sway_stiffness(after)
    mass = before.system.M[:n, :n].sum(axis=1), after.system.M[:n, :n].sum(axis=1)
    diagonal = np.diag(after.system.M)[:n] - np.diag(before.system.M)[:n]
    heavier = mass[1] - mass[0]
    # Coupling terms move mass between floors and off the diagonal. The row sum shows additional mass.
    added = np.where(np.abs(heavier) > NOTHING * mass[0], heavier, diagonal)
    found = [(modes(state.system.M, state.system.K), state.system.M) for state in (before, after)]
    # The modes of masses that are attached to the frame are left out.
    frequencies = [each.frequencies[frame_modes(each, M, n)] for each, M in found]
    stiffness = stiff[1] - stiff[0], stiff[1] / stiff[0] - 1.0
    gain, moved = after.gain / before.gain - 1.0, frequencies[1] / frequencies[0] - 1.0
    alone = np.allclose(stiff[0], before.story_stiffness, rtol=1e-6)
    return Change(configuration.name, *stiffness, added, added / mass[0], gain, moved, alone)


def _sway_stiffness(state: State) -> Floats:
    """Divide a force at the top by the drift of each story under it, shape (N,), N/m: k_i of a shear frame."""
    K, n = state.system.K, len(state.story_stiffness)
    force = np.zeros(len(K))
    force[n - 1] = 1.0
    return np.asarray(1.0 / np.diff(np.linalg.solve(K, force)[:n], prepend=0.0))


def consequences(estimate: Estimate, placed: LocatedEffect, units: Units = AUTOMATIC) -> list[str]:
    """Write the consequences of an effect of a fit in sentences.

    Parameters
    ----------
    estimate : Estimate
    placed : LocatedEffect
        One of its effects.
    units : Units, optional
        Units of masses and stiffnesses.
    """
    found = changes(estimate, placed)
    if not found:
        return []
    return [*_stiffness(found, units), *_mass(found, units), *_gain(found), *_frequencies(found)]


def _largest(found: list[Change], name: str) -> Iterator[tuple[Change, int, float]]:
    """Yield the configuration, place and size of the largest relative change, if any."""
    item = ranking.ranked(found, lambda each: float(np.max(np.abs(getattr(each, name)))))[0]
    place = ranking.first_largest(np.abs(getattr(item, name)))
    if abs(getattr(item, name)[place]) >= NOTHING:
        yield item, place, float(getattr(item, name)[place])


def _stiffness(found: list[Change], units: Units) -> Iterator[str]:
    for most, story, share in _largest(found, "stiffness_share"):
        least = ranking.ranked(found, lambda each: -float(np.min(np.abs(each.stiffness_share))))[0]
        other = ranking.first_largest(-np.abs(least.stiffness_share))
        word, way = ("takes", "from") if share < 0 else ("adds", "to")
        factor, unit = units.of_stiffness([10 * float(most.stiffness[story])])
        whole = "the story stiffness" if most.alone else "what the story resists with the other effects"
        sentence = (
            f"It {word} {abs(most.stiffness[story]) / factor:.3g} {unit}, {percent(abs(share))} of {whole}, "
            f'{way} story {story + 1} in "{most.configuration}"'
        )
        smallest = abs(float(least.stiffness_share[other]))
        if (most, story) != (least, other) and smallest > NOTHING:
            sentence += (
                f', where it does most; least in story {other + 1} in "{least.configuration}": {percent(smallest)}'
            )
        yield sentence + "."


def _mass(found: list[Change], units: Units) -> Iterator[str]:
    for most, floor, share in _largest(found, "mass_share"):
        factor, unit = units.of_mass([float(most.mass[floor])])
        size = f"{abs(most.mass[floor]) / factor:.3g} {unit} {'more' if share > 0 else 'less'}"
        yield (
            f'The inertia at floor {floor + 1} in "{most.configuration}" is {size}, {percent(abs(share))} of what the '
            "floor carries."
        )


def _gain(found: list[Change]) -> Iterator[str]:
    for floor, gain in enumerate(found[0].gain, 1):
        if abs(gain) > NOTHING:
            word = "much" if gain > 0 else "little"
            yield f"The sensor at floor {floor} reads {percent(abs(gain))} too {word}; the frame itself is as it was."


def _frequencies(found: list[Change]) -> Iterator[str]:
    for most, mode, moved in _largest(found, "frequencies"):
        yield (
            f"It {'lowers' if moved < 0 else 'raises'} the natural frequency of mode {mode + 1} in "
            f'"{most.configuration}" by {percent(abs(moved))}, more than any other.'
        )
