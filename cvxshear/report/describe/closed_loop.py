"""Describe the result of the loop: verdict, states, frame, probabilities, errors, open questions, next test."""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from cvxshear.data import Deviation, Frequencies, noise_kinds
from cvxshear.effects import compose
from cvxshear.effects.state import State
from cvxshear.loop import LoopResult
from cvxshear.loop.results import AddedEffect, EffectSet, by_part
from cvxshear.report.describe import (
    PAGE_COLUMNS,
    Block,
    Column,
    Document,
    Facts,
    Points,
    Section,
    Sentence,
    Table,
    describe,
    exact,
    line,
    places,
    table,
    table_of_rows,
)
from cvxshear.report.describe.headline import (
    DOUBT,
    MODELS,
    NAMED,
    evidence_in_words,
    headline,
    in_doubt,
    noise_facts,
    numbering_sections,
    numbers_in_words,
    verdict_of,
)
from cvxshear.report.describe.identified import (
    declared,
    frame_table,
    frequencies_table,
    generous_noise,
    in_words,
    measured_modes,
    units_for,
)
from cvxshear.util.quantities import (
    AUTOMATIC,
    Units,
    capital,
    chance,
    counted,
    listed,
    per_force,
    percents,
    probability,
    signed,
    significant,
    significants,
    with_std,
)
from cvxshear.util.typing import Floats


def effects_section(result: LoopResult) -> Section:
    """List the added effects, the most probable first, each with its rivals."""
    if not result.effects:
        return Section("effects", "Effects added", (Sentence("None was added to the model."),))
    rows = (row for item in result.effects for row in _with_rivals(item))
    remarks = tuple(f"{item.placed.label}: {remark}" for item in result.effects for remark in item.remarks)
    title = "The effect found" if len(result.effects) == 1 else "Effects found"
    caption = "Effects that were added to the shear model"
    parts: list[Block] = []
    if verdict_of(result).provisional:
        title, caption = "Provisional effects", "Effects that survive while a residual is left"
        among = "the probabilities are among causes that were tried, none of which explains the data"
        said = f"None of them counts as found, as long as a residual is left: {among}."
        parts.append(Sentence(said, "warning"))
    parts.append(table_of_rows("effects-table", caption, ("effect", "probability"), rows))
    return Section("effects", title, (*parts, *([Points("remarks", remarks)] if remarks else [])))


def _with_rivals(item: AddedEffect) -> Iterator[tuple[str, str]]:
    yield item.size, chance(item.probability)
    for rival in item.rivals:
        words = "cannot be distinguished from" if rival.twin else "or in its place"
        yield f"   {words}: {rival.placed.label}", chance(rival.probability)
    if not item.rivals:
        yield "   rivals: none", ""


def effect_sections(result: LoopResult) -> Iterator[Section]:
    """Describe each effect in full: its meaning, formula and parameters."""
    for place, item in enumerate(result.effects, 1):
        kind = item.placed.effect
        known = ("probability", chance(item.probability)), ("source of the formula", kind.source)
        facts = Facts((("formula", kind.formula), *_parameters(result, item), *known))
        parts = (Sentence(kind.summary), facts)
        yield Section(f"effect-{place}", capital(item.placed.label), parts, detail=True, below=True)


def _parameters(result: LoopResult, item: AddedEffect) -> Iterator[tuple[str, str]]:
    units = item.placed.units(result.experiment)
    for parameter, unit in zip(item.placed.effect.parameters, units, strict=True):
        name = parameter.name
        written = per_force if "N" in unit.partition("/")[2] else with_std
        yield name.replace("_", " "), written(item.parameters[name], item.std[name], unit)


def effects_table(result: LoopResult) -> Table:
    """Tabulate each parameter of each effect, for programs."""
    rows = []
    for found in result.effects:
        place, units = found.placed.place, found.placed.units(result.experiment)
        where = found.placed.effect.name.replace("_", " "), place.floor, place.story, place.test or place.state
        for parameter, unit in zip(found.placed.effect.parameters, units, strict=True):
            name = parameter.name
            rows.append((*where, name.replace("_", " "), unit, found.parameters[name], found.std[name]))
    names = ("effect", "floor", "story", "configuration", "parameter", "unit", "value", "std")
    values = zip(*rows, strict=True) if rows else [()] * len(names)
    return Table("effects", "Effects", tuple(map(exact, names, values)))


