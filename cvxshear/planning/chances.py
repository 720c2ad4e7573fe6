"""How probable it is, before a test, that the loop will come to the right verdict on a few effects.

Where the model is linear and the noise Gaussian, all that the data say of the effects is y = G x + e, x their values in
units of their expected size, G the information about them with the frame's masses and stiffnesses marginalised, and
cov(e) = G (`fit/separation.py`). From the evidence of each effect alone and even odds follows a probability of each.
The verdict is right where the effect that is there has 95 %; where there is none, where none has a half, from which on
one would be added.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.effects import Place, Placed, Scale, named
from cvxshear.fit.separation import log_evidence
from cvxshear.loop.conclusion import EXPLAINED
from cvxshear.loop.posterior import ADDED
from cvxshear.measurement.experiment import Frame
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats

DRAWS = 20_000
"""Simulated outcomes a possibility: a probability of 90 % is then known to 0.2 %."""

DRAWS_SEED = 2014
"""Seed of these, so that a plan comes out the same each time."""

SUFFICES = 0.9
"""Probability of the right verdict from which on a test is said to suffice: nine tests in ten."""

NONE = "none of them"
"""What the possibility is called that no effect is there."""


@dataclass(frozen=True)
class Target:
    """An effect of one parameter at a place, with the size that it would have.

    Parameters
    ----------
    placed : Placed
    size : float
        How far its parameter would be from the null value, in its unit.
    unit : str
    """

    placed: Placed
    size: float
    unit: str = ""

    @property
    def null(self) -> float:
        """The value at which the effect vanishes."""
        return self.placed.effect.parameters[0].null

    @property
    def mean(self) -> float:
        """The value expected if the effect is there, in sizes: 1 where physics confines it to an interval without 0."""
        return 1.0 if self._confined else 0.0

    @property
    def std(self) -> float:
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
    """Return the effect that "NAME", "NAME@PLACE", or either with "=SIZE", stands for.

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
    try:
        value = float(size) if size else usual
    except ValueError:
        raise InputError(f"the size in {text!r} must be a number, not {size!r}") from None
    unit = item.unit if frame.story_heights is not None else item.unit_in_stories or item.unit
    return Target(Placed(effect, place), checks.number(value, f"size of {head.strip()}", above=0.0), unit)


def _place(name: str, sits_at: tuple[str, ...], lowest: int, where: str, stories: int) -> Place:
    """Return the place that stands behind the @."""
    if not sits_at:
        if where:
            raise InputError(f"effect {name} has no place of its own; write {name} alone, not {name}@{where}")
        return Place()
    kind = sits_at[0]
    if not where.isdigit():
        raise InputError(f"effect {name} sits at a {kind}; write which, such as {name}@{max(lowest, 2)}")
    number = checks.whole(int(where), f"{kind} of effect {name}", least=lowest if kind == "floor" else 1, most=stories)
    return Place(floor=number) if kind == "floor" else Place(story=number)


@dataclass(frozen=True)
class Chance(InJson):
    """What becomes of one of the possibilities.

    Parameters
    ----------
    label : str
        The effect at its place, or "none of them".
    size : float or None
        That it is expected to have.
    unit : str or None
        Of the size.
    distance : float or None
        Standard deviations that its effect on the data is from none, the frame following.
    nearest : str or None
        What it is hardest to distinguish from.
    nearest_distance : float or None
        Standard deviations from that, whatever the size of the other.
    probability : float
        That the verdict is right if it is this.
    """

    label: str
    size: float | None
    unit: str | None
    distance: float | None
    nearest: str | None
    nearest_distance: float | None
    probability: float

    json_keys = (
        "effect=label size unit standard_deviations=distance nearest "
        "nearest_standard_deviations=nearest_distance probability"
    )

    @property
    def suffices(self) -> bool:
        """Whether these tests can be said to show it."""
        return self.probability >= SUFFICES


def chances(targets: Sequence[Target], information: Floats) -> tuple[Chance, ...]:
    """Say what becomes of each possibility: none of the effects, or one of them.

    Parameters
    ----------
    targets : sequence of Target
    information : ndarray, shape (q, e, e)
        G for each frame that the design values allow: distances and probabilities are averages over these.
    """
    right = np.mean([_right(targets, G) for G in information], axis=0)
    own = np.mean(np.sqrt(np.diagonal(information, axis1=1, axis2=2)), axis=0)
    pairs = np.mean([_distances(targets, G) for G in information], axis=0)
    least = int(np.argmin(own))
    result = [Chance(NONE, None, None, None, targets[least].placed.label, float(own[least]), float(right[0]))]
    for i, each in enumerate(targets):
        near = [(float(own[i]), NONE)]
        near += [(float(pairs[i, j]), other.placed.label) for j, other in enumerate(targets) if j != i]
        distance, nearest = min(near)
        result.append(
            Chance(each.placed.label, each.size, each.unit, float(own[i]), nearest, distance, float(right[i + 1]))
        )
    return tuple(result)


def _distances(targets: Sequence[Target], G: Floats) -> Floats:
    """Compute standard deviations of each effect (row) from the value of each other that does most like it, (e, e).

    That value is among those that physics allows.
    """
    own = np.diag(G)
    allowed = np.array([[G[i, j] * other.side >= 0 for j, other in enumerate(targets)] for i in range(len(targets))])
    return np.asarray(np.sqrt(np.maximum(own[:, None] - np.where(allowed, G**2 / own[None, :], 0.0), 0.0)))


def _right(targets: Sequence[Target], G: Floats) -> list[float]:
    """Probability of the right verdict if there is none of the effects, and for each if it is there."""
    rng = np.random.default_rng(DRAWS_SEED)
    noise = rng.standard_normal((DRAWS, len(targets))) @ np.linalg.cholesky(G).T
    result = []
    for truth in range(len(targets) + 1):
        y = noise if truth == 0 else noise + G[:, truth - 1]
        found = [log_evidence(float(G[i, i]), y[:, i], t.mean, t.std, t.side) for i, t in enumerate(targets)]
        evidence = np.stack([np.zeros(DRAWS), *found], axis=1)
        likely = np.exp(evidence - evidence.max(axis=1, keepdims=True))
        likely /= likely.sum(axis=1, keepdims=True)
        right = likely[:, truth] >= EXPLAINED if truth else likely[:, 1:].max(axis=1) < ADDED
        result.append(float(np.mean(right)))
    return result
