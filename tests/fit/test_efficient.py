"""Test the efficient estimator: incomplete data, scales, uncertainty, refusals."""

import tracemalloc

import numpy as np
import pytest

from cvxshear import Experiment, backends, identify
from cvxshear.fit.domain import domain_of
from cvxshear.fit.gauss_newton import gauss_newton
from cvxshear.fit.misfit import Misfit
from cvxshear.fit.start import starts
from cvxshear.priors import Bounds, Nominal, Value
from cvxshear.util.errors import UnsuitableError
from tests.frames import configuration, experiment

MASS = np.array([10.0, 7.5, 5.0])
STIFFNESS = np.array([1800.0, 1200.0, 600.0])
MASS6 = np.array([21e3, 19e3, 19.5e3, 18e3, 17e3, 12e3])
STIFFNESS6 = np.array([30e6, 36e6, 33e6, 27e6, 22e6, 16e6])


def of6(*tables, **keys):
    return Experiment.from_dict(experiment(MASS6, STIFFNESS6, *tables, **keys))


def noisy6(seed=0, added=(None, [2e3, 6e3, 4e3, 7e3, 3e3, 5e3]), **keys):
    rng = np.random.default_rng(seed)
    tables = [
        configuration(MASS6, STIFFNESS6, each, rng=rng, shape_noise=0.01, frequency_noise=0.001, **keys)
        for each in added
    ]
    return of6(*tables)


def assert_exact(found, mass=MASS6, stiffness=STIFFNESS6, rtol=1e-6):
    np.testing.assert_allclose(found.frame.floor_mass, mass, rtol=rtol)
    np.testing.assert_allclose(found.frame.story_stiffness, stiffness, rtol=rtol)


@pytest.mark.parametrize(
    ("tests", "frame"),
    [
        ([{"modes": [1, 2, 3, 4]}], None),
        ([{"measured_floors": [1, 2, 4, 5, 6]}], None),
        ([{"modes": [1, 2, 3, 4], "measured_floors": [1, 2, 4, 5, 6]}], None),
        ([{"modes": [2, 4, 5]}], None),
        ([{"modes": [1, 2, 3, 5], "measured_floors": [2, 3, 4, 6]}], None),
        # Different modes and floors in different tests.
        (
            [
                {"modes": [1, 2], "measured_floors": [2, 4, 6]},
                {"added": [0, 0, 8e3, 0, 0, 4e3], "modes": [2, 3, 4], "measured_floors": [1, 3, 5, 6]},
                {"added": [5e3, 0, 0, 0, 6e3, 0], "modes": [1, 5, 6]},
            ],
            None,
        ),
        # A different added mass tells the scale.
        ([{}, {"added": [3e3, 0, 0, 5e3, 0, 9e3]}], {}),
    ],
)
def test_incomplete_exact_data_give_the_exact_frame(tests, frame):
    assert_exact(identify(of6(*(configuration(MASS6, STIFFNESS6, **keys) for keys in tests), frame=frame)))


def test_entries_that_were_not_measured_do_not_count():
    """A row of nan is a frequency alone."""
    table = configuration(MASS6, STIFFNESS6)
    shapes = np.array(table["mode_shapes"])
    shapes[0, 3] = shapes[2, 5] = shapes[4, :2] = shapes[5] = np.nan
    table["mode_shapes"] = shapes.tolist()
    found = identify(of6(table))
    assert_exact(found)
    assert found.fit.dof == 6 + 36 - 4 - 6 - 5 - (5 + 6)


def test_mass_normalized_shapes_tell_the_scale():
    table = configuration(MASS6, STIFFNESS6, mass_normalized=True)
    shapes = np.array(table["mode_shapes"])
    modal = np.sum(shapes**2 * MASS6, axis=1)
    table["mode_shapes"] = (shapes / np.sqrt(modal)[:, None] * np.array([1, -1, 1, -1, 1, -1])[:, None]).tolist()
    assert_exact(identify(of6(table, frame={})))


@pytest.mark.parametrize(
    "prior",
    [
        Value("floor_mass", at=3, value=19.5e3),
        Nominal("story_stiffness", values=STIFFNESS6),
        Value("story_stiffness", at=1, value=30e6),
    ],
)
def test_a_prior_tells_the_scale(prior):
    table = experiment(MASS6, STIFFNESS6, frame={})
    of = Experiment.from_dict({**table, "prior": [prior.to_dict()]})
    assert_exact(identify(of))


