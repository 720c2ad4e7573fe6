"""Frequency response functions from hits, impulse responses from either, and windows taken out again.

H1 = S_yf / S_ff is free of the response's noise, H2 = S_yy / S_fy of the force's (Bendat and Piersol,
"Random Data", 4th ed., sec. 6.1), the spectra summed over the hits at one floor.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from cvxshear.records import pole_sweep
from cvxshear.records.record import FrfRecord, Run, TimeRecord
from cvxshear.util.errors import InputError
from cvxshear.util.typing import Bools, Complexes, Floats, Ints

#: How often each quantity is a displacement differentiated by time.
DERIVATIVES = {"displacement": 0, "velocity": 1, "acceleration": 2}


def modal_products(
    amplitudes: Complexes, eigenvalues: Complexes, sampling_rate: float, quantity: str, *, base: bool
) -> Complexes:
    """Turn amplitudes into shape times participation, shape (modes, outputs, inputs); real for real modes.

    The receptance residue of a mass-normalized real mode is phi_i phi_d / (2i w_d); a derivative multiplies
    it by the eigenvalue, a base acceleration's participation replaces -phi_d. The sampled sequence is 1/fs
    times the continuous one.
    """
    factor = 2j * np.abs(eigenvalues.imag) / eigenvalues ** DERIVATIVES[quantity]
    sign = -1.0 if base else 1.0
    return np.asarray(sign * amplitudes * (factor * sampling_rate)[:, None, None])


def participations(products: Complexes, shapes: Complexes) -> Complexes:
    """Find the complex number that turns each mode's shape into its products, strongest input, shape (modes,)."""
    columns = np.einsum("ri,rij->rj", np.conj(shapes), products) / np.sum(np.abs(shapes) ** 2, axis=1)[:, None]
    strongest = np.argmax(np.abs(columns), axis=1)
    return np.asarray(columns[np.arange(len(columns)), strongest])


def modal_scale(products: Complexes, shape: Floats, floors: Ints, driven: Ints) -> float | None:
    """Find the factor that mass-normalizes a real shape, 1/sqrt(kg).

    With phi = q psi, products = q^2 psi_i psi_d; q^2 by least squares over all responses and driving points.
    None where no driving point carries a sensor, or where the driving points say that q^2 is not positive.

    Parameters
    ----------
    products : array of complex, shape (outputs, inputs)
    shape : array, shape (outputs,)
        psi.
    floors, driven : array of int
        Floors of the outputs and of the inputs.
    """
    places = {int(floor): place for place, floor in enumerate(floors)}
    columns = [j for j, floor in enumerate(driven) if int(floor) in places]
    if not columns:
        return None
    model = np.outer(shape, [shape[places[int(driven[j])]] for j in columns])
    square = float(np.sum(model * products[:, columns].real) / np.sum(model**2))
    return float(np.sqrt(square)) if square > 0 else None


#: Block rows and columns of the Hankel matrix of impulse responses: twice the states of the largest model for a single
#: sensor, and at a tenth of the sampling rate, where the highest mode lies at least, sixty of its periods.
ERA_ROWS, ERA_COLUMNS = 60, 600
#: Samples at the start of an impulse response that its cut at half the sampling rate disturbs most.
SKIPPED = 3
#: Samples that a step or a blow, sampled behind a steep filter, rings before and after.
RINGING = 12
#: Of the largest force power: lines beyond the first weaker one say nothing of the frame.
WEAKEST_FORCE = 0.01
#: Of the largest force power, added to it where responses are divided by the amplitude of the blow: the noise stays
#: nearly white, and the pulse that the frame then answers to is over soon.
LEAST_FORCE = 0.1
#: Hits at a floor: with one of them left out there must be two to compare.
FEWEST_CROSSED = 3
#: Of a pulse's largest sample: below it the frame moves freely.
PULSE_OVER = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Spectra:
    """One run's contribution to the frequency response of its driving floor.

    Parameters
    ----------
    response_force : array of complex, shape (lines, channels)
        Conjugate force spectrum times response spectrum.
    force_force : array, shape (lines,)
    response_response : array, shape (lines, channels)
    floor : int
        Where the force acts.
    """

    response_force: Complexes
    force_force: Floats
    response_response: Floats
    floor: int

    @staticmethod
    def together(runs: Sequence[Spectra]) -> Spectra:
        """Sum the spectra of several runs."""
        return Spectra(
            np.sum([each.response_force for each in runs], axis=0),
            np.sum([each.force_force for each in runs], axis=0),
            np.sum([each.response_response for each in runs], axis=0),
            runs[0].floor,
        )


