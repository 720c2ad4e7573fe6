"""Measure speed as ratios within one run: `python -m tests.benchmarks` prints the tables of docs/speed.md."""
