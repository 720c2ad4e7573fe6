"""Test the time series of predictions: equal numbers in every file format."""

import numpy as np
import pytest
from scipy import io

import cvxshear
from cvxshear.paper.reproduction import exact_modes
from cvxshear.paper.setups import three_story
from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.report.responses import series, write_series
from cvxshear.response import Fitted, Models, predict
from tests.response.common import shaking

RATIOS = [0.01, 0.015, 0.02]


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


def test_the_header_of_time_series_has_units(three, tmp_path):
    write_series(tmp_path / "series.csv", three[2]["modal"])
    head = (tmp_path / "series.csv").read_text().splitlines()[0].split(",")
    assert head[:4] == ["run", "time (s)", "excitation (m/s2)", "acceleration_1 (m/s2)"]
    assert {"drift_2 (m)", "drift_std_2 (m)", "drift_ratio_1", "shear_3 (N)", "overturning_moment (N m)"} < set(head)
