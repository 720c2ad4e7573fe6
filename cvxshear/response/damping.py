"""Frame with damping: its matrices and complex modes, and the damping that gives the measured ratios.

Story dashpots and Rayleigh factors are solutions of least-squares programs that every backend can solve.
"""

from dataclasses import dataclass

import numpy as np

from cvxshear.backends import Backend
from cvxshear.fit.domain import Domain, Uncertainty
from cvxshear.fit.gauss_newton import Accuracy, gauss_newton
from cvxshear.fit.optimality import PlainResiduals
from cvxshear.measurement.experiment import Configuration, Experiment
from cvxshear.model import Modes, modes, stiffness_matrix
from cvxshear.priors import Constraints
from cvxshear.programs import LeastSquares, constraints, formulations
from cvxshear.util.decorators import cached_property
from cvxshear.util.errors import InputError, NoModesError, NoSolutionError, UnsuitableError
from cvxshear.util.quantities import ranged
from cvxshear.util.typing import Bools, Complexes, Floats, Ints

#: Relative standard deviation of a measured damping ratio without a declared one: the scatter of repeated tests.
DEFAULT_STD = 0.2

#: Relative standard deviation of the damping ratio of an unmeasured mode: the scatter between modes of one frame.
ASSUMED_STD = 0.5


#: Least damping ratio that is questioned as a value in percent; frames with dampers have lower ratios.
HIGH = 0.2


def modal_damping(real: Modes, C: Floats) -> Floats:
    """Compute Gamma = Phi' C Phi, shape (N, N): diagonal with 2 zeta omega if the modes are uncoupled."""
    return real.shapes @ C @ real.shapes.T


def coupled(real: Modes, gamma: Floats) -> tuple[Complexes, Complexes, Complexes]:
    """Compute the poles of modes that damping couples, one of each conjugate pair: (s^2 M + s C + K) psi = 0.

    The state is (omega q, q') of the modal coordinates q. Its undamped part is skew and evenly scaled.

    Returns
    -------
    s : ndarray of complex, shape (p,)
        rad/s; ascending in size. Overdamped modes have two real poles each.
    psi : ndarray of complex, shape (N, p)
    a : ndarray of complex, shape (p,)
        a = psi' (2 s M + C) psi.
    """
    n = len(gamma)
    omega = np.sqrt(real.eigenvalues)
    system = np.zeros((2 * n, 2 * n))
    system[:n, n:] = np.diag(omega)
    system[n:, :n] = -np.diag(omega)
    system[n:, n:] = -gamma
    values, states = np.linalg.eig(system)
    values, states = values.astype(np.complex128), states.astype(np.complex128)
    kept = np.flatnonzero(values.imag >= 0)
    kept = kept[np.argsort(np.abs(values[kept]), kind="stable")]
    s: Complexes = np.asarray(values[kept], dtype=np.complex128)
    q = states[:n, kept] / omega[:, None]
    scales = 2 * s * np.sum(q * q, axis=0) + np.sum(q * (gamma @ q), axis=0)
    return s, np.asarray(real.shapes.T @ q, dtype=np.complex128), scales


@dataclass(frozen=True, eq=False)
class DampedModel:
    """Mass, damping and stiffness matrices of one state of the frame.

    Parameters
    ----------
    M, C, K : ndarray, shape (N, N)
        kg, N s/m, N/m.
    gain : ndarray, shape (N,)
        Value that a sensor on each floor shows for a value of 1.
    heights : ndarray, shape (N,), optional
        Story heights, m.
    mass_known : bool, optional
        Whether the mass scale is known; without it, forces have no scale.
    input_gain : float, optional
        Ratio of the real excitation to the value that its sensor shows.
    """

    M: Floats
    C: Floats
    K: Floats
    gain: Floats
    heights: Floats | None = None
    mass_known: bool = True
    input_gain: float = 1.0

    @cached_property
    def modes(self) -> Modes:
        """Undamped modes."""
        return modes(self.M, self.K)

    @cached_property
    def ratios(self) -> Floats:
        """Damping ratio of each mode, shape (N,): -Re s / |s| of its pole, or from Phi' C Phi if one is overdamped."""
        gamma = modal_damping(self.modes, self.C)
        s, _, _ = coupled(self.modes, gamma)
        if len(s) == len(self.M) and np.all(s.imag > 0):
            return -s.real / np.abs(s)
        return np.asarray(np.diag(gamma) / (2 * np.sqrt(self.modes.eigenvalues)))


