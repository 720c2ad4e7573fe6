"""How probable everything is: what was added and its rivals, sets of effects, all that was looked for."""

from __future__ import annotations

from collections.abc import Iterator

from cvxshear.loop import Closure
from cvxshear.loop.results import AddedEffect, Candidate, EffectSet
from cvxshear.report.describe.consequences import consequences
from cvxshear.report.describe.numbering import numbers_in_words
from cvxshear.report.describe.parameters import in_words
from cvxshear.report.describe.vocabulary import Block, Facts, Points, Row, Section, Sentence, Table
from cvxshear.util.quantities import Units, capital, chance, listed, per_force, probability, significants, with_std

BRIEF_SETS = 6
BRIEF_CANDIDATES = 8
SPELLED_OUT = 3
"""Effects of a set up to which all are named; of a larger one, in what it differs from the most probable set."""


def effects_section(of: Closure) -> Section:
    """What was added, most probable first, each with what may be there in its place."""
    if not of.effects:
        return Section("effects", "Effects added", (Sentence("None was added to the model."),))
    rows = tuple(row for item in of.effects for row in _with_rivals(item))
    table = Table("effects-table", "What the shear model lacks", ("effect", "probability"), rows)
    remarks = tuple(f"{item.placed.label}: {remark}" for item in of.effects for remark in item.remarks)
    title = "The effect found" if len(of.effects) == 1 else "Effects found"
    return Section("effects", title, (table, *([Points("remarks", remarks)] if remarks else [])))


def _with_rivals(item: AddedEffect) -> Iterator[Row]:
    yield Row((item.size, chance(item.probability)), exact=(item.probability,))
    for rival in item.rivals:
        words = "no datum tells it from" if rival.twin else "or in its place"
        yield Row((f"   {words}: {rival.placed.label}", chance(rival.probability)), exact=(rival.probability,))
    if not item.rivals:
        yield Row(("   rivals: none", ""))


def effect_sections(of: Closure, units: Units) -> Iterator[Section]:
    """Each effect in full: what it is, its formula, its parameters, what it does."""
    for place, item in enumerate(of.effects, 1):
        kind = item.placed.effect
        facts = Facts(
            (
                ("formula", kind.formula),
                *_parameters(of, item),
                ("probability", chance(item.probability)),
                ("source of the formula", kind.source),
            )
        )
        parts: tuple[Block, ...] = (
            Sentence(kind.summary),
            facts,
            Points(f"size-{place}", tuple(consequences(of.estimate, item.placed, units))),
        )
        yield Section(f"effect-{place}", capital(item.placed.label), parts, detail=True, below=True)


def _parameters(of: Closure, item: AddedEffect) -> Iterator[tuple[str, str]]:
    units = item.placed.units(of.experiment)
    for parameter, unit in zip(item.placed.effect.parameters, units, strict=True):
        name = parameter.name
        written = per_force if "N" in unit.partition("/")[2] else with_std
        yield name.replace("_", " "), written(item.parameters[name], item.std[name], unit)


def sets_section(of: Closure) -> Section:
    """The sets of effects with their probabilities."""
    chi2 = significants([item.chi2 for item in of.models])
    rows = tuple(
        Row((_label(item, of), chance(item.probability), shown), exact=(item.probability, item.chi2))
        for item, shown in zip(of.models, chi2, strict=True)
    )
    head = ("set", "probability", "chi-square")
    table = Table("models", "Sets of effects, the most probable first", head, rows, brief=BRIEF_SETS)
    return Section("sets", "Which effects together", (table,) if rows else (), below=True)


def _label(item: EffectSet, of: Closure) -> str:
    """Its effects, and how its modes are numbered where that is other than in the verdict's set."""
    label = _set_label(item, of.models[0])
    if item.changes == of.numberings[0].changes:
        return label
    return f"{label}, {numbers_in_words(item.changes) if item.changes else 'the modes as given'}"


def _set_label(of: EffectSet, first: EffectSet) -> str:
    """Its effects, or what it has in place of some of the most probable set's."""
    if not of.effects:
        return "the shear model alone"
    if len(of.effects) <= SPELLED_OUT or of is first:
        return " + ".join(placed.label for placed in of.effects)
    come = listed([placed.label for placed in of.effects if placed not in first.effects])
    gone = listed([placed.label for placed in first.effects if placed not in of.effects])
    if come and gone:
        return f"the first, with {come} in place of {gone}"
    return f"the first, and {come}" if come else f"the first, without {gone}"


def candidates_section(of: Closure) -> Section:
    """All that was looked for, before the data and with them."""
    if not of.candidates:
        return Section("candidates", "What was looked for", (), below=True)
    count = len(of.candidates)
    chi2 = significants([item.chi2 for item in of.candidates])
    table = Table(
        "candidates-table",
        f"The most probable first (p: of such a gain in chi-square by chance, counting that {count} were tried)",
        ("effect", "before", "with the data", "chi-square", "dof", "p of gain"),
        tuple(_candidate_row(item, shown) for item, shown in zip(of.candidates, chi2, strict=True)),
        brief=BRIEF_CANDIDATES,
    )
    said = tuple(_confounded(item) for item in of.candidates if item.confounded_with)
    parts: tuple[Block, ...] = (table, *([Points("confounded", said)] if said else []))
    return Section("candidates", "What was looked for, and how probable it is", parts, below=True)


def _candidate_row(item: Candidate, chi2: str) -> Row:
    return Row(
        (
            item.placed.label,
            chance(item.prior),
            chance(item.probability),
            chi2,
            str(item.dof),
            probability(item.p_value),
        ),
        exact=(item.prior, item.probability, item.chi2, item.dof, item.p_value),
    )


def _confounded(item: Candidate) -> str:
    return f"{capital(item.placed.label)} cannot be told from {in_words(item.confounded_with)}."
