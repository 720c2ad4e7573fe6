"""Test the statement of each prior against numbers computed by hand, and the names of contradictory priors."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cvxshear.measurement.experiment import Experiment, Frame
from cvxshear.priors import Bounds, Constraints, Monotone, Nominal, Prior, Ratio, Value
from cvxshear.programs.constraints import NamedConstraints, feasible, refuse_contradictions, statements
from cvxshear.util.errors import InfeasibleError, InputError

AT = np.array([10.0, 7.5, 5.0])
"""Point for the evaluation of soft priors: the floor masses of the paper's three-story frame, kg."""


@dataclass(frozen=True, eq=False)
class Smooth(Prior):
    """Neighboring stories differ little: r_i = (x[i+1] - x[i]) / width."""

    kind: ClassVar[str] = "test-smooth"
    quantity: str
    width: float = 1.0
    skipped: tuple[int, ...] = field(default_factory=tuple)

    def residual(self, x):
        J = np.diff(np.eye(len(x)), axis=0) / self.width
        return J @ x, J


class Lightest(Prior):
    """The top floor is the lightest. This prior has no kind, so a file cannot name it."""

    quantity = "floor_mass"

    def constraints(self, stories):
        rows = -np.eye(stories)[:-1]
        rows[:, -1] = 1.0
        return Constraints(G=rows, h=np.zeros(stories - 1))


def said(prior, stories=3):
    """Return the prior's constraints without those that are None."""
    return {name: value for name, value in vars(prior.constraints(stories)).items() if value is not None}


EXACT = [
    (Bounds("floor_mass", lower=2.0, upper=[9.0, 8.0, 7.0]), {"lower": [2, 2, 2], "upper": [9, 8, 7]}),
    (Bounds("floor_mass", lower=2.0), {"lower": [2, 2, 2], "upper": [np.inf] * 3}),
    (Bounds("floor_mass", upper=2.0), {"lower": [-np.inf] * 3, "upper": [2, 2, 2]}),
    (Ratio("floor_mass", of=3, to=1, value=0.5), {"A": [[-0.5, 0, 1]], "b": [0]}),
    (Value("story_stiffness", at=2, value=1200.0), {"A": [[0, 1, 0]], "b": [1200]}),
    (Nominal("floor_mass", values=[9.0, 8.0, 7.0]), {"A": np.eye(3), "b": [9, 8, 7]}),
]


@pytest.mark.parametrize(("prior", "expected"), EXACT, ids=lambda item: getattr(item, "kind", ""))
def test_an_exact_prior_is_rows_of_constraints(prior, expected):
    found = said(prior)
    assert set(found) == set(expected)
    for name, value in expected.items():
        assert_array_equal(found[name], value)
    assert no_rows(prior)


SOFT = [
    (
        Ratio("floor_mass", of=2, to=3, value=1.2, std=0.05),
        [np.log(7.5 / 6.0) / 0.05], [[0, 1 / (7.5 * 0.05), -1 / (5.0 * 0.05)]],
    ),
    # 10 kg is a quarter above 8 kg, and a standard deviation is a tenth.
    (Value("floor_mass", at=1, value=8.0, std=0.1), [2.5], [[1.25, 0, 0]]),
    (Nominal("floor_mass", [8.0, 7.5, 10.0], std=0.1), [2.5, 0, -5], np.diag([1.25, 1 / 0.75, 1.0])),
    (Smooth("floor_mass", width=2.0), [-1.25, -1.25], [[-0.5, 0.5, 0], [0, -0.5, 0.5]]),
]  # fmt: skip


@pytest.mark.parametrize(("prior", "r", "J"), SOFT, ids=lambda item: getattr(item, "kind", ""))
def test_a_soft_prior_is_a_residual(prior, r, J):
    assert said(prior) == {}
    assert_allclose(prior.residual(AT)[0], r)
    assert_allclose(prior.residual(AT)[1], J)


def no_rows(prior):
    r, J = prior.residual(AT)
    return r.shape == (0,) and J.shape == (0, 3)


def test_exact_nominal_of_free_scale():
    prior = Nominal("floor_mass", values=[4.0, 3.0, 2.0], free_scale=True)
    rows = said(prior)
    assert rows["A"].shape == (2, 3)
    assert_allclose(rows["A"] @ [8.0, 6.0, 4.0], 0, atol=1e-15, err_msg="any multiple keeps it")
    assert np.linalg.matrix_rank(rows["A"]) == 2
    assert_array_equal(rows["b"], [0, 0])
    assert no_rows(prior)


