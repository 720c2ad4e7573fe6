"""Figures: nothing overlaps or is cut off at two or at twenty stories, and what is drawn is what was found."""

import dataclasses
import itertools
import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import cvxshear
from cvxshear.report import figures
from cvxshear.report.figures.drawn_shapes import mac_tables, mode_shapes
from cvxshear.report.figures.modal_figures import written
from cvxshear.report.figures.style import inline_svg, letters, power_of_ten, spread
from cvxshear.util.errors import InputError

ODDS = [1.0] + [0.0] * 13
OF_A_LOOP = [figures.frame, figures.shapes, figures.residual, figures.ranking, figures.mac]


def boxes(figure):
    """Every visible text with the box that the renderer gives it, pixels."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    texts = [*figure.texts, *(text for legend in figure.legends for text in legend.get_texts())]
    for axes in figure.axes:
        texts += [axes.title, axes._left_title, axes._right_title, axes.xaxis.label, axes.yaxis.label, *axes.texts]
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            texts += [
                label
                for tick in axis.get_major_ticks()
                if low - 1e-9 <= tick.get_loc() <= high + 1e-9
                for label in (tick.label1, tick.label2)
            ]
    return [
        (text.get_text(), text.get_window_extent(renderer))
        for text in texts
        if text.get_visible() and text.get_text().strip()
    ]


def assert_readable(figure):
    assert isinstance(figure, Figure)
    found = boxes(figure)
    assert found
    width, height = figure.bbox.size
    for text, box in found:
        inside = box.x0 >= -1 and box.y0 >= -1 and box.x1 <= width + 1 and box.y1 <= height + 1
        assert inside, f"{text!r} is cut off"
    for (text, a), (other, b) in itertools.combinations(found, 2):
        # Half a pixel of two letters' bearings is no overlap.
        shared = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        assert min(shared) < 1.0, f"{text!r} and {other!r} overlap by {shared} pixels"


@pytest.mark.parametrize("draw", OF_A_LOOP, ids=lambda draw: draw.__name__)
@pytest.mark.parametrize("result", ["paper", "twenty", "unexplained", "nine"])
def test_no_text_of_a_loops_figure_overlaps_or_is_cut_off(draw, result, request):
    assert_readable(draw(request.getfixturevalue(result)))


def test_no_text_of_the_other_figures_overlaps_or_is_cut_off(paper, study, six_story, comparison, no_heights, eight):
    two_stage = cvxshear.identify(paper.experiment, method="two-stage")
    tall = cvxshear.identify(eight.experiment, method="two-stage")
    for figure in (
        figures.convergence(two_stage),
        figures.convergence(tall),
        figures.frame(two_stage),
        figures.frame(no_heights),
        figures.mac(two_stage),
        figures.noise_boxes(study),
        figures.noise_variation(study),
        figures.noise_boxes(six_story),
        figures.noise_variation(six_story),
        figures.backend_differences(comparison),
    ):
        assert_readable(figure)


def test_values_without_deviation_have_one_format_in_a_frame(paper):
    """The masses of the paper's frame are above and below 10 kg times 1.5, the stiffnesses of one size."""
    parts = cvxshear.identify(paper.experiment, method="two-stage")
    for axes in figures.frame(parts).axes:
        said = [text.get_text() for text in axes.texts]
        for word in ("story", "floor"):
            numbers = [text.split()[2] for text in said if text.startswith(word) and ":" in text]
            assert len(numbers) == 2
            assert len({len(number.partition(".")[2]) for number in numbers}) == 1, numbers
        assert not any("±" in text for text in said)


def test_a_logarithmic_axis_of_less_than_a_decade_has_numbers(comparison):
    first = enumerate(comparison.rows[:12])
    rows = tuple(dataclasses.replace(row, relative_time=1.0 + 0.1 * place) for place, row in first)
    figure = figures.backend_differences(dataclasses.replace(comparison, rows=rows))
    assert_readable(figure)
    axis = figure.axes[1].xaxis
    low, high = axis.get_view_interval()
    labels = [
        tick.label1.get_text()
        for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]
        if low <= tick.get_loc() <= high and tick.label1.get_text()
    ]
    assert len(labels) >= 2
    assert set(labels) <= {"0.5", "1", "2", "5"}


@pytest.mark.parametrize("result", ["paper", "twenty"])
def test_no_text_of_a_plan_overlaps_or_is_cut_off(result, request):
    experiment = request.getfixturevalue(result).experiment
    assert_readable(figures.plan(cvxshear.plan(experiment, sensors=2)))


