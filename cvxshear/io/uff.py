"""Reader and writer of universal files, by pyuff (the extra `uff`): data sets 58 and 55.

Traps of pyuff that are met here: a file of one set comes back as a dict rather than a list; writing turns
nan into 0, so nan is refused before; `mode="overwrite"` with a binary set corrupts a file, so files are
written in ASCII, to a name that does not exist yet.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cvxshear.io.columns import Columns
from cvxshear.io.formats import LIMIT, TOO_LARGE, read_bytes
from cvxshear.util.errors import InputError, optional, printable
from cvxshear.util.typing import Complexes, Floats, Ints, Json
from cvxshear.util.writing import write_file

if TYPE_CHECKING:
    from cvxshear.records.result import ModalResult

AXES = ("", "x", "y", "z", "rx", "ry", "rz")
"""Names of the directions 0 to 6; negative ones point the other way."""
FRF = 4
"""Function type of frequency response functions in data set 58."""
NEEDED = {58: ("x", "data", "func_type"), 55: ("r1", "node_nums")}
"""Keys that pyuff returns for a complete data set; for a damaged one it omits some."""


def read_uff(path: str | Path, limit: float = LIMIT) -> Columns:
    """Read the functions (data set 58) of a universal file as columns.

    Parameters
    ----------
    path : str or Path
    limit : float, optional
        Bytes that the file may have.

    Returns
    -------
    Columns
        The abscissa as `time` or `frequency`; each function by its response node and direction, `1x`, `2x-`, ... (`1d9`
        for a direction outside the format); a complex function in two columns with `_re` and `_im`. A function whose
        name is taken already has its place in the file appended, `1x#7`.

    Raises
    ------
    InputError
        If the file cannot be read or its functions have different abscissae, naming the function.
    """
    where = str(path)
    functions = _sets(Path(path), 58, limit)
    if not functions:
        raise InputError(f"{where} holds no function (data set 58)")
    axis = np.asarray(functions[0]["x"], dtype=np.float64)
    named: dict[str, Floats] = {"frequency" if int(functions[0]["func_type"]) == FRF else "time": axis}
    taken: set[str] = set()
    for place, item in enumerate(functions, 1):
        name = _name(item, place, taken)
        taken.add(name)
        other = np.asarray(item["x"], dtype=np.float64)
        values = np.asarray(item["data"])
        with np.errstate(over="ignore", invalid="ignore"):
            same = values.shape == other.shape == axis.shape and np.allclose(other, axis, rtol=1e-5, atol=1e-9)
        if not same:
            raise InputError(
                f'{where}: function {place}, channel "{name}", has {len(other)} points in steps of '
                f"{_step(other):.6g}, the first has {len(axis)} in steps of {_step(axis):.6g}; one file, one rate"
            )
        if np.iscomplexobj(values):
            named[f"{name}_re"], named[f"{name}_im"] = values.real, values.imag
        else:
            named[name] = values.astype(np.float64)
    return Columns(where, tuple(named), np.column_stack(list(named.values())))


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
        If pyuff is not installed, a value is not finite, or the file cannot be written.
    """
    if not (np.all(np.isfinite(result.mode_shapes)) and np.all(np.isfinite(result.frequencies))):
        raise InputError("a universal file cannot hold nan: pyuff would write it as 0")
    pyuff = load_pyuff()
    modes = (_mode(pyuff, result, place) for place in range(len(result.frequencies)))
    write_file(path, universal_file([*_header(pyuff, result), *modes]))


def universal_file(sets: Iterable[Json]) -> bytes:
    """Write the content of a universal file of these data sets."""
    # pyuff writes to a name only.
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "sets.uff"
        file = load_pyuff().UFF(str(made))
        for each in sets:
            file.write_sets(each, mode="add")
        return made.read_bytes()


def read_modes(path: str | Path) -> tuple[Floats, Floats, Complexes, Ints]:
    """Frequencies (Hz), viscous damping ratios, shapes and nodes of the modes (data set 55) of a universal file.

    Returns
    -------
    frequencies, damping : array, shape (modes,)
    shapes : array of complex, shape (modes, nodes)
        In the x direction, in the order of the file's nodes.
    nodes : array of int, shape (nodes,)

    Raises
    ------
    InputError
        If the file cannot be read or holds no mode.
    """
    where = str(path)
    modes = _sets(Path(path), 55, LIMIT)
    if not modes:
        raise InputError(f"{where} holds no mode (data set 55)")
    shapes = [np.atleast_1d(item["r1"]).astype(np.complex128) for item in modes]
    nodes = [np.atleast_1d(item["node_nums"]).astype(np.int64) for item in modes]
    if any("freq" not in item for item in modes) or len({each.tobytes() for each in nodes}) > 1:
        raise InputError(f"{where}: the sets 55 are not normal modes at the same nodes")
    frequencies = np.array([float(np.real(item["freq"])) for item in modes])
    damping = np.array([float(item.get("modal_damp_vis", 0.0)) for item in modes])
    return frequencies, damping, np.array(shapes), nodes[0]