class FrfSource(pole_sweep.Source):
    """Responses to forces at one or several floors, for the eigensystem realization algorithm.

    The cross-spectra of response and force, summed over the hits at a floor, are divided by the root of the force's
    power, not by the power itself. They then belong to the responses to a symmetric pulse of the blows' own amplitude
    spectrum: white noise stays white in them, and once the pulse is over they are sums of decaying exponentials. An
    impulse response that ends where the hammer's spectrum or the record does is no such sum, which bends the highest
    modes. The same division makes a table of functions the responses to a unit pulse.

    With three or more hits at a floor, the poles come from the eigenvectors of the products H_a H_b' of different hits
    at it. The noise of two such Hankel matrices is independent. The product of a hit with itself has the noise's power
    in it, which bends weak modes by more than they scatter.

    Parameters
    ----------
    spectra : sequence of Spectra
        One a hit, or one a frequency response function of a table.
    sampling_rate : float
        Hz.
    samples : int
        Length of the transforms.
    recorded : int, optional
        Samples that were recorded of each response, where zeros make up the rest; all of them where not given.
    wrapped : bool, optional
        Whether the lines sample the response to all time: their inverse transform then folds what comes after
        its end back onto its start, which multiplies each residue by 1 / (1 - exp(eigenvalue * length)).

    Attributes
    ----------
    floors : array of int, shape (inputs,)
        The driving floors, ascending.
    """

    def __init__(
        self,
        spectra: Sequence[Spectra],
        sampling_rate: float,
        samples: int,
        recorded: int | None = None,
        *,
        wrapped: bool = False,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.samples = samples
        self.wrapped = wrapped
        self.spectra = list(spectra)
        self.outputs = spectra[0].response_force.shape[1]
        self.floors: Ints = np.unique([item.floor for item in spectra])
        counts = [sum(item.floor == floor for item in spectra) for floor in self.floors]
        if min(counts) >= 2:
            self.unit = "hit"
            self.groups = np.searchsorted(self.floors, [item.floor for item in spectra])
        elif len(spectra) == len(self.floors) >= 3:
            self.unit = "driving point"
            self.groups = np.zeros(len(spectra), dtype=np.int64)
        else:
            self.unit = "none"
            self.groups = np.zeros(0, dtype=np.int64)
        self._roots: dict[int, Floats] = {}
        for floor in self.floors.tolist():
            power = Spectra.together([item for item in spectra if item.floor == floor]).force_force
            self._roots[floor] = np.sqrt(power + LEAST_FORCE * power.max())
        self._stop = samples
        pulse = np.abs(self._answered(None)[1][: samples // 2 + 1])
        over = int(np.flatnonzero(pulse > PULSE_OVER * pulse.max(axis=0)[None, :])[-1]) // pulse.shape[1] + 1
        self._start = max(SKIPPED, over)
        # The end of a record is as near to what was not recorded as its start is to the blow.
        if recorded is not None:
            self._stop = recorded - self._start - RINGING
        if self._stop - self._start < ERA_ROWS:
            raise InputError("too few samples are left once the blow is over; record longer, or hit with a harder tip")
        self._own = None
        if min(counts) >= FEWEST_CROSSED:
            each = map(self._response, spectra)
            self._own = np.array([_product(markov_hankel(sequence[:, :, None], self._start)) for sequence in each])

    @property
    def weights(self) -> Floats:
        """Energy of each hit's force, shape (hits,), beside which its sensors' noise is always the same."""
        return np.array([item.force_force.sum() for item in self.spectra])

    def factor(self, keep: Bools | None = None) -> Floats:
        """Left factor of the responses' block Hankel matrix; of products of different hits where there are any.

        A floor at which a hit is left out counts as much as with all its hits: counted less, the noise of its hits
        would seem to matter less than it does in the whole.
        """
        used = np.ones(len(self.spectra), dtype=np.bool_) if keep is None else keep
        at = np.array([item.floor for item in self.spectra])
        impulse = self.impulse(keep)
        if self._own is None:
            shares = [
                self.weights[used & (at == floor)].sum() / self.weights[at == floor].sum() for floor in impulse.driven
            ]
            return pole_sweep.left_factor(markov_hankel(impulse.sequence / shares, self._start))
        total = np.zeros(self._own.shape[1:])
        for floor, sequence in zip(impulse.driven, np.moveaxis(impulse.sequence, 2, 0), strict=True):
            left = used & (at == floor)
            different = _product(markov_hankel(sequence[:, :, None], self._start)) - self._own[left].sum(axis=0)
            total += different * _pairs(self.weights[at == floor]) / _pairs(self.weights[left])
        values, vectors = linalg.eigh(total)
        positive = values > 0
        return np.asarray((vectors[:, positive] * np.sqrt(values[positive]))[:, ::-1])

    def impulse(self, keep: Bools | None = None) -> pole_sweep.Impulse:
        """Find the responses to pulses, of all hits or of some."""
        responses, pulses, floors = self._answered(keep)
        return pole_sweep.Impulse(responses, self._start, floors, self.wrapped, pulses[: self._start])

    def _answered(self, keep: Bools | None) -> tuple[Floats, Floats, Ints]:
        """Return the responses, the pulses that they answer to, and the floors where these act."""
        used = self.spectra if keep is None else [s for s, k in zip(self.spectra, keep, strict=True) if k]
        floors = np.unique([item.floor for item in used])
        hits = [Spectra.together([item for item in used if item.floor == floor]) for floor in floors]
        pulses = [np.fft.irfft(each.force_force / self._roots[each.floor], n=self.samples) for each in hits]
        return np.stack([self._response(each) for each in hits], axis=2), np.column_stack(pulses), floors

    def _response(self, hits: Spectra) -> Floats:
        """Return the response to the pulse that hits at one floor make together, shape (samples, outputs)."""
        cross = hits.response_force / self._roots[hits.floor][:, None]
        return np.fft.irfft(cross, n=self.samples, axis=0)[: self._stop]


def _product(hankel: Floats) -> Floats:
    return np.asarray(hankel @ hankel.T)


def _pairs(energies: Floats) -> float:
    """Sum of the products of the energies of different hits."""
    return float(energies.sum() ** 2 - np.sum(energies**2))


class ImpulseSource(pole_sweep.Source):
    """Impulse responses or free decays as they stand, for the eigensystem realization algorithm.

    Three or more columns, the decays from several releases, can be left out one at a time.

    Parameters
    ----------
    impulse : Impulse
    sampling_rate : float
        Hz.
    """

    def __init__(self, impulse: pole_sweep.Impulse, sampling_rate: float) -> None:
        self._impulse = impulse
        self.sampling_rate = sampling_rate
        _, self.outputs, columns = impulse.sequence.shape
        several = columns >= 3
        self.unit = "release" if several else "none"
        self.groups = np.zeros(columns if several else 0, dtype=np.int64)

    def factor(self, keep: Bools | None = None) -> Floats:
        """Left factor of the block Hankel matrix."""
        impulse = self.impulse(keep)
        return pole_sweep.left_factor(markov_hankel(impulse.sequence, impulse.start))

    def impulse(self, keep: Bools | None = None) -> pole_sweep.Impulse:
        """Return the impulse responses, or the decays kept."""
        whole = self._impulse
        if keep is None:
            return whole
        return dataclasses.replace(whole, sequence=whole.sequence[:, :, keep], driven=whole.driven[keep])


def markov_hankel(sequence: Floats, start: int) -> Floats:
    """Arrange an impulse response or a decay that starts at sample `start` as a block Hankel matrix."""
    rows = min(ERA_ROWS, (len(sequence) - start) // 3)
    columns = min(ERA_COLUMNS, len(sequence) - start - rows)
    return pole_sweep.block_hankel(sequence, rows, columns, start)


def table_spectra(record: FrfRecord, highest: float = np.inf) -> tuple[list[Spectra], int]:
    """Read a table of functions up to a frequency, Hz, as spectra under a unit force from 0 Hz on.

    The number of samples that their inverse transforms have comes second.
    """
    missing = round(float(record.frequencies[0]) / record.step)
    result = []
    for run in record.runs:
        # The table has no data below its first line; rigid-body motion of a fixed frame is zero there.
        padding = np.zeros((missing, run.responses.shape[1]))
        response = np.vstack([padding, run.responses])
        response = response[: int(np.ceil(min(highest / record.step, len(response) - 1))) + 1]
        result.append(Spectra(response, np.ones(len(response)), np.abs(response) ** 2, run.floor))
    return result, 2 * (len(result[0].force_force) - 1)


def hit_spectra(record: TimeRecord) -> tuple[list[Spectra], int]:
    """Transform every hit from just before the hammer meets the frame, as many zeros behind it as it has samples.

    Products of such spectra are correlations that do not fold their end onto their start. The length of the transforms,
    twice the shortest hit, comes second.
    """
    starts = [hit_start(run) for run in record.runs]
    samples = min(run.samples - start for run, start in zip(record.runs, starts, strict=True))
    if samples < ERA_ROWS:
        raise InputError(f"a hit leaves only {samples} samples after the blow; record longer or trigger earlier")
    result = []
    for run, start in zip(record.runs, starts, strict=True):
        assert run.excitation is not None
        force = np.fft.rfft(_quiet_after_blow(run.excitation)[start : start + samples], 2 * samples)
        response = np.fft.rfft(run.responses[start : start + samples], 2 * samples, axis=0)
        result.append(Spectra(np.conj(force)[:, None] * response, np.abs(force) ** 2, np.abs(response) ** 2, run.floor))
    return result, 2 * samples


def reach(record: TimeRecord) -> float:
    """Find the first frequency, Hz, without energy of the blows, or half the sampling rate."""
    spectra, samples = hit_spectra(record)
    power = Spectra.together(spectra).force_force
    weak = np.flatnonzero(power < WEAKEST_FORCE * power.max())
    weak = weak[weak > np.argmax(power)]
    return float(weak[0] if weak.size else len(power) - 1) * record.sampling_rate / samples


def hit_start(run: Run) -> int:
    """Find the sample from which the blow is seen, with the ringing of the sampler's filter ahead of it."""
    assert run.excitation is not None
    force = np.abs(run.excitation)
    loud = np.flatnonzero(force[: np.argmax(force) + 1] >= 0.02 * force.max())
    together = np.split(loud, np.flatnonzero(np.diff(loud) > 3) + 1)
    return max(0, int(together[-1][0]) - RINGING)


def _quiet_after_blow(force: Floats) -> Floats:
    """Set the noise of the force's sensor to zero once the hammer has left the frame.

    The usual force window: outside the blow the force is nought, and what the sensor shows is noise.
    """
    first, last = np.flatnonzero(np.abs(force) >= 0.25 * np.max(np.abs(force)))[[0, -1]].tolist()
    margin = max(RINGING, 3 * (last - first + 1))
    window = np.zeros(len(force))
    window[max(0, first - margin) : last + margin + 1] = 1.0
    return force * window
