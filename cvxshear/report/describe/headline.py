"""The verdict on a frame in a sentence that an engineer would say."""

from __future__ import annotations

from cvxshear.fit.quality import Quality
from cvxshear.loop import Closure
from cvxshear.loop.results import AddedEffect
from cvxshear.report.describe.noise import noise_in_words
from cvxshear.report.describe.numbering import in_doubt, numbers_in_words, other_numbers
from cvxshear.util.quantities import chance, listed, percents

NAMED = 2
"""Effects up to which a sentence names them all; more are a matter for the table."""

FELL = 0.9
"""Ratio of an error after to that before below which it fell."""


def headline(of: Closure) -> str:
    """What was found, how probable it is, and what it does to the errors.

    Parameters
    ----------
    of : Closure
    """
    says = {"adequate": _adequate, "explained": _explained, "ambiguous": _ambiguous, "unexplained": _unexplained}
    found = of.numberings[0]
    if not found.changes:
        return says[of.verdict](of)
    numbers = f"{numbers_in_words(found.changes)} ({chance(found.probability)} probable)"
    renumbered = change_in_words(of.before.estimate.quality, of.steps[1].estimate.quality)
    if of.effects or of.verdict == "unexplained":
        return f"{numbers}, and with these numbers {renumbered}; {says[of.verdict](of)}"
    doubt = f"; but perhaps {other_numbers(of)} ({chance(of.numberings[1].probability)})" if in_doubt(of) else ""
    return f"{numbers}; so numbered, {_model(of)} explains the data, and {renumbered}{doubt}."


def _adequate(of: Closure) -> str:
    model = _model(of)
    if of.estimate.dof <= 0:
        return f"there is nothing to test: {model} has as many parameters as there are data."
    noise = noise_in_words(of)
    within = f" within {noise}" if noise else " within the declared noise"
    best = of.candidates[0] if of.candidates else None
    if best is None:
        return f"{model} explains the data{within}."
    likely = f"{best.placed.label} is the most probable ({chance(best.probability)})"
    return f"{model} explains the data{within}; of what it might lack, {likely}."


def _explained(of: Closure) -> str:
    return f"{_model(of)} lacks {_effects(of.effects)}; with {_them(of)} {_change(of)}."


def _ambiguous(of: Closure) -> str:
    if not of.effects:
        return f"{_model(of)} explains the data, but {_doubt(of)}."
    return f"{_model(of)} lacks {_effects(of.effects)}, but {_doubt(of)}; with {_them(of)} {_change(of)}."


def _doubt(of: Closure) -> str:
    """Why the verdict is ambiguous."""
    doubtful = [item for item in of.effects if item.rivals]
    if not doubtful and in_doubt(of):
        return f"perhaps {other_numbers(of)} ({chance(of.numberings[1].probability)})"
    if not doubtful:
        return f"whether {_them(of).replace('them', 'each')} is there at all is less sure than 95 %"
    if len(of.effects) <= NAMED:
        return "; ".join(_rivals(item, several=len(of.effects) > 1) for item in doubtful)
    return f"in place of {len(doubtful)} of them something else would explain the data as well"


def _unexplained(of: Closure) -> str:
    where = listed(of.remains[:2])
    left = f"a significant residual is left, most of all in {where}" if where else "a significant residual is left"
    if not of.effects:
        return f"{left}; no effect that was looked for accounts for it."
    return f"{left}, though {_model(of)} is given {_effects(of.effects)}: with {_them(of)} {_change(of)}."


def _model(of: Closure) -> str:
    if not of.assumed:
        return "the shear model"
    return f"the shear model with {listed([placed.label for placed in of.assumed])}"


def _effects(effects: tuple[AddedEffect, ...]) -> str:
    said = [_sized(item) for item in effects]
    if len(said) <= NAMED:
        return listed(said)
    return f"{len(said)} effects, such as {said[0]}"


def _sized(item: AddedEffect) -> str:
    """An effect with its size, and how probable it is."""
    probable = f"{chance(item.probability)} probable)"
    return f"{item.size[:-1]}; {probable}" if item.size.endswith(")") else f"{item.size} ({probable}"


def _them(of: Closure) -> str:
    return "it" if len(of.effects) == 1 else "them"


def _rivals(item: AddedEffect, *, several: bool) -> str:
    """What else it may be: what no datum tells from it first, then what is less probable."""
    twins = [rival.placed.label for rival in item.rivals if rival.twin]
    others = [f"{rival.placed.label} ({chance(rival.probability)})" for rival in item.rivals if not rival.twin]
    mine = item.placed.label if several else "it"
    said = []
    if twins:
        said.append(f"these data cannot tell {mine} from {listed(twins, 'or')}")
    if others:
        place = f"in place of {mine}" if several else "in its place"
        said.append(f"{listed(others, 'or')} would explain them as well {place}")
    return ", and ".join(said)


def _change(of: Closure) -> str:
    """What the effects change; what other numbers of the modes do to the errors is said by itself."""
    before = of.steps[1] if of.numberings[0].changes else of.before
    return change_in_words(before.estimate.quality, of.after.estimate.quality)


def change_in_words(before: Quality, after: Quality) -> str:
    """What became of the error that changed: that of the frequencies, or else that of the shapes.

    Parameters
    ----------
    before, after : Quality
    """
    frequency = (before.max_frequency_error, after.max_frequency_error)
    shape = (before.max_shape_error or 0.0, after.max_shape_error or 0.0)
    if frequency[1] > FELL * frequency[0] and shape[1] < FELL * shape[0]:
        return _moves("the largest mode-shape error", *shape)
    return _moves("the largest frequency error", *frequency)


def _moves(what: str, before: float, after: float) -> str:
    first, last = percents([before, after])
    if first == last:
        return f"{what} stays at {last}"
    return f"{what} {'falls' if after < before else 'rises'} from {first} to {last}"
