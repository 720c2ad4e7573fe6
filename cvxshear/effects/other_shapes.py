"""Shapes of one state that are less accurate than was declared, or than those of the other states."""

from __future__ import annotations

from collections.abc import Sequence

from cvxshear.effects.base import Parameter, Place
from cvxshear.effects.open_class import OpenClass
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Experiment, Tested
from cvxshear.util.quantities import with_std
from cvxshear.util.typing import Floats


class OtherShapes(OpenClass):
    """Every shape entry of one state has an error beyond its standard deviation.

    An error of every entry, normal about zero with one common size, is the same as a standard deviation that is larger
    by a factor. So the class has no parameters but that factor, which is its common size.
    """

    name = "other_shapes"
    summary = "The shapes of one state are less accurate than their standard deviation says."
    formula = "standard deviation of the shapes of one state times an unknown factor"
    source = "sensors that came loose, a clock, a mode that was not separated"
    stage = "shape"
    rescales = True
    sits_at = ("state",)
    holds_in_words = "that the shapes are as accurate as their standard deviations"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return []

    def usual_size(self, of: Scale) -> float:
        return 1.0

    def lacks(self, experiment: Experiment) -> str:
        return "" if self.places(experiment) else "shapes of a declared accuracy, or of several states"

    def places(self, experiment: Experiment) -> list[Place]:
        """States with shapes; where no accuracy was declared only those that differ from others can be told."""
        shown = [each for each in experiment.configurations if each.measured.any()]
        declared = any(each.mode_shape_std is not None for each in shown)
        states = dict.fromkeys(each.state for each in shown)
        return [Place(state=state) for state in states] if declared or len(states) > 1 else []

    def rescales_datum(self, tested: Tested, noise: str, place: Place) -> bool:
        return noise == "mode_shape" and tested.state == place.state

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        # It changes how much the shapes count, not what they are.
        return state

    def phrase(self, place: Place, values: Floats, std: Floats, of: Scale, units: Sequence[str]) -> str:
        where = f'the shapes of "{place.state}"'
        if not len(values):
            return f"{where} are less accurate than their standard deviation says"
        return f"{where} are less accurate than declared, by a factor of {with_std(float(values[0]), float(std[0]), '')}"
