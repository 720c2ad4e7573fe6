"""Test that faults of a channel are found before the identification, and that sound records stay the same."""

import copy
import dataclasses
import functools

import numpy as np
import pytest
from scipy import linalg, signal

from cvxshear import Experiment, identify
from cvxshear.records import Channel, Run, TimeRecord, identify_modes
from cvxshear.records.examination import examined, one_a_floor
from cvxshear.records.placement import ChannelMistake, findings_of, weighed
from cvxshear.records.prepare import only, scaled
from cvxshear.records.simulate import PAPER_FRAME, KnownFrame, ambient_record, base_record
from cvxshear.report import terminal
from cvxshear.response.sources import load_unscaled
from cvxshear.screening import Screening
from cvxshear.util.errors import InputError
from tests.frames import modes_of
from tests.studies.record_faults import INPUTS, NAMED_BY, case_of, judged, sound_record


@pytest.mark.parametrize("kind", INPUTS)
def test_a_sound_record_comes_back_as_it_went_in(kind):
    record = case_of(51, kind, "sound").record
    seen = examined(record)
    assert [finding.kind for finding in seen.findings] == []
    for before, after in zip(record.runs, seen.record.runs, strict=True):
        np.testing.assert_array_equal(before.responses, after.responses)


NEEDS_TIME = ("without samples", "gain step", "resonance")
"""Faults that decays of a minute are too short to show."""
FAULTS = [fault for fault in NAMED_BY if fault not in ("reversed", "exchanged", "in g", "dropout")]


@pytest.mark.parametrize(
    ("kind", "fault"),
    [(kind, fault) for kind in INPUTS for fault in FAULTS if kind != "free_decay" or fault not in NEEDS_TIME],
)
def test_a_fault_of_one_channel_is_named(kind, fault):
    """The check runs before the identification; delays and drifts are right within a tenth of a sample."""
    least, most = {"delay": (0.05, 2.0), "drift": (100.0, 500.0), "low-pass": (0.0, 5.0), "resonance": (0.0, 99.0)}.get(
        fault, (-1.0, 2.0)
    )
    case = next(case for seed in range(60, 90) if least < abs((case := case_of(seed, kind, fault)).size) <= most)
    found = [item for item in examined(case.record).findings if item.numbers.get("channel") in case.channels]
    assert {item.kind for item in found} & set(NAMED_BY[fault])
    first = next(item for item in found if item.kind in NAMED_BY[fault])
    if fault == "delay":
        assert first.numbers["seconds"] == pytest.approx(case.size, abs=0.15 / case.record.sampling_rate)
    if fault == "drift":
        # Three releases have short motions. The stated deviation of the drift gives the tolerance.
        within = 3e6 * first.numbers["drift_std"] if kind == "free_decay" else 5.0
        assert 1e6 * first.numbers["drift"] == pytest.approx(case.size, abs=within)
    if fault in ("low-pass", "resonance"):
        assert first.numbers["corner"] == pytest.approx(case.size, rel=0.15)
    if fault == "gain step":
        assert np.log(first.numbers["factor"]) == pytest.approx(np.log(case.size), rel=0.2)


@pytest.mark.parametrize("kind", ["base", "force", "free_decay"])
def test_a_mild_low_pass_is_told_by_the_phases_of_the_modes(kind):
    """Its corner is at the highest frequency: a straight line leaves a degree of its phases; wind scatters by more."""
    cases = (case_of(seed, kind, "low-pass") for seed in range(60, 90))
    case = next(case for case in cases if 0.35 < case.size / case.record.sampling_rate < 0.5)
    outcome, why = judged(case)
    assert outcome == "named", why


def damped_record(kind: str, late: float = 0.0, hit: int = 0) -> TimeRecord:
    """Return noisy sensors on all floors of `damped_motion` except 2; floor 4 is `late` by a whole number of steps."""
    rate, finer = 64.0, 5
    moved, base, force, random = copy.deepcopy(damped_motion(kind, hit, rate, finer))
    moved[:, 3] = np.roll(moved[:, 3], round(late * rate * finer))
    values = moved[::finer][:, [0, 2, 3, 4]]
    values = values + 0.005 * values.std(axis=0) * random.standard_normal(values.shape)
    driven = {"base": base[::finer], "force": force[::finer, (hit or 3) - 1]}.get(kind)
    run = Run(values, driven, (hit or 3) if kind == "force" else 0)
    channels = [Channel(f"floor{floor}", floor) for floor in (1, 3, 4, 5)]
    return TimeRecord(channels, runs=[run], sampling_rate=rate, input=kind, stories=5)


