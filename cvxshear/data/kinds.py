"""Which kinds of data there are."""

from __future__ import annotations

from cvxshear.data.base import Datum, NoiseKind
from cvxshear.data.frequencies import Frequencies
from cvxshear.data.shapes import Shapes
from cvxshear.data.static import Static
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.errors import InputError

_kinds: dict[str, type[Datum]] = {kind.__name__: kind for kind in (Frequencies, Shapes, Static)}


def register(kind: type[Datum]) -> None:
    """Add a kind of datum; one of the same name is replaced.

    Raises
    ------
    InputError
        Where it declares no noise, or another kind has a different noise of that name.
    """
    noise = getattr(kind, "noise", None)
    if not isinstance(noise, NoiseKind):
        raise InputError(f"{kind.__name__}.noise is {noise!r}: declare a NoiseKind")
    for other in _kinds.values():
        if other.__name__ != kind.__name__ and other.noise.name == noise.name and other.noise != noise:
            raise InputError(f"{kind.__name__}.noise: the name {noise.name!r} is that of the noise of {other.__name__}")
    _kinds[kind.__name__] = kind


def noise_kinds() -> dict[str, NoiseKind]:
    """List the noise of every kind of data, by its name."""
    return {kind.noise.name: kind.noise for kind in _kinds.values()}


def data_of(experiment: Experiment) -> list[Datum]:
    """All data of an experiment, kind by kind within each tested state."""
    found = [datum for kind in _kinds.values() for datum in kind.of(experiment)]
    order = {id(tested): place for place, tested in enumerate(experiment.tested)}
    return sorted(found, key=lambda datum: order[id(datum.tested)])
