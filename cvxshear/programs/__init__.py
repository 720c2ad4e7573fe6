"""The least-squares programs of the identification, in the one form that every backend takes.

>>> import cvxshear
>>> program = cvxshear.programs.story_stiffnesses("paper", [12.7, 18.6], configuration="Structure 1")
>>> [round(float(k) / 1000, 1) for k in program.solve("clarabel").x]
[25.5, 25.0]
"""

from cvxshear.programs.certificate import Acceptance, ActiveConstraint, Certificate, MatrixInequality
from cvxshear.programs.constraints import NamedConstraints, constrained
from cvxshear.programs.formulations import mass_correction, one_shot_masses, story_stiffnesses
from cvxshear.programs.least_squares import LeastSquares, Solution

__all__ = [
    "Acceptance", "ActiveConstraint", "Certificate", "LeastSquares", "MatrixInequality", "NamedConstraints",
    "Solution", "constrained", "mass_correction", "one_shot_masses", "story_stiffnesses",
]  # fmt: skip
