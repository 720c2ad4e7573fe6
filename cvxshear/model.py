"""The forward model: mass and stiffness matrices of the shear frame, its modes, and their derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy import linalg

from cvxshear.motions import ONE_MOTION, Motions, slopes, unit_derivatives
from cvxshear.util import decorators, errors, ranking
from cvxshear.util.typing import Floats, Ints

#: Minimum number of stories for the tridiagonal eigensolver, which is slower for smaller frames.
TALL = 40


@lru_cache(maxsize=8)
def transformation(stories: int) -> Floats:
    """T of Eq. 19, shape (N, N), read-only: T' u are the story drifts, floor less floor below."""
    T = np.eye(stories) - np.eye(stories, k=1)
    T.setflags(write=False)
    return T


def mass_matrix(floor_mass: Floats) -> Floats:
    """M = diag(m) of Eq. 1, shape (N, N), kg."""
    return np.diag(floor_mass)


def stiffness_matrix(story_stiffness: Floats) -> Floats:
    """K = T diag(k) T' of Eq. 18, shape (N, N), N/m: symmetric and tridiagonal."""
    n, above = len(story_stiffness), story_stiffness[1:]
    K = np.zeros((n, n))
    K.flat[:: n + 1] = story_stiffness
    K.flat[: n * (n - 1) : n + 1] += above
    K.flat[1 :: n + 1] = K.flat[n :: n + 1] = -above
    return K


@dataclass(frozen=True, eq=False)
class System:
    """Mass and stiffness matrices, and their derivatives with respect to P parameters.

    Parameters
    ----------
    M, K : ndarray, shape (N, N)
        kg and N/m.
    dM, dK : ndarray, shape (P, N, N)
        dM/dtheta_p and dK/dtheta_p, a row a parameter.
    """

    M: Floats
    K: Floats
    dM: Floats
    dK: Floats

    def by(self, which: slice) -> System:
        """Keep the derivatives by some of the parameters."""
        return System(self.M, self.K, self.dM[which], self.dK[which])

    def modal_products(self, phi: Floats, phi_j: Floats) -> tuple[Floats, Floats]:
        """phi' dK phi_j and phi' dM phi_j by every parameter, each of shape (P, N, m).

        Parameters
        ----------
        phi, phi_j : ndarray, shapes (N, N) and (N, m)
            One column a mode.
        """
        return phi.T @ (self.dK @ phi_j), phi.T @ (self.dM @ phi_j)

    def stiffness_slopes(self, u: Floats) -> Floats:
        """dK u by every parameter, shape (P, N)."""
        return np.asarray(self.dK @ u)

    def plus(self, name: str, values: Floats, units: Floats, own: slice) -> SummedSystem:
        """Add the sum of values_i units_i to M or K, see `Term`; the values are parameters."""
        matrices, n = {"M": self.M, "K": self.K}, units.shape[-1]
        matrices[name] = matrices[name].copy()
        matrices[name][:n, :n] += np.tensordot(values, units, 1)
        before, terms = (self.before, self.terms) if isinstance(self, SummedSystem) else (self, ())
        return SummedSystem(**matrices, before=before, terms=(*terms, Term(name, units, own)))

    def arrays(self) -> Iterator[tuple[str, Floats]]:
        """Yield the numbers that the system holds, each with the name of its matrix or derivative."""
        yield from (("M", self.M), ("K", self.K), ("dM", self.dM), ("dK", self.dK))


