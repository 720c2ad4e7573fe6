"""Section 6: the two-story steel test frame with three structures, Tables 4 to 8."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize

from cvxshear.backends import Backend
from cvxshear.fit.identification import identify
from cvxshear.io.toml import load
from cvxshear.model.shear import mass_matrix, modes, stiffness_matrix
from cvxshear.paper import tables
from cvxshear.paper.tables import KILO, PaperRow, PaperSection
from cvxshear.programs.pair_rows import normalized, stiffness_rows
from cvxshear.util.typing import Floats

PerStructure = Mapping[str, Any]
"""Numbers, or printed figures, of each structure by its name."""


class RecoveredShapes(NamedTuple):
    """Shapes of the two modes of a two-story frame.

    Parameters
    ----------
    first, second : float
        Ratio of the entries at floors 1 and 2.
    misfit : float
        Largest relative difference between the stiffnesses from Eq. 24 and the printed ones.
    """

    first: float
    second: float
    misfit: float


def recovered_shapes(floor_mass: Floats, story_stiffness: Floats, frequencies: Floats) -> RecoveredShapes:
    """Find the mode shapes that give these masses and stiffnesses in the paper's method.

    The method's final masses make the two measured modes orthogonal. So the ratio r of the first shape gives the
    ratio r2 of the second one: m1 r r2 + m2 = 0. Least squares finds the r that gives the stiffnesses by Eq. 24, two
    equations for one unknown; the residual shows whether both agree.

    Parameters
    ----------
    floor_mass : ndarray, shape (2,)
        Identified masses with added mass, kg.
    story_stiffness : ndarray, shape (2,)
        Identified stiffnesses, N/m.
    frequencies : ndarray, shape (2,)
        Measured frequencies, Hz.
    """
    eigenvalues = (2 * np.pi * frequencies) ** 2

    def second(first: float) -> float:
        return float(-floor_mass[1] / (floor_mass[0] * first))

    def misfit(ratio: Floats) -> Floats:
        shapes = np.array([[ratio[0], second(ratio[0])], [1.0, 1.0]])
        program = stiffness_rows(normalized(shapes, floor_mass), eigenvalues)
        return np.asarray(np.linalg.lstsq(program.R, program.s, rcond=None)[0] / story_stiffness - 1.0)

    model = modes(mass_matrix(floor_mass), stiffness_matrix(story_stiffness)).shapes[0]
    found = optimize.least_squares(misfit, [model[0] / model[1]], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    first = float(found.x[0])
    return RecoveredShapes(first, second(first), float(np.max(np.abs(found.fun))))


class SteelFrame:
    """Built-in measurement file `paper`; each structure is identified separately, as in the paper.

    Parameters
    ----------
    backend : str or Backend
    """

    def __init__(self, backend: str | Backend) -> None:
        self.experiment = load("paper")
        self.tested = {each.name: each for each in self.experiment.configurations}
        parts = {part.name: part for part in identify(self.experiment, "two-stage", backend).parts}
        self.net_mass = {name: parts[name].frame.floor_mass for name in tables.STRUCTURES}
        self.stiffness = {name: parts[name].frame.story_stiffness / KILO for name in tables.STRUCTURES}
        self.frequencies = {name: parts[name].predictions[0].frequencies for name in tables.STRUCTURES}
        self.mass = {name: net + self.tested[name].added_mass for name, net in self.net_mass.items()}

    def recovered(self, name: str) -> RecoveredShapes:
        """Compute the shapes of Fig. 8 from the printed figures of one structure."""
        printed = (tables.TABLE_6_MASS, tables.TABLE_6_STIFFNESS, tables.TABLE_5)
        mass, stiffness, frequencies = (tables.values(table[name]) for table in printed)
        return recovered_shapes(mass, KILO * stiffness, frequencies)


def sections(ours: SteelFrame) -> Iterator[PaperSection]:
    """Compute Tables 4 to 8, Fig. 8, and the conclusions of Section 7."""
    added = {name: each.added_mass for name, each in ours.tested.items()}
    measured = {name: each.frequencies for name, each in ours.tested.items()}
    inputs = (
        *_rows("Table 4", "counterweight of floor {}, kg", tables.TABLE_4, added),
        *_rows("Table 5", "f{}, Hz", tables.TABLE_5, measured),
        PaperRow("net total mass, kg", "Section 6", tables.TOTAL_NET_MASS, ours.experiment.frame.known_total or np.nan),
    )
    yield PaperSection("Tables 4 and 5: what is identified from", inputs, (tables.note("inputs"),), counted=False)
    shapes = {name: ours.recovered(name) for name in tables.STRUCTURES}
    in_file = {name: [f"{low / high:.5f}" for low, high in each.mode_shapes] for name, each in ours.tested.items()}
    ratios = _rows("Fig. 8", "mode {}, floor 1 / floor 2", in_file, {name: each[:2] for name, each in shapes.items()})
    notes = (tables.note("figure_8", misfit=max(each.misfit for each in shapes.values())),)
    title, source = "Fig. 8: mode shapes recovered from Table 6", "in the file `paper`"
    yield PaperSection(title, tuple(ratios), notes, printed_in=source, counted=False)
    identified = (
        *_rows("Table 6", "m{}, kg", tables.TABLE_6_MASS, ours.mass),
        *_rows("Table 6", "net m{}, kg", tables.TABLE_6_NET_MASS, ours.net_mass),
        *_rows("Table 6", "k{}, kN/m", tables.TABLE_6_STIFFNESS, ours.stiffness),
    )
    yield PaperSection("Table 6: identified masses and stiffnesses", identified)
    frequencies = _rows("Table 7", "f{}, Hz", tables.TABLE_7, ours.frequencies)
    yield PaperSection("Table 7: analytical frequencies", tuple(frequencies))
    printed = {name: tables.values(texts) for name, texts in tables.TABLE_7.items()}
    both = ours.frequencies, printed
    errors, rounded = ({name: 100 * (each[name] / seen - 1) for name, seen in measured.items()} for each in both)
    rows = tuple(_rows("Table 8", "f{}, %", tables.TABLE_8, errors, rounded))
    yield PaperSection("Table 8: errors of the analytical frequencies", rows, (tables.note("table_8"),))
    conclusions = (
        ("difference of a net mass", tables.NET_MASS_DIFFERENCE, _spread, ours.net_mass, tables.TABLE_6_NET_MASS),
        ("difference of a story stiffness", tables.STIFFNESS_DIFFERENCE, _spread, ours.stiffness,
         tables.TABLE_6_STIFFNESS),
        ("error of a frequency", tables.LARGEST_FREQUENCY_ERROR, _largest, errors, rounded),
    )  # fmt: skip
    largest = (
        PaperRow(f"largest {what}, %", "Section 7", text, measure(found), from_rounded=measure(of_printed))
        for what, text, measure, found, of_printed in conclusions
    )
    yield PaperSection("Section 7: largest differences", tuple(largest))


def _rows(
    table: str, what: str, printed: PerStructure, found: PerStructure, rounded: PerStructure | None = None
) -> Iterator[PaperRow]:
    for name in tables.STRUCTURES:
        own = None if rounded is None else rounded[name]
        yield from tables.rows(f"{table}, {name}", what, printed[name], found[name], own)


def _spread(found: PerStructure) -> float:
    """Compute the largest difference between structures, in percent of the largest: the paper's 2.41 and 5.73 %."""
    table = np.array([found[name] for name in tables.STRUCTURES], dtype=float)
    return 100 * float(np.max((table.max(axis=0) - table.min(axis=0)) / table.max(axis=0)))


def _largest(found: PerStructure) -> float:
    return float(max(np.max(np.abs(found[name])) for name in tables.STRUCTURES))
