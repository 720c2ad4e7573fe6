"""Faults of records are named with their channel before anything is identified; sound records are left as they are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import signal

from cvxshear import Experiment, identify
from cvxshear.modal import Channel, Run, TimeRecord, identify_modes
from cvxshear.modal.diagnostics import cables_changed
from cvxshear.records.examination import examined
from cvxshear.records.placement import weighed
from cvxshear.records.signals import scaled
from cvxshear.records.simulate import PAPER_FRAME, KnownFrame, base_record
from cvxshear.report import terminal
from cvxshear.screening import Screening
from cvxshear.util.errors import InputError
from tests.benchmarks.record_faults import INPUTS, NAMED_BY, case_of, judged


@pytest.mark.parametrize("kind", INPUTS)
def test_a_sound_record_comes_back_as_it_went_in(kind):
    record = case_of(51, kind, "sound").record
    seen = examined(record)
    assert [finding.kind for finding in seen.findings] == []
    for before, after in zip(record.runs, seen.record.runs, strict=True):
        np.testing.assert_array_equal(before.responses, after.responses)


@pytest.mark.parametrize("kind", INPUTS)
@pytest.mark.parametrize("fault", ["delay", "drift", "dead", "stuck", "saturated", "spikes"])
def test_a_fault_of_one_channel_is_named(kind, fault):
    """Before any mode is looked for; delays and drifts to a tenth of a sample, from the size that was put in."""
    if (fault, kind) == ("drift", "free_decay"):
        pytest.skip("three releases have too few stretches of motion for a drift to be told from their scatter")
    case = next(
        case for seed in range(60, 90) if abs((case := case_of(seed, kind, fault)).size) > 0.05 or fault != "delay"
    )
    found = [item for item in examined(case.record).findings if item.numbers.get("channel") in case.channels]
    assert {item.kind for item in found} & set(NAMED_BY[fault])
    first = next(item for item in found if item.kind in NAMED_BY[fault])
    if fault == "delay":
        assert first.numbers["seconds"] == pytest.approx(case.size, abs=0.15 / case.record.sampling_rate)
    if fault == "drift":
        assert 1e6 * first.numbers["drift"] == pytest.approx(case.size, abs=5.0)


@pytest.mark.parametrize("kind", INPUTS)
@pytest.mark.parametrize("fault", ["reversed", "exchanged", "in g"])
def test_places_signs_and_units_are_named(kind, fault):
    outcome, why = judged(case_of(71, kind, fault))
    assert outcome in ("named", "refused"), why


def test_numbers_of_modes_follow_from_repaired_signs():
    """Six stories, five sensors, the fourth floor's reversed: the lowest mode was called the third."""
    frame = KnownFrame(np.full(6, 1000.0), np.full(6, 2.5e6), 0.01)
    record = base_record(frame, 0, noise=0.02, duration=200.0, sampling_rate=42.0)
    kept = [0, 1, 2, 3, 5]
    runs = tuple(dataclasses.replace(run, responses=run.responses[:, kept]) for run in record.runs)
    record = dataclasses.replace(record, channels=tuple(record.channels[place] for place in kept), runs=runs)
    result = identify_modes(scaled(record, {"floor4": -1.0}))
    np.testing.assert_array_equal(result.modes, np.arange(1, 7))
    np.testing.assert_allclose(result.frequencies, frame.modes()[0], rtol=3e-3)
    assert (result.mode_shapes[0] > 0).all()


def test_the_input_is_named_where_most_floors_move_against_it():
    record = scaled(base_record(PAPER_FRAME, 0, noise=0.01, duration=200.0), {"input": -1.0})
    assert [item.numbers["channel"] for item in examined(record).findings if item.kind == "sign"] == ["input"]


def test_a_missed_mode_is_weighed_against_a_reversed_channel():
    """Two sensors and modes two and three of a frame: the ratio of frequencies speaks for a mode that was missed."""
    frequencies, shapes = KnownFrame(np.ones(6), np.ones(6), 0.01).modes()
    floors = np.array([2, 6])
    best = weighed(frequencies[1:3], shapes[1:3][:, floors - 1], floors, 6)[0]
    assert (best.kind, best.missed > 0.5) == ("sound", True)
    turned = shapes[:2][:, floors - 1] * np.array([1.0, -1.0])
    assert weighed(frequencies[:2], turned, floors, 6)[0].kind == "sign"


def torsional_record() -> tuple[TimeRecord, float]:
    """A sway record whose roof turns at 1.6 Hz, seen by two sensors at unequal distances from the centre."""
    record = base_record(PAPER_FRAME, 0, noise=0.01, duration=300.0)
    run, random = record.runs[0], np.random.default_rng(1)
    turning = signal.lfilter(*signal.iirpeak(1.6, 30, fs=20), random.standard_normal(run.samples))
    turning *= 0.8 * run.responses[:, 2].std() / turning.std()
    top = run.responses[:, 2]
    both = np.column_stack([run.responses[:, :2], top + 1.3 * turning, top - 0.7 * turning])
    channels = (Channel("a1", 1), Channel("a2", 2), Channel("left", 3, position=(0, 1.3)), Channel("right", 3))
    return dataclasses.replace(record, channels=channels, runs=(Run(both, run.excitation),)), 1.6


