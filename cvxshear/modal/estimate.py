"""From the chosen poles to everything that is reported of a mode, on all the data or on a part of it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from cvxshear.modal.clock import Offsets, offsets, undone
from cvxshear.modal.frf import FixedSource
from cvxshear.modal.jackknife import jackknife, surrogate
from cvxshear.modal.picking import Sweep, Values, values_on
from cvxshear.modal.realization import DampedModes, Impulse, Source
from cvxshear.modal.residues import modal_products, modal_scale, participations, residues, unwrapped
from cvxshear.modal.runs import Complexes
from cvxshear.modal.shapes import main_axis, real_shape, signed_projection
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Floats, Ints

SURROGATES = 20
FEW_PIECES = 6
LAST_SAMPLE = 4000
"""Of an impulse response, for its residues; a longer one has decayed."""


@dataclass(frozen=True, eq=False)
class Replication:
    """What stays the same over the replicates of one identification.

    Parameters
    ----------
    source : Source
    sweep : Sweep
    floors : array of int, shape (n,)
    quantity : str
    shift : float
        Decay that an exponential window added, 1/s.
    rule : str
        For the real normal mode.
    base : bool
        Whether the input is a base acceleration.
    """

    source: Source
    sweep: Sweep
    floors: Ints
    quantity: str
    shift: float
    rule: str
    base: bool


@dataclass(frozen=True, eq=False)
class Details(DampedModes):
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


def details(setting: Replication, values: Values, keep: Bools | None, reference: Details | None = None) -> Details:
    """What the poles and shapes say, with the residues of the data kept."""
    products, driven = _products(setting, values, keep)
    turned = None if products is None else participations(products, values.shapes)
    clocks = offsets(
        values.eigenvalues,
        values.shapes,
        turned,
        None if reference is None else reference.clocks.reference,
        setting.source.sampling_rate,
    )
    straight = undone(values.eigenvalues, values.shapes, clocks.seconds)
    shapes = np.array([main_axis(shape) for shape in straight])
    # A projection is taken of what was recorded, offsets and all; its signs still are those of true clocks.
    real = np.array(
        [
            real_shape(shape) if setting.rule == "magnitude" else signed_projection(raw, shape)
            for raw, shape in zip(values.shapes, straight, strict=True)
        ]
    )
    places = np.argmax(np.abs(real if reference is None else reference.real), axis=1)
    real = real / real[np.arange(len(real)), places][:, None]
    scales = None
    if products is not None and not setting.base:
        found = [
            modal_scale(_turned_back(each, value, clocks), shape, setting.floors, driven)
            for each, value, shape in zip(products, values.eigenvalues, real, strict=True)
        ]
        known = [scale for scale in found if scale is not None]
        scales = np.array(known) if len(known) == len(found) else None
    return Details(values.eigenvalues + setting.shift, shapes, real, scales, clocks, products, driven)


def _turned_back(products: Complexes, eigenvalue: complex, clocks: Offsets) -> Complexes:
    """Products of one mode without the turns of the clocks of the channels and of the force."""
    late = clocks.seconds[: len(products)] - clocks.seconds[-1]
    return np.asarray(products * np.exp(1j * abs(eigenvalue.imag) * late)[:, None])


def _products(setting: Replication, values: Values, keep: Bools | None) -> tuple[Complexes | None, Ints]:
    impulse = setting.source.impulse(keep)
    if impulse is None or not (setting.base or np.all(impulse.driven > 0)):
        return None, np.zeros(0, dtype=np.int64)
    rate = setting.source.sampling_rate
    sequence = impulse.sequence[:LAST_SAMPLE]
    amplitudes = residues(sequence, values.eigenvalues, rate, impulse.start)
    if impulse.wrapped:
        amplitudes = unwrapped(amplitudes, values.eigenvalues, len(impulse.sequence) / rate)
    return modal_products(amplitudes, values.eigenvalues, rate, setting.quantity, base=setting.base), impulse.driven


def covariance(setting: Replication, full: Details, seed: int) -> tuple[Floats, str, int]:
    """Covariance of `full.vector()`, how it was got in words, and how many pieces had to be passed over."""
    groups = setting.source.groups

    def replicate(keep: Bools) -> Floats | None:
        values = values_on(setting.source, setting.sweep, keep)
        if values is None:
            return None
        part = details(setting, values, keep, full)
        if (part.scales is None) != (full.scales is None):
            return None
        return part.vector()

    if len(groups):
        result, lost = jackknife(replicate, groups)
        how = f"jackknife over {len(groups)} {setting.source.unit}s"
        if len(groups) < FEW_PIECES and setting.source.impulse() is not None:
            result, how = _widened(result, disturbed(setting, full, seed)), f"{how}, at least {SURROGATES} surrogates'"
        return result, how, lost
    return disturbed(setting, full, seed), f"{SURROGATES} surrogates of the residual", 0


def _widened(spread: Floats, other: Floats) -> Floats:
    """The covariance with every standard deviation raised to the other's where that is larger.

    The scatter of three pieces is small by chance often enough that it must not stand alone.
    """
    std, least = np.sqrt(np.diag(spread)), np.sqrt(np.diag(other))
    factor = np.where(std > 0, np.maximum(1.0, least / np.where(std > 0, std, 1.0)), 1.0)
    missing = np.where(std > 0, 0.0, least)
    return np.asarray(spread * np.outer(factor, factor) + np.diag(missing**2))


def disturbed(setting: Replication, full: Details, seed: int) -> Floats:
    """Covariance where nothing can be left out: the fit is disturbed by noise like its residual, and refitted.

    What the fit leaves of the impulse responses is taken for noise; its spectra are kept and its phases drawn
    anew, `SURROGATES` times (parametric bootstrap).
    """
    impulse = setting.source.impulse()
    if impulse is None:
        raise InputError("the record is too short to be cut into blocks")
    fit = _fit(impulse, full.eigenvalues - setting.shift, setting.source.sampling_rate)
    residual = impulse.sequence[impulse.start :] - fit
    random = np.random.default_rng(seed)
    replicates = []
    for _ in range(SURROGATES):
        noise = surrogate(residual.reshape(len(residual), -1), random).reshape(residual.shape)
        noisy = np.concatenate([impulse.sequence[: impulse.start], fit + noise])
        source = FixedSource(dataclasses.replace(impulse, sequence=noisy), setting.source.sampling_rate)
        values = values_on(source, setting.sweep, None)
        if values is not None:
            replicates.append(details(dataclasses.replace(setting, source=source), values, None, full))
    rows = [item.vector() for item in replicates if (item.scales is None) == (full.scales is None)]
    if len(rows) < SURROGATES // 2:
        raise InputError("the modes drown in the noise that the fit leaves; record longer, or more hits")
    return np.cov(np.array(rows), rowvar=False)


def _fit(impulse: Impulse, eigenvalues: Complexes, rate: float) -> Floats:
    """The chosen modes' part of the impulse responses, from their start on."""
    amplitudes = residues(impulse.sequence, eigenvalues, rate, impulse.start)
    powers = np.exp(np.outer(np.arange(impulse.start, len(impulse.sequence)), eigenvalues) / rate)
    return np.asarray(2 * np.real(np.einsum("kr,roi->koi", powers, amplitudes)))
