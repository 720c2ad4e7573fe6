"""What looks wrong in a measurement file or a record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cvxshear.report.describe.dispatch import describe
from cvxshear.report.describe.vocabulary import Block, Document, Facts, Section, Sentence
from cvxshear.screening import Finding, Screening
from cvxshear.util.quantities import AUTOMATIC, Units, counted, listed


@describe.register
def _screening(of: Screening, units: Units = AUTOMATIC) -> Document:
    accepted = [Sentence(f"accepted beforehand: {', '.join(of.accepted)}")] if of.accepted else []
    parts = [*accepted, *(part for item in of.findings for part in _finding(item)), *_record(of)]
    return Document(of.name, f"{of.name}: {_headline(of)}", (Section("findings", "", tuple(parts)),))


def _headline(of: Screening) -> str:
    mistakes = sum(item.refuses for item in of.findings)
    numbers = {"mistake": mistakes, "doubt": len(of.findings) - mistakes, "remark": len(of.record)}
    return listed([counted(number, noun) for noun, number in numbers.items() if number]) or "nothing looks wrong"


def _finding(item: Finding) -> Iterator[Block]:
    """A finding with what to change."""
    word, tone = ("MISTAKE", "mistake") if item.refuses else ("WARNING", "warning")
    where = f' in configuration "{item.configuration}"' if item.configuration else ""
    yield Sentence(f"{word}: {' or '.join((item.name, *item.rivals))}{where}", tone)
    yield Facts(
        (
            ("  found", item.found),
            ("  change", item.change),
            ("  accept", f"{item.how_to_accept}, if it is right as it is"),
        )
    )


def _record(of: Screening) -> Iterator[Block]:
    """What a record's own diagnostics say."""
    for item in of.record:
        yield Sentence(f"RECORD: {item.kind}", "warning")
        yield Facts((("  found", item.message),))


def doubts_section(found: Sequence[Finding]) -> Section:
    """Doubts above a result that was computed all the same, a line each."""
    said = (f"WARNING: {item.found}; {item.change} ({item.how_to_accept} silences this)" for item in found)
    return Section("doubts", "", tuple(Sentence(each, "warning") for each in said))
