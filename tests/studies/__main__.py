"""Run a study: `python -m tests.studies NAME [OPTIONS]`, with the name of a module of this folder.

`python -m tests.studies` prints the tables of docs/speed.md; `python -m tests.studies scaling peers` some of them.
"""

import runpy
import sys
from importlib import import_module
from pathlib import Path

from tests.studies.timing import machine

SPEED = ("backends", "starting", "scaling", "many", "loops", "solvers", "peers", "response", "planning")
STUDIES = sorted({path.stem for path in Path(__file__).parent.glob("[!_]*.py")} - {"drawn", "timing"})


def main(words):
    """Run the study that the first word names with the other words as its options, or each named table of speed."""
    if set(words) <= set(SPEED):
        print(machine())
        for name in words or SPEED:
            import_module(f"tests.studies.{name}").main()
    elif words[0] in STUDIES:
        sys.argv = words
        runpy.run_module(f"tests.studies.{words[0]}", run_name="__main__", alter_sys=True)
    else:
        sys.exit(f"no study {words[0]!r}; the studies are {', '.join(STUDIES)}")


if __name__ == "__main__":
    main(sys.argv[1:])
