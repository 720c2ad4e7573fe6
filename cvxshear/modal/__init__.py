"""Records to modes: what was recorded, how modes are identified from it, and what it got wrong."""

from cvxshear.modal.adapters import from_arrays, from_pyoma, from_sdypy
from cvxshear.modal.agreement import second_opinion
from cvxshear.modal.identify import identify_modes
from cvxshear.modal.result import IdentifiedRecord, ModalResult, merged
from cvxshear.modal.stabilization import Criteria
from cvxshear.records.record import Channel, Finding, FrfRecord, FrfRun, Record, Run, TimeRecord

__all__ = [
    "Channel", "Criteria", "Finding", "FrfRecord", "FrfRun", "IdentifiedRecord", "ModalResult", "Record", "Run",
    "TimeRecord", "from_arrays", "from_pyoma", "from_sdypy", "identify_modes", "merged", "second_opinion",
]  # fmt: skip
