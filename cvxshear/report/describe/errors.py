"""Errors before and after, in the same noise: overall, part by part, and step by step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from cvxshear.data import Deviation
from cvxshear.loop import Closure
from cvxshear.loop.residual import by_part
from cvxshear.report.describe.noise import noise_facts
from cvxshear.report.describe.vocabulary import Block, Exact, Row, Section, Sentence, Table, columns
from cvxshear.util.quantities import percents, probability, signed, significant, significants

Writer = Callable[[Sequence[float | None]], list[str]]


def _each(written: Callable[[float | None], str]) -> Writer:
    return lambda values: [written(value) for value in values]


ERRORS: tuple[tuple[str, str, Writer], ...] = (
    ("max_frequency_error", "largest frequency error", percents),
    ("rms_frequency_error", "frequency error, root mean square", percents),
    ("held_out_frequency_error", "largest frequency error, predicted from other tests", percents),
    ("min_mac", "smallest modal assurance criterion (MAC)", _each(lambda value: significant(value, 6))),
    ("max_shape_error", "largest mode-shape error", percents),
    ("max_displacement_error", "largest displacement error", percents),
    ("chi2", "chi-square of the residual", significants),
    ("dof", "its degrees of freedom", _each(lambda value: f"{value:.0f}" if value is not None else "–")),
    ("p_value", "p: such a residual by chance", _each(probability)),
)


def before_after(of: Closure) -> Section:
    """The model that the loop began with beside the one that it ended with."""
    first = of.before.action
    after = "the final model" if len(of.steps) > 1 else "the same model, as nothing was added"
    which = f"Before: {first}. After: {after}. Both are counted in the same noise."
    parts: list[Block] = [Sentence(which), errors_table(of)]
    parts += not_converged(of)
    parts.append(noise_facts(of))
    return Section("before-after", "Before and after", tuple(parts))


def errors_table(of: Closure) -> Table:
    """Every error that either model has."""
    before, after = of.before.to_dict(), of.after.to_dict()
    rows = []
    for key, label, written in ERRORS:
        values: tuple[Exact, ...] = (before[key], after[key])
        if any(value is not None for value in values):
            rows.append(Row((label, *written([before[key], after[key]])), key, values))
    return Table("errors", "Errors of the model against the measurement", ("error", "before", "after"), tuple(rows))


def not_converged(of: Closure) -> Iterator[Sentence]:
    """A warning for each fit whose numbers are shown though it did not converge."""
    for step in of.steps:
        fit = step.estimate.fit
        if not fit.converged:
            yield Sentence(
                f"NOT CONVERGED: {step.action} ({fit.reason}). Its numbers are where the fit stopped.", "warning"
            )


def residual_section(of: Closure) -> Section:
    """The residual of every part of the measurement; a table for each kind of data."""
    before, after = by_part(of.before.estimate), by_part(of.estimate)
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
    title = f"{kind.replace('_', ' ')}: model less measurement, in percent and in standard deviations (std)"
    head = ("configuration", "part", "before", "after", "std before", "std after")
    return Table(f"residual-{kind.replace('_', '-')}", title, head, rows, words=(0, 1))


def _std(item: Deviation) -> str:
    return signed(item.deviations, 1) if item.entries == 1 else f"{item.deviations:.1f}"


def steps_section(of: Closure) -> Section:
    """Each fit on the way; nothing that the errors do not say where there are two or fewer."""
    errors = percents([step.estimate.quality.max_frequency_error for step in of.steps])
    chi2 = significants([step.estimate.chi2 for step in of.steps])
    rows = columns(
        [step.action for step in of.steps],
        chi2,
        [str(step.estimate.dof) for step in of.steps],
        [probability(step.p_value) for step in of.steps],
        errors,
    )
    head = ("step", "chi-square", "dof", "p", "largest frequency error")
    table = Table("steps-table", "How the model was arrived at, in the noise of the last step", head, rows)
    return Section("steps", "Step by step", (table,), detail=len(of.steps) < 3, below=True)
