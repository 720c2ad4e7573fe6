"""Describe an identified frame: its masses, stiffnesses and damping, and the fit of each configuration."""

import math
from collections.abc import Callable, Iterable, Iterator
from functools import partial

import numpy as np

from cvxshear.data import Frequencies, noise_kinds
from cvxshear.fit.results import Identification, IdentifiedFrame, Quality, SingleIdentification
from cvxshear.programs.certificate import ActiveConstraint
from cvxshear.report.describe import vocabulary
from cvxshear.report.describe.measured import declared, units_for
from cvxshear.report.describe.vocabulary import (
    Block,
    Document,
    Points,
    Row,
    Section,
    Sentence,
    Table,
    describe,
    line,
    plain_rows,
    table,
)
from cvxshear.response import IdentifiedDamping
from cvxshear.util.quantities import (
    AUTOMATIC,
    NEGLIGIBLE_STD,
    UNKNOWN,
    Units,
    capital,
    counted,
    equals,
    listed,
    percent,
    percents,
    ranged,
    significant,
    significants,
    with_std,
)
from cvxshear.util.typing import Floats

PLURALS = {"floor_mass": "floor masses", "story_stiffness": "story stiffnesses"}
"""Plurals of the quantities with one value for each floor or story."""


def in_words(names: Iterable[str]) -> str:
    """Write names of parameters in words: "story stiffnesses 1 to 4 and floor mass 2".

    Parameters
    ----------
    names : iterable of str
        Names such as "story_stiffness 3"; other names, such as "gravity: gamma", stay unchanged.
    """
    places: dict[str, list[int]] = {}
    for name in names:
        kind, _, place = name.rpartition(" ")
        known = kind in PLURALS and place.isdecimal()
        places.setdefault(kind if known else name, []).extend([int(place)] if known else [])
    said = []
    for kind, at in places.items():
        plain = (PLURALS[kind] if len(at) > 1 else kind).replace("_", " ")
        said.append(f"{plain} {ranged(sorted(at))}" if at else plain)
    return listed(said)


def frame_table(
    frame: IdentifiedFrame,
    title: str,
    units: Units,
    *,
    key: str = "identified",
    averaged: IdentifiedFrame | None = None,
) -> Table:
    """Tabulate floor masses, their sum and story stiffnesses, the top first, with optional averages over models."""
    mass_factor, mass_unit = units.of_mass(frame.floor_mass.tolist())
    factor, unit = units.of_stiffness(frame.story_stiffness.tolist())
    head = ["floor / story", f"mass, {mass_unit}", f"stiffness, {unit}"]
    shown = [frame] if averaged is None else [frame, averaged]
    if averaged is not None:
        head += [f"averaged mass, {mass_unit}", f"averaged stiffness, {unit}"]
    cells = [[str(i) for i in range(1, len(frame.floor_mass) + 1)]]
    for each in shown:
        for quantity, values, std, size in (
            ("floor_mass", each.floor_mass, each.floor_mass_std, mass_factor),
            ("story_stiffness", each.story_stiffness, each.story_stiffness_std, factor),
        ):
            stopped = each.stopped(quantity)
            written = _column(values, std, size)
            cells.append([
                f"{significant(value / size, 2)} (at a bound)" if at_bound else text
                for value, text, at_bound in zip(values.tolist(), written, stopped, strict=True)
            ])  # fmt: skip
    sums = [text for each in shown for text in (significant(float(each.floor_mass.sum()) / mass_factor, 5), "")]
    return Table(key, title, tuple(head), (*reversed(plain_rows(zip(*cells, strict=True))), Row(("sum", *sums))))


def in_one_unit(
    values: Floats, stds: Floats, unit_of: Callable[[Iterable[float]], tuple[float, str]]
) -> tuple[list[str], str]:
    """Write values and their standard deviations in one unit; values without any standard deviation have one format.

    Parameters
    ----------
    values, stds : ndarray, shape (N,)
    unit_of : callable
        Function that chooses the size and the name of a unit for values, such as `Units.of_mass`.

    Returns
    -------
    written : list of str
    unit : str
    """
    factor, unit = unit_of(values.tolist())
    return _column(values, stds, factor), unit


