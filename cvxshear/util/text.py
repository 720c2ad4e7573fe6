"""Texts from outside: names are data, and what a person is shown of them must not steer the terminal."""

from __future__ import annotations


def printable(text: str) -> str:
    """A text in one line that a terminal takes for text: what would steer it stands as its escape.

    Control characters, line breaks, marks that turn the direction of writing, and halves of surrogate pairs.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode("ascii") for each in text)
