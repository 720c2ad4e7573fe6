"""Motion of an identified frame: damping, prediction of responses, comparison with a record, reconstruction."""

from cvxshear.records.motion import DrivenRecord, DrivenRun
from cvxshear.response.compare import RecordComparison
from cvxshear.response.damping import DampedModel
from cvxshear.response.predicted import ModelResponse, Peaks, RecordPrediction, predict
from cvxshear.response.reconstruction import Reconstruction, reconstruct
from cvxshear.response.sources import Fitted, Models, models_of_loop
from cvxshear.response.state_space import Response, response
from cvxshear.response.uncertain import IdentifiedDamping, damping_of

__all__ = [
    "DampedModel",
    "DrivenRecord",
    "DrivenRun",
    "Fitted",
    "IdentifiedDamping",
    "ModelResponse",
    "Models",
    "Peaks",
    "Reconstruction",
    "RecordComparison",
    "RecordPrediction",
    "Response",
    "damping_of",
    "models_of_loop",
    "predict",
    "reconstruct",
    "response",
]  # fmt: skip