def test_soft_nominal_of_free_scale():
    prior = Nominal("floor_mass", values=[4.0, 3.0, 1.0], std=0.1, free_scale=True)
    assert said(prior) == {}
    r, J = prior.residual(AT)
    logs = np.log(AT / [4.0, 3.0, 1.0]) / 0.1
    assert r.shape == (2,), "a free factor takes one of three statements away"
    assert_allclose(r @ r, np.sum((logs - logs.mean()) ** 2))
    assert_allclose(J @ AT, 0, atol=1e-13, err_msg="a common factor changes nothing")
    assert_allclose(prior.residual(7.0 * AT)[0], r, atol=1e-13)
    steps = 1e-5 * np.diag(AT)
    central = [(prior.residual(AT + step)[0] - prior.residual(AT - step)[0]) / (2 * step.sum()) for step in steps]
    assert_allclose(J, np.transpose(central), rtol=1e-8, atol=1e-9)


def test_free_scale_of_a_single_story_says_nothing():
    prior = Nominal("floor_mass", values=[4.0], std=0.1, free_scale=True)
    r, J = prior.residual(np.array([3.0]))
    assert (r.shape, J.shape) == ((0,), (0, 1))
    assert Nominal("floor_mass", values=[4.0], free_scale=True).constraints(1).A.shape == (0, 1)


@pytest.mark.parametrize(
    ("direction", "kept", "broken"),
    [("decreasing", [3.0, 2.0, 2.0], [3.0, 1.0, 2.0]), ("increasing", [1.0, 1.0, 2.0], [1.0, 2.0, 1.5])],
)
def test_monotone(direction, kept, broken):
    prior = Monotone("story_stiffness", direction)
    rows = said(prior)
    assert set(rows) == {"G", "h"}
    assert np.all(rows["G"] @ kept <= rows["h"])
    assert not np.all(rows["G"] @ broken <= rows["h"])
    assert no_rows(prior)
    assert prior.constraints(1).G.shape == (0, 1)


DESCRIPTIONS = [
    (Bounds("floor_mass", lower=2.0), "floor_mass at least 2 kg"),
    (Bounds("story_stiffness", upper=[3e6, 2.5e6]), "story_stiffness at most [3000, 2500] kN/m"),
    (Bounds("floor_mass", lower=2, upper=[3, 4]), "floor_mass at least 2 kg and at most [3, 4] kg"),
    (Ratio("floor_mass", of=2, to=1, value=1.5), "floor_mass 2 is 1.5 times floor_mass 1"),
    (Ratio("floor_mass", of=2, to=1, value=1.5, std=0.02), "floor_mass 2 is 1.5 times floor_mass 1 within 2 %"),
    (Value("story_stiffness", at=1, value=2e4), "story_stiffness 1 is 20 kN/m"),
    (Value("story_stiffness", at=1, value=1.155e8), "story_stiffness 1 is 115.5 MN/m"),
    (Value("floor_mass", at=2, value=21.02e3), "floor_mass 2 is 21.02 t"),
    (Ratio("floor_mass", of=2, to=1, value=1.0, std=0.04), "floor_mass 2 is equal to floor_mass 1 within 4 %"),
    (Value("floor_mass", at=1, value=9.5, std=0.005), "floor_mass 1 is 9.5 kg within 0.5 %"),
    (Nominal("floor_mass", [9.0, 7.5]), "floor_mass is [9, 7.5] kg"),
    (
        Nominal("floor_mass", [9.0, 7.5], std=0.1, free_scale=True),
        "floor_mass is [9, 7.5] kg up to a common factor within 10 %",
    ),
    (Monotone("story_stiffness", "decreasing"), "story_stiffness only decreasing with height"),
    (Smooth("floor_mass"), "test-smooth on floor_mass"),
    (Lightest(), "Lightest on floor_mass"),
]


@pytest.mark.parametrize(("prior", "words"), DESCRIPTIONS, ids=[words for _, words in DESCRIPTIONS])
def test_describe(prior, words):
    assert prior.describe() == words


@pytest.mark.parametrize(
    ("prior", "fixes"),
    [
        (Bounds("floor_mass", lower=1.0), False),
        (Ratio("floor_mass", of=1, to=2, value=1.0), False),
        (Monotone("floor_mass", "increasing"), False),
        (Nominal("floor_mass", [1.0, 1.0], free_scale=True), False),
        (Nominal("floor_mass", [1.0, 1.0]), True),
        (Nominal("story_stiffness", [1.0, 1.0], std=0.1), True),
        (Value("story_stiffness", at=1, value=1.0), True),
    ],
)
def test_which_priors_fix_the_scale(prior, fixes):
    assert prior.fixes_scale is fixes


@pytest.mark.parametrize("prior", [prior for prior, _ in DESCRIPTIONS[:-2]], ids=[w for _, w in DESCRIPTIONS[:-2]])
def test_to_dict_declares_the_same_prior(prior):
    again = Prior.from_dict(prior.to_dict())
    assert type(again) is type(prior)
    np.testing.assert_equal(vars(again), vars(prior))


# A custom prior.


