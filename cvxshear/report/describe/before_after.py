"""Errors before and after, in the same noise: overall, part by part, and step by step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from cvxshear.data import Deviation, Frequencies, noise_kinds
from cvxshear.loop import Closure
from cvxshear.loop.residual import by_part
from cvxshear.report.describe.headline import noise_facts
from cvxshear.report.describe.vocabulary import Block, Exact, Row, Section, Sentence, Table, columns
from cvxshear.util.quantities import capital, percents, probability, signed, significant, significants

Writer = Callable[[Sequence[float | None]], list[str]]


def _each(written: Callable[[float | None], str]) -> Writer:
    return lambda values: [written(value) for value in values]


MODELS = ("shear model", "with effects")
"""The model that the loop began with and the one that it ended with; states may be named "before" and "after"."""


def compared_errors(held_out: str) -> Iterator[tuple[str, str, Writer]]:
    """Key in the JSON, label, and how the two values are written, of each error that is compared.

    Parameters
    ----------
    held_out : str
        How the held-out frequencies were predicted.
    """
    for kind in noise_kinds().values():
        for figure in kind.figures:
            yield figure.key, figure.label, percents if figure.relative else _each(lambda value: significant(value, 6))
        if kind is Frequencies.noise:
            yield "held_out_frequency_error", f"largest frequency error, {held_out}", percents
    yield "chi2", "chi-square of the residual", significants
    yield "dof", "its degrees of freedom", _each(lambda value: f"{value:.0f}" if value is not None else "–")
    yield "p_value", "p: such a residual by chance", _each(probability)


def before_after(result: Closure) -> Section:
    """Set the model that the loop began with beside the one that it ended with."""
    first = capital(result.before.action)
    same = "" if len(result.steps) > 1 else " Nothing was added, so that both are the same."
    which = f"{first} beside the final model, in the same noise.{same}"
    parts: list[Block] = [Sentence(which), errors_table(result)]
    parts += not_converged(result)
    parts.append(noise_facts(result))
    return Section("before-after", "The shear model and the model with effects", tuple(parts))


def errors_table(result: Closure) -> Table:
    """Every error that either model has."""
    before, after = result.before.to_dict(), result.after.to_dict()
    several = len(result.experiment.configurations) > 1
    held_out = "each test predicted from the others" if several else "each mode predicted from the others"
    rows = []
    for key, label, written in compared_errors(held_out):
        values: tuple[Exact, ...] = (before[key], after[key])
        if any(value is not None for value in values):
            rows.append(Row((label, *written([before[key], after[key]])), key, values))
    return Table("errors", "Errors of the model against the measurement", ("error", *MODELS), tuple(rows))


def not_converged(result: Closure) -> Iterator[Sentence]:
    """Warn of each fit whose numbers are shown though it did not converge."""
    for step in result.steps:
        fit = step.estimate.fit
        if not fit.converged:
            yield Sentence(
                f"NOT CONVERGED: {step.action} ({fit.reason}). Its numbers are where the fit stopped.", "warning"
            )


def residual_section(result: Closure) -> Section:
    """Tabulate the residual of every part of the measurement; a table for each kind of data."""
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


def steps_section(result: Closure) -> Section:
    """Each fit on the way; nothing that the errors do not say where there are two or fewer."""
    errors = percents([step.estimate.quality.max_frequency_error for step in result.steps])
    chi2 = significants([step.estimate.chi2 for step in result.steps])
    rows = columns(
        [step.action for step in result.steps],
        chi2,
        [str(step.estimate.dof) for step in result.steps],
        [probability(step.p_value) for step in result.steps],
        errors,
    )
    head = ("step", "chi-square", "dof", "p", "largest frequency error")
    table = Table("steps-table", "How the model was arrived at, in the noise of the last step", head, rows)
    return Section("steps", "Step by step", (table,), detail=len(result.steps) < 3, below=True)
