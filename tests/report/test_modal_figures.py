"""Test figures of identified modes and of floors that turn: no overlap, and values equal to the result."""

import dataclasses
import re

import numpy as np
import pytest
from matplotlib.patches import Ellipse

import cvxshear
from cvxshear import close_loop
from cvxshear.records import ModalResult, from_arrays, identify_modes
from cvxshear.records.simulate import PAPER_FRAME, KnownFrame, base_record, hammer_record, shaker_record
from cvxshear.report import figures
from cvxshear.report.figures.mode_figures import mode_shapes
from cvxshear.report.html import render
from cvxshear.util.errors import InputError
from tests.fe.plan_frames import random_frame
from tests.frames import EXAMPLES, chain
from tests.report.test_figures import assert_readable

OF_RECORDS = (figures.stabilization, figures.functions, figures.modal_shapes)
MASSES = np.array([10.0, 7.5, 5.0])
STIFFNESSES = np.array([36e3, 24e3, 12e3])


@pytest.fixture(scope="module")
def hammer():
    return identify_modes(hammer_record(PAPER_FRAME, 0, noise=0.01, hits=2), functions=True)


@pytest.fixture(scope="module")
def shaker():
    two = KnownFrame(np.array([2.0, 1.0]), np.array([4000.0, 1500.0]), 0.01)
    record = shaker_record(two, 0, noise=0.01, floor=2, sampling_rate=40.0, duration=120.0)
    name = 'a "long" name of a record: $x_1$ & 结构 ' * 2
    return dataclasses.replace(identify_modes(record, functions=True), name=name)


@pytest.fixture(scope="module")
def base():
    return identify_modes(base_record(PAPER_FRAME, 0, noise=0.01, duration=240.0), functions=True)


def twenty_modes(sweep):
    """Return twenty closely spaced modes at twenty floors, with the order sweep of another record."""
    angle = (2 * np.arange(1, 21) - 1) * np.pi / 41
    shapes = np.sin(np.outer(angle, np.arange(1, 21)))
    found = from_arrays(3.2 * np.sin(angle / 2), shapes, frequency_std=0.001, mode_shape_std=0.01, name="twenty")
    return dataclasses.replace(found, sweep=sweep)


@pytest.fixture(scope="module")
def twenty(hammer):
    return twenty_modes(hammer.sweep)


@pytest.mark.parametrize("draw", OF_RECORDS, ids=lambda draw: draw.__name__)
def test_no_text_overlaps_or_is_cut_off(draw, hammer, shaker):
    assert_readable(draw(hammer, shaker))
    assert_readable(draw(shaker))


@pytest.mark.parametrize("draw", [figures.stabilization, figures.modal_shapes])
def test_nor_with_twenty_modes(draw, twenty):
    assert_readable(draw(twenty))


def test_the_poles_of_the_modes_are_drawn_at_their_frequencies(hammer):
    axes = figures.stabilization(hammer).axes[0]
    lines = {line.get_label(): line for line in axes.get_lines()}
    frequencies, orders = lines["of a mode"].get_data()
    assert set(np.round(frequencies, 1)) == {1.0, 2.2, 3.3}
    assert max(orders) == 30
    assert len(lines["pole"].get_xdata()) > 20
    assert [text.get_text() for text in axes.texts] == ["1: 1.034 Hz", "2: 2.210 Hz", "3: 3.281 Hz"]


def test_a_mode_faces_one_way_in_every_record(hammer):
    turned = dataclasses.replace(hammer, mode_shapes=-hammer.mode_shapes, name="turned")
    drawn = [axes.get_lines()[1].get_xdata() for axes in figures.modal_shapes(hammer, turned).axes]
    for first, second in zip(drawn[:3], drawn[3:], strict=True):
        np.testing.assert_allclose(first, second)


def test_each_record_begins_a_row(hammer, shaker):
    """A record with two modes or floors stands between records with three; rows are not shared."""
    for draw in (figures.modal_shapes, figures.functions):
        rows = [axes.get_subplotspec().rowspan.start for axes in draw(hammer, shaker, hammer).axes]
        assert rows == [0, 0, 0, 1, 1, 2, 2, 2], draw.__name__


def test_functions_of_other_units_are_labelled_at_each_record(hammer, base):
    figure = figures.functions(hammer, base)
    assert figure.axes[0].get_ylabel() == "accelerance, (m/s²)/N"
    assert figure.axes[3].get_ylabel() == "acceleration / base acceleration"
    assert_readable(figure)


def test_a_deviation_that_nobody_stated_is_not_drawn(hammer):
    assert "±" in figures.modal_shapes(hammer).axes[0].get_title(loc="left")
    given = from_arrays([3.0, 9.0], [[0.5, 1.0], [1.0, -0.6]])
    assert "±" not in figures.modal_shapes(given).axes[0].get_title(loc="left")


def test_what_is_lacking_is_said():
    given = from_arrays([3.0, 9.0], [[0.5, 1.0], [1.0, -0.6]], name="given")
    with pytest.raises(InputError, match="'stabilization' needs an order sweep"):
        figures.stabilization(given)
    with pytest.raises(InputError, match="needs"):
        figures.functions(given)