def test_every_axis_says_what_it_shows(paper, study, comparison):
    for figure in (figures.residual(paper), figures.backend_differences(comparison), figures.ranking(paper)):
        for axes in figure.axes:
            assert axes.get_xlabel()
    assert figures.frame(paper).axes[0].get_ylabel() == "elevation, m"
    assert figures.noise_variation(study).axes[0].get_ylabel().endswith("%")


def test_the_residual_is_drawn_in_the_noise_of_the_final_model(paper):
    left = figures.residual(paper).axes[0]
    drawn = {line.get_label(): line.get_xdata() for line in left.lines}
    measured = np.concatenate([each.frequencies for each in paper.experiment.configurations])
    # No noise is declared here: 0.2 % is the default, and the final model tells how many times that it is.
    noise = 0.002 * paper.noise.to_dict()["frequency"]["factor"]
    for step, name in ((paper.before, "before"), (paper.after, "after")):
        modelled = np.concatenate([each.frequencies for each in step.estimate.predictions])
        # The fit was made with the noise that the one before it spoke for; the two agree to a few percent.
        assert drawn[name] == pytest.approx(np.log(modelled / measured) / noise, rel=0.05)
    ratio = drawn["before"] / np.log(
        np.concatenate([p.frequencies for p in paper.before.estimate.predictions]) / measured
    )
    assert ratio == pytest.approx(ratio[0])
    assert drawn["after"] == pytest.approx(np.log(modelled / measured) * ratio[0])


def test_probabilities_are_drawn_as_log_odds_and_none_is_lost_at_the_edges(paper):
    axes = figures.ranking(paper).axes[0]
    candidates = paper.candidates[:14]
    before = next(line for line in axes.lines if line.get_label() == "before the data")
    prior = np.array([item.prior for item in candidates])
    assert 1 / (1 + np.exp(-before.get_xdata())) == pytest.approx(prior)
    drawn = {
        int(place): 1 / (1 + np.exp(-value))
        for line in axes.lines
        if line is not before and line.get_marker() != "None"
        for value, place in zip(line.get_xdata(), line.get_ydata(), strict=True)
    }
    assert sorted(drawn) == list(range(len(candidates)))
    for place, item in enumerate(candidates):
        assert drawn[place] == pytest.approx(np.clip(item.probability, 1e-4, 1 - 1e-4))
    sure = tuple(dataclasses.replace(item, probability=p) for item, p in zip(candidates, ODDS, strict=True))
    assert_readable(figures.ranking(dataclasses.replace(paper, candidates=sure)))


def test_shapes_are_scaled_to_the_measured_ones(eight):
    for item, target in zip(
        mode_shapes(eight.estimate),
        [(each, j) for each in eight.experiment.configurations for j in range(len(each.frequencies))],
        strict=True,
    ):
        configuration, j = target
        measured = configuration.mode_shapes[j]
        assert np.nanmax(np.abs(item.measured)) == pytest.approx(1.0)
        largest = int(np.argmax(np.abs(measured)))
        assert item.measured * (measured[largest] / item.measured[largest]) == pytest.approx(measured)
        # By least squares what is left is orthogonal to the model's shape.
        assert (item.measured - item.modelled) @ item.modelled == pytest.approx(0.0, abs=1e-9)


def test_a_mode_has_one_sign_in_all_configurations(nine):
    drawn = mode_shapes(nine.estimate)
    for item in drawn:
        first = next(each for each in drawn if each.mode == item.mode)
        assert item.modelled @ first.modelled > 0


def test_the_mac_matrix_is_that_of_the_predictions(paper):
    for (name, table), prediction, configuration in zip(
        mac_tables(paper), paper.estimate.predictions, paper.experiment.configurations, strict=True
    ):
        assert name == configuration.name
        for i, a in enumerate(configuration.mode_shapes):
            for j, b in enumerate(prediction.mode_shapes):
                assert table[i, j] == pytest.approx(np.dot(a, b) ** 2 / np.dot(a, a) / np.dot(b, b))
    assert min(np.diag(table).min() for _, table in mac_tables(paper)) == pytest.approx(
        paper.after.estimate.quality.min_mac
    )


