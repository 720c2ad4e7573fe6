"""Reader and writer of universal files, by pyuff (the extra `uff`): data sets 58 and 55.

Traps of pyuff that are met here: a file of one set comes back as a dict rather than a list; writing turns
nan into 0, so nan is refused before; `mode="overwrite"` with a binary set corrupts a file, so files are
written in ASCII, to a name that does not exist yet.
"""

from __future__ import annotations

import importlib
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from cvxshear.errors import InputError
from cvxshear.formats.columns import Columns
from cvxshear.modal.record import Complexes
from cvxshear.modal.result import ModalResult
from cvxshear.typing import Floats, Json

X_TRANSLATION = 1
TIME, FRF = 1, 4
"""Function types of data set 58."""


def read_uff(path: str | Path) -> tuple[Columns, dict[str, Json]]:
    """Read the functions (data set 58) of a universal file as columns.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    columns : Columns
        The abscissa as `time` or `frequency`; each function by its response node and direction, `1x`,
        `2x-`, ...; a complex function in two columns with `_re` and `_im`. A function whose name is taken
        already has its place in the file appended, `1x#7`.
    notes : dict
        For each function its `node`, `direction`, `reference_node`, `quantity`, `id`.

    Raises
    ------
    InputError
        Where the file cannot be read or its functions have different abscissae, naming the function.
    """
    path = Path(path)
    functions = [item for item in _sets(path) if item.get("type") == 58]
    if not functions:
        raise InputError(f"{path} holds no function (data set 58)")
    axis = np.asarray(functions[0]["x"], dtype=np.float64)
    named: dict[str, Floats] = {"frequency" if int(functions[0]["func_type"]) == FRF else "time": axis}
    notes: dict[str, Json] = {}
    for place, item in enumerate(functions, 1):
        name = _name(item, place, notes)
        other = np.asarray(item["x"], dtype=np.float64)
        if other.shape != axis.shape or not np.allclose(other, axis, rtol=1e-5, atol=1e-9):
            raise InputError(
                f'{path}: function {place}, channel "{name}", has {len(other)} points in steps of '
                f"{_step(other):.6g}, the first has {len(axis)} in steps of {_step(axis):.6g}; one file, one rate"
            )
        notes[name] = _note(item)
        values = np.asarray(item["data"])
        if np.iscomplexobj(values):
            named[f"{name}_re"], named[f"{name}_im"] = values.real, values.imag
        else:
            named[name] = values.astype(np.float64)
    return Columns(str(path), tuple(named), np.column_stack(list(named.values()))), notes


def write_uff(path: str | Path, result: ModalResult) -> None:
    """Write identified modes as data sets 151, 164 and 55 (normal modes, one a mode).

    Parameters
    ----------
    path : str or Path
        Replaced where it exists, once the whole file has been written.
    result : ModalResult

    Raises
    ------
    InputError
        Where pyuff is not installed, a value is not finite, or the file cannot be written.
    """
    path = Path(path)
    if not (np.all(np.isfinite(result.mode_shapes)) and np.all(np.isfinite(result.frequencies))):
        raise InputError("a universal file cannot hold nan: pyuff would write it as 0")
    pyuff = _pyuff()
    folder = tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.")
    written = Path(folder) / "modes.uff"
    try:
        file = pyuff.UFF(str(written))
        file.write_sets(_header(pyuff, result), mode="add")
        for place in range(len(result.frequencies)):
            file.write_sets(_mode(pyuff, result, place), mode="add")
        written.replace(path)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
    finally:
        written.unlink(missing_ok=True)
        os.rmdir(folder)


def read_modes(path: str | Path) -> tuple[Floats, Floats, Complexes]:
    """Frequencies (Hz), viscous damping ratios and shapes of the modes (data set 55) of a universal file.

    Returns
    -------
    frequencies, damping : array, shape (modes,)
    shapes : array of complex, shape (modes, nodes)
        In the x direction, in the order of the file's nodes.

    Raises
    ------
    InputError
        Where the file cannot be read or holds no mode.
    """
    modes = [item for item in _sets(Path(path)) if item.get("type") == 55]
    if not modes:
        raise InputError(f"{path} holds no mode (data set 55)")
    frequencies = np.array([float(np.real(item["freq"])) for item in modes])
    damping = np.array([float(item.get("modal_damp_vis", 0.0)) for item in modes])
    return frequencies, damping, np.array([np.asarray(item["r1"], dtype=np.complex128) for item in modes])


def _pyuff() -> Any:
    try:
        return importlib.import_module("pyuff")
    except ImportError:
        raise InputError("universal files need pyuff: install cvxshear[uff]") from None


def _sets(path: Path) -> list[Json]:
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    pyuff = _pyuff()
    try:
        found = pyuff.UFF(str(path)).read_sets()
    except Exception as error:
        # pyuff raises whatever its parsing runs into.
        raise InputError(f"{path} is not a universal file that can be read: {error}") from error
    return [found] if isinstance(found, dict) else list(found)


def _name(item: Json, place: int, taken: dict[str, Json]) -> str:
    direction = int(item.get("rsp_dir", X_TRANSLATION))
    axis = {0: "", 1: "x", 2: "y", 3: "z", 4: "rx", 5: "ry", 6: "rz"}[abs(direction)]
    name = f"{int(item.get('rsp_node', 0))}{axis}{'-' if direction < 0 else ''}"
    return f"{name}#{place}" if name in taken else name


def _note(item: Json) -> Json:
    return {
        "node": int(item.get("rsp_node", 0)),
        "direction": int(item.get("rsp_dir", X_TRANSLATION)),
        "reference_node": int(item.get("ref_node", 0)),
        "quantity": int(item.get("ordinate_spec_data_type", 0)),
        "id": str(item.get("id1", "")),
    }


def _step(axis: Floats) -> float:
    return float(axis[1] - axis[0]) if len(axis) > 1 else 0.0


def _header(pyuff: Any, result: ModalResult) -> list[Json]:
    return [
        pyuff.prepare_151(
            model_name=result.name[:80],
            description=f"Modes by {result.method}",
            db_app="cvxshear",
            program="cvxshear",
            return_full_dict=True,
        ),
        pyuff.prepare_164(
            units_code=1,
            units_description="SI",
            temp_mode=1,
            length=1.0,
            force=1.0,
            temp=1.0,
            temp_offset=0.0,
            return_full_dict=True,
        ),
    ]


def _mode(pyuff: Any, result: ModalResult, place: int) -> Json:
    frequency = float(result.frequencies[place])
    mode: Json = pyuff.prepare_55(
        id1=result.name[:80],
        id2=result.uncertainty[:80],
        id3="1/sqrt(kg)" if result.mass_normalized else "largest entry 1",
        id4=f"mode {int(result.modes[place])}",
        id5=f"frequency std {result.frequency_std[place]:.3g} (relative)",
        model_type=1,
        analysis_type=2,
        data_ch=2,
        spec_data_type=8,
        data_type=2,
        n_data_per_node=3,
        load_case=1,
        mode_n=int(result.modes[place]),
        freq=frequency,
        modal_m=1.0 if result.mass_normalized else 0.0,
        modal_damp_vis=float(result.damping_ratios[place]),
        modal_damp_his=0.0,
        node_nums=result.floors,
        r1=result.mode_shapes[place],
        r2=np.zeros(len(result.floors)),
        r3=np.zeros(len(result.floors)),
    )
    return mode