def experiment(**declared):
    state = {"frequencies": [2.0, 5.0], "mode_shapes": [[0.6, 1.0], [-1.7, 1.0]]}
    return Experiment.from_dict({"frame": {"total_mass": 30.0}, "configuration": [state], **declared})


def test_a_prior_of_ones_own_in_a_file():
    (prior,) = experiment(prior=[{"kind": "test-smooth", "quantity": "floor_mass", "width": 2.0}]).priors
    assert isinstance(prior, Smooth)
    assert prior.width == 2.0
    assert_allclose(prior.residual(AT)[0], [-1.25, -1.25])
    assert prior.to_dict() == {"kind": "test-smooth", "quantity": "floor_mass", "width": 2.0, "skipped": []}


def test_a_prior_without_a_kind_is_handed_in():
    found = experiment().with_priors([Lightest()])
    assert isinstance(found.priors[0], Lightest)
    assert found.to_dict()["prior"] == [{"kind": "Lightest", "quantity": "floor_mass"}]
    assert "Lightest" not in Prior.kinds


def test_a_prior_must_say_what_it_is_about():
    class Vague(Prior):
        pass

    with pytest.raises(InputError, match=r"^prior 1: quantity of the Vague prior must be one of floor_mass"):
        experiment().with_priors([Vague()])


def test_a_kind_that_is_taken_is_refused():
    with pytest.raises(InputError, match=r"^the prior kind 'bounds' is already Bounds's; give Other another$"):

        class Other(Prior):
            kind = "bounds"

    assert Prior.kinds["bounds"] is Bounds


def test_the_same_class_may_be_defined_again(monkeypatch):
    monkeypatch.setattr(Prior, "kinds", dict(Prior.kinds))

    def define():
        @dataclass(frozen=True, eq=False, slots=True)
        class Again(Prior):
            kind: ClassVar[str] = "test-again"
            quantity: str

        return Again

    define()
    last = define()
    assert isinstance(Prior.from_dict({"kind": "test-again", "quantity": "floor_mass"}), last)


def test_a_kind_that_is_no_dataclass_cannot_be_named_in_a_file(monkeypatch):
    monkeypatch.setattr(Prior, "kinds", dict(Prior.kinds))

    class Plain(Prior):
        kind = "test-plain"
        quantity = "floor_mass"

    with pytest.raises(InputError, match=r"^the test-plain prior cannot be named in a file: Plain is not a dataclass$"):
        Prior.from_dict({"kind": "test-plain"})


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"G": np.eye(2)}, "Constraints: G and h belong together; give both or neither"),
        ({"b": np.zeros(2)}, "Constraints: A and b belong together; give both or neither"),
        (
            {"A": np.ones(2), "b": np.zeros(1)},
            "Constraints: A must have the shape (rows, N) and b the shape (rows,), not (2,) and (1,)",
        ),
        (
            {"G": np.eye(2), "h": np.zeros(3)},
            "Constraints: G must have the shape (rows, N) and h the shape (rows,), not (2, 2) and (3,)",
        ),
    ],
)
def test_constraints_of_two_halves_that_do_not_fit(parts, message):
    with pytest.raises(InputError) as caught:
        Constraints(**parts)
    assert str(caught.value) == message


# Contradictions.

POSITIVE = "floor_mass is positive"
TOTAL = Frame(total_mass=30.0)


def core(priors, *, frame=TOTAL, stories=2, quantity="floor_mass"):
    """Return the statements that the refusal names."""
    with pytest.raises(InfeasibleError) as caught:
        refuse_contradictions(statements(priors, quantity, stories, frame), stories)
    head, names = str(caught.value).split(": ", 1)
    assert head == "these cannot all be true"
    return names.split("; ")


@pytest.mark.parametrize(
    "priors",
    [
        [Bounds("floor_mass", lower=5.0, upper=20.0), Ratio("floor_mass", of=2, to=1, value=2.0)],
        [Value("floor_mass", at=1, value=each, std=0.01) for each in (10.0, 20.0)],
        [Value("story_stiffness", at=1, value=each) for each in (1.0, 2.0)],
    ],
    ids=["possible", "soft", "of the other quantity"],
)
def test_no_contradiction(priors):
    parts = statements(priors, "floor_mass", 2, TOTAL)
    refuse_contradictions(parts, 2)
    assert feasible(parts, 2)


TOTAL_NAME = "total_mass = 30 kg"
LOW = Bounds("floor_mass", lower=[8.0, 1.0])
STIFF = Bounds("story_stiffness", lower=[1e6, 1e6], upper=[2e6, 2e6])
TRIPLE = Ratio("floor_mass", of=2, to=1, value=3.0)
STIFF_TRIPLE = Ratio("story_stiffness", of=2, to=1, value=3.0)
TEN, TWELVE, HEAVY = (Value("floor_mass", at=at, value=value) for at, value in ((1, 10.0), (2, 12.0), (1, 31.0)))
MORE = Value("floor_mass", at=1, value=10.1)
FALLING = Monotone("floor_mass", "decreasing")


