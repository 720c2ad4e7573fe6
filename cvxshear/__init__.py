"""cvxshear: floor masses and story stiffnesses of shear-type frames from measured modes.

>>> import cvxshear
>>> found = cvxshear.identify(cvxshear.load("paper"), method="two-stage")
>>> [round(float(k) / 1000, 1) for k in found.parts[0].frame.story_stiffness]
[25.5, 25.2]
"""

from cvxshear import backends, effects, priors, showing
from cvxshear.errors import CvxshearError, InfeasibleError, InputError, NoSolutionError, UnsuitableError
from cvxshear.experiment import Configuration, Experiment, Frame
from cvxshear.formats.toml import load
from cvxshear.identification import Identification, identify
from cvxshear.loop import Closure, close_loop
from cvxshear.priors import Prior
from cvxshear.studies.backends import Comparison, compare_backends

__version__ = "0.1.0"

showing.shown_by("cvxshear.report.show")

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
