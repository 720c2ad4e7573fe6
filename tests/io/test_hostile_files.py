"""Harmful files are refused at once, with a message that contains the remedy."""

import numpy as np
import pytest
from scipy import io

from cvxshear.io.arrays import read_mat, read_uff
from cvxshear.io.csv import read_csv
from cvxshear.io.record_tables import read_record
from cvxshear.io.toml import files_of, load
from cvxshear.util.errors import InputError
from tests.fuzz import files


def test_links_of_a_mat_file_are_not_followed(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["t"] = np.arange(100.0)
        file["dangling"], file["outside"] = h5py.SoftLink("/nowhere"), h5py.ExternalLink("b.mat", "/t")
        group = file.create_group("run")
        group["again"] = group
    assert read_mat(tmp_path / "a.mat").names == ("t",)


def test_flipped_bits_of_a_compressed_file_are_seen(tmp_path):
    """Each element has a checksum of its content. If a file with a flipped bit is read, its content is unchanged."""
    path = tmp_path / "a.mat"
    io.savemat(path, {"t": np.arange(40.0)}, do_compression=True)
    sound = path.read_bytes()
    expected = read_mat(path).values
    for place in range(128, len(sound), 8):
        path.write_bytes(sound[:place] + bytes([sound[place] ^ 0x10]) + sound[place + 1 :])
        try:
            np.testing.assert_array_equal(read_mat(path).values, expected)
        except InputError as error:
            assert "cannot be read as a MAT file" in str(error) or "holds no numeric" in str(error)  # noqa: PT017


def test_the_limit_is_raised_by_a_key_of_the_record(tmp_path):
    files.table(tmp_path)
    path = tmp_path / "record.toml"
    path.write_text(files.record_text("sound.csv", more="size_limit = 0.01"))
    with pytest.raises(InputError, match=r"has more than 0.01 MB; cut it into runs, or raise the limit by size_limit"):
        read_record(path)
    path.write_text(files.record_text("sound.csv", more="size_limit = 0.1"))
    assert read_record(path).files == (path, tmp_path / "sound.csv")


def test_a_text_of_40_mb_is_refused_by_its_size(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("x = [" + "1, " * 13_400_000 + "]\n")
    with pytest.raises(InputError, match="has more than 5 MB; too many for a measurement file"):
        load(path)


@pytest.mark.parametrize("cell", ["1e300", "-1e300", "inf", "1_000", "0x10", '"1" x'])
def test_a_cell_that_is_no_measurement(cell, tmp_path):
    files.table(tmp_path)
    path = tmp_path / "sound.csv"
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
    for read in (load, read_csv, read_mat):
        with pytest.raises(InputError, match="/dev/zero is a device or a pipe"):
            read("/dev/zero")


HEADS = {
    'axis = ["x"]': "record: axis must be a text that is not empty, not ['x']",
    "input_floor = [1]": "run 1: input_floor must be a whole number, not [1]",
    "time = ['t']": "record: time must be a text that is not empty, not ['t']",
    "stories = 'three'": "record: stories must be a whole number, not 'three'",
    'file = "a\\u0000b.csv"': "cannot be read: embedded null byte",
    "sampling_rate = [20]": "record: sampling_rate must be a number, not [20]",
    "size_limit = 'much'": "record: size_limit (MB) must be a number, not 'much'",
}


@pytest.mark.parametrize("head", HEADS)
def test_a_record_header_of_the_wrong_kind(head, tmp_path):
    files.table(tmp_path)
    text = files.record_text("sound.csv", more="" if head.startswith("file") else head)
    if head.startswith("file"):
        text = text.replace('file = "sound.csv"', head)
    if "input_floor" in head:
        text = text.replace('"base"', '"force"').replace("floor = 0", 'quantity = "force"')
    path = tmp_path / "record.toml"
    path.write_text(text)
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
    """pyuff reads it without a message, and returns neither abscissa nor values."""
    content = files.universal(tmp_path, binary=True)
    (tmp_path / "a.uff").write_bytes(content.replace(b"         4       200", b"         0       200", 1))
    with pytest.raises(InputError, match="a data set 58 lacks its numbers"):
        read_uff(tmp_path / "a.uff")
