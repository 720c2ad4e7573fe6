"""Compute frequencies, shapes, scales and deviations from the chosen poles, on all or part of the data."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.optimize import nnls

from cvxshear.measurement.configuration import Sensor
from cvxshear.measurement.repeats import student_factor
from cvxshear.records import frf, picking, pole_sweep
from cvxshear.records.clocks import Offsets, offsets, undone
from cvxshear.records.record import Finding, FrfRecord, Record, finding
from cvxshear.records.result import ModalResult
from cvxshear.util import ranking
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Complexes, Floats, Ints


def scattering(
    parts: picking.Parts, chosen: Sequence[picking.PoleCandidate], criteria: pole_sweep.Criteria
) -> picking.Doubts:
    """Modes that do not come back as themselves when a piece of the record is left out, by their members, and why.

    Poles that a model finds in noise are stable from order to order as well; their shapes are not from piece to piece.
    Each mode is judged separately, with its complex shape; other modes and clocks do not matter here.
    """
    doubts: picking.Doubts = {}
    for item in chosen:

        def replicate(keep: Bools, item: picking.PoleCandidate = item) -> Floats | None:
            found = parts.found_again(item, keep)
            if found is None:
                return None
            value, shape = found
            shape = shape * (np.vdot(item.shape, item.shape) / np.vdot(item.shape, shape))
            return np.concatenate([[np.log(abs(value))], shape.real, shape.imag])

        pieces = len(parts.source.groups)
        try:
            spread, _, lost = jackknife(replicate, parts.source.groups, parts.source.weights)
        except InputError:
            lost = pieces
        if 2 * lost > pieces:
            doubts[item.members] = f"without any of {lost} of {pieces} {parts.source.unit}s it is not found", False
            continue
        std = np.sqrt(np.diag(spread))
        of_shape = np.hypot(*np.split(std[1:], 2)).max() / np.abs(item.shape).max()
        doubts |= doubted(item, float(of_shape), float(std[0]), criteria)
    return doubts


def doubted(
    item: picking.PoleCandidate, of_shape: float, of_frequency: float, criteria: pole_sweep.Criteria
) -> picking.Doubts:
    """Doubt a mode if the standard deviation of its shape or its frequency is too large."""
    steady = of_frequency <= criteria.largest_frequency_std
    if of_shape <= criteria.largest_shape_std and steady:
        return {}
    scatter = f"shape scatters by {100 * of_shape:.0f} % and frequency by {100 * of_frequency:.1f} %"
    return {item.members: (f"{scatter} over the record's pieces", steady)}


#: Noisy copies of the fit: standard deviations from 20 of them are known to a sixth of themselves.
SURROGATES = 20
#: Pieces of a record: fewer pieces often underestimate the scatter (three pieces by half in one case of five).
FEW_PIECES = 6


@dataclasses.dataclass(frozen=True, eq=False)
class Replication:
    """Common data of the replicates of one identification.

    Parameters
    ----------
    record : TimeRecord or FrfRecord
    parts : Parts
        The source of the data and the poles of its parts.
    sweep : Sweep
    """

    record: Record
    parts: picking.Parts
    sweep: picking.Sweep

    @property
    def base(self) -> bool:
        """Whether the input is a base acceleration."""
        return not isinstance(self.record, FrfRecord) and self.record.input == "base"

    @property
    def driving_point(self) -> bool:
        """Whether the sensor of a floor shows the motion where the force acts."""
        return not (self.base or self.record.turns)

    @property
    def source(self) -> pole_sweep.Source:
        """The data."""
        return self.parts.source

    @property
    def loud(self) -> Bools:
        """Modes with enough energy to determine clocks by their phases, shape (m,)."""
        energy = np.array([item.energy for item in self.sweep.chosen])
        return np.asarray(energy > picking.FAINT * energy.max())

    def values(self, keep: Bools | None) -> picking.Values | None:
        """Find the chosen modes on a part of the data; None where one of them is not found there."""
        return self.parts.values(self.sweep.chosen, keep)


@dataclasses.dataclass(frozen=True, eq=False)
class Details(pole_sweep.DampedModes):
    """The modes of one set of data.

    Parameters
    ----------
    eigenvalues : array of complex, shape (m,)
        The structure's, 1/s; an exponential window's decay has been taken out.
    shapes : array of complex, shape (m, n)
        Clock offsets undone, main axis real.
    real : array, shape (m, n)
        Real normal modes, a largest entry of 1.
    scales : array, shape (m,), or None
        What mass-normalizes `real`.
    clocks : Offsets
    products : array of complex, shape (m, n, inputs), or None
    driven : array of int, shape (inputs,)
    """

    eigenvalues: Complexes
    shapes: Complexes
    real: Floats
    scales: Floats | None
    clocks: Offsets
    products: Complexes | None
    driven: Ints

    def vector(self) -> Floats:
        """All parameters in one row: log frequencies, damping, shapes, scales, clock offsets."""
        scales = np.zeros(0) if self.scales is None else self.scales
        return np.concatenate(
            [np.log(self.frequencies), self.damping_ratios, self.real.ravel(), scales, self.clocks.seconds]
        )


def details(
    setting: Replication, values: picking.Values, keep: Bools | None, reference: Details | None = None
) -> Details:
    """Find all parameters of the modes from poles, shapes and the residues of the data kept."""
    products, driven = _products(setting, values, keep)
    turned = None if products is None else frf.participations(products, values.shapes)
    right, rate = None if reference is None else reference.clocks.reference, setting.source.sampling_rate
    late = offsets(values.eigenvalues, values.shapes, turned, right, rate, setting.loud)
    if setting.record.turns:
        # Modes in x alone and in y alone link no clocks; the whole band has set them right before.
        none = 0.0 * late.seconds
        late = Offsets(none, none, late.reference)
    straight = undone(values.eigenvalues, values.shapes, late.seconds)
    shapes = np.array([picking.main_axis(shape) for shape in straight])
    real = np.array([picking.real_shape(shape) for shape in straight])
    places = ranking.largest(np.abs(real if reference is None else reference.real))
    real = real / real[np.arange(len(real)), places][:, None]
    scales = None
    if products is not None and setting.driving_point:
        # Without the turns of the clocks of the channels and of the force.
        turns = undone(values.eigenvalues, np.ones_like(shapes), late.seconds - late.seconds[-1])
        each = zip(products * turns[:, :, None], real, strict=True)
        found = [frf.modal_scale(product, shape, setting.record.floors, driven) for product, shape in each]
        known = [scale for scale in found if scale is not None]
        scales = np.array(known) if len(known) == len(found) else None
    return Details(values.eigenvalues + setting.record.window_decay, shapes, real, scales, late, products, driven)


def _products(setting: Replication, values: picking.Values, keep: Bools | None) -> tuple[Complexes | None, Ints]:
    found = setting.source.residues(values.eigenvalues, keep)
    if found is None:
        return None, np.zeros(0, dtype=np.int64)
    rate, quantity = setting.source.sampling_rate, setting.record.quantity
    return frf.modal_products(found[0], values.eigenvalues, rate, quantity, base=setting.base), found[1]


def covariance(setting: Replication, full: Details) -> tuple[Floats, str, int]:
    """Covariance of `full.vector()`, how it was got in words, and how many pieces had to be passed over."""
    groups = setting.source.groups

    def replicate(keep: Bools) -> Floats | None:
        values = setting.values(keep)
        if values is None:
            return None
        part = details(setting, values, keep, full)
        if (part.scales is None) != (full.scales is None):
            return None
        return part.vector()

    if len(groups):
        result, freedom, lost = jackknife(replicate, groups, setting.source.weights)
        how = f"jackknife over {len(groups)} {setting.source.unit}s"
        if len(groups) < FEW_PIECES and setting.source.impulse() is not None:
            result, how = _widened(result, disturbed(setting, full)), f"{how}, at least {SURROGATES} surrogates'"
        else:
            # The deviations are estimates from a few pieces; still, 95 % of the errors must lie within 1.96 deviations.
            factor = student_factor(freedom)
            result = result * np.outer(factor, factor)
        return result, how, lost
    return disturbed(setting, full), f"{SURROGATES} surrogates of the residual", 0


def _widened(spread: Floats, other: Floats) -> Floats:
    """Raise every standard deviation to the other covariance's where that is larger.

    The scatter of three pieces alone is unreliable: chance often makes it small.
    """
    std, least = np.sqrt(np.diag(spread)), np.sqrt(np.diag(other))
    factor = np.divide(np.maximum(std, least), std, out=np.ones_like(std), where=std > 0)
    return np.asarray(spread * np.outer(factor, factor))


def disturbed(setting: Replication, full: Details) -> Floats:
    """Covariance where nothing can be left out: the fit is disturbed by noise like its residual, and refitted.

    The residual of the impulse responses is taken for noise. Its spectra are kept and its phases are drawn at random,
    `SURROGATES` times (parametric bootstrap).
    """
    impulse = setting.source.impulse()
    assert impulse is not None, "a record without impulse responses has blocks"
    fit = _fit(impulse, full.eigenvalues - setting.record.window_decay, setting.source.sampling_rate)
    residual = impulse.sequence[impulse.start :] - fit
    random = np.random.default_rng(0)
    replicates = []
    for _ in range(SURROGATES):
        noise = surrogate(residual.reshape(len(residual), -1), random).reshape(residual.shape)
        noisy = np.concatenate([impulse.sequence[: impulse.start], fit + noise])
        source = frf.ImpulseSource(dataclasses.replace(impulse, sequence=noisy), setting.source.sampling_rate)
        other = dataclasses.replace(setting, parts=picking.Parts(source, setting.sweep.poles))
        values = other.values(None)
        if values is not None:
            replicates.append(details(other, values, None, full))
    rows = [item.vector() for item in replicates if (item.scales is None) == (full.scales is None)]
    if len(rows) < SURROGATES // 2:
        raise InputError("the modes drown in the noise that the fit leaves; record longer, or more hits")
    return np.cov(np.array(rows), rowvar=False)


def _fit(impulse: pole_sweep.Impulse, eigenvalues: Complexes, rate: float) -> Floats:
    """Return the chosen modes' part of the impulse responses, from their start on."""
    amplitudes = impulse.amplitudes(eigenvalues, rate)
    powers = np.exp(np.outer(np.arange(impulse.start, len(impulse.sequence)), eigenvalues) / rate)
    return np.asarray(2 * np.real(np.einsum("kr,roi->koi", powers, amplitudes)))


