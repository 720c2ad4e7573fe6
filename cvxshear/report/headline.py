"""Write the verdict on a frame in one sentence, and describe the noise and the mode numbering."""

from collections.abc import Iterator, Sequence

from cvxshear.data import Frequencies, noise_kinds
from cvxshear.fit.efficient import Estimate
from cvxshear.loop import LoopResult
from cvxshear.loop.hypotheses import MANY_CAUSES, Changes
from cvxshear.loop.posterior import ADDED
from cvxshear.loop.results import VERDICTS, AddedEffect, by_part
from cvxshear.report.blocks import Section, section, table_of_rows
from cvxshear.util import ranking
from cvxshear.util.quantities import SURE, chance, listed, percent, percents, significant, with_std

#: Names of the first and the final model of the loop. The words "before" and "after" may be names of states.
MODELS = ("shear model", "with effects")


def numbers_in_words(changes: Changes) -> str:
    """Write the mode numbers, such as 'the modes of "ambient" are 1, 2 and 4 of the frame'.

    Parameters
    ----------
    changes : tuple of (str, tuple of int)
    """
    if not changes:
        return "the modes are those given"
    names: dict[tuple[int, ...], list[str]] = {}
    for name, modes in changes:
        names.setdefault(modes, []).append(f'"{name}"')
    said = [f"the modes of {listed(who)} are {listed([str(mode) for mode in modes])}" for modes, who in names.items()]
    return f"{listed(said)} of the frame"


def in_doubt(result: LoopResult) -> bool:
    """Return whether the second most probable numbering is possible."""
    return len(result.numberings) > 1 and result.numberings[1].probability > 1.0 - SURE


def numbering_section(result: LoopResult) -> Section:
    """Tabulate the probabilities of the numberings; without parts if the mode numbers were certain."""
    doubtful = [item for item in result.numberings if item.changes or len(result.numberings) > 1]
    rows = ((numbers_in_words(item.changes), chance(item.probability)) for item in doubtful)
    title, head = "Which modes of the frame were measured", ("numbering", "probability")
    return section("numbering", "Which modes these are", table_of_rows("numberings", title, head, rows))


def noise_facts(result: LoopResult) -> Iterator[tuple[str, str]]:
    """Yield the noise of each kind of data."""
    for kind in result.estimate.misfit.noises.values():
        name, estimated = f"noise of {kind.plural}", result.noise.of(kind.name)
        partly = any(datum.noise == kind and datum.declared for datum in result.estimate.misfit.data)
        if estimated is None:
            yield name, "as stated" if partly else "the default: neither stated nor told by the data"
            continue
        factor, std = estimated["factor"], estimated["std"]
        (size, size_std), unit = kind.sized(factor, std)
        where = ", where it is not stated" if partly else ""
        yield name, f"{with_std(size, size_std, unit)} (estimated: {with_std(factor, std)} times the default{where})"


def noise_in_words(result: LoopResult) -> str:
    """Write the estimated noise in a few words; empty if all noise was declared."""
    said = []
    for name, factor in result.noise.noise.factors:
        # The estimate also scales effects with many parameters; these scales are not noise.
        if (kind := result.estimate.misfit.noises.get(name)) is not None:
            (size,), unit = kind.sized(factor)
            said.append(f"{significant(size, 2)} {unit} of {kind.plural}")
    return f"an estimated noise of {listed(said)}" if said else ""


def plural_of(noise: str) -> str:
    """Name the data of a noise in the plural, such as "mode shapes" or "priors"."""
    return "priors" if noise == "prior" else noise_kinds()[noise].plural


#: Largest number of effects that a sentence names; a table lists more.
NAMED = 2


def some(texts: Sequence[str], word: str = "and") -> str:
    """List the first `NAMED` texts and count the others."""
    more = [f"{len(texts) - NAMED} more"] if len(texts) > NAMED else []
    return listed([*texts[:NAMED], *more], word)


def headline(result: LoopResult) -> str:
    """State the finding, its probability, and its influence on the error that decided the verdict.

    Parameters
    ----------
    result : LoopResult
    """
    found, spread = result.numberings[0], "in no single part" if result.provisional else ""
    added, before = bool(result.effects), result.before
    unmoved = _only_accuracy(result) if added else bool(found.changes)
    renumbered = ""
    if found.changes:
        before = result.steps[1]
        numbers = f"{numbers_in_words(found.changes)} ({chance(found.probability)} probable)"
        moved = change_in_words(result.before.estimate, before.estimate)
        renumbered = f"{numbers}, and with these numbers {moved}; "
    within = f"within {noise_in_words(result) or 'the stated noise'}"
    if result.estimate.dof <= 0:
        within = "exactly, as it has as many parameters as there are data"
    model = "the symmetric model" if result.experiment.symmetric else "the shear model"
    if result.assumed:
        model += f" with {listed([placed.label for placed in result.assumed])}"
    said = VERDICTS[result.verdict].says(
        added=added,
        model=model,
        found=_effects(result),
        doubt=_doubt(result),
        place=f"in {listed(result.remains[:2])}" if result.remains else spread,
        change="" if unmoved else change_in_words(before.estimate, result.estimate),
        within=within,
    )
    return f"{renumbered}{said}."


