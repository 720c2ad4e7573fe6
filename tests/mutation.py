"""Run the study of small changes of the code (`tests/studies/mutations.py`): `python -m tests.mutation --seed 1`."""

from tests.studies.mutations import main

if __name__ == "__main__":
    main()
