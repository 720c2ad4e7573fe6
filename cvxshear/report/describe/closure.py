"""What closing the loop found."""

from __future__ import annotations

from collections.abc import Iterator

from cvxshear.loop import VERDICTS, Closure
from cvxshear.loop.next_test import NextTest
from cvxshear.report.describe.dispatch import describe, line
from cvxshear.report.describe.errors import before_after, residual_section, steps_section
from cvxshear.report.describe.evidence import candidates_section, effect_sections, effects_section, sets_section
from cvxshear.report.describe.experiment import declared, measured_modes, units_for
from cvxshear.report.describe.frame import frame_table
from cvxshear.report.describe.headline import NAMED, headline
from cvxshear.report.describe.numbering import in_doubt, numbering_sections
from cvxshear.report.describe.parameters import in_words
from cvxshear.report.describe.vocabulary import Block, Document, Points, Section, Sentence
from cvxshear.util.quantities import AUTOMATIC, Units, capital, chance, counted, listed, significant


@describe.register
def _closure(of: Closure, units: Units = AUTOMATIC) -> Document:
    units = units_for(of.experiment, units)
    sections = (
        verdict_section(of),
        *numbering_sections(of),
        effects_section(of),
        sets_section(of),
        candidates_section(of),
        *effect_sections(of, units),
        before_after(of),
        residual_section(of),
        steps_section(of),
        frame_section(of, units),
        limits_section(of),
        next_section(of, units),
        declared(of.experiment, units),
        measured_modes(of.experiment, units),
        Section("effort", "Effort", (Sentence(_effort(of)),)),
    )
    return Document(of.experiment.name, f"{of.verdict.upper()}: {headline(of)}", sections)


@line.register
def _line(of: Closure) -> str:
    found = [f"{item.placed.label} ({chance(item.probability)})" for item in of.effects]
    if len(found) > NAMED:
        found[NAMED:] = [f"{len(found) - NAMED} more"]
    return f"<Closure {of.experiment.name}: {of.verdict}, {listed(found) or 'nothing added'}>"


def verdict_section(of: Closure) -> Section:
    """What the verdict means and rests on."""
    assumed = f" In the model from the start: {', '.join(placed.label for placed in of.assumed)}." if of.assumed else ""
    meaning = VERDICTS[of.verdict].sentence
    if not of.effects and of.verdict == "explained":
        meaning = "The shear model explains the data, once the modes are numbered otherwise; no effect was added."
    if not of.effects and of.verdict == "ambiguous":
        meaning = "The shear model explains the data; which modes of the frame were measured is in question."
    return Section("verdict", "Verdict", (Sentence(f"{meaning} It rests on {listed(list(of.rests_on))}.{assumed}"),))


def frame_section(of: Closure, units: Units) -> Section:
    """The frame of the verdict's set, and the one averaged over all sets."""
    title = "Masses without added mass; averaged: over all sets of effects, each as probable as it is"
    parts: tuple[Block, ...] = (frame_table(of.frame, title, units, averaged=of.averaged),)
    if not of.estimate.fit.converged:
        parts = (*parts, Sentence(f"NOT CONVERGED ({of.estimate.fit.reason}).", "warning"))
    return Section("frame", "The identified frame", parts)


def limits_section(of: Closure) -> Section:
    """Where a residual is left, what the data leave open, what was not looked for."""
    parts: list[Block] = []
    if of.remains:
        parts += [Sentence("The residual sits in:", "warning"), Points("remains", of.remains)]
    known = tuple(_limits(of))
    if known:
        parts.append(Points("untold", known))
    return Section("limits", "What is left and what these data cannot tell", tuple(parts))


def _limits(of: Closure) -> Iterator[str]:
    for names in of.estimate.uncertainty.null_directions:
        yield f"Not determined: {in_words(names)}."
    for text in of.information:
        yield f"{capital(text)}."
    for name, lacking in of.not_considered.items():
        yield f"{capital(name.replace('_', ' '))} was not looked for: that needs {lacking.replace('_', ' ')}."


def next_section(of: Closure, units: Units) -> Section:
    """The test that would tell the rivals apart."""
    return Section("next", "What to test next", (Sentence(_next(of, units)),))


def _next(of: Closure, units: Units) -> str:
    test = of.next_test
    if test is not None:
        factor, unit = units.of_mass([test.added_mass])
        return (
            f'Put {significant(test.added_mass / factor, 3)} {unit} more on floor {test.floor} of "{test.state}" and '
            f"measure again{_with_sensors(of, test)}: that would set the rivals {test.standard_deviations:.1f} "
            "standard deviations apart."
        )
    if of.verdict == "unexplained":
        return (
            "No added mass is proposed: no effect that was looked for makes the residual. Look first at where it sits."
        )
    if of.verdict == "ambiguous" and in_doubt(of) and not any(item.rivals for item in of.effects):
        return (
            "Sensors at more floors: the changes of sign of a shape that is known at every floor tell which mode it is."
        )
    if of.verdict == "ambiguous":
        return "No added mass up to that of a floor would tell the rivals apart."
    return "Nothing: no rival is left that another test would have to tell apart."


def _with_sensors(of: Closure, test: NextTest) -> str:
    """Which floors are to be measured too."""
    if test.measured_floors is None:
        return ""
    first = next(each for each in of.experiment.configurations if each.state == test.state)
    more = [str(floor) for floor in test.measured_floors if floor not in first.measured_floors]
    return (
        f", with {'a sensor' if len(more) == 1 else 'sensors'} at floor{'s' * (len(more) > 1)} {' and '.join(more)} too"
    )


def _effort(of: Closure) -> str:
    return f"Backend {of.backend}: {counted(of.fits, 'fit')}, {counted(of.programs, 'step program')}."
