"""Recomputation of the paper's figures: the three-story frame of Section 5, the steel frame of Section 6."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize, stats

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.fit.identification import identify
from cvxshear.fit.paper_methods import identified_stiffness
from cvxshear.io.toml import load
from cvxshear.measurement.experiment import Configuration, Experiment, Frame
from cvxshear.model import mass_matrix, modes, stiffness_matrix
from cvxshear.paper.scatter import NoiseStudy, noise_study, paper_setups
from cvxshear.paper.setups import three_story
from cvxshear.paper.tables import MISPRINT, PRINTED, PaperRow, PaperSection, Reproduction, note, rows, value, values
from cvxshear.programs.formulations import complete_test
from cvxshear.programs.pair_rows import normalized, stiffness_rows
from cvxshear.util.quantities import NORMAL_95, SURE
from cvxshear.util.typing import Floats

KILO = 1e3
"""The paper prints stiffnesses in kN/m."""

PerStructure = Mapping[str, Any]
"""Numbers, or printed figures, of each structure by its name."""


def reproduce(
    backend: str | Backend = "auto", samples: Sequence[int] = (100, 10_000), seed: int = 2023
) -> Reproduction:
    """Recompute Tables 1 to 8, the numbers of iterations and the coefficients of variation of Fig. 6.

    Parameters
    ----------
    backend : str or Backend, optional
        Solver of the programs. The random samples of Table 3 and Fig. 6 are solved in closed form, all at once.
    samples : sequence of int, optional
        Numbers of random samples for Table 3; the paper has 100.
    seed : int, optional
        Seed of these samples.

    Returns
    -------
    Reproduction

    Raises
    ------
    NoSolutionError
        If the backend does not solve a program.
    """
    solver = backends.get(backend)
    sections = (*exact_sections(solver), *noise_sections(samples, seed), *steel_sections(solver))
    return Reproduction(sections, solver.name, tuple(samples), seed)


def exact_modes() -> Experiment:
    """Measure the three-story frame of Fig. 3 without noise."""
    truth = three_story(0.01)
    frequencies, shapes = truth.exact()
    frame = Frame(total_mass=float(truth.floor_mass.sum()))
    return Experiment(frame, (Configuration(frequencies, shapes, "exact modes"),), name="three stories")


def exact_sections(backend: str | Backend) -> Iterator[PaperSection]:
    """Compute Tables 1 and 2, the numbers of iterations, and the errors stated in the text, from exact modes."""
    experiment, starts = exact_modes(), PRINTED["initial_mass"]
    parts = {
        (method, case): identify(experiment, method, backend, initial_mass=start).parts[0]
        for method in PRINTED["methods"]
        for case, start in starts.items()
    }
    matrices = {
        key: np.diag(part.frame.floor_mass) if part.mass_matrix is None else part.mass_matrix
        for key, part in parts.items()
    }
    masses = (
        PaperRow(
            f"m{entry[0]}, kg" if entry[0] == entry[1] else f"mass matrix entry ({entry[0]}, {entry[1]}), kg",
            _place("Table 1", method, case), printed, _entry(matrices[method, case], entry),
            misprint=(method, case, entry) == MISPRINT,
        )
        for method, cases in PRINTED["table_1"].items()
        for case, entries in cases.items()
        for entry, printed in entries.items()
    )  # fmt: skip
    yield PaperSection("Table 1: corrected floor masses", tuple(masses), (_misprint(experiment, matrices, backend),))
    stiffnesses = (
        row
        for case in starts
        for method, printed in PRINTED["table_2"].items()
        for row in rows(
            _place("Table 2", method, case), "k{}, kN/m", printed[case],
            parts[method, case].frame.story_stiffness / KILO,
        )
    )  # fmt: skip
    yield PaperSection("Table 2: identified story stiffnesses", tuple(stiffnesses))
    iterations = (
        PaperRow("iterations", f"Section 5.1, Case {case}, present", printed, parts["two-stage", case].iterations)
        for case, printed in PRINTED["iterations"].items()
    )
    yield PaperSection("Section 5.1: iterations to Eq. 15", tuple(iterations))
    truth, largest = three_story(0.01), []
    for method, cases in PRINTED["largest_errors"].items():
        for case, (of_mass, of_stiffness) in cases.items():
            frame, where = parts[method, case].frame, _place("Section 5.1", method, case)
            diagonal = values([PRINTED["table_1"][method][case][entry] for entry in ("11", "22", "33")])
            stiffness = KILO * values(PRINTED["table_2"][method][case])
            for what, printed, found, rounded, true in (
                ("floor mass", of_mass, frame.floor_mass, diagonal, truth.floor_mass),
                ("story stiffness", of_stiffness, frame.story_stiffness, stiffness, truth.story_stiffness),
            ):
                errors = [100 * float(np.max(np.abs(each / true - 1))) for each in (found, rounded)]
                largest.append(PaperRow(f"largest error of a {what}, %", where, printed, errors[0], errors[1]))
    title = "Section 5.1: largest errors of the two earlier methods"
    yield PaperSection(title, tuple(largest), (note("largest_errors"),))


def _place(table: str, method: str, case: str) -> str:
    return f"{table}, Case {case}, {PRINTED['methods'][method]}"


def _entry(matrix: Floats, entry: str) -> float:
    """Return an entry of a matrix by its two printed numbers."""
    return float(matrix[int(entry[0]) - 1, int(entry[1]) - 1])


def _misprint(experiment: Experiment, matrices: Mapping[tuple[str, str], Floats], backend: str | Backend) -> str:
    """Explain the misprint: the paper's own Table 2 was computed with the formula's value."""
    method, case, entry = MISPRINT
    i, j = int(entry[0]), int(entry[1])
    printed, matrix = PRINTED["table_1"][method][case][entry], matrices[method, case]
    as_printed = matrix.copy()
    as_printed[i - 1, j - 1] = as_printed[j - 1, i - 1] = value(printed)
    test = complete_test(experiment, experiment.configurations[0], "method berman")
    wrong, right = (
        " ".join(f"{each / KILO:.3f}" for each in identified_stiffness(test, M, backends.get(backend)).x)
        for M in (as_printed, matrix)
    )
    return note(
        "misprint", i=i, j=j, case=case, printed=printed, formula=matrix[i - 1, j - 1], as_printed=wrong,
        table_2=" ".join(PRINTED["table_2"][method][case]), as_computed=right,
    )  # fmt: skip


def noise_sections(samples: Sequence[int], seed: int) -> Iterator[PaperSection]:
    """Compute Table 3 with each number of samples, and Fig. 6 with as many samples as a noise study has.

    Parameters
    ----------
    samples : sequence of int
    seed : int
    """
    for count in samples:
        study = noise_study(paper_setups(), ("two-stage",), count, seed=seed)
        table = tuple(_table_3(study))
        yield PaperSection(
            f"Table 3: error of the mean, {count:,} samples", table, (_chance(table), *_systematic(study))
        )
    yield _figure_6(noise_study(paper_setups(map(float, PRINTED["figure_6"])), ("two-stage",), seed=seed))


def _table_3(study: NoiseStudy) -> Iterator[PaperRow]:
    for scatter, (sigma, printed) in zip(study.scatters, PRINTED["table_3"].items(), strict=True):
        # The paper's mean and ours come from independent samples.
        chance = scatter.errors.std(axis=0, ddof=1) * np.sqrt(1 / PRINTED["noise"]["samples"] + 1 / study.samples)
        for place, name in enumerate(PRINTED["noise"]["parameters"]):
            figures = (scatter.bias[place], scatter.bias_error[place], chance[place])
            bias, std_error, by_chance = (100 * float(each) for each in figures)
            where = f"Table 3, σ = {sigma}"
            yield PaperRow(f"{name}, %", where, printed[place], bias, std_error=std_error, chance=by_chance)


def _chance(table: Sequence[PaperRow]) -> str:
    """Say whether the largest of the differences is as large as chance makes it in one case of twenty."""
    distances = np.abs([row.distance for row in table if row.distance is not None])
    farthest = float(np.max(distances))
    by_chance = 1.0 - (1.0 - 2.0 * stats.norm.sf(farthest)) ** len(table)
    return note(
        "chance", samples=PRINTED["noise"]["samples"], rows=len(table), beyond=int(np.sum(distances > NORMAL_95)),
        unlikely=round(NORMAL_95, 2), expected=(1 - SURE) * len(table), farthest=farthest,
        explains="explains" if by_chance > 1 - SURE else "does not explain",
    )  # fmt: skip


def _systematic(study: NoiseStudy) -> Iterator[str]:
    """Find the bias without the effect of chance, if the samples are sufficient."""
    scatter = study.scatters[-1]
    seen = np.flatnonzero(np.abs(scatter.bias) > 3 * scatter.bias_error)
    if seen.size:
        names = PRINTED["noise"]["parameters"]
        listed = (f"{names[i]} {100 * scatter.bias[i]:+.2f} ± {100 * scatter.bias_error[i]:.2f} %" for i in seen)
        yield note("systematic", sigma=scatter.setup.mode_shape_std, listed=", ".join(listed))


def _figure_6(study: NoiseStudy) -> PaperSection:
    scatter, names = study.scatters[0], PRINTED["noise"]["parameters"]
    ((sigma, printed),) = PRINTED["figure_6"].items()
    variation = 100 * scatter.variation
    largest = int(np.argmax(variation))
    # Standard errors of the standard deviation of normal samples.
    errors = (variation / np.sqrt(2 * study.samples)).tolist()
    table = tuple(
        PaperRow(f"{name}, %", f"Fig. 6, σ = {sigma}", printed, found, std_error=error)
        for name, found, error in zip(names, variation.tolist(), errors, strict=True)
    )
    enlarged = note("figure_6", parameter=names[largest], times=variation[largest] / (100 * float(sigma)))
    return PaperSection(f"Fig. 6: coefficients of variation, {study.samples:,} samples", table, (enlarged,))


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


def recovered(name: str) -> RecoveredShapes:
    """Compute the shapes of Fig. 8 from the printed figures of one structure."""
    mass, stiffness, frequencies = (
        values(PRINTED[table][name]) for table in ("table_6_mass", "table_6_stiffness", "table_5")
    )
    return recovered_shapes(mass, KILO * stiffness, frequencies)


def steel_sections(backend: str | Backend) -> Iterator[PaperSection]:
    """Compute Tables 4 to 8, Fig. 8, and the conclusions of Section 7; each structure is identified separately."""
    experiment = load("paper")
    tested = {each.name: each for each in experiment.configurations}
    parts = {part.name: part for part in identify(experiment, "two-stage", backend).parts}
    measured = {name: each.frequencies for name, each in tested.items()}
    net_mass = {name: part.frame.floor_mass for name, part in parts.items()}
    stiffness = {name: part.frame.story_stiffness / KILO for name, part in parts.items()}
    frequencies = {name: part.predictions[0].frequencies for name, part in parts.items()}
    said = PRINTED["conclusions"]
    inputs = (
        *_by_structure("Table 4", "counterweight of floor {}, kg", PRINTED["table_4"],
                       {name: each.added_mass for name, each in tested.items()}),
        *_by_structure("Table 5", "f{}, Hz", PRINTED["table_5"], measured),
        PaperRow("net total mass, kg", "Section 6", said["total_net_mass"], experiment.frame.known_total or np.nan),
    )  # fmt: skip
    yield PaperSection("Tables 4 and 5: what is identified from", inputs, (note("inputs"),), counted=False)
    shapes = {name: recovered(name) for name in tested}
    in_file = {name: [f"{low / high:.5f}" for low, high in each.mode_shapes] for name, each in tested.items()}
    ratios = _by_structure(
        "Fig. 8", "mode {}, floor 1 / floor 2", in_file, {name: each[:2] for name, each in shapes.items()}
    )
    notes = (note("figure_8", misfit=max(each.misfit for each in shapes.values())),)
    title, source = "Fig. 8: mode shapes recovered from Table 6", "in the file `paper`"
    yield PaperSection(title, tuple(ratios), notes, printed_in=source, counted=False)
    identified = (
        *_by_structure("Table 6", "m{}, kg", PRINTED["table_6_mass"],
                       {name: net + tested[name].added_mass for name, net in net_mass.items()}),
        *_by_structure("Table 6", "net m{}, kg", PRINTED["table_6_net_mass"], net_mass),
        *_by_structure("Table 6", "k{}, kN/m", PRINTED["table_6_stiffness"], stiffness),
    )  # fmt: skip
    yield PaperSection("Table 6: identified masses and stiffnesses", identified)
    analytical = _by_structure("Table 7", "f{}, Hz", PRINTED["table_7"], frequencies)
    yield PaperSection("Table 7: analytical frequencies", tuple(analytical))
    printed = {name: values(texts) for name, texts in PRINTED["table_7"].items()}
    errors, rounded = (
        {name: 100 * (each[name] / seen - 1) for name, seen in measured.items()} for each in (frequencies, printed)
    )
    table_8 = tuple(_by_structure("Table 8", "f{}, %", PRINTED["table_8"], errors, rounded))
    yield PaperSection("Table 8: errors of the analytical frequencies", table_8, (note("table_8"),))
    conclusions = (
        ("difference of a net mass", "net_mass", _spread, net_mass, PRINTED["table_6_net_mass"]),
        ("difference of a story stiffness", "stiffness", _spread, stiffness, PRINTED["table_6_stiffness"]),
        ("error of a frequency", "frequency", _largest, errors, rounded),
    )
    largest = (
        PaperRow(f"largest {what}, %", "Section 7", said[key], measure(found), from_rounded=measure(of_printed))
        for what, key, measure, found, of_printed in conclusions
    )
    yield PaperSection("Section 7: largest differences", tuple(largest))


def _by_structure(
    table: str, what: str, printed: PerStructure, found: PerStructure, rounded: PerStructure | None = None
) -> Iterator[PaperRow]:
    for name, texts in printed.items():
        yield from rows(f"{table}, {name}", what, texts, found[name], None if rounded is None else rounded[name])


def _spread(found: PerStructure) -> float:
    """Compute the largest difference between structures, in percent of the largest: the paper's 2.41 and 5.73 %."""
    table = np.array(list(found.values()), dtype=float)
    return 100 * float(np.max((table.max(axis=0) - table.min(axis=0)) / table.max(axis=0)))


def _largest(found: PerStructure) -> float:
    return float(np.max(np.abs(list(found.values()))))
