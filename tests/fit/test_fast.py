"""Tall frames, and many identifications at once, give the same numbers as single small ones."""

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
from functools import partial

import joblib
import numpy as np
import pytest

from cvxshear import Experiment, InputError, NoSolutionError, backends, identify
from cvxshear.paper.setups import three_story
from cvxshear.programs import LeastSquares
from cvxshear.programs.formulations import mass_rows, normalized, pair_normal, pair_products, stiffness_rows
from cvxshear.util.parallel import each
from tests.frames import configuration, experiment

KKT = backends.get("kkt")


def random_frame(stories, seed=0, spread=0.3):
    rng = np.random.default_rng(seed)
    mass = 2e4 * (1 + spread * rng.uniform(-1, 1, stories))
    return mass, 2e7 * stories * (1 + spread * rng.uniform(-1, 1, stories)), rng


@pytest.mark.parametrize("diagonal", [True, False])
def test_the_normal_matrix_is_that_of_the_rows(diagonal):
    P = np.random.default_rng(1).standard_normal((5, 4))
    A = pair_products(P, diagonal=diagonal)
    np.testing.assert_allclose(pair_normal(P, diagonal=diagonal), A.T @ A, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("stories", [31, 45])
@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_factors_and_rows_have_the_same_answer(stories, noise):
    """A tall frame's program is a factor of the normal matrix; the minimizer over its rows comes from numpy."""
    mass, stiffness, rng = random_frame(stories)
    table = configuration(mass, stiffness, rng=rng, shape_noise=noise, mode_shape_std=max(noise, 1e-3))
    test = Experiment.from_dict(experiment(mass, stiffness, table)).configurations[0]
    even = np.full(stories, mass.mean())
    phi = normalized(test.mode_shapes.T, even)
    x, lam = np.diff(phi, axis=0, prepend=0.0), (2 * np.pi * test.frequencies) ** 2
    for program, columns, sides, start in (
        (mass_rows(phi, even, mass.sum()), phi, np.eye(stories), even),
        (stiffness_rows(phi, lam), x, np.diag(lam), np.zeros(stories)),
    ):
        i, j = np.triu_indices(stories)
        rows = pair_products(columns)
        plain = LeastSquares(rows, sides[i, j] - rows @ start, A=program.A, b=program.b)
        assert program.R.shape == (stories, stories)
        expected = KKT.solve(plain).x
        np.testing.assert_allclose(KKT.solve(program).x, expected, rtol=1e-9, atol=1e-9 * np.max(np.abs(expected)))


LARGE = textwrap.dedent("""
    import sys, tracemalloc
    import numpy as np
    from cvxshear import Configuration, Experiment, Frame, identify
    from cvxshear.model import mass_matrix, modes, stiffness_matrix
    n = int(sys.argv[2])
    rng = np.random.default_rng(0)
    mass, stiffness = 2e4 * rng.uniform(0.7, 1.3, n), 2e10 * rng.uniform(0.7, 1.3, n)
    found = modes(mass_matrix(mass), stiffness_matrix(stiffness))
    of = Experiment(Frame(stories=n, total_mass=mass.sum()), (Configuration(found.frequencies, found.shapes),))
    keys = {"tolerance": 1e-12} if sys.argv[1] == "two-stage" else {}  # of the mass iteration
    tracemalloc.start()
    frame = identify(of, sys.argv[1], **keys).frame
    peak = tracemalloc.get_traced_memory()[1] / found.shapes.nbytes
    print(np.max(np.abs(frame.floor_mass / mass - 1)), np.max(np.abs(frame.story_stiffness / stiffness - 1)), peak)
""")


@pytest.mark.parametrize(("method", "stories"), [("one-shot", "1000"), ("two-stage", "200")])
def test_hundreds_of_stories_need_the_memory_of_twenty_four_tables_and_keep_ten_digits(method, stories):
    """Arrays are counted, in tables of all shapes: the buffers of a BLAS differ between processors."""
    run = subprocess.run(
        [sys.executable, "-c", LARGE, method, stories], capture_output=True, text=True, check=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    mass, stiffness, tables = map(float, run.stdout.split())
    assert mass < 1e-10
    assert stiffness < 1e-10
    assert tables < 24


def noisy_samples(count):
    setup = three_story(0.05)
    frequencies, shapes = setup.draw(np.random.default_rng(1), count)
    return [setup.experiment(f, s) for f, s in zip(frequencies, shapes, strict=True)]


def _masses(experiment):
    return identify(experiment).frame.floor_mass


def test_two_processes_have_the_same_numbers_as_one_and_say_how_far_they_are():
    samples = noisy_samples(6)
    heard = []
    one = each(_masses, samples)
    two = each(_masses, samples, jobs=2, progress=lambda *done: heard.append(done))
    np.testing.assert_array_equal(one, two)
    assert heard[-1] == (6, 6)


def _fail(item):
    raise NoSolutionError("test", f"item {item}")


def test_an_error_of_another_process_comes_back_whole():
    with pytest.raises(NoSolutionError, match=r"backend test: item [01]") as caught:
        each(_fail, [0, 1], jobs=2)
    assert caught.value.backend == "test"


def test_a_number_of_jobs_that_means_nothing_is_refused():
    with pytest.raises(InputError, match="jobs = 0 must be at least 1"):
        each(abs, [1], jobs=0)


def _twice_deadly(item, folder):
    """End its worker the first two times, as the system does if memory is short."""
    for marker in ("first", "second"):
        with contextlib.suppress(FileExistsError):
            os.close(os.open(os.path.join(folder, marker), os.O_CREAT | os.O_EXCL))
            os.kill(os.getpid(), signal.SIGKILL)
    return identify(item, "efficient").frame.floor_mass


def test_a_dask_cluster_has_the_same_numbers_and_loses_nothing_with_two_workers(tmp_path):
    distributed = pytest.importorskip("dask.distributed")
    samples = noisy_samples(8)
    expected = [identify(item, "efficient").frame.floor_mass for item in samples]
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path), silence_logs=50
        ) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config(backend="dask"),
    ):
        plain = each(_masses, samples, jobs=-1)
        survived = each(partial(_twice_deadly, folder=str(tmp_path)), samples, jobs=-1)
    assert {"first", "second"} <= {path.name for path in tmp_path.iterdir()}
    np.testing.assert_array_equal(plain, expected)
    np.testing.assert_array_equal(survived, expected)


def test_design_values_are_where_a_large_fit_starts():
    """Sixty stories, eight modes at fifteen floors: only the design values give a start between the floors."""
    mass, stiffness, rng = random_frame(60, seed=4, spread=0.05)
    table = configuration(
        mass, stiffness, rng=rng, shape_noise=0.01, frequency_noise=0.001, modes=list(range(1, 9)),
        measured_floors=list(range(4, 61, 4)),
    )  # fmt: skip
    prior = [
        {"kind": "nominal", "quantity": "floor_mass", "values": [2e4] * 60, "std": 0.05},
        {"kind": "nominal", "quantity": "story_stiffness", "values": [1.2e9] * 60, "std": 0.05},
    ]
    found = identify(Experiment.from_dict(experiment(mass, stiffness, table, prior=prior)))
    assert found.converged
    assert found.fit.p_value > 0.01
    assert np.max(np.abs(found.frame.floor_mass / mass - 1)) < 0.15