def _column(values: Floats, stds: Floats, factor: float) -> list[str]:
    if np.all(np.isnan(stds)):
        written = significants((values / factor).tolist(), 5)
        return [UNKNOWN if np.isnan(value) else text for value, text in zip(values, written, strict=True)]
    fast = ~np.isnan(values) & ~(stds > NEGLIGIBLE_STD * np.abs(values))
    # A fixed value has no deviation; all fixed values have one format.
    shown = _short(significants((values[fast] / factor).tolist(), 5))
    fast_ones = dict(zip(np.flatnonzero(fast).tolist(), shown, strict=True))
    return [
        UNKNOWN if np.isnan(value) else fast_ones[place] if place in fast_ones else with_std(value, std, factor=factor)
        for place, (value, std) in enumerate(zip(values.tolist(), stds.tolist(), strict=True))
    ]


def _short(written: list[str]) -> list[str]:
    """Remove trailing decimals that are 0 in all texts."""
    while written and all("." in text and text.endswith(("0", ".")) for text in written):
        written = [text[:-1] for text in written]
    return written


@describe.register
def _damping(result: IdentifiedDamping, units: Units = AUTOMATIC) -> Document:
    remarks = tuple(Sentence(each, "warning") for each in result.remarks)
    headline = f"{result.kind} damping of {counted(len(result.ratios), 'mode')}"
    return Document("damping", headline, (damping_section(result), Section("remarks", "", remarks)))


def damping_section(result: IdentifiedDamping) -> Section:
    """Tabulate the damping ratios of the modes, and the dashpots or Rayleigh factors if they exist."""
    return Section("damping", "Damping", tuple(_damping_parts(result)))


def _damping_parts(result: IdentifiedDamping) -> Iterator[Block]:
    measured = np.full(len(result.ratios), np.nan) if result.measured is None else result.measured
    numbers = [str(number) for number in range(1, len(result.ratios) + 1)]
    yield table("damping-ratios", f"damping ({result.kind})", {
        "mode": numbers,
        "ratio, %": map(partial(with_std, factor=0.01), result.ratios.tolist(), result.ratios_std.tolist()),
        "measured, %": [significant(100 * float(seen), 3) for seen in measured],
    })  # fmt: skip
    if result.story_dashpot is not None and result.story_dashpot_std is not None:
        dashpots = list(map(with_std, result.story_dashpot.tolist(), result.story_dashpot_std.tolist()))
        stories = [str(story) for story in range(1, len(dashpots) + 1)]
        yield table("story-dashpots", "story dashpots", {"story": stories, "N s/m": dashpots}, top_first=True)
    if result.rayleigh is not None:
        a, b = result.rayleigh
        yield Sentence(f"C = a M + b K, a = {significant(float(a))} 1/s, b = {significant(float(b))} s")


RULED_OUT = 1e-3
"""Smallest p-value of chi-square for a plausible model; 1 minus this value is the largest for a plausible noise."""


def generous_noise(fit: Quality) -> Iterator[str]:
    """Warn if the residual is much smaller than the stated noise predicts.

    Parameters
    ----------
    fit : Quality
    """
    if fit.p_value is None or fit.p_value <= 1 - RULED_OUT:
        return
    size = significant(math.sqrt(fit.dof / max(fit.chi2, 1e-9)), 2)
    yield (
        f"the residual is {size} times smaller than the stated standard deviations let expect (chi-square "
        f"{significant(fit.chi2)}, {counted(fit.dof, 'degree')} of freedom): these are too large, and with them those "
        "of masses and stiffnesses, or they hold errors that all these data share, as those that 'modes' writes do"
    )


@describe.register
def _identification(result: Identification, units: Units = AUTOMATIC) -> Document:
    units = units_for(result.experiment, units)
    sections = [declared(result.experiment, units)]
    sections += [part_section(result, part, place, units) for place, part in enumerate(result.parts, 1)]
    if result.undetermined:
        open_ones = [Sentence(f"Not determined: {in_words(names)}.", "warning") for names in result.undetermined]
        sections.append(Section("undetermined", "What these data cannot tell", tuple(open_ones)))
    return Document(result.experiment.name, _headline(result), tuple(sections))


@line.register
def _line(result: Identification) -> str:
    worst = max(part.fit.max_frequency_error for part in result.parts)
    ended = "" if result.converged else ", not converged"
    return (
        f"<Identification {result.experiment.name}: {result.method}, {counted(result.experiment.stories, 'story')}, "
        f"largest frequency error {percent(worst)}{ended}>"
    )


