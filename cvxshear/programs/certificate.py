"""Evaluate the optimality conditions of a program at an answer, on the program as the caller stated it.

The check does not use the scaling for the solver, and therefore reveals a mistake in the scaling or its inverse. Each
residual is a difference of terms and is divided by their sizes; the quotient has no unit.
"""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from cvxshear.util.decorators import cached_property
from cvxshear.util.results import InJson
from cvxshear.util.typing import Bools, Floats

#: Fraction of the solution's norm, in units of each column, that is added to an unknown's size. Without it a bound at
#: zero would have to be met exactly. With a thousandth, small unknowns keep three digits fewer than large ones.
NEAR_ZERO = 1e-3

#: Fraction of the right side, in units of each column, that is also added to an unknown's size. In the last step of an
#: iteration, the step and its violations are rounding errors. The value is well above the rounding of ill-conditioned
#: rows.
NEAR_NOTHING = 1e-7

#: Fraction of the largest row's terms that is added to the terms of every row. A millionth of it, the accepted dual
#: residual, is the rounding of that row; an unknown with tiny coefficients has a gradient of that size.
AT_ROUNDING = 2e-10


@dataclass(frozen=True)
class Certificate(InJson):
    r"""Residuals of the optimality conditions, computed here from the program and the solution.

    Parameters
    ----------
    primal_residual : float
        Largest violation of a constraint.
    dual_residual : float
        Largest entry of the Lagrangian's gradient, and largest multiplier of the wrong sign.
    duality_gap : float
        Primal less dual objective.
    error_bound : float or None
        Largest error of an unknown, relative to its size; None before it is computed, and for the closed forms.
    errors : ndarray, shape (n,), or None
        Bound on the error of each unknown, in its unit: it lies within this of the exact minimizer.

    Notes
    -----
    All four values belong to the unscaled program and do not change with the units of unknowns, rows or weights. With
    R and s the weighted rows, the size of an unknown is

    .. math:: X_j = |x_j| + (10^{-3} \sqrt{\textstyle\sum_k |R_k|^2 x_k^2} + 10^{-7} |s|) / |R_j|,

    with its second term limited to the largest :math:`|b| / |a_j|` over the equalities with unknown j. The residuals
    compare

    * a violation of :math:`a'x \le b` to :math:`|b| + \sum_j |a_j| X_j`;
    * entry j of the gradient to :math:`\sum_i |R_{ij}| r_i + \sum_i |A_{ij} y_i| + \sum_i |G_{ij} w_i|` with
      :math:`r_i = \sum_k |R_{ik} x_k| + |s_i|`, the sizes of the terms of the residual Rx - s, and
      :math:`2 \cdot 10^{-10}` of the largest of them;
    * a negative eigenvalue of a matrix inequality to the largest entry of :math:`|F_0| + \\sum_j |F_j| X_j`; its dual
      matrix joins the gradient, the gap and their sizes as a multiplier does;
    * the gap to :math:`r^2 / 2 + \sum_i |y_i b_i| + \sum_i |w_i h_i|` with :math:`r = \sum_k |R_k x_k| + |s|`;
    * the error of unknown j to :math:`X_j`.

    `cvxshear.backends.minimizer` computes the bound on the error: the distance to the minimizer on the active
    constraints, and the rounding of that minimizer itself.
    """

    primal_residual: float
    dual_residual: float
    duality_gap: float
    error_bound: float | None = None
    errors: Floats | None = field(default=None, compare=False)

    @property
    def worst(self) -> float:
        """The largest of the three residuals; nan where one is nan."""
        return float(np.max([self.primal_residual, self.dual_residual, self.duality_gap]))


@dataclass(frozen=True, eq=False)
class MatrixInequality:
    """State that the matrix F(x) = F_0 + sum over j of x_j F_j is positive semidefinite.

    Parameters
    ----------
    name : str
        What the matrix is, such as "mass matrix of floor 1".
    constant : ndarray, shape (d, d)
        F_0, symmetric.
    slopes : ndarray, shape (n, d, d)
        F_j, symmetric.
    """

    name: str
    constant: Floats
    slopes: Floats

    def at(self, x: Floats) -> Floats:
        """Compute F(x), shape (d, d)."""
        return np.asarray(self.constant + np.tensordot(x, self.slopes, 1))

    def products(self, dual: Floats) -> Floats:
        """Compute <dual, F_j> for every unknown, shape (n,)."""
        return np.asarray(np.tensordot(self.slopes, dual, 2))

    def widened(self, own: slice, size: int) -> "MatrixInequality":
        """Write the same of x among other unknowns, at these places."""
        slopes = np.zeros((size, *self.constant.shape))
        slopes[own] = self.slopes
        return MatrixInequality(self.name, self.constant, slopes)

    def holds(self, x: Floats, dual: Floats, objective: float) -> bool:
        """Whether the matrix is singular at the solution, rather than its dual zero.

        Of the pair, the one that is smaller relative to its own size is the zero; <dual, F> has the objective's unit.
        """
        matrix = self.at(x)
        least, size = float(np.linalg.eigvalsh(matrix)[0]), float(np.max(np.abs(matrix)))
        return bool(np.trace(dual) * size**2 > max(least, 0.0) * objective)


