"""Files made to do harm are refused at once, in little memory, with a message that says what to do.

Each runs in a process of its own whose memory is limited to 500 MB beyond what the library takes to load.
"""

from __future__ import annotations

import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
from scipy import io

from cvxshear.io import toml
from cvxshear.io.csv import read_csv
from cvxshear.io.mat import read_mat
from cvxshear.io.record_file import read_record
from cvxshear.io.toml import files_of, load
from cvxshear.io.uff import read_uff
from cvxshear.util.errors import InputError
from tests.fuzz import files

HEADER = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
DOUBLE, CELL, STRUCTURE = 6, 1, 2

LIMITED = """
import resource, sys
from pathlib import Path
import numpy, scipy.io, h5py
from cvxshear.io.mat import read_mat
from cvxshear.util.errors import InputError
taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (taken + 500_000_000,) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
for path in sys.argv[1:]:
    try:
        read_mat(path)
        print("read")
    except InputError as error:
        print(error)
"""


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def matrix(of_class: int, sizes, *parts: bytes, name: bytes = b"a") -> bytes:
    head = element(6, struct.pack("<II", of_class, 0)) + element(5, struct.pack(f"<{len(sizes)}i", *sizes))
    return element(14, head + element(1, name) + b"".join(parts))


def compressed(content: bytes, zeros: int = 0) -> bytes:
    packed = packed_with(content, zeros)
    return struct.pack("<II", 15, len(packed)) + packed


def packed_with(content: bytes, zeros: int) -> bytes:
    """What zlib makes of some bytes and so many million zeros: a million is packed once and stands there repeatedly."""
    million, packer = bytes(1_000_000), zlib.compressobj(9)
    head = packer.compress(content) + packer.flush(zlib.Z_FULL_FLUSH)
    piece = packer.compress(million) + packer.flush(zlib.Z_FULL_FLUSH)
    check = zlib.adler32(content)
    for _ in range(zeros):
        check = zlib.adler32(million, check)
    return head + piece * zeros + packer.flush()[:-4] + struct.pack(">I", check)


def zeros_in(count: int, millions: int, kind: int = 9) -> bytes:
    """The head of a matrix of so many numbers that are so many million bytes of zeros, which follow it."""
    whole = matrix(DOUBLE, (1, count), struct.pack("<II", kind, 1_000_000 * millions))
    return struct.pack("<II", 14, len(whole) - 8 + 1_000_000 * millions) + whole[8:]


def small_that_inflates(path):
    """Deflate makes a thousandfold at most; five megabytes make five gigabytes."""
    path.write_bytes(HEADER + compressed(zeros_in(12_000_000, 96), 96) * 50)
    assert path.stat().st_size < 6_000_000


def one_that_inflates(path):
    path.write_bytes(HEADER + compressed(zeros_in(120_000_000, 960), 960))


def small_numbers(path):
    """Stored in a byte each, they are read as doubles."""
    path.write_bytes(HEADER + compressed(zeros_in(90_000_000, 90, kind=1), 90))


def deep_cells(path):
    content = matrix(DOUBLE, (1, 100), element(9, bytes(800)))
    for _ in range(3000):
        content = matrix(CELL, (1, 1), content)
    path.write_bytes(HEADER + compressed(content))


def complex_of_one_part(path):
    """scipy's reader ends the process on such files."""
    content = matrix(DOUBLE | 0x0800, (1, 100), element(9, bytes(800)))
    path.write_bytes(HEADER + compressed(content))


def of_size(of_class, sizes, *parts):
    return lambda path: path.write_bytes(HEADER + matrix(of_class, sizes, *parts))


def hdf5(put):
    """A sound file, and what is put into it besides."""

    def make(path):
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            file["t"] = np.arange(100.0)
            put(file, h5py)

    return make


def linked(link):
    return hdf5(lambda file, h5py: file.__setitem__("x", link(h5py)))


def data_set(*shape, **options):
    return hdf5(lambda file, _: file.create_dataset("x", shape, "f8", **options))


def inside_itself(file, _):
    group = file.create_group("run")
    group["again"] = group


def deep_groups(file, _):
    for _ in range(3000):
        file = file.create_group("g")


def virtual(file, h5py):
    layout = h5py.VirtualLayout((100,), "f8")
    layout[:] = h5py.VirtualSource("b.mat", "t", (100,))
    file.create_virtual_dataset("x", layout)


def bursting_piece(file, _):
    item = file.create_dataset("x", (100_000,), "f8", chunks=(100_000,), compression="gzip")
    item.id.write_direct_chunk((0,), packed_with(b"", 600))


