"""Custom backends and priors are checked when they are added: an error names the part and its fault."""

from dataclasses import dataclass

import numpy as np
import pytest

import cvxshear
from cvxshear import Experiment, InputError, NoSolutionError, backends
from cvxshear.backends import Answer, Backend
from cvxshear.priors import Constraints, Prior
from cvxshear.programs import LeastSquares
from tests import frames

FRAME = Experiment.from_dict(frames.experiment([12.0, 18.0], [2e4, 1.5e4]))
PROGRAM = LeastSquares(np.eye(3), np.array([1.0, 2.0, 3.0]), A=np.ones((1, 3)), b=np.array([5.0]))


class Guest(Backend):
    """A backend that returns the closed form's answer with a change."""

    name = "guest"

    def __init__(self, change):
        self.change = change

    def answer(self, problem):
        return self.change(backends.get("kkt").answer(problem))


def replaced(**parts):
    return lambda exact: Answer(**{"z": exact.z, "y": exact.y, "w": exact.w, "status": "", "iterations": 1, **parts})


def raising(exact):
    raise ZeroDivisionError("nothing to divide by")


BACKENDS = {
    "nothing": (lambda exact: None, InputError, r"backend guest: answer\(\) must return a .*Answer, not"),
    "a bare array": (lambda exact: exact.z, InputError, r"must return a cvxshear.backends.Answer, not"),
    "z of another length": (
        lambda exact: replaced(z=exact.z[:-1])(exact), InputError, r"z of its answer must have the shape \(.,\), not",
    ),
    "z as a column": (replaced(z=np.ones((3, 1))), InputError, r"the shape \(3,\), not \(3, 1\)"),
    "no multipliers": (replaced(y=None), InputError, r"y of its answer must hold real numbers, not None"),
    "ragged": (replaced(z=[[1.0], [2.0, 3.0]]), InputError, r"z of its answer must hold real numbers"),
    "complex": (lambda exact: replaced(z=exact.z + 0j)(exact), InputError, r"z of its answer must hold real numbers"),
    "words": (replaced(z=["1", "2", "3"]), InputError, r"z of its answer must hold real numbers"),
    "nan": (lambda exact: replaced(z=exact.z * np.nan)(exact), NoSolutionError, r"backend guest: its answer holds nan"),
    "infinite": (replaced(y=np.array([np.inf])), NoSolutionError, r"backend guest: its answer holds inf"),
    "zero": (replaced(z=np.zeros(3)), NoSolutionError, r"backend guest: inaccurate solution"),
    "a little off": (lambda exact: replaced(z=exact.z + 1e-4)(exact), NoSolutionError, r"inaccurate solution"),
    "all too large": (lambda exact: replaced(z=1.1 * exact.z + 0.1)(exact), NoSolutionError, r"inaccurate solution"),
    "multipliers of the wrong sign": (
        lambda exact: replaced(y=-exact.y)(exact), NoSolutionError, r"inaccurate solution .*dual residual",
    ),
    "an exception": (raising, NoSolutionError, r"answer\(\) raised ZeroDivisionError: nothing to divide by"),
}  # fmt: skip


@pytest.mark.parametrize("what", BACKENDS)
def test_a_backend_that_does_wrong_is_named_with_the_first_thing_wrong(what):
    change, error, message = BACKENDS[what]
    with pytest.raises(error, match=message):
        Guest(change).solve(PROGRAM)


def test_integers_and_lists_are_numbers_too():
    found = Guest(lambda exact: replaced(z=exact.z.tolist(), y=exact.y.tolist())(exact)).solve(PROGRAM)
    np.testing.assert_allclose(found.x, PROGRAM.s - 1.0 / 3.0)


@dataclass(frozen=True, eq=False)
class Weighed(Prior):
    """A soft prior on the sum of the floor masses, with changed residual and derivative."""

    quantity: str
    change: object
    exact: object = None

    def constraints(self, stories):
        return Constraints() if self.exact is None else self.exact(stories)

    def residual(self, x):
        row = np.ones((1, len(x)))
        return self.change(x, (row @ x / 30.0 - 1.0) / 0.01, row / 30.0 / 0.01)


