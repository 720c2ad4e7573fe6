"""Describe the result of the loop: verdict, probabilities of the effects, open questions, recommended next test."""

from collections.abc import Iterator

from cvxshear.loop import LoopResult
from cvxshear.loop.next_test import NextTest
from cvxshear.loop.results import AddedEffect, EffectSet
from cvxshear.report.describe.consequences import before_after, consequences, residual_section, steps_section
from cvxshear.report.describe.headline import (
    DOUBT,
    NAMED,
    evidence_in_words,
    headline,
    in_doubt,
    numbering_sections,
    numbers_in_words,
    verdict_of,
)
from cvxshear.report.describe.identified import frame_table, generous_noise, in_words
from cvxshear.report.describe.measured import declared, measured_modes, units_for
from cvxshear.report.describe.vocabulary import (
    Block,
    Document,
    Facts,
    Points,
    Row,
    Section,
    Sentence,
    Table,
    describe,
    line,
    plain_rows,
)
from cvxshear.util.quantities import (
    AUTOMATIC,
    Units,
    capital,
    chance,
    counted,
    listed,
    per_force,
    probability,
    significant,
    significants,
    with_std,
)

BRIEF_SETS = 6
"""Number of sets of effects that a terminal shows."""

BRIEF_CANDIDATES = 8
"""Number of candidates that a terminal shows."""

SPELLED_OUT = 3
"""Largest number of effects of a set that are all named. A larger set is named by its differences from the most
probable."""


MOST_QUESTIONS = 4
"""Number of open questions on the first screen of a report; a later section lists all."""

GAIN = 1.0
"""Expected decrease of chi-square by chance for one additional parameter."""

UNMOVED = 2.0
"""Largest ratio of the posterior to the prior probability for an effect that counts as no more probable."""


def effects_section(result: LoopResult) -> Section:
    """List the added effects, the most probable first, each with its rivals."""
    if not result.effects:
        return Section("effects", "Effects added", (Sentence("None was added to the model."),))
    rows = tuple(row for item in result.effects for row in _with_rivals(item))
    remarks = tuple(f"{item.placed.label}: {remark}" for item in result.effects for remark in item.remarks)
    title = "The effect found" if len(result.effects) == 1 else "Effects found"
    caption = "Effects that were added to the shear model"
    parts: list[Block] = []
    if verdict_of(result).provisional:
        title, caption = "Provisional effects", "Effects that survive while a residual is left"
        among = "the probabilities are among causes that were tried, none of which explains the data"
        said = f"None of them counts as found, as long as a residual is left: {among}."
        parts.append(Sentence(said, "warning"))
    parts.append(Table("effects-table", caption, ("effect", "probability"), rows))
    return Section("effects", title, (*parts, *([Points("remarks", remarks)] if remarks else [])))


def _with_rivals(item: AddedEffect) -> Iterator[Row]:
    yield Row((item.size, chance(item.probability)))
    for rival in item.rivals:
        words = "cannot be distinguished from" if rival.twin else "or in its place"
        yield Row((f"   {words}: {rival.placed.label}", chance(rival.probability)))
    if not item.rivals:
        yield Row(("   rivals: none", ""))


def effect_sections(result: LoopResult, units: Units) -> Iterator[Section]:
    """Describe each effect in full: its meaning, formula, parameters and consequences."""
    for place, item in enumerate(result.effects, 1):
        kind = item.placed.effect
        known = ("probability", chance(item.probability)), ("source of the formula", kind.source)
        facts = Facts((("formula", kind.formula), *_parameters(result, item), *known))
        does = Points(f"size-{place}", tuple(consequences(result.judged, item.placed, units)))
        parts = (Sentence(kind.summary), facts, does)
        yield Section(f"effect-{place}", capital(item.placed.label), parts, detail=True, below=True)


def _parameters(result: LoopResult, item: AddedEffect) -> Iterator[tuple[str, str]]:
    units = item.placed.units(result.experiment)
    for parameter, unit in zip(item.placed.effect.parameters, units, strict=True):
        name = parameter.name
        written = per_force if "N" in unit.partition("/")[2] else with_std
        yield name.replace("_", " "), written(item.parameters[name], item.std[name], unit)


def sets_section(result: LoopResult) -> Section:
    """Tabulate the sets of effects with their probabilities."""
    chi2 = significants([item.chi2 for item in result.models])
    pairs = zip(result.models, chi2, strict=True)
    rows = plain_rows((_label(item, result), chance(item.probability), shown) for item, shown in pairs)
    head = ("set", "probability", "chi-square")
    table = Table("models", "Sets of effects, the most probable first", head, rows, brief=BRIEF_SETS)
    return Section("sets", "Which effects together", (table,) if rows else (), below=True)


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
    if len(effects.effects) <= SPELLED_OUT or effects is first:
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
    rows = plain_rows(
        (item.placed.label, chance(item.prior), chance(item.probability), fit, str(item.dof), probability(item.p_value))
        for item, fit in zip(result.candidates, chi2, strict=True)
    )
    table = Table("candidates-table", title, head, rows, brief=BRIEF_CANDIDATES)
    said = tuple(
        f"{capital(item.placed.label)} cannot be distinguished from {in_words(item.confounded_with)}."
        for item in result.candidates
        if item.confounded_with
    )
    parts: tuple[Block, ...] = (table, *_unmoved(result), *([Points("confounded", said)] if said else []))
    return Section("candidates", "What was looked for, and how probable it is", parts, below=True)


