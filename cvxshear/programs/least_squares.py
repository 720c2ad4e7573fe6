"""A least-squares program as an object: arrays, quadratic form, conversions, closed forms; and its solution."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from cvxshear.programs.certificate import Acceptance, ActiveConstraint, Assembled, Certificate, MatrixInequality, Point
from cvxshear.util import decorators, results
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.typing import Floats

if TYPE_CHECKING:
    import cvxpy
    import qpsolvers
    from numpy.typing import DTypeLike


@dataclasses.dataclass(frozen=True, eq=False)
class LeastSquares:
    r"""Minimize :math:`|W (R x - s)|^2` subject to :math:`G x \le h`, :math:`A x = b`, lower <= x <= upper.

    With `lmi` it is a semidefinite program: each of these matrices, linear in x, is positive semidefinite.

    Parameters
    ----------
    R, s : ndarray, shapes (r, n) and (r,)
        The rows. They are kept, since R'R squares the condition number.
    W : ndarray, shape (r,), optional
        Weights, the diagonal of W. Default: ones.
    A, b : ndarray, shapes (a, n) and (a,), optional
        Equalities.
    G, h : ndarray, shapes (g, n) and (g,), optional
        Inequalities.
    lower, upper : ndarray, shape (n,), optional
        Bounds; infinite entries are no bound.
    names : tuple of str, optional
        Names of the n unknowns.
    sources : mapping of str to tuple of str, optional
        For "A", "G", "lower" and "upper": the statement that each entry comes from, such as
        "total_mass = 31.33 kg".
    title : str, optional
        Purpose of the program, such as "mass correction, Structure 1".
    lmi : tuple of MatrixInequality, optional
        Linear matrix inequalities.

    Examples
    --------
    >>> import numpy as np
    >>> program = LeastSquares(R=np.eye(2), s=np.array([1.0, 2.0]), upper=np.array([5.0, 1.5]))
    >>> solution = program.solve("clarabel")
    >>> solution.x.round(6).tolist(), solution.duals["upper"].round(6).tolist()
    ([1.0, 1.5], [0.0, 1.0])
    """

    R: Floats
    s: Floats
    W: Floats | None = None
    A: Floats | None = None
    b: Floats | None = None
    G: Floats | None = None
    h: Floats | None = None
    lower: Floats | None = None
    upper: Floats | None = None
    names: tuple[str, ...] = ()
    sources: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    title: str = ""
    lmi: tuple[MatrixInequality, ...] = ()

    @property
    def unknowns(self) -> int:
        """Number of unknowns n."""
        return int(self.R.shape[1])

    @property
    def weighted(self) -> tuple[Floats, Floats]:
        """W R and W s."""
        if self.W is None:
            return self.R, self.s
        return self.W[:, None] * self.R, self.W * self.s

    @property
    def equalities(self) -> tuple[Floats, Floats]:
        """A and b; without rows if there are no equalities."""
        if self.A is None or self.b is None:
            return np.zeros((0, self.unknowns)), np.zeros(0)
        return self.A, self.b

    @property
    def inequalities(self) -> tuple[Floats, Floats]:
        """Rows and right sides of all inequalities: G, then the finite lower bounds, then the finite upper bounds."""
        return self.inequalities_in(None)

    def inequalities_in(self, basis: Floats | None) -> tuple[Floats, Floats]:
        """Write `inequalities` in z, where x = basis @ z: a bound selects a row of the basis."""
        units = np.eye(self.unknowns) if basis is None else basis
        rows, sides = [np.zeros((0, self.unknowns))], [np.zeros(0)]
        if self.G is not None and self.h is not None and len(self.G):
            rows.append(self.G if basis is None else self.G @ basis)
            sides.append(self.h)
        for bound, sign in ((self.lower, -1.0), (self.upper, 1.0)):
            if bound is not None:
                finite = np.isfinite(bound)
                rows.append(sign * units[finite])
                sides.append(sign * bound[finite])
        return np.concatenate(rows), np.concatenate(sides)

    @property
    def P(self) -> Floats:  # noqa: N802
        """Hessian 2 R'W²R of the objective, shape (n, n): 1/2 x'Px + q'x + constant equals the sum of squares."""
        R, _ = self.weighted
        return np.asarray(2.0 * R.T @ R)

    @property
    def q(self) -> Floats:
        """Linear term -2 R'W²s of the objective, shape (n,)."""
        R, s = self.weighted
        return np.asarray(-2.0 * R.T @ s)

    @property
    def constant(self) -> float:
        """Constant term s'W²s of the objective."""
        _, s = self.weighted
        return float(s @ s)

    def objective(self, x: Floats) -> float:
        """Return the sum of squares at x, shape (n,)."""
        R, s = self.weighted
        return float(np.sum((R @ x - s) ** 2))

    @property
    def _labels(self) -> list[tuple[str, int]]:
        """Kind and index of each row of `inequalities`: the row of G, or the unknown of a bound."""
        found = [("G", row) for row in range(0 if self.G is None else len(self.G))]
        for kind, bound in (("lower", self.lower), ("upper", self.upper)):
            if bound is not None:
                found += [(kind, unknown) for unknown in np.flatnonzero(np.isfinite(bound)).tolist()]
        return found

    def duals_at(self, point: Point) -> dict[str, Floats]:
        """Convert the multipliers of half the objective to multipliers of the objective, by name, see `Solution`."""
        n, g = self.unknowns, 0 if self.G is None else len(self.G)
        duals = {"A": 2.0 * point.y, "G": np.zeros(g), "lower": np.zeros(n), "upper": np.zeros(n)}
        for (kind, index), multiplier in zip(self._labels, point.w, strict=True):
            duals[kind][index] = (-2.0 if kind == "lower" else 2.0) * multiplier
        for each, dual in zip(self.lmi, point.matrices_of(self), strict=True):
            duals[each.name] = 2.0 * dual
        return duals

    def active_at(self, point: Point) -> tuple[ActiveConstraint, ...]:
        """List the equalities, and the inequalities with a multiplier greater than their slack in scaled units."""
        duals = self.duals_at(point)
        found = [("A", row) for row in range(len(self.equalities[1]))]
        if np.any(point.w > 0):  # otherwise no inequality holds anything, and a tall frame's rows need not be written
            held = Assembled(self).held(point)
            found += [label for label, active in zip(self._labels, held, strict=True) if active]
        listed = []
        for kind, index in found:
            sources = self.sources.get(kind, ())
            source = sources[index] if index < len(sources) else ""
            name = source or f"row {index + 1} of {kind}"
            if kind in ("lower", "upper"):
                name = self.names[index] if self.names else f"unknown {index + 1}"
            listed.append(ActiveConstraint(kind, index, name, source, float(duals[kind][index])))
        for index, (each, dual) in enumerate(zip(self.lmi, point.matrices_of(self), strict=True)):
            if each.holds(point.x, dual, self.objective(point.x)):
                listed.append(ActiveConstraint("lmi", index, each.name, each.name, 2.0 * float(np.trace(dual))))
        return tuple(listed)

    def replace(self, **changes: Any) -> LeastSquares:
        """Return a copy with some fields replaced."""
        return dataclasses.replace(self, **changes)

    def to_qpsolvers(self) -> qpsolvers.Problem:
        """Convert to a `qpsolvers.Problem` with the matrices P, q, G, h, A, b and the bounds.

        Its objective is the sum of squares without `constant`.

        Raises
        ------
        UnsuitableError
            If the program has matrix inequalities.
        """
        import qpsolvers  # noqa: PLC0415 - imports every installed solver

        if self.lmi:
            raise UnsuitableError("qpsolvers takes no matrix inequalities; to_cvxpy() does")
        A, b = (None, None) if self.b is None or not len(self.b) else (self.A, self.b)
        G, h = (None, None) if self.h is None or not len(self.h) else (self.G, self.h)
        return qpsolvers.Problem(self.P, self.q, G, h, A, b, self.lower, self.upper)

    def to_cvxpy(self) -> tuple[cvxpy.Problem, cvxpy.Variable]:
        """Convert to a `cvxpy.Problem` and its variable, to which constraints can be added.

        Returns
        -------
        problem : cvxpy.Problem
            Its constraints are, as far as the program has them: A x = b, G x <= h, x >= lower, x <= upper, and the
            matrix inequalities in order.
        x : cvxpy.Variable
        """
        import cvxpy as cp  # noqa: PLC0415 - takes a second to import

        x = cp.Variable(self.unknowns, name="x")
        R, s = self.weighted
        constraints: list[Any] = []
        if self.A is not None and self.b is not None and len(self.b):
            constraints.append(self.A @ x == self.b)
        if self.G is not None and self.h is not None and len(self.h):
            constraints.append(self.G @ x <= self.h)
        for bound, sign in ((self.lower, -1.0), (self.upper, 1.0)):
            if bound is not None and np.any(finite := np.isfinite(bound)):
                constraints.append(sign * x[finite] <= sign * bound[finite])
        for each in self.lmi:
            shape = each.constant.shape
            linear = each.slopes.reshape(len(each.slopes), -1).T @ x
            constraints.append(cp.reshape(linear, shape, order="C") + each.constant >> 0)  # type: ignore[attr-defined]  # cvxpy exports it
        return cp.Problem(cp.Minimize(cp.sum_squares(R @ x - s)), constraints), x  # type: ignore[attr-defined]  # cvxpy exports it

    def kkt(self) -> Solution:
        r"""Solve the program with its equalities alone, in closed form (Eq. 14), by the backend "kkt".

        .. math:: \begin{bmatrix} P & A' \\ A & 0 \end{bmatrix} \begin{bmatrix} x \\ y \end{bmatrix}
                  = \begin{bmatrix} -q \\ b \end{bmatrix}

        P is not formed: QR factorizations of the rows and of A give the solution.

        Returns
        -------
        Solution
            Solution of the program without G, lower, upper and matrix inequalities.

        Raises
        ------
        NoSolutionError
            If the rows and the equalities do not determine every unknown.
        """
        return self.replace(G=None, h=None, lower=None, upper=None, lmi=()).solve("kkt")

    def normal_equations(self) -> Solution:
        """Solve the program without any constraint, R'W²R x = R'W²s (Eqs. 10 and 24), by a QR factorization of W R.

        Raises
        ------
        NoSolutionError
            If the rows do not determine every unknown.
        """
        found = self.replace(A=None, b=None).kkt()
        return dataclasses.replace(found, requested="normal equations", backend="normal equations")

    @decorators.usual_arithmetic
    def solve(self, backend: str | Any = "auto", **options: Any) -> Solution:
        """Solve the program with a backend and certify the solution.

        Parameters
        ----------
        backend : str or Backend, optional
            One of `cvxshear.backends.available()`, or "auto": the closed form if no inequality is active, else the
            first general solver that succeeds.
        **options
            Options of the solver, such as ``eps_abs=1e-9``. They go to the solver as they are.

        Raises
        ------
        InfeasibleError
            If the constraints contradict each other.
        InputError
            If the backend is not installed, or takes no options.
        NoSolutionError
            If the solver fails, or its answer does not pass the certificate.
        UnsuitableError
            If the backend cannot take such a program: "kkt", if an inequality is active.
        """
        found: Solution = results.ask("solve", "solve", self, backend, options)
        return found


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    r"""The solution of a program. NumPy functions take it as its x.

    Parameters
    ----------
    program : LeastSquares
    point : Point
        The unknowns, and the multipliers of :math:`|W (R x - s)|^2 / 2`, one for each row of
        `LeastSquares.inequalities`.
    certificate : Certificate
    requested : str
        The backend that was asked.
    backend : str
        The backend that answered: "kkt" if the closed form on the active constraints took the answer's place.
    replaced : str or None
        Why `backend` is not `requested`; None if it is.
    acceptance : Acceptance
        Whether the solver's answer was accepted as given, polished or replaced.
    status : str
        The solver's own status.
    iterations : int or None
        None if the solver does not report it.
    seconds : float
        Wall time with scaling and certificate.
    """

    program: LeastSquares
    point: Point
    certificate: Certificate
    requested: str
    backend: str
    replaced: str | None = None
    acceptance: Acceptance = Acceptance.AS_GIVEN
    status: str = "closed form"
    iterations: int | None = None
    seconds: float = 0.0

    @property
    def x(self) -> Floats:
        """The unknowns, shape (n,)."""
        return self.point.x

    @property
    def errors(self) -> Floats | None:
        """Bound on the error of each unknown, shape (n,), in its unit; None for the closed forms."""
        return self.certificate.errors

    @property
    def objective(self) -> float:
        r"""Sum of squares :math:`|W (R x - s)|^2`."""
        return self.program.objective(self.x)

    @property
    def duals(self) -> dict[str, Floats]:
        r"""Multipliers "A", shape (a,), "G", shape (g,), "lower" and "upper", shape (n,).

        They have the sign convention of qpsolvers: :math:`P x + q + A' y + G' z + z_l + z_u = 0`, where the
        multipliers z of G and of upper bounds are not negative, and the multipliers of lower bounds are not positive.
        The objective changes by minus the multiplier for each unit that is added to the right side or to the bound.
        Each matrix inequality has a positive semidefinite dual matrix Z by its name, and -<Z, F> joins the Lagrangian.
        """
        return self.program.duals_at(self.point)

    @property
    def active(self) -> tuple[ActiveConstraint, ...]:
        """The equalities, and the inequalities and bounds that are active, with their duals."""
        return self.program.active_at(self.point)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Floats:
        return np.array(self.x, dtype=dtype)
