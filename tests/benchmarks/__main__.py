"""Print the tables of docs/speed.md: `python -m tests.benchmarks [starting] [scaling] [many] [solvers] [peers]`."""

import sys
from importlib import import_module

from tests.benchmarks.timing import machine

PARTS = ("starting", "scaling", "many", "solvers", "peers", "response", "planning")

if __name__ == "__main__":
    print(machine())
    for part in sys.argv[1:] or PARTS:
        import_module(f"tests.benchmarks.{part}").main()
