"""Damage files: bytes, like disks and mail do, and words, like people and programs do."""

import re

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

JUNK = (
    b"", b"0", b"-1", b"1e300", b"-1e300", b"1e-300", b"1e999", b"nan", b"inf", b"1_000", b"0x10", b"9" * 400,
    b"9" * 5000, b"true", b"[]", b"[1, 2]", b"[[1.0], [2.0, 3.0]]", b"{}", b"{a = 1}", b'""', b'"\\u0000"',
    b'"\\u001b[31m"', b'"a\\nb"', b'"[red]"', b"'..'", b"2020-01-02", b"\x00", b"\xff\xfe", b"\xe2\x80\xae", b'"', b"'",
    b"#", b",", b";", b"\t", b"\r", b"\n\n", b"    -1", b"\xef\xbb\xbf", b"paper", b"100", b"2001", b"4294967295",
)  # fmt: skip
NUMBERS = (0, 1, 2, 3, 5, 8, 9, 13, 14, 15, 127, 128, 255, 0x7FFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x40000000)
WORD = re.compile(rb"[^\s,;=\[\]]+")

PLACES = st.floats(0, 1, exclude_max=True)


def many(examples: int, *more: Phase) -> settings:
    """Return the settings of a test that tries this many examples, in more phases than their generation."""
    return settings(
        max_examples=max(3, examples), deadline=None, database=None, suppress_health_check=list(HealthCheck),
        phases=(Phase.generate, *more),
    )  # fmt: skip


def damaged(most: int = 4) -> st.SearchStrategy:
    """Return edits. Each is a kind, two places as shares of the file, and a number."""
    kinds = ("flip", "cut", "drop", "double", "swap", "byte", "number", "word", "junk")
    edit = st.tuples(st.sampled_from(kinds), PLACES, PLACES, st.integers(0, 2**16))
    return st.lists(edit, min_size=1, max_size=most)


def apply(content: bytes, edits: list[tuple[str, float, float, int]]) -> bytes:
    """Apply the edits in order and return the file."""
    for edit in edits:
        content = _edited(content, *edit)
    return content


def _edited(content: bytes, kind: str, place: float, other: float, value: int) -> bytes:
    """Apply one edit, which replaces the bytes between two places."""
    at = int(place * len(content))
    words = list(WORD.finditer(content)) if kind == "word" else []
    word = words[int(place * len(words))].span() if words else (at, at)
    aligned, there, here = at - at % 4, int(other * len(content)), content[at : at + 1]
    start, end, put = {
        "flip": (at, at + 1, bytes([here[0] ^ 1 << value % 8]) if here else b""),
        "byte": (at, at + 1, bytes([value % 256])),
        # Sizes and counts are written like this.
        "number": (aligned, aligned + 4, NUMBERS[value % len(NUMBERS)].to_bytes(4, "little")),
        "cut": (at, len(content), b""),
        "drop": (at, at + 1 + value % 64, b""),
        "double": (at, at, content[at : at + 1 + value % 64]),
        "swap": (at, at + 16, content[there : there + 16]),
        "word": (*word, JUNK[value % len(JUNK)]),
        "junk": (at, at, JUNK[value % len(JUNK)]),
    }[kind]
    return content[:start] + put + content[end:]