#: Share of a mode's impulse response that is left at the end of the window.
NOTICEABLE = 0.01


def leakage_findings(setting: Replication, full: Details) -> Iterator[Finding]:
    """Report responses of a table of functions that had not decayed at the end of the window."""
    record = setting.record
    if isinstance(record, FrfRecord):
        length = 1.0 / record.step
        left = np.abs(np.exp((full.eigenvalues - record.window_decay) * length))
        mode = ranking.first_largest(left) + 1
        if left.max() >= NOTICEABLE:
            numbers = {"mode": mode, "left": float(left.max()), "length": length, "truncated": record.truncated}
            kind = "those of responses cut off there" if record.truncated else "samples of the true functions"
            yield finding("leakage", numbers, kind=kind, other=str(not record.truncated).lower())


def assembled(setting: Replication, full: Details, covariance: Floats, *, method: str, uncertainty: str) -> ModalResult:
    """Assemble the result, without findings.

    Parameters
    ----------
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
    record, (modes, floors) = setting.record, full.real.shape
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
        phase_collinearity=np.array([picking.collinearity(shape) for shape in full.shapes]),
        lost_phase=np.array([picking.lost_phase(shape) for shape in full.shapes]),
        clock_offsets={
            name: (float(value), float(error))
            for name, value, error in zip(names, full.clocks.seconds, offset_std, strict=False)
        },
        covariance=joint @ covariance @ joint.T,
        uncertainty=uncertainty,
        sensors=_sensors(record),
        sweep=setting.sweep,
    )


def _sensors(record: Record) -> tuple[Sensor, ...]:
    """Places and directions of the channels, where the floors turn."""
    if not record.turns:
        return ()
    stands = [(each, np.array(each.position, dtype=np.float64)) for each in record.channels]
    return tuple(Sensor(each.floor, position, each.direction or 0.0) for each, position in stands)


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


def _numbers(shapes: Floats, record: Record, chosen: Sequence[picking.PoleCandidate]) -> Ints:
    """Which modes of the frame these are: as they were chosen or by changes of sign, where these tell; else from 1."""
    numbers = np.array([item.number for item in chosen], dtype=np.int64)
    if numbers.all():
        return numbers
    if shapes.shape[1] == record.stories > 1 and not record.turns:
        changes = np.array([picking.sign_changes(shape) for shape in shapes], dtype=np.int64)
        if np.all(np.diff(changes) > 0):
            return changes + 1
    return np.arange(1, len(shapes) + 1, dtype=np.int64)


#: Weight of equal variances, relative to the weight of the covariance.
DRAWN = 0.3


def independent_std(covariance: Floats, shape: Floats) -> Floats:
    """Independent errors on all entries that, the scale free, scatter a shape as a covariance says.

    An error along the shape itself is lost in the scale: with P the projector off the shape, P D P and
    P cov P have the same diagonal for the diagonal matrix D = diag(std^2) sought, a linear system with
    the squared entries of P. Solved for non-negative variances.

    Parameters
    ----------
    covariance : array, shape (n, n)
        In any scaling of the shape to a fixed length or entry.
    shape : array, shape (n,)

    Returns
    -------
    array, shape (n,)
    """
    off = np.eye(len(shape)) - np.outer(shape, shape) / (shape @ shape)
    seen = np.diag(off @ covariance @ off)
    typical = float(seen.sum()) / max(1, len(shape) - 1)
    if typical <= 0:
        return np.zeros(len(shape))
    # Drawn towards equal variances: the system is singular for two floors, and a covariance from a score of
    # pieces is no better known than that.
    rows = np.vstack([off**2, DRAWN * np.eye(len(shape))])
    variances = nnls(rows, np.concatenate([seen / typical, np.full(len(shape), DRAWN)]))[0] * typical
    return np.sqrt(np.maximum(variances, 0.1 * typical))


Estimate = Callable[[Bools], Floats | None]


def jackknife(estimate: Estimate, groups: Ints, weights: Floats) -> tuple[Floats, Floats, int]:
    """Find the covariance by leaving out one piece at a time.

    Pieces may tell more or less. With p_j the share of a piece's weight in its stratum, the sum of (1 - p_j) times the
    squares of what leaving it out changes is without bias where a piece's variance goes with 1 / p_j, and nearly so
    where it does not (HC2 of MacKinnon and White 1985, "Some heteroskedasticity-consistent covariance matrix
    estimators", J. Econometrics 29). For equal weights it is the usual jackknife.

    Parameters
    ----------
    estimate : callable
        From a mask of pieces to the parameters, shape (k,), or None where they are not found.
    groups : array of int, shape (pieces,)
        Stratum of each piece.
    weights : array, shape (pieces,)
        How much each piece tells.

    Returns
    -------
    covariance : array, shape (k, k)
    freedom : array, shape (k,)
        Degrees of freedom of each variance, its strata's together (Satterthwaite 1946), a stratum's from its weights
        (Bell and McCaffrey 2002).
    lost : int
        Pieces without which the parameters were not found; the other pieces replace them.

    Raises
    ------
    InputError
        Where fewer than two pieces of some stratum can be left out.
    """
    parts, freedoms, lost = [], [], 0
    for group in np.unique(groups):
        found, rest = [], []
        pieces = np.flatnonzero(groups == group)
        shares = weights[pieces] / weights[pieces].sum()
        for piece, share in zip(pieces, shares, strict=True):
            keep = np.ones(len(groups), dtype=bool)
            keep[piece] = False
            values = estimate(keep)
            if values is None:
                lost += 1
            else:
                found.append(values)
                rest.append(1 - share)
        if len(found) < 2:
            raise InputError(
                "the modes rest on single pieces of the record: left out one at a time, they are not found again in "
                "the rest; record longer, or more hits"
            )
        spread = (np.array(found) - np.average(found, axis=0, weights=rest)) * np.sqrt(rest)[:, None]
        parts.append(spread.T @ spread * len(pieces) / len(found))
        form = (shares**2 / (1 - shares))[:, None] * (np.diag(1 / shares) - 1)
        freedoms.append(np.trace(form) ** 2 / np.sum(form * form.T) * (len(found) - 1) / (len(pieces) - 1))
    variances, total = np.array([np.diag(part) for part in parts]), np.sum(parts, axis=0)
    squares = np.sum(variances**2 / np.array(freedoms)[:, None], axis=0)
    freedom = np.divide(np.diag(total) ** 2, squares, out=np.full(len(total), float(sum(freedoms))), where=squares > 0)
    return total, freedom, lost


def surrogate(residual: Floats, random: np.random.Generator) -> Floats:
    """Noise with the spectra and cross-spectra of a residual, shape (samples, channels), of random phase.

    One random phase a line, the same for all channels, keeps their coherence (Prichard and Theiler 1994).
    """
    spectrum = np.fft.rfft(residual, axis=0)
    phase = np.exp(2j * np.pi * random.random(len(spectrum)))
    phase[0] = 1.0
    if len(residual) % 2 == 0:
        phase[-1] = 1.0
    return np.fft.irfft(spectrum * phase[:, None], n=len(residual), axis=0)
