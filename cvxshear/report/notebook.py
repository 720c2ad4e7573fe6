"""Results that show themselves in a notebook: short tables, where jinja2 is installed."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from cvxshear.backends import Comparison
from cvxshear.identification import Identification, IdentifiedFrame
from cvxshear.loop import Closure
from cvxshear.quantities import percent, scaled, significant, with_std
from cvxshear.typing import Json

if TYPE_CHECKING:
    from jinja2 import Template


def identification_html(result: Identification) -> str | None:
    """The frames and their errors; None where jinja2 is not installed."""
    parts = [
        {
            "title": part.name or "all configurations together",
            "rows": _frame_rows(part.frame),
            "note": f"largest frequency error {percent(part.fit.max_frequency_error)}, "
            f"smallest MAC {significant(part.fit.min_mac, 6)}, {part.iterations} iterations",
        }
        for part in result.parts
    ]
    return _page(
        {"title": f"{result.experiment.name}: method {result.method}, backend {result.backend}", "parts": parts}
    )


def closure_html(result: Closure) -> str | None:
    """The verdict, before and after, and the frame; None where jinja2 is not installed."""
    from cvxshear.report.loop_terminal import headline  # noqa: PLC0415 - loads rich, which a notebook may do without

    before, after = result.before.to_dict(), result.after.to_dict()
    errors = [
        {"place": label, "cells": [percent(before[key]), percent(after[key])]}
        for key, label in (
            ("max_frequency_error", "largest frequency error"),
            ("held_out_frequency_error", "largest held-out frequency error"),
            ("max_shape_error", "largest shape error"),
        )
    ]
    parts = [
        {"title": "", "head": ["error", "before", "after"], "rows": errors, "note": ""},
        {"title": "the identified frame", "rows": _frame_rows(result.frame), "note": ""},
    ]
    return _page({"title": f"{result.verdict.upper()}: {headline(result)}", "parts": parts})


def comparison_html(result: Comparison) -> str | None:
    """One row a backend and kind of program; None where jinja2 is not installed."""
    rows = [
        {
            "place": f"{row.kind}, {row.backend}",
            "cells": ["not solved", ""]
            if row.failure
            else [f"{row.difference or 0.0:.1e}", significant(row.relative_time, 2)],
        }
        for row in result.rows
    ]
    head = ["program, backend", "largest difference", "time / time of kkt"]
    parts = [{"title": "", "head": head, "rows": rows, "note": result.left_out}]
    return _page({"title": f"{result.experiment}: backends on the same programs", "parts": parts})


def _frame_rows(frame: IdentifiedFrame) -> list[Json]:
    factor, unit = scaled(frame.story_stiffness.tolist(), "N/m")
    rows: list[Json] = []
    for i in reversed(range(len(frame.floor_mass))):
        mass_std, stiffness_std = (
            None if std is None else float(std[i]) for std in (frame.floor_mass_std, frame.story_stiffness_std)
        )
        mass = with_std(float(frame.floor_mass[i]), mass_std, "kg")
        stiffness = with_std(float(frame.story_stiffness[i]), stiffness_std, unit, factor)
        rows.append({"place": str(i + 1), "cells": [mass, stiffness]})
    return rows


def _page(values: Json) -> str | None:
    template = _template()
    return None if template is None else template.render(frame_head=["floor / story", "mass", "stiffness"], **values)


@cache
def _template() -> Template | None:
    """The template; None where jinja2 is not installed, and a notebook then shows the plain text."""
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415
    except ImportError:
        return None
    environment = Environment(
        loader=PackageLoader("cvxshear.report", "templates"), autoescape=True, undefined=StrictUndefined
    )
    return environment.get_template("notebook.html")
