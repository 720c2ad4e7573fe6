"""Certificates belong to the caller's program: they show mistakes in scaling, its inverse, and hidden errors."""

import dataclasses
import itertools
from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from scipy import linalg

from cvxshear import InfeasibleError, NoSolutionError, backends
from cvxshear.backends import base, canonical
from cvxshear.backends.base import accurate
from cvxshear.backends.minimizer import minimizer
from cvxshear.programs import LeastSquares
from cvxshear.programs.certificate import Assembled, Point, certify

GENERAL = ("auto", "clarabel", "daqp", "cvxpy-clarabel")
BOUNDED = [name for name in backends.available() if name != "kkt"]


def exactly(R, s):
    """Solve least squares of two unknowns exactly for these floats, with rational arithmetic and Cramer's rule."""
    R = [[Fraction(float(value)) for value in row] for row in R]
    s = [Fraction(float(value)) for value in s]
    N = [[sum(row[i] * row[j] for row in R) for j in range(2)] for i in range(2)]
    c = [sum(row[i] * side for row, side in zip(R, s, strict=True)) for i in range(2)]
    det = N[0][0] * N[1][1] - N[0][1] * N[1][0]
    return np.array([float((c[0] * N[1][1] - c[1] * N[0][1]) / det), float((N[0][0] * c[1] - N[1][0] * c[0]) / det)])


def conditioned(seed, condition, rows=2):
    rng = np.random.default_rng(seed)
    left, right = np.linalg.qr(rng.standard_normal((rows, 2)))[0], np.linalg.qr(rng.standard_normal((2, 2)))[0]
    R = left @ np.diag([1.0, 1.0 / condition]) @ right.T
    return R, rng


def bounded(seed):
    """Return a program of condition 3e5 with bounds close to the unbounded solution, and its solution by trial."""
    R, rng = conditioned(seed, 3e5)
    inside = rng.standard_normal(2)
    s, lower = R @ inside, inside - 0.1 * rng.standard_normal(2)
    best = None
    for choice in itertools.product([False, True], repeat=2):
        held, x = np.array(choice), lower.copy()
        if held.any():
            x[~held] = np.linalg.lstsq(R[:, ~held], s - R[:, held] @ lower[held], rcond=None)[0]
        else:
            x = exactly(R, s)
        value = np.linalg.norm(R @ x - s)
        if np.all(x >= lower) and (best is None or value < best[0]):
            best = (value, x)
    return LeastSquares(R, s, lower=lower), best[1]


@pytest.mark.parametrize("name", BOUNDED)
def test_an_ill_conditioned_answer_is_right_or_refused(name):
    answered = 0
    for seed in range(12):
        program, expected = bounded(seed)
        try:
            found = backends.get(name).solve(program)
        except NoSolutionError:
            continue
        np.testing.assert_allclose(found.x, expected, atol=2e-6 * np.max(np.abs(expected)))
        answered += 1
    # Methods of first order refuse many of these: they do not reach the accuracy.
    assert answered >= (12 if name in {"clarabel", "quadprog", "highs"} else 1)


def free_or_held(*, held):
    rng = np.random.default_rng(3)
    R, s = rng.standard_normal((9, 4)) / np.array([1e4, 1.0, 1e-3, 10.0]), rng.standard_normal(9)
    program = LeastSquares(R, s, A=np.array([[1e-4, 1.0, 0.0, 0.0]]), b=np.array([0.7]))
    if not held:
        return program
    x = backends.get("kkt").solve(program).x
    return program.replace(lower=x + np.array([-9e5, -9.0, 2e-4, -9e2]))


def halved(field):
    def wrong(original):
        def sabotaged(*arguments):
            result = list(original(*arguments))
            result[field] = 0.5 * result[field]
            return tuple(result)

        return sabotaged

    return wrong


SABOTAGE = {
    "the whitening": ("_whitening", halved(0)),
    "the whitened right side": ("_whitening", halved(2)),
    "the scaled right sides of the constraints": ("_unit_rows", halved(1)),
    "the scales of the constraints": ("_unit_rows", halved(2)),
}


