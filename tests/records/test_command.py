"""Test the command line on a record: writing modes to a measurement file, and the loop on the record itself."""

import json
import re

import numpy as np
import pytest
from scipy import io, signal

import cvxshear
from cvxshear.records import Channel, Run, TimeRecord, identify_modes
from cvxshear.records.simulate import KnownFrame, base_record
from tests.frames import chain, modes_of
from tests.records.shared import channels

MASS = np.array([10.0, 7.5, 5.0])
STIFFNESS = np.array([18000.0, 12000.0, 6000.0])
DAMPING = 0.01


@pytest.fixture
def record(tmp_path):
    """Return accelerances of the three-story frame with the force at floor 3 and little noise."""
    _, K = chain(MASS, STIFFNESS)
    eigenvalues, vectors = np.linalg.eigh(np.diag(MASS**-0.5) @ K @ np.diag(MASS**-0.5))
    phi = np.diag(MASS**-0.5) @ vectors
    f = np.arange(1, 1025) / 64
    w, wn = 2 * np.pi * f[:, None], np.sqrt(eigenvalues)
    receptance = 1.0 / (wn**2 - w**2 + 2j * DAMPING * w * wn)
    rng = np.random.default_rng(0)
    columns = []
    for floor in range(3):
        values = -(w[:, 0] ** 2) * (receptance @ (phi[floor] * phi[2]))
        values = values + 1e-3 * np.abs(values).max() * (rng.standard_normal(1024) + 1j * rng.standard_normal(1024))
        columns += [values.real, values.imag]
    names = ",".join(["frequency_hz", *(f"floor{i}_{part}" for i in (1, 2, 3) for part in ("re", "im"))])
    np.savetxt(tmp_path / "frf.csv", np.column_stack([f, *columns]), delimiter=",", header=names, comments="")
    text = '[record]\nkind = "frf"\nfile = "frf.csv"\ninput_floor = 3\n' + channels("floor1", "floor2", "floor3")
    path = tmp_path / "record.toml"
    path.write_text(text + "\n[frame]\ntotal_mass = 22.5\n")
    return path


def test_modes_are_printed_and_written(record, tmp_path, printed):
    file = tmp_path / "test.toml"
    out = printed("modes", record, "-o", file)
    assert "3 modes at floors 1, 2, 3" in out
    frequencies, _ = modes_of(MASS, STIFFNESS)
    np.testing.assert_allclose(cvxshear.load(file).configurations[0].frequencies, frequencies, rtol=1e-3)


def test_the_loop_takes_a_record(record, printed):
    result = json.loads(printed("loop", record, "--effects", "ground_spring", "--json", "-"))
    assert len(result["modes"]["frequencies"]) == 3
    np.testing.assert_allclose(result["frame"]["floor_mass"], MASS, rtol=0.03)


def test_check_asks_about_a_sensor_that_its_file_has_the_wrong_way(record, run):
    record.write_text(record.read_text().replace("floor = 2\n", "floor = 2\nsign = -1\n"))
    status, out, _ = run("check", record, "--strict")
    assert status == 3
    assert "RECORD: sign" in out
    assert json.loads(run("check", record, "--json", "-")[1])["doubtful"]
    # A problem that `modes` repairs does not block the command.
    assert run("modes", record)[0] == 0


def test_check_takes_a_record_and_says_what_its_diagnostics_say(record, run, printed):
    out = printed("check", record, "--json", "-")
    result = json.loads(out)
    assert result["findings"] == []
    assert not result["refused"]
    exchanged = record.read_text().replace("floor = 1", "floor = 9").replace("floor = 2", "floor = 1")
    record.write_text(exchanged.replace("floor = 9", "floor = 2"))
    status, out, _ = run("check", record, "--strict")
    assert status == 3
    assert "RECORD: swapped channels" in out
    assert "MISTAKE" not in out


def test_each_run_by_itself_ends_in_a_table_over_the_amplitude(tmp_path, run, printed):
    """Frames of 2 Hz times A^-0.04, each driven by noise of strength A, simulated exactly."""
    arrays = {}
    for number, strength in enumerate((0.1, 0.4, 2.0), 1):
        frame = KnownFrame([1000.0], [1000.0 * (4 * np.pi) ** 2 * strength**-0.08], 0.02)
        (run,) = base_record(frame, number, noise=0.01, duration=300.0).runs
        arrays[f"eq{number}"] = {"acc": strength * np.column_stack([run.excitation, run.responses])}
    io.savemat(tmp_path / "quakes.mat", {**arrays, "fs": 20.0})
    path = tmp_path / "record.toml"
    both = channels("*.acc[1]", "*.acc[2]", first=0)
    path.write_text(f'[record]\ninput = "base"\nfile = "quakes.mat"\n{both}')
    file, figure = tmp_path / "modes.toml", tmp_path / "amplitude.svg"
    arguments = ("modes", path, "--each-run", "-o", file, "--figure", f"amplitude:{figure}")
    out = printed(*arguments)
    assert "Modes over the amplitude of the motion" in out
    tests = cvxshear.load(file).configurations
    amplitudes = np.array([test.amplitude for test in tests])
    change = float(re.search(r"mode 1 by (\S+) ± \S+ %", " ".join(out.split())).group(1))
    exact = np.polyfit(np.log10(amplitudes), -0.04 * np.log([0.1, 0.4, 2.0]), 1)[0]
    assert change == pytest.approx(100 * np.expm1(exact), abs=0.3)
    np.testing.assert_allclose(
        [test.frequencies[0] for test in tests], 2 * np.array([0.1, 0.4, 2.0]) ** -0.04, rtol=3e-3
    )
    assert np.all(np.diff(amplitudes) > 0)
    assert figure.exists()


def test_a_tone_is_doubted_as_the_first_mode():
    random = np.random.default_rng(3)
    base = signal.sosfilt(signal.butter(4, 5.0, fs=100.0, output="sos"), random.standard_normal(6000))
    tone = 0.1 * np.sin(2 * np.pi * 21.6 * np.arange(6000) / 100.0)
    run = Run(np.outer(tone, [0.7, 1.0]) + 0.05 * random.standard_normal((6000, 2)), base)
    record = TimeRecord((Channel("floor 2", 2), Channel("roof", 6)), runs=(run,), sampling_rate=100.0, input="base")
    found = identify_modes(record)
    np.testing.assert_allclose(found.frequencies[0], 21.6, rtol=1e-3)
    assert any(each.numbers.get("damping", 1.0) < 1e-3 for each in found.findings if each.kind == "doubtful mode")


@pytest.mark.parametrize(("highest", "doubted"), [(5.0, True), (40.0, False)])
def test_a_first_mode_above_the_excited_band_is_doubted(highest, doubted):
    """A floor of 10 Hz under noise of the base up to 5 or 40 Hz."""
    random, rate = np.random.default_rng(4), 100.0
    base = signal.sosfilt(signal.butter(6, highest, fs=rate, output="sos"), random.standard_normal(12_000))
    wind = signal.lfilter(*signal.iirpeak(10.0, 30, fs=rate), random.standard_normal(12_000))
    roof = base + signal.lfilter(*signal.iirpeak(10.0, 30, fs=rate), base) + 0.3 * wind
    record = TimeRecord((Channel("roof", 1),), runs=(Run(roof[:, None], base),), sampling_rate=rate, input="base")
    found = [each.numbers for each in identify_modes(record).findings if each.kind == "doubtful mode"]
    assert bool(found) is doubted
    assert all(numbers["excited"] < 0.01 for numbers in found)
