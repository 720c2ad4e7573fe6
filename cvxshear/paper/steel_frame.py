"""Section 6: the two-story steel test frame in three structures, Tables 4 to 8."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from scipy import optimize

from cvxshear.backends import Backend
from cvxshear.files.toml import load
from cvxshear.methods import identify
from cvxshear.model.shear import mass_matrix, modes, stiffness_matrix
from cvxshear.paper import tables
from cvxshear.paper.tables import KILO, Row, Section
from cvxshear.programs import story_stiffnesses
from cvxshear.programs.orthogonality import normalized
from cvxshear.util.typing import Floats


class RecoveredShapes(NamedTuple):
    """The two modes of a two-story frame.

    Parameters
    ----------
    first, second : float
        Entry at floor 1 over that at floor 2.
    misfit : float
        Largest relative distance of the stiffnesses that Eq. 24 gives from the printed ones.
    """

    first: float
    second: float
    misfit: float


def recovered_shapes(floor_mass: Floats, story_stiffness: Floats, frequencies: Floats) -> RecoveredShapes:
    """Find the mode shapes from which the paper's method finds these masses and stiffnesses.

    The method ends at masses on which two measured modes are orthogonal, so the second shape follows from the
    first one's ratio r: m1 r r2 + m2 = 0. That r for which Eq. 24 returns the stiffnesses is found by least
    squares, two equations for one unknown; what is left shows whether the two agree.

    Parameters
    ----------
    floor_mass : ndarray, shape (2,)
        Identified, with added mass, kg.
    story_stiffness : ndarray, shape (2,)
        Identified, N/m.
    frequencies : ndarray, shape (2,)
        Measured, Hz.
    """
    eigenvalues = (2 * np.pi * frequencies) ** 2

    def second(first: float) -> float:
        return float(-floor_mass[1] / (floor_mass[0] * first))

    def misfit(ratio: Floats) -> Floats:
        shapes = np.array([[ratio[0], second(ratio[0])], [1.0, 1.0]])
        program = story_stiffnesses(normalized(shapes, floor_mass), eigenvalues)
        return np.asarray(np.linalg.lstsq(program.R, program.s, rcond=None)[0] / story_stiffness - 1.0)

    model = modes(mass_matrix(floor_mass), stiffness_matrix(story_stiffness)).shapes[0]
    found = optimize.least_squares(misfit, [model[0] / model[1]], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    first = float(found.x[0])
    return RecoveredShapes(first, second(first), float(np.max(np.abs(found.fun))))


class SteelFrame:
    """The built-in measurement file `paper`, each structure identified by itself as the paper does.

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

    @property
    def mass(self) -> dict[str, Floats]:
        """Floor masses, counterweights included, kg."""
        return {name: net + self.tested[name].added_mass for name, net in self.net_mass.items()}

    def recovered(self, name: str) -> RecoveredShapes:
        """Read the shapes of Fig. 8 from the printed figures of one structure."""
        printed = (tables.TABLE_6_MASS, tables.TABLE_6_STIFFNESS, tables.TABLE_5)
        mass, stiffness, frequencies = (tables.values(table[name]) for table in printed)
        return recovered_shapes(mass, KILO * stiffness, frequencies)


def sections(ours: SteelFrame) -> Iterator[Section]:
    """Tables 4 to 8, Fig. 8, and what Section 7 concludes from them."""
    notes = (tables.note("inputs"),)
    yield Section("Tables 4 and 5: what is identified from", tuple(_inputs(ours)), notes, counted=False)
    yield _figure_8(ours)
    identified = (
        *_rows("Table 6", "m{}, kg", tables.TABLE_6_MASS, ours.mass),
        *_rows("Table 6", "net m{}, kg", tables.TABLE_6_NET_MASS, ours.net_mass),
        *_rows("Table 6", "k{}, kN/m", tables.TABLE_6_STIFFNESS, ours.stiffness),
    )
    yield Section("Table 6: identified masses and stiffnesses", identified)
    frequencies = _rows("Table 7", "f{}, Hz", tables.TABLE_7, ours.frequencies)
    yield Section("Table 7: analytical frequencies", tuple(frequencies))
    notes = (tables.note("table_8"),)
    yield Section("Table 8: errors of the analytical frequencies", tuple(_table_8(ours)), notes)
    yield Section("Section 7: largest differences", tuple(_conclusions(ours)))


