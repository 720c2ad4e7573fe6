"""What stands in the report of a closed loop, as plain values and texts; the template only arranges them."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Iterator
from importlib import metadata

import numpy as np

import cvxshear
from cvxshear.experiment import Configuration
from cvxshear.loop import VERDICTS, Closure
from cvxshear.loop.residual import by_mode
from cvxshear.loop.results import Found
from cvxshear.report import effect_size, motion
from cvxshear.report.loop_terminal import headline
from cvxshear.report.numbers import percent, probability, scaled, significant, with_std
from cvxshear.response.fitted import without_nan
from cvxshear.studies.backends import Comparison
from cvxshear.typing import Json

PACKAGES = (
    "numpy",
    "scipy",
    "qpsolvers",
    "clarabel",
    "cvxpy",
    "osqp",
    "scs",
    "highspy",
    "piqp",
    "proxsuite",
    "quadprog",
    "daqp",
)

ERRORS = (
    ("max_frequency_error", "largest frequency error", percent),
    ("rms_frequency_error", "frequency error, root mean square", percent),
    ("held_out_frequency_error", "largest frequency error, predicted from the other tests", percent),
    ("min_mac", "smallest modal assurance criterion (MAC)", lambda value: significant(value, 6)),
    ("max_shape_error", "largest mode-shape error", percent),
    ("chi2", "chi-square of the residual", significant),
    ("dof", "its degrees of freedom", str),
    ("p_value", "probability of such a residual by chance", probability),
)


def contents(result: Closure, comparison: Comparison, command: str) -> Json:
    """Everything that the template puts on the page but the figures.

    Parameters
    ----------
    result : Closure
    comparison : Comparison
        Of every backend on the programs of the same experiment.
    command : str
        What was typed to make the report.
    """
    return {
        "title": result.experiment.name,
        "verdict": result.verdict,
        "verdict_means": VERDICTS[result.verdict],
        "headline": _sentence(headline(result)),
        "rests_on": result.rests_on,
        "measured": _measured(result),
        "configurations": [_configuration(each) for each in result.experiment.configurations],
        "errors": list(_errors(result)),
        "modes": list(_modes(result)),
        "steps": list(_steps(result)),
        "effects": [_effect(result, found) for found in result.effects],
        "assumed": [placed.label for placed in result.assumed],
        "candidates": list(_candidates(result)),
        "not_considered": result.not_considered,
        "remains": result.remains,
        "information": result.information,
        "undetermined": [" and ".join(names) for names in result.estimate.uncertainty.null_directions],
        "frame": list(_frame(result)),
        "next_test": result.next_test,
        "backends": list(_backends(comparison)),
        "left_out": comparison.left_out,
        "motion": motion.drawings(result),
        "motion_size": (motion.WIDTH, motion.HEIGHT),
        "versions": list(versions()),
        "backend": result.backend,
        "effort": (result.fits, result.programs),
        "command": command,
        "experiment_json": readable_json(without_nan(result.experiment.to_dict())),
        "result_json": readable_json(result.to_dict()),
    }


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def readable_json(value: object) -> str:
    """JSON that a person can read."""
    return json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False)


def _measured(result: Closure) -> list[tuple[str, str]]:
    experiment = result.experiment
    frame = experiment.frame
    heights = frame.story_heights
    rows = [
        ("stories", str(experiment.stories)),
        ("story heights", "not declared" if heights is None else _listed(heights, "m")),
        ("total mass without added mass", "not declared" if frame.known_total is None else f"{frame.known_total:g} kg"),
        ("tested configurations", str(len(experiment.configurations))),
        ("measurement noise", "declared" if experiment.noise_declared else "not declared; its size is estimated"),
    ]
    return rows + [("known beforehand", prior.describe()) for prior in experiment.priors]


def _listed(values: np.ndarray, unit: str) -> str:
    """The values, or the one value that all have."""
    same = bool(np.all(values == values[0]))
    return f"{values[0]:g} {unit} each" if same and len(values) > 1 else f"{', '.join(f'{v:g}' for v in values)} {unit}"


def _configuration(each: Configuration) -> Json:
    """One tested state: what was added, and its modes as measured."""
    largest = np.max(np.abs(np.where(each.measured, each.mode_shapes, 0.0)), axis=1, keepdims=True)
    unit = np.where(largest > 0, largest, 1.0)
    shape_std = each.entry_std / unit
    return {
        "name": each.name,
        "added": _listed(each.added_mass, "kg") if each.added_mass.any() else "none",
        "noise": each.noise_declared,
        "floors": each.measured_floors.tolist(),
        "rows": [
            {
                "mode": int(mode),
                "frequency": significant(float(each.frequencies[j]), 5),
                "std": percent(float(each.log_frequency_std[j])),
                "shape": ["–" if np.isnan(value) else f"{value:+.4f}" for value in each.mode_shapes[j] / unit[j]],
                "shape_std": significant(float(np.max(shape_std[j])), 2),
            }
            for j, mode in enumerate(each.modes)
        ],
    }


def _errors(result: Closure) -> Iterator[Json]:
    before, after = result.before.to_dict(), result.after.to_dict()
    for key, label, written in ERRORS:
        yield {
            "key": key,
            "label": label,
            "before": written(before[key]),
            "after": written(after[key]),
            "before_exact": json.dumps(before[key]),
            "after_exact": json.dumps(after[key]),
        }


def _modes(result: Closure) -> Iterator[Json]:
    for before, after in zip(by_mode(result.before.estimate), by_mode(result.estimate), strict=True):
        yield {
            "configuration": after.configuration,
            "mode": after.mode,
            "frequency": [f"{100 * item.frequency_error:+.2f} %" for item in (before, after)],
            "shape": [percent(item.shape_error) for item in (before, after)],
        }


def _steps(result: Closure) -> Iterator[Json]:
    for step in result.steps:
        quality = step.estimate.quality
        yield {
            "action": _sentence(step.action),
            "tried": str(step.tried) if step.tried else "–",
            "chi2": significant(quality.chi2),
            "dof": quality.dof,
            "p_value": probability(step.p_value),
            "error": percent(quality.max_frequency_error),
            "held_out": percent(step.held_out),
        }


def _effect(result: Closure, found: Found) -> Json:
    kind = found.placed.effect
    return {
        "label": found.placed.label,
        "summary": kind.summary,
        "formula": kind.formula,
        "source": kind.source,
        "parameters": effect_size.summary(found.placed, found.parameters, found.std),
        "size": effect_size.in_words(result.estimate, found.placed),
        "chance": probability(_exp(found.log_p)),
        "rivals": [rival.placed.label for rival in found.rivals],
    }


def _exp(log_p: float) -> float:
    return 0.0 if log_p < -700 else math.exp(log_p)


def _candidates(result: Closure) -> Iterator[Json]:
    for item in result.candidates:
        if item.admissible and item.estimate is not None:
            yield {
                "label": item.placed.label,
                "chi2": significant(item.estimate.chi2),
                "dof": item.estimate.dof,
                "chance": probability(_exp(item.log_p)),
            }


def _frame(result: Closure) -> Iterator[Json]:
    frame = result.frame
    factor, unit = scaled(frame.story_stiffness.tolist(), "N/m")
    for i in reversed(range(len(frame.floor_mass))):
        stds = [None if std is None else float(std[i]) for std in (frame.floor_mass_std, frame.story_stiffness_std)]
        yield {
            "place": i + 1,
            "mass": with_std(float(frame.floor_mass[i]), stds[0], "kg"),
            "stiffness": with_std(float(frame.story_stiffness[i]), stds[1], unit, factor),
        }


def _backends(comparison: Comparison) -> Iterator[Json]:
    """For each backend its worst figures over all programs that it takes."""
    for name in dict.fromkeys(row.backend for row in comparison.rows):
        rows = [row for row in comparison.rows if row.backend == name]
        solved = [row for row in rows if not row.failure]
        failures = {_short(row.failure) for row in rows if row.failure}
        certificates = [
            value
            for row in solved
            for value in (row.primal_residual, row.dual_residual, row.duality_gap)
            if value is not None
        ]
        yield {
            "name": name,
            "solved": f"{sum(row.programs for row in solved)} of {sum(row.programs for row in rows)}",
            "difference": _worst([row.difference for row in solved if row.difference is not None]),
            "certificate": _worst(certificates),
            "remark": "; ".join(sorted(failures)),
        }


def _worst(values: list[float]) -> str:
    return f"{max(values):.1e}" if values else "–"


def _short(failure: str) -> str:
    return "takes no active bound" if "takes equalities only" in failure else failure


def versions() -> Iterator[tuple[str, str]]:
    """Names and versions of what computed the result."""
    yield "cvxshear", cvxshear.__version__
    yield "Python", platform.python_version()
    for name in PACKAGES:
        try:
            yield name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