def test_frequencies_alone_leave_directions_open_and_name_them():
    table = configuration(MASS, STIFFNESS)
    table["mode_shapes"] = [[float("nan")] * 3] * 3
    found = identify(Experiment.from_dict(experiment(MASS, STIFFNESS, table)))
    assert len(found.undetermined) == 2
    assert all(name.split()[0] in ("floor_mass", "story_stiffness") for names in found.undetermined for name in names)
    assert None in found.to_dict()["frame"]["floor_mass"]


@pytest.mark.parametrize("std", [1e-6, 1e-9, 1e-12, 1e-13])
@pytest.mark.parametrize("quantity", ["floor_mass", "story_stiffness"])
def test_a_ratio_known_ever_better_ends_where_the_exact_one_does(quantity, std):
    """The ratio does not concern the common size of the two, and must not slow its change."""
    tables = noisy6().to_dict()["configuration"]
    true = MASS6 if quantity == "floor_mass" else STIFFNESS6
    prior = {"kind": "ratio", "quantity": quantity, "of": 3, "to": 2, "value": 1.02 * true[2] / true[1]}
    soft, exact = (identify(of6(*tables, prior=[{**prior, **each}])) for each in ({"std": std}, {}))
    assert soft.converged
    for key in ("floor_mass", "story_stiffness"):
        off = getattr(soft.frame, key) - getattr(exact.frame, key)
        assert np.all(np.abs(off) < 1e-3 * getattr(exact.frame, key + "_std"))


@pytest.mark.parametrize("seed", range(3))
def test_all_starts_lead_to_the_same_fit(seed):
    of = noisy6(seed)
    fits = [
        gauss_newton(Misfit(of), start, domain_of(of, (), start), backends.get("auto")).theta for start in starts(of)
    ]
    for theta in fits[1:]:
        np.testing.assert_allclose(theta, fits[0], rtol=1e-6)


def test_backends_agree_where_a_bound_is_active():
    of = noisy6()
    free = identify(of).frame.story_stiffness
    prior = Bounds("story_stiffness", upper=[1e9, 1e9, 0.99 * free[2], 1e9, 1e9, 1e9])
    answers = {name: identify(of, backend=name, priors=[prior]).frame for name in backends.available() if name != "kkt"}
    for name, frame in answers.items():
        assert frame.story_stiffness[2] == pytest.approx(0.99 * free[2], rel=1e-6), name
        np.testing.assert_allclose(frame.story_stiffness, answers["quadprog"].story_stiffness, rtol=1e-5, err_msg=name)


def test_where_nothing_is_left_over_there_is_no_probability_of_a_worse_fit():
    """For one story the stiffness is 4 pi^2 f^2 m, with twice the relative deviation of its frequency."""
    table = {"frequencies": [2.0], "mode_shapes": [[1.0]], "frequency_std": 0.01, "mode_shape_std": 0.01}
    found = identify(Experiment.from_dict({"frame": {"stories": 1, "total_mass": 10.0}, "configuration": [table]}))
    assert (found.fit.dof, found.fit.p_value) == (0, None)
    assert found.frame.story_stiffness == pytest.approx(10.0 * (4 * np.pi) ** 2)
    assert found.frame.story_stiffness_std == pytest.approx(0.02 * found.frame.story_stiffness)


def test_identical_experiments_give_identical_numbers():
    a, b = identify(noisy6()).to_dict(), identify(noisy6()).to_dict()
    assert a == b


def test_a_fit_that_needs_too_much_memory_is_refused_before_it_is_made():
    """Two thousand stories in one mode need 32 million entries, squared in the parameters, several times."""
    stories = 2000
    declared = {
        "frame": {"stories": stories, "total_mass": 1e6},
        "configuration": [{"frequencies": [0.1], "mode_shapes": [np.linspace(0.001, 1.0, stories).tolist()]}],
    }
    tracemalloc.start()
    with pytest.raises(UnsuitableError, match=r"would take about .* GB, more than the 1 GB that are allowed; name the"):
        identify(Experiment.from_dict(declared))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 50e6
