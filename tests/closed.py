"""Compute loops, modes of records and studies once for tests in several files and for pages of the docs."""

import numpy as np

import cvxshear
from cvxshear import records
from cvxshear.loop import LoopResult
from cvxshear.paper import scatter as paper_study
from tests.docs.runner import once
from tests.fe.experiments import simulated

close_loop, identify_modes = once(cvxshear.close_loop), once(records.identify_modes)
noise_study, six_story_study = once(paper_study.noise_study), once(paper_study.six_story_study)


def built_in(name: str) -> LoopResult:
    """Return the loop of a built-in frame with every effect considered."""
    return close_loop(cvxshear.load(name))


def paper(*effects: str) -> LoopResult:
    """Return the loop of the published frame with these effects, by default all."""
    return close_loop(cvxshear.load("paper"), effects=effects or None)


def spring(*effects: str) -> LoopResult:
    """Return the loop of four stories, three tests and a spring to the ground, with these effects considered."""
    declared, _ = simulated("ground_spring", stories=4, configurations=3, rng=np.random.default_rng(4))
    return close_loop(cvxshear.Experiment.from_dict(declared), effects=effects)
