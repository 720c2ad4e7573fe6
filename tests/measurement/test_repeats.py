"""Repeated tests and the covariance of frequencies, against formulas written out and draws of known covariance."""

import numpy as np
import pytest
from scipy import linalg, stats

from cvxshear import Experiment, identify, load
from cvxshear.fit.misfit import Misfit, expected_configuration
from cvxshear.io.toml import write_measurement
from cvxshear.measurement.configuration import Configuration
from cvxshear.measurement.repeats import Repeats
from cvxshear.util.errors import InputError
from tests.frames import modes_of

MASS, STIFFNESS = [10.0, 9.0, 8.0], [26e3, 20e3, 17e3]
FREQUENCIES = modes_of(MASS, STIFFNESS)[0]
COVARIANCE = 1e-6 * np.array([[4.0, 3.0, 1.0], [3.0, 9.0, 2.0], [1.0, 2.0, 6.0]])


def drawn(rng, tests, covariance=COVARIANCE):
    return FREQUENCIES * np.exp(rng.multivariate_normal(np.zeros(3), covariance, tests))


def declared(frame=None, **keys):
    return {"frame": {"floor_masses": MASS, **(frame or {})}, "configuration": [{"name": "bare", **keys}]}


def scaled_frame(covariance, frequencies):
    """A frame known up to one factor on all stiffnesses, so that the fit is a weighted mean."""
    stated = {"kind": "nominal", "quantity": "story_stiffness", "values": STIFFNESS, "free_scale": True}
    return identify({**declared(frequencies=frequencies, frequency_covariance=covariance), "prior": [stated]})


def test_a_covariance_gives_generalized_least_squares():
    off = np.array([0.004, -0.002, 0.001])
    found = scaled_frame(COVARIANCE.tolist(), (FREQUENCIES * np.exp(off)).tolist())
    weights = linalg.solve(COVARIANCE, np.ones(3))
    mean = weights @ off / weights.sum()
    assert found.frame.story_stiffness == pytest.approx(np.array(STIFFNESS) * np.exp(2 * mean), rel=1e-8)
    assert found.frame.story_stiffness_std / found.frame.story_stiffness == pytest.approx(
        2 / np.sqrt(weights.sum()), rel=1e-6
    )
    left = off - mean
    assert found.fit.chi2 == pytest.approx(left @ linalg.solve(COVARIANCE, left), rel=1e-8)
    assert found.fit.dof == 2


def test_independent_deviations_are_unchanged():
    off = FREQUENCIES * np.exp([0.004, -0.002, 0.001])
    std = np.array([0.002, 0.003, 0.001])
    first, second = (
        Misfit(Experiment.from_dict(declared(frequencies=off.tolist(), **noise))).evaluate(np.array(MASS + STIFFNESS))
        for noise in ({"frequency_std": std.tolist()}, {"frequency_covariance": np.diag(std**2).tolist()})
    )
    np.testing.assert_allclose(second.r, first.r, rtol=1e-12)
    np.testing.assert_allclose(second.J, first.J, rtol=1e-12, atol=1e-12 * np.abs(first.J).max())


def test_modes_that_are_left_out_have_no_influence():
    test = {"frequencies": FREQUENCIES.tolist(), "frequency_covariance": COVARIANCE.tolist()}
    theta = np.array(MASS + STIFFNESS) * np.linspace(0.9, 1.1, 6)
    some = Misfit(Experiment.from_dict(declared(**test)), leave_out={"bare": np.array([False, True, False])})
    off = np.log(modes_of(theta[:3], theta[3:])[0] / FREQUENCIES)[[0, 2]]
    expected = off @ linalg.solve(COVARIANCE[np.ix_([0, 2], [0, 2])], off)
    assert some.evaluate(theta).chi2 == pytest.approx(expected, rel=1e-9)


def test_the_mean_and_its_covariance_by_hand():
    tests = np.array([[2.0, 5.0], [2.02, 5.01], [1.99, 5.03], [2.01, 4.99]])
    found = Configuration(repeats={"frequencies": tests.tolist()})
    logs = np.log(tests)
    np.testing.assert_allclose(found.frequencies, np.exp(logs.mean(axis=0)))
    S = (logs - logs.mean(axis=0)).T @ (logs - logs.mean(axis=0)) / 3
    S[0, 1], S[1, 0] = 0.75 * S[0, 1], 0.75 * S[1, 0]
    factor = stats.t.ppf(0.975, 3) / stats.norm.ppf(0.975)
    np.testing.assert_allclose(found.frequency_covariance, factor**2 * S / 4, rtol=1e-10)
    np.testing.assert_allclose(found.frequency_std**2, np.diag(found.frequency_covariance))


