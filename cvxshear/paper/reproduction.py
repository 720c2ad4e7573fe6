"""Recomputation of the paper's figures: the three-story frame of Section 5, the steel frame of Section 6.

The source is "High precision identification method of mass and stiffness matrix for shear-type frame test model",
Sections 5 and 6. Cases 1 and 2 are its two initial masses. "Present" is its own method, "Ref. [23]" Qi's, "Ref. [17]"
Berman's. Printed figures are texts, which keep the number of printed digits.
"""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from cvxshear import backends
from cvxshear.fit.identification import identify
from cvxshear.io.toml import load
from cvxshear.measurement.experiment import Configuration, Experiment, Frame
from cvxshear.paper.scatter import NoiseStudy, noise_study
from cvxshear.paper.setups import paper_setups, three_story
from cvxshear.util.results import InJson
from cvxshear.util.typing import Floats

#: The paper prints stiffnesses in kN/m.
KILO = 1e3

#: Numbers, or printed figures, of each structure by its name.
PerStructure = Mapping[str, Any]


#: Tables of figures; the file says what each holds, and in which unit.
PRINTED: dict[str, Any] = tomllib.loads((resources.files("cvxshear.paper") / "printed.toml").read_text("utf-8"))

#: Method, case and entry of Table 1 that differs from the formula's value.
MISPRINT = ("berman", "1", "23")


def note(name: str, **gaps: object) -> str:
    """Return a note for readers of the recomputed figures."""
    return str(PRINTED["notes"][name]).format(**gaps)


def value(printed: str) -> float:
    """Read a printed figure as a number."""
    return float(printed.removeprefix("about "))


def decimals(printed: str) -> int:
    """Count the printed decimals."""
    return len(printed.partition(".")[2])


def values(printed: Sequence[str]) -> Floats:
    """Read printed figures as numbers."""
    return np.array([value(each) for each in printed])


TO_THE_DIGIT = "to the last digit"
ROUNDED = "from rounded figures"
MISPRINTED = "misprint"
#: Possible results of the comparison of a recomputed figure with the printed one.
DIFFERS = "differs"


@dataclass(frozen=True)
class PaperRow(InJson):
    """One figure.

    Parameters
    ----------
    what : str
        The quantity and its unit.
    where : str
        Place in the paper.
    printed : str
        Figure as printed.
    recomputed : float
    from_rounded : float, optional
        The same figure, computed from other printed figures of the paper.
    std_error : float, optional
        Standard error of a figure from random samples.
    chance : float, optional
        Standard deviation of `difference` if both figures come from different random samples.
    misprint : bool, optional
        Whether the printed figure differs from the paper's own formula.
    """

    what: str
    where: str
    printed: str
    recomputed: float
    from_rounded: float | None = None
    std_error: float | None = None
    chance: float | None = None
    misprint: bool = False

    json_keys = "what where printed recomputed difference agrees from_rounded std_error distance misprint verdict"

    @property
    def difference(self) -> float:
        """Recomputed figure minus printed figure."""
        return self.recomputed - value(self.printed)

    @property
    def agrees(self) -> bool:
        """Whether the recomputed figure, rounded to the printed number of digits, equals the printed one."""
        return same_digits(self.recomputed, self.printed)

    @property
    def distance(self) -> float | None:
        """Difference in standard deviations of random sampling; None for figures without random samples."""
        return None if self.chance is None else self.difference / self.chance

    @property
    def verdict(self) -> str:
        """Comparison of the figures in words; empty if the paper gives only a rough figure."""
        if self.misprint:
            return MISPRINTED
        if self.distance is not None:
            return f"{self.distance:+.1f} standard errors"
        if self.printed.startswith("about"):
            return ""
        if self.agrees:
            return TO_THE_DIGIT
        if self.from_rounded is not None and same_digits(self.from_rounded, self.printed):
            return ROUNDED
        return DIFFERS


@dataclass(frozen=True)
class PaperSection(InJson):
    """The rows of one table or statement of the paper.

    Parameters
    ----------
    title : str
    rows : tuple of PaperRow
    notes : tuple of str, optional
        Notes for readers of the rows.
    counted : bool, optional
        Whether the rows are results of the paper, which the summary counts, and not its input.
    """

    title: str
    rows: tuple[PaperRow, ...]
    notes: tuple[str, ...] = ()
    counted: bool = True

    json_keys = "title rows notes"


@dataclass(frozen=True)
class Reproduction(InJson):
    """The paper's figures and ours.

    Parameters
    ----------
    sections : tuple of PaperSection
    backend : str
    samples : tuple of int
        Numbers of random samples of Table 3.
    seed : int
    """

    sections: tuple[PaperSection, ...]
    backend: str
    samples: tuple[int, ...]
    seed: int

    json_keys = "backend samples seed summary sections"

    @property
    def summary(self) -> str:
        """Number of figures that agree, in a sentence or two."""
        results = [row for section in self.sections if section.counted for row in section.rows]
        fixed = [row for row in results if row.chance is None and not row.printed.startswith("about")]
        verdicts = (TO_THE_DIGIT, ROUNDED, MISPRINTED, DIFFERS)
        counts = {name: sum(row.verdict == name for row in fixed) for name in verdicts}
        return (
            f"{len(fixed)} printed results that no chance is involved in: {counts[TO_THE_DIGIT]} are met to the last "
            f"printed digit, {counts[ROUNDED]} more once computed, as the paper did, from its own rounded figures, "
            f"{counts[MISPRINTED]} is a misprint, {counts[DIFFERS]} differ."
        )


def rows(
    where: str, what: str, printed: Sequence[str], found: Sequence[float] | Floats, rounded: Floats | None = None
) -> Iterator[PaperRow]:
    """Pair the figures of one line of a table with ours; `what` has a place for their numbers from 1."""
    from_rounded = [None] * len(printed) if rounded is None else rounded.tolist()
    for place, each in enumerate(zip(printed, found, from_rounded, strict=True), 1):
        yield PaperRow(what.format(place), where, each[0], float(each[1]), each[2])


def same_digits(number: float, printed: str) -> bool:
    """Return whether a number rounds to a printed one; the sign of zero does not matter."""
    count = decimals(printed)
    return round(number, count) == round(value(printed), count)


def reproduce(
    backend: str | backends.Backend = "auto", samples: Sequence[int] = (100, 10_000), seed: int = 2023
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


def exact_sections(backend: str | backends.Backend) -> Iterator[PaperSection]:
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
            _place("Table 1", method, case), printed,
            float(matrices[method, case][int(entry[0]) - 1, int(entry[1]) - 1]),
            misprint=(method, case, entry) == MISPRINT,
        )
        for method, cases in PRINTED["table_1"].items()
        for case, entries in cases.items()
        for entry, printed in entries.items()
    )  # fmt: skip
    yield PaperSection("Table 1: corrected floor masses", tuple(masses), (note("misprint"),))
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


def noise_sections(samples: Sequence[int], seed: int) -> Iterator[PaperSection]:
    """Compute Table 3 with each number of samples, and Fig. 6 with as many samples as a noise study has.

    Parameters
    ----------
    samples : sequence of int
    seed : int
    """
    for count in samples:
        study = noise_study(paper_setups(), ("two-stage",), count, seed=seed)
        yield PaperSection(f"Table 3: error of the mean, {count:,} samples", tuple(_table_3(study)))
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


def steel_sections(backend: str | backends.Backend) -> Iterator[PaperSection]:
    """Compute Tables 4 to 8 and the conclusions of Section 7; each structure is identified separately."""
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