@functools.cache
def damped_motion(kind: str, hit: int, rate: float, finer: int):
    """Return the motion of five stories (2 Hz) with a dashpot in story 2: damping of 2 to 9 %, complex modes.

    The solution is exact for forces held constant over steps of a fifth of a sample. Excitations: white base motion, a
    shaker sweep, wind, or a knock. Return floor accelerations, base acceleration, forces and the random generator.
    """
    count, random = 5, np.random.default_rng([21, INPUTS.index(kind)])
    drift = np.eye(count) - np.eye(count, k=-1)
    stiffness = drift.T @ np.diag([1.0, 0.9, 0.9, 0.7, 0.6]) @ drift
    stiffness *= (4 * np.pi) ** 2 / np.linalg.eigvalsh(stiffness)[0]
    damper = 0.0015 * stiffness + 9.0 * np.outer(drift[1], drift[1])
    state = np.block([[np.zeros((count, count)), np.eye(count)], [-stiffness, -damper]])
    step = linalg.expm(state / (rate * finer))
    held = np.linalg.solve(state, step - np.eye(2 * count))[:, count:]
    samples = int({"base": 120, "force": 120, "none": 600, "free_decay": 40}[kind] * rate * finer)
    time = np.arange(samples) / (rate * finer)
    base, force = np.zeros(samples), np.zeros((samples, count))
    if kind == "base":
        base = signal.sosfilt(signal.butter(2, 14.0, fs=rate * finer, output="sos"), random.standard_normal(samples))
        force -= base[:, None]
    elif hit:
        force[320:326, hit - 1] = 5.0
    elif kind == "force":
        force[:, 2] = signal.chirp(time, 0.5, time[-1], 14.0)
    elif kind == "none":
        force = random.standard_normal((samples, count))
    else:
        force[500:503, 3] = 5.0
        force[500:, 4] = -1.0
    forced, moved, x = force @ held.T, np.empty((samples, 2 * count)), np.zeros(2 * count)
    for place in range(samples):
        moved[place] = x
        x = step @ x + forced[place]
    return force + moved @ state[count:].T + base[:, None], base, force, random


def test_a_damper_is_no_drift_where_one_floor_is_hit_after_another():
    """A damper causes phases that depend on the hit floor, and therefore on time."""
    runs, random = [], np.random.default_rng(3)
    for floor in (1, 5):
        record = damped_record("force", hit=floor)
        whole = record.runs[0]
        for _ in range(3):
            noise = 0.01 * whole.responses[:1600].std(axis=0) * random.standard_normal((1600, 4))
            runs.append(Run(whole.responses[:1600] + noise, whole.excitation[:1600], floor))
    found = examined(dataclasses.replace(record, runs=tuple(runs))).findings
    assert "clock drift" not in {finding.kind for finding in found}


@pytest.mark.parametrize("kind", INPUTS)
def test_a_damper_is_no_late_clock_and_no_spike(kind):
    """The damper's phases appear one by one in a sweep, but are no drift; a knock at a sensor's floor is no spike."""
    record = damped_record(kind)
    assert [finding.message for finding in examined(record).findings] == []
    if kind != "free_decay":  # one strongly damped decay has no standard deviations
        accused = {"clock offset", "clock drift", "sign", "swapped channels"}
        assert not accused & {finding.kind for finding in identify_modes(record).findings}


@pytest.mark.parametrize("kind", INPUTS)
@pytest.mark.parametrize("late", [-0.25, 1.0])
def test_a_late_clock_is_named_beside_a_damper(kind, late):
    record = damped_record(kind, late)
    [finding] = examined(record).findings
    assert (finding.kind, finding.numbers["channel"]) == ("clock offset", "floor4")
    # The damper's own phases remain. The deviation includes them.
    within = 4 * finding.numbers["std"] + 1e-4
    assert finding.numbers["seconds"] == pytest.approx(late, abs=within)
    if kind in ("base", "none"):
        said = [item for item in identify_modes(record).findings if item.kind == "clock offset"]
        assert [item.numbers["channel"] for item in said] == ["floor4"]
        assert said[0].numbers["seconds"] == pytest.approx(late, abs=2 * within)


