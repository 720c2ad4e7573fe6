"""Section 5.1: the three-story frame from exact modes, by the paper's method and the two it compares itself with."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.measurement.experiment import Configuration, Experiment, Frame
from cvxshear.methods import SingleIdentification, identify
from cvxshear.methods.separate import complete_test, identified_stiffness
from cvxshear.paper import tables
from cvxshear.paper.results import Row, Section
from cvxshear.studies.setups import three_story
from cvxshear.util.typing import Floats

KILO = 1e3


class ThreeStory:
    """The frame of Fig. 3 identified by every method from both initial masses.

    Parameters
    ----------
    backend : str or Backend
    """

    def __init__(self, backend: str | Backend) -> None:
        self.backend = backend
        self.truth = three_story(0.01)
        frequencies, shapes = self.truth.exact()
        frame = Frame(total_mass=float(self.truth.floor_mass.sum()))
        self.experiment = Experiment(frame, (Configuration(frequencies, shapes, "exact modes"),), name="three stories")

    @cached_property
    def parts(self) -> dict[tuple[str, int], SingleIdentification]:
        """What each method finds in each case."""
        return {
            (method, case): identify(self.experiment, method, self.backend, initial_mass=start).parts[0]
            for method in tables.METHODS
            for case, start in tables.INITIAL_MASS.items()
        }

    def mass_matrix(self, method: str, case: int) -> Floats:
        """The corrected mass matrix, shape (3, 3), kg."""
        part = self.parts[method, case]
        return np.diag(part.frame.floor_mass) if part.mass_matrix is None else part.mass_matrix

    def stiffness_of(self, mass_matrix: Floats) -> Floats:
        """Eq. 24 on the modes normalized by a mass matrix, shape (3,), N/m."""
        of = complete_test(self.experiment, self.experiment.configurations[0], "berman")
        return identified_stiffness(of, mass_matrix, backends.get(self.backend))


def sections(of: ThreeStory) -> Iterator[Section]:
    """Tables 1 and 2, the numbers of iterations, and the errors stated in the text."""
    yield Section("Table 1: corrected floor masses", tuple(_table_1(of)), (_misprint(of),))
    yield Section("Table 2: identified story stiffnesses", tuple(_table_2(of)))
    yield Section("Section 5.1: iterations to Eq. 15", tuple(_iterations(of)))
    yield Section(
        "Section 5.1: largest errors of the two earlier methods",
        tuple(_largest_errors(of)),
        (
            "The paper took these from its tables' rounded figures, and relative to the exact value (Eq. 25 as it is "
            "printed would divide by the approximate one).",
        ),
    )


def _place(table: str, method: str, case: int) -> str:
    return f"{table}, Case {case}, {tables.METHODS[method]}"


def _table_1(of: ThreeStory) -> Iterator[Row]:
    for (method, case), entries in tables.TABLE_1.items():
        matrix = of.mass_matrix(method, case)
        for (i, j), printed in entries.items():
            yield Row(
                what=f"m{i}, kg" if i == j else f"mass matrix entry ({i}, {j}), kg",
                where=_place("Table 1", method, case),
                printed=printed,
                recomputed=float(matrix[i - 1, j - 1]),
                misprint=(method, case, (i, j)) == tables.MISPRINT,
            )


def _misprint(of: ThreeStory) -> str:
    """Why that entry is a misprint: the paper's own Table 2 was computed with the formula's value."""
    method, case, (i, j) = tables.MISPRINT
    printed = tables.TABLE_1[method, case][i, j]
    matrix = of.mass_matrix(method, case)
    as_printed = matrix.copy()
    as_printed[i - 1, j - 1] = as_printed[j - 1, i - 1] = tables.value(printed)

    def listed(stiffness: Floats) -> str:
        return " ".join(f"{each / KILO:.3f}" for each in stiffness)

    return (
        f"Entry ({i}, {j}) of Ref. [17] in Case {case} is a misprint: the paper has {printed}, the formula gives "
        f"{matrix[i - 1, j - 1]:.3f}. With {printed} Table 2 would read {listed(of.stiffness_of(as_printed))} kN/m; it "
        f"reads {' '.join(tables.TABLE_2[method, case])}, which the formula's entry gives "
        f"({listed(of.stiffness_of(matrix))})."
    )


def _table_2(of: ThreeStory) -> Iterator[Row]:
    for (method, case), printed in tables.TABLE_2.items():
        stiffness = of.parts[method, case].frame.story_stiffness / KILO
        for story, (text, found) in enumerate(zip(printed, stiffness, strict=True), 1):
            yield Row(f"k{story}, kN/m", _place("Table 2", method, case), text, float(found))


def _iterations(of: ThreeStory) -> Iterator[Row]:
    for case, printed in tables.ITERATIONS.items():
        yield Row("iterations", f"Section 5.1, Case {case}, present", printed, of.parts["two-stage", case].iterations)


def _largest_errors(of: ThreeStory) -> Iterator[Row]:
    for (method, case), (mass, stiffness) in tables.LARGEST_ERRORS.items():
        frame = of.parts[method, case].frame
        where = _place("Section 5.1", method, case)
        diagonal = tuple(text for (i, j), text in tables.TABLE_1[method, case].items() if i == j)
        truth = of.truth
        yield Row(
            "largest error of a floor mass, %", where, mass, _largest(frame.floor_mass, truth.floor_mass),
            from_rounded=_largest(np.array(tables.values(diagonal)), truth.floor_mass),
        )  # fmt: skip
        rounded = KILO * np.array(tables.values(tables.TABLE_2[method, case]))
        yield Row(
            "largest error of a story stiffness, %", where, stiffness,
            _largest(frame.story_stiffness, truth.story_stiffness),
            from_rounded=_largest(rounded, truth.story_stiffness),
        )  # fmt: skip


def _largest(found: Floats, truth: Floats) -> float:
    return 100 * float(np.max(np.abs(found / truth - 1)))
