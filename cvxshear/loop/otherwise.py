"""The searches with the modes numbered as given and otherwise, each as far as it may still win.

A search among sets of effects that cannot mend a wrong number is long and in vain. So the shear model is fitted under
every numbering first, then the most promising take the effects that their linearised models promise, and only what is
still near the best is searched to its end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from cvxshear.loop.neighbors import holds_open
from cvxshear.loop.numbering import Numbering, named_numberings, overlooked_in_all, overlooked_in_one
from cvxshear.loop.search import REACH, Search
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.errors import CvxshearError

PROBED = 4
"""Numberings, the best by their shear models, that are probed with effects before one is searched to its end."""

CARRIED_OVER = 3
"""Best sets of effects of the leading numbering that are tried with every other one that is probed."""

FAR_BEHIND = 100.0
"""Logarithm of a probability ratio at which a numbering is given up once another one explains the data: the others by
their shear models, as effects that both need bring both as much; the numbers as given by the best that was tried."""

Begun = Callable[[Numbering], Search]


def searches(experiment: Experiment, begun: Begun, dual: Callable[[Search], Search | None]) -> list[Search]:
    """Run the searches that count: with the modes numbered as given, then with each numbering near the best.

    Each is searched to its end, but the one with the modes as given where others leave it far behind.

    Parameters
    ----------
    experiment : Experiment
    begun : callable
        The search under a numbering, its shear model fitted.
    dual : callable
        A search that starts at the dual of another's shear model; None where no frame has the same frequencies.

    Raises
    ------
    NoSolutionError
        Where the shear model could not be fitted to the modes as given.
    """
    given = begun(Numbering(experiment))
    others = list(_begun(named_numberings(experiment), begun))
    if not given.base.improbable:
        given.run()
    if given.base.improbable or given.best.effects:
        others += _begun(overlooked_in_all(experiment), begun)
    leader = _leader(given, others)
    if leader.best.improbable or holds_open(leader.best.effects):
        # Before a statement of the shear model is given up the numbers are doubted one test at a time.
        others += _begun(overlooked_in_one(experiment), begun)
        leader = _leader(given, others)
    leader.run()
    kept = _kept(given, others, leader)
    twins = [other for search in kept if (other := dual(search)) is not None]
    for search in (*kept, *twins):
        search.refine()
        search.visit_twins()
    return [*kept, *twins]


def _begun(numberings: Iterable[Numbering], begun: Begun) -> Iterator[Search]:
    for numbering in numberings:
        try:
            yield begun(numbering)
        except CvxshearError:
            # With these numbers the frame cannot be what was declared of it.
            continue


def _leader(given: Search, others: Sequence[Search]) -> Search:
    """Probe the most promising, and return the best of them."""
    if not others:
        return given
    promising = sorted(others, key=lambda search: -search.base.score)[: PROBED - 1]
    for search in (given, *promising):
        search.probe()
    return max((given, *promising), key=lambda search: search.best.score)


def _kept(given: Search, others: Sequence[Search], leader: Search) -> list[Search]:
    """Search what is near the best to its end, and the numbers as given where they may still win."""
    rest = sorted((each for each in (given, *others) if each is not leader), key=lambda search: -search.base.score)
    kept = {id(given), id(leader)}
    best = leader.best.score
    for search in rest:
        hopeless = not leader.best.improbable and search.base.score < leader.base.score - FAR_BEHIND
        if hopeless and search is not given:
            continue
        search.visit(model.effects for model in leader.beam[:CARRIED_OVER])
        behind = best - search.best.score
        if behind <= REACH or (search is given and (behind <= FAR_BEHIND or leader.best.improbable)):
            search.run()
            best = max(best, search.best.score)
            kept.add(id(search))
    return [search for search in (given, *others) if id(search) in kept]
