"""Try one model of discrepancy in place of the discount for many causes: `python -m tests.studies discrepancy SEED`.

The open classes of stiffness and inertia, and those of changes and loads in each state, are always part of the
covariance of the residual, with a fifth of their usual size and a probability of 0.9. The sets that a search visited
get this evidence, by the linearised model at their fits, and the discount is left out. For each frame the table has the
probability of every cause of the verdict: with the discount, without it, and with the discrepancy in its place.
"""

import dataclasses
import sys

import numpy as np

from cvxshear import Experiment
from cvxshear.effects import LocatedEffect, open_classes
from cvxshear.fit.gaussian import gains_by_size
from cvxshear.loop import close, posterior
from tests.studies import calibration, outside
from tests.studies.timing import table

SHARE, SIZE = 0.9, 0.2
ALWAYS = ("other_stiffness", "other_inertia", "other_changes", "other_loads")
PILES = ("eccentric panel", "soft at large amplitude", "water as a load", "warm upper stories")
KNOWN = (("base_rocking", 1), ("axial_columns", 1), ("story_change", 3))


def with_discrepancy(model):
    """Add the logarithm of the factor by which the discrepancy raises the evidence of a set."""
    estimate = model.estimate
    classes = [each.bound(estimate.experiment) for each in open_classes() if each.name in ALWAYS]
    placed = [
        LocatedEffect(each.bound_at(estimate.experiment, place), place)
        for each in classes
        if not each.unavailable(estimate.experiment)
        for place in each.places(estimate.experiment)
    ]
    placed = [each for each in placed if each not in model.effects]
    at, sizes = estimate.fit.at, np.concatenate([estimate.misfit.expectation.of(each) for each in placed])
    columns = np.zeros((len(at.r), len(sizes)))
    columns[: at.measured] = SIZE * sizes * estimate.misfit.slopes_by(estimate.theta, placed)
    reached = at.J @ estimate.free_directions
    columns -= reached @ (reached.T @ columns)
    gain = float(gains_by_size(-(columns.T @ at.r), columns.T @ columns, np.zeros(1))[0])
    more = np.logaddexp(np.log1p(-SHARE), np.log(SHARE) + gain)
    return dataclasses.replace(model, log_evidence=model.log_evidence + float(more))


def told(models, looked_for, many):
    """Say the causes of the verdict with their probabilities, if so many kinds of causes are discounted."""
    kept, posterior.MANY_CAUSES = posterior.MANY_CAUSES, many
    try:
        found = posterior.Posterior(models, looked_for)
        return ", ".join(sorted(f"{each.label} {found.of_effects[each]:.1%}" for each in found.verdict_set())) or "none"
    finally:
        posterior.MANY_CAUSES = kept


def main(seed=77):
    frames = [(kind, outside.simulated(kind, 1000 * seed)[0]) for kind in PILES]
    trials = [calibration.Trial((name,), tests, 1000 * seed + i) for i, (name, tests) in enumerate(KNOWN)]
    frames += [(each.effects[0], calibration.experiment_of(each)[0]) for each in trials]
    rows = []
    for name, declared in frames:
        experiment = Experiment.from_dict(declared)
        wanted, _ = close.hypotheses.able_to_take_part(close.hypotheses.chosen(None, experiment), experiment)
        searches = close.Searches(experiment, wanted, (), close.backends.get("auto")).run()
        looked_for = searches[0].fitter.hypotheses
        models = [model for each in searches for model in each.visited.values() if np.isfinite(model.score)]
        always = [with_discrepancy(model) for model in models]
        rows.append([name, told(models, looked_for, 3), told(models, looked_for, 99), told(always, looked_for, 99)])
    table("Causes of the verdict", ["frame", "discount", "without", "discrepancy"], rows)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