@pytest.mark.parametrize("tests", [2, 3, 10])
def test_intervals_of_the_mean_cover(tests):
    """Nineteen intervals in twenty hold the truth, of a frequency, and of sums and differences."""
    rng, hits = np.random.default_rng(tests), []
    directions = np.array([[1, 0, 0], [0, 0, 1], [1, 1, 1], [1, -1, 0]]) / 1.0
    for _ in range(600):
        summary = Repeats(drawn(rng, tests)).summary(mass_normalized=False)
        off = directions @ np.log(summary["frequencies"] / FREQUENCIES)
        std = np.sqrt(np.einsum("ij,jk,ik->i", directions, summary["frequency_covariance"], directions))
        hits.append(np.abs(off) < 1.96 * std)
    # Three deviations of a share of 600 are 2.7 %; correlations of few repeats are taken as smaller than they are.
    np.testing.assert_allclose(np.mean(hits, axis=0)[:2], 0.95, atol=0.027)
    assert np.mean(hits, axis=0)[2:].min() > 0.91


def in_blocks(rng, blocks, tests, between):
    days = np.repeat(rng.multivariate_normal(np.zeros(3), between * COVARIANCE, blocks), tests, axis=0)
    names = [f"day {each + 1}" for each in range(blocks) for _ in range(tests)]
    return Repeats(drawn(rng, blocks * tests) * np.exp(days), block=names)


def test_blocks_that_differ_belong_to_the_deviation():
    rng, within, sizes = np.random.default_rng(3), [], []
    for _ in range(300):
        found = in_blocks(rng, 6, 4, 25.0)
        assert found.blocks_differ.any()
        sizes.append(found.between_std**2)
        summary = found.summary(mass_normalized=False)
        off = np.log(summary["frequencies"] / FREQUENCIES)
        within.append(np.abs(off) < 1.96 * np.sqrt(np.diag(summary["frequency_covariance"])))
    np.testing.assert_allclose(np.mean(within, axis=0), 0.95, atol=0.04)
    np.testing.assert_allclose(np.mean(sizes, axis=0), 25.0 * np.diag(COVARIANCE), rtol=0.15)
    assert "24 repeats in 6 blocks, which differ by more than their scatter" in found.describe()


def test_blocks_that_do_not_differ_are_one_sample():
    rng = np.random.default_rng(4)
    found = [in_blocks(rng, 4, 5, 0.0) for _ in range(300)]
    assert np.mean([each.blocks_differ.any() for each in found]) < 0.09
    same = next(each for each in found if not each.blocks_differ.any())
    summary = same.summary(mass_normalized=False)
    alone = Repeats(same.frequencies).summary(mass_normalized=False)
    np.testing.assert_array_equal(summary["frequency_covariance"], alone["frequency_covariance"])
    assert same.describe() == "20 repeats in 4 blocks, which do not differ by more than their scatter"


def test_repeated_shapes_have_their_own_scales_and_signs():
    """The mean of R shapes has the deviation of one shape over the root of R, and Student's for few."""
    rng, shape = np.random.default_rng(5), np.array([[0.4, 0.8, 1.0], [-1.0, -0.4, 0.9]])
    shapes = shape + 0.01 * rng.standard_normal((40, 2, 3))
    scales = rng.uniform(0.5, 2.0, (40, 2, 1)) * rng.choice([-1.0, 1.0], (40, 2, 1))
    found = Configuration(repeats={"frequencies": drawn(rng, 40)[:, :2], "mode_shapes": shapes * scales})
    unit = found.mode_shapes / found.mode_shapes[:, [2, 0]][[0, 1], [0, 1]][:, None]
    np.testing.assert_allclose(unit, shape / [[1.0], [-1.0]], atol=0.006)
    np.testing.assert_allclose(found.mode_shape_std, 0.01 / np.sqrt(40), rtol=0.25)
    with_masses = Configuration(
        repeats={"frequencies": drawn(rng, 40)[:, :2], "mode_shapes": shapes}, mass_normalized=True
    )
    np.testing.assert_allclose(with_masses.mode_shapes, shapes.mean(axis=0))


TABLE = """# ten weeks
frequency 1; frequency 2; frequency 3; shape 1 1; shape 1 3; shape 2 1; shape 2 3; shape 3 1; block
3,25; 8,91; 13,02; 0,41; 1,0; -1,0; 0,71; ; May
3,26; 8,93; 13,00; 0,40; 1,0; -1,0; 0,70; ; May
3,24; 8,92; 13,05; 0,82; 2,0; 1,0; -0,72; ; June
"""


def test_a_file_of_repeats_and_back(tmp_path):
    (tmp_path / "repeats.csv").write_text(TABLE.replace("; shape 3 1", "").replace("; ;", ";"))
    (tmp_path / "test.toml").write_text(
        '[frame]\ntotal_mass = 27.0\nstories = 3\n[[configuration]]\nname = "bare"\nrepeats = "repeats.csv"\n'
    )
    found = load(tmp_path / "test.toml")
    (test,) = found.configurations
    np.testing.assert_array_equal(test.measured_floors, [1, 3])
    assert test.repeats.block == ("May", "May", "June")
    np.testing.assert_array_equal(np.isnan(test.mode_shapes), [[False, False], [False, False], [True, True]])
    np.testing.assert_allclose(test.mode_shapes[0], [0.4067, 1.0], rtol=5e-3)
    write_measurement(tmp_path / "again.toml", found.to_dict())
    (again,) = load(tmp_path / "again.toml").configurations
    for key in ("frequencies", "frequency_covariance", "frequency_std", "mode_shapes", "mode_shape_std"):
        np.testing.assert_allclose(getattr(again, key), getattr(test, key), rtol=1e-7)
    assert "3 repeats in 2 blocks" in str(identify(found, priors=()))


