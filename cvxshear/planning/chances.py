"""Probability, before a test, of the right verdict of the loop on a few effects.

In a linear model with Gaussian noise, the data determine the effects by y = G x + e. Here x are the effects' values
relative to their expected sizes, G is the information about the effects with the frame's masses and stiffnesses
marginalized, and cov(e) = G (`fit/gaussian.py`). The evidence of each single effect and even prior odds give the
probability of each effect. If an effect is present, the verdict is right if this effect has a probability of 95 %. If
no effect is present, the verdict is right if all effects stay below 50 %, the limit for adding an effect.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.effects import LocatedEffect, Place, Scale, named
from cvxshear.fit.gaussian import log_evidence_of_one
from cvxshear.loop.posterior import ADDED
from cvxshear.measurement.experiment import Frame
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.odds import weigh
from cvxshear.util.quantities import SURE
from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats

DRAWS = 20_000
"""Number of simulated outcomes per possibility: the standard error of a probability of 90 % is 0.2 %."""

DRAWS_SEED = 2014
"""Seed of the simulated outcomes; a fixed seed makes plans repeatable."""

SUFFICES = 0.9
"""Least probability of the right verdict of a sufficient test: nine tests in ten."""

NONE = "none of them"
"""Label of the possibility without any effect."""


@dataclass(frozen=True)
class Target:
    """An effect with one parameter at a place, and its assumed size.

    Parameters
    ----------
    placed : LocatedEffect
    size : float
        Assumed distance of the parameter from its null value, in the parameter's unit.
    unit : str
    """

    placed: LocatedEffect
    size: float
    unit: str = ""

    @property
    def null(self) -> float:
        """Value without an effect."""
        return self.placed.effect.parameters[0].null

    @property
    def mean(self) -> float:
        """Expected value of a present effect, in sizes: 1 if physics confines the value to an interval without 0."""
        return 1.0 if self._confined else 0.0

    @property
    def std(self) -> float:
        """Standard deviation of the value of a present effect, in sizes."""
        item = self.placed.effect.parameters[0]
        return (item.upper - item.lower) / np.sqrt(12) / self.size if self._confined else 1.0

    @property
    def side(self) -> int:
        """1 or -1 if physics allows only values above or only values below the null value; else 0."""
        item = self.placed.effect.parameters[0]
        return 0 if self._confined else int(item.lower == item.null) - int(item.upper == item.null)

    @property
    def _confined(self) -> bool:
        item = self.placed.effect.parameters[0]
        return bool(np.isfinite(item.upper - item.lower)) and not item.lower <= item.null <= item.upper


def target(text: str, frame: Frame, scale: Scale) -> Target:
    """Parse an effect from "NAME" or "NAME@PLACE", optionally followed by "=SIZE".

    Parameters
    ----------
    text : str
        PLACE is a floor or a story, SIZE a change of the effect's parameter in its unit.
    frame : Frame
        Frame with its number of stories.
    scale : Scale
        Scale of the frame, for the expected sizes of effects.

    Raises
    ------
    InputError
        If the effect is unknown, has another kind of place, needs undeclared data, or has no expected size.
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
    return Target(LocatedEffect(effect, place), checks.number(value, f"size of {head.strip()}", above=0.0), unit)


def _place(name: str, sits_at: tuple[str, ...], lowest: int, where: str, stories: int) -> Place:
    """Parse the place after the @."""
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
    """Chance of the right verdict for one possibility.

    Parameters
    ----------
    label : str
        The effect at its place, or "none of them".
    size : float or None
        Expected size of the effect.
    unit : str or None
        Unit of the size.
    distance : float or None
        Distance from no effect, in standard deviations, with the frame's parameters unknown.
    nearest : str or None
        The possibility that is hardest to distinguish from this one.
    nearest_distance : float or None
        Distance from the nearest possibility, in standard deviations, for any size of the other effect.
    probability : float
        Probability of the right verdict if this possibility is true.
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
        """Whether these tests are sufficient for this possibility."""
        return self.probability >= SUFFICES


def chances(targets: Sequence[Target], information: Floats) -> tuple[Chance, ...]:
    """Compute the chance of the right verdict for each possibility: no effect, or one of the effects.

    Parameters
    ----------
    targets : sequence of Target
    information : ndarray, shape (q, e, e)
        G for each frame that the design values allow; distances and probabilities are averages over these frames.
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
    """Compute the distance of each effect (row) from the nearest value of each other effect, shape (e, e).

    Distances are in standard deviations. Only physically possible values count.
    """
    own = np.diag(G)
    allowed = np.array([[G[i, j] * other.side >= 0 for j, other in enumerate(targets)] for i in range(len(targets))])
    return np.asarray(np.sqrt(np.maximum(own[:, None] - np.where(allowed, G**2 / own[None, :], 0.0), 0.0)))


def _right(targets: Sequence[Target], G: Floats) -> list[float]:
    """Compute the probability of the right verdict without any effect, and with each effect."""
    rng = np.random.default_rng(DRAWS_SEED)
    noise = rng.standard_normal((DRAWS, len(targets))) @ np.linalg.cholesky(G).T
    result = []
    for truth in range(len(targets) + 1):
        y = noise if truth == 0 else noise + G[:, truth - 1]
        found = [log_evidence_of_one(float(G[i, i]), y[:, i], t.mean, t.std, t.side) for i, t in enumerate(targets)]
        evidence = np.stack([np.zeros(DRAWS), *found], axis=1)
        likely = weigh(evidence)
        right = likely[:, truth] >= SURE if truth else likely[:, 1:].max(axis=1) < ADDED
        result.append(float(np.mean(right)))
    return result
