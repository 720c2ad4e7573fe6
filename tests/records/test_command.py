"""Test the command line on a record: writing modes to a measurement file, and the loop on the record itself."""

import json

import numpy as np
import pytest

import cvxshear
from cvxshear.cli import main
from tests.frames import chain, modes_of

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
    channels = "".join(f'\n[[channel]]\ncolumn = "floor{i}"\nfloor = {i}\n' for i in (1, 2, 3))
    text = f'[record]\nkind = "frf"\nfile = "frf.csv"\ninput_floor = 3\n{channels}\n[frame]\ntotal_mass = 22.5\n'
    path = tmp_path / "record.toml"
    path.write_text(text)
    return path


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(list(arguments))
    return stopped.value.code, capsys.readouterr()


def test_modes_are_printed_and_written(record, tmp_path, capsys):
    out = tmp_path / "test.toml"
    status, shown = run(capsys, "modes", str(record), "-o", str(out))
    assert status == 0, shown.err
    assert "3 modes at floors 1, 2, 3" in shown.out
    frequencies, _ = modes_of(MASS, STIFFNESS)
    np.testing.assert_allclose(cvxshear.load(out).configurations[0].frequencies, frequencies, rtol=1e-3)


def test_the_loop_takes_a_record(record, capsys):
    status, shown = run(capsys, "loop", str(record), "--effects", "ground_spring", "--json", "-")
    assert status == 0, shown.err
    result = json.loads(shown.out)
    assert len(result["modes"]["frequencies"]) == 3
    np.testing.assert_allclose(result["frame"]["floor_mass"], MASS, rtol=0.03)


def test_a_record_with_a_mistake_is_status_two(record, tmp_path, capsys):
    record.write_text(record.read_text().replace('"floor2"', '"flor2"'))
    status, shown = run(capsys, "modes", str(record), "-o", str(tmp_path / "never.toml"))
    assert status == 2
    assert "flor2" in shown.err
    assert not (tmp_path / "never.toml").exists()


def test_check_asks_about_a_sensor_that_its_file_has_the_wrong_way(record, capsys):
    record.write_text(record.read_text().replace("floor = 2\n", "floor = 2\nsign = -1\n"))
    status, shown = run(capsys, "check", str(record), "--strict")
    assert status == 3
    assert "RECORD: sign" in shown.out
    assert json.loads(run(capsys, "check", str(record), "--json", "-")[1].out)["doubtful"]
    # A problem that `modes` repairs does not block the command.
    assert run(capsys, "modes", str(record))[0] == 0


def test_check_takes_a_record_and_says_what_its_diagnostics_say(record, capsys):
    status, shown = run(capsys, "check", str(record), "--json", "-")
    assert status == 0, shown.err
    result = json.loads(shown.out)
    assert result["findings"] == []
    assert not result["refused"]
    exchanged = record.read_text().replace("floor = 1", "floor = 9").replace("floor = 2", "floor = 1")
    record.write_text(exchanged.replace("floor = 9", "floor = 2"))
    status, shown = run(capsys, "check", str(record))
    assert status == 2
    assert "RECORD: swapped channels" in shown.out
    assert "MISTAKE: swapped_sensors" in shown.out
