"""From records to modes: records, modal identification, and mistakes in records."""

from cvxshear.records.adapters import from_arrays, from_pyoma, from_sdypy, second_opinion
from cvxshear.records.identify import identify_modes
from cvxshear.records.pole_sweep import Criteria
from cvxshear.records.record import Channel, Finding, FrfRecord, FrfRun, Record, Run, TimeRecord
from cvxshear.records.result import IdentifiedRecord, ModalResult, merged

__all__ = [
    "Channel", "Criteria", "Finding", "FrfRecord", "FrfRun", "IdentifiedRecord", "ModalResult", "Record", "Run",
    "TimeRecord", "from_arrays", "from_pyoma", "from_sdypy", "identify_modes", "merged", "second_opinion",
]  # fmt: skip
