"""Test that faults of a record are found with their size, and that a sound record has no findings."""

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pytest

from cvxshear import InputError
from cvxshear.records import Channel, FrfRecord, FrfRun, Run, TimeRecord, from_arrays, identify_modes
from cvxshear.records.clocks import Segments, offsets
from cvxshear.records.diagnostics import reciprocity_findings
from cvxshear.records.examination import examined
from cvxshear.records.prepare import in_step, only, struck
from cvxshear.records.record import Finding
from cvxshear.records.result import SENSOR_STD
from cvxshear.records.simulate import PAPER_FRAME, KnownFrame, ambient_record, base_record, hammer_record
from tests.records.shared import TWO_STORY_FREQUENCIES, two_story_frf

QUIET = {"clock offset", "sign", "swapped channels", "amplitude", "reciprocity", "dead channel", "clipped channel"}


@pytest.fixture(scope="module")
def record() -> TimeRecord:
    return base_record(PAPER_FRAME, 7, noise=0.01, duration=150.0)


def changed(record: TimeRecord, change) -> TimeRecord:
    values = record.runs[0].responses.copy()
    change(values)
    return dataclasses.replace(record, runs=(Run(values, record.runs[0].excitation),))


def kinds(result) -> set[str]:
    return {finding.kind for finding in result.findings}


def found(result, kind):
    return [finding for finding in result.findings if finding.kind == kind]


def test_a_sound_record_is_left_alone(record):
    assert not kinds(identify_modes(record)) & QUIET
    assert not kinds(identify_modes(hammer_record(PAPER_FRAME, 0, noise=0.01, hits=2))) & QUIET


def test_hits_at_another_floor_than_all_runs_say_are_told_by_the_signs_of_their_residues():
    record = hammer_record(PAPER_FRAME, 3, noise=0.01, floors=(2,), hits=3)
    assert "scale" not in kinds(identify_modes(record))
    elsewhere = tuple(dataclasses.replace(run, floor=3) for run in record.runs)
    result = identify_modes(dataclasses.replace(record, runs=elsewhere))
    [finding] = found(result, "scale")
    assert finding.numbers == {"floor": 3, "positive_at": [2]}
    assert not result.mass_normalized


def test_several_hits_in_one_run_are_counted_with_how_to_part_them():
    record = hammer_record(PAPER_FRAME, 3, noise=0.01, floors=(2,), hits=3)
    one = dataclasses.replace(
        record.runs[0],
        responses=np.concatenate([run.responses for run in record.runs]),
        excitation=np.concatenate([run.excitation for run in record.runs]),
    )
    with pytest.raises(InputError, match=r"holds 3 hits, at .* s: give each a") as error:
        identify_modes(dataclasses.replace(record, runs=(one,)))
    times = [
        float(time) for time in re.search(r"hits, at (.*) s:", str(error.value))[1].replace(" and", ",").split(", ")
    ]
    np.testing.assert_allclose(np.diff(times), record.runs[0].samples / record.sampling_rate, atol=0.1)


@pytest.mark.parametrize(("name", "late"), [("floor2", 0.008), ("input", 0.012)])
def test_clock_offset_is_found_and_corrected(record, name, late):
    result = identify_modes(in_step(record, {name: (-late, 0.0)}))
    [finding] = found(result, "clock offset")
    assert finding.numbers["channel"] == name
    assert finding.numbers["seconds"] == pytest.approx(late, abs=5e-4)
    np.testing.assert_allclose(result.mode_shapes, identify_modes(record).mode_shapes, atol=2e-3)


@pytest.mark.parametrize(("kept", "both"), [([0, 2], True), ([0, 1, 2], False)])
def test_of_two_clocks_alone_nobody_tells_which_is_off(kept, both):
    record = in_step(ambient_record(PAPER_FRAME, 3, noise=0.01, duration=600.0), {"floor3": (-0.01, 0.0)})
    [finding] = found(identify_modes(only(record, kept)), "clock offset")
    assert finding.numbers["channel"] == "floor3"
    assert ("which of the two is off no third clock tells" in finding.message) is both


