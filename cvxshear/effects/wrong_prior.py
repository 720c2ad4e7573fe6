"""A declared statement with a standard deviation that does not hold."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Self

import numpy as np

from cvxshear.effects.base import Effect, Parameter, Place
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment
from cvxshear.util.typing import Floats


class WrongPrior(Effect):
    """Every residual of one soft prior, or of a total mass with a standard deviation, is off by a number of its own.

    Those numbers, in standard deviations of the statement, are normal about zero with one common size: the same as a
    standard deviation that is larger by that factor.

    Expected size: five times the declared standard deviation, between 2 and 14 times in two thirds of all cases; who
    judges "within 2 %" from drawings is wrong by 10 % now and then. One statement in thirty does not hold.
    """

    name = "wrong_prior"
    summary = "A statement that was declared with a standard deviation is wrong by several times that."
    formula = "residual of the prior - e, e normal about 0 with a standard deviation of about 5"
    source = "design values and judgement that do not hold for the frame as built"
    stage = "story"
    common_size = True
    size_width = 1.0
    probability = 0.03
    parameters: tuple[Parameter, ...] = ()

    def places(self, experiment: Experiment) -> list[Place]:
        return [Place(prior=words) for words, rows in experiment.soft_statements if rows]

    def lacks(self, experiment: Experiment) -> str:
        return "" if self.places(experiment) else "a prior with a standard deviation"

    def bound_at(self, experiment: Experiment, place: Place) -> Self:
        own = copy.copy(self)
        rows = dict(experiment.soft_statements)[str(place.prior)]
        own.parameters = tuple(Parameter(f"e{i}" if rows > 1 else "e", "") for i in range(1, rows + 1))
        return own

    def sizes(self, scale: Scale) -> Floats:
        return np.full(len(self.parameters), 5.0)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        # It acts on the prior that its place names, not on the frame.
        return state

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        largest = float(np.max(np.abs(values)))
        return f'the statement "{place.prior}" is wrong by {largest:.1f} of its standard deviations'
