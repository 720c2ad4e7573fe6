"""Modes of a record."""

from __future__ import annotations

import dataclasses

import numpy as np

from cvxshear import checks
from cvxshear.errors import NoSolutionError
from cvxshear.modal import diagnostics
from cvxshear.modal.channels import channel_findings, without_dead
from cvxshear.modal.estimate import Details, Setting, covariance, details
from cvxshear.modal.leakage import settle_truncation
from cvxshear.modal.findings import Finding
from cvxshear.modal.picking import Sweep, Values, sweep_orders
from cvxshear.modal.prepare import BLOCKS, default_method, source_of
from cvxshear.modal.record import FrfRecord, Record
from cvxshear.modal.result import ModalResult, independent_std
from cvxshear.modal.shapes import RULES, collinearity, lost_phase
from cvxshear.modal.shift import shifted
from cvxshear.modal.stabilization import Criteria
from cvxshear.typing import Floats


def identify_modes(
    record: Record,
    *,
    method: str | None = None,
    estimator: str = "h1",
    blocks: int = BLOCKS,
    criteria: Criteria | None = None,
    count: int | None = None,
    rule: str = "magnitude",
    correct_clocks: bool = False,
    accept_swapped: bool = False,
    seed: int = 0,
) -> ModalResult:
    """Identify the sway modes of a frame from a record.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    method : str, optional
        "era": eigensystem realization on impulse responses, from hits, frequency response functions or free
        decays. "okid": the same on the Markov parameters of an observer, for measured continuous input.
        "subspace": PO-MOESP for the same. "ssi": covariance-driven, for ambient records. What suits the
        input where None.
    estimator : str, optional
        "h1" or "h2", for hits.
    blocks : int, optional
        Pieces of a continuous record for the jackknife.
    criteria : Criteria, optional
    count : int, optional
        Most modes; one a story where None.
    rule : str, optional
        Real normal mode: "magnitude" or "projection", see `cvxshear.modal.shapes.real_shape`.
    correct_clocks : bool, optional
        Shift the channels by their estimated clock offsets and identify again.
    accept_swapped : bool, optional
        Report channels that look swapped as a finding, not as an error.
    seed : int, optional
        For the surrogates of a record that cannot be cut into pieces.

    Returns
    -------
    ModalResult

    Raises
    ------
    InputError
        Where the record cannot be right, naming the channel.
    UnsuitableError
        Where the method cannot use the record's input.
    NoSolutionError
        Where no mode of the frame was found.
    """
    checks.choice(rule, RULES, "rule")
    criteria = criteria or Criteria()
    findings = channel_findings(record)
    record = without_dead(record, findings)
    method = method or default_method(record)
    source = source_of(record, method, estimator=estimator, blocks=blocks)
    shift = 0.0 if record.exponential_window is None else 1.0 / record.exponential_window
    wanted = record.stories if count is None else checks.whole(count, "count", least=1, most=record.stories)
    sweep = sweep_orders(
        source,
        criteria,
        count=wanted,
        by_signs=len(record.channels) == record.stories > 1,
        band=record.band,
        shift=shift,
    )
    if not sweep.chosen:
        raise NoSolutionError(method, _nothing(sweep))
    base = not isinstance(record, FrfRecord) and record.input == "base"
    setting = Setting(source, sweep, record.floors, record.quantity, shift, rule, base)
    findings += settle_truncation(record, setting, _chosen(sweep))
    full = details(setting, _chosen(sweep), None)
    spread, how, lost = covariance(setting, full, seed)
    result = _result(record, method, setting, full, spread, how)
    findings += diagnostics.modal_findings(record, result, setting, full, spread, lost, accept_swapped=accept_swapped)
    if correct_clocks and any(finding.kind == "clock offset" for finding in findings):
        return _corrected(record, result, findings, method, estimator, blocks, criteria, count, rule, seed)
    return dataclasses.replace(result, findings=tuple(findings))


def _chosen(sweep: Sweep) -> Values:
    return Values(
        np.array([item.eigenvalue for item in sweep.chosen]), np.array([item.shape for item in sweep.chosen])
    )


def _nothing(sweep: Sweep) -> str:
    seen = [f"{item.frequency:.3g} Hz ({item.reason or 'not a sway mode'})" for item in sweep.candidates[:8]]
    return "no mode of the frame was found; " + (
        f"candidates: {', '.join(seen)}" if seen else "no pole is stable from order to order"
    )


