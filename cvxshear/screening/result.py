"""Everything that looks wrong in a file, as one result."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from cvxshear.measurement.experiment import Experiment
from cvxshear.screening.finding import Finding
from cvxshear.screening.screen import screen
from cvxshear.util.showing import Shown
from cvxshear.util.typing import Json


class Remark(Protocol):
    """What a record's own diagnostics say, see `cvxshear.records.record`."""

    @property
    def kind(self) -> str:
        """What sort of thing is wrong."""

    @property
    def message(self) -> str:
        """What is wrong, with the numbers."""

    def to_dict(self) -> Json:
        """The remark as plain values."""


@dataclass(frozen=True, repr=False)
class Screening(Shown):
    """What `check` shows of a file.

    Parameters
    ----------
    name : str
        Of the experiment.
    accepted : tuple of str
        Findings that the file declares to be known and right.
    findings : tuple of Finding
        Mistakes first, then doubts.
    record : tuple of Remark
        What the records behind it say of themselves; empty for a measurement file.
    """

    name: str
    accepted: tuple[str, ...]
    findings: tuple[Finding, ...]
    record: tuple[Remark, ...] = ()

    @staticmethod
    def of(experiment: Experiment, record: Iterable[Remark] = ()) -> Screening:
        """What looks wrong in an experiment, and what was said of the records that it comes from."""
        return Screening(experiment.name, tuple(experiment.frame.accept), screen(experiment), tuple(record))

    @property
    def refused(self) -> bool:
        """Whether nothing is to be fitted before something is changed or accepted."""
        return any(item.refuses for item in self.findings)

    def to_dict(self) -> Json:
        """The documented JSON."""
        return {
            "name": self.name,
            "refused": self.refused,
            "findings": [item.to_dict() for item in self.findings],
            "record": [item.to_dict() for item in self.record],
        }