def _unmoved(result: LoopResult) -> Iterator[Sentence]:
    """Explain why some effects improve chi-square and are no more probable than before."""
    added = {item.placed for item in result.effects}
    final = result.estimate.chi2
    seen = [
        item.placed.label
        for item in result.candidates
        if item.placed not in added and final - max(item.chi2, 0.0) > GAIN and item.probability < UNMOVED * item.prior
    ]
    if seen:
        names = listed(seen if len(seen) <= SPELLED_OUT else [*seen[:SPELLED_OUT], f"{len(seen) - SPELLED_OUT} more"])
        yield Sentence(
            f"With {names} chi-square would be lower, yet the probability hardly rises: any free number improves a fit "
            "a little, and a cause gains only by what it improves beyond that; the column p of gain says how often "
            "chance alone does as well."
        )


@describe.register
def _closure(result: LoopResult, units: Units = AUTOMATIC) -> Document:
    units = units_for(result.experiment, units)
    effort = f"Backend {result.backend}: {counted(result.fits, 'fit')}, {counted(result.programs, 'step program')}."
    sections = (
        verdict_section(result),
        *numbering_sections(result),
        effects_section(result),
        sets_section(result),
        candidates_section(result),
        *effect_sections(result, units),
        before_after(result),
        residual_section(result),
        steps_section(result),
        frame_section(result, units),
        limits_section(result),
        Section("next", "What to test next", (Sentence(_next(result, units)),)),
        declared(result.experiment, units),
        measured_modes(result.experiment, units),
        Section("effort", "Effort", (Sentence(effort),)),
    )
    return Document(result.experiment.name, f"{result.verdict.upper()}: {headline(result)}", sections)


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


def frame_section(result: LoopResult, units: Units) -> Section:
    """Tabulate the frame of the verdict's set and the average frame over all sets."""
    title = "Masses without added mass; averaged: over all sets of effects, each as probable as it is"
    parts: tuple[Block, ...] = (frame_table(result.frame, title, units, averaged=result.averaged),)
    if not result.estimate.fit.converged:
        parts = (*parts, Sentence(f"NOT CONVERGED ({result.estimate.fit.reason}).", "warning"))
    return Section("frame", "The identified frame", parts)


def limits_section(result: LoopResult) -> Section:
    """List the remaining residuals, the undetermined quantities and the effects that were not examined."""
    parts: list[Block] = []
    if result.remains:
        parts += [Sentence("The residual sits in:", "warning"), Points("remains", result.remains)]
    known = tuple(_limits(result))
    if known:
        parts.append(Points("untold", known))
    return Section("limits", "What is left open", tuple(parts))


def _limits(result: LoopResult) -> Iterator[str]:
    yield from _undetermined(result)
    for name, lacking in result.not_considered.items():
        yield f"{capital(name.replace('_', ' '))} was not looked for: that needs {lacking.replace('_', ' ')}."


def _undetermined(result: LoopResult) -> Iterator[str]:
    for names in result.estimate.uncertainty.null_directions:
        yield f"Not determined: {in_words(names)}."
    for text in (*generous_noise(result.estimate.quality), *result.information):
        yield f"{capital(text)}."


def open_questions(result: LoopResult) -> tuple[str, ...]:
    """List up to `MOST_QUESTIONS` open questions that the headline omits, the most important first.

    Parameters
    ----------
    result : LoopResult
    """
    said = []
    # The headline names the rivals if the effects are few.
    for item in result.effects if len(result.effects) > NAMED else ():
        if item.rivals:
            first = item.rivals[0]
            how = "cannot be distinguished from" if first.twin else "may in truth be"
            said.append(f"{capital(item.placed.label)} {how} {first.placed.label} ({chance(first.probability)}).")
    if in_doubt(result):
        said.append("The numbers of the measured modes are in question.")
    said += _undetermined(result)
    more = len(said) - MOST_QUESTIONS
    return (*said[:MOST_QUESTIONS], *([f"{more} more below."] if more > 0 else []))


def _next(result: LoopResult, units: Units) -> str:
    """Describe the test that would distinguish the rivals, or give the reason why no test is proposed."""
    test = result.next_test
    if test is not None:
        factor, unit = units.of_mass([test.added_mass])
        return (
            f'Put {significant(test.added_mass / factor, 3)} {unit} more on floor {test.floor} of "{test.state}" and '
            f"measure again{_with_sensors(result, test)}: the rivals would then differ by "
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
    named = [f"{item.placed.label} ({chance(item.probability)})" for item in left[:SPELLED_OUT]]
    if more := len(left) - len(named):
        named.append(f"{more} more")
    first = "No rival is left in the place of what was found" if added else "Nothing has to be added"
    return (
        f"{first}, but something may be there besides: {listed(named, 'or')}. The averaged masses and stiffnesses "
        "allow for that; use those."
    )


def _with_sensors(result: LoopResult, test: NextTest) -> str:
    """Name the additional floors that the next test measures."""
    if test.measured_floors is None:
        return ""
    first = next(each for each in result.experiment.configurations if each.state == test.state)
    more = [str(floor) for floor in test.measured_floors if floor not in first.measured_floors]
    return (
        f", with {'a sensor' if len(more) == 1 else 'sensors'} at floor{'s' * (len(more) > 1)} {' and '.join(more)} too"
    )
