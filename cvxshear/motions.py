r"""The affine map from parameters to mass and stiffness matrices, and from motions to readings.

A floor has d motions: one displacement u, or displacements u_x, u_y of a reference point and the angle theta about the
vertical axis. With a basis B of a floor's mass matrix and a basis C of a story's stiffness matrix, both d x d,

.. math:: M = \sum_{i, q} a_{iq} \, e_i e_i' \otimes B_q, \qquad K = \sum_{s, p} b_{sp} \, t_s t_s' \otimes C_p

with t_s column s of T (Eq. 19). Without rotation B = C = (1), and a and b are floor masses and story stiffnesses. Of
floors that turn, M_i has mass m, first moments s = m c of the mass center c and polar inertia J; a story has any
symmetric matrix:

.. math:: M_i = \begin{bmatrix} m & 0 & -s_y \\ 0 & m & s_x \\ -s_y & s_x & J \end{bmatrix}
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import linalg

from cvxshear.util.typing import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Motions:
    """The motions of each floor, with the bases of floor masses and story stiffnesses.

    Parameters
    ----------
    mass_names, stiffness_names : tuple of str
        Names of the q parameters of a floor and of the p parameters of a story.
    mass_basis, stiffness_basis : ndarray, shapes (q, d, d) and (p, d, d)
        B and C.
    """

    mass_names: tuple[str, ...]
    mass_basis: Floats
    stiffness_names: tuple[str, ...]
    stiffness_basis: Floats

    @property
    def count(self) -> int:
        """Number of motions d of a floor."""
        return int(self.mass_basis.shape[1])

    @property
    def lengths(self) -> tuple[Ints, Ints]:
        """Powers of a length in the units of the q and the p parameters: one for each rotation of an entry."""
        bases = (self.mass_basis, self.stiffness_basis)
        found = [[np.sum(np.argwhere(each)[0] == 2) for each in basis] for basis in bases]
        return np.array(found[0]), np.array(found[1])

    @property
    def positive(self) -> tuple[Bools, Bools]:
        """Whether each of the q and the p parameters is a diagonal entry, which is positive."""
        first, second = (np.trace(basis, axis1=1, axis2=2) > 0 for basis in (self.mass_basis, self.stiffness_basis))
        return first, second

    def masses(self, a: Floats) -> Floats:
        """Assemble M, shape (N d, N d), from the parameters of the floors, the lowest floor first."""
        return np.asarray(linalg.block_diag(*blocks(a, self.mass_basis)))

    def stiffnesses(self, b: Floats) -> Floats:
        """Assemble K, shape (N d, N d), from the parameters of the stories, the lowest story first."""
        of_stories = blocks(b, self.stiffness_basis)
        relative = self.relative(np.eye(len(of_stories) * self.count))
        return np.asarray(relative.T @ linalg.block_diag(*of_stories) @ relative)

    def units(self, mass: float, stiffness: float, radius: Floats) -> Floats:
        """Return the size of every parameter for a typical floor mass and story stiffness, and each floor's radius."""
        sizes = zip((mass, stiffness), self.lengths, strict=True)
        return np.concatenate([(size * radius[:, None] ** powers).ravel() for size, powers in sizes])

    def loads(self, mass: Floats, position: Floats) -> Floats:
        """Assemble M of a point mass on each floor, shapes (N,) and (N, 2), or (0,) at the reference points."""
        moved = np.zeros((len(mass), 2, self.count))
        moved[:, :, :2] = np.eye(2)[:, : self.count]
        if len(position):
            moved[:, :, 2] = position[:, ::-1] * [-1.0, 1.0]
        return np.asarray(linalg.block_diag(*(mass[:, None, None] * np.swapaxes(moved, 1, 2) @ moved)))

    def relative(self, motion: Floats) -> Floats:
        """Subtract the motion of the floor below from that of each floor, along axis 0 of shape (N d, ...)."""
        below = np.zeros_like(motion)
        below[self.count :] = motion[: -self.count]
        return np.asarray(motion - below)


#: One displacement per floor: the shear frame.
ONE_MOTION = Motions(("floor_mass",), np.ones((1, 1, 1)), ("story_stiffness",), np.ones((1, 1, 1)))


def _symmetric(*entries: tuple[int, int, float]) -> Floats:
    matrix = np.zeros((3, 3))
    for row, column, value in entries:
        matrix[row, column] = matrix[column, row] = value
    return matrix


#: x, y and rotation at a reference point: floors that turn. Letter r stands for rotation.
THREE_MOTIONS = Motions(
    ("floor_mass", "first_moment_x", "first_moment_y", "inertia"),
    np.array(
        [
            _symmetric((0, 0, 1.0), (1, 1, 1.0)), _symmetric((1, 2, 1.0)), _symmetric((0, 2, -1.0)),
            _symmetric((2, 2, 1.0)),
        ]
    ),
    tuple(f"story_stiffness {pair}" for pair in ("xx", "yy", "rr", "xy", "xr", "yr")),
    np.array([_symmetric((*at, 1.0)) for at in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]),
)  # fmt: skip

