"""Make sound files of every kind that a reader accepts, to be damaged by the tests."""

import gc
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy import io

from cvxshear.records.simulate import PAPER_FRAME, base_record
from tests.frames import EXAMPLES
from tests.records.shared import channels, csv

CHANNELS = channels("{ground}", "{names[0]}", "{names[1]}", first=0) + "sign = -1\ncalibration = 9.81\n"
CHANNELS += (
    channels("{names[2]}", first=3)
    + """
[frame]
total_mass = 22.5

[[prior]]
kind = "monotone"
quantity = "story_stiffness"
direction = "decreasing"
"""
)


def columns() -> np.ndarray:
    """Return time, ground and three floors of the paper's frame, shaken for half a minute."""
    record = base_record(PAPER_FRAME, 0, noise=0.01, duration=30.0)
    time = np.arange(record.runs[0].samples) / record.sampling_rate
    return np.column_stack([time, record.runs[0].excitation, record.runs[0].responses])


def measurement() -> bytes:
    return (EXAMPLES / "three_story.toml").read_bytes()


def record_text(file: str, ground: str = "ground", names: tuple[str, ...] = ("a1", "a2", "a3"), more: str = "") -> str:
    head = f'added_mass = [0.0, 0.0, 0.0]\n[record]\nname = "r"\ninput = "base"\nfile = "{file}"\n{more}\n'
    return head + CHANNELS.format(ground=ground, names=names)


def table(folder: Path) -> bytes:
    return csv(folder / "sound.csv", ["t", "ground", "a1", "a2", "a3"], columns()[:200]).read_bytes()


def _variables(values: np.ndarray) -> dict[str, object]:
    inner = {"deep": values[:, 2] + 1j * values[:, 3], "text": "name", "cell": np.array([1.0, "x"], dtype=object)}
    single = values[:, 2].astype(np.float32)
    return {"t": values[:, 0], "ground": values[:, 1], "a": values[:, 2:], "run": inner, "b": single, "n": 3}


def mat4(folder: Path) -> bytes:
    values = columns()[:200]
    io.savemat(folder / "sound4.mat", {"t": values[:, 0], "a": values[:, 2:], "h": values[:, 2] + 1j}, format="4")
    return (folder / "sound4.mat").read_bytes()


def mat73(folder: Path) -> bytes:
    h5py = pytest.importorskip("h5py")
    values = columns()[:200]
    with h5py.File(folder / "sound73.mat", "w", userblock_size=512) as file:
        file.create_dataset("t", data=values[:, [0]].T)
        file.create_dataset("a", data=values[:, 2:].T, chunks=(3, 64), compression="gzip", shuffle=True)
        file.create_dataset("run/ground", data=values[:, [1]].T, chunks=(1, 64), compression="gzip", fletcher32=True)
        file.create_dataset("h", data=np.zeros((1, 200), dtype=[("real", "f8"), ("imag", "f8")]))
    content = (folder / "sound73.mat").read_bytes()
    return b"MATLAB 7.3 MAT-file".ljust(512) + content[512:]


def universal(folder: Path, *, binary: bool) -> bytes:
    sound = dict(zip([(node, 1) for node in (9, 1, 2, 3)], columns()[:200].T[1:], strict=True))
    return write_universal(folder / "sound.uff", sound, 0.05, binary=binary)


def write_universal(path: Path, columns: dict, step: float, *, binary: bool = False) -> bytes:
    """Write data sets 58: real time histories by their nodes and directions."""
    pyuff = pytest.importorskip("pyuff")
    path.unlink(missing_ok=True)
    sets = [
        pyuff.prepare_58(
            binary=int(binary), func_type=1, rsp_node=node, rsp_dir=direction, ref_node=2, ref_dir=1, data=column,
            x=step * np.arange(len(column)), id1=f"channel {node}", ver_num=0, load_case_id=0, rsp_ent_name="NONE",
            ref_ent_name="NONE", abscissa_spacing=1, abscissa_inc=step, abscissa_spec_data_type=17,
            ordinate_spec_data_type=12, orddenom_spec_data_type=0,
        )
        for (node, direction), column in columns.items()
    ]  # fmt: skip
    with warnings.catch_warnings():
        # pyuff does not close the file; the garbage collector does.
        warnings.simplefilter("ignore", ResourceWarning)
        pyuff.UFF(str(path)).write_sets(sets, mode="add")
        gc.collect()
    return path.read_bytes()
