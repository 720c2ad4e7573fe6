"""Damping ratios of all modes, and the story dashpots or Rayleigh's factors that have them.

Either is a least-squares program of the form that every backend solves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.domain import Domain
from cvxshear.fit.gauss_newton import Accuracy, gauss_newton
from cvxshear.fit.optimality import PlainResiduals
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model.shear import Modes, stiffness_matrix
from cvxshear.priors import Prior
from cvxshear.programs import LeastSquares
from cvxshear.programs.constraints import constrained, refuse_contradictions, softened, statements
from cvxshear.programs.pair_rows import pair_products
from cvxshear.response.damped import coupled, modal_damping
from cvxshear.util import ranking
from cvxshear.util.errors import InputError, NoModesError, NoSolutionError, UnsuitableError
from cvxshear.util.quantities import ranged
from cvxshear.util.typing import Bools, Floats, Ints

DEFAULT_STD = 0.2
"""Relative standard deviation of a measured damping ratio where none is declared: repeated tests scatter by as much."""

ASSUMED_STD = 0.5
"""Relative standard deviation of the damping ratio of a mode that was not measured: modes of one frame differ so."""


HIGH = 0.2
"""Damping ratio from which on it is asked whether percent were meant: frames with dampers have less."""


@dataclass(frozen=True, eq=False)
class Ratios:
    """Damping ratios of the N modes of a frame.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Fraction of critical; where not measured, the mean of those that were.
    std : ndarray, shape (N,)
        Relative.
    measured : ndarray of bool, shape (N,)
    tested : Configuration
        The state in which they were measured.
    """

    values: Floats
    std: Floats
    measured: Bools
    tested: Configuration

    def assumed(self) -> tuple[str, ...]:
        """Say what is taken for known and was not measured."""
        said = []
        if not self.measured.all():
            names = ranged([int(j) + 1 for j in np.flatnonzero(~self.measured)])
            said.append(
                f"no damping ratio was measured of mode{'s' if (~self.measured).sum() > 1 else ''} {names}: the mean "
                f"of the others is taken, {100 * self.values[~self.measured][0]:.2g} % of critical within "
                f"{100 * ASSUMED_STD:g} %"
            )
        if np.any(self.values[self.measured] >= HIGH):
            largest = float(self.values[self.measured].max())
            said.append(
                f"a damping ratio of {largest:g} is {100 * largest:g} % of critical: are the ratios in percent? "
                "damping_ratios are fractions of critical"
            )
        if self.tested.damping_ratio_std is None:
            said.append(
                f"no deviation of the damping ratios is declared (damping_ratio_std): {100 * DEFAULT_STD:g} % is taken"
            )
        return tuple(said)


def damping_ratios(experiment: Experiment, configuration: Configuration) -> Ratios:
    """Return the ratios of a configuration, or of the first that has some where it has none.

    Raises
    ------
    InputError
        Where no configuration declares any.
    """
    sources = [each for each in experiment.configurations if each.damping_ratios is not None]
    if not sources:
        raise InputError(
            "nothing tells how the frame is damped: give damping_ratios in [[configuration]] (fractions of critical, "
            "one a mode, or one number for all)"
        )
    tested = next((each for each in sources if each.name == configuration.name), sources[0])
    assert tested.damping_ratios is not None
    there = np.isfinite(tested.damping_ratios)
    modes = tested.modes[there] - 1
    seen = np.zeros(experiment.stories, dtype=bool)
    seen[modes] = True
    values = np.full(experiment.stories, float(np.mean(tested.damping_ratios[there])))
    values[modes] = tested.damping_ratios[there]
    std = np.full(experiment.stories, ASSUMED_STD)
    std[modes] = DEFAULT_STD if tested.damping_ratio_std is None else tested.damping_ratio_std[there]
    return Ratios(values, std, seen, tested)


QUANTITY = "story_damping"
"""Quantity of the priors that speak of the dashpots."""

LOOSE = 10.0
"""Relative standard deviation of the assumption that the dashpots are in proportion to the stiffnesses: it decides only
what neither the ratios nor the priors do."""

LEAST_RATIO = 1e-3
"""Damping ratio below which a measured one is known no better than one of this size."""

DASHPOT_STEPS = 100
SETTLED_DASHPOTS = 1e-5
"""Gauss-Newton steps at most, and largest change of a ratio, in its standard deviation, at which the dashpots have
settled."""

LEFT_OPEN = 1e-6
"""Change of the data, each dashpot in units of its own effect, below which they leave a combination of dashpots
open."""

UNTOUCHED = 1e-4
"""Part of a story in the combinations that are left open, below which its own dashpot counts as determined."""

NAMED_SHARE = 0.1
"""Share of the largest entry from which on a story is named as part of a combination."""

ZERO = 1e-9
"""Dashpot, relative to the largest, below which it is zero to within what solvers deliver."""


@dataclass(frozen=True, eq=False)
class Dashpots:
    """Story dashpots.

    Parameters
    ----------
    values : ndarray, shape (N,)
        N s/m.
    open : tuple of str
        Combinations that the measured ratios and the priors leave open, in words.
    determined : ndarray of bool, shape (N,)
        Which stories take part in none of them.
    """

    values: Floats
    open: tuple[str, ...]
    determined: Bools


def story_dashpots(
    real: Modes,
    stiffness: Floats,
    ratios: Ratios,
    backend: Backend,
    priors: Sequence[Prior] = (),
    start: Floats | None = None,
) -> Dashpots:
    """Dashpots c >= 0 between the floors with which the frame has the measured damping ratios.

    With real modes x = T' phi, x_i o x_j' c = 2 zeta_i omega_i delta_ij. The rows i = j are the measurement, each
    divided by 2 omega_i and by the deviation of its zeta_i. The rows i /= j say that the modes do not couple, which
    nobody measured; of a matrix that only dissipates, an entry is at most sqrt(zeta_i zeta_j) in these units, and a
    uniform distribution up to there has a standard deviation of sqrt(zeta_i zeta_j / 3).

    Dashpots that do couple the modes change the ratios of the poles in second order. So the program is solved again
    with the ratios of the complex modes and their derivatives, ds/dc_k = -s y_k^2 / a with the drifts y of the
    complex shape, until nothing changes: ratios of the frame's own complex modes are then met, too.

    Parameters
    ----------
    real : Modes
        Undamped, all N of them.
    stiffness : ndarray, shape (N,)
        N/m; the dashpots are in proportion to it where nothing else tells.
    priors : sequence of Prior, optional
        Of the quantity "story_damping".
    start : ndarray, shape (N,), optional
        Dashpots near the answer.

    Raises
    ------
    InfeasibleError
        Where exact priors contradict each other.
    NoSolutionError
        Where the backend does not solve a program, or the dashpots do not settle.
    """
    n = len(stiffness)
    where = statements(priors, QUANTITY, n)
    refuse_contradictions(where, n)
    fit = _Fit(real, stiffness, ratios, priors)
    c = start
    if c is None:
        # The first answer is that of real modes, wherever it lies; from there on the ratios come ever nearer.
        c = backend.solve(constrained(fit.program(np.zeros(n)), where, np.zeros(n))).x
    domain = Domain(where, np.full(n, max(float(np.abs(c).max()), 1e-300)), np.full(n, np.inf))
    found = gauss_newton(fit, c, domain, backend, Accuracy(SETTLED_DASHPOTS, DASHPOT_STEPS), fit.residuals(c))
    if not found.converged:
        raise NoSolutionError(
            backend.name,
            f"the story dashpots did not settle in {DASHPOT_STEPS} steps; use modal damping in their place",
        )
    return fit.found(found.theta, fit.program(found.theta))


class _Fit:
    """The rows of the programs of one fit.

    Parameters
    ----------
    real, stiffness, ratios, priors
        As for `story_dashpots`.
    """

    def __init__(self, real: Modes, stiffness: Floats, ratios: Ratios, priors: Sequence[Prior]) -> None:
        self.real, self.stiffness, self.priors = real, stiffness, priors
        self.seen = np.flatnonzero(ratios.measured)
        self.zeta = ratios.values[self.seen]
        size = np.maximum(self.zeta, LEAST_RATIO)
        self.std = ratios.std[self.seen] * size
        self.statement = _statement(real, self.seen, size, stiffness)

    def program(self, c: Floats) -> LeastSquares:
        """State the program of a change of the dashpots: measured ratios, then what is assumed, then soft priors."""
        found, J = _pole_ratios(self.real, c, self.seen)
        R = np.concatenate([J / self.std[:, None], self.statement])
        s = np.concatenate([(self.zeta - found) / self.std, -self.statement @ c])
        names = tuple(f"{QUANTITY} {i + 1}" for i in range(len(c)))
        at = np.maximum(c, 1e-12 * self.stiffness)
        return softened(LeastSquares(R, s, names=names), self.priors, QUANTITY, at, 1.0, step=True)

    def residuals(self, c: Floats) -> PlainResiduals:
        """Return the rows at given dashpots.

        Raises
        ------
        UnsuitableError
            Where a measured mode would not swing any more.
        """
        program = self.program(c)
        return PlainResiduals(-program.s, program.R)

    def evaluate(self, theta: Floats, /, *, derivatives: bool = True) -> PlainResiduals:
        """Return the rows as Gauss-Newton takes them; dashpots that overdamp a mode are too long a step."""
        try:
            return self.residuals(theta)
        except UnsuitableError as error:
            raise NoModesError(str(error)) from None

    def found(self, c: Floats, program: LeastSquares) -> Dashpots:
        """Return the dashpots at the end, with what the program's rows of data leave open."""
        measured, assumed = len(self.seen), len(self.statement)
        exact = [prior.constraints(len(c)).A for prior in self.priors]
        rows = [program.R[:measured], program.R[measured + assumed :], *(A for A in exact if A is not None)]
        c = np.where(c > ZERO * c.max(), c, 0.0)
        return Dashpots(c, *_left_open(np.concatenate(rows)))


