"""Test modes from other programs, and results as plain values."""

import numpy as np
import pytest

import cvxshear
from cvxshear.records import TimeRecord, from_arrays, identify_modes
from cvxshear.records.simulate import PAPER_FRAME, base_record
from cvxshear.util.errors import InputError

SHAPES = [[1.0, -0.6], [0.5, 1.0]]


def test_arrays_are_put_in_order():
    result = from_arrays([9.0, 3.0], np.array(SHAPES)[:, ::-1], floors=[2, 1], damping_ratios=[0.02, 0.01])
    np.testing.assert_array_equal(result.frequencies, [3.0, 9.0])
    np.testing.assert_array_equal(result.mode_shapes, [[0.5, 1.0], [1.0, -0.6]])
    np.testing.assert_array_equal(result.damping_ratios, [0.01, 0.02])
    experiment = cvxshear.Experiment.from_dict(result.to_experiment({"total_mass": 3.0}))
    np.testing.assert_array_equal(experiment.configurations[0].mode_shapes, [[0.5, 1.0], [1.0, -0.6]])


def test_what_is_not_given_stays_undeclared():
    """Missing deviations and damping ratios stay undeclared, in the result and in its file."""
    given = {"frequency_std": 0.001, "mode_shape_std": 0.02, "damping_ratios": [0.01, 0.02]}
    for key in given:
        result = from_arrays([3.0, 9.0], SHAPES, **{name: value for name, value in given.items() if name != key})
        (configuration,) = result.to_experiment({"total_mass": 3.0})["configuration"]
        assert {*given} - {*configuration} == {key}
        assert np.all(np.isnan(getattr(result, key)))
        written = cvxshear.Experiment.from_dict(result.to_experiment({"total_mass": 3.0})).configurations[0]
        assert getattr(written, key) is None


def test_complex_shapes_become_real():
    result = from_arrays([3.0, 9.0], np.array([[0.5, 1.0], [1.0, -0.6]]) * np.exp([[1j], [-2j]]))
    scaled = result.mode_shapes / result.mode_shapes[[0, 1], [1, 0]][:, None]
    np.testing.assert_allclose(scaled, [[0.5, 1.0], [1.0, -0.6]], atol=1e-12)


@pytest.mark.parametrize(
    ("frequencies", "shapes", "options", "expected"),
    [
        ([3.0], SHAPES, {}, "mode_shapes has 2 rows, frequencies 1 entries"),
        ([3.0, np.nan], SHAPES, {}, "frequencies, entry 2 must be a finite number"),
        ([3.0, 9.0], [SHAPES[0], [np.inf, 1.0]], {}, "mode_shapes, row 2, entry 1 is not finite"),
        ([3.0, 9.0], SHAPES[0], {}, "mode_shapes must be a table of samples by channels"),
        ([3.0, 9.0], SHAPES, {"floors": [1]}, "floors must have 2 entries"),
        ([3.0, 9.0], SHAPES, {"frequency_std": -1.0}, "frequency_std must be finite and not negative"),
        (["a", "b"], SHAPES, {}, "frequencies, entry 1 must be a number"),
    ],
)
def test_arrays_that_do_not_fit(frequencies, shapes, options, expected):
    with pytest.raises(InputError, match=expected):
        from_arrays(frequencies, shapes, **options)


def test_modal_constants_of_another_library_are_shapes():
    """Each modal constant of the force at floor 2 is the shape times its entry there, over 2i w."""
    shapes = np.array([[0.5, 1.0], [1.0, -0.6]])
    constants = shapes * shapes[:, [1]] / (2j * 2 * np.pi * np.array([[3.0], [9.0]]))
    found = from_arrays([3.0, 9.0], constants).mode_shapes
    np.testing.assert_allclose(found[:, 0] / found[:, 1], [0.5, -1 / 0.6], rtol=1e-12)


@pytest.fixture(scope="module")
def result():
    return identify_modes(base_record(PAPER_FRAME, 0, noise=0.01, duration=150.0))


def test_result_as_plain_values(result):
    found = result.to_dict()
    assert found["method"] == "subspace"
    assert found["uncertainty"] == "jackknife over 20 blocks"
    np.testing.assert_allclose(found["frequencies"], PAPER_FRAME.modes()[0], rtol=1e-3)
    assert all(type(value) is float for row in found["mode_shapes"] for value in row)
    assert set(found["clock_offsets"]) == {"floor1", "floor2", "floor3", "input"}


def test_covariance_agrees_with_the_stated_deviations(result):
    diagonal = np.sqrt(np.diag(result.covariance))
    np.testing.assert_allclose(diagonal[:3], result.frequency_std)
    np.testing.assert_allclose(diagonal[3:].reshape(3, 3), result.mode_shape_std)
    assert np.linalg.eigvalsh(result.covariance).min() > -1e-12 * diagonal.max() ** 2


def test_a_data_frame_with_a_column_of_time_and_samples_that_are_missing():
    """The column gives the time; 20 missing samples in the middle divide the record into two runs, like in a file."""
    pandas = pytest.importorskip("pandas")
    values = np.random.default_rng(0).standard_normal((2000, 2))
    table = pandas.DataFrame(values, columns=["low", "high"])
    table.insert(0, "time_s", 0.02 * np.arange(2000))
    table.loc[1000:1019, "high"] = np.nan
    record = TimeRecord.of(table)
    assert record.sampling_rate == pytest.approx(50.0)
    assert [channel.name for channel in record.channels] == ["low", "high"]
    assert [run.samples for run in record.runs] == [1000, 980]
    np.testing.assert_array_equal(record.runs[1].responses, values[1020:])
