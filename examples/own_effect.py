"""A custom effect: an undeclared brace between two floors."""

import numpy as np

import cvxshear
from cvxshear.effects import Effect, Parameter, catalogue


class Brace(Effect):
    """K + b (e1 - e3)(e1 - e3)'."""

    name = "brace"
    summary = "A brace joins floors 1 and 3."
    formula = "K + b (e1 - e3)(e1 - e3)'"
    source = "linear spring between two floors"
    stage = "spring"
    parameters = (Parameter("b", "N/m", lower=0.0),)
    usual, usual_in = 0.1, "story_stiffness"

    def apply(self, state, place, values, own):
        e = np.zeros(len(state.story_stiffness))
        e[0], e[2] = 1.0, -1.0
        return state.plus_stiffness(values, [np.outer(e, e)], own)


def measured(added):
    """Simulate a test of a four-story frame with a brace of 400 N/m, to the declared noise."""
    M = np.diag(np.array([10.0, 9.0, 8.0, 7.0]) + added)
    k = np.array([2000.0, 1800.0, 1500.0, 1200.0])
    K = np.diag(k + np.append(k[1:], 0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    e = np.array([1.0, 0.0, -1.0, 0.0])
    eigenvalues, shapes = np.linalg.eig(np.linalg.solve(M, K + 400.0 * np.outer(e, e)))
    order = np.argsort(eigenvalues)
    shapes = (shapes / np.abs(shapes).max(axis=0))[:, order].T
    return {
        "added_mass": list(added),
        "frequencies": (np.sqrt(eigenvalues[order]) / (2 * np.pi) * (1 + 0.001 * random.standard_normal(4))).tolist(),
        "mode_shapes": (shapes + 0.01 * random.standard_normal((4, 4))).tolist(),
        "frequency_std": 0.001,
        "mode_shape_std": 0.01,
    }


random = np.random.default_rng(0)
experiment = cvxshear.Experiment.from_dict(
    {
        "frame": {"total_mass": 34.0, "story_heights": 0.5},
        "configuration": [measured(np.zeros(4)), measured(np.array([4.0, 0.0, 0.0, 3.0]))],
    }
)
closure = cvxshear.close_loop(experiment, effects=[*catalogue(), Brace()])
for found in closure.effects:
    print(f"{found.placed.label}: b = {found.parameters['b']:.0f} ± {found.std['b']:.0f} N/m")