@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_late_channel_is_told_whichever_the_phases_are_counted_from(late):
    """This includes the channel with the largest motion in all modes, the phase reference without an input."""
    eigenvalues = 2j * np.pi * np.array([2.0, 6.0, 9.0])
    shapes = np.array([[0.4, 0.8, 1.0], [1.0, 0.7, -0.6], [-0.7, 1.0, -0.4]])
    seconds = np.where(np.arange(3) == late, 0.004, 0.0)
    turned = shapes * np.exp(-1j * eigenvalues.imag[:, None] * seconds)
    told = offsets(eigenvalues, turned)
    assert told.reference != late
    np.testing.assert_allclose(told.seconds, seconds, atol=1e-9)
    np.testing.assert_allclose(told.unexplained, 0.0, atol=1e-6)


def test_phases_are_nearer_with_any_delay_up_to_twice_the_true_one(record):
    ratios = Segments.of(in_step(record, {"floor2": (-0.02, 0.0)})).against(1, [0])
    seconds = np.array([-0.02, -0.001, 0.001, 0.01, 0.03, 0.039, 0.041, 0.06])
    assert [ratios.nearer(each) for each in seconds] == (np.abs(seconds - 0.02) < 0.02).tolist()


def test_a_mode_next_to_half_the_sampling_rate_says_nothing_of_clocks():
    """Only this mode has phase errors, of up to 15 degrees."""
    eigenvalues = 2j * np.pi * np.array([2.0, 6.0, 9.0]) - 0.1
    shapes = np.array([[0.4, 0.8, 1.0], [1.0, 0.3, -0.8], [-0.7, 1.0, -0.5]])
    late = np.array([0.004, 0.0, -0.002])
    turned = shapes * np.exp(-1j * eigenvalues.imag[:, None] * late)
    turned[2] *= np.exp(1j * np.radians([15.0, 0.0, -8.0]))
    np.testing.assert_allclose(offsets(eigenvalues, turned, sampling_rate=20.0).seconds, late, atol=1e-9)
    assert np.max(np.abs(offsets(eigenvalues, turned, sampling_rate=40.0).seconds - late)) > 1e-3
    # An offset needs at least two modes.
    pair = offsets(eigenvalues[1:], turned[1:], sampling_rate=20.0)
    np.testing.assert_array_equal(pair.seconds, offsets(eigenvalues[1:], turned[1:]).seconds)


def test_shift_is_exact_for_a_slow_sine(record):
    time = np.arange(1000) / 20.0
    wave = np.column_stack([np.sin(2 * np.pi * 1.3 * time)] * 3)
    run = Run(wave, np.cos(time))
    moved = in_step(dataclasses.replace(record, runs=(run,)), {"floor1": (0.013, 0.0)}).runs[0].responses
    edge = (1000 - len(moved)) // 2
    expected = np.sin(2 * np.pi * 1.3 * (time + 0.013))[edge : edge + len(moved)]
    np.testing.assert_allclose(moved[50:-50, 0], expected[50:-50], atol=2e-3)
    np.testing.assert_allclose(moved[:, 1], wave[edge : edge + len(moved), 1], atol=1e-9)


def test_dead_channel_is_left_out(record):
    def cut_wire(values):
        values[:, 1] = 1e-9 * np.random.default_rng(0).standard_normal(len(values))

    result = identify_modes(changed(record, cut_wire))
    [finding] = found(result, "dead channel")
    assert finding.numbers["floor"] == 2
    np.testing.assert_array_equal(result.floors, [1, 3])
    np.testing.assert_allclose(result.frequencies, PAPER_FRAME.modes()[0], rtol=1e-3)


