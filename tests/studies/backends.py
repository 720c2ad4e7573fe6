"""Count how each backend's answers are accepted: as given, polished, replaced, or refused."""

import numpy as np

import cvxshear
from cvxshear import CvxshearError, UnsuitableError, backends
from cvxshear.fit.identification import programs_of
from cvxshear.io.toml import BUILT_IN
from cvxshear.programs import Acceptance, LeastSquares
from tests.studies.timing import table

RANDOM_PROGRAMS = 30
COLUMNS = [*(each.value for each in Acceptance), "refused", "not solved: an inequality is active"]


def main():
    programs = programs_of_examples(BUILT_IN) + [bounded(seed) for seed in range(RANDOM_PROGRAMS)]
    rows = [[name, *answers(name, programs).values()] for name in backends.available()]
    table(f"Answers to {len(programs)} programs", ["backend", *COLUMNS], rows)


def programs_of_examples(names):
    """Return the programs of built-in examples."""
    return [each.program for name in names for each in programs_of(cvxshear.load(name))[0]]


def bounded(seed):
    """Return a random program with ten unknowns, half of them at a bound."""
    rng = np.random.default_rng(seed)
    R, s = rng.standard_normal((30, 10)), rng.standard_normal(30)
    free = np.linalg.lstsq(R, s, rcond=None)[0]
    return LeastSquares(R, s, lower=np.full(10, np.quantile(free, 0.3)), upper=np.full(10, np.quantile(free, 0.8)))


def answers(name, programs):
    """Return the number of a backend's answers for each column of the table."""
    counts = dict.fromkeys(COLUMNS, 0)
    for program in programs:
        try:
            counts[program.solve(name).acceptance.value] += 1
        except UnsuitableError:
            counts[COLUMNS[-1]] += 1
        except CvxshearError:
            counts["refused"] += 1
    return counts