@pytest.mark.parametrize("kind", INPUTS)
@pytest.mark.parametrize("fault", ["reversed", "exchanged", "in g"])
def test_places_signs_and_units_are_named(kind, fault):
    outcome, why = judged(case_of(11, kind, fault))
    assert outcome in ("named", "refused"), why


def test_numbers_of_modes_follow_from_repaired_signs():
    """Six stories have five sensors, with floor 4 reversed; before the repair, the lowest mode was numbered 3."""
    frame = KnownFrame(np.full(6, 1000.0), np.full(6, 2.5e6), 0.01)
    record = base_record(frame, 0, noise=0.02, duration=200.0, sampling_rate=42.0)
    result = identify_modes(scaled(only(record, [0, 1, 2, 3, 5]), {"floor4": -1.0}))
    np.testing.assert_array_equal(result.modes, np.arange(1, 7))
    np.testing.assert_allclose(result.frequencies, frame.modes()[0], rtol=3e-3)
    assert (result.mode_shapes[0] > 0).all()


def test_the_input_is_named_where_most_floors_move_against_it():
    record = scaled(base_record(PAPER_FRAME, 0, noise=0.01, duration=200.0), {"input": -1.0})
    assert [item.numbers["channel"] for item in examined(record).findings if item.kind == "sign"] == ["input"]


@pytest.mark.parametrize(("lowest", "told"), [(0.2, True), (1.2, False), (1.5, False)])
def test_a_table_that_hardly_moves_at_low_frequency_tells_signs_and_units(lowest, told):
    """The table has no motion below this multiple of the first frequency; floor 2 is reversed, floor 3 is in g.

    The motion is a thousandth of that of a strong earthquake: its size tells nothing.
    """
    frame = KnownFrame(np.full(6, 1000.0), np.full(6, 2.5e6), 0.01)
    record = base_record(frame, 1, noise=0.0, duration=300.0, sampling_rate=50.0)
    (run,), random = record.runs, np.random.default_rng(1)
    cut = signal.butter(8, lowest * frame.modes()[0][0], "high", fs=50.0, output="sos")
    moved = signal.sosfilt(cut, np.column_stack([run.excitation, run.responses]), axis=0)
    moved = 1e-3 * (moved + 0.01 * moved.std(axis=0) * random.standard_normal(moved.shape))
    record = dataclasses.replace(record, runs=(Run(moved[:, 1:], moved[:, 0]),))
    found = examined(scaled(record, {"floor2": -1.0, "floor3": 1 / 9.80665})).findings
    expected = [("sign", "floor2"), ("unit", "floor3")] if told else []
    assert [(item.kind, item.numbers["channel"]) for item in found] == expected


@pytest.mark.parametrize(
    "floors", [(2, 6), (1, 2), (1, 6), (4, 6), (5, 6), (1, 3), (2, 4), (1, 5, 6), (1, 2, 5), (1, 3, 5), range(1, 7)]
)
def test_a_missed_mode_is_weighed_against_a_reversed_channel_and_exchanged_ones(floors):
    """With the second and third modes, the frequency ratio and the changes of sign indicate a missed mode."""
    frequencies, shapes = KnownFrame(np.ones(6), np.ones(6), 0.01).modes()
    floors = np.array(floors)
    seen = shapes[:, floors - 1]
    best = weighed(frequencies[1:3], seen[1:3], floors, 6)[0]
    assert (best.kind, best.missed > 0.5) == ("sound", True)
    for sign in (1.0, -1.0):
        best = weighed(frequencies[:2], seen[:2] * [[1.0], [sign]], floors, 6)[0]
        assert (best.kind, best.missed > 0.5) == ("sound", False)
    assert weighed(frequencies[:2], seen[:2] * np.where(floors == floors[-1], -1.0, 1.0), floors, 6)[0].kind == "sign"
    order = [1, 0, *range(2, len(floors))]
    found = weighed(frequencies[:2], seen[:2][:, order], floors, 6)[0]
    assert (found.kind, found.places) == ("swapped channels", (0, 1))


