"""Test exported predictions and models: equal numbers in every file format, and the same frame in other programs."""

import ast
import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest
from scipy import io

import cvxshear
from cvxshear import effects
from cvxshear.effects import LocatedEffect
from cvxshear.paper.reproduction import exact_modes
from cvxshear.paper.setups import three_story
from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.report.handover import matrices, series, write_model, write_series
from cvxshear.response import Fitted, Models, predict
from cvxshear.util.errors import InputError, UnsuitableError
from tests.response.common import shaking

RATIOS = [0.01, 0.015, 0.02]
NEEDS_OPENSEES = pytest.mark.skipif(
    importlib.util.find_spec("openseespy") is None, reason="openseespy (the extra opensees) is not installed"
)


@pytest.fixture(scope="module")
def three():
    """Return the paper's three-story model with damping and known masses, and its prediction."""
    table = exact_modes().to_dict()
    table["frame"]["story_heights"] = 3.0
    table["configuration"][0]["damping_ratios"] = RATIOS
    experiment = cvxshear.Experiment.from_dict(table, name="three = stories")
    theta = three_story(0.01).truth
    fitted = Fitted(experiment, (), theta, np.diag((1e-3 * theta) ** 2))
    motion = DrivenRecord((DrivenRun(shaking(600)),), 100.0)
    return fitted, motion, {kind: predict(Models(None, fitted), motion, damping=kind) for kind in ("modal", "story")}


@pytest.mark.parametrize("kind", ["csv", "mat", "npz"])
def test_series_are_the_same_in_every_file(three, kind, tmp_path):
    found = three[2]["story"]
    path = tmp_path / f"series.{kind}"
    write_series(path, found)
    columns = series(found)
    assert {"time", "acceleration_1", "acceleration_std_3", "drift_ratio_2", "base_shear"} <= set(columns)
    if kind == "csv":
        heads = path.read_text().splitlines()[0].split(",")
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        again = {head.split(" (")[0]: values for head, values in zip(heads, table.T, strict=True)}
    elif kind == "npz":
        again = dict(np.load(path))
    else:
        again = {name: values[:, 0] for name, values in io.loadmat(path).items() if not name.startswith("__")}
    assert set(again) == set(columns)
    for name, values in again.items():
        np.testing.assert_allclose(values, columns[name], rtol=1e-8, atol=1e-12)


def test_models_are_the_same_in_every_file(three, tmp_path):
    found = three[2]["story"]
    expected = matrices(found.after.damped)
    for kind in ("npz", "mat", "json"):
        write_model(tmp_path / f"model.{kind}", found)
    from_json = json.loads((tmp_path / "model.json").read_text())
    from_mat = io.loadmat(tmp_path / "model.mat")
    with np.load(tmp_path / "model.npz") as from_npz:
        assert set(from_npz) == set(from_json) == set(expected)
        for name, values in expected.items():
            np.testing.assert_array_equal(from_npz[name], values)
            np.testing.assert_array_equal(np.array(from_json[name]), values)
            np.testing.assert_array_equal(from_mat[name].reshape(values.shape), values)
    shapes, M, K = expected["mode_shapes"], expected["M"], expected["K"]
    np.testing.assert_allclose(shapes @ M @ shapes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.diag(shapes @ K @ shapes.T), (2 * np.pi * expected["frequencies"]) ** 2, rtol=1e-10)
    poles = np.linalg.eigvals(expected["state_A"])
    ratios = np.sort(-poles.real / np.abs(poles))[::2]
    np.testing.assert_allclose(ratios, np.sort(found.damping.ratios), rtol=1e-8)


