"""An identified frame as a script for OpenSeesPy."""

from __future__ import annotations

import numpy as np

from cvxshear.response.uncertain import Damped
from cvxshear.util.errors import UnsuitableError
from cvxshear.util.text import printable
from cvxshear.util.typing import Floats

SCRIPT = '''"""{title}: the identified frame for OpenSeesPy; units m, kg, s, N.

Each floor is a node with one translation, node 0 the ground. Springs between the floors, and to the ground, make up
the stiffness matrix; where the frame has more than story springs some of them are negative.
"""

import openseespy.opensees as ops

MASSES = {masses}
SPRINGS = {springs}  # (node, node, N/m)
DASHPOTS = {dashpots}  # (node, node, N s/m)
DAMPING_RATIOS = {ratios}
RAYLEIGH = {rayleigh}  # a, b of C = a M + b K


def build():
    """Make the model."""
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    for node in range(len(MASSES) + 1):
        ops.node(node, 0.0)
    ops.fix(0, 1)
    for node, mass in enumerate(MASSES, 1):
        ops.mass(node, mass)
    for tag, (lower, upper, stiffness) in enumerate(SPRINGS, 1):
        ops.uniaxialMaterial("Elastic", tag, stiffness)
        ops.element("zeroLength", tag, lower, upper, "-mat", tag, "-dir", 1, "-doRayleigh", 1)
    for tag, (lower, upper, dashpot) in enumerate(DASHPOTS, len(SPRINGS) + 1):
        ops.uniaxialMaterial("Viscous", tag, dashpot, 1.0)
        ops.element("zeroLength", tag, lower, upper, "-mat", tag, "-dir", 1)


def frequencies():
    """Natural frequencies, Hz."""
    return [value**0.5 / 6.283185307179586 for value in ops.eigen("-fullGenLapack", len(MASSES))]


def damp():
    """Set the damping that is not in dashpots; the eigenvalues are computed first."""
    frequencies()
    if DAMPING_RATIOS:
        ops.modalDamping(*DAMPING_RATIOS)
    if RAYLEIGH:
        ops.rayleigh(RAYLEIGH[0], 0.0, RAYLEIGH[1], 0.0)


def shake(acceleration, step):
    """Displacements of every floor against the ground, one list a sample, under a base acceleration (m/s2)."""
    build()
    damp()
    ops.timeSeries("Path", 1, "-dt", step, "-values", *acceleration)
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("FullGeneral")
    ops.algorithm("Linear")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    moved = [[0.0] * len(MASSES)]
    for _ in acceleration[1:]:
        ops.analyze(1, step)
        moved.append([ops.nodeDisp(node, 1) for node in range(1, len(MASSES) + 1)])
    return moved


if __name__ == "__main__":
    build()
    for mode, frequency in enumerate(frequencies(), 1):
        print(f"mode {{mode}}: {{frequency:.6g}} Hz")
'''


def opensees_script(damped: Damped, title: str) -> str:
    """A script that makes the frame in OpenSeesPy, with its damping.

    Any symmetric stiffness matrix is that of springs -K_ij between floors i and j and of sum_j K_ij to the ground.

    Parameters
    ----------
    damped : Damped
    title : str

    Raises
    ------
    UnsuitableError
        Where the mass matrix is not diagonal: nodes have masses of their own only.
    """
    M = damped.model.M
    if np.any(np.abs(M - np.diag(np.diag(M))) > 1e-12 * np.abs(M).max()):
        raise UnsuitableError(
            "OpenSees has masses at nodes only, and the mass matrix of this frame couples its floors (mass_coupling); "
            "hand it on as .npz, .mat or .json"
        )
    modal = damped.dashpots is None and damped.rayleigh is None
    return SCRIPT.format(
        title=printable(" ".join(title.split())).replace("\\", "/").replace('"', "'") or "frame",
        masses=np.diag(M).tolist(),
        springs=_links(damped.model.K),
        dashpots=[] if damped.dashpots is None else _links(damped.model.C),
        ratios=damped.model.ratios.tolist() if modal else [],
        rayleigh=[] if damped.rayleigh is None else damped.rayleigh.tolist(),
    )


def _links(matrix: Floats) -> list[tuple[int, int, float]]:
    """Links between nodes, the ground being 0, whose matrix this is."""
    n = len(matrix)
    ground = [(0, i + 1, float(matrix[i].sum())) for i in range(n)]
    between = [(i + 1, j + 1, float(-matrix[i, j])) for i in range(n) for j in range(i + 1, n)]
    # Rounding of the row sums is no spring to the ground.
    return [link for link in (*ground, *between) if abs(link[2]) > 1e-12 * np.abs(matrix).max()]
