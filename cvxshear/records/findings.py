"""What a record gets wrong, in words: the sentences stand in `findings.toml`."""

import tomllib
from importlib import resources
from string import Formatter

from cvxshear.records.record import Finding
from cvxshear.util.typing import Json

SENTENCES: dict[str, str] = tomllib.loads(
    resources.files("cvxshear.records").joinpath("findings.toml").read_text(encoding="utf-8")
)
"""What is said of each kind of finding; behind a slash, of one case of that kind."""

SCALES = {"%": 1e2, "ms": 1e3, "ppm": 1e6}
"""Units that a gap may ask for, with the factor on a ratio or on seconds."""


class _Gaps(Formatter):
    """Fills gaps; one such as `{share:.0f %}` asks for a number in a unit."""

    def format_field(self, value: object, format_spec: str) -> str:
        form, _, unit = format_spec.partition(" ")
        return f"{format(SCALES[unit] * value, form)} {unit}" if unit else format(value, form)  # type: ignore[operator]


def finding(key: str, numbers: Json, /, **words: object) -> Finding:
    """Report something that is wrong with a record, or that it cannot tell.

    Parameters
    ----------
    key : str
        Of `SENTENCES`; what stands before a slash is the kind of finding.
    numbers : dict
        For programs, and for the gaps of the sentence.
    **words
        What else its gaps hold.
    """
    return Finding(key.partition("/")[0], _Gaps().vformat(SENTENCES[key], (), {**numbers, **words}), numbers)
