"""Time the start: import of the library and its help command, compared with `import numpy, scipy.linalg`."""

import subprocess
import sys
import time

from tests.studies.timing import shown, table

ROUNDS = 15
"""Number of alternating starts of each command; the fastest counts."""

STARTED = {
    "`import numpy, scipy.linalg`": ["-c", "import numpy, scipy.linalg"],
    "`import cvxshear`": ["-c", "import cvxshear"],
    "`import cvxshear; cvxshear.load`": ["-c", "import cvxshear; cvxshear.load"],
    "`cvxshear --help`": ["-m", "cvxshear", "--help"],
    "`cvxshear identify --help`": ["-m", "cvxshear", "identify", "--help"],
}


def seconds(arguments):
    began = time.perf_counter()
    subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - began


def main():
    times = {name: [] for name in STARTED}
    for _ in range(ROUNDS):
        for name, arguments in STARTED.items():
            times[name].append(seconds(arguments))
    fastest = {name: min(each) for name, each in times.items()}
    plain = next(iter(fastest.values()))
    rows = [[name, shown(value), f"{value / plain:.2f}"] for name, value in fastest.items()]
    table("Starting", ["started", "time", "of the first"], rows)
