"""Test modes of records of floors that turn, simulated with the frames of tests/fe/plan_frames.py."""

import json

import numpy as np
import pytest
from scipy import linalg, signal

import cvxshear
from cvxshear.io.modes import modes_from_file
from cvxshear.records import Channel, Run, TimeRecord, identify_modes
from tests.fe.plan_frames import random_frame
from tests.io.test_schema import faults

RATE = 50.0


def readings(frame, seconds=400.0, seed=1, noise=0.02):
    """Simulate all sensors under white forces on every floor, one recursive filter a mode, with 1 % of damping."""
    rng, dense = np.random.default_rng(seed), 8
    values, shapes = linalg.eigh(frame.matrices[1], frame.matrices[0])
    forces = rng.standard_normal((int(seconds * RATE) * dense, len(values))) * np.tile([1.0, 1.0, 4.0], frame.stories)
    moved = np.zeros((len(forces), len(values)))
    for omega, shape in zip(np.sqrt(values), shapes.T, strict=True):
        system = [1.0, 0.0, 0.0], [1.0, 0.02 * omega, omega**2]
        above, below, _ = signal.cont2discrete(system, 1.0 / (RATE * dense), method="foh")
        moved += np.outer(signal.lfilter(above.ravel(), below, forces @ shape), shape)
    rows = []
    for sensor in frame.sensors():
        angle, place = np.deg2rad(sensor["direction"]), frame.place(sensor["floor"] - 1, *sensor["position"])
        rows.append(np.cos(angle) * place[0] + np.sin(angle) * place[1])
    sampled = signal.decimate(moved @ np.array(rows).T, dense, ftype="fir", axis=0)
    return sampled + noise * sampled.std(axis=0) * rng.standard_normal(sampled.shape)


def record_of(frame):
    channels = tuple(
        Channel(f"s{place}", sensor["floor"], position=sensor["position"], direction=sensor["direction"])
        for place, sensor in enumerate(frame.sensors(), 1)
    )
    return TimeRecord(channels, runs=(Run(readings(frame)),), sampling_rate=RATE, turns=True, name="wind")


def test_modes_of_a_symmetric_frame_are_pure():
    """Without eccentricity, each mode is displacement in x, in y, or rotation."""
    frame = random_frame(2, 31, symmetric=True)
    found = identify_modes(record_of(frame))
    expected = np.sqrt(linalg.eigvalsh(frame.matrices[1], frame.matrices[0])) / (2 * np.pi)
    np.testing.assert_allclose(found.frequencies, expected, rtol=0.003)
    shares = found.motion_shares
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    assert np.all(shares.max(axis=1) > 0.95)
    assert sorted(np.argmax(shares, axis=1).tolist()) == [0, 0, 1, 1, 2, 2]
    table = found.to_dataframe()
    np.testing.assert_allclose(table[["share_x", "share_y", "share_rotation"]], shares)
    np.testing.assert_allclose(table["sensor_1"], found.mode_shapes[:, 0])
    for word in ("rotation", "floor 1, "):
        assert word in str(found)
    assert faults("modes", json.loads(json.dumps(found.to_dict()))) == []


def record_file(tmp_path, frame, **changes):
    """Write a record file; channels along y are declared by their axis."""
    np.savetxt(tmp_path / "wind.csv", readings(frame), delimiter=",", header="a,b,c,d,e,f", comments="")
    lines = ["[frame]", 'motions = ["x", "y", "rotation"]', f"total_mass = {frame.floor_mass.sum()}", "[record]"]
    lines += ['file = "wind.csv"', f"sampling_rate = {RATE}"]
    for name, sensor in zip("abcdef", frame.sensors(), strict=True):
        axis = "y" if sensor["direction"] else "x"
        lines += ["[[channel]]", f'column = "{name}"', f"floor = {sensor['floor']}", f'axis = "{axis}"']
        if name != changes.get("without"):
            lines.append(f"position = {sensor['position']}")
    path = tmp_path / "record.toml"
    path.write_text("\n".join(lines))
    return path


def test_the_command_line_writes_a_measurement_file_with_its_sensors(tmp_path, printed):
    frame = random_frame(2, 3)
    written = {"--output": tmp_path / "test.toml", "--report": tmp_path / "modes.html"}
    out = printed("modes", record_file(tmp_path, frame), *(each for pair in written.items() for each in pair))
    assert "rotation" in out
    assert "rotation" in written["--report"].read_text()
    experiment = cvxshear.load(written["--output"])
    assert [sensor.direction for sensor in experiment.configurations[0].sensors] == [0.0, 90.0, 0.0] * 2
    result = cvxshear.identify(experiment).frame
    assert np.all(np.abs(result.floor_mass - frame.floor_mass) < 4 * result.floor_mass_std)
    assert np.all(np.abs(result.mass_center - frame.mass_center) < 4 * result.mass_center_std)
    np.testing.assert_allclose(result.floor_mass, frame.floor_mass, rtol=0.05)


def test_a_channel_without_a_position_is_named(tmp_path):
    with pytest.raises(cvxshear.InputError, match=r'channel "c" .* needs a position'):
        modes_from_file(record_file(tmp_path, random_frame(2, 3), without="c"))
