"""Findings of the screening and the changes that they propose."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from importlib import resources

from cvxshear.util.results import InJson
from cvxshear.util.typing import Json


@dataclass(frozen=True)
class FileFinding(InJson):
    """One thing that looks wrong, and what to change.

    Parameters
    ----------
    name : str
        The word that `[frame] accept = [...]` takes.
    configuration : str or None
        Where it was found; None where it concerns the whole file.
    found : str
        What is there, a sentence.
    change : str
        What to change, a sentence.
    refuses : bool
        Whether the file is refused until the mistake is changed or accepted; otherwise a warning.
    rivals : tuple of str, optional
        Names of other mistakes that `change` proposes as well; to accept one of them is to accept the finding.
    """

    name: str
    configuration: str | None
    found: str
    change: str
    refuses: bool
    rivals: tuple[str, ...] = ()

    @staticmethod
    def of_changes(
        configuration: str | None, changes: Sequence[tuple[str, str, str]], evidence: str, *, refuses: bool
    ) -> FileFinding:
        """Make a finding with alternative changes: the mistakes, the evidence and the changes."""
        names = list(dict.fromkeys(name for name, _, _ in changes))
        found = f"{' or '.join(found for _, found, _ in changes)}: {evidence}"
        change = f"{'One of: ' if len(changes) > 1 else ''}{'; or '.join(change for _, _, change in changes)}"
        return FileFinding(names[0], configuration, found, change, refuses, tuple(names[1:]))

    def accepted(self, names: Collection[str]) -> bool:
        """Whether it is among these names."""
        return any(name in names for name in (self.name, *self.rivals))

    @property
    def how_to_accept(self) -> str:
        """The line of the measurement file that lets it pass."""
        return f'[frame] accept = ["{self.name}"]'


def in_json(found: Iterable[FileFinding] | None) -> Json:
    """List the findings for a result's JSON; empty without screening."""
    return {} if found is None else {"warnings": [item.to_dict() for item in found]}


WORDS_OF_FINDINGS: dict[str, dict[str, str]] = tomllib.loads(
    resources.files("cvxshear.screening").joinpath("words.toml").read_text(encoding="utf-8")
)
"""Sentence of each finding, and the proposed change; a key with a slash is one case of a finding."""


def in_words(key: str, /, **gaps: object) -> tuple[str, str, str]:
    """Name a finding, and say what it is and what to change, the gaps filled."""
    words = WORDS_OF_FINDINGS[key]
    return key.partition("/")[0], words["found"].format(**gaps), words["change"].format(**gaps)


def doubt(key: str, configuration: str | None = None, /, **gaps: object) -> FileFinding:
    """Make a finding that warns, in the words of its key."""
    name, found, change = in_words(key, **gaps)
    return FileFinding(name, configuration, found, change, refuses=False)