@pytest.mark.parametrize("kept", [[0, 1, 3], [0, 2, 3], [1, 2, 3]])
def test_poles_of_noise_take_no_number(kept):
    """Two of four modes lie below half the sampling rate; the model has stable noise poles between them."""
    frame = KnownFrame(np.array([20.3, 19.8, 20.1, 16.2]), np.array([55e3, 63e3, 47e3, 41e3]), 0.015)
    result = identify_modes(only(base_record(frame, 1, noise=0.01, duration=300.0), kept), method="subspace")
    np.testing.assert_array_equal(result.modes, [1, 2])
    np.testing.assert_allclose(result.frequencies, frame.modes()[0][:2], rtol=2e-4)
    assert not [item for item in result.findings if item.kind in ("overlooked mode", "other mode")]


def test_missing_modes_are_said_only_where_some_are_missing():
    record = only(base_record(PAPER_FRAME, 0, noise=0.01, duration=200.0), [0, 2])
    assert "missing mode" not in {item.kind for item in identify_modes(record).findings}
    picked = identify_modes(record, pick=[1.03, 2.2])
    assert picked.modes.tolist() == [1, 2]
    said = {item.kind: item.message for item in picked.findings}
    assert said["missing mode"].startswith("2 of 3 modes were asked for, and 2 of 3 floors are measured")


def with_roof(record: TimeRecord, left, right, places=(None, None)) -> TimeRecord:
    """Return the record with two sensors in place of the top one, at declared places across or without any."""
    run = record.runs[0]
    at = [None if place is None else (0.0, place) for place in places]
    channels = (*record.channels[:2], *(Channel(n, 3, position=p) for n, p in zip(("left", "right"), at, strict=True)))
    both = np.column_stack([run.responses[:, :2], left, right])
    return dataclasses.replace(record, channels=channels, runs=(Run(both, run.excitation),))


def torsional_record() -> tuple[TimeRecord, float]:
    """Return a sway record with roof rotation at 1.6 Hz, seen by two sensors at unequal distances from the center."""
    record = base_record(PAPER_FRAME, 0, noise=0.01, duration=300.0)
    run, random = record.runs[0], np.random.default_rng(1)
    turning = signal.lfilter(*signal.iirpeak(1.6, 30, fs=20), random.standard_normal(run.samples))
    turning *= 0.8 * run.responses[:, 2].std() / turning.std()
    top = run.responses[:, 2]
    return with_roof(record, top + 1.3 * turning, top - 0.7 * turning, (1.3, None)), 1.6


def test_two_sensors_on_a_floor_are_its_motion_and_its_rotation():
    record, torsion = torsional_record()
    result = identify_modes(record)
    np.testing.assert_allclose(result.frequencies, PAPER_FRAME.modes()[0], rtol=1e-3)
    aside = [item for item in result.findings if item.kind == "rotation" and "frequency" in item.numbers]
    assert [item.numbers["frequency"] for item in aside] == [pytest.approx(torsion, rel=0.01)]


@pytest.mark.parametrize(
    ("places", "weights"),
    [((1.3, -0.7), (0.35, 0.65)), ((0.5, 2.0), (4 / 3, -1 / 3)), ((2.0, 2.5), (0.5, 0.5)), ((None, 1.0), (0.5, 0.5))],
)
def test_the_floors_center_follows_from_the_positions(places, weights):
    """Sensors at y1 and y2 measure U - t y: U is (y2 u1 - y1 u2) / (y2 - y1), unless this extrapolates far."""
    record, _ = torsional_record()
    channels = [
        dataclasses.replace(channel, position=None if place is None else (0.0, place))
        for channel, place in zip(record.channels[2:], places, strict=True)
    ]
    single, (said,) = one_a_floor(dataclasses.replace(record, channels=(*record.channels[:2], *channels)))
    both = record.runs[0].responses[:, 2:]
    center = both @ np.array(weights)
    np.testing.assert_allclose(single.runs[0].responses[:, 2], center, atol=1e-12)
    sway, turn = center.var(), np.var(both - center[:, None], axis=0).sum()
    assert said.numbers["share"] == pytest.approx(turn / (sway + turn))


def test_a_roof_that_turns_with_the_sway_is_said_mode_by_mode():
    """With declared positions, the shapes belong to the centers, although the roof rotates in the second mode."""
    record = base_record(PAPER_FRAME, 0, noise=0.005, duration=300.0)
    run = record.runs[0]
    second = PAPER_FRAME.modes()[0][1]
    turning = 1.5 * signal.lfilter(*signal.iirpeak(second, 30, fs=20), run.responses[:, 1])
    top = run.responses[:, 2]
    result = identify_modes(with_roof(record, top - 1.3 * turning, top + 0.5 * turning, (1.3, -0.5)))
    turned = [item.numbers["mode"] for item in result.findings if item.kind == "rotation" and "mode" in item.numbers]
    assert turned == [2]
    shapes = PAPER_FRAME.modes()[1]
    np.testing.assert_allclose(
        result.mode_shapes, shapes / np.take_along_axis(shapes, np.abs(shapes).argmax(1)[:, None], 1), atol=0.02
    )