def test_the_same_mode_of_two_configurations_faces_one_way():
    """The second mode's largest entry moves from the top to the middle floor, due to a mass on the top."""
    configurations = []
    for name, added in (("bare", 0.0), ("loaded", 2.5)):
        weights = np.array([0.0, 0.0, added])
        mass, stiffness = chain(MASSES + weights, STIFFNESSES)
        values, vectors = np.linalg.eigh(np.diag(np.diag(mass) ** -0.5) @ stiffness @ np.diag(np.diag(mass) ** -0.5))
        shapes = (np.diag(np.diag(mass) ** -0.5) @ vectors).T
        scaled = shapes / shapes[np.arange(3), np.argmax(np.abs(shapes), axis=1)][:, None]
        frequencies = (np.sqrt(values) / (2 * np.pi)).tolist()
        noise = {"frequency_std": 0.001, "mode_shape_std": 0.01}
        modes = {"frequencies": frequencies, "mode_shapes": scaled.tolist()}
        configurations.append({"name": name, "added_mass": weights.tolist(), **modes, **noise})
    experiment = cvxshear.Experiment.from_dict({"configuration": configurations})
    drawn = mode_shapes(close_loop(experiment, effects=["story_change"]).estimate)
    for first, second in zip(drawn[:3], drawn[3:], strict=True):
        assert first.modelled @ second.modelled > 0
        assert first.measured @ second.measured > 0
        assert np.nanmax(np.abs(second.measured)) == pytest.approx(1.0)


def test_the_first_figure_of_a_record_is_its_stabilization_diagram():
    """A file without a named kind gets this figure; a report has the others in this order."""
    expected = ["stabilization", "amplitude", "functions", "shapes", "plan_shapes"]
    assert list(figures.figures_of(ModalResult)) == expected


def test_plans_show_the_centers_with_ellipses_of_95_percent():
    result = cvxshear.identify(random_frame(2, 3).experiment(noise=0.005, std=0.005, seed=1), method="one-shot")
    figure = figures.plans(result)
    assert_readable(figure)
    for floor, axes in enumerate(figure.axes):
        centers = {line.get_label(): np.ravel(line.get_data()) for line in axes.lines}
        np.testing.assert_allclose(centers["center of mass"], result.frame.mass_center[floor])
        np.testing.assert_allclose(centers["center of stiffness"], result.frame.stiffness_center[floor])
        of_mass = next(each for each in axes.patches if isinstance(each, Ellipse))
        # Chi-square of two degrees of freedom is below 5.991 with 95 %.
        expected = 2.0 * np.sqrt(5.991) * result.frame.mass_center_std[floor]
        np.testing.assert_allclose([of_mass.width, of_mass.height], expected, rtol=1e-4)


def test_modes_from_above_name_their_shares():
    result = cvxshear.identify(
        random_frame(2, 31, symmetric=True).experiment(noise=0.001, std=0.001), method="one-shot"
    )
    figure = figures.plan_shapes(result)
    assert_readable(figure)
    titles = [axes.get_title(loc="left") or axes.get_title() for axes in figure.axes]
    assert len(titles) == 6
    assert all("100 %" in title or "9" in title for title in titles)


def test_a_page_of_an_identification(tmp_path, printed):
    page = tmp_path / "frame.html"
    printed("identify", EXAMPLES / "turning_floors.toml", "--report", page, "--quiet")
    text = page.read_text()
    for figure in ("plans", "plan_shapes"):
        assert f'id="figure-{figure}"' in text
    with pytest.raises(InputError, match="floors that turn"):
        figures.plans(cvxshear.identify("paper"))


def test_the_page_of_a_loop_moves_the_plans_of_its_floors():
    """A corner at r from the reference moves by u + theta (-r_y, r_x), with u and theta from the sensors' readings."""
    result = cvxshear.close_loop("examples/turning_floors.toml")
    page = render(result, command="cvxshear loop examples/turning_floors.toml")
    drawing = re.search(r'<figure id="figure-swaying">(.*?)</figure>', page, re.DOTALL)[1]
    panels = re.findall(r"<title>mode (\d): (.*?) Hz; (.*?)</title>(.*?)</g></g>", drawing, re.DOTALL)
    assert [int(number) for number, *_ in panels] == list(range(1, 10))
    tested, found = result.experiment.configurations[0], result.estimate.predictions[0]
    corners = np.array([[x, y] for x, y in ((-6.0, -4.5), (6.0, -4.5), (6.0, 4.5), (-6.0, 4.5))])
    for place, (_, frequency, said, drawn) in enumerate(panels):
        assert float(frequency) == pytest.approx(tested.frequencies[place], rel=1e-3)
        assert "rotation" in said
        rest, moved = (
            np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", path), dtype=float).reshape(3, 4, 2)
            for path in re.findall(r' d="(.*?)"', drawn)[:2]
        )
        shape = found.mode_shapes[found.modes[place] - 1]
        expected = []
        for floor in range(3):
            # Readings along x and y at (6, 4.5), and along x at (-6, -4.5).
            along, across, opposite = shape[3 * floor : 3 * floor + 3]
            turn = (opposite - along) / 9.0
            u = np.array([along + 4.5 * turn, across - 6.0 * turn])
            expected.append(u + turn * np.column_stack([-corners[:, 1], corners[:, 0]]))
        pixels = (moved - rest) * [1.0, -1.0]
        scale = np.max(np.abs(pixels)) / np.max(np.abs(expected))
        np.testing.assert_allclose(pixels, scale * np.array(expected), atol=0.2)
