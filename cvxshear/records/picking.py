"""Which clusters are modes of the frame, and their values on all the data or on a part of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from operator import itemgetter

import numpy as np

from cvxshear.data.kinds import mac
from cvxshear.measurement.reading import fewest_changes, most_changes
from cvxshear.records import clocks, pole_sweep
from cvxshear.util import ranking
from cvxshear.util.typing import Bools, Complexes, Floats

#: How the reason of a candidate begins that is set aside as a mode of rotation.
MOSTLY_ROTATION = "mostly rotation"

#: Of the loudest resonance's energy: fainter ones may be of noise.
FAINT = 1e-3

#: Relative distance of two resonances with one shape that are one mode: a frequency that follows the amplitude splits
#: into two, and the third mode of a frame is half as high again as the second.
BESIDE = 0.1

#: Fraction of a shape's largest entry. Smaller entries can have either sign, because of noise or a sensor that is
#: askew.
UNSURE = 0.05

#: Relative; a pole picked by hand is looked for so far around the frequency given.
PICKABLE = 0.03


#: Rejected candidates by their members: the reason, and whether their frequency comes back.
Doubts = dict[tuple[tuple[int, int], ...], tuple[str, bool]]


@dataclasses.dataclass(frozen=True, eq=False)
class PoleCandidate:
    """A cluster of stable poles, judged.

    Parameters
    ----------
    members : tuple of (int, int)
        Places in the sweep that its values rest on.
    eigenvalue : complex
        1/s, as in the data: an exponential window's decay is still in it.
    shape : array of complex, shape (outputs,)
    persistence : float
        Share of the orders, from its first on, in which it is stable.
    energy : float
        Share of the data's energy.
    physical : bool
    reason : str
        Why not, where it is not.
    shaky : bool
        Whether that is because pieces of the record give it another shape, at nearly the same frequency.
    number : int
        Which mode of the frame it is, where its changes of sign tell; 0 else.
    """

    members: tuple[tuple[int, int], ...]
    eigenvalue: complex
    shape: Complexes
    persistence: float
    energy: float
    physical: bool = True
    reason: str = ""
    shaky: bool = False
    number: int = 0

    @property
    def frequency(self) -> float:
        """Hz."""
        return abs(self.eigenvalue) / (2 * np.pi)


@dataclasses.dataclass(frozen=True, eq=False)
class Values:
    """Eigenvalues and shapes of the chosen modes, from all the data or a part.

    Parameters
    ----------
    eigenvalues : array of complex, shape (modes,)
    shapes : array of complex, shape (modes, outputs)
    """

    eigenvalues: Complexes
    shapes: Complexes

    @staticmethod
    def of(items: Sequence[PoleCandidate]) -> Values:
        """Eigenvalues and shapes of candidates."""
        return Values(np.array([item.eigenvalue for item in items]), np.array([item.shape for item in items]))


@dataclasses.dataclass(frozen=True, eq=False)
class Sweep:
    """The order sweep of one record, with what was made of it.

    Parameters
    ----------
    poles : sequence of Poles
        One an order, ascending.
    stable : list of list of int
        For each order the indices of stable poles.
    candidates : tuple of PoleCandidate
        Ascending in frequency.
    chosen : tuple of PoleCandidate
        The frame's modes, ascending.
    """

    poles: list[pole_sweep.Poles]
    stable: list[list[int]]
    candidates: tuple[PoleCandidate, ...]
    chosen: tuple[PoleCandidate, ...]
    choose: ModeChoice

    def without(self, doubts: Doubts) -> Sweep:
        """Leave out candidates whose values scatter; modes are chosen and numbered anew among the others."""
        reasons = [doubts.get(item.members) for item in self.candidates]
        candidates = [
            item if why is None else dataclasses.replace(item, physical=False, reason=why[0], shaky=why[1])
            for item, why in zip(self.candidates, reasons, strict=True)
        ]
        return self.choose(self.poles, self.stable, candidates)


@dataclasses.dataclass(frozen=True)
class ModeChoice:
    """Which candidates are the frame's modes.

    Parameters
    ----------
    count : int
        Most modes to choose.
    by_signs : bool or None
        Whether every floor is measured. Mode r of a shear frame then has r - 1 changes of sign (its stiffness matrix is
        a Jacobi matrix: Gantmacher and Krein 1950), and otherwise that many at most. None, for floors that turn, takes
        the modes of most energy as 1, 2, ....
    picked : tuple of float
        Frequencies in Hz whose nearest stable poles are the modes, whatever else would choose them.
    """

    count: int
    by_signs: bool | None
    picked: tuple[float, ...] = ()

    def __call__(self, poles: list[pole_sweep.Poles], stable: list[list[int]], found: list[PoleCandidate]) -> Sweep:
        """Choose the modes among the candidates, which are ascending in frequency."""
        if self.picked:
            return Sweep(poles, stable, tuple(found), tuple(_by_hand(found, self.picked)), self)
        usable = [dataclasses.replace(item, number=0) for item in found if item.physical]
        if self.by_signs is None:
            loudest = sorted(usable, key=lambda item: -item.energy)[: self.count]
            chosen = sorted(loudest, key=lambda item: item.frequency)
        else:
            chosen = _numbered(usable, self.count, whole=self.by_signs)
        numbered = {item.members: item for item in chosen}
        found = [numbered.get(item.members, dataclasses.replace(item, number=0)) for item in found]
        return Sweep(poles, stable, tuple(found), tuple(chosen), self)


def sweep_orders(
    source: pole_sweep.Source,
    criteria: pole_sweep.Criteria,
    choose: ModeChoice,
    *,
    band: tuple[float, float] | None = None,
    shift: float = 0.0,
    turning: Callable[[float], float] | None = None,
) -> Sweep:
    """Sweep the orders, cluster the stable poles and choose the frame's modes.

    Parameters
    ----------
    source : Source
    criteria : Criteria
    choose : ModeChoice
    band : (float, float), optional
        Hz.
    shift : float, optional
        Decay that an exponential window added, 1/s.
    turning : callable, optional
        The share of rotation in the motion at a frequency, Hz; a mode with more than half is not a sway mode.

    Returns
    -------
    Sweep
    """
    factor = source.factor()
    poles = pole_sweep.realize(factor, source.outputs, source.sampling_rate, criteria.orders(choose.count))
    stable = pole_sweep.stable_poles(poles, source.sampling_rate, criteria, shift)
    found = []
    for cluster in pole_sweep.clusters(poles, stable, criteria):
        if len(cluster) < 2:
            continue
        members = pole_sweep.undivided(cluster, poles, criteria, shift)
        values = np.array([poles[i].eigenvalues[j] for i, j in members])
        value, shape = pole_sweep.center(values, np.array([poles[i].shapes[j] for i, j in members]))
        # Of the sweep's orders from the cluster's first on.
        share = len(cluster) / (len(poles) - cluster[0][0])
        found.append(PoleCandidate(tuple(members), value, shape, share, 0.0, *_lasting(cluster, share, criteria)))
    found.sort(key=lambda item: item.frequency)
    if band is not None:
        found = [item for item in found if band[0] <= item.frequency <= band[1]]
    found = _weighed(_distinct(found, criteria), source.data(), source.sampling_rate)
    return choose(poles, stable, _set_aside(found, criteria, turning))


def _lasting(cluster: pole_sweep.Cluster, share: float, criteria: pole_sweep.Criteria) -> tuple[bool, str]:
    if len(cluster) < criteria.least_orders:
        return False, f"stable in {len(cluster)} orders only"
    if share < criteria.least_persistence:
        return False, f"stable in {100 * share:.0f} % of the orders only"
    return True, ""


def _distinct(found: list[PoleCandidate], criteria: pole_sweep.Criteria) -> list[PoleCandidate]:
    """Of clusters with nearly one frequency and one shape the one that first appeared; lasting others named as such."""
    kept: list[PoleCandidate] = []
    for item in sorted(found, key=lambda item: (not item.physical, item.members[0][0])):
        twins = [
            other
            for other in kept
            if abs(item.frequency - other.frequency) < BESIDE * other.frequency
            and mac(item.shape, other.shape) > criteria.shape_agreement
        ]
        if twins and item.physical:
            alike = mac(item.shape, twins[0].shape)
            reason = f"a mode found twice: it has the shape of {twins[0].frequency:.4f} Hz, MAC {alike:.3f}"
            kept.append(dataclasses.replace(item, physical=False, reason=reason))
        elif not twins:
            kept.append(item)
    return sorted(kept, key=lambda item: item.frequency)


def _weighed(found: list[PoleCandidate], factor: Floats, sampling_rate: float) -> list[PoleCandidate]:
    lasting = [item for item in found if item.physical]
    shares = pole_sweep.energies(factor, [(item.eigenvalue, item.shape) for item in lasting], sampling_rate)
    energy = dict(zip(map(id, lasting), shares.tolist(), strict=True))
    return [dataclasses.replace(item, energy=energy.get(id(item), 0.0)) for item in found]


def _clocks(found: Sequence[PoleCandidate]) -> Floats | None:
    """Clock offsets of the channels, s, by the strong candidates; None with a single candidate.

    The straight line through the phases gives each mode the same weight. The phase of a pole of noise means nothing.
    """
    if sum(item.physical for item in found) < 2 or len(found[0].shape) < 2:
        return None
    loud = Values.of(_loud(found))
    return clocks.offsets(loud.eigenvalues, loud.shapes).seconds


def _loud(found: Sequence[PoleCandidate]) -> list[PoleCandidate]:
    """Select the physical candidates that are not faint."""
    usable = [item for item in found if item.physical]
    return [item for item in usable if item.energy > FAINT * max(other.energy for other in usable)]


def _set_aside(
    found: list[PoleCandidate], criteria: pole_sweep.Criteria, turning: Callable[[float], float] | None
) -> list[PoleCandidate]:
    """Set candidates aside that are no sway modes: of scattered phases, or mostly rotation.

    Phases that a clock offset explains are taken away first. Rotation is in the difference of sensors on one floor.
    """
    seconds, judged = _clocks(found), []
    for item in found:
        reason = ""
        if item.physical and seconds is not None:
            straight = clocks.undone(np.array([item.eigenvalue]), item.shape[None], seconds)[0]
            measure = max(collinearity(straight), collinearity(item.shape))
            if measure < criteria.least_collinearity:
                reason = f"modal phase collinearity {measure:.2f} only"
        share = 0.0 if turning is None else turning(item.frequency)
        if item.physical and not reason and share > 0.5:
            reason = (
                f"{MOSTLY_ROTATION}: {100 * share:.0f} % of the motion is in the difference of sensors on one floor"
            )
        judged.append(dataclasses.replace(item, physical=False, reason=reason) if reason else item)
    return judged


def _by_hand(found: list[PoleCandidate], picked: Sequence[float]) -> list[PoleCandidate]:
    """Find the nearest candidate to each frequency, each at most once and only within reach."""
    chosen: list[PoleCandidate] = []
    for frequency in sorted(picked):
        near = [
            item
            for item in found
            if abs(item.frequency - frequency) <= PICKABLE * frequency and not any(item is other for other in chosen)
        ]
        if near:
            chosen.append(min(near, key=lambda item: abs(item.frequency - frequency)))
    return sorted(chosen, key=lambda item: item.frequency)


#: A choice, after its rank: modes, those whose signs fit as they stand, the log of the product of their energies or
#: their sum, and how low the highest number is.
_Ranked = tuple[tuple[int, int, float, int], tuple[PoleCandidate, ...]]


def _numbered(usable: list[PoleCandidate], count: int, *, whole: bool) -> list[PoleCandidate]:
    """Choose and number candidates, ascending.

    At some of the floors mode r changes sign r - 1 times at most, at the whole of them just as often. A mode that the
    record does not hold is left out rather than replaced by one of the wrong shape. Entries near zero can have either
    sign. At the whole of the floors the most modes come first, then those whose signs fit as they stand, then the
    largest product of energies; at some of them the most energy comes first. The lowest numbers come last.
    """
    # best[w] is the best choice among the candidates so far for the numbers up to w, as (rank, numbered candidates).
    best: list[_Ranked] = [((0, 0, 0.0, 0), ())] * (count + 1)
    for item in usable:
        # Clocks that are right within half a sample turn no entry below half the sampling rate to the other side.
        shape = real_shape(item.shape)
        (fewest, most), changes = possible_changes(shape, UNSURE), sign_changes(shape)
        worth = float(np.log(max(item.energy, 1e-300))) if whole else item.energy
        for number in range(min(count, most + 1) if whole else count, fewest, -1):
            (modes, fits, worths, _), chosen = best[number - 1]
            rank = (modes + whole, fits + (whole and changes == number - 1), worths + worth, -number)
            if rank > best[number][0]:
                best[number] = rank, (*chosen, dataclasses.replace(item, number=number))
        for number in range(1, count + 1):
            best[number] = max(best[number], best[number - 1], key=itemgetter(0))
    return list(best[count][1])


def strongest(sweep: Sweep, count: int) -> tuple[Floats, Floats]:
    """Frequencies and real shapes of the lowest resonances that hold a part of the energy worth the name."""
    lowest = _loud(sweep.candidates)[:count]
    return np.array([item.frequency for item in lowest]), np.array([real_shape(item.shape) for item in lowest])


class Parts:
    """The poles of parts of the data, at the orders of a sweep, computed once for each part.

    Parameters
    ----------
    source : Source
    poles : sequence of Poles
        Of all the data, one an order.
    """

    def __init__(self, source: pole_sweep.Source, poles: Sequence[pole_sweep.Poles]) -> None:
        self.source, self._whole = source, poles
        self._found: dict[bytes, list[pole_sweep.Poles]] = {}

    def found_again(self, item: PoleCandidate, keep: Bools | None) -> tuple[complex, Complexes] | None:
        """Eigenvalue and shape of a candidate on a part of the data; None where it is not found there.

        The same orders are used as on all the data, in each the pole nearest to that order's.
        """
        key = b"" if keep is None else keep.tobytes()
        if key not in self._found:
            orders = [poles.order for poles in self._whole]
            factor = self.source.factor(keep)
            self._found[key] = pole_sweep.realize(factor, self.source.outputs, self.source.sampling_rate, orders)
        values, shapes = [], []
        for i, j in item.members:
            poles, whole = self._found[key][i], self._whole[i]
            k = pole_sweep.nearest(poles, complex(whole.eigenvalues[j]), whole.shapes[j])
            if k is not None:
                values.append(poles.eigenvalues[k])
                shapes.append(poles.shapes[k])
        return None if 2 * len(values) < len(item.members) else pole_sweep.center(np.array(values), np.array(shapes))

    def values(self, chosen: Sequence[PoleCandidate], keep: Bools | None) -> Values | None:
        """Find the chosen modes on a part of the data; None where one of them is not found there."""
        found = [self.found_again(item, keep) for item in chosen]
        known = [each for each in found if each is not None]
        if len(known) < len(found):
            return None
        return Values(np.array([value for value, _ in known]), np.array([shape for _, shape in known]))


def collinearity(shape: Complexes) -> float:
    """Modal phase collinearity (MPC): 1 where all entries lie on one line through the origin, 0 for a circle.

    ((Sxx - Syy)^2 + 4 Sxy^2) / (Sxx + Syy)^2 with S the second moments of real and imaginary parts
    (Pappa, Elliott and Schenk 1993).
    """
    x, y = shape.real, shape.imag
    sxx, syy, sxy = x @ x, y @ y, x @ y
    return float(((sxx - syy) ** 2 + 4 * sxy**2) / (sxx + syy) ** 2)


def main_axis(shape: Complexes) -> Complexes:
    """Turn a shape so that the sum of its squared imaginary parts is least; its largest entry is positive."""
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))
    largest = turned[ranking.first_largest(np.abs(turned))]
    return np.asarray(turned if largest.real > 0 else -turned)


def real_shape(shape: Complexes) -> Floats:
    """Find the real normal mode of a complex shape: moduli, with the sign of the real part on the main axis.

    A phase that a clock offset or damping put there costs a modulus nothing.

    Parameters
    ----------
    shape : array of complex, shape (n,)

    Returns
    -------
    array, shape (n,)
    """
    turned = main_axis(shape)
    return np.abs(turned) * np.where(turned.real < 0, -1.0, 1.0)


def lost_phase(shape: Complexes) -> float:
    """Angle off the main axis that a real shape leaves out, degrees, root mean square weighted by modulus squared."""
    return clocks.rms_phase(main_axis(shape))


def sign_changes(shape: Floats) -> int:
    """How often the shape changes sign from the ground up."""
    return fewest_changes(np.sign(shape))


def possible_changes(shape: Floats, tolerance: float) -> tuple[int, int]:
    """Fewest and most changes of sign, where entries below a part of the largest can have either sign.

    Over a distance of d floors between entries whose sign is sure there are d changes at most, and an odd number of
    them just where the signs differ.

    Parameters
    ----------
    shape : array, shape (n,)
    tolerance : float
        Of the largest entry.
    """
    signs = np.where(np.abs(shape) > tolerance * np.abs(shape).max(), np.sign(shape), 0.0)
    return fewest_changes(signs), most_changes(signs)


def scaled_to_one(shape: Floats) -> Floats:
    """Scale a shape to a largest entry of 1."""
    return np.asarray(shape / shape[ranking.first_largest(np.abs(shape))])
