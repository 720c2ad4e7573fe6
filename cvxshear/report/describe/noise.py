"""The noise that a result rests on: declared, or estimated beside the default standard deviations."""

from __future__ import annotations

from collections.abc import Iterator

from cvxshear.loop import Closure
from cvxshear.measurement.configuration import DEFAULT_FREQUENCY_STD, DEFAULT_MODE_SHAPE_STD
from cvxshear.measurement.static_test import DEFAULT_DISPLACEMENT_STD
from cvxshear.report.describe.vocabulary import Facts
from cvxshear.util.quantities import listed, significant, with_std

DEFAULTS = {
    "frequency": DEFAULT_FREQUENCY_STD,
    "mode_shape": DEFAULT_MODE_SHAPE_STD,
    "displacement": DEFAULT_DISPLACEMENT_STD,
}


def noise_facts(of: Closure) -> Facts:
    """For each kind of data the noise that counts."""
    return Facts(tuple(_facts(of)))


def _facts(of: Closure) -> Iterator[tuple[str, str]]:
    estimated = {kind: item for kind, item in of.noise.to_dict().items() if item is not None}
    for kind in dict.fromkeys(datum.noise for datum in of.estimate.misfit.data):
        name = f"noise of {_plural(kind)}"
        if kind not in estimated:
            yield name, "as declared"
            continue
        factor, std = estimated[kind]["factor"], estimated[kind]["std"]
        size = with_std(100 * factor * DEFAULTS[kind], 100 * std * DEFAULTS[kind], "%")
        partly = any(datum.noise == kind and datum.declared for datum in of.estimate.misfit.data)
        where = ", where it is not declared" if partly else ""
        yield name, f"{size} (estimated: {with_std(factor, std)} times the default{where})"


def noise_in_words(of: Closure) -> str:
    """The estimated noise in a few words; empty where all of it was declared."""
    found = of.noise.noise.factors
    said = [f"{significant(100 * factor * DEFAULTS[kind], 2)} % of {_plural(kind)}" for kind, factor in found]
    return f"an estimated noise of {listed(said)}" if said else ""


def _plural(kind: str) -> str:
    words = kind.replace("_", " ")
    return f"{words[:-1]}ies" if words.endswith("y") else f"{words}s"
