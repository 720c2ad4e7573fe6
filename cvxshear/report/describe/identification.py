"""What an identification found."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cvxshear.methods import Identification, SingleIdentification
from cvxshear.report.describe import vocabulary
from cvxshear.report.describe.dispatch import describe, line
from cvxshear.report.describe.experiment import declared, units_for
from cvxshear.report.describe.frame import frame_table
from cvxshear.report.describe.parameters import in_words
from cvxshear.report.describe.vocabulary import Document, Row, Section, Sentence, Table
from cvxshear.util.quantities import (
    AUTOMATIC,
    Units,
    capital,
    counted,
    equals,
    percent,
    percents,
    significant,
    significants,
)
from cvxshear.util.typing import Floats

RULED_OUT = 1e-3
"""Probability of a chi-square so large below which the model is said to be ruled out."""


@describe.register
def _identification(of: Identification, units: Units = AUTOMATIC) -> Document:
    units = units_for(of.experiment, units)
    sections = [declared(of.experiment, units)]
    sections += [part_section(of, part, place, units) for place, part in enumerate(of.parts, 1)]
    if of.undetermined:
        open_ones = [Sentence(f"Not determined: {in_words(names)}.", "warning") for names in of.undetermined]
        sections.append(Section("undetermined", "What these data cannot tell", tuple(open_ones)))
    return Document(of.experiment.name, _headline(of), tuple(sections))


@line.register
def _line(of: Identification) -> str:
    worst = max(part.fit.max_frequency_error for part in of.parts)
    ended = "" if of.converged else ", not converged"
    return (
        f"<Identification {of.experiment.name}: {of.method}, {counted(of.experiment.stories, 'story')}, largest "
        f"frequency error {percent(worst)}{ended}>"
    )


def _headline(of: Identification) -> str:
    """Whose frame it is and how it was found; a warning before it where the declared noise rules the model out."""
    how = f"method {of.method}, backend {of.backend}"
    fit = of.parts[0].fit
    if not of.joint or fit.p_value is None or fit.p_value >= RULED_OUT:
        return f"{of.experiment.name}: {how}"
    return (
        f"RULED OUT: with the declared noise a shear frame would hardly give these data (chi-square "
        f"{significant(fit.chi2)} on {counted(fit.dof, 'degree')} of freedom, {equals(fit.p_value)}): the "
        "masses and stiffnesses below are those of a wrong model, and their standard deviations too small. 'cvxshear "
        f"loop' on the same file looks for what the model lacks. ({of.experiment.name}: {how})"
    )


def part_section(of: Identification, part: SingleIdentification, place: int, units: Units) -> Section:
    """The frame that one configuration, or all together, speak for, and how well it fits."""
    title = "All configurations together" if of.joint else part.name
    parts = [
        frame_table(part.frame, "Identified frame (masses without added mass)", units, key=f"identified-{place}"),
        *_bounds(part),
        *how_it_ended(part),
        *([] if part.mass_matrix is None else [_matrix(part.mass_matrix, place, units)]),
        Sentence(_fit(part)),
    ]
    return Section(f"part-{place}", title, tuple(parts))


def _bounds(part: SingleIdentification) -> Iterator[Sentence]:
    """What would have gone on but for a bound."""
    held = part.frame.at_bounds
    if held:
        are, them = ("is", "it") if len(held) == 1 else ("are", "them")
        yield Sentence(
            f"{capital(in_words(held))} {are} at a bound, a declared one or the least that counts as positive; the "
            f"data alone would have {them} beyond it. That is no measurement, and the other standard deviations "
            "hold only as far as the bound is true.",
            "warning",
        )


def how_it_ended(part: SingleIdentification) -> Iterator[Sentence]:
    """How many iterations there were and why they ended; a warning where they did not converge."""
    said = f"{counted(part.iterations, 'iteration')}: {part.reason}."
    yield (
        Sentence(said)
        if part.converged
        else Sentence(f"NOT CONVERGED. {said} The numbers are where it stopped.", "warning")
    )


def _fit(part: SingleIdentification) -> str:
    fit = part.fit
    largest, rms = percents([fit.max_frequency_error, fit.rms_frequency_error])
    said = [f"Frequency errors: largest {largest}, root mean square {rms}"]
    if fit.min_mac is not None:
        said.append(f"smallest MAC {significant(fit.min_mac, 6)}")
    if fit.max_displacement_error is not None:
        said.append(f"largest displacement error {percent(fit.max_displacement_error)}")
    test = "" if fit.p_value is None else f" ({equals(fit.p_value)})"
    said.append(f"chi-square {significant(fit.chi2)} on {counted(fit.dof, 'degree')} of freedom{test}")
    return f"{'; '.join(said)}."


def _matrix(matrix: Floats, place: int, units: Units) -> vocabulary.Block:
    factor, unit = units.of_mass(np.diag(matrix).tolist())
    head = ("floor", *(str(i) for i in range(1, len(matrix) + 1)))
    largest = float(np.max(np.abs(matrix))) / factor
    # Beside the largest entry, so that all have one format.
    written = [significants([*row, largest], 5)[:-1] for row in (matrix / factor).tolist()]
    rows = tuple(Row((str(i), *cells)) for i, cells in enumerate(written, 1))
    return Table(f"mass-matrix-{place}", f"Corrected mass matrix, {unit}", head, rows)
