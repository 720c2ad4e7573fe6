"""Findings about a record; their sentences are in `findings.toml`."""

import tomllib
from importlib import resources
from string import Formatter

from cvxshear.records.record import Finding
from cvxshear.util.typing import Json

SENTENCES: dict[str, str] = tomllib.loads(
    resources.files("cvxshear.records").joinpath("findings.toml").read_text(encoding="utf-8")
)
"""Sentence of each kind of finding; a key with a slash is one case of a kind."""

SCALES = {"%": 1e2, "ms": 1e3, "ppm": 1e6}
"""Units of gaps, with the factor for a ratio or for seconds."""


class _Gaps(Formatter):
    """Fills gaps; for example `{share:.0f %}` is a number with a unit."""

    def format_field(self, value: object, format_spec: str) -> str:
        form, _, unit = format_spec.partition(" ")
        return f"{format(SCALES[unit] * value, form)} {unit}" if unit else format(value, form)  # type: ignore[operator]


def finding(key: str, numbers: Json, /, **words: object) -> Finding:
    """Report something that is wrong with a record, or that it cannot tell.

    Parameters
    ----------
    key : str
        Key of `SENTENCES`; the part before a slash is the kind of finding.
    numbers : dict
        For programs, and for the gaps of the sentence.
    **words
        What else its gaps hold.
    """
    return Finding(key.partition("/")[0], _Gaps().vformat(SENTENCES[key], (), {**numbers, **words}), numbers)
