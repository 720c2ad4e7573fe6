"""Draws the figures of the gallery, all that the table of figures has of a few examples.

`python docs/gallery/draw.py [FOLDER]`; the build of the site runs it.
"""

import json
import sys
import tempfile
from contextlib import chdir
from pathlib import Path
from runpy import run_path

import cvxshear
from cvxshear.report import figures
from cvxshear.report.figures.style import applicable

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "examples"


def results() -> dict[str, object]:
    """Make what is drawn, by the name that the pages call it."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        run_path(str(EXAMPLES / "before_and_after.py"))
        story = cvxshear.load(Path(folder) / "before_and_after.toml")
    return {
        "paper": cvxshear.close_loop(cvxshear.load("paper")),
        "five-story": cvxshear.close_loop(cvxshear.load(EXAMPLES / "five_story.toml")),
        "story": cvxshear.close_loop(story),
    }


def draw(folder: Path) -> None:
    """Write every figure into the folder, as SVG, and beside it what the table says of it."""
    folder.mkdir(parents=True, exist_ok=True)
    words = {}
    for name, result in results().items():
        for entry in applicable(result):
            figures.save(entry.draw(result), folder / f"{name}-{entry.name}.svg")
            words[f"{name} {entry.name}"] = [entry.title, entry.alternative, entry.caption_of(result)]
    (folder / "figures.json").write_text(json.dumps(words), encoding="utf-8")


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "figures")