def opensees(path, call, tmp_path):
    """Call the script in a process of its own, because OpenSees prints and can exit, and return the result."""
    out = tmp_path / "out.json"
    code = (
        f"import json, runpy; module = runpy.run_path({str(path)!r}); result = {call}; "
        f"json.dump(result, open({str(out)!r}, 'w'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path)
    if "Failed to import openseespy" in done.stderr:
        pytest.skip("openseespy is installed but cannot be loaded here")
    assert done.returncode == 0, done.stderr
    return json.loads(out.read_text())


@NEEDS_OPENSEES
def test_opensees_has_the_same_frequencies(three, tmp_path):
    found = three[2]["modal"]
    write_model(tmp_path / "frame.py", found)
    frequencies = opensees(tmp_path / "frame.py", "(module['build'](), module['frequencies']())[1]", tmp_path)
    np.testing.assert_allclose(frequencies, found.after.damped.model.modes.frequencies, rtol=1e-9)


@NEEDS_OPENSEES
def test_opensees_has_the_same_frequencies_with_an_effect(three, tmp_path):
    """Rocking fills the stiffness matrix: springs connect all floors."""
    fitted, motion, _ = three
    rocking = LocatedEffect(effects.named(["base_rocking"])[0])
    theta = np.append(fitted.theta, 1e-3 / (fitted.theta[3:].sum() * 9.0))
    found = predict(Models(None, Fitted(fitted.experiment, (rocking,), theta, None)), motion)
    assert np.all(np.abs(found.after.damped.model.K) > 0)
    write_model(tmp_path / "frame.py", found)
    frequencies = opensees(tmp_path / "frame.py", "(module['build'](), module['frequencies']())[1]", tmp_path)
    np.testing.assert_allclose(frequencies, found.after.damped.model.modes.frequencies, rtol=1e-9)


@NEEDS_OPENSEES
@pytest.mark.parametrize("kind", ["modal", "story", "rayleigh"])
def test_opensees_moves_alike(three, kind, tmp_path):
    """With a small step, Newmark's method approaches the exact answer for each kind of damping."""
    fitted, _, _ = three
    step = 0.0005
    excitation = np.interp(np.arange(0, 1.0, step), np.arange(0, 1.01, 0.01), shaking(101))
    motion = DrivenRecord((DrivenRun(excitation),), 1 / step)
    found = predict(Models(None, fitted), motion, damping=kind, detrend=False)
    write_model(tmp_path / "frame.py", found)
    moved = np.array(opensees(tmp_path / "frame.py", f"module['shake']({excitation.tolist()}, {step})", tmp_path))
    exact = found.after.responses[0].displacement
    assert np.abs(moved - exact).max() < 0.005 * np.abs(exact).max()


def test_the_script_is_python_whatever_the_frame_is_called(three, tmp_path):
    fitted, motion, _ = three
    table = fitted.experiment.to_dict()
    nasty = cvxshear.Experiment.from_dict(table, name='a """ quote\nand \\ more')
    found = predict(Models(None, Fitted(nasty, (), fitted.theta, None)), motion)
    write_model(tmp_path / "frame.py", found)
    script = ast.parse((tmp_path / "frame.py").read_text())
    assert {"build", "frequencies", "shake"} <= {part.name for part in script.body if isinstance(part, ast.FunctionDef)}


def test_coupled_masses_are_no_nodal_masses(three, tmp_path):
    fitted, motion, _ = three
    coupling = LocatedEffect(effects.named(["mass_coupling"])[0])
    found = predict(Models(None, Fitted(fitted.experiment, (coupling,), np.append(fitted.theta, 0.5), None)), motion)
    with pytest.raises(UnsuitableError, match="masses at nodes only"):
        write_model(tmp_path / "frame.py", found)
    assert not list(tmp_path.iterdir())


def test_the_header_of_time_series_has_units(three, tmp_path):
    write_series(tmp_path / "series.csv", three[2]["modal"])
    head = (tmp_path / "series.csv").read_text().splitlines()[0].split(",")
    assert head[:4] == ["run", "time (s)", "excitation (m/s2)", "acceleration_1 (m/s2)"]
    assert {"drift_2 (m)", "drift_std_2 (m)", "drift_ratio_1", "shear_3 (N)", "overturning_moment (N m)"} < set(head)


def test_names_of_files_that_nothing_is_written_as(three, tmp_path):
    with pytest.raises(InputError, match=r"time series are written as .csv, .mat or .npz"):
        write_series(tmp_path / "series.xls", three[2]["modal"])
    with pytest.raises(InputError, match=r"a model is written as .npz, .mat, .json or .py"):
        write_model(tmp_path / "model.xls", three[2]["modal"])
    with pytest.raises(InputError, match="cannot be written"):
        write_series(tmp_path / "nowhere" / "series.csv", three[2]["modal"])
