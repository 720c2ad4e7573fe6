"""A known floor ratio as a further prior: the drawings say that floor 1 is twice as heavy as floor 3."""

from pathlib import Path

import cvxshear
from cvxshear.priors import Ratio

experiment = cvxshear.load(Path(__file__).with_name("noisy_three_story.toml"))
exact = Ratio("floor_mass", of=1, to=3, value=2.0)
nearly = Ratio("floor_mass", of=1, to=3, value=2.0, std=0.02)

for name, priors in (("no prior", []), ("within 2 %", [nearly]), ("exact", [exact])):
    mass = cvxshear.identify(experiment, method="two-stage", priors=priors).frame.floor_mass
    print(f"{name:10s} m = {mass.round(2)} kg, m1 / m3 = {mass[0] / mass[2]:.3f}")
