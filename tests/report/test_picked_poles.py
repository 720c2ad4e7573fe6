"""Test poles chosen by clicks on the stabilization diagram, and their storage in the record file."""

import tomllib

import pytest
from matplotlib import pyplot
from matplotlib.backend_bases import MouseEvent

from cvxshear.io.record_file import write_pick
from cvxshear.records import from_arrays, identify_modes
from cvxshear.records.simulate import PAPER_FRAME, hammer_record
from cvxshear.report.figures.frequency_figures import PolePicker
from cvxshear.util.errors import InputError

RECORD = """# a test
added_mass = [0.0, 0.0, 1.0]  # kg
[record]  # of hits
input = "force"
file = "hits.csv"
{pick}
[[channel]]  # the roof
column = "roof"
floor = 3
"""


@pytest.fixture(scope="module")
def result():
    return identify_modes(hammer_record(PAPER_FRAME, 1, noise=0.005, hits=2))


def click(picker, frequency):
    """Click on the diagram at a frequency, Hz."""
    axes = picker.figure.axes[0]
    x, y = axes.transData.transform((frequency, 10.0))
    canvas = picker.figure.canvas
    canvas.callbacks.process("button_press_event", MouseEvent("button_press_event", canvas, x, y, button=1))


def test_clicks_choose_and_give_up_and_are_written(result, tmp_path):
    file = tmp_path / "record.toml"
    file.write_text(RECORD.format(pick=""))
    picker = PolePicker(result, file)
    assert picker.frequencies == pytest.approx(PAPER_FRAME.modes()[0], rel=1e-3)
    click(picker, result.frequencies[1])
    click(picker, 0.5 * result.frequencies[0])  # no pole there: the choice stays
    expected = PAPER_FRAME.modes()[0][[0, 2]]
    assert picker.frequencies == pytest.approx(expected, rel=1e-3)
    assert tomllib.loads(file.read_text())["record"]["pick"] == pytest.approx(expected, rel=1e-3)
    click(picker, result.frequencies[1])
    assert len(tomllib.loads(file.read_text())["record"]["pick"]) == 3


@pytest.mark.parametrize("pick", ["", "pick = [1.0]  # by eye", "pick = [\n  1.0,\n  2.0,\n]"])
def test_the_rest_of_the_record_file_stays(tmp_path, pick):
    file = tmp_path / "record.toml"
    file.write_text(RECORD.format(pick=pick))
    before = tomllib.loads(file.read_text())
    write_pick(file, [3.6812, 11.1])
    after = tomllib.loads(file.read_text())
    assert after["record"].pop("pick") == [3.6812, 11.1]
    before["record"].pop("pick", None)
    assert after == before
    assert all(comment in file.read_text() for comment in ("# a test", "# kg", "# of hits", "# the roof"))


def test_a_record_file_without_a_header_is_left_alone(tmp_path):
    file = tmp_path / "record.toml"
    file.write_text('record = { file = "hits.csv" }\n')
    with pytest.raises(InputError, match=r"has no table \[record\] .* write there: pick = \[1\.5\]"):
        write_pick(file, [1.5])
    assert file.read_text() == 'record = { file = "hits.csv" }\n'


def test_a_backend_without_windows_says_what_to_do(result):
    """The tests draw into files, like a server."""
    pyplot.switch_backend("agg")
    with pytest.raises(InputError, match=r"%matplotlib widget .* cvxshear modes RECORD --pick list"):
        result.pick()


def test_modes_that_were_given_have_no_poles_to_choose_from():
    with pytest.raises(InputError, match="needs an order sweep"):
        PolePicker(from_arrays([1.0, 3.0], [[0.5, 1.0], [1.0, -0.5]]))
