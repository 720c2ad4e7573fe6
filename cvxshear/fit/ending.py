"""How an iteration ended: an enumeration of reasons that a person can read."""

from __future__ import annotations

from enum import StrEnum


class Ending(StrEnum):
    """Why an iteration stopped; the value is the reason in words."""

    STATIONARY = "step below tolerance"
    NO_BETTER_STEP = "no step lowers the misfit"
    FLAT = "misfit flat along directions that the data hardly determine"
    CORRECTION = "correction below tolerance (Eq. 15)"
    SOLVED = "solved"
    STEP_LIMIT = "step limit"
    ITERATION_LIMIT = "iteration limit"

    @property
    def converged(self) -> bool:
        """Whether there was nothing left to gain, or hardly anything."""
        return self not in (Ending.STEP_LIMIT, Ending.ITERATION_LIMIT)