def _doubt(result: LoopResult) -> str:
    """Explain the uncertainty of the verdict."""
    doubtful = [item for item in result.effects if item.rivals]
    said = ""
    raised = [each for each in result.candidates if each.probability and each.probability > each.prior]
    if not result.effects and result.estimate.dof <= 0:
        return "nothing could speak against it, as there are no more data than unknowns"
    if not result.effects and raised and (result.verdict == "adequate" or not in_doubt(result)):
        best = raised[0]
        grown = f"{chance(best.probability)}, before {chance(best.prior)}"
        said = f"of what the data make more probable, {best.placed.label} comes first ({grown})"
    elif _piled(result):
        said = "so many kinds of cause at once are less probable than one that nobody thought of"
    elif doubtful and len(result.effects) <= NAMED:
        said = "; ".join(_rivals(item, several=len(result.effects) > 1) for item in doubtful)
    elif doubtful:
        said = f"in place of {len(doubtful)} of them something else would explain the data as well"
    elif in_doubt(result):
        said = f"perhaps {numbers_in_words(result.numberings[1].changes)} ({chance(result.numberings[1].probability)})"
    elif unsure := [item.placed.label for item in result.effects if item.probability < SURE]:
        which = "it is" if len(result.effects) == 1 else f"{listed(unsure)} {'is' if len(unsure) == 1 else 'are'}"
        said = f"that {which} there at all is less sure than 95 %"
    return said


def _effects(result: LoopResult) -> str:
    """Name the effects with their sizes and probabilities, or give their number and name the first.

    Provisional effects have no probability here: it would compare causes that all fail to explain the data.
    """
    said = [
        item.size if result.provisional
        else f"{item.story.change} ({chance(item.story.probability)} probable)" if item.story
        else f"{item.size[:-1]}; {chance(item.probability)} probable)" if item.size.endswith(")")
        else f"{item.size} ({chance(item.probability)} probable)"
        for item in result.effects
    ]  # fmt: skip
    if len(said) <= NAMED:
        return listed(said)
    if _piled(result):
        return f"{len(said)} effects together would explain the data, the first: {result.effects[0].size}"
    return f"{len(said)} effects were found, the first: {said[0]}"


def _piled(result: LoopResult) -> bool:
    """Return whether the frame, or one state with the frame, has too many kinds of uncertain effects to believe any."""
    kinds: dict[str | None, set[str]] = {}
    for item in result.effects:
        if item.probability < ADDED:
            kinds.setdefault(item.placed.place.state, set()).add(item.placed.effect.name)
    frame = kinds.pop(None, set())
    return len(frame) >= MANY_CAUSES or any(len(names) + len(frame) >= MANY_CAUSES for names in kinds.values())


def _rivals(item: AddedEffect, *, several: bool) -> str:
    """Name the rivals of an effect: first the indistinguishable ones, then the less probable ones."""
    parts = item.story.parts if item.story else {}
    rivals = [rival for rival in item.rivals if rival.placed not in parts]
    twins = [rival.placed.label for rival in rivals if rival.twin]
    others = [f"{rival.placed.label} ({chance(rival.probability)})" for rival in rivals if not rival.twin]
    mine = item.placed.label if several else "it"
    said = [f"whether {listed(list(parts.values()), 'or')}, these data do not tell"] if parts else []
    if twins:
        said.append(f"these data cannot distinguish {mine} from {listed(twins, 'or')}")
    if others:
        place = f"in place of {mine}" if several else "in its place"
        said.append(f"{listed(others, 'or')} would explain them as well {place}")
    return ", and ".join(said)


def chi2_by_kind(estimate: Estimate) -> dict[str, float]:
    """Compute chi-square of the residual of each kind of data, in the noise of the fit.

    Parameters
    ----------
    estimate : Estimate
    """
    sums: dict[str, float] = {}
    for part in by_part(estimate):
        sums[part.noise] = sums.get(part.noise, 0.0) + part.entries * part.deviations**2
    return sums


def carried_by(before: Estimate, after: Estimate) -> dict[str, float]:
    """Divide the decrease of chi-square among the kinds of data, the largest share first; empty without a decrease.

    Parameters
    ----------
    before, after : Estimate
        Fits with the same noise.
    """
    first, last = chi2_by_kind(before), chi2_by_kind(after)
    falls = {kind: max(value - last.get(kind, 0.0), 0.0) for kind, value in first.items()}
    if (total := sum(falls.values())) <= 0:
        return {}
    return {kind: falls[kind] / total for kind in ranking.ranked(falls, falls.__getitem__)}


def evidence_in_words(result: LoopResult) -> str:
    """Name the kind of data that supports the effects; empty without effects that reduce an error of the model.

    Parameters
    ----------
    result : LoopResult
    """
    # Less weight of the scattering data lowers the residuals of the others.
    share_of_kind = {} if _only_accuracy(result) else carried_by(result.before.estimate, result.estimate)
    if not share_of_kind:
        return ""
    kind = plural_of(next(iter(share_of_kind)))
    said = [
        f"{percent(part, 0)} lie in the {plural_of(each)}" for each, part in share_of_kind.items() if round(100 * part)
    ]
    if len(said) == 1:
        return f"The evidence lies in the {kind}."
    return f"Of the fall in chi-square, {listed(said)}."


def _only_accuracy(result: LoopResult) -> bool:
    """Return whether all effects only rescale noise; such effects reduce no error of the model."""
    return all(item.placed.effect.rescales for item in result.effects)


def change_in_words(before: Estimate, after: Estimate) -> str:
    """State the change of the leading error of the decisive kind of data, or else of the frequencies.

    Parameters
    ----------
    before, after : Estimate
    """
    share_of_kind = carried_by(before, after)
    carrying = [kind for name, kind in before.misfit.noises.items() if share_of_kind.get(name, 0.0) > 0.5]
    for kind in (*carrying, Frequencies.noise):
        if kind.leading is None or not (old := before.quality.errors[kind.leading.key]):
            continue
        new = after.quality.errors[kind.leading.key] or 0.0
        first, last = percents([old, new])
        moved = f"stays at {last}" if first == last else f"{'falls' if new < old else 'rises'} from {first} to {last}"
        return f"the {kind.leading.label} {moved}"
    return ""
