"""Solve hard least-squares programs with every backend; compare with exact minimizers in rational arithmetic.

`python -m tests.studies hard_programs 1000 1` draws 1000 programs of the kinds below, seed 1, and solves each with
every backend. An answer must lie within its own error bound of the exact minimizer of the floating-point program. Every
float is a rational number, so Gaussian elimination on the optimality conditions is exact. A backend must refuse an
undetermined answer. Any two answers to one program therefore agree within their bounds.
"""

import itertools
import sys
from collections import Counter, defaultdict
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy.linalg import eigh

from cvxshear import CvxshearError, InfeasibleError, NoSolutionError, UnsuitableError, backends
from cvxshear.programs import LeastSquares
from cvxshear.programs.certificate import Assembled
from cvxshear.programs.formulations import one_shot_rows, stiffness_rows
from tests.studies.timing import table

SUBSETS = 512
"""Number of sets of active inequalities tried for the exact minimizer: all sets of nine inequalities."""


def main(programs=1000, seed=1):
    print(f"{programs} programs, seed {seed}; backends: {', '.join(backends.available())}")
    tally = study(programs, seed)
    table(
        "Hard programs: answers and refusals of all backends together",
        [
            "program",
            "programs",
            "answers",
            "refused: ill-conditioned",
            "refused: solver",
            "closed form unsuitable",
            "outside their bound",
            "constraint missed",
            "largest error / bound",
            "largest error / size",
        ],
        [tally[kind].row(kind) for kind in KINDS],
    )
    for kind in KINDS:
        for line in tally[kind].wrong:
            print(f"  {kind}: {line}")
    answers = sum((each.by_backend for each in tally.values()), Counter())
    table("Answers a backend", ["backend", "answers"], [[name, answers[name]] for name in backends.available()])


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of one program on one backend: a solution, or the error of the refusal."""

    backend: str
    solution: object = None
    error: Exception | None = None


class Tally:
    """Counts over the programs of one kind."""

    def __init__(self):
        self.programs = self.answers = self.ill_conditioned = self.failed = self.unsuitable = self.missed = 0
        self.of_bound = self.of_size = 0.0
        self.wrong, self.by_backend = [], Counter()

    def add(self, number, program, outcomes):
        self.programs += 1
        exact, unique = exactly(program)
        for each in outcomes:
            if each.error is not None:
                self.ill_conditioned += "ill-conditioned" in str(each.error)
                self.unsuitable += isinstance(each.error, UnsuitableError)
                self.failed += "ill-conditioned" not in str(each.error) and not isinstance(each.error, UnsuitableError)
                continue
            self.answers += 1
            self.by_backend[each.backend] += 1
            self._judge(f"program {number}, {each.backend}", program, each.solution, exact, unique=unique)
        for one, other in itertools.combinations([each for each in outcomes if each.error is None], 2):
            apart = np.abs(one.solution.x - other.solution.x)
            if np.any(apart > one.solution.errors + other.solution.errors):
                self.wrong.append(f"program {number}: {one.backend} and {other.backend} are further apart than bounds")

    def _judge(self, who, program, solution, exact, *, unique):
        A, b = program.equalities
        G, h = program.inequalities
        x = solution.x
        lengths = np.linalg.norm(program.weighted[0], axis=0)
        reach = 1e-3 * np.linalg.norm(lengths * x) + 1e-7 * np.linalg.norm(program.weighted[1])
        size = np.abs(x) + reach / np.where(lengths > 0, lengths, 1.0)
        excess = np.concatenate([
            np.abs(A @ x - b) / (np.abs(b) + np.abs(A) @ size), (G @ x - h) / (np.abs(h) + np.abs(G) @ size)
        ])  # fmt: skip
        self.missed += bool(np.max(excess, initial=0.0) > 1e-9)
        if exact is None:
            self.wrong.append(f"{who}: an answer where no minimizer is")
            return
        if not unique:
            return
        error = np.array([float(abs(Fraction(float(value)) - right)) for value, right in zip(x, exact, strict=True)])
        with np.errstate(divide="ignore", invalid="ignore"):
            of_bound = float(np.max(np.where(error == 0, 0.0, error / solution.errors)))
        if not of_bound <= 1.0:
            self.wrong.append(f"{who}: error {error.max():.1e}, {of_bound:.1e} times its bound")
        self.of_bound = max(self.of_bound, of_bound)
        self.of_size = max(self.of_size, float(np.max(error / Assembled(program).size(x))))

    def row(self, kind):
        return [kind, self.programs, self.answers, self.ill_conditioned, self.failed, self.unsuitable,
                len(self.wrong), self.missed, f"{self.of_bound:.2g}", f"{self.of_size:.1e}"]  # fmt: skip


def study(programs, seed, names=None):
    """Return one `Tally` per kind, over programs drawn from a seed."""
    tally = defaultdict(Tally)
    for number in range(programs):
        kind = list(KINDS)[number % len(KINDS)]
        program = KINDS[kind](np.random.default_rng([seed, number]))
        tally[kind].add(number, program, [solved(name, program) for name in names or backends.available()])
    return tally


def solved(name, program):
    try:
        return Outcome(name, solution=backends.get(name).solve(program))
    except (NoSolutionError, UnsuitableError, InfeasibleError) as error:
        return Outcome(name, error=error)
    except CvxshearError as error:
        raise AssertionError(f"{name}: {error}") from error


def exactly(program):
    """Return the minimizer in rational numbers (None without a minimizer), and whether uniqueness is certain."""
    R, s = (rational(part) for part in program.weighted)
    A, b = (rational(part) for part in program.equalities)
    G, h = (rational(part) for part in program.inequalities)
    rows = list(range(len(G)))
    n = program.unknowns
    N = [[sum(row[i] * row[j] for row in R) for j in range(n)] for i in range(n)]
    c = [sum(row[i] * side for row, side in zip(R, s, strict=True)) for i in range(n)]
    subsets = itertools.chain.from_iterable(itertools.combinations(rows, size) for size in range(len(rows) + 1))
    for active in itertools.islice(subsets, SUBSETS):
        found = stationary(N, c, A + [G[i] for i in active], b + [h[i] for i in active])
        if found is None:
            continue
        x, multipliers = found[:n], found[n + len(A) :]
        if any(value < 0 for value in multipliers):
            continue
        if all(dot(G[i], x) <= h[i] for i in rows):
            strict = [i for i, value in zip(active, multipliers, strict=True) if value > 0]
            return x, stationary(N, c, A + [G[i] for i in strict], b + [h[i] for i in strict]) is not None
    return None, False


def stationary(N, c, B, sides):
    """Solve N x + B' y = c, B x = sides for x and y by elimination; return None if the system is singular.

    Rows of B that depend on earlier rows are omitted; their multipliers are zero.
    """
    n, kept = len(N), independent(B)
    rows = [B[i] for i in kept]
    system = [[*N[i], *(row[i] for row in rows), c[i]] for i in range(n)]
    system += [[*row, *([Fraction(0)] * len(rows)), sides[i]] for row, i in zip(rows, kept, strict=True)]
    found = eliminated(system)
    if found is None or any(dot(B[i], found[:n]) != sides[i] for i in range(len(B))):
        return None
    y = [Fraction(0)] * len(B)
    for place, i in enumerate(kept):
        y[i] = found[n + place]
    return found[:n] + y


def independent(rows):
    """Return which rows are independent of the earlier rows."""
    kept, reduced = [], []
    for i, row in enumerate(rows):
        left = list(row)
        for pivot, basis in reduced:
            factor = left[pivot] / basis[pivot]
            left = [a - factor * b for a, b in zip(left, basis, strict=True)]
        pivot = next((j for j, value in enumerate(left) if value), None)
        if pivot is not None:
            kept.append(i)
            reduced.append((pivot, left))
    return kept


def eliminated(system):
    """Solve a square system whose last column is the right side; return None if the system is singular."""
    system = [list(row) for row in system]
    size = len(system)
    for k in range(size):
        pivot = next((i for i in range(k, size) if system[i][k]), None)
        if pivot is None:
            return None
        system[k], system[pivot] = system[pivot], system[k]
        for i in range(size):
            if i != k and system[i][k]:
                factor = system[i][k] / system[k][k]
                system[i] = [a - factor * b for a, b in zip(system[i], system[k], strict=True)]
    return [system[k][size] / system[k][k] for k in range(size)]


def rational(array):
    array = np.asarray(array)
    if array.ndim == 2:
        return [[Fraction(float(value)) for value in row] for row in array]
    return [Fraction(float(value)) for value in array]


def dot(row, x):
    return sum(a * b for a, b in zip(row, x, strict=True))


def frame_modes(mass, stiffness):
    """Return eigenvalues and mode shapes (columns, largest entry 1) of a shear frame from its dense matrices."""
    n = len(mass)
    T = np.eye(n) - np.eye(n, k=-1)
    eigenvalues, shapes = eigh(T.T @ np.diag(stiffness) @ T, np.diag(mass))
    return eigenvalues, shapes / np.max(np.abs(shapes), axis=0)


def tight_prior(rng):
    """Draw the program of all masses with an exact total and a soft prior of 1e-12 to 1e-4 on one mass."""
    n = int(rng.integers(2, 5))
    mass = rng.uniform(5, 20, n)
    _, shapes = frame_modes(mass, rng.uniform(1e4, 3e4, n))
    shapes = shapes + rng.choice([0.0, 0.01]) * rng.standard_normal((n, n))
    plain = one_shot_rows(shapes, mass.sum())
    std, at = 10.0 ** rng.uniform(-12, -4), int(rng.integers(n))
    value = mass[at] * rng.uniform(0.9, 1.1)
    row = np.zeros((1, n))
    row[0, at] = 1.0 / (value * std)
    noise = 0.01 * mass.mean()
    R, s = plain.weighted
    return plain.replace(
        R=np.concatenate([R / noise, row]), s=np.concatenate([s / noise, [1.0 / std]]), lower=np.zeros(n)
    )


def stiffness_ratio(rng):
    """Draw a program of stiffnesses with ratios of up to 1e8, from exact or noisy modes."""
    n = int(rng.integers(2, 6))
    stiffness = 10.0 ** rng.uniform(0, rng.uniform(1, 8), n)
    mass = rng.uniform(1, 2, n)
    eigenvalues, shapes = frame_modes(mass, stiffness)
    shapes = shapes * (1 + rng.choice([0.0, 1e-6, 1e-2]) * rng.standard_normal((n, n)))
    shapes = shapes / np.sqrt(np.sum(mass[:, None] * shapes**2, axis=0))
    return stiffness_rows(shapes, np.abs(eigenvalues)).replace(lower=np.zeros(n))


def repeated_modes(rng):
    """Draw a program of masses and stiffnesses with nearly repeated modes: stiff parts on soft joints."""
    n = int(rng.integers(3, 6))
    soft = 10.0 ** rng.uniform(-9, -2)
    stiffness = 1000.0 * np.where(np.arange(n) % 2 == 1, soft, 1.0)
    mass = np.ones(n) * (1 + soft * rng.standard_normal(n))
    eigenvalues, shapes = frame_modes(mass, stiffness)
    if rng.random() < 0.5:
        return one_shot_rows(shapes, mass.sum()).replace(lower=np.full(n, 1e-3))
    shapes = shapes / np.sqrt(np.sum(mass[:, None] * shapes**2, axis=0))
    return stiffness_rows(shapes, np.abs(eigenvalues)).replace(lower=np.full(n, 1e-6))


def ill_conditioned(rng):
    """Draw rows with a condition number of up to 1e14, and bounds close to the unbounded answer."""
    n, rows = int(rng.integers(2, 6)), int(rng.integers(5, 9))
    left = np.linalg.qr(rng.standard_normal((rows, n)))[0]
    right = np.linalg.qr(rng.standard_normal((n, n)))[0]
    condition = 10.0 ** rng.uniform(0, 14)
    R = left @ np.diag(np.geomspace(1.0, 1.0 / condition, n)) @ right.T
    inside = rng.standard_normal(n)
    s = R @ inside + rng.choice([0.0, 1e-3]) * rng.standard_normal(rows)
    lower = np.where(rng.random(n) < 0.5, inside - 0.1 * rng.standard_normal(n), -np.inf)
    return LeastSquares(R, s, lower=lower)


def units(rng):
    """Draw unknowns and rows of arbitrary units, an equality, and an inequality."""
    n = int(rng.integers(2, 6))
    sizes, weights = 10.0 ** rng.uniform(-9, 9, n), 10.0 ** rng.uniform(-4, 4, 8)
    R, A, G = (rng.standard_normal((rows, n)) / sizes for rows in (8, 1, 2))
    return LeastSquares(
        weights[:, None] * R, weights * rng.standard_normal(8), A=A, b=rng.standard_normal(1),
        G=G, h=rng.uniform(0, 1, 2) + np.maximum(G @ (np.linalg.pinv(A)[:, 0] * 0), 0),
    )  # fmt: skip


def degenerate(rng):
    """Draw constraints that touch the minimizer with zero multipliers, repeat each other, or follow from others."""
    n = int(rng.integers(2, 5))
    R, x = rng.standard_normal((n + 3, n)), rng.integers(-4, 5, n).astype(float)
    residual = np.linalg.qr(R, mode="complete")[0][:, n:] @ rng.standard_normal(3) * rng.choice([0.0, 1.0])
    G = np.concatenate([np.eye(n)[:2], 2 * np.eye(n)[:1], np.ones((1, n))])
    A = np.concatenate([np.ones((1, n)), 3 * np.ones((1, n))])
    pushed = G.T @ (rng.uniform(0, 1, 4) * rng.integers(0, 2, 4))
    s = R @ x + residual + np.linalg.pinv(R).T @ pushed
    return LeastSquares(R, s, G=G, h=G @ x, A=A, b=A @ x)


def open_direction(rng):
    """Draw fewer rows than unknowns; sometimes bounds determine the open directions."""
    n = int(rng.integers(2, 5))
    R = rng.standard_normal((n - 1, n))
    x = rng.uniform(1, 2, n)
    s = R @ x - rng.choice([0.0, 3.0])
    return LeastSquares(R, s, lower=x - rng.choice([0.0, 1.0], n), upper=x + rng.choice([0.0, 1.0], n))


def last_step(rng):
    """Draw a step of a converged iteration: the residual is orthogonal to the rows, and bounds are touched."""
    n = int(rng.integers(2, 6))
    R = rng.standard_normal((n + 4, n)) * 10.0 ** rng.uniform(-3, 3, n)
    s = np.linalg.qr(R, mode="complete")[0][:, n:] @ rng.standard_normal(4)
    lower = np.where(rng.random(n) < 0.4, 0.0, -1.0)
    damping = 1e-7 * np.diag(np.linalg.norm(R, axis=0))
    return LeastSquares(
        np.concatenate([R, damping]), np.concatenate([s, np.zeros(n)]), lower=lower, A=np.ones((1, n)), b=np.zeros(1)
    )


def contradictory(rng):
    """Draw bounds that contradict the exact sum by 1e-3 to 1e-6: there is no minimizer."""
    n = int(rng.integers(2, 5))
    lower = rng.uniform(1, 2, n)
    gap = 10.0 ** rng.uniform(-6, -3)
    return LeastSquares(
        rng.standard_normal((n + 2, n)), rng.standard_normal(n + 2), A=np.ones((1, n)),
        b=np.array([lower.sum() * (1 - gap)]), lower=lower,
    )  # fmt: skip


KINDS = {
    "soft prior of 1e-12 to 1e-4": tight_prior,
    "stiffness ratios up to 1e8": stiffness_ratio,
    "nearly repeated modes": repeated_modes,
    "condition numbers up to 1e14": ill_conditioned,
    "units from 1e-9 to 1e9": units,
    "degenerate constraints": degenerate,
    "open directions": open_direction,
    "last step of an iteration": last_step,
    "contradictory bounds": contradictory,
}
"""Generators of programs, by kind; each takes a random generator."""


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
