"""From an identified frame to how it moves: damping, prediction of responses, comparison with a record."""

from cvxshear.modal.motion import Drive, Motion
from cvxshear.response.batch import batch_peaks, sample_peaks
from cvxshear.response.compare import RecordComparison
from cvxshear.response.damping import IdentifiedDamping, damping_of
from cvxshear.response.fitted import Fitted, Models
from cvxshear.response.model import DampedModel, Response, response
from cvxshear.response.peaks import Peaks
from cvxshear.response.prediction import RecordPrediction, Side, predict, predict_many
from cvxshear.response.reconstruction import Reconstruction, reconstruct
from cvxshear.response.sources import models_of_loop
from cvxshear.response.spectra import FloorSpectra, floor_spectra

__all__ = [
    "DampedModel",
    "Drive",
    "Fitted",
    "FloorSpectra",
    "IdentifiedDamping",
    "Models",
    "Motion",
    "Peaks",
    "RecordComparison",
    "RecordPrediction",
    "Reconstruction",
    "Response",
    "Side",
    "batch_peaks",
    "damping_of",
    "floor_spectra",
    "models_of_loop",
    "predict",
    "predict_many",
    "reconstruct",
    "response",
    "sample_peaks",
]
