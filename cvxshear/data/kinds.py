"""Which kinds of data there are."""

from __future__ import annotations

from cvxshear.data.base import Datum
from cvxshear.data.frequencies import Frequencies
from cvxshear.data.shapes import Shapes
from cvxshear.data.static import Static
from cvxshear.measurement.experiment import Experiment

_kinds: dict[str, type[Datum]] = {kind.__name__: kind for kind in (Frequencies, Shapes, Static)}


def register(kind: type[Datum]) -> None:
    """Add a kind of datum; one of the same name is replaced."""
    _kinds[kind.__name__] = kind


def data_of(experiment: Experiment) -> list[Datum]:
    """All data of an experiment, kind by kind within each tested state."""
    found = [datum for kind in _kinds.values() for datum in kind.of(experiment)]
    order = {id(tested): place for place, tested in enumerate(experiment.tested)}
    return sorted(found, key=lambda datum: order[id(datum.tested)])
