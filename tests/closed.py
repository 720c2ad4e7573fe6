"""Loops that tests of several files look at, closed once a process."""

from functools import cache

import numpy as np

import cvxshear
from cvxshear.loop import Closure
from tests.fe.experiments import simulated


@cache
def paper(*effects: str) -> Closure:
    """The published frame; every effect is looked for where none is named."""
    return cvxshear.close_loop(cvxshear.load("paper"), effects=effects or None)


@cache
def spring(*effects: str) -> Closure:
    """Four stories, three tests and a spring to the ground, with these effects looked for."""
    declared, _ = simulated("ground_spring", stories=4, configurations=3, rng=np.random.default_rng(4))
    return cvxshear.close_loop(cvxshear.Experiment.from_dict(declared), effects=effects)