def read_mode_uff(path: str | Path) -> dict[str, Any]:
    """Read the modes of a universal file; its nodes 1, 2, ... are the floors.

    Parameters
    ----------
    path : str or Path
        With data sets 55; the x direction is taken, complex shapes are made real on their main axis.

    Returns
    -------
    dict
        Keys of a table [[configuration]].

    Raises
    ------
    InputError
        If the file cannot be read or holds no mode.
    """
    frequencies, damping, shapes, nodes = read_modes(path)
    upward, rising = np.argsort(nodes), np.argsort(frequencies)
    turn = np.exp(-0.5j * np.angle(np.sum(shapes**2, axis=1, keepdims=True)))
    result: dict[str, Any] = {
        "measured_floors": nodes[upward].tolist(),
        "frequencies": frequencies[rising].tolist(),
        "mode_shapes": (shapes * turn).real[rising][:, upward].tolist(),
    }
    if np.any(damping > 0):
        result["damping_ratios"] = np.where(damping > 0, damping, np.nan)[rising].tolist()
    return result


def load_pyuff() -> Any:
    """Import the optional package pyuff."""
    return optional("pyuff", "universal files need")


def _sets(path: Path, kind: int, limit: float) -> list[Json]:
    """Read the data sets of one kind, 58 (functions) or 55 (modes)."""
    where = str(path)
    # pyuff opens the file by its name; that it can be read, and how large it is, is checked here.
    read_bytes(path, limit, TOO_LARGE, named=True)
    pyuff = load_pyuff()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            file = pyuff.UFF(str(path))
            places = [place for place, each in enumerate(file.get_set_types()) if int(each) == kind]
            found = file.read_sets(places) if places else []
    except Exception as error:
        # pyuff raises whatever its parsing runs into, and quotes the file, which may have been named by mistake.
        reason = f"{type(error).__name__} in pyuff"
        raise InputError(f"{where} is not a universal file that can be read ({reason})") from error
    sets = [found] if isinstance(found, dict) else list(found)
    if any(key not in item for item in sets for key in NEEDED[kind]):
        raise InputError(f"{where} is not a universal file that can be read: a data set {kind} lacks its numbers")
    return sets


def _name(item: Json, place: int, taken: set[str]) -> str:
    direction = int(item.get("rsp_dir", AXES.index("x")))
    axis = AXES[abs(direction)] if abs(direction) < len(AXES) else f"d{abs(direction)}"
    name = f"{int(item.get('rsp_node', 0))}{axis}{'-' if direction < 0 else ''}"
    return f"{name}#{place}" if name in taken else name


def _step(axis: Floats) -> float:
    return float(axis[1] - axis[0]) if len(axis) > 1 else 0.0


def _header(pyuff: Any, result: ModalResult) -> list[Json]:
    return [
        pyuff.prepare_151(
            model_name=printable(result.name)[:80], description=f"Modes by {result.method}", db_app="cvxshear",
            program="cvxshear", return_full_dict=True,
        ),
        pyuff.prepare_164(
            units_code=1, units_description="SI", temp_mode=1, length=1.0, force=1.0, temp=1.0, temp_offset=0.0,
            return_full_dict=True,
        ),
    ]  # fmt: skip


def _mode(pyuff: Any, result: ModalResult, place: int) -> Json:
    frequency, std = float(result.frequencies[place]), float(result.frequency_std[place])
    words = {
        "id1": printable(result.name)[:80], "id2": result.uncertainty[:80],
        "id3": "1/sqrt(kg)" if result.mass_normalized else "largest entry 1", "id4": f"mode {int(result.modes[place])}",
        "id5": f"frequency std {std:.3g} (relative)" if np.isfinite(std) else "",
    }  # fmt: skip
    none = np.zeros(len(result.floors))
    mode: Json = pyuff.prepare_55(
        **words, model_type=1, analysis_type=2, data_ch=2, spec_data_type=8, data_type=2, n_data_per_node=3,
        load_case=1, mode_n=int(result.modes[place]), freq=frequency, modal_m=1.0 if result.mass_normalized else 0.0,
        modal_damp_vis=float(np.nan_to_num(result.damping_ratios[place])), modal_damp_his=0.0, node_nums=result.floors,
        r1=result.mode_shapes[place], r2=none, r3=none,
    )  # fmt: skip
    return mode