def soft(change):
    return Weighed("floor_mass", change)


def hard(exact):
    return Weighed("floor_mass", lambda x, r, J: (r, J), exact)


def in_place(x, r, J):
    x *= 2.0
    return r, J


PRIORS = {
    "half the derivative": (soft(lambda x, r, J: (r, J / 2)), r"entry 1 .* is wrong: it differs .* by 50 %"),
    "the derivative of one entry alone": (
        soft(lambda x, r, J: (r, J * (np.arange(len(x)) == 0))), r"derivative of entry 1 of its residual is wrong",
    ),
    "no derivative": (soft(lambda x, r, J: (r, 0 * J)), r"derivative of entry 1 of its residual is wrong"),
    "nan": (soft(lambda x, r, J: (r * np.nan, J)), "nowhere finite from 1 to 1e"),
    "an infinite derivative": (soft(lambda x, r, J: (r, J / 0.0)), "nowhere finite"),
    "complex": (soft(lambda x, r, J: (r + 1j, J)), "r of its residual must hold real numbers"),
    "a number": (soft(lambda x, r, J: (float(r[0]), J)), r"of the shapes \(p,\) and \(p, 2\), not \(\) and \(1, 2\)"),
    "a transposed derivative": (soft(lambda x, r, J: (r, J.T)), r"not \(1,\) and \(2, 1\)"),
    "the residual alone": (soft(lambda x, r, J: r), r"residual must return \(r, J\)"),
    "nothing": (soft(lambda x, r, J: None), r"residual must return \(r, J\), not None"),
    "masked": (soft(lambda x, r, J: (np.ma.masked_array(r, [True]), J)), "must hold real numbers"),
    "x changed in place": (soft(in_place), "residual raised ValueError: .* read-only"),
    "an exception": (soft(lambda x, r, J: 1 / 0), "residual raised ZeroDivisionError"),
    "no constraints": (hard(lambda stories: None), "constraints must return a Constraints, not None"),
    "constraints of another length": (
        hard(lambda stories: Constraints(A=np.ones((1, 5)), b=np.ones(1))), r"its A has the shape \(1, 5\)",
    ),
    "constraints with nan": (hard(lambda stories: Constraints(lower=np.array([np.nan, 1.0]))), "its lower must hold"),
    "complex constraints": (
        hard(lambda stories: Constraints(A=np.ones((1, 2)) * 1j, b=np.ones(1))), "its A must hold real numbers",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", PRIORS)
def test_a_prior_that_does_wrong_is_named_with_the_first_thing_wrong(what):
    prior, message = PRIORS[what]
    with np.errstate(divide="ignore", invalid="ignore"), pytest.raises(InputError, match=message) as caught:
        FRAME.with_priors([prior])
    assert "the Weighed prior on floor_mass" in str(caught.value)


def test_priors_of_any_size_and_curvature_pass():
    """Residuals that overflow or are strongly curved are checked at their smallest."""
    paper = cvxshear.load("paper")
    for change in (
        lambda x, r, J: (np.exp(x / 10) - 3, np.diag(np.exp(x / 10) / 10)),
        lambda x, r, J: (np.log(x / 1e5) / 0.01, np.diag(0.01**-1 / x)),
    ):
        prior = soft(change)
        assert paper.with_priors([prior]).priors[-1] is prior


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"R": [[1.0]]}, "R of a program must be an array of finite numbers"),
        ({"W": np.ones(2)}, r"W of a program .* of the shape \(3,\)"),
        ({"G": np.eye(3)}, "G and h belong together"),
        ({"lower": np.full(3, np.nan)}, "its lower must hold finite numbers, not nan"),
        ({"lower": np.full(3, 2.0), "upper": np.full(3, 1.0)}, "true: x >= lower; x <= upper"),
    ],
)
def test_a_program_that_makes_no_sense_is_refused(changes, message):
    with pytest.raises(InputError, match=message):
        PROGRAM.replace(**changes).solve()
    with pytest.raises(InputError, match="a backend must be an instance of"):
        backends.register(Guest)