#: The same for floors and stories that are symmetric about the reference point: x, y and rotation are independent.
SYMMETRIC_MOTIONS = Motions(
    ("floor_mass", "inertia"),
    THREE_MOTIONS.mass_basis[[0, 3]],
    THREE_MOTIONS.stiffness_names[:3],
    THREE_MOTIONS.stiffness_basis[:3],
)


def symmetric(general: Floats, stories: int) -> Floats:
    """Take the floors and stories of a frame as symmetric: each about its own center, without coupling of x and y.

    Parameters
    ----------
    general : ndarray, shape (10 N,)
        Parameters of `THREE_MOTIONS`.
    stories : int

    Returns
    -------
    ndarray, shape (5 N,)
        Parameters of `SYMMETRIC_MOTIONS`.
    """
    floors, entries = general[: 4 * stories].reshape(-1, 4), general[4 * stories :].reshape(-1, 6)
    inertia, rotation = (
        center(blocks(each, basis))[1]
        for each, basis in ((floors, THREE_MOTIONS.mass_basis), (entries, THREE_MOTIONS.stiffness_basis))
    )
    return np.concatenate(
        [np.column_stack([floors[:, 0], inertia]).ravel(), np.column_stack([entries[:, :2], rotation]).ravel()]
    )


def blocks(parameters: Floats, basis: Floats) -> Floats:
    """Combine a basis by the parameters of each floor or story, shape (N q,), to matrices of shape (N, d, d)."""
    return np.asarray(np.einsum("fq,qab->fab", parameters.reshape(-1, len(basis)), basis))


def entries_of(matrices: Floats) -> Floats:
    """Read the entries xx, yy, rr, xy, xr and yr of symmetric matrices, shape (..., 3, 3), as one array, flat."""
    return np.asarray(matrices[..., [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].ravel())


def slopes(first: Floats, second: Floats, basis: Floats) -> Floats:
    """Differentiate first' X second by the parameters of X, X block-diagonal in a basis.

    Parameters
    ----------
    first, second : ndarray, shapes (N d, r) and (N d, m)
    basis : ndarray, shape (q, d, d)

    Returns
    -------
    ndarray, shape (N q, r, m)
    """
    d = basis.shape[1]
    if len(basis) == d == 1:
        return np.asarray((basis[0] * first)[:, :, None] * second[:, None, :])
    left, right = (each.reshape(-1, d, each.shape[1]) for each in (first, second))
    found = np.einsum("fak,qab,fbj->fqkj", left, basis, right, optimize=True)
    return np.asarray(found.reshape(-1, first.shape[1], second.shape[1]))


def products(first: Floats, second: Floats, basis: Floats) -> Floats:
    """Compute `slopes` with the parameters last, shape (r, m, N q)."""
    return np.moveaxis(slopes(first, second, basis), 0, -1)


@lru_cache(maxsize=8)
def unit_derivatives(motions: Motions, stories: int) -> tuple[Floats, Floats]:
    """Compute dM and dK by every parameter of the floors, then of the stories, shape (P, N d, N d), read-only."""
    n = stories * motions.count
    units, relative = np.eye(n), motions.relative(np.eye(n))
    dM, dK = (
        slopes(each, each, basis) for each, basis in ((units, motions.mass_basis), (relative, motions.stiffness_basis))
    )
    found = np.concatenate([dM, np.zeros_like(dK)]), np.concatenate([np.zeros_like(dM), dK])
    for each in found:
        each.setflags(write=False)
    return found


def center(matrices: Floats) -> tuple[Floats, Floats]:
    """Find the point at which rotation decouples from the displacements, and the rotational entry there.

    A floor's mass matrix gives the mass center and the central inertia, a story's stiffness matrix the center of
    stiffness. With the displacements' part L and the coupling l, (-c_y, c_x) = L^-1 l, and the entry is that of the
    rotation less l' L^-1 l.

    Parameters
    ----------
    matrices : ndarray, shape (N, 3, 3)

    Returns
    -------
    centers : ndarray, shape (N, 2)
        x and y from the reference point.
    central : ndarray, shape (N,)
    """
    motion = _about_center(matrices)
    return motion[:, 1::-1] * [-1.0, 1.0], np.einsum("fa,fab,fb->f", motion, matrices, motion)


def center_slopes(matrices: Floats, basis: Floats) -> tuple[Floats, Floats]:
    """Differentiate `center` by the parameters of each matrix, shapes (N, 2, q) and (N, q)."""
    motion = _about_center(matrices)
    forces = np.einsum("qab,fb->faq", basis, motion)
    moved = np.linalg.solve(matrices[:, :2, :2], forces[:, :2])
    return moved[:, ::-1] * np.array([[1.0], [-1.0]]), np.einsum("fa,faq->fq", motion, forces)


def _about_center(matrices: Floats) -> Floats:
    """Motion (c_y, -c_x, 1) of the reference point in a rotation about the center, shape (N, 3)."""
    displacements = np.linalg.solve(matrices[:, :2, :2], matrices[:, :2, 2:])[..., 0]
    return np.column_stack([-displacements, np.ones(len(matrices))])
