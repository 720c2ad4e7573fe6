"""Modes of a record."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from cvxshear.records import diagnostics, estimate, picking, placement, pole_sweep, prepare
from cvxshear.records.examination import Examined, examined
from cvxshear.records.record import Finding, FrfRecord, Record
from cvxshear.records.result import ModalResult
from cvxshear.util import checks, decorators, quantities
from cvxshear.util.errors import InputError, NoSolutionError

#: Kinds of findings that the whole band and the modes may both tell of a channel.
CLOCKS = ("clock offset", "clock drift")
#: Times the highest natural frequency: as far the functions of a record are kept.
FUNCTION_RANGE = 1.5


#: Fraction of the sampling rate. With a lower highest mode, the rate is reduced.
LOWEST_SHARE = 0.1


SourceAndSweep = tuple[pole_sweep.Source, picking.Sweep]


@dataclasses.dataclass(frozen=True, eq=False)
class ModeSearch:
    """What is looked for in a record, and how.

    Parameters
    ----------
    method : str
        "era", "subspace" or "ssi".
    blocks : int
        Pieces of a continuous record for the jackknife.
    criteria : Criteria
    picked : tuple of float
        Hz; the modes that are chosen by hand.
    turning : callable or None
        The share of rotation at a frequency, Hz.
    """

    method: str
    blocks: int
    criteria: pole_sweep.Criteria
    picked: tuple[float, ...]
    turning: Callable[[float], float] | None

    def wanted(self, record: Record) -> int:
        """How many modes would be all."""
        return len(self.picked) or record.most_modes

    def tried(self, record: Record) -> SourceAndSweep:
        """Bring a record into the method's form and sweep the orders."""
        source = prepare.source_of(record, self.method, blocks=self.blocks)
        by_signs = None if record.turns else len(record.channels) == record.stories > 1
        choose = picking.ModeChoice(self.wanted(record), by_signs, self.picked)
        return source, picking.sweep_orders(
            source, self.criteria, choose, band=record.band, shift=record.window_decay, turning=self.turning
        )

    def settled(self, record: Record) -> SourceAndSweep:
        """Find the sampling rate that suits the modes, and source and sweep at it."""
        best, factor = self.tried(record), 1
        while record.band is None and (len(best[1].chosen) < self.wanted(record) or _too_low(best)):
            factor *= 2
            band = (0.0, record.sampling_rate / (2.5 * factor))
            if band[1] < max(self.picked, default=0.0):
                break
            try:
                trial = self.tried(dataclasses.replace(record, band=band))
            except (InputError, NoSolutionError):
                # The record is too short for a lower rate, or has no model there: keep the earlier result.
                break
            if len(trial[1].chosen) < len(best[1].chosen):
                break
            if len(trial[1].chosen) > len(best[1].chosen) or _too_low(best):
                best = trial
        return best

    def repaired(self, record: Record) -> tuple[Record, SourceAndSweep, list[Finding]]:
        """Set channels right that the lowest modes show to be wrong; source and sweep of the record come second."""
        found = self.settled(record)
        frequencies, lowest = picking.strongest(found[1], 2)
        if record.turns or len(record.channels) < 2 or len(lowest) < 2:
            return record, found, []
        hypotheses = placement.weighed(frequencies, lowest, record.floors, record.stories)
        channels = record.channels
        if record.quantity != "acceleration":
            # Only accelerations have g: the values of another quantity are in its SI unit.
            unit = next(iter(quantities.IN_SI[record.quantity]))
            channels = tuple(dataclasses.replace(each, unit=each.unit or unit) for each in channels)
        findings = placement.findings_of(hypotheses, channels, lowest[0])
        if findings and findings[0].numbers["corrected"]:
            record = hypotheses[0].mended(record)
            found = self.settled(record)
        return record, found, findings

    def identified(self, record: Record, found: SourceAndSweep, findings: list[Finding]) -> ModalResult:
        """Values, deviations and findings of the modes that were chosen."""
        source, sweep = found
        if len(sweep.chosen) < len(self.picked):
            raise InputError(_out_of_reach(sweep, self.picked))
        parts = picking.Parts(source, sweep.poles)
        scattering = partial(estimate.scattering, parts, criteria=self.criteria)
        # Modes that were picked by hand stay; their standard deviations show their uncertainty.
        while len(source.groups) and not self.picked and (doubts := scattering(sweep.chosen)):
            sweep = sweep.without(doubts)
        while sweep.chosen:
            setting = estimate.Replication(record, parts, sweep)
            full = estimate.details(setting, picking.Values.of(sweep.chosen), None)
            spread, how, lost = estimate.covariance(setting, full)
            result = estimate.assembled(setting, full, spread, method=self.method, uncertainty=how)
            # Once clocks are right, which no frequency depends on, and by surrogates where nothing can be left out.
            stds = np.zeros(len(sweep.chosen)) if len(source.groups) else result.frequency_std
            each = zip(sweep.chosen, result.mode_shape_std.max(axis=1).tolist(), stds.tolist(), strict=True)
            doubts = {k: v for item in each for k, v in estimate.doubted(*item, self.criteria).items()}
            if self.picked or not doubts:
                break
            sweep = sweep.without(doubts)
        else:
            raise NoSolutionError(self.method, _nothing(sweep))
        if len(source.groups):
            # Report other stable poles only if every piece of the record has them: models of noise have stable poles as
            # well.
            others = diagnostics.left_out(sweep.candidates, sweep.chosen)
            sweep = sweep.without(scattering([item for item in others if item.physical]))
            setting = dataclasses.replace(setting, sweep=sweep)
        said = [
            *findings,
            *estimate.leakage_findings(setting, full),
            *diagnostics.modal_findings(result, setting, full, lost, self.turning),
        ]
        sizes = {"floors": len(record.channels), "stories": record.stories}
        left = diagnostics.left_out(sweep.candidates, sweep.chosen)
        if not record.turns:
            said += diagnostics.overlooked_modes(result.frequencies, result.modes, left, **sizes)
        return dataclasses.replace(result, findings=tuple(said), sweep=sweep)