@pytest.mark.parametrize(("factor", "said"), [(-1.0, "reversed"), (9.80665, "another unit"), (0.01, "another unit")])
def test_two_sensors_that_contradict_each_other_are_refused(factor, said):
    record, _ = torsional_record()
    with pytest.raises(InputError, match=rf'channel "(left|right)" .* contradict each other: .* {said}'):
        identify_modes(scaled(record, {"right": factor}))


def test_a_center_somewhere_between_two_sensors_makes_its_entries_as_uncertain():
    """The roof rotates by a fifth of its sway; its center is closer to one sensor."""
    record = base_record(PAPER_FRAME, 0, noise=0.005, duration=300.0)
    top = record.runs[0].responses[:, 2]
    result = identify_modes(with_roof(record, 1.3 * top, 0.9 * top))
    shapes = PAPER_FRAME.modes()[1]
    ratio = result.mode_shapes[:, 2] / result.mode_shapes[:, 1] * shapes[:, 1] / shapes[:, 2]
    np.testing.assert_allclose(ratio, 1.1, rtol=0.02)
    largest = np.abs(result.mode_shapes).max(axis=1)
    stated = result.entry_std[:, 2] * largest / np.abs(result.mode_shapes[:, 2])
    # Half of the difference is 0.2 of 1.1, with a uniform distribution between the sensors.
    np.testing.assert_allclose(stated, 0.2 / 1.1 / np.sqrt(3.0), rtol=0.05)


def test_a_sensor_that_points_backwards_is_turned_before_rotation_is_looked_for():
    record, torsion = torsional_record()
    expected = examined(record).turning(torsion)
    channels = (*record.channels[:3], dataclasses.replace(record.channels[3], direction=180.0))
    turned = examined(dataclasses.replace(scaled(record, {"right": -1.0}), channels=channels))
    assert turned.turning(torsion) == pytest.approx(expected)


def test_of_two_channels_either_may_be_the_reversed_one():
    frequencies, shapes = PAPER_FRAME.modes()
    seen = shapes[:, [0, 2]] * np.array([1.0, -1.0])
    channels = [Channel("low", 1), Channel("high", 3)]
    found = findings_of(weighed(frequencies, seen, np.array([1, 3]), 3), channels, seen[0])
    assert 'channel "low" (floor 1) or channel "high" (floor 3) is reversed' in found[0].message
    assert found[0].numbers["channels"] == ["low", "high"]


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


STEPS = np.arange(400) / 50.0


@pytest.mark.parametrize(
    ("index", "columns", "rate", "found"),
    [
        (lambda pd: pd.date_range("2024-03-31 01:59", periods=400, freq="20ms", tz="Europe/Berlin"), "ab", None, 50.0),
        (lambda pd: (STEPS + 600.0).astype(np.float32), "ab", None, 50.0),
        (lambda pd: STEPS, [("acc", 1), ("acc", 2)], None, 50.0),
        (lambda pd: STEPS[::-1], "ab", 50.0, "the table: the time must ascend; its median step is -0.02 s"),
        (lambda pd: STEPS, "ab", 100.0, "sampling_rate = 100 Hz, but the time of the table ticks at 50 Hz"),
        (lambda pd: 0.0 * STEPS, "ab", None, "the time must ascend; its median step is 0 s"),
        (lambda pd: np.where(STEPS == 0.1, np.nan, STEPS), "ab", None, "the table, sample 6: the time is missing"),
        (lambda pd: STEPS, "aa", None, 'has the column "a" 2 times'),
    ],
)
def test_times_and_names_of_a_data_frame(index, columns, rate, found):
    pandas = pytest.importorskip("pandas")
    values = np.random.default_rng(0).standard_normal((400, 2)).astype(np.float32)
    table = pandas.DataFrame(values, index=index(pandas), columns=list(columns))
    if isinstance(found, str):
        with pytest.raises(InputError, match=found):
            TimeRecord.of(table, sampling_rate=rate)
        return
    record = TimeRecord.of(table, floors={table.columns[1]: 2}, sampling_rate=rate)
    assert record.sampling_rate == pytest.approx(found, rel=1e-5)
    np.testing.assert_array_equal(record.runs[0].responses[:, 0], values[:, 1])


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