ELSEWHERE = ': the numbers of "x" stand in another file; only this one is read'
LINK = ': "x" is a link; only numbers that stand in the file itself are read'
NUMBERS = " holds more than 100 MB of numbers; cut it into runs, or raise the limit by size_limit"
OTHERWISE = ': "x" is compressed in a way that MATLAB does not use'
NO_MAT = " is not a MAT file that can be read: "

MAT = {
    "a MB that inflates to a GB": (one_that_inflates, NUMBERS),
    "5 MB that inflate to 5 GB": (small_that_inflates, f"{NO_MAT}Duplicate variable name"),
    "90 million numbers of a byte": (small_numbers, NUMBERS),
    "3,000 cells in each other": (deep_cells, "read"),
    "more numbers than atoms": (of_size(DOUBLE, (2**31 - 1, 2**31 - 1), element(9, bytes(800))), NO_MAT),
    "a number too many": (of_size(DOUBLE, (1, 101), element(9, bytes(800))), NO_MAT),
    "complex, without an imaginary part": (complex_of_one_part, NO_MAT),
    "a structure of nothing": (of_size(STRUCTURE, (1, 2**31 - 1)), NO_MAT),
    "a dangling link": (linked(lambda h5py: h5py.SoftLink("/nowhere")), LINK),
    "a link in a circle": (linked(lambda h5py: h5py.SoftLink("/x")), LINK),
    "a link to another file": (linked(lambda h5py: h5py.ExternalLink("b.mat", "/t")), LINK),
    "a structure inside itself": (hdf5(inside_itself), ': "run.again" is a second name of a structure, and leads in a'),
    "3,000 structures in each other": (hdf5(deep_groups), " has structures more than 32 deep"),
    "1e13 numbers": (data_set(10**13, chunks=(1000,)), NUMBERS),
    "a large piece": (data_set(100, maxshape=(None,), chunks=(2 * 10**7,)), " holds pieces of more than 100 MB, in"),
    "numbers in another file": (data_set(100, external=[("/etc/passwd", 0, 800)]), ELSEWHERE),
    "virtual numbers": (hdf5(virtual), ELSEWHERE),
    "another filter": (data_set(100, compression="lzf"), OTHERWISE),
    "a piece that bursts": (hdf5(bursting_piece), ': a piece of "x" inflates to more than it stands for'),
}


