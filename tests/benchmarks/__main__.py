"""Print the tables of docs/speed.md: `python -m tests.benchmarks [starting] [scaling] [many] [solvers] [peers]`.

`python -m tests.benchmarks hard --programs 1000 --seed 1` prints that of docs/theory/backends.md,
`python -m tests.benchmarks nested` that of docs/calibration.md.
"""

import argparse
from importlib import import_module

from tests.benchmarks.timing import machine

PARTS = ("starting", "scaling", "many", "solvers", "peers", "response", "planning")

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks")
    choices = [*PARTS, "hard", "nested", []]
    parser.add_argument("parts", nargs="*", choices=choices, help="tables; all of docs/speed.md's if none")
    parser.add_argument("--programs", type=int, default=1000, help="hard: number of programs")
    parser.add_argument("--seed", type=int, default=1, help="hard: seed of the programs")
    given = parser.parse_args()
    print(machine())
    for part in given.parts or PARTS:
        if part == "hard":
            import_module("tests.benchmarks.hard_programs").main(given.programs, given.seed)
        else:
            import_module(f"tests.benchmarks.{part}").main()
