"""From records to modes: records, modal identification, and mistakes in records."""

from cvxshear.records.identify import identify_modes
from cvxshear.records.pole_sweep import Criteria
from cvxshear.records.record import Channel, Finding, FrfRecord, FrfRun, Record, Run, TimeRecord
from cvxshear.records.result import IdentifiedRecord, ModalResult, from_arrays, merged

__all__ = [
    "Channel", "Criteria", "Finding", "FrfRecord", "FrfRun", "IdentifiedRecord", "ModalResult", "Record", "Run",
    "TimeRecord", "from_arrays", "identify_modes", "merged",
]  # fmt: skip