@pytest.mark.parametrize(
    ("value", "two", "four"),
    [
        (1.0, "1.00", "1.0000"),
        (1.0 - 2e-16, "1.00", "1.0000"),
        (0.99999, "> 0.99", "> 0.9999"),
        (0.9962, "> 0.99", "0.9962"),
        (0.9946, "0.99", "0.9946"),
        (0.98766, "0.99", "0.9877"),
        (0.0, "0.00", "0.0000"),
    ],
)
def test_a_mac_is_rounded_and_1_only_where_shapes_are_the_same(value, two, four):
    assert (written(value, 2), written(value, 4)) == (two, four)


def test_convergence_shows_the_history(paper):
    found = cvxshear.identify(paper.experiment, method="two-stage")
    axes = figures.convergence(found, true_mass=np.array([13.0, 18.0])).axes[0]
    history = found.parts[0].history
    assert axes.lines[1].get_ydata() == pytest.approx(np.abs(history[:, 1] / 18.0 - 1.0))
    with pytest.raises(InputError, match="there is no mass iteration to show"):
        figures.convergence(cvxshear.identify(paper.experiment))


def test_variation_has_the_bound_beside_it(study):
    axes = figures.noise_variation(study).axes[2]
    drawn = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert drawn["two-stage"] == pytest.approx(
        [100 * each.variation[2] for each in study.scatters if each.method == "two-stage"]
    )
    assert drawn["Cramér-Rao bound"][-1] == pytest.approx(1.79, abs=0.005)
    with pytest.raises(InputError, match="none of the methods efficient; it has one-shot, two-stage"):
        figures.noise_boxes(study, ("efficient",))


def test_methods_part_without_colours(study):
    lines = figures.noise_variation(study).axes[0].lines
    assert len({(line.get_marker(), line.get_linestyle()) for line in lines}) == len(lines)


@pytest.mark.parametrize(("kind", "start"), [("svg", b"<?xml"), ("png", b"\x89PNG"), ("pdf", b"%PDF")])
def test_a_figure_is_written_whole_and_the_same_each_time(paper, tmp_path, kind, start):
    out = tmp_path / f"frame.{kind}"
    figures.save(figures.frame(paper), out)
    first = out.read_bytes()
    figures.save(figures.frame(paper), out)
    assert first.startswith(start)
    assert out.read_bytes() == first
    assert list(tmp_path.iterdir()) == [out]


def test_another_ending_is_refused_and_nothing_written(paper, tmp_path):
    with pytest.raises(InputError, match=r"frame\.jpg: a figure is written as \.svg, \.png or \.pdf"):
        figures.save(figures.frame(paper), tmp_path / "frame.jpg")
    with pytest.raises(InputError, match="cannot be written"):
        figures.save(figures.frame(paper), tmp_path / "nowhere" / "frame.svg")
    assert list(tmp_path.iterdir()) == []


def test_no_setting_of_the_user_is_changed_and_no_window_opened():
    code = (
        "import matplotlib as mpl\n"
        "mpl.rcParams['font.size'] = 17\n"
        "before = {key: mpl.rcParams[key] for key in mpl.rcParams if key != 'backend'}\n"
        "import cvxshear, sys\n"
        "from cvxshear.report import figures\n"
        "figures.frame(cvxshear.identify(cvxshear.load('paper')))\n"
        "print('matplotlib.pyplot' in sys.modules)\n"
        "print({key: mpl.rcParams[key] for key in before} == before)\n"
    )
    shown = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.split() == ["False", "True"]


def test_a_user_setting_does_not_change_a_figure(paper):
    plain = inline_svg(figures.frame(paper), "a")
    with mpl.rc_context({"font.size": 30, "axes.facecolor": "red"}):
        assert inline_svg(figures.frame(paper), "a") == plain


def test_names_are_shown_on_one_line_in_letters_that_there_are():
    assert letters("a\nb  c") == "a b c"
    assert letters("x" * 40, 10) == "x" * 9 + "…"
    assert letters("\U0010ffff") == "□"


def test_labels_are_spread_and_stay_between_the_ends():
    placed = spread(np.array([0.0, 0.1, 0.2, 5.0]), 1.0, 0.0, 5.0)
    assert np.diff(placed).min() >= 1.0 - 1e-12
    assert placed == pytest.approx([0.0, 1.0, 2.0, 5.0])
    assert spread(np.array([4.8, 4.9, 5.0]), 1.0, 0.0, 5.0) == pytest.approx([3.0, 4.0, 5.0])


def test_powers_of_ten_are_written_so():
    assert [power_of_ten(value) for value in (1e-12, 1.0, 1000.0, -10.0, 2.0, 0.0)] == [
        "10⁻¹²", "1", "1000", "−10", "", "0",
    ]  # fmt: skip