def test_a_covariance_goes_through_files(tmp_path):
    found = Experiment.from_dict(declared(frequencies=FREQUENCIES.tolist(), frequency_covariance=COVARIANCE.tolist()))
    assert "frequency_std" not in found.to_dict()["configuration"][0]
    write_measurement(tmp_path / "test.toml", found.to_dict())
    np.testing.assert_allclose(
        load(tmp_path / "test.toml").configurations[0].frequency_covariance, COVARIANCE, rtol=1e-7
    )


def test_a_test_that_is_imagined_keeps_the_covariance():
    found = Experiment.from_dict(declared(repeats={"frequencies": drawn(np.random.default_rng(1), 5).tolist()}))
    (test,) = found.configurations
    frequencies, shapes = modes_of(MASS, STIFFNESS)
    imagined = expected_configuration(test, frequencies, shapes, np.full(3, 0.01), np.full((3, 3), 0.01))
    np.testing.assert_array_equal(imagined.frequency_covariance, test.frequency_covariance)


SQUARE = COVARIANCE.tolist()
TESTS = [[3.25, 8.91], [3.26, 8.93], [3.24, 8.92]]


COVARIANCES = [
    ([[1e-6]], "frequency_covariance must have 3 rows, one for each frequency, not 1"),
    ([[1e-6, 0]] * 3, "frequency_covariance has 2 entries a row, not 3"),
    (
        [[4e-6, 1e-6, 0], [0, 4e-6, 0], [0, 0, 4e-6]],
        "frequency_covariance must be symmetric: entry [i][j] equal to entry [j][i]",
    ),
    ([[4e-6] * 3] * 3, "frequency_covariance must be positive definite: a variance above"),
]
REPEATS = [
    ({"frequencies": TESTS[:1]}, "repeats: frequencies must have two tests at least"),
    ({"frequencies": 3.0}, "frequencies must be a list of tests, not 3.0"),
    (
        {"frequencies": [[3.25, 8.9], [3.26, 8.9]]},
        "repeats: frequency 2 is the same in every test, so that its scatter is unknown: write more digits",
    ),
    ({"frequencies": TESTS, "block": ["a"]}, "block must have 3 entries, one a test"),
    (
        {"frequencies": TESTS, "mode_shapes": [[[1.0], [1.0]]] * 2},
        "mode_shapes must have 3 tests, each with the same sensors",
    ),
    ({"frequencies": TESTS, "mode_shapes": [[[1.0, 2.0], [1.0, 3.0]]] * 3}, "shape 1 is the same in every test"),
    ({"frequencies": TESTS, "days": []}, "the table: unknown key 'days'"),
]
GIVEN = {"frequencies": FREQUENCIES.tolist()}
TWICE = "frequency_std and {} are both given: leave frequency_std out"


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        *((GIVEN | {"frequency_covariance": value}, message) for value, message in COVARIANCES),
        *(({"repeats": value}, message) for value, message in REPEATS),
        (GIVEN | {"frequency_covariance": SQUARE, "frequency_std": 0.01}, TWICE.format("frequency_covariance")),
        ({"repeats": {"frequencies": TESTS}, "frequency_std": 0.01}, TWICE.format("repeats")),
        (GIVEN | {"repeats": {"frequencies": TESTS}}, "frequencies and repeats are both given: leave frequencies out"),
    ],
)
def test_the_message_says_what_to_change(keys, message):
    with pytest.raises(InputError) as caught:
        Experiment.from_dict(declared(**keys))
    assert 'configuration "bare": ' in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frequency 1, speed\n1, 2\n", 'column "speed" is not one of repeated tests'),
        ("frequency 1, frequency 1\n1, 2\n", 'has two columns named "frequency 1"'),
        ("shape 1 1, block\n1, 2\n", 'needs a column "frequency 1"'),
        (
            "frequency 1, frequency 2\n1.0, 2.0\n1.1,\n",
            'line 3: column "frequency 2" is empty; fill it in, or leave the line out',
        ),
        ("frequency 1, frequency 2\n1.0, two\n", "column \"frequency 2\" holds 'two', which is not a number"),
        ("", "repeats.csv is empty; a table has a header"),
    ],
)
def test_the_message_names_the_place_in_the_file(tmp_path, text, message):
    (tmp_path / "repeats.csv").write_text(text)
    (tmp_path / "test.toml").write_text('[frame]\nfloor_masses = [1, 1]\n[[configuration]]\nrepeats = "repeats.csv"\n')
    with pytest.raises(InputError) as caught:
        load(tmp_path / "test.toml")
    assert message in str(caught.value)
    assert "repeats.csv" in str(caught.value)
