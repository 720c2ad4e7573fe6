"""Section 5: the three-story frame from exact modes (by the paper's and two earlier methods) and noisy modes."""

from collections.abc import Iterator, Sequence

import numpy as np

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.fit.identification import identify
from cvxshear.fit.paper_methods import identified_stiffness
from cvxshear.fit.results import SingleIdentification
from cvxshear.measurement.experiment import Configuration, Experiment, Frame
from cvxshear.paper import tables
from cvxshear.paper.scatter import NoiseStudy, noise_study, paper_setups
from cvxshear.paper.setups import three_story
from cvxshear.paper.tables import KILO, PaperRow, PaperSection
from cvxshear.programs.formulations import complete_test
from cvxshear.util.decorators import cached_property
from cvxshear.util.typing import Floats

FIGURE_6_SAMPLES = 2000
"""Number of samples of Fig. 6, equal to the default of a noise study; the paper states no number."""

UNLIKELY = 1.96
"""Difference in standard errors that chance exceeds in one case of twenty."""

BEYOND_CHANCE = 3.5
"""Difference in standard errors that the largest of 30 figures exceeds by chance in one case of seventy."""


class ThreeStory:
    """Frame of Fig. 3, identified with every method from both initial masses.

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
        """Results of each method in each case."""
        return {
            (method, case): identify(self.experiment, method, self.backend, initial_mass=start).parts[0]
            for method in tables.PAPER_METHODS
            for case, start in tables.INITIAL_MASS.items()
        }

    def mass_matrix(self, method: str, case: int) -> Floats:
        """Compute the corrected mass matrix, shape (3, 3), kg."""
        part = self.parts[method, case]
        return np.diag(part.frame.floor_mass) if part.mass_matrix is None else part.mass_matrix

    def stiffness_of(self, mass_matrix: Floats) -> Floats:
        """Apply Eq. 24 to the modes normalized by a mass matrix, shape (3,), N/m."""
        test = complete_test(self.experiment, self.experiment.configurations[0], "method berman")
        return identified_stiffness(test, mass_matrix, backends.get(self.backend)).x


def sections(ours: ThreeStory) -> Iterator[PaperSection]:
    """Compute Tables 1 and 2, the numbers of iterations, and the errors stated in the text."""
    yield PaperSection("Table 1: corrected floor masses", tuple(_table_1(ours)), (_misprint(ours),))
    yield PaperSection("Table 2: identified story stiffnesses", tuple(_table_2(ours)))
    iterations = (
        PaperRow("iterations", f"Section 5.1, Case {case}, present", printed, ours.parts["two-stage", case].iterations)
        for case, printed in tables.ITERATIONS.items()
    )
    yield PaperSection("Section 5.1: iterations to Eq. 15", tuple(iterations))
    title, notes = "Section 5.1: largest errors of the two earlier methods", (tables.note("largest_errors"),)
    yield PaperSection(title, tuple(_largest_errors(ours)), notes)


def _place(table: str, method: str, case: int) -> str:
    return f"{table}, Case {case}, {tables.PAPER_METHODS[method]}"


def _table_1(ours: ThreeStory) -> Iterator[PaperRow]:
    for (method, case), entries in tables.TABLE_1.items():
        matrix = ours.mass_matrix(method, case)
        for (i, j), printed in entries.items():
            what = f"m{i}, kg" if i == j else f"mass matrix entry ({i}, {j}), kg"
            misprint = (method, case, (i, j)) == tables.MISPRINT
            where, found = _place("Table 1", method, case), float(matrix[i - 1, j - 1])
            yield PaperRow(what, where, printed, found, misprint=misprint)


def _misprint(ours: ThreeStory) -> str:
    """Explain this misprint: the paper's own Table 2 was computed with the formula's value."""
    method, case, (i, j) = tables.MISPRINT
    printed = tables.TABLE_1[method, case][i, j]
    matrix = ours.mass_matrix(method, case)
    as_printed = matrix.copy()
    as_printed[i - 1, j - 1] = as_printed[j - 1, i - 1] = tables.value(printed)

    def listed(stiffness: Floats) -> str:
        return " ".join(f"{each / KILO:.3f}" for each in stiffness)

    return tables.note(
        "misprint", i=i, j=j, case=case, printed=printed, formula=matrix[i - 1, j - 1],
        as_printed=listed(ours.stiffness_of(as_printed)), table_2=" ".join(tables.TABLE_2[method, case]),
        as_computed=listed(ours.stiffness_of(matrix)),
    )  # fmt: skip


def _table_2(ours: ThreeStory) -> Iterator[PaperRow]:
    for (method, case), printed in tables.TABLE_2.items():
        stiffness = ours.parts[method, case].frame.story_stiffness / KILO
        yield from tables.rows(_place("Table 2", method, case), "k{}, kN/m", printed, stiffness)


def _largest_errors(ours: ThreeStory) -> Iterator[PaperRow]:
    for (method, case), printed in tables.LARGEST_ERRORS.items():
        frame, truth = ours.parts[method, case].frame, ours.truth
        diagonal = tables.values([text for (i, j), text in tables.TABLE_1[method, case].items() if i == j])
        stiffness = KILO * tables.values(tables.TABLE_2[method, case])
        quantities = (
            ("floor mass", frame.floor_mass, diagonal, truth.floor_mass),
            ("story stiffness", frame.story_stiffness, stiffness, truth.story_stiffness),
        )
        for text, (what, found, rounded, true) in zip(printed, quantities, strict=True):
            errors = _largest(found, true), _largest(rounded, true)
            where = _place("Section 5.1", method, case)
            yield PaperRow(f"largest error of a {what}, %", where, text, errors[0], from_rounded=errors[1])


def _largest(found: Floats, truth: Floats) -> float:
    return 100 * float(np.max(np.abs(found / truth - 1)))


def noise_sections(samples: Sequence[int], seed: int) -> Iterator[PaperSection]:
    """Compute Table 3 with each number of samples, and Fig. 6.

    Parameters
    ----------
    samples : sequence of int
    seed : int
    """
    for count in samples:
        study = noise_study(paper_setups(tuple(tables.TABLE_3)), ("two-stage",), count, seed)
        rows = tuple(_table_3(study))
        title = f"Table 3: error of the mean, {count:,} samples"
        yield PaperSection(title, rows, (_chance(rows), *_systematic(study)))
    yield _figure_6(noise_study(paper_setups((tables.FIGURE_6_SIGMA,)), ("two-stage",), FIGURE_6_SAMPLES, seed))


def _table_3(study: NoiseStudy) -> Iterator[PaperRow]:
    for scatter, (sigma, printed) in zip(study.scatters, tables.TABLE_3.items(), strict=True):
        spread = scatter.errors.std(axis=0, ddof=1)
        # The paper's mean and ours come from independent samples.
        chance = spread * np.sqrt(1 / tables.TABLE_3_SAMPLES + 1 / study.samples)
        for place, name in enumerate(tables.PARAMETERS):
            figures = (scatter.bias[place], scatter.bias_error[place], chance[place])
            bias, std_error, by_chance = (100 * float(each) for each in figures)
            where = f"Table 3, σ = {sigma:g}"
            yield PaperRow(f"{name}, %", where, printed[place], bias, std_error=std_error, chance=by_chance)


def _chance(rows: Sequence[PaperRow]) -> str:
    distances = np.array([row.distance for row in rows if row.distance is not None])
    beyond = int(np.sum(np.abs(distances) > UNLIKELY))
    farthest = float(np.max(np.abs(distances)))
    return tables.note(
        "chance", samples=tables.TABLE_3_SAMPLES, rows=len(rows), beyond=beyond, unlikely=UNLIKELY,
        expected=0.05 * len(rows), farthest=farthest,
        explains="explains" if farthest < BEYOND_CHANCE else "does not explain",
    )  # fmt: skip


def _systematic(study: NoiseStudy) -> Iterator[str]:
    """Find the bias without the effect of chance, if the samples are sufficient."""
    scatter = study.scatters[-1]
    seen = np.flatnonzero(np.abs(scatter.bias) > 3 * scatter.bias_error)
    if seen.size:
        listed = ", ".join(
            f"{tables.PARAMETERS[i]} {100 * scatter.bias[i]:+.2f} ± {100 * scatter.bias_error[i]:.2f} %" for i in seen
        )
        yield tables.note("systematic", sigma=scatter.setup.mode_shape_std, listed=listed)


def _figure_6(study: NoiseStudy) -> PaperSection:
    scatter = study.scatters[0]
    sigma = scatter.setup.mode_shape_std
    variation = 100 * scatter.variation
    where, largest = f"Fig. 6, σ = {sigma:g}", int(np.argmax(variation))
    # Standard errors of the standard deviation of normal samples.
    errors = (variation / np.sqrt(2 * study.samples)).tolist()
    rows = tuple(
        PaperRow(f"{name}, %", where, tables.FIGURE_6, found, std_error=error)
        for name, found, error in zip(tables.PARAMETERS, variation.tolist(), errors, strict=True)
    )
    times = variation[largest] / (100 * sigma)
    note = tables.note("figure_6", parameter=tables.PARAMETERS[largest], times=times)
    return PaperSection(f"Fig. 6: coefficients of variation, {study.samples:,} samples", rows, (note,))
