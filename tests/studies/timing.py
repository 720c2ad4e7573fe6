"""Measure times and print tables."""

import os
import platform
import time
from pathlib import Path

import numpy as np
import scipy


def fastest(run, repeats=5, clock=time.perf_counter):
    """Return the seconds of the fastest run after one warm-up, and its result.

    The clock `time.process_time` excludes other processes: use it for single threads on a busy machine.
    """
    result = run()
    seconds = []
    for _ in range(repeats):
        began = clock()
        result = run()
        seconds.append(clock() - began)
    return min(seconds), result


def shown(seconds):
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def table(title, head, rows):
    print(f"\n### {title}\n")
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(str(cell) for cell in row) + " |", flush=True)


def machine():
    model = platform.processor() or platform.machine()
    listed = Path("/proc/cpuinfo")
    if listed.exists():
        model = next(
            (line.split(":")[1].strip() for line in listed.read_text().splitlines() if "model name" in line), model
        )
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    return (
        f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, numpy {np.__version__}, "
        f"scipy {scipy.__version__}, OMP_NUM_THREADS {threads}"
    )
