"""Replace the outputs on pages by the current ones: `python -m tests.docs.rewrite PAGE ...`.

An output with "..." is replaced line by line; a line without a similar printed one stays and is named.
"""

import difflib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

from tests.docs import runner
from tests.docs.test_blocks import NUMBER, ROOT, alike, missing, name_of, shown_outputs

RESEMBLES = 0.6
"""Least likeness (`difflib`) of a line shown and the one printed in its place, numbers left out: a table whose columns
were renamed is found, a line of another table is not."""


def printed_by(page: Path) -> dict[str, str]:
    """Return the output of each block of a page, by the keys of `runner.run_page`."""
    found = subprocess.run(
        [sys.executable, "-W", "error", runner.__file__, str(ROOT / "examples"), str(page)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONSAFEPATH": "1"},
    )
    return json.loads(found.stdout)[str(page)]


def renewed(shown: str, printed: str) -> tuple[str, list[str]]:
    """The output as the page should show it, and the lines for which nothing printed is there."""
    if "..." not in shown.split():
        return "\n".join(line.rstrip() for line in printed.strip("\n").splitlines()), []
    others, at, lines, lost = printed.splitlines(), 0, [], []
    for line in shown.splitlines():
        place = None if line.strip() in ("", "...") else nearest(line, others, at)
        if place is None:
            lost += [line] if line.strip() not in ("", "...") else []
            lines.append(line)
        else:
            lines.append(line if alike(line, others[place]) else cut_as(line, others[place]))
            at = place + 1
    return "\n".join(lines), lost


def nearest(line: str, others: list[str], start: int) -> int | None:
    """Index, from `start` on, of the line that agrees, else of the one that resembles it most."""
    for place in range(start, len(others)):
        if alike(line, others[place]):
            return place
    likeness = {place: resemblance(line, others[place]) for place in range(start, len(others))}
    best = max(likeness, key=lambda place: likeness[place], default=None)
    return best if best is not None and likeness[best] >= RESEMBLES else None


def resemblance(line: str, other: str) -> float:
    """How alike two lines are but for their numbers and for what "..." leaves out."""
    words = NUMBER.sub("#", cut_as(line, other)).split()
    return difflib.SequenceMatcher(None, NUMBER.sub("#", line).split(), words).ratio()


def cut_as(line: str, other: str) -> str:
    """Shorten the line `other` by "..." like `line`, with an equal number of words before and after it."""
    if "..." not in line.split():
        return other.rstrip()
    before, _, after = (part.split() for part in line.partition("..."))
    words = list(re.finditer(r"\S+", other))
    first, last = min(len(before), len(words)), min(len(after), len(words))
    kept = other[: words[first - 1].end()] + " " if first else ""
    return f"{kept}... {other[words[-last].start() :] if last else ''}".rstrip()


def rewrite(page: Path) -> bool:
    """Renew the outputs of a page; whether every one of them could be."""
    printed, text = printed_by(page), page.read_text(encoding="utf-8")
    complaints = [printed["error"]] if "error" in printed else []
    for key, shown in shown_outputs(page):
        if key in printed and missing(shown, printed[key]):
            now, lost = renewed(shown, printed[key])
            complaints += [f"line {key} prints nothing like: {line}" for line in lost]
            if text.count(shown) == 1:
                text = text.replace(shown, now)
            else:
                complaints.append(f"line {key}: the same output stands on the page twice")
    page.write_text(text, encoding="utf-8")
    for complaint in complaints:
        print(f"{name_of(page)}: {complaint}", file=sys.stderr)
    return not complaints


if __name__ == "__main__":
    renewed_all = [rewrite(Path(name).resolve()) for name in sys.argv[1:]]
    sys.exit(0 if all(renewed_all) else 1)