def test_two_sensors_on_a_floor_are_its_motion_and_its_rotation():
    record, torsion = torsional_record()
    result = identify_modes(record)
    np.testing.assert_allclose(result.frequencies, PAPER_FRAME.modes()[0], rtol=1e-3)
    aside = [item for item in result.findings if item.kind == "rotation" and "frequency" in item.numbers]
    assert [item.numbers["frequency"] for item in aside] == [pytest.approx(torsion, rel=0.01)]


def test_two_sensors_that_contradict_each_other_are_refused():
    record, _ = torsional_record()
    with pytest.raises(InputError, match=r'"left" .* and channel "right" .* contradict each other'):
        identify_modes(scaled(record, {"right": -1.0}))


def test_a_sensor_across_the_direction_of_test_is_left_out_and_one_askew_is_turned():
    record = base_record(PAPER_FRAME, 0, noise=0.01, duration=100.0)
    askew = scaled(record, {"floor2": np.cos(np.radians(20.0))})
    channels = (
        record.channels[0],
        *(dataclasses.replace(c, direction=d) for c, d in zip(record.channels[1:], (20.0, 90.0), strict=True)),
    )
    seen = examined(dataclasses.replace(askew, channels=channels))
    assert [channel.floor for channel in seen.record.channels] == [1, 2]
    np.testing.assert_allclose(seen.record.runs[0].responses[:, 1], record.runs[0].responses[:, 1])


@pytest.mark.parametrize(("gain", "lost", "named"), [(1.1, 0.0, True), (1.0, 0.15, False)])
def test_between_two_records_a_gain_is_a_cable_and_damage_is_not(gain, lost, named):
    stiffnesses = np.full(5, 8e5)
    hurt = np.where(np.arange(5) == 2, 1.0 - lost, 1.0) * stiffnesses
    before = identify_modes(base_record(KnownFrame(np.full(5, 1e3), stiffnesses, 0.01), 0, noise=0.02, duration=300.0))
    record = base_record(KnownFrame(np.full(5, 1e3), hurt, 0.01), 1, noise=0.02, duration=300.0)
    found = cables_changed(before, identify_modes(scaled(record, {"floor3": gain})))
    assert [item.numbers["floor"] for item in found] == ([3] if named else [])


def test_records_from_arrays_and_tables():
    pandas = pytest.importorskip("pandas")
    record = base_record(PAPER_FRAME, 0, noise=0.01, duration=60.0)
    run = record.runs[0]
    plain = TimeRecord.of(run.responses, excitation=run.excitation, sampling_rate=20.0)
    time = np.arange(run.samples) / 20.0
    frame = pandas.DataFrame(run.responses, index=time, columns=["a", "b", "c"]).assign(base=run.excitation)
    named = TimeRecord.of(frame, floors={"c": 3, "a": 1}, excitation="base")
    np.testing.assert_allclose(named.runs[0].responses, plain.runs[0].responses[:, [0, 2]])
    assert (plain.input, named.input, named.floors.tolist()) == ("base", "base", [1, 3])
    assert named.sampling_rate == pytest.approx(20.0)
    xarray = pytest.importorskip("xarray")
    array = xarray.DataArray(run.responses, dims=("time", "channel"), coords={"time": time, "channel": list("abc")})
    assert [channel.name for channel in TimeRecord.of(array).channels] == ["a", "b", "c"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "give sampling_rate"),
        ({"sampling_rate": 20.0, "floors": [1]}, "floors must have 3 entries"),
        ({"sampling_rate": 20.0, "excitation": "base"}, 'no channel "base" in the table; there are channel 1'),
    ],
)
def test_a_table_that_does_not_say_enough(options, message):
    with pytest.raises(InputError, match=message):
        TimeRecord.of(np.zeros((400, 3)), **options)


def test_modes_as_a_data_frame():
    pytest.importorskip("pandas")
    result = identify_modes(base_record(PAPER_FRAME, 0, noise=0.01, duration=200.0))
    table = result.to_dataframe()
    assert table.index.tolist() == [1, 2, 3]
    np.testing.assert_allclose(table["frequency_std"], result.configuration()["frequency_std"])
    np.testing.assert_allclose(table[["floor_1", "floor_2", "floor_3"]], result.mode_shapes)


def test_a_total_mass_that_nobody_gave_is_a_placeholder():
    result = identify_modes(base_record(PAPER_FRAME, 0, noise=0.01, duration=200.0))
    declared = result.to_experiment()
    assert declared["frame"]["total_mass_placeholder"] is True
    experiment = Experiment.from_dict(declared)
    assert "total_mass" in {finding.name for finding in Screening.of(experiment).findings}
    shown = "\n".join(str(item) for item in terminal.shown(identify(experiment)))
    assert " kg" not in shown
    with pytest.raises(InputError, match="total_mass_placeholder belongs to total_mass"):
        Experiment.from_dict({**declared, "frame": {"stories": 3, "total_mass_placeholder": True}})
