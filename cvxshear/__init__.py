"""cvxshear: floor masses and story stiffnesses of shear-type frames from measured modes.

>>> import cvxshear
>>> found = cvxshear.identify(cvxshear.load("paper"), method="two-stage")
>>> [round(float(k) / 1000, 1) for k in found.parts[0].frame.story_stiffness]
[25.5, 25.2]
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cvxshear import backends, effects, priors
    from cvxshear.errors import (
        CvxshearError,
        InfeasibleError,
        InputError,
        LostProcessError,
        NoSolutionError,
        UnsuitableError,
    )
    from cvxshear.experiment import Configuration, Experiment, Frame
    from cvxshear.formats.toml import load
    from cvxshear.identification import Identification
    from cvxshear.identification.identify import identify
    from cvxshear.loop import Closure, close_loop
    from cvxshear.priors import Prior
    from cvxshear.studies.backends import Comparison, compare_backends

__version__ = "0.1.0"

__all__ = [
    "Closure",
    "Comparison",
    "Configuration",
    "CvxshearError",
    "Experiment",
    "Frame",
    "Identification",
    "InfeasibleError",
    "InputError",
    "LostProcessError",
    "NoSolutionError",
    "Prior",
    "UnsuitableError",
    "backends",
    "close_loop",
    "compare_backends",
    "effects",
    "identify",
    "load",
    "priors",
]

_PACKAGES = ("backends", "effects", "priors")
_HOMES = {
    "Closure": "loop",
    "Comparison": "studies.backends",
    "Configuration": "experiment",
    "CvxshearError": "errors",
    "Experiment": "experiment",
    "Frame": "experiment",
    "Identification": "identification",
    "InfeasibleError": "errors",
    "InputError": "errors",
    "LostProcessError": "errors",
    "NoSolutionError": "errors",
    "Prior": "priors",
    "UnsuitableError": "errors",
    "close_loop": "loop",
    "compare_backends": "studies.backends",
    "identify": "identification",
    "load": "formats.toml",
}


def __getattr__(name: str) -> Any:
    """What the public names stand for, loaded when first asked for: the solvers load slowly."""
    if name in _PACKAGES:
        return importlib.import_module(f"{__name__}.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
