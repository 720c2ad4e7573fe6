"""The decision on an answer: accept it, put the closed form on its active constraints in its place, or refuse it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from cvxshear.backends.minimizer import Minimizer, UndeterminedError, UnsettledError, minimizer
from cvxshear.programs import Acceptance, Certificate
from cvxshear.programs.certificate import Assembled, Point, certify, largest_relative
from cvxshear.util.typing import Floats


@dataclass(frozen=True)
class Tolerances:
    """Largest residuals and errors of an accepted solution.

    Parameters
    ----------
    optimality : float
        Dual residual and duality gap. First-order methods reach it.
    violation : float
        Violation of a constraint, relative to the sizes of its terms: exact statements hold to nine digits.
    error : float
        Error of an unknown, relative to its size. Above it, the closed form takes the answer's place.
    error_in_deviations : float
        Error of an unknown that is tolerated all the same, in standard deviations from the residual of the rows.
    """

    optimality: float = 1e-6
    violation: float = 1e-9
    error: float = 1e-6
    error_in_deviations: float = 1e-3


TOLERANCES = Tolerances()


class InaccurateError(Exception):
    """An answer with a bad certificate; the message names the figure."""


class IllConditionedError(Exception):
    """A program whose minimizer cannot be determined in 64 bits; the message names the unknown and its error."""


@dataclass(frozen=True, eq=False)
class Accepted:
    """An answer that is accurate, or the closed form in its place.

    Parameters
    ----------
    point : Point
    certificate : Certificate
    acceptance : Acceptance
    reason : str
        Why the closed form took the answer's place; empty if it did not.
    """

    point: Point
    certificate: Certificate
    acceptance: Acceptance = Acceptance.AS_GIVEN
    reason: str = ""


def accurate(program: Assembled, point: Point) -> Accepted:
    """Certify an answer, or the closed form on its active constraints if the answer is not accurate.

    An answer with a large gradient or gap is refused. One that violates a constraint is replaced only if the rows
    hardly distinguish it from the closed form.

    Parameters
    ----------
    program : Assembled
    point : Point

    Raises
    ------
    InaccurateError
        If the answer is wrong.
    IllConditionedError
        If no answer in 64 bits can be right.
    """
    certificate = certify(program, point)
    if not max(certificate.dual_residual, certificate.duality_gap) <= TOLERANCES.optimality:
        raise _inaccurate(certificate)
    met = certificate.primal_residual <= TOLERANCES.violation
    try:
        exact = minimizer(program, point)
    except UndeterminedError:
        if not certificate.primal_residual <= TOLERANCES.optimality:
            raise _inaccurate(certificate) from None
        raise IllConditionedError(
            "too ill-conditioned to tell: the data and the active constraints leave a direction open, along which the "
            "unknowns could lie anywhere; declare more of them, or measure more"
        ) from None
    except UnsettledError:
        raise InaccurateError("the active inequalities cannot be determined, so the error is not bounded") from None
    size = program.size(exact.point.x)
    _refuse_ill_conditioned(program, exact, size)
    errors = np.abs(exact.point.x - point.x) + exact.errors
    if not met and not program.distance(point.x, exact.point.x) <= TOLERANCES.optimality:
        raise _inaccurate(certificate)
    found = Accepted(point, certificate)
    # Relative to the unknown alone, so that small unknowns among large ones are accurate, too.
    if not met or np.any(errors > TOLERANCES.error * np.abs(exact.point.x) + 2.0 * exact.errors):
        nearer = certify(program, exact.point)
        if nearer.worst <= TOLERANCES.optimality and nearer.primal_residual <= TOLERANCES.violation:
            off = f"is off by up to {largest_relative(errors, size):.1e} of an unknown, accepted {TOLERANCES.error:.0e}"
            why = off if met else f"did not pass: {_inaccurate(certificate)}"
            reason = f"its answer {why}; the closed form on its active constraints took its place"
            found = Accepted(exact.point, nearer, Acceptance.POLISHED if met else Acceptance.REPLACED, reason)
            errors = exact.errors
        elif not met or np.any(errors > TOLERANCES.error * size + 2.0 * exact.errors):
            raise _inaccurate(nearer)
        # Else the answer is accurate for its size; the last digits of the closed form are rounding in heavy rows.
    bound = largest_relative(errors, size)
    return dataclasses.replace(
        found, certificate=dataclasses.replace(found.certificate, error_bound=bound, errors=errors)
    )


def _refuse_ill_conditioned(program: Assembled, exact: Minimizer, size: Floats) -> None:
    """Raise if rounding alone can make an unknown useless."""
    tolerable = TOLERANCES.error * size + TOLERANCES.error_in_deviations * exact.deviations
    beyond = ~(exact.errors <= tolerable)
    if np.any(beyond):
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(beyond, exact.errors / size, 0.0)
        worst = int(np.argmax(np.where(np.isnan(relative), np.inf, relative)))
        raise IllConditionedError(
            f"too ill-conditioned to tell: in 64 bits {program.names[worst]} could be off by {relative[worst]:.1e} of "
            f"its size, accepted {TOLERANCES.error:.0e}"
        )


def _inaccurate(certificate: Certificate) -> InaccurateError:
    return InaccurateError(
        f"primal residual {certificate.primal_residual:.1e}, dual residual {certificate.dual_residual:.1e}, gap "
        f"{certificate.duality_gap:.1e}, accepted {TOLERANCES.violation:.0e}, {TOLERANCES.optimality:.0e} and "
        f"{TOLERANCES.optimality:.0e}"
    )
