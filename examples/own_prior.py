"""A prior of one's own: the two upper floors together were weighed, to 1 %."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import cvxshear
from cvxshear.priors import Prior


@dataclass(frozen=True, eq=False)
class WeighedTogether(Prior):
    """r = (sum of the masses at some floors / their weighed sum - 1) / std."""

    quantity: str
    floors: tuple[int, ...]
    kilograms: float
    std: float

    def residual(self, x):
        row = np.zeros((1, len(x)))
        row[0, np.array(self.floors) - 1] = 1.0 / (self.kilograms * self.std)
        return row @ x - 1.0 / self.std, row

    def describe(self):
        return f"floors {self.floors} weigh {self.kilograms:g} kg together"


experiment = cvxshear.load(Path(__file__).with_name("noisy_three_story.toml"))
weighed = WeighedTogether("floor_mass", floors=(2, 3), kilograms=12.5, std=0.01)

for name, priors in (("not weighed", []), ("weighed", [weighed])):
    mass = cvxshear.identify(experiment, method="two-stage", priors=priors).frame.floor_mass
    print(f"{name:12s} m = {mass.round(2)} kg, m2 + m3 = {mass[1:].sum():.2f} kg")
