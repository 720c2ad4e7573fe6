"""Test that figures of a prediction are readable and show the prediction."""

import dataclasses
import re

import numpy as np
import pytest

import cvxshear
from cvxshear import backends, response
from cvxshear.fit.efficient import efficient
from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.report import figures
from cvxshear.report.blocks import describe
from cvxshear.report.figures.style import figures_of
from cvxshear.report.html import render
from tests.report.test_figures import assert_readable
from tests.report.test_html import sways
from tests.response.common import damped_frame, damped_measurement, declared, matrices, pole_ratios, shaking

DRAWN = [figures.response_histories, figures.response_peaks]


@pytest.fixture(scope="module", params=[2, 20])
def prediction(request):
    stories = request.param
    M, C, K = matrices(*damped_frame(stories))
    experiment = cvxshear.Experiment.from_dict(damped_measurement(stories))
    fitted = response.Fitted.of(efficient(experiment, backends.get("auto")))
    excitation = shaking(800)
    floors = np.arange(1, stories + 1)
    moved = response.response(response.DampedModel(M, C, K, np.ones(stories)), DrivenRun(excitation), 0.01).acceleration
    motion = DrivenRecord((DrivenRun(excitation, responses=moved),), 100.0, floors=floors)
    with pytest.MonkeyPatch.context() as patch:
        # Skip the sensor checks. The figures of sound sensors do not depend on them.
        patch.setattr("cvxshear.response.recording.whole_pieces", lambda record: [])
        return response.predict(response.Models(fitted, fitted), motion)


@pytest.mark.parametrize("draw", DRAWN, ids=lambda draw: draw.__name__)
def test_figures_are_readable(prediction, draw):
    assert_readable(draw(prediction))


def test_figures_without_measured_floors(prediction):
    bare = DrivenRecord((DrivenRun(prediction.motion.runs[0].excitation),), 100.0)
    found = response.predict(response.Models(None, prediction.after.fitted), bare)
    for draw in DRAWN:
        assert_readable(draw(found))


def test_peaks_are_drawn_where_they_are(prediction):
    axes = figures.response_peaks(prediction).axes[0]
    drawn = next(line for line in axes.lines if line.get_marker() == "s")
    np.testing.assert_allclose(drawn.get_xdata(), prediction.peaks.values["floor_acceleration"])


def panel_numbers(drawn):
    return [int(axes.get_title(loc="left").split()[-1]) for axes in drawn.axes]


@pytest.mark.parametrize("largest", [1, 3, 12, 20])
def test_the_floor_of_the_largest_peak_is_drawn_and_those_left_out_are_counted(prediction, largest):
    count = len(prediction.after.damped.model.M)
    peak = np.where(np.arange(1, count + 1) == min(largest, count), 9.0, 1.0)
    peaks = response.Peaks({**prediction.peaks.values, "floor_acceleration": peak}, prediction.peaks.std)
    found = dataclasses.replace(prediction, peaks=peaks)
    shown = panel_numbers(figures.response_histories(found))
    assert min(largest, count) in shown
    assert shown == sorted(shown, reverse=True)
    caption = figures_of(response.RecordPrediction)["history"].caption_of(found)
    assert ("not drawn" in caption) == (count > 4)
    assert count <= 4 or f"16 of {count}" in caption


def test_the_story_that_the_headline_names_is_drawn():
    """The third of five stories is the softest; four panels spread over the height would omit it."""
    mass, stiffness, dashpots = damped_frame(5)
    stiffness[2] *= 0.2
    M, C, K = matrices(mass, stiffness, dashpots)
    experiment = cvxshear.Experiment.from_dict(declared(mass, stiffness, pole_ratios(M, C, K)))
    fitted = response.Fitted.of(efficient(experiment, backends.get("auto")))
    excitation = shaking(800)
    moved = response.response(response.DampedModel(M, C, K, np.ones(5)), DrivenRun(excitation), 0.01).acceleration
    motion = DrivenRecord((DrivenRun(excitation, responses=moved),), 100.0, floors=np.arange(1, 6))
    found = response.reconstruct(response.Models(None, fitted), motion, fit=False, leave_out=False)
    assert describe(found).headline.startswith("Story 3 drifted most: ")
    assert "base motion" in describe(found)["findings"].parts[0].text
    assert panel_numbers(figures.reconstructed_histories(found)) == [5, 4, 3, 1]
    for entry in figures_of(response.Reconstruction).values():
        assert_readable(entry.draw(found))
    assert "1 of 5 stories is not drawn" in figures_of(response.Reconstruction)["histories"].caption_of(found)
    page = render(found, "cvxshear reconstruct")
    drawing = re.search(r'<figure id="figure-shaking">(.*?)</figure>', page, re.DOTALL)[1]
    pictures = [sways(each) for each in re.search(r'values="(M.*?)"', drawing)[1].split(";")]
    moved = found.runs[0].response.displacement
    drifts = np.abs(found.runs[0].response.drift).max(axis=1)
    # The pictures are samples of the reconstructed motion, at least 15 in a period, with the largest drift among them.
    scale = max(np.abs(each).max() for each in pictures)
    assert scale == pytest.approx(1.0, abs=2e-3)
    (unit,) = (float(each) * 1e-3 for each in re.findall(r"floor 5 sways most, by ([\d.]+) mm", drawing))
    strongest = moved[np.argmax(drifts)] / unit
    assert min(np.abs(each - strongest).max() for each in pictures) < 5e-3
    at = [int(np.argmin(np.abs(moved / unit - each).max(axis=1))) for each in pictures]
    np.testing.assert_allclose(moved[at] / unit, pictures, atol=5e-3)
    assert (np.diff(at) == at[1] - at[0]).mean() > 0.95
    assert 100 / (at[1] - at[0]) > 15 * found.model.modes.frequencies[0]
    stills = re.findall(r'class="still"><path class="rest" d=".*?"/><path d="(.*?)"/>.*?>([\d.]+) s<', drawing)
    for outline, time in stills:
        np.testing.assert_allclose(sways(outline), moved[round(100 * float(time))] / unit, atol=5e-3)
    assert len(stills) == 4
    assert float(stills[0][1]) == pytest.approx(0.01 * np.argmax(drifts))