def _too_low(found: SourceAndSweep) -> bool:
    source, sweep = found
    return not sweep.chosen or sweep.chosen[-1].frequency < LOWEST_SHARE * source.sampling_rate


@decorators.usual_arithmetic
def identify_modes(
    record: Record,
    *,
    method: str | None = None,
    blocks: int = prepare.BLOCKS,
    criteria: pole_sweep.Criteria | None = None,
    pick: Sequence[float] | None = None,
    functions: bool = False,
) -> ModalResult:
    """Identify the sway modes of a frame from a record.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    method : str, optional
        "era": eigensystem realization on impulse responses, from hits, frequency response functions or free decays.
        "subspace": instruments of the past, for measured continuous input. "ssi": covariance-driven, for ambient
        records. By default, the method that suits the input.
    blocks : int, optional
        Pieces of a continuous record for the jackknife.
    criteria : Criteria, optional
    pick : sequence of float, optional
        Frequencies in Hz, as read off a stabilization diagram: the nearest stable poles, within 3 %, are the modes.
    functions : bool, optional
        Whether the result keeps what the record shows over frequency, for figures.

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
    picked = () if pick is None else tuple(checks.vector(pick, "pick", above=0.0).tolist())
    if len(picked) > record.most_modes:
        raise InputError(
            f"pick names {len(picked)} modes; a frame of {record.stories} stories has no more than {record.most_modes}"
        )
    method = prepare.suited_methods(record)[0] if method is None else method
    checks.choice(method, prepare.MODAL_METHODS, "method")
    try:
        # The matrices are small: with all cores, threads wait for each other longer than they compute.
        with threadpool_limits(1):
            looked = examined(record)
            search = ModeSearch(method, blocks, criteria or pole_sweep.Criteria(), picked, looked.turning)
            try:
                while True:
                    repaired = search.repaired(looked.record)
                    result = search.identified(*repaired)
                    slow = [item for item in result.findings if item.kind == "low-pass"]
                    if not slow:
                        break
                    findings = (*looked.findings, slow[0])
                    looked = dataclasses.replace(
                        looked, record=prepare.without(looked.record, slow[:1]), findings=findings
                    )
            except NoSolutionError as error:
                raise NoSolutionError(error.backend, error.reason + _besides(looked)) from None
            except InputError as error:
                raise type(error)(str(error) + _besides(looked)) from None
            result = _about_unknown_centers(looked, _with_what_was_seen(looked, result))
            if not isinstance(looked.record, FrfRecord) and method != "era":
                result = dataclasses.replace(result, amplitude=looked.record.largest)
            if functions:
                result = dataclasses.replace(
                    result, functions=prepare.measured_functions(repaired[0], FUNCTION_RANGE * result.frequencies[-1])
                )
            return result
    except np.linalg.LinAlgError as error:
        # Records that no frame made, a channel twice or a constant, have no decomposition somewhere.
        reason = f"the record determines no model ({error}); is one channel a copy of another, or constant?"
        raise NoSolutionError(method, reason) from error


def _out_of_reach(sweep: picking.Sweep, picked: tuple[float, ...]) -> str:
    near = [item.frequency for item in sweep.chosen]
    missing = [f for f in picked if not any(abs(f - other) <= picking.PICKABLE * f for other in near)]
    named = ", ".join(f"{f:g}" for f in missing or picked)
    there = ", ".join(f"{item.frequency:.4g}" for item in sweep.candidates)
    reach = 100 * picking.PICKABLE
    return f"pick: no stable pole of its own within {reach:g} % of {named} Hz; there are {there or 'none'} Hz"


def _nothing(sweep: picking.Sweep) -> str:
    seen = [f"{item.frequency:.3g} Hz ({item.reason or 'not a sway mode'})" for item in sweep.candidates[:8]]
    return "no mode of the frame was found; " + (
        f"candidates: {', '.join(seen)}" if seen else "no pole is stable from order to order"
    )


def _about_unknown_centers(looked: Examined, result: ModalResult) -> ModalResult:
    """Widen the entries of floors whose center lies somewhere between their sensors."""
    unknown = {item.numbers["floor"] for item in looked.findings if item.numbers.get("placed") is False}
    if looked.turning is None or not unknown:
        return result
    shares = np.array([looked.turning(frequency) for frequency in result.frequencies.tolist()])
    # Half the sensors' difference over their mean; a center that may be anywhere between them is off by a uniform part.
    off = np.sqrt(shares / np.maximum(1.0 - shares, 1e-9) / 3.0)
    shapes = np.abs(result.mode_shapes) / np.abs(result.mode_shapes).max(axis=1, keepdims=True)
    std = off[:, None] * shapes * np.isin(result.floors, list(unknown))
    added = np.concatenate([np.zeros(len(result.modes)), std.ravel()])
    return dataclasses.replace(
        result,
        mode_shape_std=np.hypot(result.mode_shape_std, std),
        entry_std=np.hypot(result.entry_std, std),
        covariance=result.covariance + np.diag(added**2),
    )


def _besides(looked: Examined) -> str:
    """Say what the record gets wrong, for the message of a record without modes."""
    said = [f"{item.kind}: {item.message}" for item in looked.findings]
    return f". What the record gets wrong: {'; '.join(said)}" if said else ""


def _with_what_was_seen(looked: Examined, result: ModalResult) -> ModalResult:
    """Add what was found before; clocks that the whole band set right count together with what the modes leave."""
    offsets, told = dict(result.clock_offsets), set()
    for item in looked.findings:
        name = item.numbers.get("channel")
        if item.kind in CLOCKS and name in offsets:
            told.add(name)
            rest, std = offsets[name]
            offsets[name] = item.numbers["seconds"] + rest, std
    left = [item for item in result.findings if item.kind not in CLOCKS or item.numbers["channel"] not in told]
    return dataclasses.replace(result, findings=(*looked.findings, *left), clock_offsets=offsets)