class Acceptance(StrEnum):
    """How the answer of a solver became the solution."""

    AS_GIVEN = "as given"
    """The answer passed the certificate and is accurate."""
    POLISHED = "polished"
    """The answer passed the certificate; the closed form on its active constraints has more correct digits."""
    REPLACED = "replaced"
    """The answer did not pass; the closed form on its active constraints took its place."""


@dataclass(frozen=True)
class ActiveConstraint(InJson):
    """A constraint that holds with equality at the solution, and its dual value.

    Parameters
    ----------
    constraint : str
        "A", "G", "lower", "upper" or "lmi".
    index : int
        Row of A or G, number of the unknown, or place among the matrix inequalities, from 0.
    name : str
        The unknown of a bound; the statement of a row.
    source : str
        The statement that the constraint comes from; empty if the program has no such text.
    dual : float
        The objective changes by -dual for each unit that is added to the right side or to the bound; of a matrix
        inequality, for each unit that is added to the diagonal of F_0: the trace of its dual matrix.
    """

    constraint: str
    index: int
    name: str
    source: str
    dual: float


@dataclass(frozen=True, eq=False)
class Point:
    """An answer to a program in the caller's units.

    Parameters
    ----------
    x : ndarray, shape (n,)
    y : ndarray, shape (a,)
        Multipliers of the equalities.
    w : ndarray, shape (g,)
        Multipliers of the rows of `LeastSquares.inequalities`.
    matrices : tuple of ndarray, optional
        Dual matrices of the matrix inequalities; zero where the tuple is empty.
    """

    x: Floats
    y: Floats
    w: Floats
    matrices: tuple[Floats, ...] = ()

    def matrices_of(self, program: Any) -> tuple[Floats, ...]:
        """Return a dual matrix for each matrix inequality of the program."""
        return self.matrices or tuple(np.zeros_like(each.constant) for each in program.lmi)


class Assembled:
    """A program's arrays, bounds among the inequalities, with the lengths of its columns.

    Parameters
    ----------
    program : LeastSquares

    Attributes
    ----------
    R, s : ndarray, shapes (r, n) and (r,)
        Weighted.
    A, b, G, h : ndarray
        Equalities A x = b and inequalities G x <= h.
    lengths : ndarray, shape (n,)
        Lengths of the columns of R; one for a zero column.
    names : tuple of str
        Name of each unknown in messages.
    """

    def __init__(self, program: Any) -> None:
        self.program = program
        self.R, self.s = program.weighted
        self.A, self.b = program.equalities
        self.G, self.h = program.inequalities
        self.names = program.names or tuple(f"unknown {j}" for j in range(1, program.unknowns + 1))
        lengths = np.sqrt(np.einsum("ij,ij->j", self.R, self.R))
        self.lengths: Floats = np.where(lengths > 0, lengths, 1.0)

    @cached_property
    def scaled_rows(self) -> Floats:
        """R with columns of unit length."""
        return np.asarray(self.R / self.lengths)

    @cached_property
    def absolute_rows(self) -> Floats:
        """Absolute values of `scaled_rows`."""
        return np.abs(self.scaled_rows)

    @cached_property
    def side_length(self) -> float:
        """|s|."""
        return length(self.s)

    @cached_property
    def inequality_lengths(self) -> Floats:
        """Lengths of the rows of G after the columns of R are scaled to unit length; one for a zero row."""
        return self.row_lengths(self.G)

    def held(self, point: Point) -> Bools:
        """Find the inequalities with a multiplier greater than their slack, both made free of units, shape (g,)."""
        slack = np.maximum(self.h - self.G @ point.x, 0.0)
        return np.asarray(point.w * self.inequality_lengths > slack / self.inequality_lengths)

    def row_lengths(self, rows: Floats) -> Floats:
        """Compute lengths of any rows after the columns of R are scaled to unit length; one for a zero row."""
        scaled = rows / self.lengths
        lengths = np.sqrt(np.einsum("ij,ij->i", scaled, scaled))
        return np.asarray(np.where(lengths > 0, lengths, 1.0))

    @cached_property
    def absolute(self) -> tuple[Floats, Floats]:
        """Absolute values of A and G."""
        return np.abs(self.A), np.abs(self.G)

    def size(self, x: Floats) -> Floats:
        """Compute the size of each unknown, see `Certificate`."""
        reach = NEAR_ZERO * length(self.lengths * x) + NEAR_NOTHING * self.side_length
        return np.asarray(np.abs(x) + np.minimum(reach / self.lengths, self.constrained_sizes))

    @cached_property
    def constrained_sizes(self) -> Floats:
        """Largest |b| / |a_j| over the equalities with unknown j and a nonzero b; infinite without such an equality."""
        sides = np.abs(self.b)[:, None]
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            each = np.where((self.A != 0) & (sides > 0), sides / np.abs(self.A), 0.0)
        largest = np.max(each, axis=0, initial=0.0)
        return np.asarray(np.where(largest > 0, largest, np.inf))

    def magnitude(self, x: Floats) -> float:
        """Add up the sizes of the terms of R x - s: the columns times the unknowns, and s."""
        return float(self.lengths @ np.abs(x)) + self.side_length

    def distance(self, x: Floats, other: Floats) -> float:
        """Compute the distance R (x - other) of two points, relative to the sizes of R other and s."""
        return largest_relative(np.array(length(self.R @ (x - other))), length(self.R @ other) + self.side_length)


