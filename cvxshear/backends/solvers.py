"""The solvers that backends are made of: what each is called where, whether it is installed, and how to get it.

All of this is told without importing any of them, which takes seconds for all together.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import metadata, util


@dataclass(frozen=True)
class Solver:
    """A solver that qpsolvers or cvxpy can call.

    Parameters
    ----------
    name : str
        Of the backend.
    module : str
        What Python imports.
    package : str
        What pip installs.
    through : str
        The package that calls it, "qpsolvers" or "cvxpy".
    """

    name: str
    module: str
    package: str
    through: str = "qpsolvers"

    @property
    def installed(self) -> bool:
        """Whether it, and the package that calls it, are there to be imported."""
        return _found(self.module) and _found(self.through)

    @property
    def version(self) -> str | None:
        """Its version; None where it is not installed, and where its package does not tell."""
        return version(self.package)

    @property
    def how_to_get(self) -> str:
        """The command that installs it."""
        missing = [name for name, module in ((self.through, self.through), (self.package, self.module))
                   if not _found(module)]  # fmt: skip
        return f"pip install {' '.join(missing)}"


def _found(module: str) -> bool:
    return util.find_spec(module) is not None


def version(package: str) -> str | None:
    """The version of an installed package, None where there is none."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


THROUGH_QPSOLVERS = tuple(
    Solver(*each)
    for each in (
        ("clarabel", "clarabel", "clarabel"),
        ("copt", "coptpy", "coptpy"),
        ("cvxopt", "cvxopt", "cvxopt"),
        ("daqp", "daqp", "daqp"),
        ("ecos", "ecos", "ecos"),
        ("gurobi", "gurobipy", "gurobipy"),
        ("highs", "highspy", "highspy"),
        ("jaxopt_osqp", "jaxopt", "jaxopt"),
        ("kvxopt", "kvxopt", "kvxopt"),
        ("mosek", "mosek", "mosek"),
        ("osqp", "osqp", "osqp"),
        ("piqp", "piqp", "piqp"),
        ("proxqp", "proxsuite", "proxsuite"),
        ("pyqpmad", "pyqpmad", "pyqpmad"),
        ("qpalm", "qpalm", "qpalm"),
        ("qpax", "qpax", "qpax"),
        ("qtqp", "qtqp", "qtqp"),
        ("quadprog", "quadprog", "quadprog"),
        ("scs", "scs", "scs"),
        ("sip", "sip_qp_python", "sip-qp-python"),
    )
)
"""Those of qpsolvers that pip can install, under their names there."""

THROUGH_CVXPY = tuple(Solver(f"cvxpy-{name}", name, name, "cvxpy") for name in ("clarabel", "osqp", "scs"))
