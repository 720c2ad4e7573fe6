"""What stands in the report of a closed loop besides its description: drawings, versions, the whole result as JSON."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from importlib import metadata

from cvxshear.backends import Comparison
from cvxshear.loop import Closure
from cvxshear.report import motion
from cvxshear.report.describe import describe
from cvxshear.report.describe.headline import headline
from cvxshear.response.fitted import without_nan
from cvxshear.util.quantities import AUTOMATIC, Units, capital
from cvxshear.util.text import json_text
from cvxshear.util.typing import Json
from cvxshear.version import __version__

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

CAPTIONS = {
    "ranking": (
        "How probable each effect is before and with the data; the numbers are in the table above.",
        "How probable each effect is: before the data (hollow diamonds) and with them (dots). Beyond the dotted line "
        "an effect is more probable than not.",
    ),
    "residual": (
        "Residual of each part of the measurement in standard deviations, before and after; the numbers are in the "
        "tables above.",
        "The residual of every part of the measurement before (hollow diamonds) and after (dots), both in standard "
        "deviations of the final model's noise. Within the grey band it is what noise alone makes.",
    ),
    "frame": (
        "The frame to scale with its identified masses and stiffnesses; the numbers are in the table above.",
        "The frame, heights to scale; a slab is the thicker the heavier its floor, a column the wider the stiffer its "
        "story.",
    ),
    "shapes": (
        "Measured mode shapes with error bars beside those of the first and of the final model.",
        "Each measured mode: dots with error bars are measured, the dashed line is the first model, the frame is the "
        "final model.",
    ),
    "mac": (
        "Modal assurance criterion of every measured mode with every mode of the final model.",
        "The modal assurance criterion (1 for the same shape, 0 for unrelated ones): light on the diagonal and dark "
        "beside it means that every mode was recognised.",
    ),
    "backends": (
        "Differences between the backends and their times; the numbers are in the table that follows.",
        "Left: how far each backend's answer is from the closed form (from the median of all where a bound is active). "
        "Right: its time over that of the closed form, on this machine.",
    ),
}
"""For each figure what it is to whoever cannot see it, and what stands below it."""

FIGURES_OF = {"candidates": ("ranking",), "residual": ("residual",), "frame": ("frame",)}
"""The figures that close a section."""


def contents(result: Closure, comparison: Comparison, command: str, units: Units = AUTOMATIC) -> Json:
    """Everything that the template puts on the page but the figures.

    Parameters
    ----------
    result : Closure
    comparison : Comparison
        Of every backend on the programs of the same experiment.
    command : str
        What was typed to make the report.
    units : Units, optional
        In which quantities are shown.
    """
    return {
        "document": describe(result, units),
        "headline": capital(headline(result)),
        "verdict": result.verdict,
        "captions": CAPTIONS,
        "figures_of": FIGURES_OF,
        "backends": describe(comparison)["worst"],
        "left_out": comparison.left_out,
        "motion": motion.drawings(result),
        "motion_size": (motion.WIDTH, motion.HEIGHT),
        "versions": list(versions()),
        "command": command,
        "experiment_json": readable_json(without_nan(result.experiment.to_dict())),
        "result_json": readable_json(result.to_dict()),
    }


def readable_json(value: object) -> str:
    """JSON that a person can read."""
    return json_text(value, indent=1)


def versions() -> Iterator[tuple[str, str]]:
    """Names and versions of what computed the result."""
    yield "cvxshear", __version__
    yield "Python", platform.python_version()
    for name in PACKAGES:
        try:
            yield name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
