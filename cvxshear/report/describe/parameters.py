"""Parameters of a frame in words."""

from __future__ import annotations

from collections.abc import Iterable

from cvxshear.util.quantities import listed, ranged

PLURALS = {"floor_mass": "floor masses", "story_stiffness": "story stiffnesses"}
"""Of what a frame has one at each floor or story."""


def in_words(names: Iterable[str]) -> str:
    """Names of parameters as people say them: "story stiffnesses 1 to 4 and floor mass 2".

    Parameters
    ----------
    names : iterable of str
        Such as "story_stiffness 3"; others, such as "gravity: gamma", stand as they are.
    """
    places: dict[str, list[int]] = {}
    for name in names:
        kind, _, place = name.rpartition(" ")
        known = kind in PLURALS and place.isdecimal()
        places.setdefault(kind if known else name, []).extend([int(place)] if known else [])
    said = []
    for kind, at in places.items():
        plain = (PLURALS[kind] if len(at) > 1 else kind).replace("_", " ")
        said.append(f"{plain} {ranged(sorted(at))}" if at else plain)
    return listed(said)
