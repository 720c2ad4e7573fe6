"""The sampling rate at which a record is looked at, where nobody declared a band.

A model's rows and lags span a fixed number of samples. Sampled far above its modes, a record shows them as
nearly straight lines over that span; so it is decimated until its highest mode is not lost in the lowest
tenth of the band, as long as no mode is lost by it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from cvxshear.modal.picking import Sweep
from cvxshear.modal.realization import Source
from cvxshear.modal.record import Record
from cvxshear.util.errors import InputError, NoSolutionError

FACTORS = (2, 4, 8, 16, 32, 64)
LOWEST_SHARE = 0.1
"""Of the sampling rate: a highest mode below it asks for a lower rate."""

Attempt = Callable[[Record], tuple[Source, Sweep]]


def settled(record: Record, wanted: int, attempt: Attempt, highest: float = 0.0) -> tuple[Source, Sweep]:
    """The source and sweep at the rate that suits the modes.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    wanted : int
        Number of modes that would be all.
    attempt : callable
        From a record to its source and sweep.
    highest : float, optional
        Hz that must stay in sight: the highest mode picked by hand.

    Returns
    -------
    source : Source
    sweep : Sweep
    """
    best = attempt(record)
    if record.band is not None or _suits(best, wanted):
        return best
    for factor in FACTORS:
        band = (0.0, record.sampling_rate / (2.5 * factor))
        if band[1] < highest:
            break
        try:
            trial = attempt(dataclasses.replace(record, band=band))
        except (InputError, NoSolutionError):
            # Too short to be decimated any further, or without a model then: what was found before stands.
            break
        if len(trial[1].chosen) < len(best[1].chosen):
            break
        if len(trial[1].chosen) > len(best[1].chosen) or _too_low(best):
            best = trial
        if _suits(best, wanted):
            break
    return best


def _suits(found: tuple[Source, Sweep], wanted: int) -> bool:
    return len(found[1].chosen) == wanted and not _too_low(found)


def _too_low(found: tuple[Source, Sweep]) -> bool:
    source, sweep = found
    return not sweep.chosen or sweep.chosen[-1].frequency < LOWEST_SHARE * source.sampling_rate