def _headline(result: Identification) -> str:
    """Name the frame and the method; put a warning first if the stated noise rules the model out."""
    how = f"method {result.method}, backend {result.backend}"
    fit = result.parts[0].fit
    if not result.joint or fit.p_value is None or fit.p_value >= RULED_OUT:
        return f"{result.experiment.name}: {how}"
    return (
        f"RULED OUT: with the stated noise a shear frame would hardly give these data (chi-square "
        f"{significant(fit.chi2)} on {counted(fit.dof, 'degree')} of freedom, {equals(fit.p_value)}): the "
        "masses and stiffnesses below are those of a wrong model, and their standard deviations too small. 'cvxshear "
        f"loop' on the same file looks for what the model lacks. ({result.experiment.name}: {how})"
    )


def part_section(result: Identification, part: SingleIdentification, place: int, units: Units) -> Section:
    """Tabulate the frame that one or all configurations give, and its fit."""
    title = "All configurations together" if result.joint else part.name
    parts = [
        frame_table(part.frame, "Identified frame (masses without added mass)", units, key=f"identified-{place}"),
        *_bounds(part),
        *_prices(part, place, units),
        *how_it_ended(part),
        *([] if part.mass_matrix is None else [_matrix(part.mass_matrix, place, units)]),
        Sentence(_fit(part)),
        *(Sentence(f"{capital(text)}.", "warning") for text in generous_noise(part.fit)),
    ]
    return Section(f"part-{place}", title, tuple(parts))


def _bounds(part: SingleIdentification) -> Iterator[Sentence]:
    """Warn of parameters that a bound holds."""
    at_bounds = part.frame.at_bounds
    if at_bounds:
        are, them = ("is", "it") if len(at_bounds) == 1 else ("are", "them")
        yield Sentence(
            f"{capital(in_words(at_bounds))} {are} at a bound, a declared one or the least that counts as positive; "
            f"the data alone would have {them} beyond it. That is no measurement, and the other standard deviations "
            "hold only as far as the bound is true.",
            "warning",
        )


def _prices(part: SingleIdentification, place: int, units: Units) -> Iterator[Block]:
    """List the active bounds and exact priors, each with its dual value."""
    if part.active:
        misfit = "the objective of the program" if part.name else "chi-square with the noise of the fit"
        yield Sentence(f"Active bounds and exact priors with their prices (the misfit is {misfit}):", "strong")
        yield Points(f"active-{place}", tuple(_price(held, units) for held in part.active))


def _price(held: ActiveConstraint, units: Units) -> str:
    """State the change of the misfit for one more unit on the right side of a constraint."""
    about = f"{held.name} {held.source}"
    quantities = {} if units.relative else {"floor_mass": "kg", "story_stiffness": "N/m"}
    unit = next((unit for quantity, unit in quantities.items() if quantity in about), "unit")
    at_bound = held.constraint in ("lower", "upper")
    where = f"the {held.constraint} bound of {in_words([held.name])}" if at_bound else "the right side"
    change = "lower" if held.dual > 0 else "raise"
    return (
        f"{held.source or held.name}: one more {unit} on {where} would {change} the misfit by "
        f"{significant(abs(held.dual), 3)}"
    )


def how_it_ended(part: SingleIdentification) -> Iterator[Sentence]:
    """State the number of iterations and the reason of their end; warn if the fit did not converge."""
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
    for figure in (each for kind in noise_kinds().values() for each in kind.figures if kind is not Frequencies.noise):
        error = fit.errors[figure.key]
        if error is not None:
            said.append(f"{figure.label} {percent(error) if figure.relative else significant(error, 6)}")
    test = "" if fit.p_value is None else f" ({equals(fit.p_value)})"
    said.append(f"chi-square {significant(fit.chi2)} on {counted(fit.dof, 'degree')} of freedom{test}")
    return f"{'; '.join(said)}."


def _matrix(matrix: Floats, place: int, units: Units) -> vocabulary.Block:
    factor, unit = units.of_mass(np.diag(matrix).tolist())
    head = ("floor", *(str(i) for i in range(1, len(matrix) + 1)))
    largest = float(np.max(np.abs(matrix))) / factor
    # The largest entry is appended to give all rows one format, then removed.
    written = [significants([*row, largest], 5)[:-1] for row in (matrix / factor).tolist()]
    rows = tuple(Row((str(i), *cells)) for i, cells in enumerate(written, 1))
    return Table(f"mass-matrix-{place}", f"Corrected mass matrix, {unit}", head, rows)
