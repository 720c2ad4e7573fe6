"""The result, from the parameters of the modes and their covariance."""

from collections.abc import Sequence

import numpy as np

from cvxshear.records.deviations import independent_std
from cvxshear.records.estimate import Details, Replication
from cvxshear.records.mode_shapes import collinearity, lost_phase, sign_changes
from cvxshear.records.picking import PoleCandidate
from cvxshear.records.record import Record
from cvxshear.records.result import ModalResult
from cvxshear.util.typing import Floats, Ints


def assembled(
    record: Record, setting: Replication, full: Details, covariance: Floats, *, method: str, uncertainty: str
) -> ModalResult:
    """Assemble the result, without findings.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    setting : Replication
    full : Details
        The modes of all the data.
    covariance : array, shape (k, k)
        Of `full.vector()`.
    method : str
    uncertainty : str
        How the covariance was got.

    Returns
    -------
    ModalResult
    """
    modes, floors = full.real.shape
    std = np.sqrt(np.diag(covariance))
    entries = _entry_jacobian(full, len(covariance))
    joint = np.vstack([np.eye(modes, len(covariance)), entries])
    of_entries = entries @ covariance @ entries.T
    blocks = [of_entries[r : r + floors, r : r + floors] for r in range(0, modes * floors, floors)]
    relative = np.sqrt(np.array([np.maximum(np.diag(block), 0.0) for block in blocks]))
    independent = np.array([independent_std(block, shape) for block, shape in zip(blocks, full.real, strict=True)])
    scale = np.ones(modes) if full.scales is None else full.scales
    # The remaining phases about the straight line are not scatter of the data. They add to the uncertainty of the
    # offset.
    left = np.radians(full.clocks.unexplained) / (2 * np.pi * np.sqrt(np.mean(full.frequencies**2)))
    offset_std = np.hypot(std[len(std) - len(left) :], left)
    names = [*(channel.name for channel in record.channels), "input"]
    return ModalResult(
        name=record.name,
        method=method,
        stories=record.stories,
        floors=record.floors,
        frequencies=full.frequencies,
        frequency_std=std[:modes],
        damping_ratios=full.damping_ratios,
        damping_std=std[modes : 2 * modes],
        mode_shapes=full.real * scale[:, None],
        mode_shape_std=relative,
        entry_std=np.hypot(independent, _scale_std(full, covariance)),
        mass_normalized=full.scales is not None,
        modes=_numbers(full.real, record, setting.sweep.chosen),
        complex_shapes=full.shapes,
        phase_collinearity=np.array([collinearity(shape) for shape in full.shapes]),
        lost_phase=np.array([lost_phase(shape) for shape in full.shapes]),
        clock_offsets={
            name: (float(value), float(error))
            for name, value, error in zip(names, full.clocks.seconds, offset_std, strict=False)
        },
        covariance=joint @ covariance @ joint.T,
        uncertainty=uncertainty,
        sweep=setting.sweep,
    )


def _entry_jacobian(full: Details, size: int) -> Floats:
    """Jacobian of the entries over each mode's largest, by the parameters: d(q psi) / q = d psi + psi dq / q."""
    modes, floors = full.real.shape
    start = 2 * modes
    result = np.zeros((modes * floors, size))
    result[:, start : start + modes * floors] = np.eye(modes * floors)
    if full.scales is not None:
        for r in range(modes):
            result[r * floors : (r + 1) * floors, start + modes * floors + r] = full.real[r] / full.scales[r]
    return result


def _scale_std(full: Details, covariance: Floats) -> Floats:
    """Independent errors on the entries that leave mass-normalized modes as uncertain in scale as they are.

    A mode's scale errs for all its n entries at once, and an error of the force for all m modes; a fit that
    takes entries for independent would average it away. Errors of n k var(q) psi_i^2 average to k var(q),
    with k = 1' cov(q) 1 / sum var(q), the common share of the errors of the modes. Shape (m, n), over each
    mode's largest entry.
    """
    modes, floors = full.real.shape
    if full.scales is None:
        return np.zeros((modes, floors))
    start = 2 * modes + modes * floors
    of_scales = covariance[start : start + modes, start : start + modes] / np.outer(full.scales, full.scales)
    together = max(1.0, float(of_scales.sum() / max(np.trace(of_scales), 1e-300)))
    return np.asarray(np.sqrt(floors * together * np.diag(of_scales))[:, None] * np.abs(full.real))


def _numbers(shapes: Floats, record: Record, chosen: Sequence[PoleCandidate]) -> Ints:
    """Which modes of the frame these are: as they were chosen or by changes of sign, where these tell; else from 1."""
    numbers = np.array([item.number for item in chosen], dtype=np.int64)
    if numbers.all():
        return numbers
    if shapes.shape[1] == record.stories > 1:
        changes = np.array([sign_changes(shape) for shape in shapes], dtype=np.int64)
        if np.all(np.diff(changes) > 0):
            return changes + 1
    return np.arange(1, len(shapes) + 1, dtype=np.int64)
