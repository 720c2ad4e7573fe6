"""Write reports of a closed loop, of a response and of modes, each as one HTML file that contains its figures."""

import platform
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import metadata
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from cvxshear.backends import Comparison
from cvxshear.fit.identification import compare_backends
from cvxshear.loop import LoopResult
from cvxshear.records import ModalResult
from cvxshear.report.blocks import describe
from cvxshear.report.headline import headline, verdict_of
from cvxshear.util.errors import printable
from cvxshear.util.quantities import capital
from cvxshear.util.results import as_json
from cvxshear.util.typing import Json
from cvxshear.util.writing import json_text
from cvxshear.version import __version__

#: Packages that may compute the numbers of a report; the report lists their versions.
PACKAGES = (
    "numpy", "scipy", "qpsolvers", "clarabel", "cvxpy", "osqp", "scs", "highspy", "piqp", "proxsuite", "quadprog",
    "daqp",
)  # fmt: skip


@cache
def environment() -> Environment:
    """Load the templates of the reports."""
    # Every text is escaped in every template: names and priors come from files.
    found = Environment(
        loader=PackageLoader("cvxshear.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters["printable"] = printable
    return found


def page(template: str, result: Json | list[Json], **contents: Any) -> str:
    """Write a page from its template, with the result as JSON and the versions of all packages.

    Parameters
    ----------
    template : str
        Name of the template.
    result : dict or list
        JSON of the result.
    **contents : object
        Values that the template needs.
    """
    known = {"result_json": json_text(result, indent=1), "versions": list(versions())}
    return environment().get_template(template).render(**contents, **known)


def drawings(*results: Any) -> dict[str, Json]:
    """Draw the animations of these results, then all figures that apply, by name.

    Parameters
    ----------
    *results : object
        Results of one type; most figures show one result.

    Returns
    -------
    dict of str to dict
        `name`, `title`, `caption`, `alternative` and `section` as in the table of figures; `svg`, the drawing;
        `moves`, whether it is an animation.
    """
    # Imported here, because a notebook shows tables without matplotlib.
    from cvxshear.report.figures import animations, style  # noqa: PLC0415

    moving = {each["name"]: each for each in animations(*results)}
    return moving | {
        entry.name: {
            "name": entry.name,
            "title": entry.title,
            "section": entry.section,
            "caption": entry.caption_of(*results),
            "alternative": entry.alternative_of(*results),
            # matplotlib has escaped the texts in a drawing.
            "svg": Markup(style.inline_svg(entry.draw(*results), entry.name)),
            "moves": False,
        }
        for entry in style.applicable(*results)
    }


def versions() -> Iterator[tuple[str, str]]:
    """Yield names and versions of the packages that computed the result."""
    yield "cvxshear", __version__
    yield "Python", platform.python_version()
    for name in PACKAGES:
        try:
            yield name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue


def render(result: LoopResult, command: str, comparison: Comparison | None = None) -> str:
    """Write the report of a closed loop as HTML.

    Parameters
    ----------
    result : LoopResult
    command : str
        Command line that writes this report.
    comparison : Comparison, optional
        Comparison of the backends. Default: a new comparison.

    Returns
    -------
    str
        One page without references to other files.
    """
    if comparison is None:
        comparison = compare_backends(result.experiment, repeats=1)
    # Without effects the picture of the verdict is the identified frame.
    figure = {name: each for name, each in drawings(result).items() if result.effects or name != "frame"}
    return page(
        "report.html",
        result.to_dict(),
        document=describe(result),
        heading=result.experiment.report,
        headline=capital(headline(result)),
        verdict=verdict_of(result),
        figure=figure,
        backends=describe(comparison)["worst"],
        left_out=comparison.left_out,
        command=command,
        experiment_json=json_text(as_json(result.experiment), indent=1),
    )


#: Headings of the pages by the type of their result.
HEADINGS = {
    "Identification": "Identified frame",
    "RecordPrediction": "Predicted response",
    "Reconstruction": "Reconstructed response",
    "History": "History of a frame",
    "Plan": "Planned test",
}


def render_described(result: object, command: str) -> str:
    """Write the page of an identification, prediction, reconstruction, history or plan as HTML, with its figures."""
    heading = HEADINGS[type(result).__name__]
    found = as_json(result)
    return page(
        "described.html", found, heading=heading, described=describe(result), figure=drawings(result), command=command
    )


def render_modes(results: Sequence[ModalResult], command: str, failed: Sequence[str] = ()) -> str:
    """Write the report of the modes of one record or of several as HTML.

    Parameters
    ----------
    results : sequence of ModalResult
    command : str
    failed : sequence of str, optional
        Reasons why other records are missing.
    """
    return page(
        "modal_report.html",
        [result.to_dict() for result in results],
        title=", ".join(result.name for result in results),
        documents=[describe(result) for result in results],
        failed=list(failed),
        command=command,
        figure=drawings(*results),
    )
