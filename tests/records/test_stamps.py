"""Test sampling rates from rounded time stamps: a constant rate is found, a missing sample is refused."""

import numpy as np
import pytest

from cvxshear.io.csv import Columns
from cvxshear.records.data_frames import sampling_rate_of
from cvxshear.util.errors import InputError


def rate(time, declared=None):
    return sampling_rate_of(time, Columns("log.csv", ("t",), time[:, None]), 'column "t"', declared)


def stamps(frequency, count, start=0.0, missing=None):
    time = start + np.arange(1, count + 1) / frequency
    return np.delete(time, missing) if missing is not None else time


@pytest.mark.parametrize("frequency", [51.2, 102.4, 128.0, 200.0, 256.0, 500.0, 512.0, 833.3, 1000.0, 1024.0])
@pytest.mark.parametrize("start", [0.0, 1234.5678])
@pytest.mark.parametrize("rounded", [np.round, np.floor])
def test_stamps_rounded_to_a_millisecond(frequency, start, rounded):
    time = rounded(stamps(frequency, 3000, start) * 1000 + 1e-9) / 1000
    assert rate(time) == pytest.approx(frequency, rel=2e-4)


@pytest.mark.parametrize("frequency", [100.0, 256.0, 512.0, 1000.0, 1024.0])
@pytest.mark.parametrize("declared", [False, True])
def test_a_missing_sample_is_refused(frequency, declared):
    time = np.round(stamps(frequency, 3000, missing=1400), 3)
    with pytest.raises(InputError, match=r"column .t. (has a gap|goes back|has two)"):
        rate(time, frequency if declared else None)


def test_stamps_may_be_coarser_than_the_samples():
    """With whole seconds the rate is as exact as a second over the length of the record."""
    for rounding, declared in ((1e-3, None), (1e-3, 4000.0), (1.0, None)):
        time = rounding * np.floor(stamps(400.0 / rounding**0.5, 60_000) / rounding)
        assert rate(time) == pytest.approx(400.0 / rounding**0.5, rel=2.0 * rounding / time[-1]), declared


@pytest.mark.parametrize("every", [40, 200])
def test_bursts_of_samples_are_no_rounded_stamps(every):
    time = np.arange(4000) / 250.0 + 100.0 * (np.arange(4000) // every)
    with pytest.raises(InputError, match="has a gap of 100"):
        rate(time)
