"""Test measured functions against dynamic stiffness, and manually chosen poles."""

import dataclasses

import numpy as np
import pytest

from cvxshear.records import Channel, Run, TimeRecord, from_arrays, identify_modes
from cvxshear.records.frf import reach
from cvxshear.records.prepare import measured_functions
from cvxshear.records.result import band_of, synthesized
from cvxshear.records.simulate import PAPER_FRAME, ambient_record, hammer_record, shaker_record
from cvxshear.util.errors import InputError, UnsuitableError


@pytest.fixture(scope="module")
def hammer():
    return identify_modes(hammer_record(PAPER_FRAME, 0, noise=0.005, hits=2), functions=True)


def accelerance(lines):
    """Return the accelerance of the paper's frame from its dynamic stiffness, shape (lines, outputs, inputs)."""
    frequencies, shapes = PAPER_FRAME.modes()
    mass = np.diag(PAPER_FRAME.masses)
    damper = mass @ shapes.T @ np.diag(4 * np.pi * PAPER_FRAME.damping * frequencies) @ shapes @ mass
    w = 2 * np.pi * lines
    return np.array([-(x**2) * np.linalg.inv(PAPER_FRAME.stiffness - x**2 * mass + 1j * x * damper) for x in w])


def test_functions_of_hits_and_of_their_modes_are_those_of_the_frame(hammer):
    seen = hammer.functions
    within = band_of(seen.frequencies, hammer.frequencies)
    exact = accelerance(seen.frequencies[within])
    for values in (seen.values, synthesized(hammer)):
        error = np.abs(values[within] - exact) / np.sqrt(np.mean(np.abs(exact) ** 2))
        assert np.sqrt(np.mean(error**2)) < 0.03
    np.testing.assert_array_equal(seen.inputs, [1, 2, 3])


def test_what_the_hammer_s_sensor_shows_after_the_blow_is_noise():
    record, noisy = hammer_record(PAPER_FRAME, 0, noise=0.005, hits=1), []
    for run in record.runs:
        blow = np.flatnonzero(np.abs(run.excitation) > 0.25 * np.abs(run.excitation).max())
        noise = 0.015 * run.excitation.max() * np.random.default_rng(1).choice([-1.0, 1.0], run.samples)
        noise[: blow[-1] + 3 * len(blow) + 20] = 0.0
        noisy.append(dataclasses.replace(run, excitation=run.excitation + noise))
    expected = measured_functions(record, 5.0).values
    found = measured_functions(dataclasses.replace(record, runs=tuple(noisy)), 5.0).values
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


def test_the_functions_have_the_sign_that_was_set_right(hammer):
    """A reversed sensor is turned round: the modes then make its function too, and the others'."""
    record = hammer_record(PAPER_FRAME, 0, noise=0.005, hits=2)
    reversed_ = tuple(dataclasses.replace(run, responses=run.responses * [1.0, -1.0, 1.0]) for run in record.runs)
    turned = identify_modes(dataclasses.replace(record, runs=reversed_), functions=True)
    assert [finding.kind for finding in turned.findings] == ["sign"]
    expected, found = (np.nan_to_num(synthesized(each)) for each in (hammer, turned))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * np.abs(expected).max())
    np.testing.assert_allclose(turned.functions.values, hammer.functions.values, rtol=1e-6)


def test_ambient_vibration_has_no_functions():
    record = ambient_record(PAPER_FRAME, 0, noise=0.01, duration=240.0)
    assert identify_modes(record, functions=True).functions is None


def test_a_force_without_a_frame_has_a_constant_function():
    random = np.random.default_rng(3)
    force = random.standard_normal(40_000)
    response = 2.0 * force + 2.0 * random.standard_normal(len(force))
    record = TimeRecord((Channel("a", 1),), runs=(Run(response[:, None], force, 1),), sampling_rate=50.0, input="force")
    seen = measured_functions(record, 20.0)
    assert np.mean(seen.values.real) == pytest.approx(2.0, rel=0.02)
    assert seen.frequencies.max() <= 20.0


def test_a_continuous_force_carries_the_masses():
    record = shaker_record(PAPER_FRAME, 0, noise=0.01, floor=3)
    result = identify_modes(record)
    assert result.mass_normalized
    frequencies, shapes = PAPER_FRAME.modes()
    np.testing.assert_allclose(result.frequencies, frequencies, rtol=1e-3)
    np.testing.assert_allclose(np.abs(result.mode_shapes), np.abs(shapes), atol=0.005)
    both = (*record.runs, dataclasses.replace(record.runs[0], floor=2))
    with pytest.raises(UnsuitableError, match="driven at floors 2, 3 cannot share"):
        identify_modes(dataclasses.replace(record, runs=both))


def test_modes_picked_by_hand():
    record = hammer_record(PAPER_FRAME, 1, noise=0.005, hits=2)
    result = identify_modes(record, pick=[3.3, 1.03])
    np.testing.assert_allclose(result.frequencies, PAPER_FRAME.modes()[0][[0, 2]], rtol=1e-3)
    np.testing.assert_array_equal(result.modes, [1, 3])
    for pick, expected in (
        ([1.03, 1.3], r"no stable pole of its own within 3 % of 1\.3 Hz; there are"),
        ([1.0, 2.2, 3.2, 4.0], "pick names 4 modes; a frame of 3 stories has no more than 3"),
        ([-1.0], "pick"),
    ):
        with pytest.raises(InputError, match=expected):
            identify_modes(record, pick=pick)


def test_a_mode_left_out_by_hand_is_not_called_missing():
    record = hammer_record(PAPER_FRAME, 1, noise=0.005, hits=2)
    said = {finding.kind: finding.message for finding in identify_modes(record, pick=[1.03, 3.28]).findings}
    assert said["missing mode"] == "mode 2 of 3 was not asked for"
    assert said["other mode"].endswith("is not among the modes asked for")


def test_poles_out_of_reach_are_told_up_to_the_frequency_asked_for():
    """Request the first mode and a missing one: decimation must keep the third mode in the band."""
    record = shaker_record(PAPER_FRAME, 0, noise=0.01, floor=3, duration=120.0, sampling_rate=64.0)
    with pytest.raises(InputError, match=r"no stable pole of its own within 3 % of 20 Hz; there are .*3\.28"):
        identify_modes(record, pick=[1.03, 20.0])


def test_what_was_not_kept_is_said():
    with pytest.raises(InputError, match="holds no functions"):
        synthesized(from_arrays([3.0, 9.0], [[0.5, 1.0], [1.0, -0.6]]))


def test_a_blow_of_one_sample_reaches_half_the_sampling_rate():
    """The spectrum of one sample is flat; a half sine of 8 samples is weak before its zero at 3 / 16 of the rate."""
    answers = np.random.default_rng(1).standard_normal((512, 1))

    def reached(blow):
        force = np.zeros(512)
        force[20 : 20 + len(blow)] = blow
        run = Run(answers, force, 1, "hit")
        return reach(TimeRecord((Channel("top", 1),), stories=1, runs=(run,), sampling_rate=200.0, input="force"))

    assert reached([1.0]) == pytest.approx(100.0)
    assert 200.0 / 8 < reached(np.sin(np.pi * (np.arange(8) + 0.5) / 8)) < 200.0 * 3 / 16
