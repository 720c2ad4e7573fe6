"""What is known of the frame that its data cannot show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cvxshear.identification.efficient import Estimate
from cvxshear.loop.candidates import Candidate


def information(estimate: Estimate, ranking: Sequence[Candidate]) -> tuple[str, ...]:
    """Statements about effects that these data cannot tell from the frame itself, with their size where it is known."""
    said = [
        f"{item.placed.label} cannot be told from {_some(item.confounded_with)} by these data"
        for item in ranking
        if item.confounded_with
    ]
    said += [f"{item.placed.label} could not be fitted ({item.failure})" for item in ranking if item.failure]
    said += _implied_noise(estimate)
    weight = _gravity(estimate)
    return (*said, weight) if weight else tuple(said)


def _implied_noise(estimate: Estimate) -> list[str]:
    """What the residual says of the measurement's accuracy, where that was not declared."""
    if estimate.experiment.noise_declared or not estimate.dof > 0:
        return []
    scale = estimate.noise_scale
    frequency = max(float(each.log_frequency_std.max()) for each in estimate.experiment.configurations)
    return [
        f"the verdict takes frequencies to be uncertain to {100 * scale * frequency:.2g} %, as the residual says; if "
        "yours are surer, declare frequency_std and mode_shape_std, and the residual is tested against them"
    ]


def _some(names: Sequence[str]) -> str:
    """A few of the names."""
    shown = ", ".join(names[:3])
    return shown if len(names) <= 3 else f"{shown} and {len(names) - 3} more"


def _gravity(estimate: Estimate) -> str:
    """How much of a story's stiffness the weight above takes, where heights are declared and no gravity is fitted."""
    experiment = estimate.experiment
    heights = experiment.frame.story_heights
    n = experiment.stories
    if heights is None or any(placed.effect.name == "gravity" for placed in estimate.effects):
        return ""
    mass, stiffness = estimate.theta[:n], estimate.theta[n : 2 * n]
    shares = []
    for each in experiment.configurations:
        load = experiment.frame.gravity * np.cumsum((mass + each.added_mass)[::-1])[::-1]
        shares.append(float(np.max(load / heights / (stiffness + load / heights))))
    if max(shares) <= 0 or not np.isfinite(max(shares)):
        return ""
    return (
        f"the weight above takes up to {100 * max(shares):.2g} % of a story's stiffness (P/h, up to 6/5 of it for "
        "columns that bend); the stiffnesses given are what is left"
    )
