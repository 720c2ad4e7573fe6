"""Effects that a test is to tell apart: where each sits, and which size it is expected to have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cvxshear.effects import Place, Placed, Scale, named
from cvxshear.measurement.experiment import Frame
from cvxshear.util import checks
from cvxshear.util.errors import InputError


@dataclass(frozen=True)
class Target:
    """An effect of one parameter at a place, with the size that it would have.

    Parameters
    ----------
    placed : Placed
    size : float
        How far its parameter would be from the null value, in its unit.
    """

    placed: Placed
    size: float

    @property
    def null(self) -> float:
        """The value at which the effect vanishes."""
        return self.placed.effect.parameters[0].null

    @property
    def mean(self) -> float:
        """The value expected if the effect is there, in sizes: 1 where physics confines it to an interval without 0."""
        return 1.0 if self._confined else 0.0

    @property
    def spread(self) -> float:
        """Standard deviation of the value if the effect is there, in sizes."""
        item = self.placed.effect.parameters[0]
        return (item.upper - item.lower) / np.sqrt(12) / self.size if self._confined else 1.0

    @property
    def side(self) -> int:
        """1 or -1 where physics lets the value be on that side of none alone, from none on; else 0."""
        item = self.placed.effect.parameters[0]
        return 0 if self._confined else int(item.lower == item.null) - int(item.upper == item.null)

    @property
    def _confined(self) -> bool:
        item = self.placed.effect.parameters[0]
        return bool(np.isfinite(item.upper - item.lower)) and not item.lower <= item.null <= item.upper


def target(text: str, frame: Frame, scale: Scale) -> Target:
    """The effect that "NAME", "NAME@PLACE", or either with "=SIZE", stands for.

    Parameters
    ----------
    text : str
        PLACE is a floor or a story, SIZE a change of the effect's parameter in its unit.
    frame : Frame
        With its number of stories.
    scale : Scale
        Of the frame, which effects expect their size in.

    Raises
    ------
    InputError
        Where the effect is not known, sits elsewhere, needs what the frame does not declare, or has no expected size.
    """
    head, _, size = text.partition("=")
    name, _, where = head.strip().partition("@")
    (effect,) = named([name.strip()])
    if "state" in effect.sits_at or len(effect.parameters) != 1:
        raise InputError(
            f"effect {effect.name} sits in a single state of the frame, and no plan is made for it; plan for effects "
            "that are there in every test, such as gravity or joint_rotation"
        )
    if "heights" in effect.needs and frame.story_heights is None:
        raise InputError(f"effect {effect.name} needs frame: story_heights, which is not declared")
    place = _place(effect.name, effect.sits_at, effect.lowest_floor, where.strip(), frame.stories)
    item = effect.parameters[0]
    expected = float(effect.expected_sizes(scale)[0])
    usual = expected if np.isfinite(expected) else abs(item.start - item.null)
    value = usual if not size else _number(size, text)
    return Target(Placed(effect, place), checks.number(value, f"size of {head.strip()}", above=0.0))


def _place(name: str, sits_at: tuple[str, ...], lowest: int, where: str, stories: int) -> Place:
    """The place that stands behind the @."""
    if not sits_at:
        if where:
            raise InputError(f"effect {name} has no place of its own; write {name} alone, not {name}@{where}")
        return Place()
    kind = sits_at[0]
    if not where.isdigit():
        raise InputError(f"effect {name} sits at a {kind}; write which, such as {name}@{max(lowest, 2)}")
    number = checks.whole(int(where), f"{kind} of effect {name}", least=lowest if kind == "floor" else 1, most=stories)
    return Place(floor=number) if kind == "floor" else Place(story=number)


def _number(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"the size in {whole!r} must be a number, not {text!r}") from None