class FrameSystem(System):
    """A frame without effects, with derivatives of low rank.

    In the shear frame dM/dm_i = e_i e_i' and dK/dk_i = t_i t_i', t_i column i of T. Products use these vectors instead
    of matrices, which would need 128 GB for 2,000 stories.

    Parameters
    ----------
    motions : Motions
    M, K : ndarray, shape (N d, N d)
    size : int
        Number P of parameters: those of the floors, those of the stories, and others without influence on M and K.
    which : slice, optional
        Parameters of the requested derivatives.
    """

    def __init__(self, motions: Motions, M: Floats, K: Floats, size: int, which: slice = slice(None)) -> None:
        self.__dict__.update(M=M, K=K, _motions=motions, _size=size, _which=which)

    _motions: Motions
    _size: int
    _which: slice

    @property
    def dM(self) -> Floats:  # noqa: N802 - a field there; here made when asked for
        """As of `System`."""
        return self._padded(unit_derivatives(self._motions, len(self.M) // self._motions.count)[0])

    @property
    def dK(self) -> Floats:  # noqa: N802 - likewise
        """As of `System`."""
        return self._padded(unit_derivatives(self._motions, len(self.M) // self._motions.count)[1])

    def by(self, which: slice) -> System:
        return FrameSystem(self._motions, self.M, self.K, self._size, which)

    def arrays(self) -> Iterator[tuple[str, Floats]]:
        yield from (("M", self.M), ("K", self.K))

    def modal_products(self, phi: Floats, phi_j: Floats) -> tuple[Floats, Floats]:
        motions = self._motions
        own_mass = slopes(phi, phi_j, motions.mass_basis)
        own_stiffness = slopes(motions.relative(phi), motions.relative(phi_j), motions.stiffness_basis)
        by_stiffness = np.concatenate([np.zeros_like(own_mass), own_stiffness])
        by_mass = np.concatenate([own_mass, np.zeros_like(own_stiffness)])
        return self._padded(by_stiffness), self._padded(by_mass)

    def stiffness_slopes(self, u: Floats) -> Floats:
        # Static tests are of frames with one motion per floor.
        T = transformation(len(self.M))
        return self._padded(np.concatenate([np.zeros(T.shape), (T * (T.T @ u)).T]))

    def _padded(self, rows: Floats) -> Floats:
        """Spread the rows of masses and stiffnesses to all parameters that are wanted, zero for the others."""
        extra = self._size - len(rows)
        if extra:
            rows = np.concatenate([rows, np.zeros((extra, *rows.shape[1:]))])
        return rows[self._which]


@dataclass(frozen=True, eq=False)
class Term:
    """Constant matrices times parameters as a part of M or K.

    Parameters
    ----------
    name : str
        "M" or "K".
    units : ndarray, shape (p, n, n)
        Matrices for the first n motions: the derivatives by the parameters.
    own : slice
        Places of the parameters.
    """

    name: str
    units: Floats
    own: slice

    def by(self, which: slice) -> Term:
        """Keep the parameters among those of a slice without steps."""
        wanted = range(self.own.stop)[which]
        first, last = max(wanted.start, self.own.start), max(wanted.stop, self.own.start)
        units = self.units[first - self.own.start : last - self.own.start]
        return Term(self.name, units, slice(first - wanted.start, last - wanted.start))


class SummedSystem(System):
    """A system with terms added: whole derivatives, which each term would copy, are made when they are asked for.

    Parameters
    ----------
    M, K : ndarray, shape (N, N)
        With the terms.
    before : System
        Without them.
    terms : tuple of Term
    """

    def __init__(self, M: Floats, K: Floats, before: System, terms: tuple[Term, ...]) -> None:
        self.__dict__.update(M=M, K=K, before=before, terms=terms)

    before: System
    terms: tuple[Term, ...]

    @decorators.cached_property
    def dM(self) -> Floats:  # noqa: N802 - a field there; here made when asked for
        """As of `System`."""
        return self._plus_terms("M", self.before.dM.copy())

    @decorators.cached_property
    def dK(self) -> Floats:  # noqa: N802 - likewise
        """As of `System`."""
        return self._plus_terms("K", self.before.dK.copy())

    def _plus_terms(self, name: str, slopes: Floats) -> Floats:
        for term in self.terms:
            if term.name == name:
                n = term.units.shape[-1]
                slopes[term.own, :n, :n] += term.units
        return slopes

    def by(self, which: slice) -> System:
        return SummedSystem(self.M, self.K, self.before.by(which), tuple(each.by(which) for each in self.terms))

    def modal_products(self, phi: Floats, phi_j: Floats) -> tuple[Floats, Floats]:
        by_stiffness, by_mass = self.before.modal_products(phi, phi_j)
        for term in self.terms:
            n = term.units.shape[-1]
            (by_mass if term.name == "M" else by_stiffness)[term.own] += phi[:n].T @ (term.units @ phi_j[:n])
        return by_stiffness, by_mass

    def stiffness_slopes(self, u: Floats) -> Floats:
        slopes = self.before.stiffness_slopes(u)
        for term in self.terms:
            n = term.units.shape[-1]
            if term.name == "K":
                slopes[term.own, :n] += term.units @ u[:n]
        return slopes

    def arrays(self) -> Iterator[tuple[str, Floats]]:
        yield from (("M", self.M), ("K", self.K), *((f"d{term.name}", term.units) for term in self.terms))
        yield from (each for each in self.before.arrays() if each[0] in ("dM", "dK"))


def shear_system(floor_mass: Floats, story_stiffness: Floats) -> System:
    """Assemble the shear frame, with derivatives by every floor mass and then every story stiffness (P = 2N)."""
    return FrameSystem(ONE_MOTION, mass_matrix(floor_mass), stiffness_matrix(story_stiffness), 2 * len(floor_mass))


@dataclass(frozen=True, eq=False)
class Modes:
    """Undamped modes of a frame, all N of them, ascending.

    Parameters
    ----------
    eigenvalues : ndarray, shape (N,)
        lambda = omega^2, (rad/s)^2.
    shapes : ndarray, shape (N, N)
        One row a mode, mass-normalized: shapes M shapes' = 1.
    """

    eigenvalues: Floats
    shapes: Floats

    @property
    def frequencies(self) -> Floats:
        """Natural frequencies, shape (N,), Hz."""
        return np.sqrt(self.eigenvalues) / (2 * np.pi)


def modes(M: Floats, K: Floats) -> Modes:
    """Solve K phi = lambda M phi.

    Parameters
    ----------
    M, K : ndarray, shape (N, N)
        Symmetric; M positive definite.

    Returns
    -------
    Modes
        Each shape has its largest entry positive.

    Raises
    ------
    NoModesError
        Where M is not positive definite, or K has a negative eigenvalue: the frame would buckle.
    """
    try:
        eigenvalues, vectors = _chain_modes(M, K) if _is_chain(M, K) else _all_modes(M, K)
    except (linalg.LinAlgError, ValueError):
        raise errors.NoModesError("the mass matrix is not positive definite") from None
    if not eigenvalues[0] > 0:
        raise errors.NoModesError(f"the frame is not stable: the lowest eigenvalue is {eigenvalues[0]:g} (rad/s)^2")
    shapes = vectors.T
    largest = shapes[np.arange(len(shapes)), ranking.largest(np.abs(shapes))]
    return Modes(eigenvalues, shapes * np.sign(largest)[:, None])


def attached_share(found: Modes, M: Floats, floors: int) -> Floats:
    """Part of each mode's kinetic energy that is in masses attached to the floors, shape (n,).

    The motions of the floors come first; attached masses are coupled to nothing by their inertia, and have together the
    energy of one mode each.
    """
    attached = slice(floors, len(M))
    return np.asarray(found.shapes[:, attached] ** 2 @ np.diag(M)[attached])


def frame_modes(found: Modes, M: Floats, floors: int) -> Ints:
    """Find the modes that are the frame's, zero-based, ascending, shape (N,): all but the attached masses' own."""
    if len(M) == floors:
        return np.arange(floors)
    order = np.argsort(attached_share(found, M, floors), kind="stable")
    return np.sort(order[:floors])


def _is_chain(M: Floats, K: Floats) -> bool:
    """Whether M is diagonal, K is tridiagonal and the frame has at least `TALL` stories."""
    n = len(M)
    if n < TALL:
        return False
    mass = np.diag(M)
    beyond = np.count_nonzero(K) - sum(np.count_nonzero(np.diag(K, at)) for at in (-1, 0, 1))
    return bool(np.all(mass > 0) and np.count_nonzero(M) == n and beyond == 0)


def _all_modes(M: Floats, K: Floats) -> tuple[Floats, Floats]:
    """Modes by LAPACK itself: in a frame of a few stories what `linalg.eigh` does around it takes three times as long.

    Raises
    ------
    LinAlgError
    """
    values, vectors, failed = linalg.lapack.dsygvd(K, M)
    if failed:
        raise linalg.LinAlgError
    return values, vectors


def _chain_modes(M: Floats, K: Floats) -> tuple[Floats, Floats]:
    """Modes of a tridiagonal K and a diagonal M, in O(N^2)."""
    root = np.sqrt(np.diag(M))
    values, vectors = linalg.eigh_tridiagonal(
        np.diag(K) / root**2, np.diag(K, 1) / (root[1:] * root[:-1]), check_finite=False
    )
    return np.asarray(values, dtype=np.float64), vectors / root[:, None]


def mode_derivatives(found: Modes, system: System, which: slice | Ints | list[int]) -> tuple[Floats, Floats]:
    """Compute derivatives of eigenvalues and mass-normalized shapes, by modal superposition (Fox and Kapoor, 1968).

    With S = dK - lambda_j dM,

        dlambda_j = phi_j' S phi_j
        dphi_j    = sum over l != j of phi_l (phi_l' S phi_j) / (lambda_j - lambda_l) - phi_j (phi_j' dM phi_j) / 2

    which is exact, since all modes of the frame are at hand.

    Parameters
    ----------
    found : Modes
    system : System
        With derivatives by P parameters.
    which : index
        The modes j wanted, m of them, zero-based.

    Returns
    -------
    dlam : ndarray, shape (P, m)
    dphi : ndarray, shape (P, m, N)
    """
    lam, phi = found.eigenvalues, found.shapes.T
    lam_j, phi_j = lam[which], phi[:, which]
    by_stiffness, by_mass = system.modal_products(phi, phi_j)
    S = by_stiffness - lam_j * by_mass
    own = np.arange(len(lam))[which]
    column = np.arange(len(own))
    dlam = S[:, own, column]
    gap = lam_j[None, :] - lam[:, None]
    # Modes of one eigenvalue have no derivatives along each other.
    share = np.divide(S, gap, out=np.zeros_like(S), where=gap != 0.0)
    share[:, own, column] = -0.5 * by_mass[:, own, column]
    return dlam, share.transpose(0, 2, 1) @ phi.T


#: Index of every floor.
ALL = slice(None)


@dataclass(frozen=True, eq=False)
class Observation:
    """y = C q: the reading y of a sensor on each of N floors, from the n motions q of the frame.

    A shear frame has one motion a floor, and C is the identity. An attached mass is one motion more, which no sensor
    shows; the gain of a sensor scales its row of C.

    Parameters
    ----------
    matrix : ndarray, shape (N, n)
        C.
    slopes : mapping of int to ndarray, shape (N, n)
        dC by each parameter that C depends on; parameters that are not there leave it as it is.
    """

    matrix: Floats
    slopes: Mapping[int, Floats] = field(default_factory=dict)

    def shown(self, motion: Floats, floors: slice | Ints = ALL) -> Floats:
        """Return readings on some of the floors, shape (..., f), of motions of shape (..., n)."""
        return np.asarray(motion @ self.matrix[floors].T)

    def shown_slopes(self, motion: Floats, slopes: Floats, which: slice, floors: slice | Ints = ALL) -> Floats:
        """Return derivatives of the readings by some of the parameters, shape (p, m, f).

        Parameters
        ----------
        motion : ndarray, shape (m, n)
        slopes : ndarray, shape (p, m, n)
            Derivatives of the motion.
        which : slice
            Place of the p parameters among the parameters of the fit.
        floors : index, optional
        """
        found = self.shown(slopes, floors)
        rows = {parameter: row for row, parameter in enumerate(range(max(self.slopes, default=-1) + 1)[which])}
        for parameter, slope in self.slopes.items():
            if parameter in rows:
                found[rows[parameter]] += motion @ slope[floors].T
        return found

    @property
    def gain(self) -> Floats:
        """Gain of the sensor on each floor for the motion of this floor, shape (N,)."""
        return np.diagonal(self.matrix).copy()

    def scaled(self, floor: int, factor: float, own: int) -> Observation:
        """Multiply the readings of one floor, counted from 0, by a factor that grows by one with parameter `own`."""
        matrix = self.matrix.copy()
        slopes = {parameter: slope.copy() for parameter, slope in self.slopes.items()}
        slopes.setdefault(own, np.zeros_like(matrix))
        for slope in slopes.values():
            slope[floor] *= factor
        slopes[own][floor] += matrix[floor]
        matrix[floor] *= factor
        return Observation(matrix, slopes)

    def extended(self) -> Observation:
        """Put the same sensors on a frame of one motion more, which none of them shows."""
        none = np.zeros((len(self.matrix), 1))
        return Observation(
            np.hstack([self.matrix, none]),
            {parameter: np.hstack([slope, none]) for parameter, slope in self.slopes.items()},
        )