@pytest.mark.parametrize(("frequency", "noise"), [(3.5, 7.0), (3.5, 0.0), (0.8, 0.3), (0.8, 0.0)])
def test_a_rounded_peak_is_no_clip(frequency, noise):
    """Decays at 512 Hz span a thousand converter steps, with noise in steps; limited to 70 %, they are clipped."""
    time = np.arange(4096) / 512
    clips = {1.0: 0, 0.7: 0}
    for seed in range(20):
        random = np.random.default_rng(seed)
        moved = 1000.0 * np.exp(-0.2 * time) * np.sin(2 * np.pi * frequency * time + seed)
        moved = np.round(moved + noise * random.standard_normal(len(time)))
        for share in clips:
            limit = np.round(share * np.abs(moved).max())
            values = np.column_stack([np.clip(moved, -limit, limit), np.roll(moved, 7)])
            channels = (Channel("a1", 1), Channel("a2", 2))
            series = TimeRecord(channels, runs=(Run(values),), sampling_rate=512.0, input="free_decay")
            clips[share] += any(item.kind == "clipped channel" for item in examined(series).findings)
    assert clips == {1.0: 0, 0.7: 20}


def frf_record(damping: float, gain: float = 1.0) -> FrfRecord:
    frequencies = np.arange(1, 1025) / 32
    runs = tuple(
        FrfRun(two_story_frf(frequencies, damping, floor) * (gain if floor == 2 else 1.0), floor) for floor in (1, 2)
    )
    return FrfRecord((Channel("a1", 1), Channel("a2", 2)), runs=runs, frequencies=frequencies)


def test_functions_give_the_masses():
    result = identify_modes(frf_record(0.01))
    np.testing.assert_allclose(result.frequencies, TWO_STORY_FREQUENCIES, rtol=2e-4)
    np.testing.assert_allclose(result.damping_ratios, 0.01, rtol=0.02)
    assert result.mass_normalized
    np.testing.assert_allclose(np.linalg.inv(result.mode_shapes.T @ result.mode_shapes), np.diag([2.0, 1.0]), atol=0.02)
    assert not found(result, "reciprocity")


def test_reciprocity_violation():
    [finding] = found(identify_modes(frf_record(0.01, gain=1.07)), "reciprocity")
    assert finding.numbers["floors"] == [1, 2]
    assert finding.numbers["largest"] == pytest.approx(0.07 / 1.035, abs=0.005)


def test_a_transfer_near_a_node_tells_nothing_of_calibrations():
    """Floor 2 hardly moves in mode 2: crosstalk of 0.1 % changes its transfers by a tenth there."""
    real = np.array([[0.6, 1.0], [1.0, 0.01]])
    products = np.einsum("ri,rj->rij", real, real).astype(complex)
    setting = SimpleNamespace(driving_point=True, record=SimpleNamespace(floors=np.array([1, 2])))
    full = SimpleNamespace(products=products, real=real, driven=np.array([1, 2]))
    products[1, 0, 1] += 0.001
    assert not list(reciprocity_findings(full, setting))
    products[0, 0, 1] *= 1.05
    (said,) = reciprocity_findings(full, setting)
    assert "up to 4.9 % (mode 1; 4.9 % over all modes" in said.message


def test_another_mode_than_all_may_be_of_a_story_that_was_not_declared():
    """Sensors at floors 2 and 4 of four stories are declared at floors 2 and 3 of three; four modes are found."""
    frame = KnownFrame(np.full(4, 10.0), np.full(4, 2e4), 0.01)
    base = base_record(frame, 0, noise=0.01, duration=200.0, sampling_rate=64.0)
    run = dataclasses.replace(base.runs[0], responses=base.runs[0].responses[:, [1, 3]])
    told = dataclasses.replace(base, channels=(Channel("a", 2), Channel("b", 3)), runs=(run,), stories=3)
    (other,) = found(identify_modes(told), "other mode")
    assert min(np.abs(frame.modes()[0] - other.numbers["frequency"])) < 0.05
    assert "one more than 3 stories can have" in other.message
    assert other.message.endswith("or the frame has more")


def test_frequency_that_depends_on_amplitude():
    """Half the record has five times the excitation and 1 % lower frequencies."""
    soft = dataclasses.replace(PAPER_FRAME, stiffnesses=0.98 * PAPER_FRAME.stiffnesses)
    weak = base_record(PAPER_FRAME, 1, noise=0.01, duration=150.0).runs[0]
    strong = base_record(soft, 2, noise=0.01, duration=150.0).runs[0]
    strong = Run(5 * strong.responses, 5 * strong.excitation, name="strong")
    channels = tuple(Channel(f"floor{floor}", floor) for floor in (1, 2, 3))
    record = TimeRecord(channels, runs=(weak, strong), sampling_rate=20.0, input="base")
    changes = [finding.numbers["change"] for finding in found(identify_modes(record), "amplitude")]
    assert len(changes) == 3
    np.testing.assert_allclose(changes, np.log(0.98) / 2, atol=0.002)