def sets_section(result: LoopResult) -> Section:
    """Tabulate the sets of effects with their probabilities."""
    chi2 = significants([item.chi2 for item in result.models])
    pairs = zip(result.models, chi2, strict=True)
    rows = [(_label(item, result), chance(item.probability), shown) for item, shown in pairs]
    head = ("set", "probability", "chi-square")
    found = table_of_rows("models", "Sets of effects, the most probable first", head, rows, brief=True)
    return Section("sets", "Which effects together", (found,) if rows else (), below=True)


def _label(item: EffectSet, result: LoopResult) -> str:
    """Name the effects of a set, and its mode numbers if they differ from the verdict's."""
    label = _set_label(item, result.models[0])
    if item.changes == result.numberings[0].changes:
        return label
    return f"{label}, {numbers_in_words(item.changes) if item.changes else 'the modes as given'}"


def _set_label(effects: EffectSet, first: EffectSet) -> str:
    """Name the effects of a set, or its differences from the most probable set."""
    if not effects.effects:
        return "the shear model alone"
    if len(effects.effects) <= NAMED or effects is first:
        return " + ".join(placed.label for placed in effects.effects)
    come = listed([placed.label for placed in effects.effects if placed not in first.effects])
    gone = listed([placed.label for placed in first.effects if placed not in effects.effects])
    if come and gone:
        return f"the first, with {come} in place of {gone}"
    return f"the first, and {come}" if come else f"the first, without {gone}"


def candidates_section(result: LoopResult) -> Section:
    """Tabulate all candidates with their prior and posterior probabilities."""
    if not result.candidates:
        return Section("candidates", "What was looked for", (), below=True)
    count = len(result.candidates)
    # The chi-square that a linearized model predicts may be negative.
    chi2 = significants([max(item.chi2, 0.0) for item in result.candidates])
    title = f"The most probable first (p: of such a gain in chi-square by chance, counting that {count} were tried)"
    head = ("effect", "before", "with the data", "chi-square", "dof", "p of gain")
    rows = (
        (item.placed.label, chance(item.prior), chance(item.probability), fit, str(item.dof), probability(item.p_value))
        for item, fit in zip(result.candidates, chi2, strict=True)
    )
    found = table_of_rows("candidates-table", title, head, rows, brief=True)
    said = tuple(
        f"{capital(item.placed.label)} cannot be distinguished from {in_words(item.confounded_with)}."
        for item in result.candidates
        if item.confounded_with
    )
    parts: tuple[Block, ...] = (found, *([Points("confounded", said)] if said else []))
    return Section("candidates", "What was looked for, and how probable it is", parts, below=True)


@describe.register
def _closure(result: LoopResult, units: Units = AUTOMATIC) -> Document:
    units = units_for(result.experiment, units)
    effort = f"Backend {result.backend}: {counted(result.fits, 'fit')}, {counted(result.programs, 'step program')}."
    sections = (
        verdict_section(result),
        limits_section(result),
        states_section(result, units),
        frame_section(result, units),
        effects_section(result),
        *numbering_sections(result),
        sets_section(result),
        candidates_section(result),
        *effect_sections(result),
        before_after(result),
        residual_section(result),
        Section("next", "What to test next", (Sentence(_next(result, units)),)),
        declared(result.experiment, units),
        measured_modes(result.experiment, units),
        steps_section(result),
        not_considered(result),
        Section("effort", "Effort", (Sentence(effort),), below=True, appendix=True),
    )
    headline_text = f"{result.verdict.upper()}: {headline(result)}"
    data = (
        frame_table(result.frame, "Identified frame", AUTOMATIC, key="frame", averaged=result.averaged),
        effects_table(result),
        errors_table(result),
        frequencies_table(result.experiment, result.estimate.predictions),
    )
    return Document(result.experiment.name, headline_text, sections, data)


@line.register
def _line(result: LoopResult) -> str:
    found = [f"{item.placed.label} ({chance(item.probability)})" for item in result.effects]
    if len(found) > NAMED:
        found[NAMED:] = [f"{len(found) - NAMED} more"]
    return f"<LoopResult {result.experiment.name}: {result.verdict}, {listed(found) or 'nothing added'}>"


def verdict_section(result: LoopResult) -> Section:
    """State the meaning of the verdict, its assumptions, and the data that decided it."""
    verdict = verdict_of(result)
    meaning = verdict.sentence if result.effects or not verdict.plain else verdict.plain
    noise, *granted = result.rests_on
    said = [meaning, f"It rests on {noise}.", evidence_in_words(result)]
    if granted:
        said.append(f"It takes for granted {'; '.join(text.rstrip('.') for text in granted)}.")
    if result.assumed:
        said.append(f"In the model from the start: {', '.join(placed.label for placed in result.assumed)}.")
    return Section("verdict", "Verdict", (Sentence(" ".join(each for each in said if each)),))


