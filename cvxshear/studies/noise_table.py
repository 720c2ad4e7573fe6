"""The noise study on a terminal and in Markdown, from the same lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from cvxshear.studies.noise import NoiseStudy
from cvxshear.studies.scatter import Scatter
from cvxshear.studies.setups import Setup
from cvxshear.util.typing import Floats

Line = tuple[str, ...]
"""Method, figure, and its value for each parameter."""


@dataclass(frozen=True)
class Block:
    """One noise level: a title, the names of the columns, and a group of lines a method, the bound first."""

    title: str
    header: Line
    groups: tuple[tuple[Line, ...], ...]


def render(study: NoiseStudy) -> RenderableType:
    """The study as rich tables, one a noise level."""
    return Group(*(_rich(block) for block in blocks(study)), Text(note(study)))


def markdown(study: NoiseStudy) -> str:
    """The study as Markdown tables, one a noise level."""
    return "\n\n".join([*(_markdown(block) for block in blocks(study)), note(study)])


def percent(values: Floats, decimals: int = 2) -> Line:
    """Relative values in percent."""
    return tuple(f"{100 * value:.{decimals}f}" for value in values)


def _rich(block: Block) -> Table:
    result = Table(title=block.title, title_justify="left")
    for place, name in enumerate(block.header):
        result.add_column(name, justify="left" if place < 2 else "right")
    for group in block.groups:
        for line in group:
            result.add_row(*line)
        result.add_section()
    return result


def _markdown(block: Block) -> str:
    rule = f"|---|---|{'---:|' * (len(block.header) - 2)}"
    lines = [block.header, *(line for group in block.groups for line in group)]
    head, *body = (f"| {' | '.join(line)} |" for line in lines)
    return "\n".join([f"{block.title}\n", head, rule, *body])


def blocks(study: NoiseStudy) -> Iterator[Block]:
    """One block a noise level."""
    for setup, scatters in groupby(study.scatters, key=lambda each: each.setup):
        alike = list(scatters)
        least = ("least possible", "Cramér-Rao bound, %", *percent(alike[0].relative_bound))
        yield Block(_title(setup), _header(setup), ((least,), *(tuple(_lines(each)) for each in alike)))


def _title(setup: Setup) -> str:
    exact = "exact" if setup.exact_frequencies else f"with {100 * setup.frequency_std:g} %"
    noise = f"{setup.mode_shape_noise} shape noise {100 * setup.mode_shape_std:g} %"
    return f"{setup.name}; {noise}, frequencies {exact}"


def _header(setup: Setup) -> Line:
    numbers = range(1, setup.stories + 1)
    return ("method", "figure", *(f"m{i}" for i in numbers), *(f"k{i}" for i in numbers))


def _lines(scatter: Scatter) -> Iterator[Line]:
    """What is said of one method at one noise level."""
    lost = int(np.sum(~scatter.answered))
    method = f"{scatter.method} ({lost} without an answer)" if lost else scatter.method
    yield method, "bias, %", *percent(scatter.bias, 3)
    yield "", "its standard error, %", *percent(scatter.bias_error, 3)
    yield "", "coefficient of variation, %", *percent(scatter.variation)
    yield "", "error, root mean square, %", *percent(scatter.rmse)
    yield "", "error / bound", *("" if np.isnan(value) else f"{value:.2f}" for value in scatter.ratio)
    if scatter.coverage is not None:
        yield "", "truth in the 95 % interval, %", *percent(scatter.coverage, 1)


def note(study: NoiseStudy) -> str:
    """What chance alone does to these figures."""
    ratio = 100 / np.sqrt(2 * study.samples)
    held = 100 * np.sqrt(0.95 * 0.05 / study.samples)
    return (
        f"{study.samples} samples a noise level, seed {study.seed}. Chance alone moves error / bound by ±{ratio:.1f} % "
        f"and the share of intervals by ±{held:.1f} (one standard deviation)."
    )