def earthquake(seed: int, rate: float = 20.0, steps: int = 20) -> TimeRecord:
    """Return a record of a decaying ground motion."""
    random = np.random.default_rng(seed)
    time, inner = np.arange(0.0, 120.0, 1 / rate), np.arange(0.0, 120.0, 1 / (rate * steps))
    ground = np.interp(inner, time, random.standard_normal(len(time)) * np.minimum(time / 4, np.exp((4 - time) / 25)))
    moved = PAPER_FRAME.accelerations(-np.outer(ground, PAPER_FRAME.masses), 1 / (rate * steps)) + ground[:, None]
    sampled = np.column_stack([ground, moved])[::steps]
    noisy = sampled + 0.01 * sampled.std(axis=0) * random.standard_normal(sampled.shape)
    channels = tuple(Channel(f"floor{floor}", floor) for floor in (1, 2, 3))
    return TimeRecord(channels, runs=(Run(noisy[:, 1:], noisy[:, 0]),), sampling_rate=rate, input="base")


@pytest.mark.parametrize("seed", [5, 6, 7, 9])
def test_earthquake_on_a_linear_frame_has_no_amplitude_in_its_frequencies(seed):
    """The weaker half of the record has a tenth of the motion and the full noise."""
    assert not found(identify_modes(earthquake(seed)), "amplitude")


@pytest.mark.parametrize("offset", [0.0, 0.02, -0.02])
def test_blows_are_blows_whatever_the_offset_of_the_force(offset):
    """Over a run, an offset of 2 % of the peak has more energy than the blow; sound runs outvote one without a blow."""
    record = hammer_record(PAPER_FRAME, 3, noise=0.01, floors=(1, 3), hits=3)
    peak = max(float(np.max(run.excitation)) for run in record.runs)
    runs = [dataclasses.replace(run, excitation=run.excitation + offset * peak) for run in record.runs]
    result = identify_modes(dataclasses.replace(record, runs=tuple(runs)))
    assert result.method == "era"
    np.testing.assert_allclose(result.frequencies, PAPER_FRAME.modes()[0], rtol=2e-4)
    quiet = dataclasses.replace(runs[0], excitation=offset * peak + 0.01 * np.sin(np.arange(runs[0].samples)))
    assert struck(dataclasses.replace(record, runs=(quiet, *runs[1:])))


def test_shapes_are_as_uncertain_as_a_failure_of_reciprocity_says():
    """Draw calibrations of two sensors and two driving points; compare their effect on a shape and on the pair."""
    s, draws = 0.03, 20_000
    sensors, forces = s * np.random.default_rng(3).standard_normal((2, draws, 2))
    # The residue of floor i driven at j is (1 + sensor i)(1 + force j) phi_i phi_j. A driving point gives phi_i^2.
    entry = np.sqrt((1 + sensors) * (1 + forces)) - 1
    failure = (1 + sensors[:, 0]) * (1 + forces[:, 1]) / ((1 + sensors[:, 1]) * (1 + forces[:, 0])) - 1
    seen = float(np.sqrt(np.mean(failure**2)))
    finding = Finding("reciprocity", "", {"floors": [1, 2], "by_mode": [seen, seen]})
    shapes = np.array([[0.5, -1.0, 0.2], [2.0, 1.0, -1.0]])
    given = dataclasses.replace(from_arrays([3.0, 9.0], shapes, mode_shape_std=0.0), findings=(finding,))
    std = given.written_entry_std
    expected = np.sqrt(np.mean(entry**2)) * np.abs(shapes) / np.abs(shapes).max(axis=1, keepdims=True)
    expected[:, 2] = 0.0
    np.testing.assert_allclose(std, np.hypot(expected, SENSOR_STD), rtol=0.02)
