"""The report of a closed loop, for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from cvxshear.loop import VERDICTS, Closure
from cvxshear.loop.residual import by_mode
from cvxshear.loop.results import Found
from cvxshear.report.effect_size import summary
from cvxshear.report.numbers import percent, probability, significant
from cvxshear.report.terminal import declared, frame_table, plain_table
from cvxshear.text import printable

SHOWN_CANDIDATES = 8


def closure(result: Closure) -> Iterator[RenderableType]:
    """What was measured, the residual, the steps, before and after, the frame, what remains."""
    yield Text(f"{result.verdict.upper()}: {printable(headline(result))}", style="bold")
    yield Text(f"The verdict rests on {printable(result.rests_on)}.\n")
    yield declared(result.experiment)
    yield Text("")
    yield residuals(result)
    yield Text("")
    yield steps(result)
    yield Text("")
    for found in result.effects:
        yield Text(effect(found) + "\n")
    if any(item.admissible for item in result.candidates):
        yield ranking(result)
        yield Text("")
    yield before_after(result)
    yield Text("")
    yield frame_table(result.frame, "the frame (masses without added mass)")
    yield Text("\n" + "\n".join(map(printable, _remarks(result))))


def headline(result: Closure) -> str:
    """The verdict in a sentence that names what was found."""
    if not result.effects and result.verdict == "adequate" and result.estimate.dof <= 0:
        return "There is nothing to test: the shear model has as many parameters as there are data."
    if not result.effects and result.verdict == "adequate" and not result.experiment.noise_declared:
        return "Nothing was added: no effect that was looked for improves the shear model beyond the noise it leaves."
    if not result.effects:
        return VERDICTS[result.verdict]
    names = " and ".join(found.placed.label for found in result.effects)
    change = (
        f"the largest frequency error falls from {percent(result.before.estimate.quality.max_frequency_error)} "
        f"to {percent(result.after.estimate.quality.max_frequency_error)}"
    )
    if result.verdict == "unexplained":
        return f"with {names} {change}, but a significant residual is left."
    if result.verdict == "ambiguous":
        rivals = sorted({rival.placed.label for found in result.effects for rival in found.rivals})
        return f"with {names} {change}, but {', '.join(rivals)} would explain the data as well."
    return f"the shear model lacks {names}; with it {change}."


def residuals(result: Closure) -> Table:
    """The residual by configuration and mode, before and after, in percent and in standard deviations."""
    table = plain_table(
        "residual, model less measurement (std: in standard deviations of the noise)",
        "configuration", "mode", "frequency before", "std", "after", "std", "shape before", "std", "after", "std",
    )  # fmt: skip
    pairs = zip(by_mode(result.before.estimate), by_mode(result.estimate), strict=True)
    for before, after in pairs:
        cells = []
        for item in (before, after):
            cells += [f"{100 * item.frequency_error:+.2f} %", f"{item.frequency_deviation:+.1f}"]
        for item in (before, after):
            cells += [
                percent(item.shape_error, 1),
                "–" if item.shape_deviation is None else f"{item.shape_deviation:.1f}",
            ]
        table.add_row(printable(before.configuration), str(before.mode), *cells)
    return table


def steps(result: Closure) -> Table:
    """Each fit on the way, what was tried and what it left."""
    table = plain_table("steps", "step", "tried", "chi-square", "of", "p", "largest frequency error", "held out")
    for step in result.steps:
        quality = step.estimate.quality
        table.add_row(
            printable(step.action),
            str(step.tried) if step.tried else "–",
            significant(quality.chi2),
            str(quality.dof),
            probability(step.p_value),
            percent(quality.max_frequency_error),
            percent(step.held_out),
        )
    return table


def effect(found: Found) -> str:
    """An effect in words: what it is, its formula, its size and how sure it is."""
    kind = found.placed.effect
    sizes = ", ".join(f"{name} = {value}" for name, value in summary(found.placed, found.parameters, found.std))
    rivals = ", ".join(rival.placed.label for rival in found.rivals)
    return "\n".join(
        printable(line)
        for line in [
            f"{found.placed.label}: {kind.summary}",
            f"  {kind.formula}",
            f"  {sizes}; a gain like this by chance: {probability(_exp(found.log_p))}",
            f"  rivals: {rivals or 'none'}",
        ]
    )


def _exp(log_p: float) -> float:
    return 0.0 if log_p < -700 else 2.718281828459045**log_p


def ranking(result: Closure) -> Table:
    """The best candidates of the last step."""
    table = plain_table("candidates of the last step, best first", "candidate", "chi-square", "of", "p of its gain")
    admissible = [item for item in result.candidates if item.admissible and item.estimate is not None]
    for item in admissible[:SHOWN_CANDIDATES]:
        assert item.estimate is not None
        table.add_row(
            printable(item.placed.label),
            significant(item.estimate.chi2),
            str(item.estimate.dof),
            probability(_exp(item.log_p)),
        )
    if len(admissible) > SHOWN_CANDIDATES:
        table.add_row(f"and {len(admissible) - SHOWN_CANDIDATES} more")
    return table


def before_after(result: Closure) -> Table:
    """Errors of the shear model and of the final one side by side."""
    table = plain_table("error", "", "before", "after")
    before, after = result.before.to_dict(), result.after.to_dict()
    rows = (
        ("largest frequency error", "max_frequency_error", percent),
        ("rms frequency error", "rms_frequency_error", percent),
        ("largest frequency error on held-out data", "held_out_frequency_error", percent),
        ("smallest MAC", "min_mac", lambda value: significant(value, 6)),
        ("largest shape error", "max_shape_error", percent),
        ("chi-square", "chi2", significant),
        ("degrees of freedom", "dof", str),
        ("p value of the residual", "p_value", probability),
    )
    for label, key, written in rows:
        table.add_row(label, written(before[key]), written(after[key]))
    return table


def _remarks(result: Closure) -> Iterator[str]:
    """What remains, what is not determined, what was not looked for, what to test next."""
    if result.remains:
        yield "the residual sits in:"
        yield from (f"  {place}" for place in result.remains)
    for names in result.estimate.uncertainty.null_directions:
        yield f"not determined by these data: {' and '.join(names)}"
    for name, lacking in result.not_considered.items():
        yield f"not looked for: {name} (declare {lacking})"
    for said in result.information:
        yield f"known: {said}"
    if result.next_test is not None:
        test = result.next_test
        yield (
            f"next test: {test.added_mass:.3g} kg more on floor {test.floor} would set the rivals "
            f"{test.standard_deviations:.1f} standard deviations apart"
        )
    yield f"effort: {result.fits} fits, {result.programs} step programs"
