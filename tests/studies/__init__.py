"""Studies: figures of reliability, accuracy and speed for the docs. `python -m tests.studies NAME` runs one."""
