"""Base class of priors: an exact or soft statement about the floor masses or the story stiffnesses.

A prior of one's own is a subclass of `Prior` that overrides `constraints` (an exact statement) or
`residual` (a soft one). A subclass that sets `kind` and is a dataclass can be named in a measurement file.
"""

from __future__ import annotations

import dataclasses
from abc import ABC
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from cvxshear.util import checks, quantities
from cvxshear.util.errors import InputError
from cvxshear.util.results import fields_as_table
from cvxshear.util.typing import Floats, Json

QUANTITY_UNITS = {"floor_mass": "kg", "story_stiffness": "N/m"}
#: Quantities that priors speak of, with their units.
QUANTITIES = tuple(QUANTITY_UNITS)

#: Sizes of masses (kg), stiffnesses (N/m) and dashpots for the checks of a user's prior, from bench models to towers.
#: The checks compare its residual and derivative at the size with the smallest residual.
SIZES = (1.0, 1e2, 1e4, 1e6, 1e8)


@dataclasses.dataclass(frozen=True, eq=False)
class Constraints:
    """Exact linear statements about one vector x of length N.

    Parameters
    ----------
    lower, upper : ndarray, shape (N,), optional
        lower <= x <= upper; infinite where there is no bound.
    G, h : ndarray, shapes (g, N) and (g,), optional
        G x <= h.
    A, b : ndarray, shapes (a, N) and (a,), optional
        A x = b.
    """

    lower: Floats | None = None
    upper: Floats | None = None
    G: Floats | None = None
    h: Floats | None = None
    A: Floats | None = None
    b: Floats | None = None

    def __post_init__(self) -> None:
        for matrix, side in (("G", "h"), ("A", "b")):
            rows, values = getattr(self, matrix), getattr(self, side)
            if (rows is None) != (values is None):
                raise InputError(f"Constraints: {matrix} and {side} belong together; give both or neither")
            if rows is not None and (np.ndim(rows) != 2 or np.shape(values) != np.shape(rows)[:1]):
                raise InputError(
                    f"Constraints: {matrix} must have the shape (rows, N) and {side} the shape (rows,), "
                    f"not {np.shape(rows)} and {np.shape(values)}"
                )

    def check(self, size: int, where: str) -> None:
        """Raise `InputError` where the statements are not about a vector of `size` real numbers; `where` names them."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is None:
                continue
            array = checks.real(value, f"{where}: its {field.name}")
            if field.name not in {"h", "b"} and array.shape[-1:] != (size,):
                raise InputError(
                    f"{where}: its {field.name} has the shape {array.shape}, where the last length must be {size}"
                )
            missing = {"lower": -np.inf, "upper": np.inf}.get(field.name)
            wrong = ~np.isfinite(array) & (array != missing)
            if wrong.any():
                raise InputError(f"{where}: its {field.name} must hold finite numbers, not {array[wrong][0]}")


class Prior(checks.ReadOnlyArrays, ABC):
    """A statement about the floor masses (without added mass), the story stiffnesses or the story dashpots.

    Attributes
    ----------
    kind : str
        The word for it in a measurement file; empty where it has none.
    quantity : str
        "floor_mass" (kg) or "story_stiffness" (N/m).
    """

    kind: ClassVar[str] = ""
    kinds: ClassVar[dict[str, type[Prior]]] = {}
    quantity: str

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        kind = cls.__dict__.get("kind")  # an inherited kind stays the parent's
        if not kind:
            return
        taken = Prior.kinds.get(kind)
        # The same class may come again: a notebook cell run twice, a dataclass with slots.
        if taken is not None and (taken.__module__, taken.__name__) != (cls.__module__, cls.__name__):
            raise InputError(f"the prior kind {kind!r} is already {taken.__name__}'s; give {cls.__name__} another")
        Prior.kinds[kind] = cls

    @staticmethod
    def from_dict(declared: object) -> Prior:
        """Read the prior that a table of a measurement file declares.

        Parameters
        ----------
        declared : dict
            The key `kind`, and the keys of that kind.

        Raises
        ------
        InputError
            Where a key is unknown or missing, or a value is wrong.
        """
        if not isinstance(declared, Mapping):
            raise InputError(f"a prior must be a table of keys and values, not {checks.shown(declared)}")
        if "kind" not in declared:
            raise InputError(f"the key 'kind' is missing; it is one of {', '.join(Prior.kinds)}")
        cls = Prior.kinds[checks.choice(declared["kind"], list(Prior.kinds), "kind")]
        if not dataclasses.is_dataclass(cls):
            raise InputError(f"the {cls.kind} prior cannot be named in a file: {cls.__name__} is not a dataclass")
        fields = [field for field in dataclasses.fields(cls) if field.init and field.name != "kind"]
        required = [each.name for each in fields if each.default is each.default_factory is dataclasses.MISSING]
        names = [field.name for field in fields]
        table = checks.keys(declared, ["kind", *names], required, f"the {cls.kind} prior")
        given = {key: table[key] for key in names if key in table}
        return cls(**{key: value for key, value in given.items() if value is not None or key in required})

    def to_dict(self) -> Json:
        """Return the table that declares this prior in a measurement file."""
        table = fields_as_table(self, empty=True) if dataclasses.is_dataclass(self) else {"quantity": self.quantity}
        return {"kind": self.kind or type(self).__name__, **table}

    @property
    def fixes_scale(self) -> bool:
        """Whether it alone tells how heavy or how stiff the frame is, and not only how it is distributed."""
        return False

    def suggested(self, stories: int) -> Floats | None:
        """Values from which a fit may start, shape (N,), up to a common factor unless `fixes_scale`.

        nan on floors or stories that the prior says nothing of; None, the default, where it suggests no value.
        """
        return None

    def check(self, stories: int) -> None:
        """Raise `InputError` if the prior does not fit the frame's number of stories."""

    def constraints(self, stories: int) -> Constraints:
        """Return the exact statements for a frame of the given number of stories; empty by default."""
        return Constraints()

    def residual(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the soft statements at `x`: their errors in standard deviations, and the derivative.

        Parameters
        ----------
        x : ndarray, shape (N,)
            The quantity, kg or N/m.

        Returns
        -------
        r : ndarray, shape (p,)
            Errors divided by their standard deviations; none by default.
        J : ndarray, shape (p, N)
            dr/dx.
        """
        return np.zeros(0), np.zeros((0, len(x)))

    def describe(self) -> str:
        """Say the statement in words, for messages and reports."""
        return f"{self.kind or type(self).__name__} on {self.quantity}"


def check_quantity(prior: Prior) -> None:
    """Raise `InputError` unless the prior's quantity is one that a frame has."""
    checks.choice(getattr(prior, "quantity", None), QUANTITIES, f"quantity of the {_name(prior)} prior")


def check_prior(prior: Prior, stories: int) -> None:
    """Raise `InputError` if a prior does not fit the frame's number of stories, or breaks the rules of priors.

    Of a user's prior, `constraints` and `residual` must return real, finite numbers of the right shapes, and the
    derivative must agree with central differences in two random directions. The library's own priors skip this check.

    Parameters
    ----------
    prior : Prior
    stories : int
    """
    check_quantity(prior)
    prior.check(stories)
    if type(prior).__module__.startswith("cvxshear.priors."):
        return
    name = f"the {_name(prior)} prior on {prior.quantity}"
    try:
        said = prior.constraints(stories)
    except Exception as error:
        raise InputError(f"{name}: constraints({stories}) raised {type(error).__name__}: {error}") from error
    if not isinstance(said, Constraints):
        raise InputError(f"{name}: constraints must return a Constraints, not {checks.shown(said)}")
    said.check(stories, name)
    _check_residual(prior, stories, name)


def _check_residual(prior: Prior, stories: int, name: str) -> None:
    """Raise `InputError` where `residual` is not a function of x with its derivative."""
    rng = np.random.default_rng(0)
    spread = rng.uniform(0.8, 1.25, stories)
    tried = [(size * spread, *_evaluated(prior, size * spread, name)) for size in SIZES]
    finite = [each for each in tried if np.all(np.isfinite(each[1])) and np.all(np.isfinite(each[2]))]
    if not finite:
        raise InputError(f"{name}: its residual or derivative is nowhere finite from {SIZES[0]:g} to {SIZES[-1]:g}")
    x, r, J = min(finite, key=lambda each: float(np.max(np.abs(each[1]), initial=0.0)))
    for _ in range(2):
        d = checks.DIFFERENCE_STEP * x * rng.choice([-1.0, 1.0], stories)
        change = 0.5 * (_evaluated(prior, x + d, name)[0] - _evaluated(prior, x - d, name)[0])
        size = np.abs(J) @ np.abs(d) + np.abs(change)
        for entry, row in enumerate(J):
            said = f"{name}: the derivative of entry {entry + 1} of its residual"
            checks.derivative(row @ d, change[entry], size[entry], np.append(r, 1.0), said)


def _evaluated(prior: Prior, x: Floats, name: str) -> tuple[Floats, Floats]:
    """Return the residual and its derivative as real arrays of fitting shapes, or raise `InputError`."""
    given = checks.frozen(x.copy())
    try:
        with np.errstate(all="ignore"):
            found = prior.residual(given)
    except Exception as error:
        raise InputError(f"{name}: residual raised {type(error).__name__}: {error}") from error
    if not isinstance(found, tuple) or len(found) != 2:
        raise InputError(f"{name}: residual must return (r, J), not {checks.shown(found)}")
    r, J = (checks.real(part, f"{name}: {key} of its residual") for key, part in zip("rJ", found, strict=True))
    if r.ndim != 1 or J.shape != (len(r), len(x)):
        raise InputError(
            f"{name}: residual must return r and J of the shapes (p,) and (p, {len(x)}), not {r.shape} and {J.shape}"
        )
    return r, J


def _name(prior: Prior) -> str:
    return prior.kind or type(prior).__name__


def put(prior: Prior, name: str, check: Callable[..., object], **limits: object) -> None:
    """Check a field of one of this library's priors, and put what the check returns in its place."""
    checks.put(prior, name, check, f"{name} of the {prior.kind} prior", **limits)


def check_place(prior: Prior, name: str, stories: int = checks.MOST_STORIES) -> None:
    """Raise `InputError` unless the field holds a floor or story, from 1 to `stories`."""
    put(prior, name, checks.whole, least=1, most=stories)


def check_length(prior: Prior, name: str, stories: int, remedy: str) -> None:
    """Raise `InputError` unless a list in the field has an entry for each floor or story."""
    value = getattr(prior, name)
    if isinstance(value, np.ndarray) and len(value) != stories:
        count = checks.entries(len(value))
        raise InputError(f"{name} of the {prior.kind} prior has {count}, the frame has {stories} stories; {remedy}")


def listed(value: float | Floats, quantity: str) -> str:
    """Write a number or a list of numbers on one line, in the unit of the quantity that fits their size."""
    values = np.ravel(np.asarray(value, dtype=float))
    factor, unit = quantities.fitting(values.tolist(), QUANTITY_UNITS[quantity])
    shown = ", ".join(f"{entry / factor:g}" for entry in values)
    return f"{shown if np.ndim(value) == 0 else f'[{shown}]'} {unit}"


def certainty(std: float | None) -> str:
    """How sure a statement is, in words; nothing where it is exact."""
    return "" if std is None else f" within {100 * std:g} %"
