"""Test modes from tables and universal files in a measurement file, and results in spreadsheets."""

import csv

import numpy as np
import pytest
from scipy import linalg

import cvxshear
from cvxshear.io.spreadsheets import write_csv, write_xlsx
from cvxshear.io.templates import template, template_from
from cvxshear.records import from_arrays
from cvxshear.records.result import SENSOR_STD
from cvxshear.report.terminal import sheets_of
from cvxshear.util.errors import InputError
from tests import closed

FREQUENCIES = [2.990, 7.934]
SHAPES = [[0.61071, 1.0], [-1.65840, 1.0]]
PLAIN = 'mode,"frequency, Hz",damping,frequency std,floor 1,floor 2\n1,2.990,0.01,0.001,0.61071,1.0\n'
PLAIN += "2,7.934,0.02,0.002,-1.65840,1.0\n"


def measurement(folder, said, more=""):
    path = folder / "test.toml"
    path.write_text(f"[frame]\ntotal_mass = 31.33\n{more}\n[[configuration]]\n{said}\n")
    return path


def check(experiment):
    (one,) = experiment.configurations
    np.testing.assert_allclose(one.frequencies, FREQUENCIES)
    ratios = one.mode_shapes[:, 0] / one.mode_shapes[:, 1]
    np.testing.assert_allclose(ratios, [0.61071, -1.65840])


@pytest.mark.parametrize(
    "table",
    [
        PLAIN,
        "# from the logger\nF (Hz);Floor_2;floor1\n2,990;1,0;0,61071\n7,934;1;-1,6584\n",
        "frequency\tfloor 1\tfloor 2\n2.990\t0.61071\t1\n7.934\t-1.6584\t1\n",
    ],
)
def test_a_csv_table(tmp_path, table):
    (tmp_path / "modes.csv").write_text(table)
    check(cvxshear.load(measurement(tmp_path, 'csv = "modes.csv"')))


def test_what_the_table_says_besides(tmp_path):
    (tmp_path / "modes.csv").write_text(PLAIN)
    one = cvxshear.load(measurement(tmp_path, 'csv = "modes.csv"\nname = "x"')).configurations[0]
    np.testing.assert_allclose(one.damping_ratios, [0.01, 0.02])
    np.testing.assert_allclose(one.frequency_std, [0.001, 0.002])
    said = cvxshear.load(measurement(tmp_path, 'csv = "modes.csv"\nfrequency_std = 0.005')).configurations[0]
    np.testing.assert_allclose(said.frequency_std, [0.005, 0.005])


def test_an_empty_cell_was_not_measured(tmp_path):
    (tmp_path / "modes.csv").write_text("frequency,floor 1,floor 3\n1.0,0.4,1.0\n3.0,,1.0\n,,\n")
    one = cvxshear.load(measurement(tmp_path, 'csv = "modes.csv"', "stories = 3")).configurations[0]
    np.testing.assert_array_equal(one.measured_floors, [1, 3])
    np.testing.assert_array_equal(one.mode_shapes, [[0.4, 1.0], [np.nan, 1.0]])


@pytest.mark.parametrize(
    ("table", "said", "expected"),
    [
        ("", "", r"modes\.csv is empty; a table has a header"),
        ("frequency,floor 1\n2.9,x\n", "", "line 2: column \"floor 1\" holds 'x', which is not a number"),
        ("frequency,floor 1\n,1.0\n", "", 'line 2: column "frequency" is empty'),
        ("frequency,roof\n2.9,1.0\n", "", 'column "roof" is not one of a table of modes'),
        ("frequency,floor 0,floor 1\n2.9,0,1\n", "", 'column "floor 0" is not one of a table of modes'),
        ("frequency,floor 1,floor 1\n2.9,1,1\n", "", 'has two columns named "floor 1"'),
        ("mode,floor 1\n1,1.0\n", "", 'needs a column "frequency"'),
        ("frequency,floor 1\n2.9,1.0,3.0\n", "", "line 2 has 3 cells where the header names 2 columns"),
        (PLAIN, "frequencies = [1.0]", "csv and frequencies all say what the modes are; give one"),
        (PLAIN, 'uff = "a.uff"', "csv and uff all say what the modes are"),
        (None, "", r"modes\.csv: no such file"),
    ],
)
def test_what_is_wrong_with_a_table_is_named(tmp_path, table, said, expected):
    if table is not None:
        (tmp_path / "modes.csv").write_text(table)
    with pytest.raises(InputError, match=expected):
        cvxshear.load(measurement(tmp_path, f'csv = "modes.csv"\n{said}'))


