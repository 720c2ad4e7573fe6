"""Records to modes: what was recorded, how modes are identified from it, and what it got wrong."""

from cvxshear.modal.adapters import from_arrays, from_pyoma, from_sdypy
from cvxshear.modal.findings import Finding
from cvxshear.modal.identify import identify_modes
from cvxshear.modal.record import FrfRecord, Record, TimeRecord
from cvxshear.modal.result import ModalResult
from cvxshear.modal.runs import Channel, FrfRun, Run
from cvxshear.modal.stabilization import Criteria

__all__ = [
    "Channel",
    "Criteria",
    "Finding",
    "FrfRecord",
    "FrfRun",
    "ModalResult",
    "Record",
    "Run",
    "TimeRecord",
    "from_arrays",
    "from_pyoma",
    "from_sdypy",
    "identify_modes",
]