@dataclass(frozen=True, eq=False)
class Ratios:
    """Damping ratios of the N modes of a frame.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Fraction of critical; for unmeasured modes, the mean of the measured ratios.
    std : ndarray, shape (N,)
        Relative.
    measured : ndarray of bool, shape (N,)
    tested : Configuration
        The configuration in which they were measured.
    """

    values: Floats
    std: Floats
    measured: Bools
    tested: Configuration

    def assumed(self) -> tuple[str, ...]:
        """Report the assumptions about the ratios."""
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
    """Return the ratios of a configuration; if it has none, of the first configuration with ratios.

    Raises
    ------
    InputError
        If no configuration declares ratios.
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


#: Relative standard deviation of the assumption of dashpots proportional to the stiffnesses. The large value only
#: affects combinations that the ratios do not determine.
LOOSE = 10.0

#: Least damping ratio that sets the accuracy: a smaller ratio has the same absolute standard deviation.
LEAST_RATIO = 1e-3


@dataclass(frozen=True, eq=False)
class Dashpots:
    """Story dashpots.

    Parameters
    ----------
    values : ndarray, shape (N,)
        N s/m.
    open : tuple of str
        Combinations that the measured ratios do not determine, in words.
    determined : ndarray of bool, shape (N,)
        Stories that are in no such combination.
    """

    values: Floats
    open: tuple[str, ...]
    determined: Bools


def story_dashpots(real: Modes, stiffness: Floats, ratios: Ratios, backend: Backend) -> Dashpots:
    """Find dashpots c >= 0 between the floors that give the frame the measured damping ratios.

    With real modes x = T' phi, x_i o x_j' c = 2 zeta_i omega_i delta_ij. The rows i = j are the measurement, each
    divided by 2 omega_i and by the deviation of its zeta_i. The rows i /= j assume uncoupled modes, which is not a
    measurement. A dissipative matrix has entries of at most sqrt(zeta_i zeta_j) in these units, and a uniform
    distribution up to this limit has a standard deviation of sqrt(zeta_i zeta_j / 3).

    Dashpots that couple the modes change the ratios of the poles in second order. So the program is solved repeatedly
    with the ratios of the complex modes and their derivatives, ds/dc_k = -s y_k^2 / a, with the drifts y of the
    complex shape. At convergence, the frame's complex modes have the measured ratios.

    Parameters
    ----------
    real : Modes
        All N undamped modes.
    stiffness : ndarray, shape (N,)
        N/m; undetermined dashpots are proportional to the stiffnesses.

    Raises
    ------
    NoSolutionError
        If the backend does not solve a program, or the dashpots do not converge.
    UnsuitableError
        If a measured mode would be overdamped.
    """
    n = len(stiffness)
    where = [constraints.NamedConstraints("dashpots are positive", Constraints(lower=np.zeros(n)))]
    fit = _Fit(real, stiffness, ratios)
    # The first solution uses the real modes, for any distance; the following steps improve the ratios.
    c = backend.solve(constraints.constrained(fit.program(np.zeros(n)), where, np.zeros(n))).x
    domain = Domain(where, np.full(n, max(float(np.abs(c).max()), 1e-300)), np.full(n, np.inf))
    try:
        found = gauss_newton(fit, c, domain, backend, Accuracy())
    except NoModesError as error:
        raise UnsuitableError(str(error)) from None
    if not found.converged:
        raise NoSolutionError(backend.name, "the story dashpots did not settle; use modal damping in their place")
    return fit.found(found.theta, fit.program(found.theta))


class _Fit:
    """The rows of the programs of one fit.

    Parameters
    ----------
    real, stiffness, ratios
        As for `story_dashpots`.
    """

    def __init__(self, real: Modes, stiffness: Floats, ratios: Ratios) -> None:
        self.real = real
        self.seen = np.flatnonzero(ratios.measured)
        self.zeta = ratios.values[self.seen]
        size = np.maximum(self.zeta, LEAST_RATIO)
        self.std = ratios.std[self.seen] * size
        self.statement = _statement(real, self.seen, size, stiffness)

    def program(self, c: Floats) -> LeastSquares:
        """Return the program for a change of the dashpots: measured ratios, then assumptions."""
        found, J = _pole_ratios(self.real, c, self.seen)
        R = np.concatenate([J / self.std[:, None], self.statement])
        s = np.concatenate([(self.zeta - found) / self.std, -self.statement @ c])
        return LeastSquares(R, s, names=tuple(f"dashpot {i + 1}" for i in range(len(c))))

    def evaluate(self, theta: Floats, /, *, derivatives: bool = True) -> PlainResiduals:
        """Return the rows for Gauss-Newton; NoModesError rejects a step to dashpots that overdamp a mode."""
        program = self.program(theta)
        return PlainResiduals(-program.s, program.R)

    def found(self, c: Floats, program: LeastSquares) -> Dashpots:
        """Return the final dashpots, and the combinations that the program's data do not determine."""
        n, none = len(c), np.zeros((0, len(c)))
        names = tuple(str(story) for story in range(1, n + 1))
        told = Uncertainty(program.R[: len(self.seen)], none, none, none, np.full(n, np.inf), np.zeros(n), names)
        words = (
            f"the dashpots of stories {', '.join(each)}" if len(each) > 1 else f"the dashpot of {each[0]}"
            for each in told.null_directions
        )
        return Dashpots(np.maximum(c, 0.0), tuple(words), told.determined)