def _statement(real: Modes, seen: Ints, zeta: Floats, stiffness: Floats) -> Floats:
    """Rows that are zero for what is assumed: modes that do not couple, dashpots in proportion to the stiffnesses."""
    n = len(stiffness)
    omega = np.sqrt(real.eigenvalues[seen])
    drifts = np.diff(real.shapes[seen].T, axis=0, prepend=0.0)
    i, j = np.triu_indices(len(seen), k=1)
    unit = 2 * np.sqrt(omega[i] * omega[j]) * np.sqrt(zeta[i] * zeta[j] / 3)
    uncoupled = pair_products(drifts, diagonal=False) / unit[:, None]
    # c_k / k_k less the mean of all, in units of the proportion that gives the mean ratio at the first mode.
    typical = 2 * float(np.mean(zeta)) / float(np.sqrt(real.eigenvalues[0]))
    proportion = (np.eye(n) - 1.0 / n) / stiffness / (typical * LOOSE)
    return np.concatenate([uncoupled, proportion])


def _pole_ratios(real: Modes, c: Floats, seen: Ints) -> tuple[Floats, Floats]:
    """Damping ratios of the measured modes' poles, shape (m,), and their derivatives by the dashpots, (m, N)."""
    if not np.any(c):
        drifts = np.diff(real.shapes[seen].T, axis=0, prepend=0.0)
        return np.zeros(len(seen)), (drifts**2 / (2 * np.sqrt(real.eigenvalues[seen]))).T
    gamma = modal_damping(real, stiffness_matrix(c))
    found = coupled(real, gamma)
    swinging = np.flatnonzero(found.values.imag > 0)
    if seen[-1] >= len(swinging):
        raise UnsuitableError(
            "with story dashpots that give the measured damping ratios one of those modes would not swing any more; "
            "use modal damping in their place"
        )
    own = swinging[seen]
    s, a = found.values[own], found.scales[own]
    drifts = np.diff(found.shapes[:, own], axis=0, prepend=0.0)
    ds = -(s * drifts**2 / a).T
    size = np.abs(s)[:, None]
    toward = np.real(np.conj(s)[:, None] * ds)
    return -s.real / np.abs(s), -ds.real / size + s.real[:, None] * toward / size**3


