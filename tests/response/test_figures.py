"""Figures of a prediction can be read, and show what was predicted."""

import numpy as np
import pytest

import cvxshear
from cvxshear import backends
from cvxshear.fit.efficient import efficient
from cvxshear.records.motion import Drive, Motion
from cvxshear.report import figures
from cvxshear.response import DampedModel, Fitted, Models, predict, response
from cvxshear.util.errors import InputError
from tests.report.test_figures import assert_readable
from tests.response.common import damped_frame, declared, matrices, pole_ratios, shaking

DRAWN = [figures.response_histories, figures.response_peaks, figures.transfer_functions, figures.floor_spectra]


@pytest.fixture(scope="module", params=[2, 20])
def prediction(request):
    stories = request.param
    mass, stiffness, dashpots = damped_frame(stories)
    M, C, K = matrices(mass, stiffness, dashpots)
    experiment = cvxshear.Experiment.from_dict(declared(mass, stiffness, pole_ratios(M, C, K)))
    fitted = Fitted.of(efficient(experiment, backends.get("auto")))
    excitation = shaking(800)
    floors = np.arange(1, stories + 1)
    moved = response(DampedModel(M, C, K, np.ones(stories)), Drive(excitation), 0.01).acceleration
    return predict(Models(fitted, fitted), Motion((Drive(excitation, responses=moved),), 100.0, floors=floors))


@pytest.mark.parametrize("draw", DRAWN, ids=lambda draw: draw.__name__)
def test_figures_are_readable(prediction, draw):
    assert_readable(draw(prediction))


def test_figures_without_measured_floors(prediction):
    bare = Motion((Drive(prediction.motion.drives[0].excitation),), 100.0)
    found = predict(Models(None, prediction.after.fitted), bare)
    for draw in DRAWN:
        if draw is not figures.transfer_functions:
            assert_readable(draw(found))
    with pytest.raises(InputError, match="the record has no accelerations of floors"):
        figures.transfer_functions(found)


def test_peaks_are_drawn_where_they_are(prediction):
    axes = figures.response_peaks(prediction).axes[0]
    drawn = next(line for line in axes.lines if line.get_marker() == "s")
    np.testing.assert_allclose(drawn.get_xdata(), prediction.peaks.values["floor_acceleration"])