def _statement(real: Modes, seen: Ints, zeta: Floats, stiffness: Floats) -> Floats:
    """Return the rows of the assumptions: uncoupled modes, dashpots proportional to the stiffnesses."""
    n = len(stiffness)
    omega = np.sqrt(real.eigenvalues[seen])
    drifts = np.diff(real.shapes[seen].T, axis=0, prepend=0.0)
    i, j = np.triu_indices(len(seen), k=1)
    unit = 2 * np.sqrt(omega[i] * omega[j]) * np.sqrt(zeta[i] * zeta[j] / 3)
    uncoupled = formulations.pair_products(drifts, diagonal=False) / unit[:, None]
    # c_k / k_k minus the mean of all, relative to the factor that gives the first mode the mean ratio.
    typical = 2 * float(np.mean(zeta)) / float(np.sqrt(real.eigenvalues[0]))
    proportion = (np.eye(n) - 1.0 / n) / stiffness / (typical * LOOSE)
    return np.concatenate([uncoupled, proportion])


def _pole_ratios(real: Modes, c: Floats, seen: Ints) -> tuple[Floats, Floats]:
    """Compute the damping ratios of the measured modes' poles, (m,), and derivatives by the dashpots, (m, N)."""
    if not np.any(c):
        drifts = np.diff(real.shapes[seen].T, axis=0, prepend=0.0)
        return np.zeros(len(seen)), (drifts**2 / (2 * np.sqrt(real.eigenvalues[seen]))).T
    gamma = modal_damping(real, stiffness_matrix(c))
    values, shapes, scales = coupled(real, gamma)
    swinging = np.flatnonzero(values.imag > 0)
    if seen[-1] >= len(swinging):
        raise NoModesError(
            "with story dashpots that give the measured damping ratios one of those modes would not swing any more; "
            "use modal damping in their place"
        )
    own = swinging[seen]
    s, a = values[own], scales[own]
    drifts = np.diff(shapes[:, own], axis=0, prepend=0.0)
    ds = -(s * drifts**2 / a).T
    size = np.abs(s)[:, None]
    toward = np.real(np.conj(s)[:, None] * ds)
    return -s.real / np.abs(s), -ds.real / size + s.real[:, None] * toward / size**3


def rayleigh(real: Modes, ratios: Ratios, backend: Backend) -> Floats:
    """Find a, b >= 0 of C = a M + b K from zeta_i = a / (2 omega_i) + b omega_i / 2, by weighted least squares.

    Raises
    ------
    UnsuitableError
        If fewer than two modes have a measured ratio.
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
