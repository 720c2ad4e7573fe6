"""Draws the figures of the gallery: `python docs/gallery/draw.py [FOLDER]`; the build of the site runs it."""

import sys
from pathlib import Path

import cvxshear
from cvxshear.report import figures

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "examples"


def draw(folder: Path) -> None:
    """Write every figure of the gallery into the folder, as SVG."""
    folder.mkdir(parents=True, exist_ok=True)
    paper = cvxshear.close_loop(cvxshear.load("paper"))
    for name in ("frame", "shapes", "residual", "ranking", "mac"):
        figures.save(getattr(figures, name)(paper), folder / f"paper-{name}.svg")
    five = cvxshear.close_loop(cvxshear.load(EXAMPLES / "five_story.toml"))
    for name in ("shapes", "ranking"):
        figures.save(getattr(figures, name)(five), folder / f"five-story-{name}.svg")
    three = cvxshear.load(EXAMPLES / "three_story.toml")
    first = cvxshear.identify(three, method="two-stage", initial_mass=[9.5, 7.5, 5.5])
    figures.save(figures.convergence(first), folder / "convergence.svg")
    figures.save(figures.backend_differences(cvxshear.compare_backends(three)), folder / "backends.svg")


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "figures")
