"""Test that a prediction's report is self-contained and has numbers and pictures."""

import html
import json
import re

import numpy as np
import pytest

import cvxshear
from cvxshear import close_loop
from cvxshear.io.toml import write_measurement
from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.report.html import render
from cvxshear.response import DampedModel, Fitted, Models, models_of_loop, predict, response
from tests.records.shared import channels, csv
from tests.report.conftest import NASTY, table
from tests.report.test_html import Page
from tests.response.common import damped_frame, damped_measurement, matrices, shaking

pytestmark = pytest.mark.usefixtures("shared_drawings")
COMMAND = "cvxshear predict frame.toml --record shaken.toml"


@pytest.fixture(scope="module")
def closed():
    return close_loop(cvxshear.Experiment.from_dict(damped_measurement(3), name=NASTY), effects=["gravity"])


def motion(*, measured):
    excitation = shaking(800)
    M, C, K = matrices(*damped_frame(3))
    moved = response(DampedModel(M, C, K, np.ones(3)), DrivenRun(excitation), 0.01).acceleration
    if not measured:
        return DrivenRecord((DrivenRun(excitation),), 100.0, name=NASTY)
    return DrivenRecord((DrivenRun(excitation, responses=moved),), 100.0, floors=np.arange(1, 4), name=NASTY)


@pytest.fixture(scope="module", params=[True, False], ids=["measured", "ground alone"])
def prediction(closed, request):
    return predict(models_of_loop(closed), motion(measured=request.param))


@pytest.fixture(scope="module")
def text(prediction):
    return render(prediction, COMMAND)


def figures_of(page):
    return [dict(attributes).get("id") for tag, attributes in page.attributes if tag == "figure"]


def test_pictures_and_numbers(prediction, text):
    assert figures_of(Page(text)) == ["figure-history", "figure-peaks"]
    said = json.loads(html.unescape(re.search(r'<pre id="result">(.*?)</pre>', text, re.DOTALL)[1]))
    assert said == json.loads(json.dumps(prediction.to_dict()))
    assert text.count("<tr") > 3


def test_one_set_of_errors_where_nothing_was_added(closed):
    """With exact modes of a shear frame, the models before and after are one, in terminal, page and picture."""
    assert closed.estimate.effects == ()
    alike = predict(models_of_loop(closed), motion(measured=True))
    assert alike.to_dict()["before"] == alike.to_dict()["after"]
    errors = table(alike, "prediction-errors")
    assert errors.head[:2] == ("floor", "error in time")
    assert [row[0] for row in errors.rows] == ["3", "2", "1"]


def test_two_sets_of_errors_where_an_effect_was_added(closed):
    gained = close_loop(closed.experiment, effects=[], assume=["gravity"]).estimate
    pair = Models(Fitted.of(closed.estimate), Fitted.of(gained))
    found = predict(pair, motion(measured=True))
    assert [row[:2] for row in table(found, "prediction-errors").rows[:2]] == [
        ("3", "shear model"),
        ("3", "with effects"),
    ]


@pytest.mark.usefixtures("shared_loops")
def test_commands_write_it(tmp_path, monkeypatch, printed):
    monkeypatch.chdir(tmp_path)
    write_measurement("frame.toml", damped_measurement(2))
    csv(tmp_path / "ground.csv", ["ground"], shaking(400)[:, None])
    (tmp_path / "ground.toml").write_text(
        '[record]\nname = "ground"\ninput = "base"\nfile = "ground.csv"\nsampling_rate = 100.0\n'
        + channels("ground", first=0)
    )
    words = ["predict", "frame.toml", "--record", "ground.toml"]
    printed(*words, "--report", "predict.html")
    text = (tmp_path / "predict.html").read_text()
    assert all(said in text for said in ("Predicted response", "figure-peaks", " ".join(words)))