# The closed form accepts no active bound.
@pytest.mark.parametrize(("name", "held"), [("kkt", False), *itertools.product(GENERAL, [False, True])])
@pytest.mark.parametrize("what", SABOTAGE)
def test_a_scaling_that_is_wrong_by_half_is_refused(monkeypatch, name, held, what):
    program = free_or_held(held=held)
    backends.get(name).solve(program)
    function, wrong = SABOTAGE[what]
    monkeypatch.setattr(canonical, function, wrong(getattr(canonical, function)))
    with pytest.raises(NoSolutionError, match=r"inaccurate solution|no solution"):
        backends.get(name).solve(program)


@pytest.mark.parametrize("name", ["kkt", *GENERAL])
@pytest.mark.parametrize("back", ["to_x", "multipliers"])
def test_a_way_back_that_is_wrong_by_half_is_refused(monkeypatch, name, back):
    program = free_or_held(held=name != "kkt")
    original = getattr(canonical.Canonical, back)

    def wrong(self, *scaled):
        return original(self, *(0.5 * part for part in scaled))

    monkeypatch.setattr(canonical.Canonical, back, wrong)
    with pytest.raises(NoSolutionError, match="inaccurate solution"):
        backends.get(name).solve(program)


@pytest.mark.parametrize("lost", ["y", "w"])
def test_multipliers_that_are_lost_on_the_way_back_are_refused(monkeypatch, lost):
    original = canonical.Canonical.multipliers

    def wrong(self, y, w):
        found = dict(zip("yw", original(self, y, w), strict=True))
        found[lost] = 0.0 * found[lost]
        return found["y"], found["w"]

    monkeypatch.setattr(canonical.Canonical, "multipliers", wrong)
    with pytest.raises(NoSolutionError, match=r"dual residual \d"):
        backends.get("clarabel").solve(free_or_held(held=True))


def test_no_figure_of_a_certificate_changes_with_the_units():
    rng = np.random.default_rng(0)
    R, s, W = rng.standard_normal((7, 3)), rng.standard_normal(7), rng.uniform(1, 2, 7)
    A, b, G, h = (rng.standard_normal(shape) for shape in ((1, 3), 1, (2, 3), 2))
    x, y, w = rng.standard_normal(3), rng.standard_normal(1), rng.uniform(-1, 1, 2)
    plain = certify(Assembled(LeastSquares(R, s, W, A, b, G, h)), Point(x, y, w))
    units, weight, rows = 10.0 ** rng.uniform(-7, 7, 3), 1e5, np.array([1e4, 1e-6])
    other = LeastSquares(R / units, s, weight * W, A / units * 1e3, b * 1e3, G / units * rows[:, None], h * rows)
    same = certify(Assembled(other), Point(x * units, y * weight**2 / 1e3, w * weight**2 / rows))
    for field in ("primal_residual", "dual_residual", "duality_gap"):
        assert getattr(same, field) == pytest.approx(getattr(plain, field), rel=1e-12)
        assert getattr(plain, field) > 1e-4


@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-7])
@pytest.mark.parametrize("condition", [1e1, 1e4, 1e7])
def test_the_error_is_within_its_bound_and_the_bound_within_reach_of_it(condition, off):
    """Compare with rational arithmetic. An error along the weakest direction keeps all residuals small."""

    class Off(backends.Backend):
        name = "off"

        def answer(self, problem):
            exact = backends.get("kkt").answer(problem)
            x = problem.to_x(exact.z)
            weak = np.linalg.svd(R / np.linalg.norm(R, axis=0))[2][-1] / np.linalg.norm(R, axis=0)
            scale = np.column_stack([problem.to_x(each) for each in np.eye(2)])
            moved = off * np.linalg.norm(x) * weak / np.linalg.norm(weak)
            return dataclasses.replace(exact, z=exact.z + np.linalg.solve(scale, moved))

    for seed in range(5):
        R, rng = conditioned(seed, condition, rows=4)
        program = LeastSquares(R, R @ rng.uniform(1, 2, 2) + 1e-3 * rng.standard_normal(4))
        found = Off().solve(program)
        error = np.max(np.abs(found.x - exactly(R, program.s)) / np.abs(found.x))
        bound = found.certificate.error_bound
        assert error <= bound * 1.01
        assert bound <= 2 * error + 200 * condition * np.finfo(float).eps


