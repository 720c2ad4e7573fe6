"""Each reader returns finite numbers or refuses a file with a message; `--fuzz-budget` counts the tried mutations."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, seed

from cvxshear.io.arrays import read_mat, read_uff
from cvxshear.io.csv import Columns, read_csv
from cvxshear.io.record_tables import read_record
from cvxshear.io.toml import load
from cvxshear.util.errors import CvxshearError, InputError
from tests.fuzz import files
from tests.fuzz.mutations import apply, damaged, many


def finite(columns: Columns) -> None:
    for name in columns.names:
        try:
            assert np.isfinite(columns.column(name, "the test")).all()
        except InputError:
            continue


def measured(path: Path) -> None:
    experiment = load(path)
    for each in experiment.configurations:
        assert np.isfinite(each.frequencies).all()
        assert np.isfinite(each.mode_shapes[each.measured]).all()


def recorded(path: Path) -> None:
    for each in read_record(path).record.runs:
        assert np.isfinite(each.responses).all()


# Not MAT 5: scipy's reader of that version ends the process on some damaged files (docs/reliability.md).
READERS: dict[str, tuple[str, Callable[[Path], bytes], Callable[[Path], object]]] = {
    "MAT 4": ("x.mat", files.mat4, lambda x: finite(read_mat(x))),
    "MAT 7.3": ("x.mat", files.mat73, lambda x: finite(read_mat(x))),
    "UFF": ("x.uff", lambda at: files.universal(at, binary=False), lambda x: finite(read_uff(x))),
    "UFF, binary": ("x.uff", lambda at: files.universal(at, binary=True), lambda x: finite(read_uff(x))),
    "CSV": ("x.csv", files.table, lambda x: finite(read_csv(x))),
    "TOML, measurement": ("x.toml", lambda _: files.measurement(), measured),
    "TOML, record": ("x.toml", lambda _: files.record_text("sound.csv").encode(), recorded),
}


@pytest.mark.parametrize("kind", READERS)
def test_a_mutated_file_is_read_or_refused(kind, fuzz_budget, tmp_path):
    name, make, read = READERS[kind]
    files.table(tmp_path)
    sound = make(tmp_path)
    path = tmp_path / name
    path.write_bytes(sound)
    read(path)
    counts = {"read": 0, "refused": 0}

    @seed(13)
    @many(fuzz_budget, Phase.shrink)
    @given(damaged())
    def check(edits):
        path.write_bytes(apply(sound, edits))
        try:
            read(path)
            counts["read"] += 1
        except CvxshearError as error:
            assert str(error).isprintable()  # noqa: PT017
            counts["refused"] += 1

    check()
    print(f"{kind}: {counts['read']} read, {counts['refused']} refused")
    assert sum(counts.values()) >= fuzz_budget