def _left_open(data: Floats) -> tuple[tuple[str, ...], Bools]:
    """Name the combinations of dashpots that rows leave open, and which stories take part in none."""
    length = np.linalg.norm(data, axis=0)
    unit = 1.0 / np.where(length > 0, length, 1.0)
    _, values, right = np.linalg.svd(data * unit, full_matrices=True)
    rank = int(np.sum(values > LEFT_OPEN * values[0]))
    null = right[rank:]
    part = np.linalg.norm(null, axis=0) if len(null) else np.zeros(data.shape[1])
    words = []
    for direction in np.abs(null):
        order = ranking.order(direction)
        names = [str(k + 1) for k in order if direction[k] > NAMED_SHARE * direction[order[0]]]
        words.append(f"the dashpots of stories {', '.join(names)}" if len(names) > 1 else f"the dashpot of {names[0]}")
    return tuple(words), part < UNTOUCHED


def rayleigh(real: Modes, ratios: Ratios, backend: Backend) -> Floats:
    """Find a and b of C = a M + b K, both at least zero, by zeta_i = a / (2 omega_i) + b omega_i / 2, weighted.

    Raises
    ------
    UnsuitableError
        Where fewer than two modes have a measured ratio.
    """
    seen = np.flatnonzero(ratios.measured)
    if len(seen) < 2:
        raise UnsuitableError(
            "Rayleigh damping has two factors, and one mode's damping ratio was measured; use modal damping"
        )
    omega, zeta = np.sqrt(real.eigenvalues[seen]), ratios.values[seen]
    std = ratios.std[seen] * np.maximum(zeta, LEAST_RATIO)
    rows = np.column_stack([0.5 / omega, 0.5 * omega]) / std[:, None]
    program = LeastSquares(rows, zeta / std, lower=np.zeros(2), names=("a", "b"))
    return np.maximum(backend.solve(program).x, 0.0)
