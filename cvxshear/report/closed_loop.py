"""Describe the result of the loop: verdict, states, frame, probabilities, errors, open questions, next test."""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from cvxshear.data import Deviation, Frequencies, noise_kinds
from cvxshear.effects import compose
from cvxshear.effects.state import State
from cvxshear.loop import LoopResult
from cvxshear.loop.results import VERDICTS, AddedEffect, by_part
from cvxshear.report import blocks, headline, identified
from cvxshear.util import quantities
from cvxshear.util.typing import Bools, Floats


@blocks.describe.register
def _closure(result: LoopResult) -> blocks.Document:
    units = identified.units_for(result.experiment)
    fits, programs = quantities.counted(result.fits, "fit"), quantities.counted(result.programs, "step program")
    effort = f"Backend {result.backend}: {fits}, {programs}."
    modes = identified.frequencies_table(result.experiment, result.estimate.predictions)
    averaged = "Masses without added mass; averaged over all sets of effects, each as probable as it is"
    frame = identified.frame_table(result.averaged, averaged, units).folded(2 * blocks.PAGE_COLUMNS // 3)
    sections = (
        verdict_section(result),
        limits_section(result),
        states_section(result, units),
        blocks.section("frame", "The identified frame", *frame, *identified.turning_words(result.frame)),
        identified.other_frames_section(result, units),
        effects_section(result),
        headline.numbering_section(result),
        candidates_section(result),
        *effect_sections(result),
        before_after(result),
        residual_section(result),
        blocks.section("next", "What to test next", _next(result, units)),
        identified.declared(result.experiment, units),
        blocks.section("frequencies", "Frequencies", modes, below=True, appendix=True),
        not_considered(result),
        blocks.section("effort", "Effort", effort, below=True, appendix=True),
    )
    title = result.experiment.report.title or result.experiment.name
    text = f"{result.verdict.upper()}: {headline.headline(result)}"
    data = identified.frame_table(result.averaged, "Identified frame", quantities.AUTOMATIC, "frame")
    found = [f"{item.placed.label} ({quantities.chance(item.probability)})" for item in result.effects]
    line = f"{title}: {result.verdict}, {headline.some(found) or 'nothing added'}"
    return blocks.Document(title, text, sections, (data, effects_table(result), errors_table(result), modes), line)


def verdict_section(result: LoopResult) -> blocks.Section:
    """State the meaning of the verdict, its assumptions, and the data that decided it."""
    verdict = VERDICTS[result.verdict]
    meaning = verdict.sentence if result.effects or not verdict.plain else verdict.plain
    noise, *granted = result.rests_on
    said = [meaning, f"It rests on {noise}.", headline.evidence_in_words(result)]
    if granted:
        said.append(f"It takes for granted {'; '.join(text.rstrip('.') for text in granted)}.")
    if result.assumed:
        said.append(f"In the model from the start: {', '.join(placed.label for placed in result.assumed)}.")
    return blocks.section("verdict", "Verdict", " ".join(each for each in said if each))


def limits_section(result: LoopResult) -> blocks.Section:
    """List the fits that did not converge, the remaining residuals, and the undetermined quantities."""
    stopped = ((step.action, step.estimate.fit.reason) for step in result.steps if not step.estimate.fit.converged)
    said = [f"NOT CONVERGED: {action} ({why}). Its numbers are where the fit stopped." for action, why in stopped]
    said += ["The residual sits in:"] if result.remains else []
    # Of floors that turn, the table of the frame says it.
    left = () if result.experiment.frame.turns else result.estimate.undetermined
    known = [f"Not determined: {identified.in_words(names)}" for names in left]
    known += [*identified.generous_noise(result.estimate.quality), *result.information]
    points = blocks.Points("remains", result.remains), blocks.Points("untold", blocks.sentences(known))
    return blocks.section("limits", "What is left open", *blocks.warnings(said), *points)


#: A quantity of every story or floor, shape (N,), and its derivatives by every parameter, shape (P, N).
StateValues = tuple[Floats, Floats]


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
    n = len(state.heights)
    if state.experiment.frame.turns:
        at = 3 * np.arange(n)
        return state.system.M[at, at] - state.tested.added_mass, state.system.dM[:, at, at]
    rows, by_parameters = (each[..., :n, :n].sum(axis=-1) for each in (state.system.M, state.system.dM))
    return rows - state.tested.added_mass, by_parameters


def _along(axis: int) -> Callable[[State], StateValues]:
    """Take the stiffness of each story that turns in x (0) or y (1), N/m."""
    return lambda state: (state.story_stiffness[axis::6], state.d_story_stiffness[:, axis::6])


def states_section(result: LoopResult, units: quantities.Units) -> blocks.Section:
    """Tabulate every story and floor that an effect changes: frame alone or reference state, each state, the change.

    The changes are those of the verdict's set, and the values they start from those of the averaged frame.
    """
    of_set, averaged = result.frame, result.averaged
    heavier, stiffnesses = averaged.floor_mass / of_set.floor_mass, (averaged.story_stiffness, of_set.story_stiffness)
    if result.experiment.frame.turns:
        of_stories = {
            f"stories-{axis}": (f"Stiffness of each story in {axis}", _along(at), np.divide(*entries))
            for at, axis in enumerate("xy")
            for entries in [[each[:, at, at] for each in stiffnesses]]
        }
    else:
        of_stories = {"stories": ("Sway stiffness of each story", sway_stiffness, np.divide(*stiffnesses))}
    stories = (
        table
        for key, (title, quantity, ratio) in of_stories.items()
        for table in _by_state(result, key, title, quantity, units.of_stiffness, ratio)
    )
    floors = _by_state(result, "floors", "Mass that moves with each floor", moving_mass, units.of_mass, heavier)
    return blocks.section("states", "Every story and floor, before and after", *stories, *floors)


def _by_state(
    result: LoopResult,
    key: str,
    title: str,
    quantity: Callable[[State], StateValues],
    unit_of: Callable[[Iterable[float]], tuple[float, str]],
    ratio: Floats,
) -> Iterator[blocks.Table]:
    """Tabulate one quantity in all states in which it differs; yield nothing if no effect changes it."""
    judged, experiment = result.judged, result.experiment
    tests = {each.state: each for each in reversed(experiment.tested)}
    first = experiment.frame.reference
    states = sorted(experiment.states, key=lambda name: name != first)
    found = [(f'"{name}"', quantity(compose(experiment, tests[name], judged.effects, judged.theta))) for name in states]
    if first is None:
        found.insert(0, ("shear frame", quantity(compose(experiment, tests[states[0]], (), judged.theta))))
    groups: list[tuple[list[str], StateValues]] = []
    for name, values in found:
        same = [names for names, each in groups if _alike(each[0], values[0]).all()]
        if same:
            same[0].append(name)
        else:
            groups.append(([name], values))
    if len(groups) == 1:
        return
    (_, before), *_ = groups
    factor, unit = unit_of((ratio * before[0]).tolist())
    covariance = judged.uncertainty.covariance()
    columns = [blocks.places(len(before[0]), "floor" if key == "floors" else "story")]
    for names, after in groups:
        texts = quantities.significants((ratio * after[0] / factor).tolist(), 5)
        change = after[0] / before[0] - 1.0
        by_parameters = (after[1] - (1.0 + change) * before[1]) / before[0]
        std = np.sqrt(np.einsum("pi,pq,qi->i", by_parameters, covariance, by_parameters))
        pairs = zip(change.tolist(), std.tolist(), strict=True)
        written = [f" ({quantities.with_std(*each, '%', factor=0.01)})" for each in pairs]
        changes = ["" if same else text for text, same in zip(written, _alike(after[0], before[0]), strict=True)]
        cells = tuple(map("".join, zip(texts, changes, strict=True)))
        columns.append(blocks.Column(f"{headline.some(names)}, {unit}", cells))
    # A value with its change takes half as much again of the width.
    yield from blocks.Table(key, title, tuple(columns), top_first=True).folded(2 * blocks.PAGE_COLUMNS // 3)


def _alike(one: Floats, other: Floats) -> Bools:
    """Find the values that differ by rounding at most."""
    return np.isclose(one, other, rtol=quantities.NEGLIGIBLE_STD, atol=0.0)


def effects_section(result: LoopResult) -> blocks.Section:
    """List the added effects, the most probable first, each with its rivals."""
    if not result.effects:
        return blocks.section("effects", "Effects added", "None was added to the model.")
    title, caption, doubt = "Effects found", "Effects that were added to the shear model", ""
    if result.provisional:
        title, caption = "Provisional effects", "Effects that survive while a residual is left"
        among = "the probabilities are among causes that were tried, none of which explains the data"
        doubt = f"None of them counts as found, as long as a residual is left: {among}."
    rows = (row for item in result.effects for row in _with_rivals(item))
    table = blocks.table_of_rows("effects-table", caption, ("effect", "probability"), rows)
    remarks = tuple(f"{item.placed.label}: {remark}" for item in result.effects for remark in item.remarks)
    return blocks.section("effects", title, *blocks.warnings([doubt]), table, blocks.Points("remarks", remarks))


def _with_rivals(item: AddedEffect) -> Iterator[tuple[str, str]]:
    yield item.size, quantities.chance(item.probability)
    for rival in item.rivals:
        words = "cannot be distinguished from" if rival.twin else "or in its place"
        yield f"   {words}: {rival.placed.label}", quantities.chance(rival.probability)
    if not item.rivals:
        yield "   rivals: none", ""


def effect_sections(result: LoopResult) -> Iterator[blocks.Section]:
    """Describe each effect in full: its meaning, formula and parameters."""
    for place, item in enumerate(result.effects, 1):
        kind, facts = item.placed.effect, [("formula", item.placed.effect.formula)]
        for name, unit in _parameters(result, item):
            written = quantities.per_force if "N" in unit.partition("/")[2] else quantities.with_std
            facts.append((name.replace("_", " "), written(item.parameters[name], item.std[name], unit)))
        facts += [("probability", quantities.chance(item.probability)), ("source of the formula", kind.source)]
        title, parts = quantities.capital(item.placed.label), (kind.summary, blocks.Facts(tuple(facts)))
        yield blocks.section(f"effect-{place}", title, *parts, detail=True, below=True)


def _parameters(result: LoopResult, item: AddedEffect) -> Iterator[tuple[str, str]]:
    """Yield the names and units of the parameters of an effect; an open accuracy is none."""
    names = (parameter.name for parameter in item.placed.effect.parameters)
    return zip(names, item.placed.units(result.experiment), strict=True)


def effects_table(result: LoopResult) -> blocks.Table:
    """Tabulate each parameter of each effect, for programs."""
    rows = []
    for item in result.effects:
        place, effect = item.placed.place, item.placed.effect.name.replace("_", " ")
        where = effect, place.floor, place.story, place.part, place.test or place.state
        for name, unit in _parameters(result, item):
            rows.append((*where, name.replace("_", " "), unit, item.parameters[name], item.std[name]))
    names = ("effect", "floor", "story", "part", "configuration", "parameter", "unit", "value", "std")
    values = zip(*rows, strict=True) if rows else [()] * len(names)
    # Floors that do not turn have no parts.
    known = (pair for pair in zip(names, values, strict=True) if pair[0] != "part" or result.experiment.frame.turns)
    return blocks.Table("effects", "Effects", tuple(blocks.exact(*pair) for pair in known))


def candidates_section(result: LoopResult) -> blocks.Section:
    """Tabulate all candidates with their prior and posterior probabilities."""
    found = result.candidates
    tried = f"counting that {len(found)} were tried"
    title = f"The most probable first (p: of such a gain in chi-square by chance, {tried})"
    table = blocks.table("candidates-table", title, {
        "effect": [item.placed.label for item in found],
        "before": [quantities.chance(item.prior) for item in found],
        "with the data": [quantities.chance(item.probability) for item in found],
        # The chi-square that a linearized model predicts may be negative.
        "chi-square": quantities.significants([max(item.chi2, 0.0) for item in found]),
        "dof": [str(item.dof) for item in found],
        "p of gain": [quantities.probability(item.p_value) for item in found],
    }, brief=True)  # fmt: skip
    alike = [
        f"{quantities.capital(item.placed.label)} cannot be distinguished from {identified.in_words(names)}."
        for item in found
        if (names := item.confounded_with)
    ]
    points = blocks.Points("confounded", tuple(alike))
    return blocks.section("candidates", "What was looked for, and how probable it is", table, points, below=True)


Writer = Callable[[Sequence[float | None]], list[str]]


def _six_digits(values: Sequence[float | None]) -> list[str]:
    return [quantities.significant(value, 6) for value in values]


def compared_errors(held_out: str) -> Iterator[tuple[str, str, Writer]]:
    """Yield the JSON key, the label and the format of each compared error.

    Parameters
    ----------
    held_out : str
        Text that explains the prediction of the held-out frequencies.
    """
    for kind in noise_kinds().values():
        for figure in kind.figures:
            yield figure.key, figure.label, quantities.percents if figure.relative else _six_digits
        if kind is Frequencies.noise:
            yield "held_out_frequency_error", f"largest frequency error, {held_out}", quantities.percents
    yield "chi2", "chi-square of the residual", quantities.significants
    yield "dof", "its degrees of freedom", _six_digits
    yield "p_value", "p: such a residual by chance", lambda values: list(map(quantities.probability, values))


def before_after(result: LoopResult) -> blocks.Section:
    """Compare the first and the final model of the loop."""
    which = f"{quantities.capital(result.before.action)} beside the final model, in the same noise."
    title = "The shear model and the model with effects"
    if len(result.steps) == 1:
        which, title = "Nothing was added.", "The shear model and the measurement"
    noise = blocks.Facts(tuple(headline.noise_facts(result)))
    return blocks.section("before-after", title, which, errors_table(result), noise)


def errors_table(result: LoopResult) -> blocks.Table:
    """Tabulate all errors of both models."""
    before, after = result.before.to_dict(), result.after.to_dict()
    several = len(result.experiment.configurations) > 1
    held_out = "each test predicted from the others" if several else "each mode predicted from the others"
    known = [each for each in compared_errors(held_out) if (before[each[0]], after[each[0]]) != (None, None)]
    labels = tuple(label for _, label, _ in known)
    texts = [written([before[key], after[key]]) for key, _, written in known]
    columns = [blocks.Column("error", labels, words=True, name="error", values=labels)]
    for name, side, cells in zip(headline.MODELS, (before, after), zip(*texts, strict=True), strict=True):
        values = tuple(side[key] for key, _, _ in known)
        # A model without effects is shown once.
        shown = name if name == headline.MODELS[0] or len(result.steps) > 1 else ""
        columns.append(blocks.Column(shown, cells, name=name.replace(" ", "_"), values=values))
    return blocks.Table("errors", "Errors of the model against the measurement", tuple(columns))


def residual_section(result: LoopResult) -> blocks.Section:
    """Tabulate the residual of every part of the measurement, one table for each kind of data."""
    models = (result.before, result.after) if len(result.steps) > 1 else (result.after,)
    parts = list(zip(*(by_part(each.estimate) for each in models), strict=True))
    kinds = dict.fromkeys(part[0].noise for part in parts)
    tables = (_residuals(kind, [part for part in parts if part[0].noise == kind]) for kind in kinds)
    return blocks.section("residual", "Where the residual sits", *tables, below=True)


def _residuals(kind: str, parts: list[tuple[Deviation, ...]]) -> blocks.Table:
    signed = all(item.entries == 1 for part in parts for item in part)
    errors = iter(quantities.percents([item.error for part in parts for item in part], sign=signed))
    rows = ((part[0].configuration, part[0].place, *(next(errors) for _ in part), *map(_std, part)) for part in parts)
    models = headline.MODELS[: len(parts[0])]
    name = quantities.capital(kind.replace("_", " "))
    title = f"{name}: model less measurement, in percent and in standard deviations (std)"
    head = ("configuration", "part", *models, *(f"std, {model}" for model in models))
    return blocks.table_of_rows(f"residual-{kind.replace('_', '-')}", title, head, rows, words=(0, 1))


def _std(item: Deviation) -> str:
    return quantities.signed(item.deviations, 1) if item.entries == 1 else f"{item.deviations:.1f}"


def not_considered(result: LoopResult) -> blocks.Section:
    """List the effects that the data cannot tell, and what would tell them."""
    rows = [[text.replace("_", " ") for text in pair] for pair in result.not_considered.items()]
    table = blocks.table_of_rows("not-looked-for", "", ("effect", "needs"), rows, words=(0, 1))
    return blocks.section("not-considered", "What was not looked for", table, below=True, appendix=True)


def _next(result: LoopResult, units: quantities.Units) -> str:
    """Describe the test that would distinguish the rivals, or give the reason why no test is proposed."""
    test = result.next_test
    if test is not None:
        return (
            f"{identified.put_more(test, units)}: the rivals would then differ by "
            f"{test.standard_deviations:.1f} standard deviations"
            f"{'' if test.tells_all else ', but for those that no added mass tells'}.{_reference(result)}"
        )
    verdict = VERDICTS[result.verdict]
    if verdict.certain:
        nothing = f"Nothing: no rival is left that another test would have to rule out. {verdict.advice}"
        return _besides(result) or nothing
    if any(item.rivals for item in result.effects):
        return f"No added mass up to that of a floor would distinguish the rivals.{_reference(result)} {verdict.advice}"
    if headline.in_doubt(result):
        return "Sensors at more floors: the changes of sign of a shape known at every floor show which mode it is."
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
    left = [
        item
        for item in result.candidates
        if item.placed not in added and not item.confounded_with and item.probability > 1.0 - quantities.SURE
    ]
    if not left:
        return ""
    named = headline.some([f"{item.placed.label} ({quantities.chance(item.probability)})" for item in left], "or")
    first = "No rival is left in the place of what was found" if added else "Nothing has to be added"
    return f"{first}, but something may be there besides: {named}. The masses and stiffnesses allow for that."
