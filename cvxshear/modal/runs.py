"""What a record is made of: channels, and runs, which are stretches of time or responses by frequency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cvxshear.measurement.experiment import MOST_STORIES
from cvxshear.util import checks
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Floats

Complexes = NDArray[np.complex128]


@dataclass(frozen=True)
class Channel:
    """One measured response: where the sensor sits and which way it points.

    Parameters
    ----------
    name : str
        The column or data set it was read from.
    floor : int
        0 the ground, 1 the first floor above it.
    axis : str, optional
        Direction of shaking, any name ("x").
    place : str, optional
        Where the channel was declared, for messages ('line 12 of record.toml'); the name where empty.
    unit : str, optional
        The unit in which the sensor was recorded ("g", "mm/s2"); the record's values have been converted from it.
    position : (float, float), optional
        Where the sensor sits on its floor, m: along the direction of test, and across it.
    direction : float, optional
        Degrees from the direction of test to the sensor's axis, counter-clockwise; 0 where not given.
    """

    name: str
    floor: int
    axis: str = "x"
    place: str = ""
    unit: str | None = None
    position: tuple[float, float] | None = None
    direction: float | None = None

    def __post_init__(self) -> None:
        checks.text(self.name, "channel: name")
        checks.whole(self.floor, f'channel "{self.name}": floor', least=0, most=MOST_STORIES)
        checks.text(self.axis, f'channel "{self.name}": axis')
        if self.unit is not None:
            checks.text(self.unit, f'channel "{self.name}": unit')
        if self.position is not None:
            x, y = checks.vector(self.position, f'channel "{self.name}": position (m, along and across)', length=2)
            object.__setattr__(self, "position", (float(x), float(y)))
        if self.direction is not None:
            degrees = checks.number(self.direction, f'channel "{self.name}": direction (degrees)')
            object.__setattr__(self, "direction", degrees)

    def __str__(self) -> str:
        spot = f"floor {self.floor}" if self.floor else "ground"
        return f'channel "{self.name}" ({spot}{", " + self.place if self.place else ""})'


@dataclass(frozen=True, eq=False)
class Run:
    """One uninterrupted stretch of time: a hit, a release, an earthquake, an hour of wind.

    Parameters
    ----------
    responses : array_like, shape (samples, channels)
        m/s2, m/s or m, one column a channel of the record.
    excitation : array_like, shape (samples,), optional
        N for a force, m/s2 for a base acceleration.
    floor : int, optional
        Where the force acts; 0 for a base acceleration or none.
    name : str, optional
    start, end : float, optional
        s; the part of the file that this run is. The arrays hold that part alone.
    """

    responses: Floats
    excitation: Floats | None = None
    floor: int = 0
    name: str = "run 1"
    start: float | None = None
    end: float | None = None

    def __post_init__(self) -> None:
        responses = _matrix(self.responses, f"{self.name}: responses", np.float64)
        object.__setattr__(self, "responses", responses)
        if self.excitation is not None:
            excitation = np.asarray(_matrix([self.excitation], f"{self.name}: excitation", np.float64)[0])
            if excitation.shape != (len(responses),):
                raise InputError(
                    f"{self.name}: excitation has {excitation.size} samples, the responses have {len(responses)}"
                )
            object.__setattr__(self, "excitation", checks.frozen(excitation))
        for key in ("start", "end"):
            if getattr(self, key) is not None:
                value = checks.number(getattr(self, key), f"{self.name}: {key} (s)")
                object.__setattr__(self, key, value)
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise InputError(f"{self.name}: end = {self.end:g} s must come after start = {self.start:g} s")

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.responses)


@dataclass(frozen=True, eq=False)
class FrfRun:
    """The responses to a unit force at one floor, by frequency.

    Parameters
    ----------
    responses : array_like of complex, shape (lines, channels)
        Response over force: accelerance (m/s2)/N, mobility (m/s)/N or receptance m/N.
    floor : int
        Where the force acts.
    name : str, optional
    """

    responses: Complexes
    floor: int
    name: str = "run 1"

    def __post_init__(self) -> None:
        object.__setattr__(self, "responses", _matrix(self.responses, f"{self.name}: responses", np.complex128))
        checks.whole(self.floor, f"{self.name}: input_floor", least=1, most=MOST_STORIES)


def _matrix(value: Any, where: str, dtype: type) -> Any:
    try:
        result: NDArray[Any] = np.array(value, dtype=dtype)
    except (TypeError, ValueError):
        raise InputError(f"{where} must be a table of numbers, samples by channels") from None
    if result.ndim != 2 or 0 in result.shape:
        raise InputError(f"{where} must be a table of samples by channels, not of shape {result.shape}")
    return checks.frozen(result)