def _corrected(
    record: Record,
    first: ModalResult,
    findings: list[Finding],
    method: str,
    estimator: str,
    blocks: int,
    criteria: Criteria,
    count: int | None,
    rule: str,
    seed: int,
) -> ModalResult:
    """Identify again with the clocks set right; the offsets found the first time stay on record."""
    again = identify_modes(
        shifted(record, first.clock_offsets),
        method=method,
        estimator=estimator,
        blocks=blocks,
        criteria=criteria,
        count=count,
        rule=rule,
        seed=seed,
    )
    before = [
        dataclasses.replace(finding, message=finding.message + "; corrected")
        for finding in findings
        if finding.kind == "clock offset"
    ]
    others = [finding for finding in findings if finding.kind in diagnostics.OF_CHANNELS]
    rest = [finding for finding in again.findings if finding.kind not in diagnostics.OF_CHANNELS]
    return dataclasses.replace(again, findings=(*others, *before, *rest))


def _result(
    record: Record, method: str, setting: Setting, full: Details, spread: Floats, how: str
) -> ModalResult:
    modes, floors = full.real.shape
    std = np.sqrt(np.diag(spread))
    damping_std = std[modes : 2 * modes]
    shape_at = 2 * modes
    shapes, entry_covariance = _shapes(full, spread, shape_at)
    place = 2 * modes + modes * floors + (0 if full.scales is None else modes)
    names = [channel.name for channel in record.channels] + ["input"]
    offset_std = std[place:]
    largest = np.max(np.abs(full.real), axis=1)
    blocks = [entry_covariance[r * floors : (r + 1) * floors, r * floors : (r + 1) * floors] for r in range(modes)]
    normalized = full.scales is not None
    relative = np.sqrt(np.array([np.diag(block) for block in blocks]))
    independent = np.array(
        [independent_std(block, shape) for block, shape in zip(blocks, full.real, strict=True)]
    ) / largest[:, None]
    joint = _joint(full, spread, shape_at)
    return ModalResult(
        name=record.name,
        method=method,
        stories=record.stories,
        floors=record.floors,
        frequencies=full.frequencies,
        frequency_std=std[:modes],
        damping_ratios=full.damping_ratios,
        damping_std=damping_std,
        mode_shapes=shapes,
        mode_shape_std=relative,
        entry_std=np.maximum(relative, independent) if normalized else independent,
        mass_normalized=normalized,
        modes=_numbers(full.real, record),
        complex_shapes=full.shapes,
        phase_collinearity=np.array([collinearity(shape) for shape in full.shapes]),
        lost_phase=np.array([lost_phase(shape) for shape in full.shapes]),
        clock_offsets={
            name: (float(value), float(error))
            for name, value, error in zip(names, full.clocks.seconds, offset_std, strict=False)
        },
        covariance=joint,
        uncertainty=how,
        sweep=setting.sweep,
    )


def _numbers(shapes: Floats, record: Record) -> np.ndarray:  # type: ignore[type-arg]
    """Which modes of the frame these are: by sign changes where every floor is measured, else from 1 on."""
    from cvxshear.modal.shapes import sign_changes

    if shapes.shape[1] == record.stories > 1:
        return np.array([sign_changes(shape) + 1 for shape in shapes], dtype=np.int64)
    return np.arange(1, len(shapes) + 1, dtype=np.int64)


def _shapes(full: Details, spread: Floats, shape_at: int) -> tuple[Floats, Floats]:
    """Shapes as reported, and the covariance of their entries over each mode's largest."""
    transform = _transform(full, len(spread), shape_at)
    scale = np.ones(len(full.real)) if full.scales is None else full.scales
    return full.real * scale[:, None], transform @ spread @ transform.T


def _transform(full: Details, size: int, shape_at: int) -> Floats:
    """Jacobian of the entries over each mode's largest: d(q psi) / q = d psi + psi dq / q."""
    modes, floors = full.real.shape
    result = np.zeros((modes * floors, size))
    result[:, shape_at : shape_at + modes * floors] = np.eye(modes * floors)
    if full.scales is not None:
        for r in range(modes):
            rows = slice(r * floors, (r + 1) * floors)
            result[rows, shape_at + modes * floors + r] = full.real[r] / full.scales[r]
    return result


def _joint(full: Details, spread: Floats, shape_at: int) -> Floats:
    modes = len(full.real)
    transform = np.vstack([np.eye(modes, len(spread)), _transform(full, len(spread), shape_at)])
    return np.asarray(transform @ spread @ transform.T)
