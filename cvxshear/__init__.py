"""cvxshear: floor masses and story stiffnesses of shear-type frames from measured modes.

>>> import cvxshear
>>> found = cvxshear.identify(cvxshear.load("paper"), method="two-stage")
>>> [round(float(k) / 1000, 1) for k in found.parts[0].frame.story_stiffness]
[25.5, 25.2]
"""

from importlib import import_module
from typing import TYPE_CHECKING

from cvxshear.util.errors import (
    CvxshearError,
    FaultyEffectError,
    InfeasibleError,
    InputError,
    LostProcessError,
    NoModesError,
    NoSolutionError,
    UnsuitableError,
)
from cvxshear.version import __version__ as __version__

if TYPE_CHECKING:
    from cvxshear import backends, effects, priors, programs
    from cvxshear.backends import Comparison
    from cvxshear.fit.identification import compare_backends, identify
    from cvxshear.fit.results import Identification
    from cvxshear.io.toml import load
    from cvxshear.loop import LoopResult
    from cvxshear.measurement.experiment import Configuration, Experiment, Frame
    from cvxshear.planning import plan
    from cvxshear.priors import Prior
    from cvxshear.response import predict, reconstruct
    from cvxshear.screening import close_loop, history

__all__ = [
    "Comparison",
    "Configuration",
    "CvxshearError",
    "Experiment",
    "FaultyEffectError",
    "Frame",
    "Identification",
    "InfeasibleError",
    "InputError",
    "LoopResult",
    "LostProcessError",
    "NoModesError",
    "NoSolutionError",
    "Prior",
    "UnsuitableError",
    "backends",
    "close_loop",
    "compare_backends",
    "effects",
    "history",
    "identify",
    "load",
    "plan",
    "predict",
    "priors",
    "programs",
    "reconstruct",
]  # fmt: skip

#: Where the public names come from. They are imported when they are first asked for (PEP 562): the loop alone brings
#: scipy.stats and joblib, which take longer to load than many a program that needs neither.
_HOMES = {
    name: home
    for home, names in {
        "cvxshear.loop": "LoopResult",
        "cvxshear.backends": "Comparison",
        "cvxshear.measurement.experiment": "Configuration Experiment Frame",
        "cvxshear.fit.identification": "compare_backends identify",
        "cvxshear.fit.results": "Identification",
        "cvxshear.priors": "Prior",
        "cvxshear.io.toml": "load",
        "cvxshear.planning": "plan",
        "cvxshear.response": "predict reconstruct",
        "cvxshear.screening": "close_loop history",
    }.items()
    for name in names.split()
}

if not TYPE_CHECKING:

    def __getattr__(name):
        if name in _HOMES:
            value = getattr(import_module(_HOMES[name]), name)
        elif name in __all__:
            value = import_module(f"cvxshear.{name}")
        else:
            raise AttributeError(f"module 'cvxshear' has no attribute {name!r}")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