Writer = Callable[[Sequence[float | None]], list[str]]


def _each(written: Callable[[float | None], str]) -> Writer:
    return lambda values: [written(value) for value in values]


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
    known = [each for each in compared_errors(held_out) if (before[each[0]], after[each[0]]) != (None, None)]
    labels = tuple(label for _, label, _ in known)
    texts = [written([before[key], after[key]]) for key, _, written in known]
    columns = [Column("error", labels, words=True, name="error", values=labels)]
    for name, side, cells in zip(MODELS, (before, after), zip(*texts, strict=True), strict=True):
        columns.append(Column(name, cells, name=name.replace(" ", "_"), values=tuple(side[key] for key, _, _ in known)))
    return Table("errors", "Errors of the model against the measurement", tuple(columns))


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
    rows = (
        (after.configuration, after.place, *errors[2 * at : 2 * at + 2], *(_std(item) for item in (before, after)))
        for at, (before, after) in enumerate(pairs)
    )
    title = f"{capital(kind.replace('_', ' '))}: model less measurement, in percent and in standard deviations (std)"
    head = ("configuration", "part", *MODELS, *(f"std, {model}" for model in MODELS))
    return table_of_rows(f"residual-{kind.replace('_', '-')}", title, head, rows, words=(0, 1))


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
    return Section("steps", "Step by step", (steps,), detail=len(result.steps) < 3, below=True, appendix=True)


NOTHING = 1e-9
"""Smallest relative change that is not rounding."""

StateValues = tuple[Floats, Floats]
"""A quantity of every story or floor, shape (N,), and its derivatives by every parameter, shape (P, N)."""


def sway_stiffness(state: State) -> StateValues:
    """Divide a force at the top by the drift of each story under it, N/m: the story stiffness of a shear frame."""
    K, dK, n = state.system.K, state.system.dK, len(state.story_stiffness)
    force = np.zeros(len(K))
    force[n - 1] = 1.0
    sway = np.linalg.solve(K, force)
    by_parameters = -np.linalg.solve(K, (dK @ sway).T).T
    drift, d_drift = (np.diff(each[..., :n], prepend=0.0) for each in (sway, by_parameters))
    return 1.0 / drift, -d_drift / drift**2


def moving_mass(state: State) -> StateValues:
    """Sum the mass that moves with each floor, kg, without the declared added mass."""
    n = len(state.story_stiffness)
    rows, by_parameters = (each[..., :n, :n].sum(axis=-1) for each in (state.system.M, state.system.dM))
    return rows - state.tested.added_mass, by_parameters


def states_section(result: LoopResult, units: Units) -> Section:
    """Tabulate every story and floor that an effect changes: frame alone or reference state, each state, the change."""
    tables = (
        _by_state(result, "stories", "Sway stiffness of each story", sway_stiffness, units.of_stiffness),
        _by_state(result, "floors", "Mass that moves with each floor", moving_mass, units.of_mass),
    )
    return Section("states", "Every story and floor, before and after", tuple(part for each in tables for part in each))