def test_a_measurement_file_without_a_mass_is_read_with_a_placeholder(tmp_path):
    path = tmp_path / "modes.toml"
    path.write_text("[[configuration]]\nfrequencies = [1.0, 3.0]\nmode_shapes = [[0.5, 1.0], [1.0, -0.6]]\n")
    assert load_unscaled(path).frame.total_mass_placeholder


@pytest.mark.parametrize(
    ("declared", "times", "expected", "unit"),
    [
        ("g", 9.80665, "floor 2 is declared in g and looks like m/s2: ", "m/s2"),
        ("m/s2", 1 / 9.80665, "floor 2 is declared in m/s2 and looks like g: ", "g"),
        ("mg", 1 / 9.80665, "floor 2 is declared in mg and looks like 9.81 times that: ", None),
        ("m/s", 9.80665, "floor 2 is declared in m/s and looks like 0.102 times that: ", None),
        (None, 1 / 9.80665, "floor 2 looks like g, the others like m/s2: ", "g"),
        (None, 9.80665, "floor 2 looks like m/s2, the others like g: ", None),
    ],
)
def test_a_wrong_unit_is_said_beside_the_declared_one(declared, times, expected, unit):
    """Lowest modes of a uniform five-story frame; floor 2 reads this multiple of the true motion."""
    frequencies, shapes = modes_of(np.full(5, 10.0), np.full(5, 2e4))
    shapes[:, 1] *= times
    channels = [Channel(f"acc {floor}", floor, unit=declared if floor == 2 else None) for floor in range(1, 6)]
    (finding,) = findings_of(weighed(frequencies[:2], shapes[:2], np.arange(1, 6), 5), channels, shapes[0])
    assert finding.message.startswith(expected)
    assert finding.numbers["unit"] == unit
    assert finding.numbers["factor"] == pytest.approx(1 / times)
    assert (f'Write unit = "{unit}"' in finding.message) == (unit is not None)


def test_a_velocity_never_looks_like_g():
    record = ambient_record(KnownFrame(np.full(5, 10.0), np.full(5, 2e4), 0.01), 1, noise=0.01, duration=300.0)
    record = dataclasses.replace(scaled(record, {"floor2": 1 / 9.80665}), quantity="velocity")
    (wrong,) = (item for item in identify_modes(record).findings if item.kind == "unit")
    assert "looks like 9.81 times that" in wrong.message
    assert (wrong.numbers["unit"], wrong.numbers["channel"]) == (None, "floor2")


def test_what_is_probable_but_not_sure_is_said_with_odds_that_make_up_the_whole():
    channels = [Channel("acc_1", 1), Channel("acc_2 (g)", 2)]
    weights = [ChannelMistake("unit", (1,), 9.80665, 0.91), ChannelMistake("sound", probability=0.002)]
    others = ChannelMistake("sign", (0,), probability=0.088)
    (finding,) = findings_of([*weights, others], channels, np.array([0.6, 0.1]))
    assert finding.message.startswith(
        'by the lowest modes channel "acc_2 (g)" (floor 2) looks like g, the others like m/s2 (91.0 %), the channels '
        "are as declared (0.2 %) or something else is wrong (8.8 %); look at"
    )
    assert "The record is taken as declared: nothing reaches 95 %" in finding.message
    assert finding.numbers["corrected"] is False


def test_what_a_release_leaves_in_the_model_is_no_spike():
    """The spike model uses the 24 preceding samples; nine samples after this release, its error is ten deviations."""
    assert "spikes" not in {finding.kind for finding in examined(sound_record(120002, "free_decay")).findings}


@pytest.mark.parametrize("place", [24, 25, 600, 1175])
def test_a_spike_is_found_wherever_the_model_reaches(place):
    record = ambient_record(PAPER_FRAME, 3, noise=0.01, duration=60.0)
    values = record.runs[0].responses.copy()
    values[place, 1] += 30 * values[:, 1].std()
    (spike,) = examined(dataclasses.replace(record, runs=(Run(values),))).findings
    assert (spike.kind, spike.numbers) == ("spikes", {"channel": "floor2", "samples": 1})