@pytest.fixture(scope="module")
def said_of(tmp_path_factory):
    """What is said of each file, all read by one process in little memory."""
    pytest.importorskip("resource")
    folder = tmp_path_factory.mktemp("hostile")
    paths = {kind: folder / f"{place}.mat" for place, kind in enumerate(MAT)}
    for kind, path in paths.items():
        MAT[kind][0](path)
    found = subprocess.run(
        [sys.executable, "-W", "error", "-c", LIMITED, *map(str, paths.values())],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    assert not found.stderr
    lines = found.stdout.splitlines()
    return {kind: line.removeprefix(str(path)) for (kind, path), line in zip(paths.items(), lines, strict=True)}


@pytest.mark.parametrize("kind", MAT)
def test_a_mat_file_made_to_do_harm(kind, said_of):
    assert said_of[kind].startswith(MAT[kind][1])


def test_flipped_bits_of_a_compressed_file_are_seen(tmp_path):
    """Each element has a checksum of what it holds: what is read in spite of a flip is what was written."""
    path = tmp_path / "a.mat"
    io.savemat(path, {"t": np.arange(40.0)}, do_compression=True)
    sound = path.read_bytes()
    expected = read_mat(path).values
    for place in range(128, len(sound), 8):
        path.write_bytes(sound[:place] + bytes([sound[place] ^ 0x10]) + sound[place + 1 :])
        try:
            np.testing.assert_array_equal(read_mat(path).values, expected)
        except InputError as error:
            assert "is not a MAT file that can be read" in str(error) or "holds no numeric" in str(error)  # noqa: PT017


def test_the_limit_is_raised_by_a_key_of_the_record(tmp_path):
    files.table(tmp_path)
    path = tmp_path / "record.toml"
    path.write_text(files.record_text("sound.csv", more="size_limit = 0.01"))
    with pytest.raises(InputError, match=r"has more than 0.01 MB; cut it into runs, or raise the limit by size_limit"):
        read_record(path)
    path.write_text(files.record_text("sound.csv", more="size_limit = 0.1"))
    assert read_record(path).files == (path, tmp_path / "sound.csv")


TEXTS = {
    "a dotted key of 50,000 parts": (".".join(["a"] * 50_000) + " = 1\n", "a key of more than 16 parts (at line 1)"),
    "a header of 50,000 parts": (f"x = 1\n[{'.'.join(['a'] * 50_000)}]\n", "a key of more than 16 parts (at line 2)"),
    "a key in quotes": (".".join(['"a b"'] * 50_000) + " = 1\n", "a key of more than 16 parts (at line 1)"),
    "a list of 40 MB": ("x = [" + "1, " * 13_400_000 + "]\n", "has more than 5 MB; too many for a measurement file"),
}  # fmt: skip


@pytest.mark.parametrize("kind", TEXTS)
def test_a_text_that_takes_for_ever(kind, tmp_path):
    text, message = TEXTS[kind]
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load(path)
    assert message in str(caught.value)


def test_keys_and_numbers_of_usual_length_are_no_long_keys(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[a.b."c.d".e]\nx = "1.2.3.4.5.6.7.8.9"\ny = [' + "1.5, " * 1000 + "]\n")
    assert toml.parse(path.read_text(), path)["a"]["b"]["c.d"]["e"]["y"] == [1.5] * 1000


@pytest.mark.parametrize("cell", ["1e300", "-1e300", "inf", "1_000", "0x10", '"1" x'])
def test_a_cell_that_is_no_measurement(cell, tmp_path):
    path = files.table(tmp_path) and tmp_path / "sound.csv"
    lines = path.read_text().splitlines()
    lines[10] = ",".join([*lines[10].split(",")[:4], cell])
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"sound.csv, line 11"):
        read_csv(path).column("a3", "the test")


def test_a_quote_that_never_ends(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text('a,b\n1,"2\n' + "1,2\n" * 100)
    with pytest.raises(InputError, match="line 2 is no line of a table: its quotation marks"):
        read_csv(path)


def test_a_pipe_that_never_ends(tmp_path):
    with pytest.raises(InputError, match="/dev/zero has more than 5 MB"):
        load("/dev/zero")
    with pytest.raises(InputError, match=r"/dev/zero has more than 0.001 MB"):
        read_csv("/dev/zero", 1000)
    with pytest.raises(InputError, match="/dev/zero is a device or a pipe"):
        read_mat("/dev/zero")


HEADS = {
    'axis = ["x"]': "record: axis must be a text that is not empty, not ['x']",
    "input_floor = [1]": "run 1: input_floor must be a whole number, not [1]",
    "time = ['t']": "record: time must be a text that is not empty, not ['t']",
    "stories = 'three'": "record: stories must be a whole number, not 'three'",
    'file = "a\\u0000b.csv"': "cannot be the name of a file: embedded null byte",
    "sampling_rate = [20]": "record: sampling_rate must be a number, not [20]",
    "size_limit = 'much'": "record: size_limit (MB) must be a number, not 'much'",
}


@pytest.mark.parametrize("head", HEADS)
def test_a_record_header_of_the_wrong_kind(head, tmp_path):
    csv = files.table(tmp_path)
    text = files.record_text("sound.csv", more="" if head.startswith("file") else head)
    if head.startswith("file"):
        text = text.replace('file = "sound.csv"', head)
    if "input_floor" in head:
        text = text.replace('"base"', '"force"').replace("floor = 0", 'quantity = "force"')
    path = tmp_path / "record.toml"
    path.write_text(text)
    assert csv
    with pytest.raises(InputError) as caught:
        read_record(path)
    assert HEADS[head] in str(caught.value)


@pytest.mark.parametrize("table", ["prior = [1]", "prior = ['x']", "prior = 3", "frame = [1]"])
def test_priors_of_a_record_that_are_no_tables(table, tmp_path):
    files.table(tmp_path)
    path = tmp_path / "record.toml"
    path.write_text(f"{table}\n" + files.record_text("sound.csv").split("[frame]")[0])
    with pytest.raises(InputError, match=r"frame must be a table \[frame\], prior a list of tables"):
        read_record(path)


def test_the_files_that_a_command_reads(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[[run]]\nfile = "1.csv"\n[[run]]\nfile = "2.csv"\n[[configuration]]\nuff = "m.uff"\nname = "x"\n')
    assert [each.name for each in files_of(path)] == ["a.toml", "1.csv", "2.csv", "m.uff"]


def test_a_function_whose_numbers_are_of_no_type(tmp_path):
    """pyuff reads it without a word, and gives neither abscissa nor values."""
    content = files.universal(tmp_path, binary=True)
    (tmp_path / "a.uff").write_bytes(content.replace(b"         4       200", b"         0       200", 1))
    with pytest.raises(InputError, match="a data set 58 lacks its numbers"):
        read_uff(tmp_path / "a.uff")
