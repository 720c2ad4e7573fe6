"""The paper's figures recomputed."""

from __future__ import annotations

from collections.abc import Sequence

from cvxshear import backends
from cvxshear.backends import Backend
from cvxshear.paper import noise, steel_frame, three_story
from cvxshear.paper.results import Reproduction
from cvxshear.studies.noise import SEED


def reproduce(
    backend: str | Backend = "auto", samples: Sequence[int] = (100, 10_000), seed: int = SEED
) -> Reproduction:
    """Recompute Tables 1 to 8, the numbers of iterations and the coefficients of variation of Fig. 6.

    Parameters
    ----------
    backend : str or Backend, optional
        Which solver solves the programs. The random samples of Table 3 and Fig. 6 are solved in closed form,
        all at once.
    samples : sequence of int, optional
        Numbers of random samples for Table 3; the paper has 100.
    seed : int, optional
        Of those samples.

    Returns
    -------
    Reproduction

    Raises
    ------
    NoSolutionError
        Where the backend does not solve a program.
    """
    solver = backends.get(backend)
    parts = (
        *three_story.sections(three_story.ThreeStory(solver)),
        *noise.sections(samples, seed),
        *steel_frame.sections(steel_frame.SteelFrame(solver)),
    )
    return Reproduction(parts, solver.name, tuple(samples), seed)