def certify(program: Assembled, point: Point) -> Certificate:
    """Evaluate a program's optimality conditions at a point; there is no bound on its error yet.

    Parameters
    ----------
    program : Assembled
    point : Point
    """
    x, y, w = point.x, point.y, point.w
    absolute_A, absolute_G = program.absolute
    size, magnitude = program.size(x), program.magnitude(x)
    equality, slack = program.A @ x - program.b, program.h - program.G @ x
    gradient = program.R.T @ (program.R @ x - program.s) + program.A.T @ y + program.G.T @ w
    terms = program.absolute_rows @ np.abs(program.lengths * x) + np.abs(program.s)
    terms = terms + AT_ROUNDING * np.max(terms, initial=0.0)
    gradient_size = program.lengths * (program.absolute_rows.T @ terms)
    gradient_size += absolute_A.T @ np.abs(y) + absolute_G.T @ np.abs(w)
    wrong_sign = np.max(absolute_G * np.maximum(-w, 0.0)[:, None], axis=0, initial=0.0)
    # If the Lagrangian's gradient is zero, the dual objective equals the Lagrangian, and the gap equals the terms of
    # the constraints in the Lagrangian.
    gap = float(w @ slack) - float(y @ equality)
    objective_size = 0.5 * magnitude**2 + np.abs(y) @ np.abs(program.b) + np.abs(w) @ np.abs(program.h)
    of_matrices = 0.0
    for each, dual in zip(program.program.lmi, point.matrices_of(program.program), strict=True):
        value, sizes = each.at(x), np.abs(each.slopes)
        lowest = max(-float(np.linalg.eigvalsh(value)[0]), 0.0)
        terms_of = np.abs(each.constant) + np.tensordot(size, sizes, 1)
        of_matrices = max(of_matrices, largest_relative(np.array(lowest), float(np.max(terms_of))))
        gradient = gradient - each.products(dual)
        gradient_size = gradient_size + np.tensordot(sizes, np.abs(dual), 2)
        negative = max(-float(np.linalg.eigvalsh(dual)[0]), 0.0)
        wrong_sign = np.maximum(wrong_sign, negative * np.max(sizes, axis=(1, 2)))
        gap += float(np.sum(dual * value))
        objective_size += float(np.sum(np.abs(dual) * np.abs(each.constant)))
    of_equalities = largest_relative(np.abs(equality), np.abs(program.b) + absolute_A @ size)
    of_inequalities = largest_relative(np.maximum(-slack, 0.0), np.abs(program.h) + absolute_G @ size)
    return Certificate(
        primal_residual=max(of_equalities, of_inequalities, of_matrices),
        dual_residual=largest_relative(np.maximum(np.abs(gradient), wrong_sign), gradient_size),
        duality_gap=largest_relative(np.array(abs(gap)), objective_size),
    )


def largest_relative(difference: Floats, size: Floats | float) -> float:
    """Find the largest difference relative to the size of its terms; zero of zero terms is no difference."""
    if not difference.size:
        return 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.max(np.where(difference == 0, 0.0, difference / size)))


def length(vector: Floats) -> float:
    """Compute the Euclidean length of a vector; numpy's `norm` takes several times as long on short ones."""
    return math.sqrt(float(vector @ vector))
