"""Speed, as ratios measured in one run: `python -m tests.benchmarks` prints the tables of docs/speed.md."""
