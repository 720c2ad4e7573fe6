"""Recomputation of the paper's figures."""

from collections.abc import Sequence
from dataclasses import dataclass

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.paper import steel_frame, three_story
from cvxshear.paper.scatter import SEED
from cvxshear.paper.tables import DIFFERS, MISPRINTED, ROUNDED, TO_THE_DIGIT, PaperSection
from cvxshear.util.results import InJson


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


def reproduce(
    backend: str | Backend = "auto", samples: Sequence[int] = (100, 10_000), seed: int = SEED
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
    parts = (
        *three_story.sections(three_story.ThreeStory(solver)),
        *three_story.noise_sections(samples, seed),
        *steel_frame.sections(steel_frame.SteelFrame(solver)),
    )
    return Reproduction(parts, solver.name, tuple(samples), seed)