@pytest.mark.parametrize(
    ("priors", "frame", "others"),
    [
        # Three to one of 30 kg is 7.5 kg on floor 1, below the bound. Each statement alone is possible.
        ((LOW, TRIPLE), TOTAL, [TOTAL_NAME]),
        ((STIFF, STIFF_TRIPLE), None, []),
        ((TEN, TWELVE, FALLING), None, []),
        ((TEN, MORE), None, []),
        ((HEAVY,), TOTAL, [POSITIVE, TOTAL_NAME]),
        ((TRIPLE,), Frame(floor_masses=[15.0, 15.0]), ["floor_masses"]),
        ((Lightest(), Value("floor_mass", at=2, value=20.0)), TOTAL, [TOTAL_NAME]),
    ],
)
def test_the_statements_of_a_contradiction_are_named(priors, frame, others):
    names = core(priors, frame=frame, quantity=priors[0].quantity)
    assert names == [*others, *(f"prior: {prior.describe()}" for prior in priors)]


@pytest.mark.parametrize("bounds", [{"lower": 16.0}, {"upper": 14.0}, {"upper": [1.0, 28.0]}], ids=str)
def test_bounds_that_exclude_the_total_mass(bounds):
    prior = Bounds("floor_mass", **bounds)
    bystanders = [Monotone("floor_mass", "increasing"), Ratio("floor_mass", of=1, to=2, value=1.0, std=0.1)]
    assert core([bystanders[0], prior, bystanders[1]]) == [TOTAL_NAME, f"prior: {prior.describe()}"]


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e9, 1e12], ids=str)
def test_whatever_the_unit_a_contradiction_is_found_and_nothing_else(size):
    """Stiffnesses of 1e9 N/m give rows of 1e-9, below a solver's absolute tolerances."""
    design = Nominal("story_stiffness", size * np.array([1.0, 2.0]), free_scale=True)
    first = Value("story_stiffness", at=1, value=size)
    wrong = Value("story_stiffness", at=2, value=2.1 * size)
    right = Value("story_stiffness", at=2, value=2.0 * size)
    refuse_contradictions(statements([design, first, right], "story_stiffness", 2), 2)
    names = core([design, first, wrong], quantity="story_stiffness", frame=None)
    assert names == [f"prior: {prior.describe()}" for prior in (design, first, wrong)]


def test_the_set_named_is_a_smallest_one():
    """Without any one of the named statements, the rest can be true."""
    priors = [
        Bounds("floor_mass", lower=1.0),
        Monotone("floor_mass", "decreasing"),
        Ratio("floor_mass", of=3, to=2, value=1.0),
        Value("floor_mass", at=1, value=4.0),
        Bounds("floor_mass", upper=25.0),
    ]
    parts = statements(priors, "floor_mass", 3, TOTAL)
    named = core(priors, stories=3)
    inside = [part for part in parts if part.name in named]
    assert 2 <= len(inside) < len(parts)
    assert not feasible(inside, 3)
    for part in inside:
        assert feasible([other for other in inside if other is not part], 3)


@pytest.mark.parametrize(
    ("constraints", "message"),
    [
        (Constraints(A=np.ones((1, 3)), b=np.ones(1)), "its A has the shape (1, 3), where the last length must be 2"),
        (Constraints(lower=np.zeros(3)), "its lower has the shape (3,), where the last length must be 2"),
        (Constraints(upper=np.array([1.0, np.nan])), "its upper must hold finite numbers, not nan"),
        (Constraints(lower=np.array([1.0, np.inf])), "its lower must hold finite numbers, not inf"),
        (Constraints(G=np.eye(2), h=np.array([1.0, np.inf])), "its h must hold finite numbers, not inf"),
    ],
)
def test_a_statement_about_something_else(constraints, message):
    with pytest.raises(InputError) as caught:
        refuse_contradictions([NamedConstraints("prior: mine", constraints)], 2)
    assert str(caught.value) == f"prior: mine: {message}"


@pytest.mark.parametrize(
    ("prior", "expected"),
    [
        (Value("floor_mass", 2, 13.0, 0.1), [np.nan, 13.0, np.nan]),
        (Nominal("floor_mass", [1.0, 2.0, 3.0], free_scale=True), [1.0, 2.0, 3.0]),
        (Ratio("floor_mass", 1, 2, 2.0), None),
        (Bounds("floor_mass", lower=1.0), None),
    ],
)
def test_what_a_prior_suggests(prior, expected):
    suggested = prior.suggested(3)
    assert suggested is expected or np.array_equal(suggested, expected, equal_nan=True)