def test_a_universal_file(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    for mode, (frequency, shape) in enumerate(zip(FREQUENCIES, SHAPES, strict=True), 1):
        modal = pyuff.prepare_55(
            model_type=1, analysis_type=2, data_ch=2, spec_data_type=8, data_type=2, n_data_per_node=3, load_case=1,
            mode_n=mode, freq=frequency, modal_m=0.0, modal_damp_vis=0.01 * mode, modal_damp_his=0.0,
            node_nums=[1, 2], r1=np.array(shape), r2=np.zeros(2), r3=np.zeros(2),
        )  # fmt: skip
        pyuff.UFF(str(tmp_path / "modes.uff")).write_sets(modal, mode="add")
    experiment = cvxshear.load(measurement(tmp_path, 'uff = "modes.uff"'))
    check(experiment)
    np.testing.assert_allclose(experiment.configurations[0].damping_ratios, [0.01, 0.02])


WRITERS = {"csv": write_csv, "xlsx": write_xlsx}


@pytest.mark.parametrize("ending", WRITERS)
def test_modes_out_and_in_again(tmp_path, ending):
    pytest.importorskip("openpyxl")
    given = {"damping_ratios": [0.01, 0.02], "frequency_std": [0.001, 0.003], "mode_shape_std": 0.01}
    modes = from_arrays(FREQUENCIES, SHAPES, **given)
    WRITERS[ending](tmp_path / f"modes.{ending}", sheets_of(modes))
    experiment = cvxshear.load(measurement(tmp_path, f'{ending} = "modes.{ending}"'))
    check(experiment)
    np.testing.assert_allclose(experiment.configurations[0].frequency_std, [0.001, 0.003])
    np.testing.assert_allclose(experiment.configurations[0].mode_shape_std, modes.written_entry_std)


def test_an_identification_as_a_table(tmp_path):
    found = cvxshear.identify(cvxshear.load("paper"))
    write_csv(tmp_path / "frame.csv", sheets_of(found))
    rows = list(csv.reader((tmp_path / "frame.csv").read_text().splitlines()))
    assert rows[0][1] == "floor mass, kg"
    np.testing.assert_allclose([float(row[1]) for row in rows[1:]], found.frame.floor_mass)
    np.testing.assert_allclose([float(row[4]) for row in rows[1:]], found.frame.story_stiffness_std)
    each = cvxshear.identify(cvxshear.load("paper"), method="two-stage")
    assert [row[0] for row in sheets_of(each)[0].rows] == [p.name for p in each.parts for _ in range(2)]


def test_a_closure_as_a_workbook(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    closure = closed.paper()
    write_xlsx(tmp_path / "loop.xlsx", sheets_of(closure))
    book = openpyxl.load_workbook(tmp_path / "loop.xlsx")
    assert book.sheetnames == ["frame", "effects", "errors", "modes"]
    assert [row[0] for row in book["errors"].iter_rows(values_only=True)][1] == "largest frequency error"
    written = [cell for name in ("effects", "errors") for row in book[name].iter_rows(values_only=True) for cell in row]
    assert not [cell for cell in written if isinstance(cell, str) and "_" in cell]
    rows = list(book["modes"].iter_rows(values_only=True))
    errors = [abs(row[4]) for row in rows[1:]]
    assert max(errors) == pytest.approx(closure.to_dict()["after"]["max_frequency_error"], rel=1e-6)


@pytest.mark.parametrize("stories", [1, 2, 7])
def test_a_new_file_is_a_frame_of_equal_stories(tmp_path, stories):
    path = tmp_path / "new.toml"
    path.write_text(template(stories))
    frame = cvxshear.identify(cvxshear.load(path)).frame
    np.testing.assert_allclose(frame.floor_mass, 10.0, rtol=1e-2)
    np.testing.assert_allclose(frame.story_stiffness, 10e3, rtol=1e-2)


def test_a_new_file_from_a_table(tmp_path):
    (tmp_path / "modes.csv").write_text(PLAIN)
    (tmp_path / "tests").mkdir()
    path = tmp_path / "tests" / "new.toml"
    path.write_text(template_from(tmp_path / "modes.csv", path.parent))
    check(cvxshear.load(path))
    with pytest.raises(InputError, match=r"modes are read from files that end in \.csv"):
        template_from(tmp_path / "modes.doc")


@pytest.mark.parametrize("ending", WRITERS)
def test_the_scale_goes_out_and_comes_in(tmp_path, ending):
    """Mass-normalized modes give the masses of the original frame, without a declared total."""
    pytest.importorskip("openpyxl")
    masses, stiffnesses = np.array([12.7, 18.6]), np.array([26e3, 25e3])
    stiffness = np.array([[stiffnesses.sum(), -stiffnesses[1]], [-stiffnesses[1], stiffnesses[1]]])
    squares, shapes = linalg.eigh(stiffness, np.diag(masses))
    modes = from_arrays(np.sqrt(squares) / (2 * np.pi), shapes.T, mass_normalized=True, mode_shape_std=0.02)
    table = tmp_path / f"modes.{ending}"
    WRITERS[ending](table, sheets_of(modes))
    path = tmp_path / "new.toml"
    path.write_text(template_from(table, tmp_path))
    experiment = cvxshear.load(path)
    np.testing.assert_allclose(experiment.configurations[0].mode_shape_std, np.hypot(0.02, SENSOR_STD))
    np.testing.assert_allclose(cvxshear.identify(experiment).frame.floor_mass, masses, rtol=1e-6)


def test_a_scale_that_is_not_known_is_to_be_filled_in(tmp_path):
    (tmp_path / "modes.csv").write_text(PLAIN)
    text = template_from(tmp_path / "modes.csv", tmp_path)
    assert "total_mass = 1.0  # kg, all floors without added mass: FILL IN" in text
    assert "modes.csv does not tell how heavy the frame is" in text
    (tmp_path / "modes.csv").write_text(PLAIN.replace("floor 1", '"floor 1, 1/sqrt(kg)"'))
    with pytest.raises(InputError, match="some floors are in 1/sqrt"):
        template_from(tmp_path / "modes.csv", tmp_path)


def test_the_command_prints_or_writes_and_never_replaces(printed, refused, tmp_path):
    path = tmp_path / "new.toml"
    assert printed("new", "--stories", "2") == template(2)
    printed("new", "-o", path)
    assert "is there already" in refused("new", "-o", path)
    refused("new", "--from", "a.csv", "--stories", "2")
    assert cvxshear.load(path).stories == 3