def _rows(table: str, what: str, printed: Mapping[str, tuple[str, ...]], found: Mapping[str, Floats]) -> Iterator[Row]:
    for name in tables.STRUCTURES:
        for place, (text, number) in enumerate(zip(printed[name], found[name], strict=True), 1):
            yield Row(what.format(place), f"{table}, {name}", text, float(number))


def _inputs(ours: SteelFrame) -> Iterator[Row]:
    added = {name: each.added_mass for name, each in ours.tested.items()}
    measured = {name: each.frequencies for name, each in ours.tested.items()}
    yield from _rows("Table 4", "counterweight of floor {}, kg", tables.TABLE_4, added)
    yield from _rows("Table 5", "f{}, Hz", tables.TABLE_5, measured)
    total = ours.experiment.frame.total_mass
    yield Row("net total mass, kg", "Section 6", tables.TOTAL_NET_MASS, float("nan") if total is None else total)


def _figure_8(ours: SteelFrame) -> Section:
    rows, misfits = [], []
    for name in tables.STRUCTURES:
        found = ours.recovered(name)
        misfits.append(found.misfit)
        shapes = ours.tested[name].mode_shapes
        for mode, ratio in enumerate((found.first, found.second)):
            in_file = shapes[mode, 0] / shapes[mode, 1]
            rows.append(Row(f"mode {mode + 1}, floor 1 / floor 2", f"Fig. 8, {name}", f"{in_file:.5f}", ratio))
    title, notes = "Fig. 8: mode shapes recovered from Table 6", (tables.note("figure_8", misfit=max(misfits)),)
    return Section(title, tuple(rows), notes, printed_in="in the file `paper`", counted=False)


def _table_8(ours: SteelFrame) -> Iterator[Row]:
    for name in tables.STRUCTURES:
        measured = ours.tested[name].frequencies
        for place, text in enumerate(tables.TABLE_8[name]):
            rounded = tables.value(tables.TABLE_7[name][place])
            exact = float(ours.frequencies[name][place])
            yield Row(
                f"f{place + 1}, %", f"Table 8, {name}", text, 100 * float(exact / measured[place] - 1),
                from_rounded=100 * float(rounded / measured[place] - 1),
            )  # fmt: skip


def _conclusions(ours: SteelFrame) -> Iterator[Row]:
    yield Row(
        "largest difference of a net mass, %", "Section 7", tables.NET_MASS_DIFFERENCE, _spread(ours.net_mass),
        from_rounded=_spread(tables.TABLE_6_NET_MASS),
    )  # fmt: skip
    yield Row(
        "largest difference of a story stiffness, %", "Section 7", tables.STIFFNESS_DIFFERENCE, _spread(ours.stiffness),
        from_rounded=_spread(tables.TABLE_6_STIFFNESS),
    )  # fmt: skip
    errors = [row for row in _table_8(ours) if row.from_rounded is not None]
    yield Row(
        "largest error of a frequency, %", "Section 7", tables.LARGEST_FREQUENCY_ERROR,
        max(abs(row.recomputed) for row in errors), from_rounded=max(abs(row.from_rounded or 0.0) for row in errors),
    )  # fmt: skip


def _spread(found: Mapping[str, Floats | tuple[str, ...]]) -> float:
    """Largest over smallest structure, percent of the largest: as the paper's 2.41 and 5.73 % are taken."""
    table = np.array([found[name] for name in tables.STRUCTURES], dtype=float)
    return 100 * float(np.max((table.max(axis=0) - table.min(axis=0)) / table.max(axis=0)))