def _by_state(
    result: LoopResult,
    key: str,
    title: str,
    quantity: Callable[[State], StateValues],
    unit_of: Callable[[Iterable[float]], tuple[float, str]],
) -> Iterator[Table]:
    """Tabulate one quantity in all states in which it differs; yield nothing if no effect changes it."""
    estimate, experiment = result.judged, result.experiment
    tests = {each.state: each for each in reversed(experiment.configurations)}
    first = experiment.frame.reference
    states = sorted(experiment.states, key=lambda name: name != first)
    found = [
        (f'"{name}"', quantity(compose(experiment, tests[name], estimate.effects, estimate.theta))) for name in states
    ]
    if first is None:
        found.insert(0, ("shear frame", quantity(compose(experiment, tests[states[0]], (), estimate.theta))))
    groups: list[tuple[list[str], StateValues]] = []
    for name, values in found:
        same = next((names for names, each in groups if np.allclose(each[0], values[0], rtol=NOTHING, atol=0.0)), None)
        if same is None:
            groups.append(([name], values))
        else:
            same.append(name)
    if len(groups) == 1:
        return
    (_, before), *_ = groups
    factor, unit = unit_of(before[0].tolist())
    covariance = estimate.uncertainty.covariance()
    columns = [places(len(before[0]), "story" if key == "stories" else "floor")]
    for names, after in groups:
        heading = listed(names if len(names) <= NAMED else [*names[:NAMED], f"{len(names) - NAMED} more"])
        texts = significants((after[0] / factor).tolist(), 5)
        change = after[0] / before[0] - 1.0
        by_parameters = (after[1] - (1.0 + change) * before[1]) / before[0]
        std = np.sqrt(np.einsum("pi,pq,qi->i", by_parameters, covariance, by_parameters))
        written = (with_std(*each, "%", factor=0.01) for each in zip(change.tolist(), std.tolist(), strict=True))
        changes = [f" ({text})" if abs(value) > NOTHING else "" for text, value in zip(written, change, strict=True)]
        columns.append(Column(f"{heading}, {unit}", tuple(map("".join, zip(texts, changes, strict=True)))))
    # A value with its change takes half as much again of the width.
    yield from Table(key, title, tuple(columns), top_first=True).folded(2 * PAGE_COLUMNS // 3)


def frame_section(result: LoopResult, units: Units) -> Section:
    """Tabulate the frame of the verdict's set and the average frame over all sets."""
    title = "Masses without added mass; averaged: over all sets of effects, each as probable as it is"
    parts: tuple[Block, ...] = (frame_table(result.frame, title, units, averaged=result.averaged),)
    if not result.estimate.fit.converged:
        parts = (*parts, Sentence(f"NOT CONVERGED ({result.estimate.fit.reason}).", "warning"))
    return Section("frame", "The identified frame", parts)


def limits_section(result: LoopResult) -> Section:
    """List the remaining residuals and the undetermined quantities."""
    parts: list[Block] = []
    if result.remains:
        parts += [Sentence("The residual sits in:", "warning"), Points("remains", result.remains)]
    if known := tuple(_undetermined(result)):
        parts.append(Points("untold", known))
    return Section("limits", "What is left open", tuple(parts))


def not_considered(result: LoopResult) -> Section:
    """List the effects that the data cannot tell, and what would tell them."""
    texts = tuple(
        f"{capital(name.replace('_', ' '))} was not looked for: that needs {lacking.replace('_', ' ')}."
        for name, lacking in result.not_considered.items()
    )
    parts = (Points("not-looked-for", texts),) if texts else ()
    return Section("not-considered", "What was not looked for", parts, below=True, appendix=True)


def _undetermined(result: LoopResult) -> Iterator[str]:
    for names in result.estimate.uncertainty.null_directions:
        yield f"Not determined: {in_words(names)}."
    for text in (*generous_noise(result.estimate.quality), *result.information):
        yield f"{capital(text)}."


def _next(result: LoopResult, units: Units) -> str:
    """Describe the test that would distinguish the rivals, or give the reason why no test is proposed."""
    test = result.next_test
    if test is not None:
        factor, unit = units.of_mass([test.added_mass])
        return (
            f'Put {significant(test.added_mass / factor, 3)} {unit} more on floor {test.floor} of "{test.state}" and '
            "measure again: the rivals would then differ by "
            f"{test.standard_deviations:.1f} standard deviations"
            f"{'' if test.tells_all else ', but for those that no added mass tells'}.{_reference(result)}"
        )
    verdict = verdict_of(result)
    if verdict.certain:
        nothing = f"Nothing: no rival is left that another test would have to rule out. {verdict.advice}"
        return _besides(result) or nothing
    if any(item.rivals for item in result.effects):
        return f"No added mass up to that of a floor would distinguish the rivals.{_reference(result)} {verdict.advice}"
    if in_doubt(result):
        return (
            "Sensors at more floors: the changes of sign of a shape that is known at every floor show which mode it is."
        )
    return verdict.advice


def _reference(result: LoopResult) -> str:
    """Advise to declare the sound state if causes in several states are rivals."""
    experiment = result.estimate.experiment
    states = {rival.placed.place.state for item in result.effects for rival in item.rivals}
    states |= {item.placed.place.state for item in result.effects}
    if experiment.frame.reference is not None or len(states - {None}) < 2:
        return ""
    return (
        f' If the frame was sound in one state, say so ([frame] reference = "{experiment.states[0]}"): what differs is '
        "then looked for in the others."
    )


def _besides(result: LoopResult) -> str:
    """Name the candidates that remain possible beside a certain verdict; empty if no candidate remains."""
    added = {item.placed for item in result.effects}
    left = [item for item in result.candidates if item.placed not in added and item.probability > DOUBT]
    if not left:
        return ""
    named = [f"{item.placed.label} ({chance(item.probability)})" for item in left[:NAMED]]
    if more := len(left) - len(named):
        named.append(f"{more} more")
    first = "No rival is left in the place of what was found" if added else "Nothing has to be added"
    return (
        f"{first}, but something may be there besides: {listed(named, 'or')}. The averaged masses and stiffnesses "
        "allow for that; use those."
    )
