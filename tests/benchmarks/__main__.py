"""Run a study by its former command: `python -m tests.benchmarks NAME`."""

import sys

from tests.studies.__main__ import main

if __name__ == "__main__":
    main(sys.argv[1:])
