"""Shapes that are less accurate than was declared: those of one state, those at one floor, or all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.effects.base import Parameter, Place
from cvxshear.effects.open_class import OpenClass
from cvxshear.effects.state import Scale, State
from cvxshear.measurement.experiment import Configuration, Experiment, Tested
from cvxshear.util.typing import Bools, Floats, Ints


class OtherShapes(OpenClass):
    """Every shape entry of one state, of one floor, or every one at all, has an error beyond its standard deviation.

    An error of every entry, normal about zero with one common size s in declared standard deviations, is the same as a
    standard deviation that is larger by sqrt(1 + s^2). So the class has no parameters but that factor; log s is normal
    about 0 with a standard deviation of 1.5.
    """

    name = "other_shapes"
    summary = "The shapes of one state, or at one floor, are less accurate than their standard deviation says."
    formula = "standard deviation of the shape entries of one state, of one floor or of all times an unknown factor"
    source = "a sensor on a soft bracket or that came loose, a clock, a mode that was not separated"
    stage = "shape"
    probability = 0.01
    rescales = True
    sits_at = ("floor", "state")
    holds_in_words = "that the shapes are as accurate as their standard deviations"

    def entries(self, experiment: Experiment) -> Sequence[Parameter]:
        return []

    def usual_size(self, scale: Scale) -> float:
        return 1.0

    def lacks(self, experiment: Experiment) -> str:
        return "" if self.places(experiment) else "shapes of a declared accuracy, or of several states"

    def places(self, experiment: Experiment) -> list[Place]:
        """Each state with shapes, each floor with a sensor, and all at once, as far as an accuracy was declared.

        One that was not is estimated anyway.
        """
        shown = [each for each in experiment.configurations if each.measured.any() and each.mode_shape_std is not None]
        states = dict.fromkeys(each.state for each in shown)
        floors = sorted({int(floor) for each in shown for floor in each.measured_floors})
        several = [Place(state=state) for state in states] if len(states) > 1 else []
        single = [Place(floor=floor) for floor in floors] if len(floors) > 2 else []
        return [*several, *single, *([Place()] if shown else [])]

    def rescaled(self, tested: Tested, noise: str, floors: Ints, place: Place) -> Bools:
        declared = isinstance(tested, Configuration) and tested.mode_shape_std is not None
        here = declared and noise == "mode_shape" and place.state in (None, tested.state)
        return (floors == place.floor) & here if place.floor is not None else np.full(len(floors), here)

    def apply(self, state: State, place: Place, values: Floats, own: slice) -> State:
        # It changes how much the shapes count, not what they are.
        return state

    def phrase(self, place: Place, values: Floats, std: Floats, scale: Scale, units: Sequence[str]) -> str:
        whose = f"the shapes at floor {place.floor}" if place.floor is not None else "the shapes"
        where = f'{whose} of "{place.state}"' if place.state is not None else whose
        return f"{where} are less accurate than their standard deviation says, in no way that the catalogue holds"
