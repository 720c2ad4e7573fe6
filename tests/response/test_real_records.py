"""Both frames of the mini table: modes from one record, prediction of the other, before and after."""

import numpy as np
import pytest

from tests.modal.shared import needs_mini_table
from tests.response_records import predicted


@needs_mini_table
@pytest.mark.parametrize(("frame", "before", "after"), [("flexible", 0.17, 0.04), ("stiff", 0.58, 0.11)])
def test_the_earthquake_is_reproduced_by_the_model_with_joint_rotation(frame, before, after):
    """The record that the modes are from: root mean squares of the floors' accelerations."""
    found = predicted(f"{frame}-northridge", f"{frame}-northridge")
    assert np.max(np.abs(found.before.comparison.rms_ratio - 1)) == pytest.approx(before, abs=0.03)
    assert np.max(np.abs(found.after.comparison.rms_ratio - 1)) < after
    assert np.all(found.after.comparison.nrmse < 0.6)
    assert np.all(found.after.comparison.nrmse < found.before.comparison.nrmse)


@needs_mini_table
@pytest.mark.parametrize("frame", ["flexible", "stiff"])
@pytest.mark.parametrize(("source", "record"), [("northridge", "sine-2.0"), ("sine-2.0", "northridge")])
def test_transfer_functions_of_the_unseen_record(frame, source, record):
    """Around every mode the error falls to less than three quarters, and what is left is said to be the amplitude's."""
    found = predicted(f"{frame}-{source}", f"{frame}-{record}")
    before, after = (side.comparison.frf_error.mean(axis=0) for side in (found.before, found.after))
    assert after[0] < 0.75 * before[0]
    assert np.all(after < 1.0)
    first = found.after.comparison.shifts[0]
    assert first.mode == 1
    # The earthquake is the stronger of the two: its frequencies are the lower ones.
    assert (first.measured < first.modelled) == (record == "northridge")
    assert any("depend on the amplitude" in remark for remark in found.remarks)