def test_an_answer_beyond_its_accuracy_is_replaced_and_one_within_it_is_left():
    R, _ = conditioned(0, 1e6)
    program = LeastSquares(R, R @ np.array([1.0, 2.0]))
    of = Assembled(program)
    weak = np.linalg.svd(R)[2][-1]
    for off, left in ((1e-8, True), (1e-4, False)):
        near = Point(np.array([1.0, 2.0]) + off * weak, np.zeros(0), np.zeros(0))
        found = accurate(of, near)
        assert (found.point is near) == left
        assert found.acceptance == ("as given" if left else "polished")
        assert bool(found.reason) != left
        np.testing.assert_allclose(found.point.x, [1.0, 2.0], atol=1e-6)
        assert found.certificate.error_bound < 1e-6
        assert np.all(np.abs(found.point.x - [1.0, 2.0]) <= found.certificate.errors + 1e-10)


@pytest.mark.parametrize("name", BOUNDED)
def test_the_last_step_of_an_iteration_is_rounding_and_no_violation(name):
    """The data leave a residual that no step removes, and a bound of zero is off by rounding, 3e-17."""
    R, s = np.array([[1.0, 0.0], [0.0, 2.0], [0.0, 0.0]]), np.array([0.0, 0.0, 1.0])
    program = LeastSquares(R, s, lower=np.array([3e-17, -np.inf]), A=np.array([[1.0, 1.0]]), b=np.array([0.0]))
    np.testing.assert_allclose(backends.get(name).solve(program).x, [0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("name", BOUNDED)
def test_a_direction_that_nothing_determines_is_refused_and_one_that_bounds_close_is_solved(name):
    program = LeastSquares(np.array([[1.0, 1.0]]), np.array([1.0]), lower=np.array([-5.0, -5.0]))
    with pytest.raises(NoSolutionError, match=r"ill-conditioned to tell: .* direction open|no solution|quadprog"):
        backends.get(name).solve(program)
    if name != "quadprog":
        determined = backends.get(name).solve(program.replace(lower=np.array([3.0, 0.0])))
        np.testing.assert_allclose(determined.x, [3.0, 0.0], atol=1e-9)
        assert determined.certificate.error_bound < 1e-6


@pytest.mark.parametrize("start", ["none", "all", "wrong signs"])
def test_the_inequalities_that_hold_the_minimizer_are_found_from_any_guess(start):
    rng = np.random.default_rng(5)
    R, s = rng.standard_normal((30, 10)), rng.standard_normal(30)
    free = np.linalg.lstsq(R, s, rcond=None)[0]
    program = LeastSquares(R, s, lower=np.full(10, np.quantile(free, 0.3)), upper=np.full(10, np.quantile(free, 0.8)))
    expected = backends.get("quadprog").solve(program)
    held = expected.point.w > 0
    w = {"none": np.zeros(20), "all": np.full(20, 10.0), "wrong signs": np.where(held, -1.0, 10.0)}[start]
    w[10:] = 0.0 if start == "all" else w[10:]
    near = Point(np.clip(free, program.lower, program.upper), np.zeros(0), w)
    found = minimizer(Assembled(program), near)
    np.testing.assert_allclose(found.point.x, expected.x, atol=1e-12)
    np.testing.assert_array_equal(found.point.w > 0, held)
    np.testing.assert_allclose(found.point.w, expected.point.w, atol=1e-10)
    # Rows in other units have other multipliers and the same bounds.
    G, h = program.inequalities
    scaled = minimizer(Assembled(LeastSquares(R, s, G=1e8 * G, h=1e8 * h)), dataclasses.replace(near, w=1e-8 * w))
    np.testing.assert_allclose(scaled.errors, found.errors, rtol=0.1)


def test_the_same_bound_said_twice_holds_the_minimizer_like_one():
    twice = LeastSquares(
        np.eye(2), np.array([2.0, 3.0]), G=np.array([[1.0, 0.0], [2.0, 0.0]]), h=np.array([1.0, 2.0]), upper=np.ones(2)
    )
    found = minimizer(Assembled(twice), Point(np.ones(2), np.zeros(0), np.array([0.5, 0.1, 0.3, 2.0])))
    np.testing.assert_allclose(found.point.x, [1.0, 1.0], rtol=1e-15)
    assert np.all(found.point.w >= 0)
    np.testing.assert_allclose(found.point.x - twice.s + twice.inequalities[0].T @ found.point.w, 0.0, atol=1e-15)


def test_an_answer_whose_inequalities_cannot_be_told_is_refused(monkeypatch):
    monkeypatch.setattr(base, "minimizer", partial(minimizer, most_sets=0))
    with pytest.raises(NoSolutionError, match=r"active inequalities cannot be determined"):
        backends.get("clarabel").solve(bounded(0)[0])


@pytest.mark.parametrize("name", BOUNDED)
def test_an_unknown_that_the_objective_hardly_sees_still_keeps_the_constraints(name):
    """Solvers return -1e11 for the last unknown. Its column is 1e-30 of the others', and the sum must be 22.5."""
    R = np.array([[-0.3147, -0.6040, 1.5e-60], [3.8e-31, -0.8437, 5.1e-31], [-6.7e-31, 0.6200, 4.0e-31]])
    program = LeastSquares(R=R, s=np.zeros(3), A=np.ones((1, 3)), b=np.array([22.5]), lower=np.full(3, 0.0075))
    try:
        x = backends.get(name).solve(program).x
    except NoSolutionError:
        return
    np.testing.assert_allclose(x, [0.0075, 0.0075, 22.485], rtol=1e-2)


@pytest.mark.parametrize(("off", "accepted"), [(2e-20, True), (2e-15, False)])
def test_an_unknown_that_hardly_anything_pulls_at_is_as_right_as_rounding_allows(off, accepted):
    """The gradient is 1e-24 for one unknown, 1e4 for its neighbor. The neighbor's terms of 6 are rounded to 1e-15."""
    program = LeastSquares(np.array([[1e4, 0.0], [0.0, 109.0], [0.0, 1.0]]), np.array([3.0, 1e-24, 0.0]))
    found = certify(Assembled(program), Point(np.array([3e-4, off]), np.zeros(0), np.zeros(0)))
    assert (found.dual_residual <= 1e-6) is accepted


def test_every_figure_is_what_the_formulas_of_the_certificate_say():
    """Compare term by term, in plain sums, at a point that violates every condition slightly."""
    rng = np.random.default_rng(12)
    R, s = rng.standard_normal((6, 3)), rng.standard_normal(6)
    A, b = rng.standard_normal((1, 3)), rng.standard_normal(1)
    G, h = rng.standard_normal((2, 3)), rng.standard_normal(2)
    x, y, w = rng.standard_normal(3), rng.standard_normal(1), np.array([0.7, -0.4])
    found = certify(Assembled(LeastSquares(R, s, A=A, b=b, G=G, h=h)), Point(x, y, w))
    columns = [sum(R[i, j] ** 2 for i in range(6)) ** 0.5 for j in range(3)]
    side = sum(value**2 for value in s) ** 0.5
    reach = 1e-3 * sum((columns[j] * x[j]) ** 2 for j in range(3)) ** 0.5 + 1e-7 * side
    size = [abs(x[j]) + min(reach / columns[j], abs(b[0]) / abs(A[0, j])) for j in range(3)]
    violations = [abs(A[0] @ x - b[0]) / (abs(b[0]) + sum(abs(A[0, j]) * size[j] for j in range(3)))]
    violations += [
        max(G[i] @ x - h[i], 0.0) / (abs(h[i]) + sum(abs(G[i, j]) * size[j] for j in range(3))) for i in range(2)
    ]
    assert found.primal_residual == pytest.approx(max(violations), rel=1e-12)
    terms = [sum(abs(R[i, j] * x[j]) for j in range(3)) + abs(s[i]) for i in range(6)]
    duals = []
    for j in range(3):
        slope = sum(R[i, j] * (R[i] @ x - s[i]) for i in range(6)) + A[0, j] * y[0] + G[0, j] * w[0] + G[1, j] * w[1]
        wrong_sign = abs(G[1, j]) * 0.4
        of = sum(abs(R[i, j]) * (terms[i] + 2e-10 * max(terms)) for i in range(6)) + abs(A[0, j] * y[0])
        of += sum(abs(G[i, j] * w[i]) for i in range(2))
        duals.append(max(abs(slope), wrong_sign) / of)
    assert found.dual_residual == pytest.approx(max(duals), rel=1e-12)
    r = sum(columns[j] * abs(x[j]) for j in range(3)) + side
    gap = abs(w @ (h - G @ x) - y @ (A @ x - b))
    of = r**2 / 2 + abs(y[0] * b[0]) + sum(abs(w[i] * h[i]) for i in range(2))
    assert found.duality_gap == pytest.approx(gap / of, rel=1e-12)


@pytest.mark.parametrize("side", [6e-10, 5e-10])
def test_equalities_of_any_scale_that_contradict_each_other_are_refused(side):
    """The equalities are x1 = 5, and x1 = 6 (or the consistent 5) in units of 1e-10."""
    A = np.array([[1.0, 0.0], [1e-10, 0.0]])
    program = LeastSquares(np.eye(2), np.ones(2), A=A, b=np.array([5.0, side]))
    if side == 6e-10:
        with pytest.raises(InfeasibleError, match="contradict"):
            backends.get("auto").solve(program)
    else:
        np.testing.assert_allclose(backends.get("auto").solve(program).x, [5.0, 1.0], rtol=1e-9)


@pytest.mark.parametrize(("n", "constraints"), [(1, 0), (5, 0), (5, 1), (5, 2), (40, 3)])
def test_the_bounds_of_the_minimizer_are_those_of_its_formulas(n, constraints):
    """Evaluate delta x = H f + Z (Z'R'RZ)^-1 Z'g + P d explicitly."""
    rng = np.random.default_rng(n + constraints)
    R, s = rng.standard_normal((2 * n, n)) * rng.uniform(1e-2, 1e2, n), rng.standard_normal(2 * n)
    A, b = rng.standard_normal((constraints, n)), rng.standard_normal(constraints)
    program = LeastSquares(R, s, A=A, b=b, G=-np.eye(1, n), h=np.array([1e9])) if constraints else LeastSquares(R, s)
    found = minimizer(
        Assembled(program), Point(np.zeros(n), np.zeros(constraints), np.zeros(len(program.inequalities[1])))
    )
    D = 1 / np.linalg.norm(R, axis=0)
    C, B = R * D, A * D
    scale = np.linalg.norm(B, axis=1)
    B, c = B / scale[:, None], b / scale
    Z = linalg.null_space(B) if constraints else np.eye(n)
    inverse = Z @ np.linalg.inv(Z.T @ C.T @ C @ Z) @ Z.T
    P = (np.eye(n) - inverse @ C.T @ C) @ np.linalg.pinv(B)
    z = inverse @ C.T @ s + P @ c
    np.testing.assert_allclose(found.point.x, D * z, rtol=1e-8)
    residual = C @ z - s
    deviation = np.sqrt(residual @ residual / (2 * n - n + constraints))
    np.testing.assert_allclose(found.deviations, D * deviation * np.sqrt(np.diag(inverse)), rtol=1e-6)
    u = 4 * np.finfo(float).eps
    f = u * np.sqrt(n) * (np.abs(C) @ np.abs(z) + np.abs(s))
    g = u * np.sqrt(2 * n) * np.abs(C).T @ np.abs(residual)
    expected = np.abs(inverse @ C.T) @ f + np.abs(inverse) @ g
    expected += np.abs(P) @ (u * np.sqrt(n) * (np.abs(B) @ np.abs(z) + np.abs(c)))
    # Add the last correction, which is of the size of rounding.
    np.testing.assert_allclose(found.errors, D * expected, rtol=0.2)
    np.testing.assert_allclose(A.T @ found.point.y, R.T @ (s - R @ found.point.x), atol=1e-6 * np.abs(R.T @ s).max())
    assert not found.point.w.any()
