"""Print the tables of docs/speed.md: `python -m tests.benchmarks [starting] [scaling] [many] [loops] ...`.

`python -m tests.benchmarks backends` prints how each backend's answers were accepted (docs/theory/backends.md).

Three commands print the tables of other pages:
`python -m tests.benchmarks hard --programs 1000 --seed 1` for docs/theory/backends.md,
`python -m tests.benchmarks hard-frames --frames 100 --seed 1` for docs/reliability.md,
`python -m tests.benchmarks nested` for docs/calibration.md.
"""

import argparse
from importlib import import_module

from tests.benchmarks.timing import machine

PARTS = ("backends", "starting", "scaling", "many", "loops", "solvers", "peers", "response", "planning")

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks")
    choices = [*PARTS, "hard", "hard-frames", "nested", []]
    parser.add_argument("parts", nargs="*", choices=choices, help="tables; all of docs/speed.md's if none")
    parser.add_argument("--programs", type=int, default=1000, help="hard: number of programs")
    parser.add_argument("--frames", type=int, default=100, help="hard-frames: number of frames")
    parser.add_argument("--seed", type=int, default=1, help="hard, hard-frames: seed")
    given = parser.parse_args()
    print(machine())
    for part in given.parts or PARTS:
        if part == "hard":
            import_module("tests.benchmarks.hard_programs").main(given.programs, given.seed)
        elif part == "hard-frames":
            import_module("tests.benchmarks.hard_frames").main(given.frames, given.seed)
        else:
            import_module(f"tests.benchmarks.{part}").main()
