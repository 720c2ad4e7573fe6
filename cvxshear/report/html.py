"""Write reports of a closed loop, of a response and of modes, each as one HTML file that contains its figures."""

import platform
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import metadata
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from cvxshear.backends import Comparison, listed
from cvxshear.fit.identification import compare_backends
from cvxshear.loop import LoopResult
from cvxshear.loop.results import VERDICTS
from cvxshear.records import ModalResult
from cvxshear.report.blocks import describe
from cvxshear.report.headline import headline
from cvxshear.util.errors import printable
from cvxshear.util.quantities import capital
from cvxshear.util.results import as_json
from cvxshear.util.typing import Json
from cvxshear.util.writing import json_text
from cvxshear.version import __version__


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
            **{key: getattr(entry, key) for key in ("name", "title", "section", "alternative")},
            "caption": entry.caption_of(*results),
            # matplotlib has escaped the texts in a drawing.
            "svg": Markup(style.inline_svg(entry.draw(*results), entry.name)),
            "moves": False,
        }
        for entry in style.applicable(*results)
    }


def versions() -> Iterator[tuple[str, str]]:
    """Yield names and versions of the installed packages that may have computed the result."""
    yield "cvxshear", __version__
    yield "Python", platform.python_version()
    solvers = (name for each in listed() for name in (each.through, each.package))
    for name in dict.fromkeys(("numpy", "scipy", *filter(None, solvers))):
        try:
            yield name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue


def render(result: Any, command: str, comparison: Comparison | None = None, failed: Sequence[str] = ()) -> str:
    """Write the report of a result as HTML.

    Parameters
    ----------
    result : object, or list of ModalResult
        A result of a loop, or of another type whose description has a heading.
    command : str
        Command line that writes this report.
    comparison : Comparison, optional
        Comparison of the backends, for the report of a loop. Default: a new comparison.
    failed : sequence of str, optional
        Reasons why other records are missing in the report of modes.

    Returns
    -------
    str
        One page with its figures and without references to other files.
    """
    results = result if isinstance(result, list) else [result]
    first, documents, figure = results[0], [describe(each) for each in results], drawings(*results)
    contents: dict[str, Any] = {"document": documents[0], "figure": figure}
    if isinstance(first, LoopResult):
        template, compared = "report.html", comparison or compare_backends(first.experiment, repeats=1)
        contents |= {
            "heading": first.experiment.report,
            "headline": capital(headline(first)),
            "verdict": VERDICTS[first.verdict],
            # Without effects the picture of the verdict is the identified frame.
            "figure": {name: each for name, each in figure.items() if first.effects or name != "frame"},
            "backends": describe(compared)["worst"],
            "left_out": compared.left_out,
            "experiment_json": json_text(as_json(first.experiment.to_dict()), indent=1),
        }
    elif isinstance(first, ModalResult):
        template = "modal_report.html"
        contents |= {"title": ", ".join(each.name for each in results), "documents": documents, "failed": failed}
    else:
        template, contents["heading"] = "described.html", documents[0].heading
    written = json_text(as_json(results if isinstance(first, ModalResult) else first), indent=1)
    found = environment().get_template(template)
    return found.render(**contents, command=command, result_json=written, versions=list(versions()))
